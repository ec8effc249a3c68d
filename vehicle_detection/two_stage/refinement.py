"""Second stage: proposals and predictions are moved onto vehicles and scored there."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
from threadpoolctl import ThreadpoolController

from vehicle_detection.tracking.boxes import best_iou
from vehicle_detection.two_stage.features import (
    chroma_features,
    cut_patches,
    describe_for_scorer,
    luma_and_chroma,
    margins_outside,
    on_whole_pixels,
    patch_features,
    regressor_features,
    scorer_features,
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
    is_tracked : ndarray of bool, shape (n,)
        The box was predicted by a track; the others were proposed by the first stage.
    """

    boxes: np.ndarray
    scores: np.ndarray
    is_tracked: np.ndarray

    def only(self, chosen: np.ndarray) -> Candidates:
        """The candidates that a mask or index array picks."""
        return Candidates(*(getattr(self, field.name)[chosen] for field in fields(self)))


def merge(predicted: np.ndarray, proposals: np.ndarray, same_iou: float) -> Candidates:
    """Predictions of tracks, and the proposals that overlap none of them too much.

    Parameters
    ----------
    predicted, proposals : ndarray of float, shapes (n, 4) and (m, 4)
    same_iou : float
        A proposal whose IoU with a prediction is this or more shows the same vehicle.

    Returns
    -------
    candidates : Candidates
        Their scores are 0.
    """
    fresh = proposals[best_iou(proposals, predicted) < same_iou]
    boxes = np.concatenate([predicted, fresh])
    return Candidates(boxes, np.zeros(len(boxes)), np.arange(len(boxes)) < len(predicted))


def refine(
    frame: np.ndarray, candidates: Candidates, detector: Detector, discard_below: float
) -> Candidates:
    """Move the edges of candidates to where they belong, and score them there.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    candidates : Candidates
    detector : Detector
    discard_below : float
        A candidate that scores less where it was proposed stays there, with its score.

    Returns
    -------
    candidates : Candidates
    """
    # For products this small, waking BLAS's threads takes longer than the product.
    with _LIBRARIES.limit(limits=1, user_api="blas"):
        boxes, scores = _move_and_score(frame, candidates.boxes, detector, discard_below)
    return Candidates(boxes, scores, candidates.is_tracked)


def _move_and_score(frame, boxes, detector, discard_below):
    boxes = on_whole_pixels(boxes)
    outside = margins_outside(boxes, frame.shape)
    planes = luma_and_chroma(cut_patches(frame, boxes))
    cells, contrast = patch_features(planes)
    scores = detector.scorer.predict(scorer_features(cells, outside))[:, 0]
    near = scores > discard_below
    chroma = chroma_features(planes[:, near], contrast[near])
    shifts = detector.regressor.predict(regressor_features(cells[near], chroma, outside[near]))
    boxes[near] = on_whole_pixels(move_edges(boxes[near], shifts))
    scores[near] = score_boxes(frame, boxes[near], detector.scorer)
    return boxes, scores


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
