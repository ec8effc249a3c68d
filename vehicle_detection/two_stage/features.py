"""Features of the second stage: a box and its margin as a patch, described cell by cell.

frame, boxes -> patches -> planes of luma and chroma -> cells -> feature vectors

A patch shows a box as 8 x 8 cells with a margin of one cell around it. Frames and patches
are RGB, uint8. Boxes are float arrays of shape (n, 4): left, top, right, bottom in pixels of
the frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vehicle_detection.compiled.cells import cell_lengths, describe_cells
from vehicle_detection.compiled.hog import cell_histograms

# These numbers are part of the format of the parameter file.
ORIENTATIONS = 9
PATCH_CELLS = 8
PATCH_MARGIN = 1
# Side of a cell in pixels of the patch.
PATCH_CELL = 6
PATCH_SIDE = PATCH_CELLS + 2 * PATCH_MARGIN
# HOG of the luma, mean colour.
CELL_FEATURES = ORIENTATIONS + 3
# Left, top, right, bottom: how much of the margin is outside of the frame.
N_BORDERS = 4
N_FEATURES = PATCH_SIDE**2 * CELL_FEATURES + N_BORDERS
_INNER = slice(PATCH_MARGIN, PATCH_MARGIN + PATCH_CELLS)

# Spread of the luma of a plain box, as a share of white.
_LEAST_SPREAD = np.float32(0.03)


def cut_out(img: np.ndarray, box: Sequence, size: tuple) -> np.ndarray:
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


def on_whole_pixels(boxes: np.ndarray) -> np.ndarray:
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


def cut_patches(img: np.ndarray, boxes: np.ndarray) -> np.ndarray:
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


def luma_and_chroma(patches: np.ndarray) -> np.ndarray:
    """Every patch in YCrCb, channel by channel.

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
        whole = cv2.cvtColor(patches.reshape(n * rows, columns, 3), cv2.COLOR_RGB2YCrCb)
        cv2.split(whole, list(planes.reshape(3, n * rows, columns)))
    return planes


def describe_patches(patches: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """HOG of the luma and relative colours of the cells of every patch, and what lies outside.

    What surrounds a box tells a vehicle from a part of one, and from a window of a house.
    HOG of the chroma is left out: with it, vehicles of a camera that was not learned from
    score low. Of HOG the square roots are taken, as of SIFT [1]_: otherwise the distance of
    two patches would be that of their strongest edges, and the faint ones would not count.

    Parameters
    ----------
    patches : ndarray of uint8, shape (n, rows, columns, 3)
        RGB, see `cut_patches`.
    outside : ndarray of float, shape (n, N_BORDERS)
        See `margins_outside`.

    Returns
    -------
    features : ndarray of float32, shape (n, N_FEATURES)

    References
    ----------
    .. [1] R. Arandjelovic and A. Zisserman, "Three things everyone should know to
           improve object retrieval", CVPR 2012.
    """
    planes = luma_and_chroma(patches)
    histograms = _patch_histograms(planes[0])
    around = cell_lengths(histograms).mean(axis=(1, 2), keepdims=True)
    cells = describe_cells(histograms, around, relative_colors(planes))
    np.sqrt(cells[..., :ORIENTATIONS], out=cells[..., :ORIENTATIONS])
    cells = cells.reshape(len(patches), N_FEATURES - N_BORDERS)
    return np.hstack([cells, outside], dtype=np.float32)


def _patch_histograms(patches):
    """`compiled.hog.cell_histograms` of planes, shape (n, side, side, orientations)."""
    n, rows, columns = patches.shape
    if not n:
        return np.empty((0, PATCH_SIDE, PATCH_SIDE, ORIENTATIONS), np.float32)
    # All patches are the channels of one image, for a pass of HOG has its price.
    channels = patches.transpose(1, 2, 0)
    return cell_histograms(channels, ORIENTATIONS, rows // PATCH_SIDE)


def relative_colors(planes: np.ndarray) -> np.ndarray:
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


def margins_outside(boxes: np.ndarray, frame_shape: tuple) -> np.ndarray:
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
