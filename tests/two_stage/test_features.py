"""Patches of the second stage and their features, against scikit-image."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation
from skimage.feature import hog

from conftest import lengths_and_units, random_boxes, textured_image
from pipeline_functions import convert_color
from vehicle_detection.compiled.hog import cell_histograms
from vehicle_detection.two_stage.features import (
    CELL_FEATURES,
    N_BORDERS,
    N_FEATURES,
    ORIENTATIONS,
    PATCH_CELL,
    PATCH_CELLS,
    PATCH_MARGIN,
    PATCH_SIDE,
    cut_out,
    cut_patches,
    describe_patches,
    luma_and_chroma,
    margins_outside,
    on_whole_pixels,
    relative_colors,
)
from vehicle_detection.two_stage.proposals import cell_features

SIDE = PATCH_CELLS * PATCH_CELL


def unit_histograms(channel, side):
    """Histograms of cells by scikit-image, each brought to unit length."""
    return hog(
        channel, ORIENTATIONS, (side, side), (1, 1), "L2",
        transform_sqrt=True, feature_vector=False,
    )[:, :, 0, 0]  # fmt: skip


@settings(max_examples=60)
@given(
    left=st.integers(-90, 90),
    top=st.integers(-90, 90),
    width=st.integers(1, 70),
    height=st.integers(1, 70),
)
def test_outside_of_the_frame_its_edge_goes_on(left, top, width, height):
    img = textured_image(1, 40, 60)
    rows = np.clip(np.arange(top, top + height), 0, 39)
    columns = np.clip(np.arange(left, left + width), 0, 59)
    cut = cut_out(img, (left, top, left + width, top + height), (width, height))
    np.testing.assert_array_equal(cut, img[rows][:, columns])
    small = cut_out(img, (left, top, left + width, top + height), (9, 7))
    expected = cv2.resize(img[rows][:, columns], (9, 7), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_array_equal(small, expected)


@settings(max_examples=60)
@given(count=st.integers(0, 6), seed=st.integers(0, 10_000))
def test_boxes_on_whole_pixels_stay_where_they_are(count, seed):
    boxes = random_boxes(np.random.default_rng(seed), count)
    whole = on_whole_pixels(boxes)
    assert np.abs(whole - boxes).max(initial=0) < 1
    margins = np.tile(whole[:, 2:] - whole[:, :2], 2) * PATCH_MARGIN / PATCH_CELLS
    ends = whole + margins * (-1, -1, 1, 1)
    np.testing.assert_allclose(ends, ends.round(), atol=1e-9)
    np.testing.assert_allclose(on_whole_pixels(whole), whole, atol=1e-9)


def lengths_of(img, cell):
    """Lengths of the histograms of an image's cells, shape (channels, rows, columns)."""
    return np.linalg.norm(cell_histograms(img, ORIENTATIONS, cell), axis=-1)


def described(img, boxes):
    """Cells of boxes, shape (n, PATCH_SIDE, PATCH_SIDE, CELL_FEATURES), and their borders."""
    outside = margins_outside(boxes, img.shape)
    features = describe_patches(cut_patches(img, boxes), outside)
    assert features.shape == (len(boxes), N_FEATURES) and features.dtype == np.float32
    shape = len(boxes), PATCH_SIDE, PATCH_SIDE, CELL_FEATURES
    return features[:, :-N_BORDERS].reshape(shape), features[:, -N_BORDERS:]


def test_patches_hold_hog_relative_colours_and_borders():
    img = textured_image(2, 240, 320)
    boxes = on_whole_pixels(np.array([(30.0, 40, 30 + SIDE, 40 + SIDE), (100.5, 60.2, 330, 170)]))
    cells, borders = described(img, boxes)
    np.testing.assert_array_equal(borders, margins_outside(boxes, img.shape))
    assert borders[1, 2] == 1
    for box, own_cells, own_patch in zip(boxes, cells, cut_patches(img, boxes), strict=True):
        margin = np.tile(box[2:] - box[:2], 2) / PATCH_CELLS * (-1, -1, 1, 1)
        size = PATCH_SIDE * PATCH_CELL, PATCH_SIDE * PATCH_CELL
        patch = cut_out(img, (box + margin).round().astype(int), size)
        np.testing.assert_array_equal(own_patch, patch)
        patch = convert_color(patch, "YCrCb")
        lengths, units = lengths_and_units(own_cells[..., :ORIENTATIONS] ** 2)
        expected = unit_histograms(patch[..., 0], PATCH_CELL)
        np.testing.assert_allclose(units, expected, atol=1e-5)
        raw = lengths_of(patch[..., :1], PATCH_CELL)[0]
        np.testing.assert_allclose(lengths, raw / np.hypot(raw, raw.mean()), atol=1e-5)
        means = patch.reshape(PATCH_SIDE, PATCH_CELL, PATCH_SIDE, PATCH_CELL, 3).mean(axis=(1, 3))
        means = means / 255 - means[1:-1, 1:-1].mean(axis=(0, 1)) / 255
        spread = np.hypot(means[1:-1, 1:-1, 0].std(), 0.03)
        colors = own_cells[..., ORIENTATIONS:]
        # Means of cells are whole numbers.
        np.testing.assert_allclose(spread * colors[..., 0], means[..., 0], atol=0.004)
        np.testing.assert_allclose(colors[..., 1:], means[..., 1:], atol=0.004)


