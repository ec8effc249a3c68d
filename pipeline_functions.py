"""The detector as plain functions, in the order in which a frame meets them.

colour -> features -> windows -> search -> heat -> labels -> drawing

Every image is RGB, uint8, shape (rows, columns, 3). Every box is
(left, top, right, bottom) in whole pixels, right and bottom excluded, and
boxes travel as int arrays of shape (n, 4).
"""

from colorsys import hsv_to_rgb
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, gcd, prod

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.ndimage import find_objects, label, maximum
from skimage.feature import hog

from vehicle_detection.compiled.hog import correlate, hog_blocks, tile_histograms
from vehicle_detection.compiled.threads import side_by_side

# ---------------------------------------------------------------- parameters

_CONVERSIONS = {
    "RGB": None,
    "YCrCb": cv2.COLOR_RGB2YCrCb,
    "HSV": cv2.COLOR_RGB2HSV,
    "HLS": cv2.COLOR_RGB2HLS,
    "LUV": cv2.COLOR_RGB2LUV,
    "YUV": cv2.COLOR_RGB2YUV,
    "Lab": cv2.COLOR_RGB2Lab,
    "gray": cv2.COLOR_RGB2GRAY,
}


def _require_color(conv):
    if conv not in _CONVERSIONS:
        raise ValueError(f"unknown colour space {conv!r}: one of {', '.join(_CONVERSIONS)}")


def _channel_count(conv):
    return 1 if conv == "gray" else 3


@dataclass(frozen=True)
class FeatureParams:
    """What is measured of a window. A colour of None leaves the group out.

    Attributes
    ----------
    spatial_color, hist_color, hog_color : str or None
        Colour space of each feature group, a name `convert_color` knows.
    spatial_size : int
        The window is shrunk to this many pixels a side; divides `window_size`.
    hist_bins : int
        Bins of each channel's histogram over 0..256.
    hog_channel : int or "ALL"
        Channel of `hog_color` that HOG looks at.
    orientations, pix_per_cell, cells_per_block : int
        HOG: bins over 180 degrees, pixels a cell, cells a block.
        `pix_per_cell` divides `window_size`.
    window_size : int
        Side of a training image, and of a window at scale 1, in pixels.
    """

    spatial_color: str | None = None
    spatial_size: int = 16
    hist_color: str | None = None
    hist_bins: int = 32
    hog_color: str | None = None
    hog_channel: int | str = "ALL"
    orientations: int = 9
    pix_per_cell: int = 8
    cells_per_block: int = 2
    window_size: int = 64

    def __post_init__(self):
        groups = (self.spatial_color, self.hist_color, self.hog_color)
        if not any(groups):
            raise ValueError("no feature group is on: give at least one colour space")
        for color in groups:
            if color is not None:
                _require_color(color)
        if min(self.spatial_size, self.pix_per_cell, self.window_size) < 1:
            raise ValueError("spatial_size, pix_per_cell and window_size start at 1")
        if self.spatial_color and self.window_size % self.spatial_size:
            raise ValueError(
                f"spatial_size {self.spatial_size} does not divide "
                f"the window of {self.window_size} pixels"
            )
        if self.window_size % self.pix_per_cell:
            raise ValueError(
                f"pix_per_cell {self.pix_per_cell} does not divide "
                f"the window of {self.window_size} pixels"
            )
        if not 1 <= self.cells_per_block <= self.window_size // self.pix_per_cell:
            raise ValueError(f"{self.cells_per_block} cells per block do not fit a window")
        if min(self.orientations, self.hist_bins) < 1:
            raise ValueError("orientations and hist_bins start at 1")
        if self.hog_color and self.hog_channel not in ("ALL", 0, 1, 2):
            raise ValueError(f"hog_channel is 0, 1, 2 or 'ALL', not {self.hog_channel!r}")
        if self.hog_color == "gray" and self.hog_channel not in ("ALL", 0):
            raise ValueError("a gray image has no HOG channel but 0")

    @property
    def n_features(self):
        """Length of the feature vector of one window."""
        n = 0
        if self.spatial_color:
            n += self.spatial_size**2 * _channel_count(self.spatial_color)
        if self.hist_color:
            n += self.hist_bins * _channel_count(self.hist_color)
        if self.hog_color:
            cells = self.window_size // self.pix_per_cell
            blocks = cells - self.cells_per_block + 1
            per_channel = (blocks * self.cells_per_block) ** 2 * self.orientations
            channels = range(_channel_count(self.hog_color))[_hog_channels(self)]
            n += per_channel * len(channels)
        return n


