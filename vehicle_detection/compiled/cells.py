"""Cells of an image as features, compiled: histograms held against those around, and colours."""

from __future__ import annotations

import numpy as np

from vehicle_detection.compiled.cache import compiled
from vehicle_detection.compiled.window_sums import SUMS

# Length of a cell without gradients, in roots of grey levels.
_LEAST_LENGTH = np.float32(1e-3)


def cell_lengths(histograms: np.ndarray) -> np.ndarray:
    """Euclidean length of the histogram of every cell, shape (..., orientations) to (...)."""
    *shape, orientations = histograms.shape
    lengths = np.empty(shape, np.float32)
    _lengths(histograms.reshape(lengths.size, orientations), lengths.reshape(-1))
    return lengths


def describe_cells(histograms: np.ndarray, around: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """HOG and colours of cells, each histogram divided by its length and that of those around.

    It is divided by the root of the squares of its own length and of the mean length
    around it. Blocks that are brought to unit length [1]_ show what noise there is in a plain
    cell as large as the edges of a vehicle. Here it stays small.

    Parameters
    ----------
    histograms : ndarray of float32, shape (..., orientations)
        See `compiled.hog.cell_histograms`.
    around : ndarray of float32, shape (...)
        Mean length around each cell, see `cell_lengths`; may be broadcast.
    colors : ndarray of float32, shape (..., n_colors)

    Returns
    -------
    features : ndarray of float32, shape (..., orientations + n_colors)
        The histogram of a cell as long as those around it is 0.7 long; none is longer than 1.

    Raises
    ------
    ValueError
        There are not as many colours as histograms.

    References
    ----------
    .. [1] N. Dalal and B. Triggs, "Histograms of Oriented Gradients for Human
           Detection", CVPR 2005.
    """
    *shape, orientations = histograms.shape
    if colors.shape[:-1] != histograms.shape[:-1]:
        raise ValueError(f"colours of {colors.shape} for cells of {histograms.shape}")
    around = np.broadcast_to(around, shape).ravel()
    histograms = histograms.reshape(around.size, orientations)
    colors = np.ascontiguousarray(colors).reshape(around.size, colors.shape[-1])
    features = np.empty((around.size, orientations + colors.shape[-1]), np.float32)
    _describe(histograms, around, colors, features)
    return features.reshape(*shape, features.shape[-1])


@compiled(error_model="numpy", fastmath=SUMS)
def _lengths(histograms, lengths):
    """`cell_lengths` of cells in a row."""
    for i in range(len(histograms)):
        squares = np.float32(0)
        for n in range(histograms.shape[1]):
            squares += histograms[i, n] ** 2
        lengths[i] = np.sqrt(squares)


@compiled(error_model="numpy", fastmath=SUMS)
def _describe(histograms, around, colors, features):
    """`describe_cells` of cells in a row."""
    orientations = histograms.shape[1]
    for i in range(len(histograms)):
        squares = around[i] ** 2 + _LEAST_LENGTH**2
        for n in range(orientations):
            squares += histograms[i, n] ** 2
        scale = np.float32(1) / np.sqrt(squares)
        for n in range(orientations):
            features[i, n] = histograms[i, n] * scale
        for n in range(colors.shape[1]):
            features[i, orientations + n] = colors[i, n]
