"""The two-stage detector: windows of four shapes, then a closer look at the best.

frame -> levels -> cells -> window scores -> proposals -> refined boxes, scores

A level is the frame at one scale, described by cells of 4 x 4 pixels: HOG of
the luma and the mean colour. Linear SVMs score windows of 8 cells' height and
four widths. The best windows are cut out of the frame with a margin and
described again, twice as finely: one kernel machine moves the four edges, and
another, an SVM with an RBF kernel, says how sure it is.

Frames are RGB, uint8. Boxes are float arrays of shape (n, 4): left, top,
right, bottom in pixels of the frame.
"""

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np
from numba import njit

from pipeline_functions import convert_color
from vehicle_detection.compiled.hog import cell_histograms, correlate
from vehicle_detection.compiled.threads import side_by_side
from vehicle_detection.media.images import written_whole
from vehicle_detection.tracking.tracker import box_areas, pairwise_overlap

COLOR = "YCrCb"
ORIENTATIONS = 9
# Windows of the first stage, in cells of so many pixels: lorries are higher than
# wide, cars seen from the side twice as wide as high.
WINDOW_ROWS = 8
WINDOW_COLUMNS = (6, 8, 11, 16)
WINDOW_CELL = 4
# The closer look: a box of 8 x 8 cells, and a margin of one cell around it.
# The side of a cell is even, for chroma is halved.
PATCH_CELLS = 8
PATCH_MARGIN = 1
PATCH_CELL = 6
# HOG of the luma, mean colour.
CELL_FEATURES = ORIENTATIONS + 3
# HOG of the chroma tells where edges are, but not what is a vehicle: with it, those of
# a camera that was not learned from score low.
CHROMA_FEATURES = 2 * ORIENTATIONS
# Gradients of a window's cell are held against those of so many cells each way.
SURROUNDINGS = 9
PATCH_SIDE = PATCH_CELLS + 2 * PATCH_MARGIN
# Left, top, right, bottom: which margins are outside of the frame.
N_BORDERS = 4
_INNER = slice(PATCH_MARGIN, PATCH_MARGIN + PATCH_CELLS)
N_INNER_FEATURES = PATCH_CELLS**2 * CELL_FEATURES + N_BORDERS
N_ALL_FEATURES = PATCH_SIDE**2 * (CELL_FEATURES + CHROMA_FEATURES) + N_BORDERS

# Suppression compares each box with each: only so many of the best.
_MOST_BOXES = 400
# What scores less where it was proposed is not a vehicle nearby either.
_HOPELESS = -1.0

# Where there are no gradients at all, in roots of grey levels.
_LEAST_LENGTH = np.float32(1e-3)
# Where there is next to no light and shade, as a share of white.
_LEAST_SPREAD = np.float32(0.03)

FORMAT_VERSION = 7


@dataclass(frozen=True)
class ScanParams:
    """Where the first stage looks, and what it hands on.

    Attributes
    ----------
    smallest, largest : float
        Heights of windows, in pixels of a frame 1280 pixels wide; they follow
        the width of other frames, for that is what the field of view fills.
    ratio : float
        Of the heights of neighbouring levels.
    horizon : (float, float)
        Rows between which the road may vanish, as shares of the frame's
        height. A vehicle's roof may be above it, its wheels are below.
    cells_per_step : int
        Distance between neighbouring windows.
    n_groups : int
        A video's frame visits one of so many groups of levels, in turn.
    threshold : float
        Windows of a decision function above it may become proposals.
    n_proposals : int
        So many of the best of each level are looked at closely. Were they
        taken from all levels together, the many small windows would crowd out
        the few large ones.
    n_entering : int
        And so many more of the best that end within a cell and a half of the left or
        right border: vehicles that enter show too little to be among the best of all.
    overlap : float
        IoU above which the better of two windows is taken for both.
    """

    smallest: float = 32
    largest: float = 400
    ratio: float = 1.25
    horizon: tuple = (0.42, 0.62)
    cells_per_step: int = 2
    n_groups: int = 5
    threshold: float = -0.5
    n_proposals: int = 10
    n_entering: int = 1
    overlap: float = 0.5

    def __post_init__(self):
        if not 0 < self.smallest <= self.largest:
            raise ValueError(f"heights {self.smallest} to {self.largest} are no range")
        if self.ratio <= 1:
            raise ValueError(f"neighbouring heights need a ratio above 1, not {self.ratio}")
        if not 0 < self.horizon[0] <= self.horizon[1] < 1:
            raise ValueError(f"the horizon lies between 0 and 1, not at {self.horizon}")
        if min(self.cells_per_step, self.n_groups, self.n_proposals) < 1 or self.n_entering < 0:
            raise ValueError("cells_per_step, n_groups and n_proposals start at 1, n_entering at 0")
        if not 0 < self.overlap < 1:
            raise ValueError(f"an overlap lies between 0 and 1, not at {self.overlap}")


