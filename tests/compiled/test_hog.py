"""Dense HOG against scikit-image's, above all on the edges between bins."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.feature import hog

from conftest import textured_image
from vehicle_detection.compiled.hog import cell_histograms, hog_blocks
from vehicle_detection.compiled.window_sums import correlate, sums_at, tile_histograms


def reference(img, orientations, cell, block):
    return [
        hog(
            img[..., c], orientations, (cell, cell), (block, block),
            block_norm="L2-Hys", transform_sqrt=True, feature_vector=False,
        )
        for c in range(img.shape[2])
    ]  # fmt: skip


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    rows=st.integers(16, 70),
    columns=st.integers(16, 90),
    orientations=st.integers(1, 18),
    cell=st.integers(2, 16),
    block=st.integers(1, 3),
)
def test_equals_scikit_image(seed, rows, columns, orientations, cell, block):
    img = textured_image(seed, rows, columns)
    if min(rows, columns) < cell * block:
        with pytest.raises(ValueError, match="smaller than one HOG block"):
            hog_blocks(img, orientations, cell, block)
        return
    expected = reference(img, orientations, cell, block)
    np.testing.assert_allclose(hog_blocks(img, orientations, cell, block), expected, atol=2e-6)


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10_000),
    orientations=st.sampled_from([2, 3, 4, 6, 8, 9, 12, 16]),
    levels=st.sampled_from(
        [(0, 255), (0, 1, 2, 4, 8), (0, 3, 12, 27), (1, 4, 9, 16), (0, 50, 100, 200)]
    ),
)
def test_gradients_on_the_edge_of_a_bin(seed, orientations, levels):
    # Few levels, chosen for their square roots: axes, diagonals, 30, 60, 22.5
    # degrees turn up all over, and rounding alone decides between two bins.
    rng = np.random.default_rng(seed)
    img = rng.choice(np.array(levels, np.uint8), size=(48, 48, 2))
    expected = reference(img, orientations, 8, 2)
    np.testing.assert_allclose(hog_blocks(img, orientations, 8, 2), expected, atol=2e-6)


def test_more_undecided_pixels_than_there_is_room_for_at_first():
    # Gradients of 30 and 60 degrees, edges of bins, in every third pixel.
    img = np.random.default_rng(0).choice(np.array([0, 1, 3, 4], np.uint8), size=(160, 160, 1))
    expected = reference(img, 12, 8, 2)
    np.testing.assert_allclose(hog_blocks(img, 12, 8, 2), expected, atol=2e-6)


def test_flat_image_has_no_gradient():
    assert not hog_blocks(np.full((16, 16, 1), 77, np.uint8), 9, 8, 1).any()


def test_vertical_edge_is_in_the_first_bin():
    img = np.zeros((16, 16, 1), np.uint8)
    img[:, 8:] = 100
    blocks = hog_blocks(img, 8, 16, 1)
    np.testing.assert_allclose(blocks.ravel(), [1, 0, 0, 0, 0, 0, 0, 0], atol=1e-6)


def test_histograms_of_cells_hold_all_gradients():
    img = textured_image(3, 40, 60)
    roots = np.sqrt(img.astype(float))
    x, y = np.zeros_like(roots), np.zeros_like(roots)
    x[:, 1:-1] = roots[:, 2:] - roots[:, :-2]
    y[1:-1] = roots[2:] - roots[:-2]
    cells = np.hypot(x, y).reshape(5, 8, 60, 3)[:, :, :56].reshape(5, 8, 7, 8, 3).mean(axis=(1, 3))
    histograms = cell_histograms(img, 9, 8)
    assert histograms.shape == (3, 5, 7, 9)
    np.testing.assert_allclose(histograms.sum(axis=3), np.moveaxis(cells, 2, 0), rtol=1e-5)


@pytest.mark.parametrize("shape", [(7, 40, 1), (40, 7, 1)])
def test_refuses_what_holds_no_cell(shape):
    with pytest.raises(ValueError, match="smaller than one HOG cell"):
        cell_histograms(np.zeros(shape, np.uint8), 9, 8)


@pytest.mark.parametrize("img", [np.zeros((16, 16, 3), np.float32), np.zeros((16, 16), np.uint8)])
def test_refuses_what_is_no_image(img):
    with pytest.raises(ValueError, match="needs uint8 channels"):
        hog_blocks(img, 9, 8, 2)


def test_tile_histograms_by_numpy():
    channel = textured_image(3, 40, 56)[..., 1]
    bin_of_value = np.arange(256) // 32
    tiles = tile_histograms(channel, bin_of_value, 8, 8)
    assert tiles.shape == (5, 7, 8)
    for row in range(5):
        for column in range(7):
            tile = channel[8 * row : 8 * row + 8, 8 * column : 8 * column + 8]
            expected, _ = np.histogram(tile, 8, (0, 256))
            np.testing.assert_array_equal(tiles[row, column], expected)


@given(
    st.sampled_from([np.uint8, np.int64, np.float32]),
    st.tuples(*[st.integers(1, 4)] * 6),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
)
def test_correlate_is_the_sum_over_windows(dtype, sides, step, seed):
    rng = np.random.default_rng(seed)
    *shape, height, width, depth, spare = sides
    rows, columns = (step * (n - 1) + side for n, side in zip(shape, (height, width), strict=True))
    cells = rng.integers(0, 200, (rows + spare - 1, columns, depth)).astype(dtype)
    weights = rng.normal(size=(height, width, depth)).astype(np.float32)
    expected = [
        [
            (cells[i * step : i * step + height, k * step : k * step + width] * weights).sum()
            for k in range(shape[1])
        ]
        for i in range(shape[0])
    ]
    np.testing.assert_allclose(correlate(cells, weights, step, shape), expected, atol=0.05)


def test_correlate_refuses_windows_outside():
    cells, weights = np.zeros((4, 6, 2), np.float32), np.ones((2, 2, 2), np.float32)
    assert correlate(cells, weights, 2, (2, 3)).shape == (2, 3)
    with pytest.raises(ValueError, match="windows reach"):
        correlate(cells, weights, 2, (2, 4))
    with pytest.raises(ValueError, match="windows reach"):
        correlate(cells, weights, 2, (3, 3))
    with pytest.raises(ValueError, match="weights of"):
        correlate(cells, weights[..., :1], 2, (2, 3))


@given(st.tuples(*[st.integers(1, 5)] * 5), st.integers(0, 4), st.integers(0, 2**32 - 1))
def test_sums_at_windows_that_may_lie_outside(sides, n_windows, seed):
    rows, columns, depth, height, width = sides
    rng = np.random.default_rng(seed)
    cells = rng.normal(size=(rows, columns, depth)).astype(np.float32)
    weights = rng.normal(size=(height, width, depth, 4)).astype(np.float32)
    corners = rng.integers(-7, 8, size=(n_windows, 2))
    padded = np.pad(cells, ((12, 12), (12, 12), (0, 0)), mode="edge")
    windows = [padded[y + 12 : y + 12 + height, x + 12 : x + 12 + width] for x, y in corners]
    expected = np.array([np.tensordot(window, weights, 3) for window in windows]).reshape(-1, 4)
    np.testing.assert_allclose(sums_at(cells, corners, weights), expected, atol=1e-3)


def test_sums_at_refuses_what_does_not_fit():
    cells, corners = np.zeros((4, 6, 2), np.float32), np.zeros((1, 2), int)
    for shape in ((2, 2, 3, 4), (2, 2, 2, 3)):
        with pytest.raises(ValueError, match="weights of"):
            sums_at(cells, corners, np.ones(shape, np.float32))
    with pytest.raises(ValueError, match="weights of"):
        sums_at(cells[:0], corners, np.ones((2, 2, 2, 4), np.float32))
