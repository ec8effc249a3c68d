"""Features and linear scores of all windows of an image, each pixel looked at once.

The numbers are those of every window by itself, but for the outermost gradients of a
window, which see the pixels beyond it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import gcd, prod
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided

from vehicle_detection.compiled.hog import hog_blocks
from vehicle_detection.compiled.window_sums import correlate, tile_histograms

if TYPE_CHECKING:
    from vehicle_detection.parameters import FeatureParams


def window_counts(shape: tuple, window_size: int, step: int) -> tuple:
    """How many windows lie one under another, and side by side."""
    rows, columns = ((side - window_size) // step + 1 for side in shape[:2])
    if rows < 1 or columns < 1:
        raise ValueError(f"an image of {shape[1]}x{shape[0]} is smaller than a window")
    return rows, columns


def dense_features(planes: dict, params: FeatureParams, cells_per_step: int) -> np.ndarray:
    """Feature vectors of all windows of an image, each pixel looked at once.

    Parameters
    ----------
    planes : dict of str to ndarray of uint8, shape (rows, columns, 3) or (rows, columns)
        The image in every colour space of `params`, at least a window high and wide.
    params : FeatureParams
    cells_per_step : int

    Returns
    -------
    features : ndarray of float32, shape (window rows, window columns, n_features)
        In the order of `extract_features`. HOG blocks are those of the whole
        image: a window's outermost gradients see the pixels beyond it.
    """
    step = cells_per_step * params.pix_per_cell
    rows, columns = window_counts(_shape(planes), params.window_size, step)
    features = np.empty((rows, columns, params.n_features), np.float32)
    start = 0
    for grid in _feature_grids(planes, params, cells_per_step):
        windows = grid.windows((rows, columns))
        # Windows come first, whatever they are made of follows.
        size = prod(windows.shape[2:])
        part = features[:, :, start : start + size]
        part.reshape(windows.shape, copy=False)[:] = windows
        start += size
    return features


def dense_scores(
    planes: np.ndarray, params: Any, cells_per_step: int, weights: np.ndarray, bias: float
) -> np.ndarray:
    """Products of the feature vectors of all windows with weights, plus a bias.

    What windows share is not copied for each: a sixth of the search's time.

    Parameters
    ----------
    planes, params, cells_per_step
        See `dense_features`.
    weights : ndarray of float32, shape (params.n_features,)
    bias : float

    Returns
    -------
    scores : ndarray of float32, shape (window rows, window columns)
    """
    counts = window_counts(_shape(planes), params.window_size, cells_per_step * params.pix_per_cell)
    scores, start = np.full(counts, bias, np.float32), 0
    for grid in _feature_grids(planes, params, cells_per_step):
        shape = grid.extent, grid.extent, grid.cells.shape[2]
        size = prod(shape)
        scores = scores + grid.products(weights[start : start + size].reshape(shape), counts)
        start += size
    return scores


def _shape(planes):
    """Rows and columns of an image that is given in several colour spaces."""
    return next(iter(planes.values())).shape[:2]


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

    def windows(self, counts: tuple) -> np.ndarray:
        """View of all windows, shape (*counts, extent, extent, depth)."""
        y, x, depth = self.cells.strides
        strides = (y * self.step, x * self.step, y * self.spacing, x * self.spacing, depth)
        shape = (*counts, self.extent, self.extent, self.cells.shape[2])
        return as_strided(self.cells, shape, strides, writeable=False)

    def products(self, weights: np.ndarray, counts: tuple) -> np.ndarray:
        """Sums of the products of all windows with weights of (extent, extent, depth)."""
        if self.spacing > 1:
            side = (self.extent - 1) * self.spacing + 1
            spaced = np.zeros((side, side, weights.shape[2]), np.float32)
            spaced[:: self.spacing, :: self.spacing] = weights
            weights = spaced
        return correlate(self.cells, weights, self.step, counts)


def _feature_grids(planes, params, cells_per_step):
    """Yield what the features of all windows are taken from, in the order of the features."""
    if params.spatial_color:
        yield _spatial_grid(planes[params.spatial_color], params, cells_per_step)
    if params.hist_color:
        for channel in cv2.split(planes[params.hist_color]):
            yield _histogram_grid(channel, params, cells_per_step)
    if params.hog_color:
        channels = np.atleast_3d(planes[params.hog_color])[..., params.hog_channels]
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


def _hog_grids(img, params, cells_per_step):
    """Yield the HOG blocks of every channel."""
    blocks = hog_blocks(img, params.orientations, params.pix_per_cell, params.cells_per_block)
    extent = params.window_size // params.pix_per_cell - params.cells_per_block + 1
    for channel in blocks:
        cells = channel.reshape(*channel.shape[:2], -1)
        yield _FeatureGrid(cells, extent, 1, cells_per_step)