FEATURE_PRESETS = {
    "G": FeatureParams(
        spatial_color="HLS", spatial_size=16,
        hog_color="HLS", orientations=8, pix_per_cell=8, cells_per_block=1,
    ),
    "B": FeatureParams(
        spatial_color="YCrCb", spatial_size=32, hist_color="YCrCb", hist_bins=32,
        hog_color="YCrCb", orientations=9, pix_per_cell=8, cells_per_block=2,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class SearchParams:
    """Where windows lie. Lengths are pixels of a frame of `reference_size`.

    On a frame of another size, scales follow its width, for that is what the
    field of view fills, and the bands follow its height, for that is where
    the horizon lies.

    Attributes
    ----------
    bands : tuple of (scale, top, bottom)
        Each scans the rows top..bottom with windows of scale * window_size.
    cells_per_step : int
        Distance between neighbouring windows, in HOG cells.
    threshold : float
        Windows of a decision function above it are hot.
    horizon : float or None
        Row in which the road vanishes. With it, only windows are visited in
        which a vehicle that stands on the road could be: small ones near the
        horizon, large ones below, see `may_hold_vehicle`. None visits all.
    scan_every : int
        Every so many frames of a video all windows are visited, and between
        them only those around what was warm in the frame before.
    reference_size : (width, height)
    """

    bands: tuple
    cells_per_step: int = 2
    threshold: float = 0.0
    horizon: float | None = None
    scan_every: int = 1
    reference_size: tuple = (1280, 720)

    def __post_init__(self):
        object.__setattr__(self, "bands", tuple(map(tuple, self.bands)))
        if not self.bands:
            raise ValueError("a search needs at least one band of (scale, top, bottom)")
        for scale, top, bottom in self.bands:
            if scale <= 0 or not 0 <= top < bottom <= self.reference_size[1]:
                raise ValueError(f"not a band (scale, top, bottom): {(scale, top, bottom)}")
        if min(self.cells_per_step, self.scan_every) < 1:
            raise ValueError("cells_per_step and scan_every start at 1")


SEARCH_PRESETS = {
    # G's stills were searched in (1, 380, 550); these are its video's bands.
    "G": SearchParams(bands=((1, 400, 550), (2, 400, 650), (3, 400, 720), (4, 400, 720))),
    "B": SearchParams(bands=((1.6, 380, 660),)),
}

# -------------------------------------------------------------------- colour


def convert_color(img, conv):
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
    _require_color(conv)
    if img.ndim != 3 or img.shape[2] != 3 or img.dtype != np.uint8:
        raise ValueError(f"not an RGB uint8 image: {img.dtype} of shape {img.shape}")
    code = _CONVERSIONS[conv]
    return img.copy() if code is None else cv2.cvtColor(img, code)


# ------------------------------------------------------------------ features

# One under another: one by one they take some four times as long.
_IMAGES_PER_STRIP = 50


def bin_spatial(img, size):
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


def color_hist(img, nbins=32, bins_range=(0, 256)):
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


def get_hog_features(img, orient, pix_per_cell, cell_per_block, vis=False, feature_vec=True):
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


def extract_features(images, params):
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


def dense_features(img, params, cells_per_step):
    """Feature vectors of all windows of an image, each pixel looked at once.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB, at least a window high and wide.
    params : FeatureParams
    cells_per_step : int

    Returns
    -------
    features : ndarray of float32, shape (window rows, window columns, n_features)
        In the order of `extract_features`. HOG blocks are those of the whole
        image: a window's outermost gradients see the pixels beyond it.
    """
    step = cells_per_step * params.pix_per_cell
    rows, columns = _window_counts(img.shape, params.window_size, step)
    features = np.empty((rows, columns, params.n_features), np.float32)
    start = 0
    for grid in _feature_grids(img, params, cells_per_step):
        windows = grid.windows((rows, columns))
        # Windows come first, whatever they are made of follows.
        size = prod(windows.shape[2:])
        part = features[:, :, start : start + size]
        part.reshape(windows.shape, copy=False)[:] = windows
        start += size
    return features


def dense_scores(img, params, cells_per_step, weights, bias):
    """Products of the feature vectors of all windows with weights, plus a bias.

    What windows share is not copied for each: a sixth of the search's time.

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
    counts = _window_counts(img.shape, params.window_size, cells_per_step * params.pix_per_cell)
    scores, start = np.float32(bias), 0
    for grid in _feature_grids(img, params, cells_per_step):
        shape = grid.extent, grid.extent, grid.cells.shape[2]
        size = prod(shape)
        scores = scores + grid.products(weights[start : start + size].reshape(shape), counts)
        start += size
    return scores


@dataclass(frozen=True)
class _FeatureGrid:
    """What the windows of a band share: each is `extent` x `extent` of these cells.

    Attributes
    ----------
    cells : ndarray, shape (rows, columns, depth)
    extent : int
    spacing : int
        Between neighbouring cells of a window.
    step : int
        Between neighbouring windows.
    """

    cells: np.ndarray
    extent: int
    spacing: int
    step: int

    def windows(self, counts):
        """View of all windows, shape (*counts, extent, extent, depth)."""
        y, x, depth = self.cells.strides
        strides = (y * self.step, x * self.step, y * self.spacing, x * self.spacing, depth)
        shape = (*counts, self.extent, self.extent, self.cells.shape[2])
        return as_strided(self.cells, shape, strides, writeable=False)

    def products(self, weights, counts):
        """Sums of the products of all windows with weights of (extent, extent, depth)."""
        if self.spacing > 1:
            side = (self.extent - 1) * self.spacing + 1
            spaced = np.zeros((side, side, weights.shape[2]), np.float32)
            spaced[:: self.spacing, :: self.spacing] = weights
            weights = spaced
        return correlate(self.cells, weights, self.step, counts)


def _feature_grids(img, params, cells_per_step):
    """Yield what the features of all windows are taken from, in the order of the features."""
    colors = {params.spatial_color, params.hist_color, params.hog_color} - {None}
    converted = {color: convert_color(img, color) for color in colors}
    if params.spatial_color:
        yield _spatial_grid(converted[params.spatial_color], params, cells_per_step)
    if params.hist_color:
        for channel in cv2.split(converted[params.hist_color]):
            yield _histogram_grid(channel, params, cells_per_step)
    if params.hog_color:
        channels = np.atleast_3d(converted[params.hog_color])[..., _hog_channels(params)]
        yield from _hog_grids(channels, params, cells_per_step)


def _spatial_grid(img, params, cells_per_step):
    """`bin_spatial` of every window.

    A window shrinks by a whole factor, and so does the image: one shrunk
    image holds the pixels of all windows that lie a multiple of the factor
    apart, and shrunk images of shifted copies hold those between.
    """
    factor = params.window_size // params.spatial_size
    step = cells_per_step * params.pix_per_cell
    pitch = gcd(factor, step)
    rows, columns = (side // factor for side in img.shape[:2])
    n_shifts = factor // pitch
    shrunk = np.empty((rows * n_shifts, columns * n_shifts, *img.shape[2:]), np.uint8)
    for i, k in np.ndindex(n_shifts, n_shifts):
        shifted = img[i * pitch :, k * pitch :]
        size = shifted.shape[1] // factor, shifted.shape[0] // factor
        if min(size) == 0:
            continue
        whole = shifted[: size[1] * factor, : size[0] * factor]
        shrunk[i::n_shifts, k::n_shifts][: size[1], : size[0]] = cv2.resize(
            whole, size, interpolation=cv2.INTER_LINEAR
        )
    cells = np.atleast_3d(shrunk)
    return _FeatureGrid(cells, params.spatial_size, n_shifts, step // pitch)


def _histogram_grid(channel, params, cells_per_step):
    """`color_hist` of one channel of every window, summed from tiles' histograms."""
    step = cells_per_step * params.pix_per_cell
    tile = gcd(params.window_size, step)
    edges = np.linspace(0, 256, params.hist_bins + 1)
    bin_of_value = np.searchsorted(edges, np.arange(256), side="right") - 1
    tiles = tile_histograms(channel, bin_of_value, params.hist_bins, tile)
    total = np.pad(tiles.cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0), (0, 0)))
    extent = params.window_size // tile
    windows = (
        total[extent:, extent:] - total[:-extent, extent:]
        - total[extent:, :-extent] + total[:-extent, :-extent]
    )  # fmt: skip
    return _FeatureGrid(np.ascontiguousarray(windows), 1, 1, step // tile)


def _hog_channels(params):
    """The channels that HOG looks at, as a slice."""
    if params.hog_channel == "ALL":
        return slice(_channel_count(params.hog_color))
    return slice(params.hog_channel, params.hog_channel + 1)


def _hog_grids(img, params, cells_per_step):
    """Yield the HOG blocks of every channel."""
    blocks = hog_blocks(img, params.orientations, params.pix_per_cell, params.cells_per_block)
    extent = params.window_size // params.pix_per_cell - params.cells_per_block + 1
    for channel in blocks:
        cells = channel.reshape(*channel.shape[:2], -1)
        yield _FeatureGrid(cells, extent, 1, cells_per_step)


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


def _window_counts(shape, window_size, step):
    """How many windows lie one under another, and side by side."""
    rows, columns = ((side - window_size) // step + 1 for side in shape[:2])
    if rows < 1 or columns < 1:
        raise ValueError(f"an image of {shape[1]}x{shape[0]} is smaller than a window")
    return rows, columns


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
        rows, columns = _window_counts(shape, params.window_size, step)
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


def slide_window(frame_shape, params, search):
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


def may_hold_vehicle(windows, frame_shape, search):
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


def are_near(windows, boxes):
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


def find_cars(frame, classifier, search, boxes=None):
    """Score the windows of a frame.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    classifier : object
        With `params`, its FeatureParams; `linear`, weights and bias of a
        linear decision function or None; `decision_function`, which takes
        features of shape (n, params.n_features) and returns n scores.
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
    results = side_by_side(lambda grid: _score_band(frame, *grid, classifier, search, boxes), grids)
    windows, scores = zip(*results, strict=True)
    return np.concatenate(windows), np.concatenate(scores)


def _score_band(frame, band, windows, classifier, search, boxes):
    """Windows of one band that are to be visited, and their scores."""
    visited = np.ones(windows.shape[:2], bool)
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
    if classifier.linear is not None:
        return dense_scores(img, params, search.cells_per_step, *classifier.linear)[inner]
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
    def of_windows(cls, windows):
        """Grid of the edges of `windows`, int array of shape (n, 4)."""
        return cls(np.unique(windows[:, [0, 2]]), np.unique(windows[:, [1, 3]]))

    def zeros(self):
        """Empty heatmap of this grid, float64."""
        return np.zeros((len(self.y_edges) - 1, len(self.x_edges) - 1))

    def to_cells(self, boxes):
        """Boxes in pixels, all on the grid's edges, to boxes in cells."""
        boxes = np.asarray(boxes).reshape(-1, 4)
        x = np.searchsorted(self.x_edges, boxes[:, [0, 2]])
        y = np.searchsorted(self.y_edges, boxes[:, [1, 3]])
        return np.stack([x[:, 0], y[:, 0], x[:, 1], y[:, 1]], axis=1)

    def to_pixels(self, boxes):
        """Boxes in cells to boxes in pixels."""
        left, top, right, bottom = np.asarray(boxes, int).reshape(-1, 4).T
        return np.stack(
            [self.x_edges[left], self.y_edges[top], self.x_edges[right], self.y_edges[bottom]],
            axis=1,
        )

    def expand(self, heatmap, frame_shape):
        """Heatmap of cells to one of pixels, zero where no window lies."""
        full = np.zeros(frame_shape[:2], heatmap.dtype)
        rows, columns = np.diff(self.y_edges), np.diff(self.x_edges)
        full[self.y_edges[0] : self.y_edges[-1], self.x_edges[0] : self.x_edges[-1]] = (
            heatmap.repeat(rows, axis=0).repeat(columns, axis=1)
        )
        return full


def add_heat(heatmap, boxes):
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


def apply_threshold(heatmap, threshold):
    """The map with everything up to and including `threshold` set to zero."""
    return np.where(heatmap > threshold, heatmap, 0)


def keep_lasting_heat(heatmaps, n_occ_thr):
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


def labeled_boxes(labels):
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


def find_blobs(heatmap):
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


def draw_boxes(img, boxes, color=(0, 0, 255), thickness=4):
    """A copy of the image with boxes on it.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of int, shape (n, 4)
    color : tuple of int
        RGB.
    thickness : int
        In pixels.
    """
    img = img.copy()
    for left, top, right, bottom in np.asarray(boxes, int).reshape(-1, 4).tolist():
        cv2.rectangle(img, (left, top), (right - 1, bottom - 1), color, thickness)
    return img


def draw_labeled_bboxes(img, labels, color=(0, 0, 255), thickness=4):
    """A copy of the image with the bounding box of every label on it.

    `labels` is as large as the image, see `labeled_boxes`.
    """
    return draw_boxes(img, labeled_boxes(labels), color, thickness)


def identity_color(identity):
    """A bright RGB colour for a vehicle's number, far from those of its neighbours."""
    # Steps of the golden ratio around the circle of hues stay far from all recent ones.
    hue = identity * 0.6180339887 % 1
    return tuple(round(255 * value) for value in hsv_to_rgb(hue, 0.85, 1.0))


def draw_vehicles(img, boxes, ids, thickness=4):
    """A copy of the image with every vehicle boxed and numbered in the colour of its identity.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray of int, shape (n, 4)
    ids : ndarray of int, shape (n,)
    thickness : int
        In pixels.
    """
    img = img.copy()
    font_scale = img.shape[0] / 600
    for (left, top, right, bottom), identity in zip(boxes.tolist(), ids.tolist(), strict=True):
        color = identity_color(identity)
        cv2.rectangle(img, (left, top), (right - 1, bottom - 1), color, thickness)
        # Above the box, or inside it where that would leave the picture.
        place = left, max(top - 2 * thickness, round(22 * font_scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(img, str(identity), place, font, font_scale, color, 2, cv2.LINE_AA)
    return img
