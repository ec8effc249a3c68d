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

_UNSETTLED = np.int32(-1)
# In bins; some ten times the error of the polynomial for 32 orientations.
_EDGE_MARGIN = np.float32(1e-3)


def hog_blocks(channel, orientations, pix_per_cell, cells_per_block):
    """Normalised HOG blocks of one image channel.

    Parameters
    ----------
    channel : ndarray of uint8, shape (rows, columns)
        At least one block high and wide, and at least 3 x 3 pixels.
    orientations, pix_per_cell, cells_per_block : int
        Number of orientation bins over 180 degrees, side of a cell in
        pixels, side of a block in cells.

    Returns
    -------
    blocks : ndarray of float32, shape (block rows, block columns,
             cells_per_block, cells_per_block, orientations)
        Blocks follow each other cell by cell.

    Raises
    ------
    ValueError
        The channel is not two-dimensional uint8, or is smaller than a block.
    """
    if channel.ndim != 2 or channel.dtype != np.uint8:
        raise ValueError(
            f"HOG needs one uint8 channel, not {channel.dtype} of shape {channel.shape}"
        )
    if min(channel.shape) < max(3, pix_per_cell * cells_per_block):
        raise ValueError(f"an image of {channel.shape} is smaller than one HOG block")
    cells = _cell_histograms(np.ascontiguousarray(channel), orientations, pix_per_cell)
    return _normalise_blocks(cells, cells_per_block)


def _cell_histograms(channel, orientations, pix_per_cell):
    """Mean gradient magnitude per orientation and cell, as float32."""
    rows, columns = channel.shape
    histograms = np.zeros((rows // pix_per_cell, columns // pix_per_cell, orientations), np.float32)
    unsettled = np.empty((channel.size, 2), np.int32)
    n_unsettled = _vote(channel, pix_per_cell, histograms, unsettled)
    _vote_exactly(channel, pix_per_cell, histograms, unsettled[:n_unsettled])
    histograms /= np.float32(pix_per_cell**2)
    return histograms


def _vote_exactly(channel, pix_per_cell, histograms, pixels):
    """Vote for (row, column) pixels with scikit-image's own arithmetic."""
    row, column = pixels.T
    gradient_row = _ROOT[channel[row + 1, column]] - _ROOT[channel[row - 1, column]]
    gradient_column = _ROOT[channel[row, column + 1]] - _ROOT[channel[row, column - 1]]
    angle = np.rad2deg(np.arctan2(gradient_row, gradient_column)) % 180
    orientations = histograms.shape[2]
    upper_edges = 180.0 / orientations * np.arange(1, orientations + 1)
    orientation = np.searchsorted(upper_edges, angle, side="right")
    np.add.at(
        histograms,
        (row // pix_per_cell, column // pix_per_cell, orientation),
        np.hypot(gradient_row, gradient_column),
    )


@njit(**_COMPILE)
def _look_up_roots(pixels, roots):
    for i in range(pixels.size):
        roots[i] = _FIXED_ROOT[pixels[i]]


@njit(**_COMPILE)
def _gradients(left, right, above, below, magnitudes, bins, orientations):
    """Magnitude and orientation bin of a run of pixels; one SIMD loop."""
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
        turn = np.float32(0.5) - turn if steep else turn
        turn = np.float32(1.0) - turn if x * y < np.float32(0.0) else turn
        position = turn * orientations
        near_edge = abs(position - np.rint(position)) < _EDGE_MARGIN
        # A gradient along an axis has an exact position, edge or not.
        near_edge &= shorter > np.float32(0.0)
        bins[i] = _UNSETTLED if near_edge else np.int32(position)


@njit(**_COMPILE)
def _diagonal_bin(channel, row, column, orientations):
    """Bin of an exact diagonal, -1 of any other gradient.

    Diagonals are by far the most common gradients on an edge, and 45 and 135
    degrees are exact in floating point.
    """
    x = _ROOT[channel[row, column + 1]] - _ROOT[channel[row, column - 1]]
    y = _ROOT[channel[row + 1, column]] - _ROOT[channel[row - 1, column]]
    if x == y:
        return np.int32(orientations // 4)
    if x == -y:
        return np.int32(3 * orientations // 4)
    return _UNSETTLED


@njit(**_COMPILE)
def _vote(channel, pix_per_cell, histograms, unsettled):
    """Add every pixel's magnitude to its cell; list the pixels left out."""
    rows, columns = channel.shape
    cell_rows, cell_columns, orientations = histograms.shape
    above = np.empty(columns, np.int32)
    here = np.empty(columns, np.int32)
    below = np.empty(columns, np.int32)
    magnitudes = np.empty(columns, np.float32)
    bins = np.empty(columns, np.int32)
    n = np.float32(orientations)
    n_unsettled = 0
    _look_up_roots(channel[0], below)
    for row in range(cell_rows * pix_per_cell):
        above, here, below = here, below, above
        if row + 1 < rows:
            _look_up_roots(channel[row + 1], below)
        # The image's border has no gradient across it.
        inside = 0 < row < rows - 1
        top, bottom = (above, below) if inside else (here, here)
        for left, right, first, last in (
            (here, here, 0, 1),
            (here[:-2], here[2:], 1, columns - 1),
            (here, here, columns - 1, columns),
        ):
            run = slice(first, last)
            _gradients(left, right, top[run], bottom[run], magnitudes[run], bins[run], n)
        cells = histograms[row // pix_per_cell]
        # Neighbouring pixels mostly share cell and bin: going from cell to
        # cell keeps one sum from waiting for the one before it.
        for offset in range(pix_per_cell):
            for cell in range(cell_columns):
                column = cell * pix_per_cell + offset
                k = bins[column]
                if k < 0:
                    k = _diagonal_bin(channel, row, column, orientations)
                if k >= 0:
                    cells[cell, k] += magnitudes[column]
                else:
                    unsettled[n_unsettled, 0] = row
                    unsettled[n_unsettled, 1] = column
                    n_unsettled += 1
    return n_unsettled


@njit(**_COMPILE)
def _normalise_blocks(cells, cells_per_block):
    """L2-Hys: unit length, clipped at 0.2, unit length again."""
    eps_squared = 1e-5**2
    size = cells_per_block
    rows = cells.shape[0] - size + 1
    columns = cells.shape[1] - size + 1
    orientations = cells.shape[2]
    blocks = np.empty((rows, columns, size, size, orientations), np.float32)
    for row in range(rows):
        for column in range(columns):
            block = blocks[row, column]
            block[:] = cells[row : row + size, column : column + size]
            values = block.reshape(block.size)
            squares = 0.0
            for i in range(values.size):
                squares += values[i] * values[i]
            scale = 1.0 / np.sqrt(squares + eps_squared)
            squares = 0.0
            for i in range(values.size):
                values[i] = min(values[i] * scale, 0.2)
                squares += values[i] * values[i]
            scale = 1.0 / np.sqrt(squares + eps_squared)
            for i in range(values.size):
                values[i] *= scale
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
