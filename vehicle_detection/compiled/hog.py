"""Histograms of oriented gradients of whole image bands, compiled.

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

from __future__ import annotations

import math

import numpy as np

from vehicle_detection.compiled.cache import compiled
from vehicle_detection.compiled.threads import share

_COMPILE = dict(error_model="numpy")
# Square roots as fixed point numbers: differences are then exact, and 2**26
# is the largest power of two for which they fit 32 bits.
_FIXED_POINT = 2.0**26
_ROOT = np.sqrt(np.arange(256.0))
_FIXED_ROOT = np.rint(_ROOT * _FIXED_POINT).astype(np.int32)

# arctan(x) / pi for x in 0..1, odd powers 1, 3, 5, 7, 9.
_A1, _A3, _A5, _A7, _A9 = (
    np.float32(a / np.pi) for a in (0.9998660, -0.3302995, 0.1801410, -0.0851330, 0.0208351)
)

# Operations that take longer than waking a thread.
_WORTH_A_THREAD = 300_000

_UNSETTLED = np.int32(-1)
# Pixels left out that there is room for at first: most images have fewer.
_FEW = 1000
# In bins; some ten times the error of the polynomial for 32 orientations.
_EDGE_MARGIN = np.float32(1e-3)


def hog_blocks(
    img: np.ndarray, orientations: int, pix_per_cell: int, cells_per_block: int
) -> np.ndarray:
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
    if min(img.shape[:2]) < pix_per_cell * cells_per_block:
        raise ValueError(f"an image of {img.shape} is smaller than one HOG block")
    cells = cell_histograms(img, orientations, pix_per_cell)
    channels, rows, columns, _ = cells.shape
    rows, columns = rows - cells_per_block + 1, columns - cells_per_block + 1
    size = cells_per_block, cells_per_block
    blocks = np.empty((channels, rows, columns, *size, orientations), np.float32)
    n_parts = 1 + 4 * blocks.size // _WORTH_A_THREAD
    share(lambda *part: _normalise_blocks(cells, *part, blocks), rows, n_parts)
    return blocks


def cell_histograms(img: np.ndarray, orientations: int, pix_per_cell: int) -> np.ndarray:
    """Gradients of every cell by orientation, as they are before blocks normalise them.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, channels)
        At least one cell high and wide, and at least 3 x 3 pixels.
    orientations, pix_per_cell : int
        See `hog_blocks`.

    Returns
    -------
    histograms : ndarray of float32, shape (channels, cell rows, cell columns, orientations)
        Sums of the magnitudes of the gradients of square roots of pixels, by
        the number of pixels of a cell.

    Raises
    ------
    ValueError
        The image is not three-dimensional uint8, or is smaller than a cell.
    """
    if img.ndim != 3 or img.dtype != np.uint8:
        raise ValueError(f"HOG needs uint8 channels, not {img.dtype} of shape {img.shape}")
    if min(img.shape[:2]) < max(3, pix_per_cell):
        raise ValueError(f"an image of {img.shape} is smaller than one HOG cell")
    rows, columns, channels = img.shape
    cell_rows = rows // pix_per_cell
    histograms = np.empty((channels, cell_rows, columns // pix_per_cell, orientations), np.float32)

    def vote(first, last):
        """Let the pixels of the cell rows first..last vote; returns those that are left out."""
        unsettled, count = np.empty((0, 5)), _FEW
        while count > len(unsettled):
            unsettled = np.empty((count, 5))
            histograms[:, first:last] = 0
            count = _vote(img, pix_per_cell, first, last, histograms, unsettled)
        return unsettled[:count]

    unsettled = np.concatenate(share(vote, cell_rows, 1 + img.size // _WORTH_A_THREAD))
    if len(unsettled):
        _vote_exactly(unsettled, histograms)
    histograms /= np.float32(pix_per_cell**2)
    return histograms


def _vote_exactly(unsettled, histograms):
    """Vote with scikit-image's own arithmetic, see `_vote`."""
    gradient_row, gradient_column = unsettled[:, 3:].T
    angle = np.rad2deg(np.arctan2(gradient_row, gradient_column)) % 180
    orientations = histograms.shape[-1]
    upper_edges = 180.0 / orientations * np.arange(1, orientations + 1)
    orientation = np.searchsorted(upper_edges, angle, side="right")
    cells = tuple(unsettled[:, :3].T.astype(int))
    np.add.at(histograms, (*cells, orientation), np.hypot(gradient_row, gradient_column))


@compiled(**_COMPILE)
def _look_up_roots(pixels, roots):
    """Roots of a row of pixels, with one more at each end that makes the end's gradient 0."""
    for i in range(pixels.size):
        roots[i + 1] = _FIXED_ROOT[pixels[i]]
    roots[0] = roots[2]
    roots[-1] = roots[-3]


# No value is infinite or not a number here, and bins near an edge are settled
# elsewhere, so the compiler may fuse and reorder.
@compiled(**_COMPILE, fastmath={"contract", "nnan", "nsz"})
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


@compiled(**_COMPILE)
def _precise_gradient(img, channel, row, column):
    """Gradient along rows and columns of a pixel that is not on the border."""
    y = _ROOT[img[row + 1, column, channel]] - _ROOT[img[row - 1, column, channel]]
    x = _ROOT[img[row, column + 1, channel]] - _ROOT[img[row, column - 1, channel]]
    return y, x


@compiled(**_COMPILE)
def _precise_bin(y, x, orientations):
    """Bin in double precision, unless rounding alone decides it."""
    position = math.atan2(y, x) / math.pi * orientations
    if position < 0:
        position += orientations
    if abs(position - np.rint(position)) < 1e-9:
        return _UNSETTLED
    return np.int32(position)


@compiled(**_COMPILE)
def _vote(img, pix_per_cell, first_cell_row, last_cell_row, histograms, unsettled):
    """Add the magnitude of the pixels of some rows to their cells; list those left out.

    A row of `unsettled` is a pixel's channel, cell row, cell column, and gradient
    along rows and columns. Returns how many there are, of which the last may find no room.
    """
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
                        y, x = _precise_gradient(img, channel, row, column)
                        k = _precise_bin(y, x, orientations)
                        if k < 0:
                            if n_unsettled < len(unsettled):
                                left_out = unsettled[n_unsettled]
                                left_out[0], left_out[1] = channel, row // pix_per_cell
                                left_out[2], left_out[3], left_out[4] = cell, y, x
                            n_unsettled += 1
                            continue
                    cells[cell, np.uint32(k)] += magnitudes[column]
    return n_unsettled


@compiled(**_COMPILE)
def _normalise_blocks(cells, first, last, blocks):
    """L2-Hys of the block rows first..last: unit length, clipped at 0.2, unit length again."""
    eps_squared = np.float32(1e-5**2)
    clip = np.float32(0.2)
    channels, _, columns, size, _, bins = blocks.shape
    for c in range(channels):
        for row in range(first, last):
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
