"""Every function of the flat module against an independent computation."""

import colorsys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from conftest import random_classifier, textured_image
from experiments import reference
from pipeline_functions import (
    _IMAGES_PER_STRIP,
    HeatGrid,
    add_heat,
    apply_threshold,
    bin_spatial,
    color_hist,
    convert_color,
    dense_features,
    draw_boxes,
    draw_labeled_bboxes,
    extract_features,
    find_blobs,
    find_cars,
    get_hog_features,
    keep_lasting_heat,
    labeled_boxes,
    slide_window,
    try_search,
)
from vehicle_detection.parameters import (
    FEATURE_PRESETS,
    SEARCH_PRESETS,
    FeatureParams,
    SearchParams,
)

COLORS = ["RGB", "YCrCb", "HSV", "HLS", "LUV", "YUV", "Lab", "gray"]

# -------------------------------------------------------------------- colour


@pytest.mark.parametrize("rgb", [(255, 0, 0), (0, 255, 0), (0, 0, 255), (200, 100, 50)])
def test_convert_color_takes_rgb(rgb):
    img = np.full((1, 1, 3), rgb, np.uint8)
    red, green, blue = np.array(rgb) / 255
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    np.testing.assert_allclose(
        convert_color(img, "HLS")[0, 0], (hue * 180, lightness * 255, saturation * 255), atol=1
    )
    hue, saturation, value = colorsys.rgb_to_hsv(red, green, blue)
    np.testing.assert_allclose(
        convert_color(img, "HSV")[0, 0], (hue * 180, saturation * 255, value * 255), atol=1
    )
    chroma = 128 + 255 * np.array([0.713 * (red - luma), 0.564 * (blue - luma)])
    np.testing.assert_allclose(
        convert_color(img, "YCrCb")[0, 0], np.clip([luma * 255, *chroma], 0, 255), atol=1.5
    )
    chroma = 128 + 255 * np.array([0.492 * (blue - luma), 0.877 * (red - luma)])
    np.testing.assert_allclose(
        convert_color(img, "YUV")[0, 0], np.clip([luma * 255, *chroma], 0, 255), atol=1.5
    )
    np.testing.assert_allclose(convert_color(img, "gray")[0, 0], luma * 255, atol=1)
    np.testing.assert_array_equal(convert_color(img, "RGB"), img)


@pytest.mark.parametrize("conv, function", [("Lab", "rgb2lab"), ("LUV", "rgb2luv")])
def test_cie_colors_by_scikit_image(conv, function):
    from skimage import color

    img = textured_image(0, 20, 20)
    exact = getattr(color, function)(img)
    # OpenCV's 8-bit ranges: L to 255; a, b shifted by 128; u, v stretched.
    if conv == "Lab":
        expected = exact * (2.55, 1, 1) + (0, 128, 128)
    else:
        expected = exact * (2.55, 255 / 354, 255 / 262) + (0, 134 * 255 / 354, 140 * 255 / 262)
    np.testing.assert_allclose(convert_color(img, conv), expected, atol=2.5)


def test_convert_color_refuses():
    with pytest.raises(ValueError, match="unknown colour space 'BGR'"):
        convert_color(np.zeros((2, 2, 3), np.uint8), "BGR")
    for img in (np.zeros((2, 2), np.uint8), np.zeros((2, 2, 3)), np.zeros((2, 2, 4), np.uint8)):
        with pytest.raises(ValueError, match="not an RGB uint8 image"):
            convert_color(img, "HLS")


# ------------------------------------------------------------------ features


def test_bin_spatial_averages_the_middle():
    img = textured_image(1, 64, 64)
    blocks = img.reshape(16, 4, 16, 4, 3)[:, 1:3, :, 1:3].astype(float)
    expected = np.floor(blocks.mean(axis=(1, 3)) + 0.5).ravel()
    np.testing.assert_array_equal(bin_spatial(img, 16), expected)


def test_color_hist_counts_each_channel():
    img = np.array([[[0, 7, 255], [8, 8, 255]]], np.uint8)
    counts = color_hist(img, nbins=32).reshape(3, 32)
    assert counts[0, 0] == 1 and counts[0, 1] == 1
    assert counts[1, 0] == 1 and counts[1, 1] == 1
    assert counts[2, 31] == 2
    assert counts.sum() == 6


