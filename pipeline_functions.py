"""The detector as plain functions, in the order in which a frame meets them.

colour -> features -> windows -> search -> heat -> labels -> drawing

Every image is RGB, uint8, shape (rows, columns, 3). Every box is
(left, top, right, bottom) in whole pixels, right and bottom excluded, and
boxes travel as int arrays of shape (n, 4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from scipy.ndimage import find_objects, label, maximum

from vehicle_detection.compiled import dense_windows
from vehicle_detection.compiled.hog import hog_blocks
from vehicle_detection.compiled.threads import side_by_side
from vehicle_detection.media.drawing import draw_boxes
from vehicle_detection.parameters import SEARCH_PRESETS, SearchParams, require_color

if TYPE_CHECKING:
    from vehicle_detection.parameters import FeatureParams

_CONVERSIONS = {
    "YCrCb": cv2.COLOR_RGB2YCrCb,
    "HSV": cv2.COLOR_RGB2HSV,
    "HLS": cv2.COLOR_RGB2HLS,
    "LUV": cv2.COLOR_RGB2LUV,
    "YUV": cv2.COLOR_RGB2YUV,
    "Lab": cv2.COLOR_RGB2Lab,
    "gray": cv2.COLOR_RGB2GRAY,
}

# -------------------------------------------------------------------- colour


def convert_color(img: np.ndarray, conv: str) -> np.ndarray:
    """Convert an RGB image to another colour space.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    conv : {"RGB", "YCrCb", "HSV", "HLS", "LUV", "YUV", "Lab", "gray"}

    Returns
    -------
    converted : ndarray of uint8, shape (rows, columns, 3), or (rows, columns)
        for "gray". OpenCV's 8-bit scaling: hue is 0..179, the rest 0..255.

    Raises
    ------
    ValueError
        The colour space is unknown, or `img` is not RGB of uint8.
    """
    require_color(conv)
    if img.ndim != 3 or img.shape[2] != 3 or img.dtype != np.uint8:
        raise ValueError(f"not an RGB uint8 image: {img.dtype} of shape {img.shape}")
    return img.copy() if conv == "RGB" else cv2.cvtColor(img, _CONVERSIONS[conv])


# ------------------------------------------------------------------ features

# One under another: one by one they take some four times as long.
_IMAGES_PER_STRIP = 50


def bin_spatial(img: np.ndarray, size: int) -> np.ndarray:
    """The image shrunk to `size` x `size` pixels, as one vector.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns) or (rows, columns, channels)
    size : int

    Returns
    -------
    features : ndarray of uint8, shape (size * size * channels,)
        Row by row, channels together.
    """
    return cv2.resize(img, (size, size), interpolation=cv2.INTER_LINEAR).ravel()


def color_hist(img: np.ndarray, nbins: int = 32, bins_range: tuple = (0, 256)) -> np.ndarray:
    """Histograms of the channels, one after the other.

    The range is fixed, so that a bin means the same in every image.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns) or (rows, columns, channels)
    nbins : int
    bins_range : (low, high)

    Returns
    -------
    features : ndarray of int64, shape (nbins * channels,)
        Pixel counts.
    """
    channels = np.atleast_3d(img)
    return np.concatenate(
        [
            np.histogram(channels[..., c], bins=nbins, range=bins_range)[0]
            for c in range(channels.shape[2])
        ]
    )


def get_hog_features(
    img: np.ndarray,
    orient: int,
    pix_per_cell: int,
    cell_per_block: int,
    vis: bool = False,
    feature_vec: bool = True,
) -> tuple:
    """HOG of one channel, square-root transform, L2-Hys.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns)
    orient, pix_per_cell, cell_per_block : int
    vis : bool
        Also return a picture of the orientations.
    feature_vec : bool
        Return one vector instead of the array of blocks.

    Returns
    -------
    features : ndarray of float32, shape (block rows, block columns,
               cell_per_block, cell_per_block, orient) or flattened
    picture : ndarray of float64, shape (rows, columns)
        With `vis` only; drawn by `skimage.feature.hog`.
    """
    features = hog_blocks(img[..., None], orient, pix_per_cell, cell_per_block)[0]
    if feature_vec:
        features = features.ravel()
    if not vis:
        return features
    # Imported here because only pictures need it, and it takes a second.
    from skimage.feature import hog

    _, picture = hog(
        img,
        orientations=orient,
        pixels_per_cell=(pix_per_cell, pix_per_cell),
        cells_per_block=(cell_per_block, cell_per_block),
        transform_sqrt=True,
        block_norm="L2-Hys",
        visualize=True,
    )
    return features, picture


def extract_features(images: np.ndarray, params: FeatureParams) -> np.ndarray:
    """Feature vectors of images of the size of a window.

    Parameters
    ----------
    images : ndarray of uint8, shape (n, window_size, window_size, 3)
        RGB.
    params : FeatureParams

    Returns
    -------
    features : ndarray of float32, shape (n, params.n_features)
        `bin_spatial`, `color_hist` and `get_hog_features` of each channel in
        turn, of the groups that are on.

    Raises
    ------
    ValueError
        The images are of another size, or not uint8.
    """
    if images.shape[1:] != (params.window_size, params.window_size, 3):
        raise ValueError(
            f"images of shape {images.shape[1:]}: a window has "
            f"{params.window_size}x{params.window_size} pixels in RGB"
        )
    features = np.empty((len(images), params.n_features), np.float32)

    def fill(first):
        """Describe the images of the strip that begins here."""
        part = slice(first, first + _IMAGES_PER_STRIP)
        features[part] = _strip_features(images[part], params)

    side_by_side(fill, range(0, len(images), _IMAGES_PER_STRIP))
    return features


def dense_features(img: np.ndarray, params: FeatureParams, cells_per_step: int) -> np.ndarray:
    """Feature vectors of all windows of an image.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB, at least a window high and wide.
    params : FeatureParams
    cells_per_step : int

    Returns
    -------
    features : ndarray of float32, shape (window rows, window columns, n_features)
        In the order of `extract_features`. HOG blocks are those of the whole image: a
        window's outermost gradients see the pixels beyond it.
    """
    return dense_windows.dense_features(_planes(img, params), params, cells_per_step)


def dense_scores(
    img: np.ndarray, params: Any, cells_per_step: int, weights: np.ndarray, bias: float
) -> np.ndarray:
    """Products of the feature vectors of all windows with weights, plus a bias.

    What windows share is not copied for each: a sixth of the time of `dense_features`.

    Parameters
    ----------
    img, params, cells_per_step
        See `dense_features`.
    weights : ndarray of float32, shape (params.n_features,)
    bias : float

    Returns
    -------
    scores : ndarray of float32, shape (window rows, window columns)
    """
    return dense_windows.dense_scores(_planes(img, params), params, cells_per_step, weights, bias)


def _planes(img, params):
    """The image in every colour space that its features need."""
    return {color: convert_color(img, color) for color in params.colors}


def _strip_features(images, params):
    """`extract_features`, with the images one under another as a single one."""
    # The rows next to an image mirror it, so that no gradient crosses its
    # border, as there is none at the border of an image by itself. Between two
    # images these are two rows, and as many empty ones as fill whole cells.
    cells_between = ceil(2 / params.pix_per_cell)
    rows_between = cells_between * params.pix_per_cell
    strip = np.pad(images, ((0, 0), (1, 1), (0, 0), (0, 0)), mode="reflect")
    strip = np.pad(strip, ((0, 0), (0, rows_between - 2), (0, 0), (0, 0)))
    # The row above the first image would shift all cells by one.
    strip = strip.reshape(-1, *images.shape[2:])[1:]
    cells_per_step = params.window_size // params.pix_per_cell + cells_between
    return dense_features(strip, params, cells_per_step)[:, 0]


# ------------------------------------------------------------------- windows


@dataclass(frozen=True)
class _Band:
    """One band on one frame: `rows` x `columns` pixels from `top` down, to be resized."""

    scale: float
    top: int
    rows: int
    columns: int
    resized_rows: int
    resized_columns: int


def _bands_on_frame(frame_shape, params, search):
    """The bands that hold a window, in the pixels of this frame."""
    height, width = frame_shape[:2]
    reference_width, reference_height = search.reference_size
    for reference_scale, reference_top, reference_bottom in search.bands:
        scale = reference_scale * width / reference_width
        top = round(reference_top * height / reference_height)
        bottom = round(reference_bottom * height / reference_height)
        resized_rows, resized_columns = int((bottom - top) / scale), int(width / scale)
        if min(resized_rows, resized_columns) >= params.window_size:
            # Cropped to whole pixels of the resized band, else every window
            # would drift by a share of the rest.
            rows, columns = round(resized_rows * scale), round(resized_columns * scale)
            yield _Band(scale, top, rows, columns, resized_rows, resized_columns)


@lru_cache(maxsize=16)
def _window_grids(frame_shape, params, search):
    """Every band that holds a window, with its windows, shape (rows, columns, 4)."""
    step = search.cells_per_step * params.pix_per_cell
    grids = []
    for band in _bands_on_frame(frame_shape, params, search):
        shape = (band.resized_rows, band.resized_columns)
        rows, columns = dense_windows.window_counts(shape, params.window_size, step)
        top, left = np.mgrid[:rows, :columns] * step
        corners = np.stack([left, top, left + params.window_size, top + params.window_size], axis=2)
        windows = np.rint(corners * band.scale).astype(int) + (0, band.top, 0, band.top)
        grids.append((band, windows))
    if not grids:
        raise ValueError(
            f"no window fits a frame of {frame_shape[1]}x{frame_shape[0]}: "
            "use a larger picture or other bands"
        )
    return grids


def slide_window(frame_shape: tuple, params: FeatureParams, search: SearchParams) -> np.ndarray:
    """All windows of a search, band by band, row by row.

    Parameters
    ----------
    frame_shape : (rows, columns, ...)
    params : FeatureParams
    search : SearchParams

    Returns
    -------
    windows : ndarray of int, shape (n, 4)
        (left, top, right, bottom) in pixels of the frame.

    Raises
    ------
    ValueError
        No band of the search holds a window on a frame of this size.
    """
    grids = _window_grids(tuple(frame_shape[:2]), params, search)
    return np.concatenate([windows.reshape(-1, 4) for _, windows in grids])


def may_hold_vehicle(windows: np.ndarray, frame_shape: tuple, search: SearchParams) -> np.ndarray:
    """Which windows could frame a vehicle that stands on the road.

    On a flat road the width of a vehicle in pixels is W / h times the
    distance of its wheels from the horizon, W being its width and h the
    height of the camera, both in metres: 1 to 2.3 for what drives, and more
    on either side for windows that do not fit exactly. To the side, windows
    may lie as far off as seven times their own size plus a sixth of the frame
    for bends: about three lanes and a half.

    Parameters
    ----------
    windows : ndarray of int, shape (..., 4)
    frame_shape : (rows, columns, ...)
    search : SearchParams
        Its `horizon` is not None.

    Returns
    -------
    possible : ndarray of bool, shape (...)
    """
    height, width = frame_shape[:2]
    left, top, right, bottom = np.moveaxis(windows, -1, 0)
    size = right - left
    below = bottom - search.horizon * height / search.reference_size[1]
    aside = np.abs(left + right - width) / 2
    return (0.6 * below < size) & (size < 3.5 * below) & (aside < 7 * size + width / 6)


def are_near(windows: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Which windows have their middle in one of the boxes, made twice as large.

    Parameters
    ----------
    windows : ndarray of int, shape (..., 4)
    boxes : ndarray of int, shape (n, 4)

    Returns
    -------
    near : ndarray of bool, shape (...)
    """
    near = np.zeros(windows.shape[:-1], bool)
    x, y = (windows[..., :2] + windows[..., 2:]).T / 2
    for left, top, right, bottom in boxes:
        half_width, half_height = right - left, bottom - top
        inside_x = np.abs(x - (left + right) / 2) <= half_width
        near |= (inside_x & (np.abs(y - (top + bottom) / 2) <= half_height)).T
    return near


