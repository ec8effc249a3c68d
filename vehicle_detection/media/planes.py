"""RGB pictures as the planes of luma and chroma that video codecs take."""

from __future__ import annotations

import av
import cv2
import numpy as np

# Shares of red and blue in the luma by the number of the matrix: table 4 of H.273 [1]_.
#
# .. [1] ITU-T H.273, "Coding-independent code points for video signal type identification".
LUMA_SHARES = {
    1: (0.2126, 0.0722),
    4: (0.30, 0.11),
    5: (0.299, 0.114),
    6: (0.299, 0.114),
    7: (0.212, 0.087),
    9: (0.2627, 0.0593),
}
# FFmpeg takes BT.601's where a stream names none.
_BT601 = 5
# Of 8 bits: black, white less black, no colour, and the range of the chroma.
_BLACK, _LUMA_RANGE, _NEUTRAL, _CHROMA_RANGE = 16, 219, 128, 224


def to_planes(rgb: np.ndarray, matrix: int) -> av.VideoFrame:
    """A picture as 8-bit Y'CbCr of limited range, a colour sample for two by two pixels.

    Parameters
    ----------
    rgb : ndarray of uint8, shape (rows, columns, 3)
        RGB. A side of odd length gets a pixel more.
    matrix : int
        As H.273 numbers them. One that is not in `LUMA_SHARES` counts as BT.601's.

    Returns
    -------
    frame : VideoFrame
        Of format yuv420p.
    """
    below, right = rgb.shape[0] % 2, rgb.shape[1] % 2
    if below or right:
        rgb = cv2.copyMakeBorder(rgb, 0, below, 0, right, cv2.BORDER_REPLICATE)
    rows, columns, _ = rgb.shape
    # In steps, because OpenCV's own conversion knows BT.601 only, and swscale takes longer.
    ycbcr = cv2.transform(rgb, _to_ycbcr(matrix))
    frame = av.VideoFrame(columns, rows, "yuv420p")
    luma, *chroma = map(_pixels, frame.planes)
    whole = np.empty((2, rows, columns), np.uint8)
    cv2.split(ycbcr, [luma, *whole])
    for plane, small in zip(whole, chroma, strict=True):
        cv2.resize(plane, (columns // 2, rows // 2), small, interpolation=cv2.INTER_AREA)
    return frame


def _pixels(plane):
    """What is seen of a plane: a view of FFmpeg's memory, whose lines may be longer."""
    lines = np.frombuffer(plane, np.uint8).reshape(plane.height, plane.line_size)
    return lines[:, : plane.width]


def _to_ycbcr(matrix):
    """Weights of red, green and blue, and what is added, for Y', Cb and Cr; formulas of H.273."""
    red, blue = LUMA_SHARES.get(matrix, LUMA_SHARES[_BT601])
    luma = np.array([red, 1 - red - blue, blue])
    to_blue = (np.array([0, 0, 1]) - luma) / (2 - 2 * blue)
    to_red = (np.array([1, 0, 0]) - luma) / (2 - 2 * red)
    ranges = np.array([_LUMA_RANGE, _CHROMA_RANGE, _CHROMA_RANGE]) / 255
    weights = ranges[:, None] * np.stack([luma, to_blue, to_red])
    return np.column_stack([weights, [_BLACK, _NEUTRAL, _NEUTRAL]])