def test_get_hog_features_and_picture():
    channel = textured_image(2, 64, 64)[..., 0]
    params = FeatureParams(hog_color="RGB", orientations=9, cells_per_block=2)
    expected = reference.hog_of_channel(channel, params)
    blocks = get_hog_features(channel, 9, 8, 2, feature_vec=False)
    np.testing.assert_allclose(blocks, expected, atol=2e-6)
    features, picture = get_hog_features(channel, 9, 8, 2, vis=True)
    np.testing.assert_allclose(features, expected.ravel(), atol=2e-6)
    assert picture.shape == channel.shape and picture.max() > 0


def test_presets_have_the_published_lengths():
    assert FEATURE_PRESETS["G"].n_features == 2304
    assert FEATURE_PRESETS["B"].n_features == 8460


@pytest.mark.parametrize("preset", ["G", "B"])
def test_extract_features_is_its_parts(preset):
    params = FEATURE_PRESETS[preset]
    img = textured_image(4, 64, 64)
    features = extract_features(img[None], params)[0]
    assert features.shape == (params.n_features,) and features.dtype == np.float32
    converted = convert_color(img, params.hog_color)
    parts = [bin_spatial(converted, params.spatial_size)]
    if params.hist_color:
        parts.append(color_hist(converted, params.hist_bins))
    for c in range(3):
        block = reference.hog_of_channel(converted[..., c], params)
        parts.append(block.ravel())
    np.testing.assert_allclose(features, np.concatenate(parts), atol=2e-6)


def test_extract_features_refuses_another_size():
    with pytest.raises(ValueError, match="64x64"):
        extract_features(np.zeros((1, 64, 65, 3), np.uint8), FEATURE_PRESETS["G"])


@st.composite
def feature_params(draw):
    """Any features that the parameters allow."""
    color = st.sampled_from([None, *COLORS])
    hog_color = draw(color)
    channels = ["ALL", 0] if hog_color == "gray" else ["ALL", 0, 1, 2]
    window = draw(st.sampled_from([32, 64, 48]))
    divisors = [d for d in range(4, 33) if window % d == 0]
    cell = draw(st.sampled_from(divisors))
    spatial, hist = draw(color), draw(color)
    if not (spatial or hist or hog_color):
        hist = "RGB"
    return FeatureParams(
        spatial_color=spatial,
        spatial_size=draw(st.sampled_from([d for d in range(1, 65) if window % d == 0])),
        hist_color=hist,
        hist_bins=draw(st.integers(1, 64)),
        hog_color=hog_color,
        hog_channel=draw(st.sampled_from(channels)),
        orientations=draw(st.integers(1, 16)),
        pix_per_cell=cell,
        cells_per_block=draw(st.integers(1, min(3, window // cell))),
        window_size=window,
    )


@settings(max_examples=80)
@given(
    params=feature_params(),
    seed=st.integers(0, 1000),
    rows=st.integers(64, 110),
    columns=st.integers(64, 130),
    cells_per_step=st.integers(1, 4),
)
def test_dense_features_equal_single_windows(params, seed, rows, columns, cells_per_step):
    img = textured_image(seed, rows, columns)
    features = dense_features(img, params, cells_per_step)
    expected = reference.band_features(img, params, cells_per_step)
    assert features.shape == expected.shape
    np.testing.assert_allclose(features, expected, atol=2e-6)


@settings(max_examples=40)
@given(params=feature_params(), seed=st.integers(0, 1000), n_images=st.integers(1, 4))
def test_features_of_many_images_equal_those_of_each(params, seed, n_images):
    size = params.window_size
    images = np.stack([textured_image(seed + i, size, size) for i in range(n_images)])
    expected = [reference.band_features(img, params, 1)[0, 0] for img in images]
    np.testing.assert_allclose(extract_features(images, params), expected, atol=2e-6)


@pytest.mark.parametrize("pix_per_cell", [1, 2, 8, 64])
def test_features_of_more_images_than_a_strip_holds(pix_per_cell):
    n_images = 2 * _IMAGES_PER_STRIP + 1
    params = FeatureParams(hog_color="gray", pix_per_cell=pix_per_cell, cells_per_block=1)
    images = np.stack([textured_image(i, 64, 64) for i in range(n_images)])
    features = extract_features(images, params)
    for i in (0, _IMAGES_PER_STRIP - 1, _IMAGES_PER_STRIP, n_images - 1):
        expected = reference.band_features(images[i], params, 1)[0, 0]
        np.testing.assert_allclose(features[i], expected, atol=2e-6)


def test_features_of_no_image():
    nothing = np.zeros((0, 64, 64, 3), np.uint8)
    assert extract_features(nothing, FEATURE_PRESETS["B"]).shape == (0, 8460)


@pytest.mark.parametrize("spatial_size", [1, 2, 64])
def test_extreme_spatial_sizes(spatial_size):
    params = FeatureParams(spatial_color="RGB", spatial_size=spatial_size)
    img = textured_image(0, 65, 124)
    expected = reference.band_features(img, params, 1)
    np.testing.assert_array_equal(dense_features(img, params, 1), expected)


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"hog_color": "BGR"},
        {"spatial_color": "RGB", "spatial_size": 20},
        {"hog_color": "RGB", "pix_per_cell": 7},
        {"hog_color": "RGB", "cells_per_block": 9},
        {"hog_color": "RGB", "orientations": 0},
        {"hog_color": "RGB", "hog_channel": 3},
        {"hog_color": "gray", "hog_channel": 1},
    ],
)
def test_feature_params_refuse(wrong):
    with pytest.raises(ValueError):
        FeatureParams(**wrong)


