"""Which candidates of a frame remain: possible sizes and shapes, non-maximum suppression."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vehicle_detection.tracking.boxes import (
    box_areas,
    clip_to_frame,
    pairwise_overlap,
)

if TYPE_CHECKING:
    from vehicle_detection.parameters import ScanParams, SelectionParams


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


def non_max_suppression(
    boxes: np.ndarray, scores: np.ndarray, params: SelectionParams
) -> np.ndarray:
    """Of boxes in conflict, keep the better ones.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    scores : ndarray, shape (n,)
    params : SelectionParams
        See `overlap_conflicts`. Scores are compared in steps of `score_step`, and among equal
        ones the earlier box stays: how a processor rounds must not move a box.

    Returns
    -------
    kept : ndarray of int
        Indices, best first.
    """
    conflicts = overlap_conflicts(boxes, params)
    suppressed, kept = np.zeros(len(boxes), bool), []
    for i in np.argsort(-np.rint(scores / params.score_step), kind="stable"):
        if not suppressed[i]:
            kept.append(i)
            suppressed |= conflicts[i]
    return np.array(kept, int)


def are_plausible(
    boxes: np.ndarray, frame_shape: tuple, scan: ScanParams, params: SelectionParams
) -> np.ndarray:
    """Which boxes have a size and shape that a vehicle within reach of the scan can have.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    frame_shape : (rows, columns, ...)
    scan : ScanParams
    params : SelectionParams

    Returns
    -------
    plausible : ndarray of bool, shape (n,)
    """
    width, height = (boxes[:, 2:] - boxes[:, :2]).T
    visible = box_areas(clip_to_frame(boxes, frame_shape)) / np.maximum(width * height, 1e-9)
    unit = frame_shape[1] / scan.reference_width
    low = scan.smallest * unit * params.size_range[0]
    high = scan.largest * unit * params.size_range[1]
    narrowest, widest = params.aspect_range
    shaped = (narrowest * height < width) & (width < widest * height)
    return (visible > params.min_visible) & shaped & (low < height) & (height < high)