def test_no_patches_have_no_features():
    img, none = textured_image(2, 24, 32), np.empty((0, 4))
    side = PATCH_SIDE * PATCH_CELL
    assert cut_patches(img, none).shape == (0, side, side, 3)
    assert luma_and_chroma(cut_patches(img, none)).shape == (3, 0, side, side)
    cells, borders = described(img, none)
    assert len(cells) == len(borders) == 0


def as_planes(patches):
    """Patches whose colours are those of planes already."""
    return patches.astype(np.uint8).transpose(3, 0, 1, 2)


@settings(max_examples=30)
@given(gain=st.floats(0.5, 1), haze=st.floats(0, 30), seed=st.integers(0, 1000))
def test_relative_colours_know_no_exposure_or_haze(gain, haze, seed):
    rng, side = np.random.default_rng(seed), PATCH_SIDE * PATCH_CELL
    coarse = rng.choice([20.0, 200.0], size=(PATCH_SIDE, PATCH_SIDE, 1)) + rng.uniform(-9, 9, 3)
    patch = np.kron(coarse, np.ones((PATCH_CELL, PATCH_CELL, 1)))[None]
    darker = gain * patch + haze
    own, other = (relative_colors(as_planes(np.rint(p))) for p in (patch, darker))
    assert own.shape == (1, PATCH_SIDE, PATCH_SIDE, 3) and side == patch.shape[1]
    np.testing.assert_allclose(other[..., 0], own[..., 0], atol=0.06)
    np.testing.assert_allclose(other[..., 1:], gain * own[..., 1:], atol=0.01)
    plain = relative_colors(np.full((3, 1, side, side), 77, np.uint8))
    np.testing.assert_allclose(plain, 0, atol=1e-5)


@pytest.mark.parametrize("describe", ["window", "patch"])
def test_faint_noise_stays_small_and_exposure_changes_no_gradient(describe):
    rng = np.random.default_rng(4)
    img = np.full((160, 160, 3), 100, np.uint8)
    img[40:120, 40:120] = 180
    noisy = img + rng.integers(0, 3, img.shape).astype(np.uint8)

    def gradients(img):
        if describe == "window":
            return cell_features(img)[..., :ORIENTATIONS]
        return described(img, np.array([[16.0, 16, 144, 144]]))[0][0, ..., :ORIENTATIONS] ** 2

    plain, lengths = (np.linalg.norm(gradients(x), axis=2) for x in (img, noisy))
    at_edge = plain > 0.3
    beside = binary_dilation(at_edge, iterations=2) & ~at_edge
    assert at_edge.any() and beside.any()
    # Brought to unit length, cells of noise alone would be as long as edges.
    assert lengths[at_edge].min() > 2 * lengths[beside].max()
    np.testing.assert_allclose(gradients(img // 4), gradients(img), atol=0.02)


def test_margins_outside_are_shares_of_a_cell():
    # Boxes of 80 x 40, so margins of 10 x 5, in a frame of 200 x 100.
    boxes = np.array(
        [(0, 50, 80, 90), (7, 60, 87, 100), (116, 2, 196, 42), (-20, 20, 60, 60)], float
    )
    expected = [(1, 0, 0, 0), (0.3, 0, 0, 1), (0, 0.6, 0.6, 0), (1, 0, 0, 0)]
    np.testing.assert_allclose(margins_outside(boxes, (100, 200, 3)), expected, atol=1e-6)
    assert margins_outside(boxes[:0], (100, 200, 3)).shape == (0, N_BORDERS)
