"""Geometry of boxes: left, top, right, bottom in pixels, arrays of shape (n, 4)."""

from __future__ import annotations

import numpy as np

_MOST_SHIFT = 0.49


def box_heights(boxes: np.ndarray) -> np.ndarray:
    """Heights of boxes, shape (n,)."""
    return boxes[:, 3] - boxes[:, 1]


def box_areas(boxes: np.ndarray) -> np.ndarray:
    """Areas of boxes, shape (n,)."""
    return (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)


def pairwise_overlap(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Intersection of every box with every other, in square pixels, shape (n, m)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    return np.clip(high - low, 0, None).prod(axis=2)


def pairwise_iou(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Intersection over union of every box with every other, shape (n, m)."""
    common = pairwise_overlap(boxes, others)
    areas, other_areas = (box_areas(b) for b in (boxes, others))
    union = areas[:, None] + other_areas[None] - common
    return np.divide(common, union, out=np.zeros_like(common, float), where=union > 0)


def best_iou(boxes: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Largest IoU of each box with any other, 0 where there is no other; shape (n,)."""
    return pairwise_iou(boxes, others).max(axis=1, initial=0)


def clip_to_frame(boxes: np.ndarray, frame_shape: tuple) -> np.ndarray:
    """The part of each box that lies within a frame of (rows, columns, ...)."""
    rows, columns = frame_shape[:2]
    return np.clip(boxes, 0, (columns, rows, columns, rows))


def touches_border(boxes: np.ndarray, frame_shape: tuple) -> np.ndarray:
    """Which edges of boxes lie within a pixel of the border of the frame, or beyond it.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    frame_shape : (rows, columns, ...)

    Returns
    -------
    touches : ndarray of bool, shape (n, 4)
        Left, top, right, bottom.
    """
    rows, columns = frame_shape[:2]
    return np.hstack([boxes[:, :2] < 1, boxes[:, 2:] > (columns - 1, rows - 1)])


def stack_boxes(boxes: list) -> np.ndarray:
    """A list of single boxes as one array of shape (n, 4), also if the list is empty."""
    return np.array(boxes, float).reshape(-1, 4)


def move_edges(boxes: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Boxes with each edge moved by a share of the box's width or height.

    By less than half, so that the left edge stays left of the right one.
    """
    size = boxes[:, 2:] - boxes[:, :2]
    return boxes + np.clip(shifts, -_MOST_SHIFT, _MOST_SHIFT) * np.hstack([size, size])
