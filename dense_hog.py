"""Histograms of oriented gradients of whole image bands, compiled with numba.

The numbers are those of ``skimage.feature.hog(transform_sqrt=True,
block_norm='L2-Hys')``, which the tests use as the reference. What makes it
fast is that a pixel has only 256 values: their square roots are looked up,
gradients are differences of integers, and the orientation bin comes from a
short polynomial. Where that polynomial lands too near an edge between two
bins to be trusted, the arithmetic of scikit-image itself decides.

References
----------
.. [1] N. Dalal and B. Triggs, "Histograms of Oriented Gradients for Human
       Detection", CVPR 2005.
.. [2] M. Abramowitz and I. Stegun, "Handbook of Mathematical Functions",
       formula 4.4.47 (arctangent, absolute error below 1e-5).
"""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
from numba import njit

_COMPILE = dict(cache=True, nogil=True, error_model="numpy")

# Square roots as fixed point numbers: differences are then exact, and 2**26
# is the largest power of two for which they fit 32 bits.
_FIXED_POINT = 2.0**26
_ROOT = np.sqrt(np.arange(256.0))
_FIXED_ROOT = np.rint(_ROOT * _FIXED_POINT).astype(np.int32)

# arctan(x) / pi for x in 0..1, odd powers 1, 3, 5, 7, 9.
_A1, _A3, _A5, _A7, _A9 = (
    np.float32(a / np.pi) for a in (0.9998660, -0.3302995, 0.1801410, -0.0851330, 0.0208351)
)

# Compiled code runs outside the interpreter's lock, so threads share large images.
N_CORES = os.cpu_count()
THREADS = ThreadPoolExecutor(N_CORES)
_WORTH_A_THREAD = 100_000

_UNSETTLED = np.int32(-1)
# In bins; some ten times the error of the polynomial for 32 orientations.
_EDGE_MARGIN = np.float32(1e-3)


def hog_blocks(img, orientations, pix_per_cell, cells_per_block):
    """Normalised HOG blocks of every channel of an image.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, channels)
        At least one block high and wide, and at least 3 x 3 pixels.
    orientations, pix_per_cell, cells_per_block : int
        Number of orientation bins over 180 degrees, side of a cell in
        pixels, side of a block in cells.

    Returns
    -------
    blocks : ndarray of float32, shape (channels, block rows, block columns,
             cells_per_block, cells_per_block, orientations)
        Blocks follow each other cell by cell.

    Raises
    ------
    ValueError
        The image is not three-dimensional uint8, or is smaller than a block.
    """
    if img.ndim != 3 or img.dtype != np.uint8:
        raise ValueError(f"HOG needs uint8 channels, not {img.dtype} of shape {img.shape}")
    if min(img.shape[:2]) < max(3, pix_per_cell * cells_per_block):
        raise ValueError(f"an image of {img.shape} is smaller than one HOG block")
    return _normalise_blocks(_cell_histograms(img, orientations, pix_per_cell), cells_per_block)


