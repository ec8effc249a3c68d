"""Which candidates of a frame remain: non-maximum suppression."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vehicle_detection.tracking.boxes import box_areas, pairwise_overlap

if TYPE_CHECKING:
    from vehicle_detection.parameters import SelectionParams


def overlap_conflicts(boxes: np.ndarray, params: SelectionParams) -> np.ndarray:
    """Which boxes cannot frame two vehicles that are both seen.

    Two boxes are in conflict if their IoU is above `params.max_iou`, or if more than
    `params.max_covered` of the smaller one lies within the larger one: it is then a part.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    params : SelectionParams

    Returns
    -------
    conflicts : ndarray of bool, shape (n, n)
    """
    areas, common = box_areas(boxes), pairwise_overlap(boxes, boxes)
    covered = common > params.max_covered * np.minimum(areas[:, None], areas)
    return covered | (common > params.max_iou * (areas[:, None] + areas - common))


def non_max_suppression(conflicts: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Of boxes in conflict, keep the better ones.

    Parameters
    ----------
    conflicts : ndarray of bool, shape (n, n)
        See `overlap_conflicts`.
    scores : ndarray, shape (n,)

    Returns
    -------
    kept : ndarray of int
        Indices, best first; of equal scores the earlier one.
    """
    suppressed, kept = np.zeros(len(scores), bool), []
    for i in np.argsort(-scores, kind="stable"):
        if not suppressed[i]:
            kept.append(i)
            suppressed |= conflicts[i]
    return np.array(kept, int)