DEFAULT_SCAN = ScanParams()

# How far hills and the camera's nodding may take the horizon, and in what steps
# it is followed: shares of the frame's height.
_HORIZON_MARGIN, _HORIZON_STEP = 0.05, 0.02


def near_horizon(scan, horizon, camera_to_car):
    """The scan with its horizon narrowed down to where it is known to be.

    Parameters
    ----------
    scan : ScanParams
    horizon : float
        Share of the frame's height; the nearest within `scan.horizon` is taken.
    camera_to_car : float
        Height of the camera by that of a car. Vehicles reach farther below the
        horizon than they are high if it is above 1: the lower end then stays.

    Returns
    -------
    scan : ScanParams
    """
    low, high = scan.horizon
    # In steps, for levels are laid out anew wherever it moves.
    middle = np.clip(round(horizon / _HORIZON_STEP) * _HORIZON_STEP, low, high)
    if camera_to_car <= 1:
        high = min(high, middle + _HORIZON_MARGIN)
    return replace(scan, horizon=(max(low, middle - _HORIZON_MARGIN), high))


@dataclass(frozen=True)
class Template:
    """Linear SVM of the first stage.

    Attributes
    ----------
    weights : ndarray of float32, shape (rows, columns, CELL_FEATURES)
    bias : float
    """

    weights: np.ndarray
    bias: float


@dataclass(frozen=True)
class KernelMachine:
    """f(x) = sum_i weights_i exp(-gamma |P x + offset - centers_i|^2) + bias.

    Attributes
    ----------
    projection : ndarray of float32, shape (n_components, n_features)
        P; scaling and principal components in one.
    offset : ndarray of float32, shape (n_components,)
    centers : ndarray of float32, shape (n, n_components)
    weights : ndarray of float32, shape (n_outputs, n)
    bias : ndarray of float32, shape (n_outputs,)
    gamma : float
    """

    projection: np.ndarray
    offset: np.ndarray
    centers: np.ndarray
    weights: np.ndarray
    bias: np.ndarray
    gamma: float

    def predict(self, features):
        """Outputs for features of float32, shape (n, n_features), shape (n, n_outputs)."""
        components = _products(features, self.projection) + self.offset
        distances = _squares(components)[:, None] + self._squared_centers
        distances -= 2 * _products(components, self.centers)
        return _products(np.exp(np.float32(-self.gamma) * distances), self.weights) + self.bias

    @cached_property
    def _squared_centers(self):
        return _squares(self.centers)


@dataclass(frozen=True)
class Detector:
    """All that `train_detector.py` learns.

    Attributes
    ----------
    templates : tuple of Template
    scorer : KernelMachine
        From the inner cells of a patch to a decision function.
    regressor : KernelMachine
        From all cells of a patch to shifts of the four edges, in widths and
        heights of the box.
    """

    templates: tuple
    scorer: KernelMachine
    regressor: KernelMachine