# -------------------------------------------------------------------- search


def find_cars(
    frame: np.ndarray, classifier: Any, search: SearchParams, boxes: np.ndarray | None = None
) -> tuple:
    """Score the windows of a frame.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    classifier : object
        With `params`, its FeatureParams, and `decision_function`, which takes features of
        shape (n, params.n_features) and returns n scores. If it has `linear`, weights and
        bias of a linear decision function, scores take a tenth of the time.
    search : SearchParams
    boxes : ndarray of int, shape (n, 4), optional
        Visit only windows near these boxes.

    Returns
    -------
    windows : ndarray of int, shape (n, 4)
        Those of `slide_window` that were visited, in its order.
    scores : ndarray of float, shape (n,)
        Decision function; above `search.threshold` a window is hot.
    """
    grids = _window_grids(frame.shape[:2], classifier.params, search)
    results = side_by_side(lambda grid: _score_band(frame, grid, classifier, search, boxes), grids)
    windows, scores = zip(*results, strict=True)
    return np.concatenate(windows), np.concatenate(scores)


def _score_band(frame, grid, classifier, search, boxes):
    """Windows of one band that are to be visited, and their scores."""
    band, windows = grid
    visited = np.ones(windows.shape[:2], bool)
    if search.x_limits is not None:
        left, right = np.array(search.x_limits) * frame.shape[1] / search.reference_size[0]
        visited &= (windows[..., 0] >= left) & (windows[..., 2] <= right)
    if search.horizon is not None:
        visited &= may_hold_vehicle(windows, frame.shape, search)
    if boxes is not None:
        visited &= are_near(windows, boxes)
    scores = np.zeros(windows.shape[:2])
    if visited.any():
        resized = _resize_band(frame, band)
        for region in _rectangles(visited):
            scores[region] = _score_region(resized, region, classifier, search)
    return windows[visited], scores[visited]


