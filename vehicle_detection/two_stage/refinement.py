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
# Outputs of a mirrored patch: the score, and the shifts of left, top, right and bottom.
_MIRRORED_OUTPUTS = np.array([0, 3, 2, 1, 4])
_MIRRORED_SIGNS = np.array([1, -1, 1, -1, 1], np.float32)
# Left and right change places.
_MIRRORED_BORDERS = np.array([2, 1, 0, 3])


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


def refine(
    frame: np.ndarray,
    boxes: np.ndarray,
    detector: Detector,
    n_predicted: int = 0,
    mirrored: bool = False,
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
    mirrored : bool
        See `look`.

    Returns
    -------
    candidates : Candidates
    """
    # For products this small, waking BLAS's threads takes longer than the product.
    with _LIBRARIES.limit(limits=1, user_api="blas"):
        moved, scores = look(frame, boxes, detector, mirrored)
        again = scores > 0
        again[:n_predicted] = False
        if again.any():
            moved[again], scores[again] = look(frame, moved[again], detector, mirrored)
    return Candidates(moved, scores)


def look(frame: np.ndarray, boxes: np.ndarray, detector: Detector, mirrored: bool = False) -> tuple:
    """Where the edges of boxes belong, and the decision function of the boxes as they are.

    Parameters
    ----------
    frame, boxes, detector
        See `refine`.
    mirrored : bool
        What is found is the mean of what the patches and their mirror images tell: a mirrored
        vehicle is one, too.

    Returns
    -------
    moved : ndarray of float, shape (n, 4)
    scores : ndarray of float32, shape (n,)
    """
    boxes = on_whole_pixels(boxes)
    patches, outside = cut_patches(frame, boxes), margins_outside(boxes, frame.shape)
    outputs = detector.machine.predict(describe_patches(patches, outside))
    if mirrored:
        features = describe_patches(patches[:, :, ::-1], outside[:, _MIRRORED_BORDERS])
        of_mirrored = detector.machine.predict(features)[:, _MIRRORED_OUTPUTS]
        outputs = (outputs + _MIRRORED_SIGNS * of_mirrored) / 2
    return move_edges(boxes, outputs[:, 1:]), outputs[:, 0]
