"""Second stage: proposals and predictions are moved onto vehicles and scored there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import ThreadpoolController

from vehicle_detection.two_stage.features import (
    cut_patches,
    describe_for_regressor,
    describe_for_scorer,
    luma_and_chroma,
    margins_outside,
    on_whole_pixels,
)

if TYPE_CHECKING:
    from vehicle_detection.two_stage.model import Detector

_MOST_SHIFT = 0.49
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


def refine(frame: np.ndarray, boxes: np.ndarray, detector: Detector) -> Candidates:
    """Move the edges of boxes to where they belong, and score them there.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of float, shape (n, 4)
    detector : Detector

    Returns
    -------
    candidates : Candidates
    """
    # For products this small, waking BLAS's threads takes longer than the product.
    with _LIBRARIES.limit(limits=1, user_api="blas"):
        moved = move_boxes(frame, boxes, detector.regressor)
        return Candidates(moved, score_boxes(frame, moved, detector.scorer))


def move_boxes(frame: np.ndarray, boxes: np.ndarray, regressor: Any) -> np.ndarray:
    """Boxes where the regressor sees the edges of vehicles, shape (n, 4), on whole pixels."""
    boxes = on_whole_pixels(boxes)
    planes = luma_and_chroma(cut_patches(frame, boxes))
    features = describe_for_regressor(planes, margins_outside(boxes, frame.shape))
    return on_whole_pixels(move_edges(boxes, regressor.predict(features)))


def score_boxes(frame: np.ndarray, boxes: np.ndarray, scorer: Any) -> np.ndarray:
    """Decision function of boxes where they are, ndarray of float32, shape (n,)."""
    planes = luma_and_chroma(cut_patches(frame, boxes))
    return scorer.predict(describe_for_scorer(planes, margins_outside(boxes, frame.shape)))[:, 0]


def move_edges(boxes: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Boxes with each edge moved by a share of the box's width or height.

    By less than half, so that the left edge stays left of the right one.
    """
    size = boxes[:, 2:] - boxes[:, :2]
    return boxes + np.clip(shifts, -_MOST_SHIFT, _MOST_SHIFT) * np.hstack([size, size])