# Not `@`: for so small a product BLAS wakes threads that then spin, and take
# from whatever runs beside the search.
_COMPILE = dict(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"})


@njit(**_COMPILE)
def _products(rows, others):
    """rows @ others.T

    Of four rows with two others at a time: read once, every value is used more often. At
    the end, where fewer are left, the last is taken again.
    """
    n, m = len(rows), len(others)
    products = np.empty((n, m), np.float32)
    zero = np.float32(0)
    for k in range(0, m, 2):
        last = min(k + 1, m - 1)
        p, q = others[k], others[last]
        for i in range(0, n, 4):
            j1, j2, j3 = min(i + 1, n - 1), min(i + 2, n - 1), min(i + 3, n - 1)
            a, b, c, d = rows[i], rows[j1], rows[j2], rows[j3]
            ap, bp, cp, dp, aq, bq, cq, dq = zero, zero, zero, zero, zero, zero, zero, zero
            for x in range(p.size):
                ap += a[x] * p[x]
                bp += b[x] * p[x]
                cp += c[x] * p[x]
                dp += d[x] * p[x]
                aq += a[x] * q[x]
                bq += b[x] * q[x]
                cq += c[x] * q[x]
                dq += d[x] * q[x]
            products[i, k], products[i, last] = ap, aq
            products[j1, k], products[j1, last] = bp, bq
            products[j2, k], products[j2, last] = cp, cq
            products[j3, k], products[j3, last] = dp, dq
    return products


def _squares(rows):
    """Squared length of every row, shape (n,)."""
    return np.einsum("ij,ij->i", rows, rows)


# --------------------------------------------------------------- first stage


@dataclass(frozen=True)
class Level:
    """Rows `top` to `bottom` of the frame, to be resized to `rows` x `columns` pixels."""

    top: int
    bottom: int
    rows: int
    columns: int


@lru_cache(maxsize=16)
def level_groups(frame_shape, scan):
    """The levels of a frame, in groups of about equal size.

    Parameters
    ----------
    frame_shape : (rows, columns)
    scan : ScanParams

    Returns
    -------
    groups : list of list of Level

    Raises
    ------
    ValueError
        No window fits the frame.
    """
    height, width = frame_shape[:2]
    low, high = (share * height for share in scan.horizon)
    side, levels = scan.smallest * width / 1280, []
    unit = scan.cells_per_step * WINDOW_CELL
    while side <= scan.largest * width / 1280:
        # Whole steps, so that the last windows end where the frame ends, or a cell
        # before: vehicles enter at its edges.
        scale = side / (WINDOW_ROWS * WINDOW_CELL)
        bottom = min(height, int(high + side))
        rows = round((bottom - max(0, low - 0.75 * side)) / scale / unit) * unit
        columns = round(width / scale / unit) * unit
        if min(rows, columns) >= WINDOW_ROWS * WINDOW_CELL:
            levels.append(Level(max(0, round(bottom - rows * scale)), bottom, rows, columns))
        side *= scan.ratio
    if not levels:
        raise ValueError(f"no window fits a frame of {width}x{height}: use a larger picture")
    groups = [[] for _ in range(min(scan.n_groups, len(levels)))]
    for level in levels:
        smallest = min(groups, key=lambda group: sum(one.rows * one.columns for one in group))
        smallest.append(level)
    return groups


def cell_features(img):
    """HOG of the luma and mean colour of every cell of an image.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.

    Returns
    -------
    features : ndarray of float32, shape (cell rows, cell columns, CELL_FEATURES)
    """
    img = convert_color(img, COLOR)
    histograms = cell_histograms(img[..., :1], ORIENTATIONS, WINDOW_CELL)[0]
    rows, columns, _ = histograms.shape
    lengths = cell_lengths(histograms)
    size = SURROUNDINGS, SURROUNDINGS
    around = cv2.blur(lengths, size, borderType=cv2.BORDER_REFLECT)
    features = np.empty((rows, columns, CELL_FEATURES), np.float32)
    features[:, :, :ORIENTATIONS] = normalise_cells(histograms, lengths, around)
    whole = img[: rows * WINDOW_CELL, : columns * WINDOW_CELL]
    means = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    np.multiply(means, np.float32(1 / 255), out=features[:, :, ORIENTATIONS:])
    return features


def cell_lengths(histograms):
    """Euclidean length of the histogram of every cell, shape (..., orientations) to (...)."""
    return np.sqrt(np.einsum("...o,...o->...", histograms, histograms))


def normalise_cells(histograms, lengths, around):
    """Cells by the root of the squares of their own length and of the mean length around them.

    Blocks that are brought to unit length [1]_ show what noise there is in a plain
    cell as large as the edges of a vehicle. Here it stays small.

    Parameters
    ----------
    histograms : ndarray of float32, shape (..., orientations)
        See `dense_hog.cell_histograms`.
    lengths, around : ndarray of float32, shape (...)
        See `cell_lengths`; `around` may be broadcast.

    Returns
    -------
    normalised : ndarray of float32, shape (..., orientations)
        0.7 long for a cell as long as those around it, at most 1.

    References
    ----------
    .. [1] N. Dalal and B. Triggs, "Histograms of Oriented Gradients for Human
           Detection", CVPR 2005.
    """
    scale = 1 / np.sqrt(lengths**2 + around**2 + _LEAST_LENGTH**2)
    return histograms * scale[..., None]


def window_scores(features, template, step):
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
    shape = [max(0, (side - length) // step + 1) for side, length in sides]
    return correlate(features, template.weights, step, shape) + np.float32(template.bias)


def propose(img, levels, templates, scan):
    """The best windows of some levels.

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
    found = side_by_side(lambda level: _propose_on_level(img, level, templates, scan), levels)
    boxes, scores = map(np.concatenate, zip(*found, strict=True))
    best = suppress(boxes, scores, scan.overlap)
    return boxes[best], scores[best]


def _propose_on_level(img, level, templates, scan):
    """The best windows of one level, as `propose`."""
    boxes, scores = [], []
    strip = img[level.top : level.bottom]
    size = level.columns, level.rows
    features = cell_features(cv2.resize(strip, size, interpolation=cv2.INTER_LINEAR))
    # Size of a cell in the frame; columns and rows were rounded each on their own.
    x, y = WINDOW_CELL * strip.shape[1] / size[0], WINDOW_CELL * strip.shape[0] / size[1]
    for template in templates:
        rows, columns, _ = template.weights.shape
        level_scores = window_scores(features, template, scan.cells_per_step)
        hot = np.nonzero(level_scores > scan.threshold)
        scores.append(level_scores[hot])
        row, column = np.multiply(hot, scan.cells_per_step)
        corners = np.stack([column, row, column + columns, row + rows], axis=1)
        boxes.append(corners * (x, y, x, y) + (0, level.top, 0, level.top))
    boxes, scores = np.concatenate(boxes), np.concatenate(scores)
    best = suppress(boxes, scores, scan.overlap)
    first, others = np.split(best, [scan.n_proposals])
    at_side = (boxes[:, 0] < 1.5 * x) | (boxes[:, 2] > strip.shape[1] - 1.5 * x)
    best = np.concatenate([first, others[at_side[others]][: scan.n_entering]])
    return boxes[best], scores[best]


def suppress(boxes, scores, overlap):
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
    sizes = np.hstack([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]]).astype(float)
    # OpenCV takes no threshold below zero.
    above_zero = (scores - scores.min() + 1).astype(np.float32)
    best = cv2.dnn.NMSBoxes(sizes, above_zero, 0.0, overlap, top_k=_MOST_BOXES)
    return np.asarray(best, int)


# -------------------------------------------------------------- second stage


def cut_out(img, box, size):
    """A box of the frame, resized; outside of the frame its edge goes on.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
    box : sequence of int
        Left, top, right, bottom.
    size : (columns, rows)

    Returns
    -------
    cut : ndarray of uint8, shape (*size[::-1], 3)
    """
    left, top, right, bottom = box
    rows, above, below = _overlap(top, bottom, img.shape[0])
    columns, before, behind = _overlap(left, right, img.shape[1])
    inside = img[rows, columns]
    if above or below or before or behind:
        inside = cv2.copyMakeBorder(inside, above, below, before, behind, cv2.BORDER_REPLICATE)
    return cv2.resize(inside, size, interpolation=cv2.INTER_LINEAR)


def _overlap(start, stop, length):
    """What of start..stop lies within 0..length, at least one; how many before and behind."""
    first = min(max(start, 0), length - 1)
    last = max(min(stop, length), first + 1)
    before = min(max(-start, 0), stop - start - 1)
    return slice(first, last), before, stop - start - before - (last - first)


def on_whole_pixels(boxes):
    """Boxes moved by less than a pixel, so that with their margins they end between pixels.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)

    Returns
    -------
    boxes : ndarray of float, shape (n, 4)
    """
    return _without_margins(_with_margins(boxes))


def _with_margins(boxes):
    """Boxes with their margins, shape (n, 4), int."""
    aside = PATCH_MARGIN / PATCH_CELLS * (boxes[:, 2:] - boxes[:, :2])
    low = np.rint(boxes[:, :2] - aside)
    high = np.maximum(np.rint(boxes[:, 2:] + aside), low + 1)
    return np.hstack([low, high]).astype(int)


def _without_margins(boxes):
    aside = PATCH_MARGIN / PATCH_SIDE * (boxes[:, 2:] - boxes[:, :2])
    return np.hstack([boxes[:, :2] + aside, boxes[:, 2:] - aside])


def cut_patches(img, boxes):
    """Every box and its margin, in one size.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of float, shape (n, 4)

    Returns
    -------
    patches : ndarray of uint8, shape (n, PATCH_SIDE * PATCH_CELL, PATCH_SIDE * PATCH_CELL, 3)
        RGB.
    """
    size = PATCH_SIDE * PATCH_CELL, PATCH_SIDE * PATCH_CELL
    patches = np.empty((len(boxes), *size, 3), np.uint8)
    for patch, box in zip(patches, _with_margins(boxes).tolist(), strict=True):
        patch[:] = cut_out(img, box, size)
    return patches


def luma_and_chroma(patches):
    """Every patch in `COLOR`, channel by channel.

    Parameters
    ----------
    patches : ndarray of uint8, shape (n, rows, columns, 3)
        RGB.

    Returns
    -------
    planes : ndarray of uint8, shape (3, n, rows, columns)
        Luma and two of chroma.
    """
    n, rows, columns, _ = patches.shape
    planes = np.empty((3, n, rows, columns), np.uint8)
    if n:
        # One below the other, they are one image.
        whole = convert_color(patches.reshape(n * rows, columns, 3), COLOR)
        cv2.split(whole, list(planes.reshape(3, n * rows, columns)))
    return planes


def patch_features(planes):
    """HOG of the luma and relative colours of the cells of every patch.

    Of HOG the square roots are taken, as of SIFT [1]_: otherwise the distance of two
    patches would be that of their strongest edges, and the faint ones would not count.

    Parameters
    ----------
    planes : ndarray of uint8, shape (3, n, rows, columns)
        Of patches, see `luma_and_chroma`.

    Returns
    -------
    features : ndarray of float32, shape (n, PATCH_SIDE, PATCH_SIDE, CELL_FEATURES)
    contrast : ndarray of float32, shape (n,)
        Mean of `cell_lengths` of the luma.

    References
    ----------
    .. [1] R. Arandjelovic and A. Zisserman, "Three things everyone should know to
           improve object retrieval", CVPR 2012.
    """
    features = np.empty((planes.shape[1], PATCH_SIDE, PATCH_SIDE, CELL_FEATURES), np.float32)
    histograms = _patch_histograms(planes[:1])[0]
    lengths = cell_lengths(histograms)
    contrast = lengths.mean(axis=(1, 2))
    around = contrast[:, None, None]
    features[..., :ORIENTATIONS] = np.sqrt(normalise_cells(histograms, lengths, around))
    features[..., ORIENTATIONS:] = relative_colors(planes)
    return features, contrast


def chroma_features(planes, contrast):
    """Square roots of HOG of the chroma of the cells of every patch, at half its size.

    Videos hold no more of the chroma than that.

    Parameters
    ----------
    planes : ndarray of uint8, shape (3, n, rows, columns)
        Of patches, see `luma_and_chroma`.
    contrast : ndarray of float32, shape (n,)
        Of the luma, see `patch_features`: faint as chroma is by itself, it is noise.

    Returns
    -------
    features : ndarray of float32, shape (n, PATCH_SIDE, PATCH_SIDE, CHROMA_FEATURES)
    """
    histograms = _patch_histograms(_halved(planes[1:]))
    around = contrast[:, None, None]
    channels = [normalise_cells(own, cell_lengths(own), around) for own in histograms]
    return np.sqrt(np.concatenate(channels, axis=-1))


def _halved(planes):
    """Planes at half their size, shape (channels, n, rows / 2, columns / 2)."""
    n_channels, n, rows, columns = planes.shape
    halved = np.empty((n_channels, n, rows // 2, columns // 2), np.uint8)
    if n:
        # One below the other, they are one image.
        whole, size = planes.reshape(-1, columns), (columns // 2, n_channels * n * rows // 2)
        cv2.resize(whole, size, halved.reshape(-1, columns // 2), interpolation=cv2.INTER_AREA)
    return halved


def _patch_histograms(planes):
    """`dense_hog.cell_histograms` of planes, shape (channels, n, side, side, orientations)."""
    n_channels, n, rows, columns = planes.shape
    shape = n_channels, n, PATCH_SIDE, PATCH_SIDE, ORIENTATIONS
    if not n:
        return np.empty(shape, np.float32)
    # All patches are the channels of one image, for a pass of HOG has its price.
    channels = planes.reshape(-1, rows, columns).transpose(1, 2, 0)
    return cell_histograms(channels, ORIENTATIONS, rows // PATCH_SIDE).reshape(shape)


def relative_colors(planes):
    """Mean colours of cells, less that of the box; the luma by its spread over the box.

    How bright a camera shows a vehicle, in what colour of light and behind what haze,
    says nothing of what it is.

    Parameters
    ----------
    planes : ndarray of uint8, shape (3, n, rows, columns)
        Of patches, see `luma_and_chroma`.

    Returns
    -------
    colors : ndarray of float32, shape (n, PATCH_SIDE, PATCH_SIDE, 3)
        The luma in standard deviations of the cells of the box, the chroma as shares
        of 255.
    """
    _, n, rows, columns = planes.shape
    if not n:
        return np.empty((0, PATCH_SIDE, PATCH_SIDE, 3), np.float32)
    below_each_other = planes.reshape(3 * n * rows, columns)
    size = PATCH_SIDE, 3 * n * PATCH_SIDE
    means = cv2.resize(below_each_other, size, interpolation=cv2.INTER_AREA)
    means = means.reshape(3, n, PATCH_SIDE, PATCH_SIDE) * np.float32(1 / 255)
    inner = means[:, :, _INNER, _INNER]
    means -= inner.mean(axis=(2, 3), keepdims=True)
    variance = (inner[0] ** 2).mean(axis=(1, 2), keepdims=True)
    means[0] /= np.sqrt(variance + _LEAST_SPREAD**2)
    return means.transpose(1, 2, 3, 0)


def margins_outside(boxes, frame_shape):
    """How much of the margin on each side of a box lies outside of the frame.

    Half a car that ends where the frame ends is a vehicle that enters; half a
    car anywhere else is a part of one.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    frame_shape : (rows, columns, ...)

    Returns
    -------
    shares : ndarray of float32, shape (n, N_BORDERS)
        Left, top, right, bottom; from 0 to 1.
    """
    rows, columns = frame_shape[:2]
    margin = PATCH_MARGIN / PATCH_CELLS * (boxes[:, 2:] - boxes[:, :2])
    to_border = np.hstack([boxes[:, :2], (columns, rows) - boxes[:, 2:]])
    within = to_border / np.maximum(np.hstack([margin, margin]), 1e-9)
    return np.clip(1 - within, 0, 1).astype(np.float32)


def inner_cells(features, outside):
    """What tells vehicles: boxes without margins, and `margins_outside`.

    Shape (n, N_INNER_FEATURES).
    """
    cells = features[:, _INNER, _INNER].reshape(-1, N_INNER_FEATURES - N_BORDERS)
    return np.hstack([cells, outside])


def all_cells(features, chroma, outside):
    """What tells edges: boxes with their margins, HOG of the chroma too, and `margins_outside`.

    Shape (n, N_ALL_FEATURES).
    """
    cells = np.concatenate([features, chroma], axis=-1)
    return np.hstack([cells.reshape(-1, N_ALL_FEATURES - N_BORDERS), outside])


def move_edges(boxes, shifts):
    """Boxes with each edge moved by a share of the box's width or height."""
    size = boxes[:, 2:] - boxes[:, :2]
    return boxes + shifts * np.hstack([size, size])


def look_closer(img, boxes, detector):
    """Move the edges of boxes to where they belong, and score them there.

    What is hopeless where it was proposed stays there, with its score. In one thread:
    of its many short calls each would wait for those of the other.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of float, shape (n, 4)
    detector : Detector

    Returns
    -------
    boxes : ndarray of float, shape (n, 4)
    scores : ndarray of float32, shape (n,)
        Decision function, positive for vehicles.
    """
    boxes = on_whole_pixels(boxes)
    outside = margins_outside(boxes, img.shape)
    planes = luma_and_chroma(cut_patches(img, boxes))
    features, contrast = patch_features(planes)
    scores = detector.scorer.predict(inner_cells(features, outside))[:, 0]
    near = scores > _HOPELESS
    chroma = chroma_features(planes[:, near], contrast[near])
    shifts = detector.regressor.predict(all_cells(features[near], chroma, outside[near]))
    moved = on_whole_pixels(move_edges(boxes[near], shifts))
    boxes[near] = moved
    features, _ = patch_features(luma_and_chroma(cut_patches(img, moved)))
    outside = margins_outside(moved, img.shape)
    scores[near] = detector.scorer.predict(inner_cells(features, outside))[:, 0]
    return boxes, scores


def are_rivals(boxes, others, overlap=0.45, covered=0.7, lower=0.1):
    """Which boxes cannot frame two vehicles that are both seen.

    Parameters
    ----------
    boxes, others : ndarray of float, shapes (n, 4) and (m, 4)
    overlap, covered, lower : float
        Two boxes are rivals if their IoU is above the first, or if the smaller of
        them is covered by more than the second; but not if it ends below the larger
        by more of its height than the third: it then stands nearer, in front.

    Returns
    -------
    rivals : ndarray of bool, shape (n, m)
    """
    areas, other_areas = box_areas(boxes)[:, None], box_areas(others)[None]
    common = pairwise_overlap(boxes, others)
    below = boxes[:, 3, None] - others[None, :, 3]
    is_smaller = areas < other_areas
    height = np.where(is_smaller, _heights(boxes)[:, None], _heights(others)[None])
    in_front = np.where(is_smaller, below, -below) > lower * height
    within = (common > covered * np.minimum(areas, other_areas)) & ~in_front
    return within | (common > overlap * (areas + other_areas - common))


def _heights(boxes):
    return boxes[:, 3] - boxes[:, 1]


def keep_wholes(boxes, scores):
    """Of boxes that are rivals, keep the better ones.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    scores : ndarray, shape (n,)

    Returns
    -------
    kept : ndarray of int
        Indices, best first.
    """
    rivals = are_rivals(boxes, boxes)
    beaten, kept = np.zeros(len(boxes), bool), []
    for i in np.argsort(-scores):
        if not beaten[i]:
            kept.append(i)
            beaten |= rivals[i]
    return np.array(kept, int)


def are_plausible(boxes, frame_shape, scan):
    """Which boxes could frame a vehicle that the first stage could have found.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    frame_shape : (rows, columns, ...)
    scan : ScanParams

    Returns
    -------
    plausible : ndarray of bool, shape (n,)
        Mostly in the frame, not much lower or higher than its windows, and
        between half and three and a half times as wide as high.
    """
    rows, columns = frame_shape[:2]
    width, height = (boxes[:, 2:] - boxes[:, :2]).T
    inside = np.clip(boxes, 0, (columns, rows, columns, rows))
    share = box_areas(inside) / np.maximum(width * height, 1e-9)
    unit = columns / 1280
    low, high = scan.smallest * unit / 1.5, scan.largest * unit * 1.25
    shaped = (0.5 * height < width) & (width < 3.5 * height)
    return (share > 0.6) & shaped & (low < height) & (height < high)


# ---------------------------------------------------------------------- file


def save_detector(detector, path):
    """Write a detector as a NumPy archive; it appears under its name only when whole."""
    arrays = {"format_version": FORMAT_VERSION}
    for i, template in enumerate(detector.templates):
        arrays |= {f"template{i}_{name}": value for name, value in vars(template).items()}
    for name in ("scorer", "regressor"):
        machine = getattr(detector, name)
        own = {field.name: getattr(machine, field.name) for field in fields(machine)}
        arrays |= {f"{name}_{key}": _half(value) for key, value in own.items()}
    with written_whole(path) as partial, open(partial, "wb") as file:
        np.savez_compressed(file, **arrays)


def _half(value):
    """Large arrays at half their precision, which no score shows in its second digit."""
    return value.astype(np.float16) if np.size(value) > 10_000 else value


def load_detector(path):
    """Read what `save_detector` wrote.

    Raises
    ------
    FileNotFoundError, ValueError
        There is no such file; it is not of this format.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such parameter file: run train_detector.py to make it")
    # What is no such archive can fail in any way whatever.
    try:
        with np.load(path) as arrays:
            if arrays["format_version"] != FORMAT_VERSION:
                raise ValueError(f"format {arrays['format_version']}, not {FORMAT_VERSION}")
            templates = tuple(
                Template(arrays[f"template{i}_weights"], float(arrays[f"template{i}_bias"]))
                for i in range(len(WINDOW_COLUMNS))
            )
            scorer = _read_machine(arrays, "scorer", N_INNER_FEATURES, 1)
            regressor = _read_machine(arrays, "regressor", N_ALL_FEATURES, 4)
        for template, columns in zip(templates, WINDOW_COLUMNS, strict=True):
            _require_shape(template.weights, (WINDOW_ROWS, columns, CELL_FEATURES))
    except Exception as error:
        raise ValueError(f"{path}: not a parameter file of train_detector.py: {error}") from error
    return Detector(templates, scorer, regressor)


def _require_shape(array, shape):
    # Compiled code looks at no bounds.
    if array.shape != shape:
        raise ValueError(f"an array of {array.shape} instead of {shape}")


def _read_machine(arrays, name, n_features, n_outputs):
    fields = ("projection", "offset", "centers", "weights", "bias")
    values = [arrays[f"{name}_{field}"].astype(np.float32) for field in fields]
    n_components, n_centers = len(values[1]), len(values[2])
    shapes = (
        (n_components, n_features), (n_components,), (n_centers, n_components),
        (n_outputs, n_centers), (n_outputs,),
    )  # fmt: skip
    for array, shape in zip(values, shapes, strict=True):
        _require_shape(array, shape)
    return KernelMachine(*values, gamma=float(arrays[f"{name}_gamma"]))
