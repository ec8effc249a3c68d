"""Luma and chroma planes, by swscale, by OpenCV and by hand."""

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import textured_image
from vehicle_detection.media.planes import to_planes


def smooth_image(rows=48, columns=64, seed=0):
    """A picture whose colours change slowly, so that it hardly matters how chroma is sampled."""
    coarse = np.random.default_rng(seed).integers(0, 256, (4, 5, 3), np.uint8)
    return cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)


def bytes_of(img, matrix):
    """The planes, one after the other."""
    return to_planes(img, matrix).to_ndarray().astype(int)


def plain(color):
    """Two by two pixels of a colour."""
    return np.full((2, 2, 3), color, np.uint8)


@pytest.mark.parametrize("shape", [(48, 64), (50, 66), (54, 98), (270, 480)])
@pytest.mark.parametrize("matrix", [0, 1, 2, 4, 5, 6, 7, 9])
def test_planes_are_those_of_swscale(matrix, shape):
    img = smooth_image(*shape)
    frame = av.VideoFrame.from_ndarray(img, "rgb24").reformat(
        format="yuv420p", dst_colorspace=matrix, dst_color_range=1
    )
    planes = bytes_of(img, matrix)
    difference = np.abs(planes - frame.to_ndarray())
    assert planes.shape == (shape[0] * 3 // 2, shape[1])
    assert difference[: shape[0]].max() <= 1
    assert difference.max() <= 4 and difference.mean() < 0.5


@given(st.tuples(*[st.integers(0, 255)] * 3))
def test_opencv_reads_them_back(color):
    planes = to_planes(plain(color), 5).to_ndarray()
    back = cv2.cvtColor(planes, cv2.COLOR_YUV2RGB_I420)
    np.testing.assert_allclose(back, plain(color).astype(int), atol=3)


def test_colours_by_hand():
    assert bytes_of(plain(0), 1).ravel().tolist() == [16] * 4 + [128, 128]
    assert bytes_of(plain(255), 1).ravel().tolist() == [235] * 4 + [128, 128]
    # 16 + 219 * 0.2126, 128 - 224 * 0.2126 / (2 - 2 * 0.0722), 128 + 112.
    assert bytes_of(plain((255, 0, 0)), 1).ravel().tolist() == [63] * 4 + [102, 240]
    # 16 + 219 * 0.59, 128 - 224 * 0.59 / (2 - 2 * 0.11), 128 - 224 * 0.59 / (2 - 2 * 0.3).
    assert bytes_of(plain((0, 255, 0)), 4).ravel().tolist() == [145] * 4 + [54, 34]


def test_colour_is_the_mean_of_four_pixels():
    img = textured_image(0, 2, 2)
    mean = plain(img.mean((0, 1)).round())
    np.testing.assert_allclose(bytes_of(img, 5)[2], bytes_of(mean, 5)[2], atol=1)


@pytest.mark.parametrize("shape", [(33, 48), (32, 47), (33, 47), (1, 1)])
def test_odd_sides_get_a_pixel_more(shape):
    img = textured_image(0, *shape)
    padded = np.pad(img, ((0, shape[0] % 2), (0, shape[1] % 2), (0, 0)), "edge")
    np.testing.assert_array_equal(bytes_of(img, 5), bytes_of(padded, 5))


def test_pictures_need_not_lie_in_one_piece():
    img = smooth_image()
    for view in (img[:, ::-1], img[::-1], img[::2, ::2], img[..., ::-1]):
        np.testing.assert_array_equal(bytes_of(view, 1), bytes_of(view.copy(), 1))
