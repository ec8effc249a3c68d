"""Second stage: proposals and predictions are scored, and moved onto vehicles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import ThreadpoolController

from vehicle_detection.tracking.boxes import move_edges
from vehicle_detection.two_stage.features import (
    cut_patches,
    describe_patches,
    margins_outside,
    on_whole_pixels,
)

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
        Decision function of the second stage at the last look, positive for vehicles.
    """

    boxes: np.ndarray
    scores: np.ndarray

    def only(self, chosen: np.ndarray) -> Candidates:
        """The candidates that a mask or index array picks."""
        return Candidates(self.boxes[chosen], self.scores[chosen])


def refine(
    frame: np.ndarray, boxes: np.ndarray, detector: Detector, n_predicted: int = 0
) -> Candidates:
    """Score boxes and move their edges to where they belong, some twice.

    A box that is off scores low. A proposal that scores above 0 is looked at again where it was
    moved. What a track predicts was moved in the frame before.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of float, shape (n, 4)
    detector : Detector
    n_predicted : int
        So many of the first boxes are predictions of tracks.

    Returns
    -------
    candidates : Candidates
    """
    # For products this small, waking BLAS's threads takes longer than the product.
    with _LIBRARIES.limit(limits=1, user_api="blas"):
        moved, scores = look(frame, boxes, detector)
        again = scores > 0
        again[:n_predicted] = False
        moved[again], scores[again] = look(frame, moved[again], detector)
    return Candidates(moved, scores)


def look(frame: np.ndarray, boxes: np.ndarray, detector: Detector) -> tuple:
    """Where the edges of boxes belong, and the decision function of the boxes as they are.

    Returns
    -------
    moved : ndarray of float, shape (n, 4)
    scores : ndarray of float32, shape (n,)
    """
    boxes = on_whole_pixels(boxes)
    outside = margins_outside(boxes, frame.shape)
    outputs = detector.machine.predict(describe_patches(cut_patches(frame, boxes), outside))
    return move_edges(boxes, outputs[:, 1:]), outputs[:, 0]