def _cell_histograms(img, orientations, pix_per_cell):
    """Mean gradient magnitude, float32, shape (channels, cell rows, cell columns, bins)."""
    rows, columns, channels = img.shape
    cell_rows = rows // pix_per_cell
    histograms = np.zeros((channels, cell_rows, columns // pix_per_cell, orientations), np.float32)

    def vote(first, last):
        """Let the pixels of the cell rows first..last vote."""
        unsettled = np.empty(((last - first) * pix_per_cell * columns * channels, 3), np.int32)
        n_unsettled = _vote(img, pix_per_cell, first, last, histograms, unsettled)
        if n_unsettled:
            _vote_exactly(img, pix_per_cell, histograms, unsettled[:n_unsettled])

    n_parts = min(N_CORES, 1 + img.size // _WORTH_A_THREAD)
    edges = [cell_rows * i // n_parts for i in range(n_parts + 1)]
    others = [THREADS.submit(vote, *part) for part in pairwise(edges[1:])]
    vote(*edges[:2])
    for other in others:
        other.result()
    histograms /= np.float32(pix_per_cell**2)
    return histograms


def _vote_exactly(img, pix_per_cell, histograms, places):
    """Vote for (channel, row, column) places with scikit-image's own arithmetic."""
    channel, row, column = places.T
    gradient_row = _ROOT[img[row + 1, column, channel]] - _ROOT[img[row - 1, column, channel]]
    gradient_column = _ROOT[img[row, column + 1, channel]] - _ROOT[img[row, column - 1, channel]]
    angle = np.rad2deg(np.arctan2(gradient_row, gradient_column)) % 180
    orientations = histograms.shape[-1]
    upper_edges = 180.0 / orientations * np.arange(1, orientations + 1)
    orientation = np.searchsorted(upper_edges, angle, side="right")
    np.add.at(
        histograms,
        (channel, row // pix_per_cell, column // pix_per_cell, orientation),
        np.hypot(gradient_row, gradient_column),
    )


@njit(**_COMPILE)
def _look_up_roots(pixels, roots):
    """Roots of a row of pixels, with one more at each end that makes the end's gradient 0."""
    for i in range(pixels.size):
        roots[i + 1] = _FIXED_ROOT[pixels[i]]
    roots[0] = roots[2]
    roots[-1] = roots[-3]


# No value is infinite or not a number here, and bins near an edge are settled
# elsewhere, so the compiler may fuse and reorder.
@njit(**_COMPILE, fastmath={"contract", "nnan", "nsz"})
def _gradients(neighbours, magnitudes, bins, orientations):
    """Magnitude and orientation bin of a run of pixels; one SIMD loop.

    `neighbours` are the runs to the left, right, above and below.
    """
    left, right, above, below = neighbours
    unit = np.float32(1.0 / _FIXED_POINT)
    for i in range(magnitudes.size):
        x = np.float32(right[i] - left[i])
        y = np.float32(below[i] - above[i])
        magnitudes[i] = np.sqrt(x * x + y * y) * unit
        abs_x = abs(x)
        abs_y = abs(y)
        steep = abs_y > abs_x
        longer = abs_y if steep else abs_x
        shorter = abs_x if steep else abs_y
        t = shorter / (longer + np.float32(1e-9))
        s = t * t
        turn = t * (_A1 + s * (_A3 + s * (_A5 + s * (_A7 + s * _A9))))
        # Gradients between the same two values are the most common ones on an
        # edge. Equal differences alone are not enough: sqrt(8) - sqrt(2) and
        # sqrt(2) - sqrt(0) may differ in their last bit.
        same_values = np.int32(left[i] + right[i]) == np.int32(above[i] + below[i])
        diagonal = (abs_x == abs_y) & same_values
        turn = np.float32(0.25) if diagonal else turn
        turn = np.float32(0.5) - turn if steep else turn
        turn = np.float32(1.0) - turn if x * y < np.float32(0.0) else turn
        position = turn * np.float32(orientations)
        near_edge = abs(position - np.rint(position)) < _EDGE_MARGIN
        # Along an axis or a diagonal the position is exact, edge or not.
        near_edge &= (shorter > np.float32(0.0)) & (not diagonal)
        bins[i] = _UNSETTLED if near_edge else np.int32(position)


@njit(**_COMPILE)
def _precise_bin(img, channel, row, column, orientations):
    """Bin in double precision, unless rounding alone decides it."""
    x = _ROOT[img[row, column + 1, channel]] - _ROOT[img[row, column - 1, channel]]
    y = _ROOT[img[row + 1, column, channel]] - _ROOT[img[row - 1, column, channel]]
    position = math.atan2(y, x) / math.pi * orientations
    if position < 0:
        position += orientations
    if abs(position - np.rint(position)) < 1e-9:
        return _UNSETTLED
    return np.int32(position)


@njit(**_COMPILE)
def _vote(img, pix_per_cell, first_cell_row, last_cell_row, histograms, unsettled):
    """Add the magnitude of the pixels of some rows to their cells; list the places left out."""
    rows, columns, channels = img.shape
    _, _, cell_columns, orientations = histograms.shape
    first_row = first_cell_row * pix_per_cell
    above = np.empty(columns + 2, np.int32)
    here = np.empty(columns + 2, np.int32)
    below = np.empty(columns + 2, np.int32)
    magnitudes = np.empty(columns, np.float32)
    bins = np.empty(columns, np.int32)
    n_unsettled = 0
    for channel in range(channels):
        _look_up_roots(img[max(0, first_row - 1), :, channel], here)
        _look_up_roots(img[first_row, :, channel], below)
        for row in range(first_row, last_cell_row * pix_per_cell):
            above, here, below = here, below, above
            if row + 1 < rows:
                _look_up_roots(img[row + 1, :, channel], below)
            # The image's border has no gradient across it.
            inside = 0 < row < rows - 1
            top, bottom = (above, below) if inside else (here, here)
            neighbours = here[:-2], here[2:], top[1:-1], bottom[1:-1]
            _gradients(neighbours, magnitudes, bins, orientations)
            cells = histograms[channel, row // pix_per_cell]
            # Neighbouring pixels mostly share cell and bin: going from cell to
            # cell keeps one sum from waiting for the one before it.
            for offset in range(pix_per_cell):
                for cell in range(cell_columns):
                    column = np.uint32(cell * pix_per_cell + offset)
                    k = bins[column]
                    if k < 0:
                        k = _precise_bin(img, channel, row, column, orientations)
                    if k >= 0:
                        cells[cell, np.uint32(k)] += magnitudes[column]
                    else:
                        unsettled[n_unsettled, 0] = channel
                        unsettled[n_unsettled, 1] = row
                        unsettled[n_unsettled, 2] = column
                        n_unsettled += 1
    return n_unsettled


@njit(**_COMPILE)
def _normalise_blocks(cells, cells_per_block):
    """L2-Hys: unit length, clipped at 0.2, unit length again."""
    eps_squared = np.float32(1e-5**2)
    clip = np.float32(0.2)
    size = cells_per_block
    channels = cells.shape[0]
    rows = cells.shape[1] - size + 1
    columns = cells.shape[2] - size + 1
    bins = cells.shape[3]
    blocks = np.empty((channels, rows, columns, size, size, bins), np.float32)
    for c in range(channels):
        for row in range(rows):
            for column in range(columns):
                squares = eps_squared
                for i in range(size):
                    for k in range(size):
                        for n in range(bins):
                            squares += cells[c, row + i, column + k, n] ** 2
                scale = np.float32(1.0) / np.sqrt(squares)
                squares = eps_squared
                for i in range(size):
                    for k in range(size):
                        for n in range(bins):
                            value = min(cells[c, row + i, column + k, n] * scale, clip)
                            blocks[c, row, column, i, k, n] = value
                            squares += value * value
                scale = np.float32(1.0) / np.sqrt(squares)
                for i in range(size):
                    for k in range(size):
                        for n in range(bins):
                            blocks[c, row, column, i, k, n] *= scale
    return blocks


@njit(**_COMPILE)
def tile_histograms(channel, bin_of_value, n_bins, tile):
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
