"""The first stage: levels, cells, window scores, proposals."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import uniform_filter
from skimage.feature import hog

from conftest import lengths_and_units, random_boxes, random_detector, textured_image
from pipeline_functions import convert_color
from vehicle_detection.compiled.hog import cell_histograms
from vehicle_detection.parameters import ScanParams
from vehicle_detection.tracking.boxes import pairwise_iou
from vehicle_detection.two_stage.features import CELL_FEATURES, ORIENTATIONS
from vehicle_detection.two_stage.model import Template
from vehicle_detection.two_stage.proposals import (
    SURROUNDINGS,
    WINDOW_CELL,
    WINDOW_CONTEXT,
    WINDOW_ROWS,
    best_windows,
    cell_features,
    level_groups,
    propose,
    suppress,
    window_scores,
    window_shifts,
)
from vehicle_detection.two_stage.road import Reach


def still_template(weights, bias):
    """A template that moves no edges."""
    rows, columns, _ = weights.shape
    shape = rows + 2 * WINDOW_CONTEXT, columns + 2 * WINDOW_CONTEXT, CELL_FEATURES, 4
    return Template(weights, bias, np.zeros(shape, np.float32), np.zeros(4, np.float32))


def still_templates(seed):
    """Random templates that move no edges."""
    return tuple(still_template(t.weights, t.bias) for t in random_detector(seed).templates)


def anywhere(n_rows):
    """Vehicles can stand in most of the frame."""
    return Reach(horizon=(0.3 * n_rows, 0.62 * n_rows), ratio=(0.2, 1.3))


@settings(max_examples=40)
@given(
    width=st.integers(200, 2000),
    shape=st.floats(0.4, 0.8),
    ratio=st.floats(1.1, 1.5),
    n_groups=st.integers(1, 6),
)
def test_groups_share_out_all_levels(width, shape, ratio, n_groups):
    scan = ScanParams(smallest=32, ratio=ratio, n_groups=n_groups)
    frame = round(width * shape), width
    (every,) = level_groups(frame, replace(scan, n_groups=1), anywhere(frame[0]))
    groups = level_groups(frame, scan, anywhere(frame[0]))
    assert len(groups) == n_groups
    assert sorted(map(repr, every)) == sorted(repr(level) for group in groups for level in group)
    heights = [WINDOW_ROWS * WINDOW_CELL * (a.bottom - a.top) / a.rows for a in every]
    assert abs(heights[0] - 32 * width / 1280) < 0.06 * heights[0]
    assert all(0 <= a.top < a.bottom <= frame[0] for a in every)
    # Levels are as fine as asked for, but for rounding.
    assert (np.diff(np.log(heights)) < np.log(ratio) + 0.1).all()


def test_a_level_stays_in_its_group_whatever_the_reach():
    scan = ScanParams(n_groups=4)
    groups = {}
    for low in np.linspace(250, 450, 21):
        reach = Reach(horizon=(low - 20, low + 20), ratio=(0.2, 1.0))
        for number, group in enumerate(level_groups((720, 1280), scan, reach)):
            for level in group:
                groups.setdefault(level.columns, set()).add(number)
    assert len(groups) > 10 and all(len(numbers) == 1 for numbers in groups.values())


def test_no_level_has_no_proposal():
    boxes, scores = propose(
        textured_image(0, 90, 120), [], random_detector(0).templates, ScanParams()
    )
    assert boxes.shape == (0, 4) and scores.shape == (0,)


def test_a_frame_too_small_for_any_window_is_refused():
    with pytest.raises(ValueError, match="no window fits a frame of 300x4"):
        level_groups((4, 300), ScanParams(), anywhere(4))


def test_levels_cover_what_is_within_reach():
    reach = Reach(horizon=(300.0, 400.0), ratio=(0.25, 1.2))
    (levels,) = level_groups((720, 1280), ScanParams(n_groups=1), reach)
    for level in levels:
        side = WINDOW_ROWS * WINDOW_CELL * (level.bottom - level.top) / level.rows
        # The highest vehicle ends a quarter of its height below the highest horizon.
        assert level.top <= max(0, 300 - 0.75 * side) + 0.3 * side
        assert level.bottom >= min(720, 400 + 1.2 * side) - 0.1 * side - 1


@settings(max_examples=20)
@given(row=st.integers(0, 12), column=st.integers(0, 24), template=st.integers(0, 3))
def test_a_window_is_moved_by_its_cells_and_those_around(row, column, template):
    cells = cell_features(textured_image(5, 80, 160))
    learned = random_detector(1).templates[template]
    (shift,) = window_shifts(cells, np.array([[column, row]]), learned)
    padded = np.pad(cells, ((3, 3), (3, 3), (0, 0)), mode="edge")
    rows, columns = learned.shift_weights.shape[:2]
    own = padded[row : row + rows, column : column + columns]
    assert own.shape[:2] == (rows, columns)
    expected = np.einsum("rcf,rcfk->k", own, learned.shift_weights) + learned.shift_bias
    np.testing.assert_allclose(shift, expected, atol=1e-4)


def every_window(img, n_proposals):
    """One level of which every window may be proposed, and the scan that says so."""
    scan = ScanParams(
        smallest=150, largest=150, cells_per_step=1, n_groups=1, threshold=-np.inf,
        n_proposals=n_proposals,
    )  # fmt: skip
    ((level,),) = level_groups(img.shape[:2], scan, anywhere(len(img)))
    return scan, level


def test_proposals_are_windows_that_were_moved():
    img, templates = textured_image(2, 90, 400), random_detector(2).templates
    scan, level = every_window(img, n_proposals=3)
    moved, scores = propose(img, [level], templates, scan)
    still = still_templates(2)
    windows, own_scores = propose(img, [level], still, scan)
    np.testing.assert_array_equal(scores, own_scores)
    to_right = tuple(replace(t, shift_bias=np.float32([0.1, 0, 0.1, 0])) for t in still)
    aside, _ = propose(img, [level], to_right, scan)
    width = windows[:, 2] - windows[:, 0]
    np.testing.assert_allclose(aside[:, ::2], windows[:, ::2] + 0.1 * width[:, None], rtol=1e-5)
    np.testing.assert_allclose(aside[:, 1::2], windows[:, 1::2])
    assert not np.allclose(moved, windows)


@settings(max_examples=20)
@given(n_proposals=st.integers(1, 6), seed=st.integers(0, 1000))
def test_the_best_windows_are_proposed(n_proposals, seed):
    img, templates = textured_image(seed, 90, 400), still_templates(seed)
    scan, level = every_window(img, n_proposals=300)
    every, _ = propose(img, [level], templates, scan)
    boxes, scores = propose(img, [level], templates, replace(scan, n_proposals=n_proposals))
    np.testing.assert_allclose(boxes, every[:n_proposals])
    assert (np.diff(scores) <= 0).all()


@pytest.mark.parametrize(
    "wrong",
    [
        {"smallest": 0},
        {"smallest": 500},
        {"ratio": 1},
        {"n_groups": 0},
        {"cells_per_step": 0},
        {"n_proposals": 0},
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


def test_cells_hold_hog_and_mean_colour():
    img = textured_image(3, 46, 61)
    features = cell_features(img)
    assert features.shape == (46 // WINDOW_CELL, 61 // WINDOW_CELL, CELL_FEATURES)
    lengths, units = lengths_and_units(features[..., :ORIENTATIONS])
    luma = cv2.cvtColor(img, cv2.COLOR_RGB2GRAY)
    np.testing.assert_allclose(units, unit_histograms(luma, WINDOW_CELL), atol=1e-5)
    raw = np.linalg.norm(cell_histograms(luma[..., None], ORIENTATIONS, WINDOW_CELL)[0], axis=-1)
    around = uniform_filter(raw, SURROUNDINGS, mode="reflect")
    np.testing.assert_allclose(lengths, raw / np.hypot(raw, around), atol=1e-5)
    top, left = 2 * WINDOW_CELL, 5 * WINDOW_CELL
    colors = convert_color(img, "YCrCb")[top : top + WINDOW_CELL, left : left + WINDOW_CELL]
    mean = colors.mean(axis=(0, 1)) / 255
    np.testing.assert_allclose(features[2, 5, ORIENTATIONS:], mean, atol=0.006)


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
    scores = window_scores(features, still_template(weights, 0.5), step)
    places = (
        range(0, max(0, side), step) for side in (rows - WINDOW_ROWS + 1, columns - width + 1)
    )
    tops, lefts = map(list, places)
    shape = len(tops), len(lefts)
    assert scores.shape == shape
    for i, k in np.ndindex(shape):
        window = features[tops[i] : tops[i] + WINDOW_ROWS, lefts[k] : lefts[k] + width]
        assert scores[i, k] == pytest.approx((window * weights).sum() + 0.5, abs=2e-3)


@settings(max_examples=30)
@given(
    rows=st.integers(1, 20),
    columns=st.integers(1, 30),
    step=st.integers(1, 3),
    n_proposals=st.integers(1, 6),
    seed=st.integers(0, 1000),
)
def test_best_windows_of_all_templates(rows, columns, step, n_proposals, seed):
    features = np.random.default_rng(seed).random((rows, columns, CELL_FEATURES), np.float32)
    templates = still_templates(seed)
    scan = ScanParams(cells_per_step=step, threshold=0.1, n_proposals=n_proposals)
    hot = []
    for i, template in enumerate(templates):
        scores = window_scores(features, template, step)
        width = template.weights.shape[1]
        for row, column in np.argwhere(scores > scan.threshold):
            x, y = column * step, row * step
            box = (int(x), int(y), int(x + width), int(y + WINDOW_ROWS))
            hot.append((float(scores[row, column]), i, box))
    wanted = []
    for score, owner, box in sorted(hot, reverse=True):
        kept = np.array([other for _, _, other in wanted], float).reshape(-1, 4)
        if (pairwise_iou(np.array([box], float), kept) <= scan.overlap).all():
            wanted.append((score, owner, box))
    windows, scores, owners = best_windows(features, templates, scan)
    found = zip(scores.tolist(), owners.tolist(), map(tuple, windows.tolist()), strict=True)
    assert list(found) == wanted[:n_proposals]


def test_a_window_is_proposed_where_its_pixels_are():
    img = np.full((360, 480, 3), 90, np.uint8)
    height, width = WINDOW_ROWS * WINDOW_CELL, 11 * WINDOW_CELL
    img[170 : 170 + height, 300 : 300 + width] = textured_image(5, height, width)
    # One level, as large as the frame.
    scan = ScanParams(
        smallest=height, largest=height, reference_width=480, cells_per_step=1, n_groups=1,
        threshold=-np.inf, n_proposals=1,
    )  # fmt: skip
    ((level,),) = level_groups(img.shape[:2], scan, anywhere(len(img)))
    strip = cv2.resize(img[level.top : level.bottom], (level.columns, level.rows))
    assert (level.rows, level.columns) == (level.bottom - level.top, 480)
    row, column = (170 - level.top) // WINDOW_CELL, 300 // WINDOW_CELL
    level_cells = cell_features(strip)
    wanted = level_cells[row : row + WINDOW_ROWS, column : column + 11]
    template = still_template(wanted - level_cells.mean(axis=(0, 1)), 0.0)
    (box,), _ = propose(img, [level], (template,), scan)
    place = 300, 170, 300 + width, 170 + height
    np.testing.assert_allclose(box, place, atol=WINDOW_CELL)


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
