"""Sums over the windows of an image, compiled.

What neighbouring windows share is read in place instead of being copied for each of them.
"""

from __future__ import annotations

import numpy as np

from vehicle_detection.compiled.cache import compiled
from vehicle_detection.compiled.threads import share

_COMPILE = dict(error_model="numpy")
# Several terms of a sum at once: no order of them is the right one.
SUMS = {"reassoc", "contract", "nsz"}
# Products that take longer than waking a thread.
_WORTH_A_THREAD = 20_000_000


@compiled(**_COMPILE)
def tile_histograms(
    channel: np.ndarray, bin_of_value: np.ndarray, n_bins: int, tile: int
) -> np.ndarray:
    """Histogram of the pixel values of every square tile of a channel.

    Parameters
    ----------
    channel : ndarray of uint8, shape (rows, columns)
    bin_of_value : ndarray of int64, shape (256,)
        Bin of every pixel value, -1 for none.
    n_bins, tile : int
        Number of bins; side of a tile in pixels.

    Returns
    -------
    histograms : ndarray of int32, shape (rows // tile, columns // tile, n_bins)
    """
    tile_rows = channel.shape[0] // tile
    tile_columns = channel.shape[1] // tile
    histograms = np.zeros((tile_rows, tile_columns, n_bins), np.int32)
    for row in range(tile_rows * tile):
        tiles = histograms[row // tile]
        for tile_column in range(tile_columns):
            for column in range(tile_column * tile, (tile_column + 1) * tile):
                k = bin_of_value[channel[row, column]]
                if k >= 0:
                    tiles[tile_column, k] += 1
    return histograms


def correlate(cells: np.ndarray, weights: np.ndarray, step: int, shape: tuple) -> np.ndarray:
    """Sums of the products of weights with the cells of every window.

    Parameters
    ----------
    cells : ndarray, shape (rows, columns, depth)
        C-contiguous.
    weights : ndarray of float32, shape (window rows, window columns, depth)
        C-contiguous; all windows must lie within the cells.
    step : int
        Between neighbouring windows, in cells.
    shape : (int, int)
        How many windows lie one under another, and side by side.

    Returns
    -------
    sums : ndarray of float32, of that shape

    Raises
    ------
    ValueError
        A window would lie outside; the weights are of another depth.
    """
    if cells.shape[2] != weights.shape[2]:
        raise ValueError(f"weights of {weights.shape} for cells of {cells.shape}")
    reach = [step * (n - 1) + side for n, side in zip(shape, weights.shape, strict=False)]
    if min(shape) > 0 and (reach[0] > cells.shape[0] or reach[1] > cells.shape[1]):
        raise ValueError(f"windows reach {reach}, cells are {cells.shape}")
    sums = np.empty(shape, np.float32)
    n_parts = 1 + sums.size * weights.size // _WORTH_A_THREAD
    share(lambda *rows: _correlate(cells, weights, step, *rows, sums), shape[0], n_parts)
    return sums


@compiled(**_COMPILE, fastmath=SUMS)
def _correlate(cells, weights, step, first, last, sums):
    """`correlate` for the window rows first..last.

    Four windows at a time share each weight that is read. At the end of a row, where
    fewer are left, the last is taken again.
    """
    _, columns, depth = cells.shape
    rows, width, _ = weights.shape
    runs = cells.reshape(-1, columns * depth)
    own_runs = weights.reshape(rows, width * depth)
    n_windows, length, stride = sums.shape[1], width * depth, step * depth
    zero = np.float32(0)
    for i in range(first, last):
        for k0 in range(0, n_windows, 4):
            k1, k2, k3 = (
                min(k0 + 1, n_windows - 1), min(k0 + 2, n_windows - 1), min(k0 + 3, n_windows - 1),
            )  # fmt: skip
            a, b, c, d = zero, zero, zero, zero
            for row in range(rows):
                run, own = runs[i * step + row], own_runs[row]
                of_a = run[k0 * stride : k0 * stride + length]
                of_b = run[k1 * stride : k1 * stride + length]
                of_c = run[k2 * stride : k2 * stride + length]
                of_d = run[k3 * stride : k3 * stride + length]
                for n in range(length):
                    a += np.float32(of_a[n]) * own[n]
                    b += np.float32(of_b[n]) * own[n]
                    c += np.float32(of_c[n]) * own[n]
                    d += np.float32(of_d[n]) * own[n]
            sums[i, k0], sums[i, k1], sums[i, k2], sums[i, k3] = a, b, c, d


def sums_at(cells: np.ndarray, corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Several sums of products of weights with the cells of some windows.

    Parameters
    ----------
    cells : ndarray of float32, shape (rows, columns, depth)
        C-contiguous; outside of them, the cells at their edge go on.
    corners : ndarray of int64, shape (n, 2)
        First column and row of each window.
    weights : ndarray of float32, shape (window rows, window columns, depth, 4)
        C-contiguous.

    Returns
    -------
    sums : ndarray of float32, shape (n, 4)

    Raises
    ------
    ValueError
        The weights are of another depth, or not of four sums; there are no cells.
    """
    if weights.shape[2:] != (cells.shape[2], 4) or not cells.size:
        raise ValueError(f"weights of {weights.shape} for cells of {cells.shape}")
    return _sums_at(cells, corners, weights)


@compiled(**_COMPILE, fastmath=SUMS)
def _sums_at(cells, corners, weights):
    """`sums_at`, without looking at its arguments."""
    n_rows, n_columns, depth = cells.shape
    rows, columns, _, _ = weights.shape
    sums = np.empty((len(corners), 4), np.float32)
    zero = np.float32(0)
    for i in range(len(corners)):
        a, b, c, d = zero, zero, zero, zero
        for row in range(rows):
            own_row = min(max(corners[i, 1] + row, 0), n_rows - 1)
            for column in range(columns):
                own_column = min(max(corners[i, 0] + column, 0), n_columns - 1)
                cell, of_cell = cells[own_row, own_column], weights[row, column]
                for n in range(depth):
                    a += cell[n] * of_cell[n, 0]
                    b += cell[n] * of_cell[n, 1]
                    c += cell[n] * of_cell[n, 2]
                    d += cell[n] * of_cell[n, 3]
        sums[i, 0], sums[i, 1], sums[i, 2], sums[i, 3] = a, b, c, d
    return sums