def _rectangles(visited):
    """Slices of rows and columns that together hold all True cells."""
    if visited.all():
        return [tuple(slice(0, side) for side in visited.shape)]
    regions, _ = label(visited, structure=np.ones((3, 3)))
    return find_objects(regions)


def _resize_band(frame, band):
    strip = frame[band.top : band.top + band.rows, : band.columns]
    return cv2.resize(
        strip, (band.resized_columns, band.resized_rows), interpolation=cv2.INTER_LINEAR
    )


def _score_region(resized, region, classifier, search):
    """Scores of a rectangle of a band's windows, shape (window rows, window columns).

    Gradients at the edge of a cut-out differ from those of the whole band, so
    one window more is cut out on each side where there is one.
    """
    params = classifier.params
    step = search.cells_per_step * params.pix_per_cell
    cut, inner = [], []
    for windows, length in zip(region, resized.shape, strict=False):
        before = min(1, windows.start)
        first = (windows.start - before) * step
        cut.append(slice(first, min(length, windows.stop * step + params.window_size)))
        inner.append(slice(before, before + windows.stop - windows.start))
    img, inner = resized[tuple(cut)], tuple(inner)
    linear = getattr(classifier, "linear", None)
    if linear is not None:
        return dense_scores(img, params, search.cells_per_step, *linear)[inner]
    features = dense_features(img, params, search.cells_per_step)[inner]
    scores = classifier.decision_function(features.reshape(-1, params.n_features))
    return scores.reshape(features.shape[:2])


