"""First stage: linear SVMs score windows of four shapes; the best, moved, are proposals.

frame -> levels -> cells -> window scores -> best windows -> moved edges -> proposals

A level is the frame at one scale, described by cells of 4 x 4 pixels: HOG of the luma and the
mean colour. Windows are 8 cells high and of four widths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from vehicle_detection.compiled.cells import cell_lengths, describe_cells
from vehicle_detection.compiled.hog import cell_histograms
from vehicle_detection.compiled.window_sums import correlate, sums_at
from vehicle_detection.tracking.boxes import move_edges
from vehicle_detection.two_stage.features import ORIENTATIONS

if TYPE_CHECKING:
    from vehicle_detection.parameters import ScanParams
    from vehicle_detection.two_stage.road import Reach

# Windows in cells: lorries are higher than wide, cars from the side twice as wide as high.
WINDOW_ROWS = 8
WINDOW_COLUMNS = (6, 8, 11, 16)
# Side of a cell, in pixels of the level.
WINDOW_CELL = 4
# So many cells around a window tell, too, where the edges of a vehicle are.
WINDOW_CONTEXT = 3
# A cell is normalised by the mean energy of so many cells each way.
SURROUNDINGS = 9
# Suppression compares each box with each: only so many of the best.
_MOST_BOXES = 400


@dataclass(frozen=True)
class Level:
    """Rows `top` to `bottom` of the frame, to be resized to `rows` x `columns` pixels."""

    top: int
    bottom: int
    rows: int
    columns: int


def level_groups(frame_shape: tuple, scan: ScanParams, reach: Reach) -> list:
    """The levels of a frame, in groups of about equal size.

    Parameters
    ----------
    frame_shape : (rows, columns)
    scan : ScanParams
    reach : Reach
        Where vehicles can stand: only these rows are scanned.

    Returns
    -------
    groups : list of list of Level
        As many as `scan.n_groups`; some may be empty.

    Raises
    ------
    ValueError
        No window fits the frame.
    """
    height, width = frame_shape[:2]
    side = scan.smallest * width / scan.reference_width
    unit = scan.cells_per_step * WINDOW_CELL
    loads = [0.0] * scan.n_groups
    groups = [[] for _ in loads]
    while side <= scan.largest * width / scan.reference_width:
        # By its size in the whole frame, so that a level stays in its group as the reach changes.
        group = loads.index(min(loads))
        loads[group] += 1 / side**2
        # Whole steps, so that the last windows end where the frame ends, or a cell
        # before: vehicles enter at its edges.
        scale = side / (WINDOW_ROWS * WINDOW_CELL)
        bottom = min(height, int(reach.horizon[1] + reach.ratio[1] * side))
        top = max(0, reach.horizon[0] + (reach.ratio[0] - 1) * side)
        rows = round((bottom - top) / scale / unit) * unit
        columns = round(width / scale / unit) * unit
        if min(rows, columns) >= WINDOW_ROWS * WINDOW_CELL:
            top = max(0, round(bottom - rows * scale))
            groups[group].append(Level(top, bottom, rows, columns))
        side *= scan.ratio
    if not any(groups):
        raise ValueError(f"no window fits a frame of {width}x{height}: use a larger picture")
    return groups


def cell_features(img: np.ndarray) -> np.ndarray:
    """HOG of the luma and mean colour of every cell of an image.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.

    Returns
    -------
    features : ndarray of float32, shape (cell rows, cell columns, CELL_FEATURES)
    """
    luma = cv2.cvtColor(img, cv2.COLOR_RGB2GRAY)
    histograms = cell_histograms(luma[..., None], ORIENTATIONS, WINDOW_CELL)[0]
    rows, columns, _ = histograms.shape
    size = SURROUNDINGS, SURROUNDINGS
    around = cv2.blur(cell_lengths(histograms), size, borderType=cv2.BORDER_REFLECT)
    whole = img[: rows * WINDOW_CELL, : columns * WINDOW_CELL]
    # OpenCV halves an image several times as fast as it takes other means.
    half = cv2.resize(whole, (2 * columns, 2 * rows), interpolation=cv2.INTER_AREA)
    means = cv2.resize(half, (columns, rows), interpolation=cv2.INTER_AREA)
    colors = cv2.cvtColor(means, cv2.COLOR_RGB2YCrCb) * np.float32(1 / 255)
    return describe_cells(histograms, around, colors)


def window_scores(features: np.ndarray, template: Any, step: int) -> np.ndarray:
    """Decision function of the windows at every so many cells.

    Parameters
    ----------
    features : ndarray of float32, shape (rows, columns, CELL_FEATURES)
    template : Template
    step : int
        In cells.

    Returns
    -------
    scores : ndarray of float32, shape (window rows, window columns)
        Empty if no window fits.
    """
    sides = zip(features.shape, template.weights.shape[:2], strict=False)
    shape = tuple(max(0, (side - length) // step + 1) for side, length in sides)
    return correlate(features, template.weights, step, shape) + np.float32(template.bias)


def propose(img: np.ndarray, levels: list, templates: tuple, scan: ScanParams) -> tuple:
    """The best windows of some levels, moved onto what they show.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    levels : list of Level
    templates : tuple of Template
    scan : ScanParams

    Returns
    -------
    boxes : ndarray of float, shape (n, 4)
    scores : ndarray of float32, shape (n,)
        Best first.
    """
    if not levels:
        return np.empty((0, 4)), np.empty(0, np.float32)
    found = [_windows_of_level(img, level, templates, scan) for level in levels]
    boxes, shifts, scores = map(np.concatenate, zip(*found, strict=True))
    best = np.argsort(-scores, kind="stable")
    return move_edges(boxes[best], shifts[best]), scores[best]


def _windows_of_level(img, level, templates, scan):
    """The best windows of one level in pixels of the frame, their shifts and scores."""
    strip = img[level.top : level.bottom]
    size = level.columns, level.rows
    features = cell_features(cv2.resize(strip, size, interpolation=cv2.INTER_LINEAR))
    windows, scores, owners = best_windows(features, templates, scan)
    # Size of a cell in the frame; columns and rows were rounded each on their own.
    x, y = WINDOW_CELL * strip.shape[1] / size[0], WINDOW_CELL * strip.shape[0] / size[1]
    boxes = windows * (x, y, x, y) + (0, level.top, 0, level.top)
    shifts = np.empty((len(boxes), 4))
    for i in set(owners.tolist()):
        shifts[owners == i] = window_shifts(features, windows[owners == i, :2], templates[i])
    return boxes, shifts, scores


def best_windows(features: np.ndarray, templates: tuple, scan: Any) -> tuple:
    """The best windows of a level that do not suppress each other.

    Parameters
    ----------
    features : ndarray of float32, shape (rows, columns, CELL_FEATURES)
    templates : tuple of Template
    scan : ScanParams

    Returns
    -------
    windows : ndarray of int, shape (n, 4)
        Left, top, right, bottom in cells; at most `scan.n_proposals`, best first.
    scores : ndarray of float32, shape (n,)
    owners : ndarray of int, shape (n,)
        Index of the template of each.
    """
    step = scan.cells_per_step
    maps = [window_scores(features, template, step) for template in templates]
    flat = np.concatenate([scores.ravel() for scores in maps])
    hot = np.flatnonzero(flat > scan.threshold)
    ends = np.cumsum([scores.size for scores in maps])
    owners = np.searchsorted(ends, hot, side="right")
    first = np.array([0, *ends])[owners]
    n_columns = np.array([scores.shape[1] for scores in maps])[owners]
    sides = np.array([template.weights.shape[:2] for template in templates])[owners]
    row, column = np.divmod(hot - first, n_columns)
    top_left = step * np.stack([column, row], axis=1)
    windows = np.hstack([top_left, top_left + sides[:, ::-1]])
    best = suppress(windows, flat[hot], scan.overlap)[: scan.n_proposals]
    return windows[best], flat[hot[best]], owners[best]


def window_shifts(features: np.ndarray, corners: np.ndarray, template: Any) -> np.ndarray:
    """Where the edges of vehicles are, seen from windows: ridge regression, as of R-CNN [1]_.

    Parameters
    ----------
    features : ndarray of float32, shape (rows, columns, CELL_FEATURES)
        Outside of them, the cells at their edge go on.
    corners : ndarray of int, shape (n, 2)
        First column and row of each window, in cells.
    template : Template

    Returns
    -------
    shifts : ndarray of float32, shape (n, 4)
        Of left, top, right and bottom, in widths and heights of the window.

    References
    ----------
    .. [1] R. Girshick, J. Donahue, T. Darrell and J. Malik, "Rich feature hierarchies for
           accurate object detection and semantic segmentation", CVPR 2014, appendix C.
    """
    corners = corners.astype(np.int64) - WINDOW_CONTEXT
    return sums_at(features, corners, template.shift_weights) + template.shift_bias


def suppress(boxes: np.ndarray, scores: np.ndarray, overlap: float) -> np.ndarray:
    """Non-maximum suppression: indices of what stays, best first.

    Parameters
    ----------
    boxes : ndarray, shape (n, 4)
    scores : ndarray, shape (n,)
    overlap : float
        A box goes if its IoU with a better one is above this, or if it is not
        among the best 400.
    """
    if not len(boxes):
        return np.empty(0, int)
    # OpenCV could pick them, but takes thousands of boxes one by one.
    best = np.argsort(-scores, kind="stable")[:_MOST_BOXES]
    boxes, scores = boxes[best], scores[best]
    sizes = np.hstack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]]).astype(float).tolist()
    # OpenCV takes no threshold below zero.
    above_zero = (scores - scores[-1] + 1).astype(np.float32)
    kept = cv2.dnn.NMSBoxes(sizes, above_zero, 0.0, overlap)
    return best[np.asarray(kept, int)]
