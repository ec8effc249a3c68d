"""Second stage: proposals and predictions are scored, and moved onto vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import ThreadpoolController

from vehicle_detection.two_stage.features import (
    cut_patches,
    describe_patches,
    margins_outside,
    on_whole_pixels,
)
from vehicle_detection.two_stage.proposals import move_edges

if TYPE_CHECKING:
    from vehicle_detection.two_stage.model import Detector

_LIBRARIES = ThreadpoolController()


@dataclass(frozen=True)
class Candidates:
    """Boxes of one frame that may be vehicles.

    Attributes
    ----------
    boxes : ndarray of float, shape (n, 4)
    scores : ndarray of float, shape (n,)
        Decision function of the second stage, positive for vehicles.
    """

    boxes: np.ndarray
    scores: np.ndarray

    def only(self, chosen: np.ndarray) -> Candidates:
        """The candidates that a mask or index array picks."""
        return Candidates(self.boxes[chosen], self.scores[chosen])


def refine(
    frame: np.ndarray, boxes: np.ndarray, detector: Detector, n_looks: int = 1
) -> Candidates:
    """Score boxes, and move their edges to where they belong.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of float, shape (n, 4)
    detector : Detector
    n_looks : int
        So often, the score being the last one.

    Returns
    -------
    candidates : Candidates
    """
    for _ in range(n_looks):
        candidates = _look(frame, boxes, detector)
        boxes = candidates.boxes
    return candidates


def _look(frame, boxes, detector):
    """Boxes with their scores, and where they belong, as `refine`."""
    boxes = on_whole_pixels(boxes)
    outside = margins_outside(boxes, frame.shape)
    features = describe_patches(cut_patches(frame, boxes), outside)
    # For products this small, waking BLAS's threads takes longer than the product.
    with _LIBRARIES.limit(limits=1, user_api="blas"):
        outputs = detector.machine.predict(features)
    return Candidates(move_edges(boxes, outputs[:, 1:]), outputs[:, 0])