# ---------------------------------------------------------------------- heat


@dataclass(frozen=True)
class HeatGrid:
    """The coarse grid that all window edges lie on.

    Heat changes only at the edges of windows, so one cell between
    neighbouring edges stands for all of its pixels: sums, thresholds and
    labels come out the same as at full resolution, on far fewer cells.

    Attributes
    ----------
    x_edges, y_edges : ndarray of int, shapes (columns + 1,), (rows + 1,)
        Increasing, in pixels of the frame.
    """

    x_edges: np.ndarray
    y_edges: np.ndarray

    @classmethod
    def of_windows(cls, windows: np.ndarray) -> HeatGrid:
        """Grid of the edges of `windows`, int array of shape (n, 4)."""
        return cls(np.unique(windows[:, [0, 2]]), np.unique(windows[:, [1, 3]]))

    def zeros(self) -> np.ndarray:
        """Empty heatmap of this grid, float64."""
        return np.zeros((len(self.y_edges) - 1, len(self.x_edges) - 1))

    def to_cells(self, boxes: np.ndarray) -> np.ndarray:
        """Boxes in pixels, all on the grid's edges, to boxes in cells."""
        boxes = np.asarray(boxes).reshape(-1, 4)
        x = np.searchsorted(self.x_edges, boxes[:, [0, 2]])
        y = np.searchsorted(self.y_edges, boxes[:, [1, 3]])
        return np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1)

    def to_pixels(self, boxes: np.ndarray) -> np.ndarray:
        """Boxes in cells to boxes in pixels."""
        left, top, right, bottom = np.asarray(boxes, int).reshape(-1, 4).T
        return np.stack(
            [self.x_edges[left], self.y_edges[top], self.x_edges[right], self.y_edges[bottom]],
            axis=1,
        )

    def expand(self, heatmap: np.ndarray, frame_shape: tuple) -> np.ndarray:
        """Heatmap of cells to one of pixels, zero where no window lies."""
        full = np.zeros(frame_shape[:2], heatmap.dtype)
        rows, columns = np.diff(self.y_edges), np.diff(self.x_edges)
        full[self.y_edges[0] : self.y_edges[-1], self.x_edges[0] : self.x_edges[-1]] = (
            heatmap.repeat(rows, axis=0).repeat(columns, axis=1)
        )
        return full


