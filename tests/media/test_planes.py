"""Luma and chroma planes, by swscale, by OpenCV and by hand."""

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import textured_image
from vehicle_detection.media.planes import planes_of


def smooth_image(rows=48, columns=64, seed=0):
    """A picture whose colours change slowly, so that it does not matter how chroma is sampled."""
    coarse = np.random.default_rng(seed).integers(0, 256, (4, 5, 3), np.uint8)
    return cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)


@pytest.mark.parametrize("matrix", [0, 1, 2, 4, 5, 6, 7, 8, 9, 10])
def test_planes_are_those_of_swscale(matrix):
    img = smooth_image()
    frame = av.VideoFrame.from_ndarray(img, "rgb24").reformat(
        format="yuv420p", dst_colorspace=matrix, dst_color_range=1
    )
    difference = np.abs(planes_of(img, matrix) - frame.to_ndarray().astype(int))
    assert difference[:48].max() <= 1
    assert difference.max() <= 4 and difference.mean() < 0.5


def test_matrices_differ():
    img = smooth_image()
    assert np.abs(planes_of(img, 1) - planes_of(img, 5).astype(int)).max() > 10


@given(st.tuples(*[st.integers(0, 255)] * 3))
def test_opencv_reads_them_back(color):
    img = np.full((2, 2, 3), color, np.uint8)
    back = cv2.cvtColor(planes_of(img, 5), cv2.COLOR_YUV2RGB_I420)
    np.testing.assert_allclose(back, img.astype(int), atol=3)


def test_black_white_and_red_by_hand():
    planes = planes_of(np.full((2, 2, 3), 0, np.uint8), 1)
    assert planes.ravel().tolist() == [16] * 4 + [128, 128]
    planes = planes_of(np.full((2, 2, 3), 255, np.uint8), 1)
    assert planes.ravel().tolist() == [235] * 4 + [128, 128]
    red = np.full((2, 2, 3), (255, 0, 0), np.uint8)
    # 16 + 219 * 0.2126, 128 - 224 * 0.2126 / (2 - 2 * 0.0722), 128 + 112.
    assert planes_of(red, 1).ravel().tolist() == [63] * 4 + [102, 240]


def test_colour_is_the_mean_of_four_pixels():
    img = textured_image(0, 2, 2)
    mean = np.full((2, 2, 3), img.mean((0, 1)).round(), np.uint8)
    np.testing.assert_allclose(planes_of(img, 5)[2], planes_of(mean, 5)[2], atol=1)


@pytest.mark.parametrize("shape", [(33, 48), (32, 47), (33, 47)])
def test_odd_sides_get_a_pixel_more(shape):
    img = textured_image(0, *shape)
    padded = np.pad(img, ((0, shape[0] % 2), (0, shape[1] % 2), (0, 0)), "edge")
    np.testing.assert_array_equal(planes_of(img, 5), planes_of(padded, 5))