# --------------------------------------------------------- windows and search


def test_slide_window_counts_of_preset_g():
    windows = slide_window((720, 1280, 3), FEATURE_PRESETS["G"], SEARCH_PRESETS["G"])
    sizes, counts = np.unique(windows[:, 2] - windows[:, 0], return_counts=True)
    assert dict(zip(sizes.tolist(), counts.tolist(), strict=True)) == {
        64: 539, 128: 148, 192: 69, 256: 34,
    }  # fmt: skip
    assert len(windows) == 790


@settings(max_examples=50)
@given(
    height=st.integers(200, 1100),
    width=st.integers(300, 2000),
    scale=st.floats(0.8, 4),
    top=st.integers(0, 400),
    rows=st.integers(280, 320),
    cells=st.integers(1, 8),
)
def test_windows_lie_in_their_band(height, width, scale, top, rows, cells):
    search = SearchParams(bands=((scale, top, top + rows),), cells_per_step=cells)
    params = FEATURE_PRESETS["G"]
    band_rows = round((top + rows) * height / 720) - round(top * height / 720)
    own_scale = scale * width / 1280
    if min(int(band_rows / own_scale), int(width / own_scale)) < 64:
        with pytest.raises(ValueError, match="no window fits"):
            slide_window((height, width), params, search)
        return
    left, upper, right, lower = slide_window((height, width), params, search).T
    assert left.min() == 0 and right.max() <= width
    assert upper.min() == round(top * height / 720)
    assert lower.max() <= round((top + rows) * height / 720)
    side = 64 * own_scale
    assert np.all(np.abs(right - left - side) <= 1)
    assert np.all(np.abs(lower - upper - side) <= 1)
    pitch = 8 * cells * own_scale
    gaps = np.diff(np.unique(left))
    assert np.all(np.abs(gaps - pitch) <= 1)
    # No further window would have fitted.
    assert right.max() + pitch > own_scale * int(width / own_scale) - 1