def add_heat(heatmap: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """One more for every cell of the map that a box covers, box by box.

    Parameters
    ----------
    heatmap : ndarray, shape (rows, columns)
        Left as it is.
    boxes : ndarray of int, shape (n, 4)
        In cells of the map.

    Returns
    -------
    heatmap : ndarray, shape (rows, columns)
    """
    heatmap = heatmap.copy()
    for left, top, right, bottom in boxes:
        heatmap[top:bottom, left:right] += 1
    return heatmap


def apply_threshold(heatmap: np.ndarray, threshold: float) -> np.ndarray:
    """The map with everything up to and including `threshold` set to zero."""
    return np.where(heatmap > threshold, heatmap, 0)


def keep_lasting_heat(heatmaps: np.ndarray, n_occ_thr: int) -> np.ndarray:
    """Sum heatmaps over time, without what did not last.

    G's filter: heat that touches in space or from one frame to the next is
    one object; an object seen in fewer than `n_occ_thr` frames is dropped.

    Parameters
    ----------
    heatmaps : ndarray, shape (frames, rows, columns)
    n_occ_thr : int

    Returns
    -------
    heatmap : ndarray, shape (rows, columns)
    """
    labels, _ = label(heatmaps)
    # What is one object is seen in every frame between its first and its last.
    durations = [frames.stop - frames.start for frames, _, _ in find_objects(labels)]
    lasting = np.array([0, *durations]) >= n_occ_thr
    return np.where(lasting[labels], heatmaps, 0).sum(axis=0)


# -------------------------------------------------------------------- labels


def labeled_boxes(labels: np.ndarray) -> np.ndarray:
    """Bounding box of every label, in order.

    Parameters
    ----------
    labels : ndarray of int, shape (rows, columns)
        As `scipy.ndimage.label` returns them: 1, 2, ... and 0 for none.

    Returns
    -------
    boxes : ndarray of int, shape (n, 4)
    """
    slices = find_objects(labels)
    boxes = [(x.start, y.start, x.stop, y.stop) for y, x in slices]
    return np.array(boxes, int).reshape(-1, 4)


def find_blobs(heatmap: np.ndarray) -> tuple:
    """Boxes of the connected parts of a thresholded heatmap, with their peaks.

    Parameters
    ----------
    heatmap : ndarray, shape (rows, columns)

    Returns
    -------
    boxes : ndarray of int, shape (n, 4)
        In cells of the map.
    peaks : ndarray of float, shape (n,)
        Highest heat of each.
    """
    labels, n_labels = label(heatmap)
    peaks = maximum(heatmap, labels, np.arange(1, n_labels + 1))
    return labeled_boxes(labels), np.asarray(peaks, float).reshape(-1)


# ------------------------------------------------------------------- drawing


def draw_labeled_bboxes(
    img: np.ndarray, labels: np.ndarray, color: tuple = (0, 0, 255), thickness: int = 4
) -> np.ndarray:
    """A copy of the image with the bounding box of every label on it.

    `labels` is as large as the image, see `labeled_boxes`.
    """
    return draw_boxes(img, labeled_boxes(labels), color, thickness)


def try_search(
    img: np.ndarray, classifier: Any, scale: float, threshold: float, color: str
) -> tuple:
    """What the choice of a scale, a threshold and a colour space does.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    classifier : object
        See `find_cars`.
    scale : float
        Of the windows, from where write-up G's bands begin down to the bottom.
    threshold : float
        Of the decision function.
    color : str
        A colour space, see `convert_color`.

    Returns
    -------
    pictures : list of ndarray of uint8
        Hot windows on the image, and the first channel of the colour space.
    titles : list of str
    """
    (_, top, _), *_ = SEARCH_PRESETS["G"].bands
    bottom = SEARCH_PRESETS["G"].reference_size[1]
    windows, scores = find_cars(img, classifier, SearchParams(bands=((scale, top, bottom),)))
    hot = draw_boxes(img, windows[scores > threshold], thickness=2)
    titles = [f"scale {scale}, above {threshold}", f"{color}, first channel"]
    return [hot, convert_color(img, color)[..., 0]], titles
