"""The two-stage detector, against brute force and other libraries."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, uniform_filter
from skimage.feature import hog
from sklearn.metrics.pairwise import rbf_kernel

from conftest import random_detector, textured_image
from pipeline_functions import convert_color
from vehicle_detection.compiled.hog import cell_histograms
from vehicle_detection.parameters import ScanParams
from vehicle_detection.tracking.boxes import pairwise_iou
from vehicle_detection.two_stage.features import (
    CELL_FEATURES,
    CHROMA_FEATURES,
    COLOR,
    N_ALL_FEATURES,
    N_BORDERS,
    N_INNER_FEATURES,
    ORIENTATIONS,
    PATCH_CELL,
    PATCH_CELLS,
    PATCH_MARGIN,
    PATCH_SIDE,
    all_cells,
    cell_lengths,
    chroma_features,
    cut_out,
    cut_patches,
    inner_cells,
    luma_and_chroma,
    margins_outside,
    normalise_cells,
    on_whole_pixels,
    patch_features,
    relative_colors,
)
from vehicle_detection.two_stage.model import (
    FORMAT_VERSION,
    KernelMachine,
    Template,
    load_detector,
    save_detector,
)
from vehicle_detection.two_stage.proposals import (
    SURROUNDINGS,
    WINDOW_CELL,
    WINDOW_ROWS,
    cell_features,
    level_groups,
    near_horizon,
    propose,
    suppress,
    window_scores,
)
from vehicle_detection.two_stage.refinement import look_closer, move_edges
from vehicle_detection.two_stage.selection import are_plausible, keep_wholes

SIDE = PATCH_CELLS * PATCH_CELL


def random_boxes(rng, count, extent=200):
    corner = rng.uniform(0, extent, size=(count, 2))
    return np.hstack([corner, corner + rng.uniform(5, 90, size=(count, 2))])


# ------------------------------------------------------------------- windows


@settings(max_examples=40)
@given(
    width=st.integers(200, 2000),
    shape=st.floats(0.4, 0.8),
    ratio=st.floats(1.1, 1.5),
    n_groups=st.integers(1, 6),
)
def test_groups_share_out_all_levels(width, shape, ratio, n_groups):
    scan = ScanParams(ratio=ratio, n_groups=n_groups)
    frame = round(width * shape), width
    (every,) = level_groups(frame, replace(scan, n_groups=1))
    groups = level_groups(frame, scan)
    assert all(groups) and len(groups) <= n_groups
    assert sorted(map(repr, every)) == sorted(repr(level) for group in groups for level in group)
    heights = [WINDOW_ROWS * WINDOW_CELL * (a.bottom - a.top) / a.rows for a in every]
    assert abs(heights[0] - 32 * width / 1280) < 0.06 * heights[0]
    assert all(0 <= a.top < a.bottom <= frame[0] for a in every)
    # Levels are as fine as asked for, but for rounding.
    assert (np.diff(np.log(heights)) < np.log(ratio) + 0.1).all()


def test_a_frame_too_small_for_any_window_is_refused():
    with pytest.raises(ValueError, match="no window fits a frame of 300x4"):
        level_groups((4, 300), ScanParams())


@pytest.mark.parametrize(
    "wrong",
    [
        {"smallest": 0},
        {"smallest": 500},
        {"ratio": 1},
        {"horizon": (0.6, 0.4)},
        {"n_groups": 0},
        {"cells_per_step": 0},
        {"n_proposals": 0},
        {"n_entering": -1},
        {"overlap": 1},
    ],
)
def test_scan_params_refuse(wrong):
    with pytest.raises(ValueError):
        ScanParams(**wrong)


def unit_histograms(channel, side):
    """Histograms of cells by scikit-image, each brought to unit length."""
    return hog(
        channel, ORIENTATIONS, (side, side), (1, 1), "L2",
        transform_sqrt=True, feature_vector=False,
    )[:, :, 0, 0]  # fmt: skip


def lengths_and_units(cells):
    lengths = np.linalg.norm(cells, axis=-1)
    return lengths, cells / np.maximum(lengths, 1e-9)[..., None]


def test_cells_hold_hog_and_mean_colour():
    img = textured_image(3, 46, 61)
    features = cell_features(img)
    img = convert_color(img, COLOR)
    assert features.shape == (11, 15, CELL_FEATURES)
    lengths, units = lengths_and_units(features[..., :ORIENTATIONS])
    np.testing.assert_allclose(units, unit_histograms(img[..., 0], WINDOW_CELL), atol=1e-5)
    raw = np.linalg.norm(cell_histograms(img[..., :1], ORIENTATIONS, WINDOW_CELL)[0], axis=-1)
    around = uniform_filter(raw, SURROUNDINGS, mode="reflect")
    np.testing.assert_allclose(lengths, raw / np.hypot(raw, around), atol=1e-5)
    cell = img[8:12, 20:24].mean(axis=(0, 1)) / 255
    np.testing.assert_allclose(features[2, 5, ORIENTATIONS:], cell, atol=0.003)


def test_a_cell_is_held_against_what_is_around():
    histograms = np.array([[3.0, 4.0], [0.0, 0.0]], np.float32)
    lengths = cell_lengths(histograms)
    np.testing.assert_allclose(lengths, [5, 0])
    normalised = normalise_cells(histograms, lengths, np.float32(2.5))
    np.testing.assert_allclose(normalised, histograms / np.sqrt(25 + 6.25), atol=1e-6)
    nothing = np.zeros((2, 2), np.float32)
    assert not normalise_cells(nothing, cell_lengths(nothing), np.float32(0)).any()


@settings(max_examples=30)
@given(
    rows=st.integers(1, 20),
    columns=st.integers(1, 30),
    width=st.integers(1, 16),
    step=st.integers(1, 3),
    seed=st.integers(0, 1000),
)
def test_window_scores_are_products_at_every_place(rows, columns, width, step, seed):
    rng = np.random.default_rng(seed)
    features = rng.normal(size=(rows, columns, CELL_FEATURES)).astype(np.float32)
    weights = rng.normal(size=(WINDOW_ROWS, width, CELL_FEATURES)).astype(np.float32)
    scores = window_scores(features, Template(weights, 0.5), step)
    places = (
        range(0, max(0, side), step) for side in (rows - WINDOW_ROWS + 1, columns - width + 1)
    )
    tops, lefts = map(list, places)
    shape = len(tops), len(lefts)
    assert scores.shape == shape
    for i, k in np.ndindex(shape):
        window = features[tops[i] : tops[i] + WINDOW_ROWS, lefts[k] : lefts[k] + width]
        assert scores[i, k] == pytest.approx((window * weights).sum() + 0.5, abs=2e-3)


def test_a_window_is_proposed_where_its_pixels_are():
    img = np.full((360, 640, 3), 90, np.uint8)
    img[170:202, 300:344] = textured_image(5, 32, 44)
    scan = ScanParams(
        smallest=64, largest=64, cells_per_step=1, n_groups=1, threshold=-np.inf, n_proposals=1,
        n_entering=0,
    )  # fmt: skip
    ((level,),) = level_groups(img.shape, scan)
    strip = cv2.resize(img[level.top : level.bottom], (level.columns, level.rows))
    assert (level.rows, level.columns) == (level.bottom - level.top, 640)
    row, column = (170 - level.top) // WINDOW_CELL, 300 // WINDOW_CELL
    level_cells = cell_features(strip)
    wanted = level_cells[row : row + WINDOW_ROWS, column : column + 11]
    template = Template(wanted - level_cells.mean(axis=(0, 1)), 0.0)
    (box,), _ = propose(img, [level], (template,), scan)
    np.testing.assert_allclose(box, (300, 170, 344, 202), atol=WINDOW_CELL)


@pytest.mark.parametrize(
    "seen, expected",
    [(0.5, (0.45, 0.55)), (0.508, (0.45, 0.55)), (0.511, (0.47, 0.57)), (0.1, (0.4, 0.45)),
     (0.9, (0.55, 0.6))],
)  # fmt: skip
def test_the_horizon_is_narrowed_down_within_what_was_asked_for(seen, expected):
    scan = ScanParams(horizon=(0.4, 0.6), ratio=1.3)
    near = near_horizon(scan, seen, 0.8)
    assert near.horizon == pytest.approx(expected)
    # Below a high camera, vehicles are farther below the horizon.
    assert near_horizon(scan, seen, 1.3).horizon == pytest.approx((expected[0], 0.6))
    assert replace(near, horizon=scan.horizon) == scan


@settings(max_examples=20)
@given(n_proposals=st.integers(1, 4), n_entering=st.integers(0, 3), seed=st.integers(0, 1000))
def test_proposals_at_the_sides_are_added_to_the_best(n_proposals, n_entering, seed):
    img, templates = textured_image(seed, 90, 400), random_detector(seed).templates
    scan = ScanParams(
        smallest=150, largest=150, horizon=(0.1, 0.2), cells_per_step=1, n_groups=1,
        threshold=-np.inf, n_proposals=300, n_entering=0,
    )  # fmt: skip
    ((level,),) = level_groups(img.shape, scan)
    every, _ = propose(img, [level], templates, scan)
    scan = replace(scan, n_proposals=n_proposals, n_entering=n_entering)
    boxes, scores = propose(img, [level], templates, scan)
    cell = WINDOW_CELL * 400 / level.columns
    at_side = (every[:, 0] < 1.5 * cell) | (every[:, 2] > 400 - 1.5 * cell)
    entering = [i for i in range(n_proposals, len(every)) if at_side[i]][:n_entering]
    np.testing.assert_allclose(boxes, every[[*range(min(n_proposals, len(every))), *entering]])
    assert (np.diff(scores) <= 0).all()


@settings(max_examples=50)
@given(count=st.integers(0, 25), overlap=st.floats(0.1, 0.9), seed=st.integers(0, 10_000))
def test_suppression_is_greedy(count, overlap, seed):
    rng = np.random.default_rng(seed)
    boxes, scores = random_boxes(rng, count), rng.normal(size=count)
    iou, kept = pairwise_iou(boxes, boxes), []
    for i in np.argsort(-scores):
        if all(iou[i, k] <= overlap for k in kept):
            kept.append(i)
    assert suppress(boxes, scores, overlap).tolist() == kept


# -------------------------------------------------------------- closer look


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


def test_patches_hold_hog_and_relative_colours():
    img = textured_image(2, 240, 320)
    boxes = on_whole_pixels(np.array([(30.0, 40, 30 + SIDE, 40 + SIDE), (100.5, 60.2, 330, 170)]))
    patches = cut_patches(img, boxes)
    planes = luma_and_chroma(patches)
    luma, contrast = patch_features(planes)
    chroma = chroma_features(planes, contrast)
    assert luma.shape == (2, PATCH_SIDE, PATCH_SIDE, CELL_FEATURES)
    assert chroma.shape == (2, PATCH_SIDE, PATCH_SIDE, CHROMA_FEATURES)
    hog = np.concatenate([luma[..., :ORIENTATIONS], chroma], axis=-1)
    colors = luma[..., ORIENTATIONS:]
    for box, own_hog, own_colors, own_patch in zip(boxes, hog, colors, patches, strict=True):
        margin = np.tile(box[2:] - box[:2], 2) / PATCH_CELLS * (-1, -1, 1, 1)
        size = PATCH_SIDE * PATCH_CELL, PATCH_SIDE * PATCH_CELL
        patch = cut_out(img, (box + margin).round().astype(int), size)
        np.testing.assert_array_equal(own_patch, patch)
        patch = convert_color(patch, COLOR)
        # Chroma at half the size, each pixel the mean of four, halves rounded up.
        fours = patch.reshape(PATCH_SIDE * PATCH_CELL // 2, 2, -1, 2, 3).sum(axis=(1, 3))
        halved = ((fours + 2) // 4).astype(np.uint8)
        sources = (patch, PATCH_CELL), (halved, PATCH_CELL // 2), (halved, PATCH_CELL // 2)
        luma_length = lengths_of(patch, PATCH_CELL)[0].mean()
        for channel, own in enumerate(np.split(own_hog**2, 3, axis=-1)):
            source, cell = sources[channel]
            lengths, units = lengths_and_units(own)
            expected = unit_histograms(source[..., channel], cell)
            np.testing.assert_allclose(units, expected, atol=1e-5)
            # All of them are held against the luma.
            raw = lengths_of(source, cell)[channel]
            expected = raw / np.hypot(raw, luma_length)
            np.testing.assert_allclose(lengths, expected, atol=1e-5)
        cells = patch.reshape(PATCH_SIDE, PATCH_CELL, PATCH_SIDE, PATCH_CELL, 3).mean(axis=(1, 3))
        cells = cells / 255 - cells[1:-1, 1:-1].mean(axis=(0, 1)) / 255
        spread = np.hypot(cells[1:-1, 1:-1, 0].std(), 0.03)
        # Means of cells are whole numbers.
        np.testing.assert_allclose(spread * own_colors[..., 0], cells[..., 0], atol=0.004)
        np.testing.assert_allclose(own_colors[..., 1:], cells[..., 1:], atol=0.004)


def test_what_tells_vehicles_and_what_tells_edges():
    rng = np.random.default_rng(0)
    luma, chroma = (
        rng.normal(size=(2, PATCH_SIDE, PATCH_SIDE, n)) for n in (CELL_FEATURES, CHROMA_FEATURES)
    )
    outside = rng.random((2, N_BORDERS))
    every = np.concatenate([luma, chroma], axis=-1).reshape(2, N_ALL_FEATURES - N_BORDERS)
    np.testing.assert_array_equal(all_cells(luma, chroma, outside), np.hstack([every, outside]))
    inner = luma[:, 1:-1, 1:-1].reshape(2, N_INNER_FEATURES - N_BORDERS)
    np.testing.assert_array_equal(inner_cells(luma, outside), np.hstack([inner, outside]))


def test_no_patches_have_no_features():
    patches = cut_patches(textured_image(2, 24, 32), np.empty((0, 4)))
    side = PATCH_SIDE * PATCH_CELL
    assert patches.shape == (0, side, side, 3)
    planes = luma_and_chroma(patches)
    assert planes.shape == (3, 0, side, side)
    luma, contrast = patch_features(planes)
    assert luma.shape == (0, PATCH_SIDE, PATCH_SIDE, CELL_FEATURES) and contrast.shape == (0,)
    chroma = chroma_features(planes, contrast)
    assert chroma.shape == (0, PATCH_SIDE, PATCH_SIDE, CHROMA_FEATURES)


def as_planes(patches):
    """Patches whose colours are those of planes already."""
    return patches.astype(np.uint8).transpose(3, 0, 1, 2)


@settings(max_examples=30)
@given(gain=st.floats(0.5, 1), haze=st.floats(0, 30), seed=st.integers(0, 1000))
def test_relative_colours_know_no_exposure_or_haze(gain, haze, seed):
    rng, side = np.random.default_rng(seed), PATCH_SIDE * PATCH_CELL
    coarse = rng.choice([20.0, 220.0], size=(PATCH_SIDE, PATCH_SIDE, 1)) + rng.uniform(-9, 9, 3)
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
        patches = cut_patches(img, np.array([[16.0, 16, 144, 144]]))
        return patch_features(luma_and_chroma(patches))[0][0, ..., :ORIENTATIONS] ** 2

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


@settings(max_examples=20)
@given(count=st.integers(0, 6), seed=st.integers(0, 1000))
def test_kernel_machine_is_a_sum_of_gaussians(count, seed):
    rng = np.random.default_rng(seed)
    arrays = [
        rng.normal(size=shape).astype(np.float32) for shape in ((7, 30), 7, (50, 7), (4, 50), 4)
    ]
    machine = KernelMachine(*arrays, gamma=0.05)
    features = rng.normal(size=(count, 30)).astype(np.float32)
    projection, offset, centers, weights, bias = arrays
    expected = bias + (
        rbf_kernel(features @ projection.T + offset, centers, 0.05) @ weights.T if count else 0
    )
    np.testing.assert_allclose(
        machine.predict(features), np.broadcast_to(expected, (count, 4)), atol=1e-3
    )


def test_edges_move_by_shares_of_the_box():
    moved = move_edges(np.array([(100.0, 50, 200, 90)]), np.array([(-0.1, 0.25, 0.2, 0)]))
    np.testing.assert_allclose(moved, [(90, 60, 220, 90)])


def test_the_closer_look_scores_where_it_moved_the_box():
    img = textured_image(4, 240, 320)
    detector = random_detector(0)

    def described(box, cells):
        planes = luma_and_chroma(cut_patches(img, box[None]))
        outside = margins_outside(box[None], img.shape)
        luma, contrast = patch_features(planes)
        if cells is inner_cells:
            return inner_cells(luma, outside)
        return all_cells(luma, chroma_features(planes, contrast), outside)

    none, no_scores = look_closer(img, np.empty((0, 4)), detector)
    assert none.shape == (0, 4) and no_scores.shape == (0,)
    boxes = random_boxes(np.random.default_rng(0), 5)
    moved, scores = look_closer(img, boxes, detector)
    for box, own_box, score in zip(on_whole_pixels(boxes), moved, scores, strict=True):
        shift = detector.regressor.predict(described(box, all_cells))
        np.testing.assert_allclose(on_whole_pixels(move_edges(box[None], shift))[0], own_box)
        alone = detector.scorer.predict(described(own_box, inner_cells))
        assert score == pytest.approx(alone[0, 0], abs=1e-4)


def test_what_is_hopeless_where_it_was_proposed_is_not_moved():
    img, detector = textured_image(4, 240, 320), random_detector(0)
    boxes = on_whole_pixels(random_boxes(np.random.default_rng(0), 9))
    outside = margins_outside(boxes, img.shape)
    features, _ = patch_features(luma_and_chroma(cut_patches(img, boxes)))
    own = detector.scorer.predict(inner_cells(features, outside))[:, 0]
    # So that the middle one is at the limit, and half of them are below it.
    limited = detector.scorer.bias - np.float32(np.median(own) + 1)
    detector = replace(detector, scorer=replace(detector.scorer, bias=limited))
    hopeless = own < np.median(own)
    moved, scores = look_closer(img, boxes, detector)
    np.testing.assert_array_equal(moved[hopeless], boxes[hopeless])
    np.testing.assert_allclose(scores[hopeless], own[hopeless] - np.median(own) - 1, atol=1e-4)
    others = own > np.median(own)
    assert others.sum() == hopeless.sum() == 4
    assert (moved[others] != boxes[others]).any()


@settings(max_examples=50)
@given(count=st.integers(0, 12), seed=st.integers(0, 10_000))
def test_of_rivals_the_better_one_is_kept(count, seed):
    rng = np.random.default_rng(seed)
    boxes, scores = random_boxes(rng, count, 80), rng.normal(size=count)

    def rivals(a, b):
        width = min(a[2], b[2]) - max(a[0], b[0])
        height = min(a[3], b[3]) - max(a[1], b[1])
        common = max(0, width) * max(0, height)
        areas = [(x[2] - x[0]) * (x[3] - x[1]) for x in (a, b)]
        smaller, larger = (a, b) if areas[0] < areas[1] else (b, a)
        in_front = smaller[3] - larger[3] > 0.1 * (smaller[3] - smaller[1])
        is_part = common / min(areas) > 0.7 and not in_front
        return common / (sum(areas) - common) > 0.45 or is_part

    kept = []
    for i in np.argsort(-scores):
        if not any(rivals(boxes[i], boxes[k]) for k in kept):
            kept.append(i)
    assert keep_wholes(boxes, scores).tolist() == kept


def test_a_car_in_front_of_a_lorry_is_no_part_of_it():
    lorry = (100.0, 100, 200, 250)
    car, wheels = (120.0, 205, 180, 261), (120.0, 205, 180, 254)
    boxes, scores = np.array([lorry, car, wheels]), np.array([3.0, 2, 1])
    assert keep_wholes(boxes, scores).tolist() == [0, 1]
    assert keep_wholes(boxes[[0, 2]], scores[[0, 2]]).tolist() == [0]


def test_plausible_boxes_frame_a_vehicle():
    boxes = np.array(
        [
            (100, 100, 180, 150),
            (-90, 100, 60, 180),
            (100, 100, 130, 118),
            (100, 10, 900, 540),
            (100, 100, 130, 170),
            (100, 100, 400, 150),
            (-20, 100, 60, 150),
        ],
        float,
    )
    plausible = are_plausible(boxes, (720, 1280, 3), ScanParams(smallest=32, largest=400))
    assert plausible.tolist() == [True, False, False, False, False, False, True]
    half = are_plausible(boxes / 2, (360, 640, 3), ScanParams(smallest=32, largest=400))
    np.testing.assert_array_equal(plausible, half)


# ---------------------------------------------------------------------- file


def test_a_detector_is_read_as_it_was_written(tmp_path):
    detector = random_detector(1)
    save_detector(detector, tmp_path / "detector.npz")
    loaded = load_detector(tmp_path / "detector.npz")
    for old, new in zip(detector.templates, loaded.templates, strict=True):
        np.testing.assert_array_equal(old.weights, new.weights)
        assert old.bias == pytest.approx(new.bias)
    img, boxes = textured_image(4, 240, 320), random_boxes(np.random.default_rng(0), 5)
    for old, new in zip(
        look_closer(img, boxes, detector), look_closer(img, boxes, loaded), strict=True
    ):
        np.testing.assert_allclose(old, new, rtol=0.01, atol=0.02)


def test_what_is_no_detector_is_named(tmp_path):
    path = tmp_path / "detector.npz"
    with pytest.raises(FileNotFoundError, match=r"detector\.npz: no such parameter file"):
        load_detector(path)
    path.write_text("nothing of the kind")
    with pytest.raises(ValueError, match=r"detector\.npz: not a parameter file"):
        load_detector(path)
    save_detector(random_detector(1), path)
    whole = path.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:100]):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"detector\.npz: not a parameter file"):
            load_detector(path)
    good = random_detector(1)
    other = replace(good, scorer=good.regressor)
    save_detector(other, path)
    with pytest.raises(ValueError, match="an array of"):
        load_detector(path)
    np.savez(path, format_version=0)
    with pytest.raises(ValueError, match=f"format 0, not {FORMAT_VERSION}"):
        load_detector(path)
    np.savez(path, format_version=FORMAT_VERSION)
    with pytest.raises(ValueError, match=r"detector\.npz: not a parameter file.*template0"):
        load_detector(path)