@settings(max_examples=20)
@given(
    params=feature_params(),
    seed=st.integers(0, 1000),
    height=st.integers(120, 200),
    width=st.integers(150, 260),
    scale=st.floats(0.9, 2.2),
    cells_per_step=st.integers(1, 3),
    kernel=st.sampled_from(["linear", "rbf"]),
)
def test_find_cars_equals_classifying_each_window(
    params, seed, height, width, scale, cells_per_step, kernel
):
    frame = textured_image(seed, height, width)
    classifier = random_classifier(params, seed, kernel)
    search = SearchParams(
        bands=((scale, 0, height), (scale * 1.3, height // 5, height)),
        cells_per_step=cells_per_step,
        reference_size=(width, height),
    )
    expected_windows, expected_scores = reference.find_cars(frame, classifier, search)
    if len(expected_windows) == 0:
        with pytest.raises(ValueError, match="no window fits"):
            find_cars(frame, classifier, search)
        return
    windows, scores = find_cars(frame, classifier, search)
    np.testing.assert_array_equal(windows, expected_windows)
    np.testing.assert_allclose(scores, expected_scores, atol=1e-4, rtol=1e-4)


def test_search_finds_the_one_window_it_was_made_for():
    params = FeatureParams(hist_color="RGB", hist_bins=8)
    search = SearchParams(bands=((1, 0, 128),), reference_size=(256, 128))
    frame = np.zeros((128, 256, 3), np.uint8)
    frame[32:96, 112:176, 0] = 255

    class Redness:
        linear = None

        def decision_function(self, features):
            return features[:, 7] - 4000

    Redness.params = params
    windows, scores = find_cars(frame, Redness(), search)
    np.testing.assert_array_equal(windows[scores > 0], [(112, 32, 176, 96)])


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    scale=st.floats(0.8, 2.5),
    cells_per_step=st.integers(1, 4),
    horizon=st.none() | st.integers(60, 200),
    n_boxes=st.integers(0, 3),
)
def test_visiting_less_scores_the_same(seed, scale, cells_per_step, horizon, n_boxes):
    rng = np.random.default_rng(seed)
    frame = textured_image(seed, 240, 320)
    classifier = random_classifier(FEATURE_PRESETS["G"], seed)
    everywhere = SearchParams(
        bands=((scale, 40, 240), (1, 0, 150)),
        cells_per_step=cells_per_step,
        reference_size=(320, 240),
    )
    corners = rng.integers(0, 200, size=(n_boxes, 2))
    boxes = np.hstack([corners, corners + rng.integers(20, 90, size=(n_boxes, 2))])
    windows, scores = find_cars(frame, classifier, everywhere)
    search = replace(everywhere, horizon=horizon)
    visited, visited_scores = find_cars(frame, classifier, search, boxes)

    def wanted(window):
        left, top, right, bottom = window
        x, y = (left + right) / 2, (top + bottom) / 2
        near = any(
            abs(x - (b[0] + b[2]) / 2) <= b[2] - b[0] and abs(y - (b[1] + b[3]) / 2) <= b[3] - b[1]
            for b in boxes
        )
        if horizon is None:
            return near
        size, below = right - left, bottom - horizon
        possible = 0.6 * below < size < 3.5 * below and abs(x - 160) < 7 * size + 320 / 6
        return near and possible

    chosen = np.array([wanted(window) for window in windows])
    np.testing.assert_array_equal(visited, windows[chosen])
    np.testing.assert_allclose(visited_scores, scores[chosen], atol=1e-4)


@pytest.mark.parametrize(
    "bands", [(), ((0, 0, 100),), ((1, 100, 100),), ((1, -1, 100),), ((1, 0, 721),)]
)
def test_search_params_refuse(bands):
    with pytest.raises(ValueError):
        SearchParams(bands=bands)


# ------------------------------------------------------------ heat and labels


def test_add_heat_counts_boxes():
    before = np.zeros((4, 5))
    heat = add_heat(before, [(0, 0, 2, 2), (1, 1, 5, 3)])
    expected = [[1, 1, 0, 0, 0], [1, 2, 1, 1, 1], [0, 1, 1, 1, 1], [0, 0, 0, 0, 0]]
    np.testing.assert_array_equal(heat, expected)
    assert not before.any()


def test_apply_threshold_is_strict():
    np.testing.assert_array_equal(apply_threshold(np.array([1, 2, 3]), 2), [0, 0, 3])


def random_boxes(rng, windows, count):
    return windows[rng.integers(len(windows), size=count)]


@settings(max_examples=25)
@given(
    seed=st.integers(0, 10_000),
    scale=st.floats(0.9, 3),
    n_frames=st.integers(1, 6),
    n_occ_thr=st.integers(1, 4),
    threshold=st.integers(0, 4),
)
def test_coarse_grid_equals_full_resolution(seed, scale, n_frames, n_occ_thr, threshold):
    rng = np.random.default_rng(seed)
    shape = (230, 310)
    search = SearchParams(
        bands=((scale, 20, 230), (1, 3, 150)), reference_size=(shape[1], shape[0])
    )
    windows = slide_window(shape, FEATURE_PRESETS["G"], search)
    grid = HeatGrid.of_windows(windows)
    hot = [random_boxes(rng, windows, rng.integers(0, 9)) for _ in range(n_frames)]
    coarse = np.array([add_heat(grid.zeros(), grid.to_cells(boxes)) for boxes in hot])
    full = [reference.heatmap_of(boxes, shape) for boxes in hot]
    for small, large in zip(coarse, full, strict=True):
        np.testing.assert_array_equal(grid.expand(small, shape), large)
    lasting = keep_lasting_heat(coarse, n_occ_thr)
    expected = reference.lasting_heat(full, n_occ_thr)
    np.testing.assert_array_equal(grid.expand(lasting, shape), expected)
    cells, peaks = find_blobs(apply_threshold(lasting, threshold))
    boxes = grid.to_pixels(cells)
    expected_boxes = reference.boxes_of(expected, threshold)
    np.testing.assert_array_equal(boxes, expected_boxes)
    for (left, top, right, bottom), peak in zip(boxes, peaks, strict=True):
        assert peak <= expected[top:bottom, left:right].max()
        assert peak > threshold


def test_keep_lasting_heat_by_hand():
    heatmaps = np.zeros((4, 3, 7))
    heatmaps[:3, 1, 1] = 2
    heatmaps[3, 1, 5] = 9
    np.testing.assert_array_equal(np.nonzero(keep_lasting_heat(heatmaps, 3)), [[1], [1]])
    assert keep_lasting_heat(heatmaps, 3)[1, 1] == 6
    assert keep_lasting_heat(heatmaps, 1)[1, 5] == 9


def test_labeled_boxes_and_blobs():
    heatmap = np.zeros((5, 8))
    heatmap[1:3, 2:4] = 3
    heatmap[2, 3] = 7
    heatmap[4, 6] = 1
    labels, _ = label(heatmap)
    np.testing.assert_array_equal(labeled_boxes(labels), [(2, 1, 4, 3), (6, 4, 7, 5)])
    boxes, peaks = find_blobs(heatmap)
    np.testing.assert_array_equal(boxes, labeled_boxes(labels))
    np.testing.assert_array_equal(peaks, [7, 1])
    boxes, peaks = find_blobs(np.zeros((3, 3)))
    assert boxes.shape == (0, 4) and peaks.shape == (0,)


# ------------------------------------------------------------------- drawing


def test_draw_boxes_paints_edges_on_a_copy():
    img = np.zeros((20, 30, 3), np.uint8)
    drawn = draw_boxes(img, [(5, 4, 15, 12)], color=(10, 20, 30), thickness=1)
    assert not img.any()
    painted = (drawn == (10, 20, 30)).all(axis=2)
    expected = np.zeros((20, 30), bool)
    expected[4:12, 5:15] = True
    expected[5:11, 6:14] = False
    np.testing.assert_array_equal(painted, expected)


def test_draw_labeled_bboxes_draws_every_label():
    labels = np.zeros((20, 30), int)
    labels[2:8, 3:9] = 1
    labels[10:18, 20:28] = 2
    img = np.zeros((20, 30, 3), np.uint8)
    drawn = draw_labeled_bboxes(img, labels, (1, 2, 3), 1)
    expected = draw_boxes(img, [(3, 2, 9, 8), (20, 10, 28, 18)], (1, 2, 3), 1)
    np.testing.assert_array_equal(drawn, expected)
    assert drawn.any()


def test_a_search_can_be_tried(classifier_g):
    img = textured_image(3, 720, 1280)
    (hot, channel), titles = try_search(img, classifier_g, 2, -7, "HLS")
    np.testing.assert_array_equal(channel, convert_color(img, "HLS")[..., 0])
    windows, scores = find_cars(img, classifier_g, SearchParams(bands=((2, 380, 720),)))
    np.testing.assert_array_equal(hot, draw_boxes(img, windows[scores > -7], thickness=2))
    assert 0 < (scores > -7).sum() < len(scores)
    assert titles == ["scale 2, above -7", "HLS, first channel"]
