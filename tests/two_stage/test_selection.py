"""Which candidates remain, against brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import random_boxes
from vehicle_detection.parameters import ScanParams, SelectionParams
from vehicle_detection.two_stage.selection import are_plausible, non_max_suppression

PARAMS = SelectionParams()


@settings(max_examples=50)
@given(count=st.integers(0, 12), seed=st.integers(0, 10_000))
def test_of_boxes_in_conflict_the_better_one_is_kept(count, seed):
    rng = np.random.default_rng(seed)
    boxes, scores = random_boxes(rng, count, 80), rng.normal(size=count)

    def in_conflict(a, b):
        width = min(a[2], b[2]) - max(a[0], b[0])
        height = min(a[3], b[3]) - max(a[1], b[1])
        common = max(0, width) * max(0, height)
        areas = [(x[2] - x[0]) * (x[3] - x[1]) for x in (a, b)]
        is_part = common / min(areas) > 0.7
        return common / (sum(areas) - common) > 0.45 or is_part

    kept = []
    for i in np.argsort(-scores):
        if not any(in_conflict(boxes[i], boxes[k]) for k in kept):
            kept.append(i)
    assert non_max_suppression(boxes, scores, PARAMS).tolist() == kept


def test_a_tie_does_not_hang_on_the_last_bit():
    boxes = np.array([(0.0, 0, 40, 20), (3, 0, 43, 20)])
    for scores in ([1.0, 1.0 + 1e-4], [1.0 + 1e-4, 1.0]):
        assert non_max_suppression(boxes, np.array(scores), PARAMS).tolist() == [0]


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
    plausible = are_plausible(boxes, (720, 1280, 3), ScanParams(smallest=32, largest=400), PARAMS)
    assert plausible.tolist() == [True, False, False, False, False, False, True]
    half = are_plausible(boxes / 2, (360, 640, 3), ScanParams(smallest=32, largest=400), PARAMS)
    np.testing.assert_array_equal(plausible, half)


def test_each_limit_of_size_and_shape():
    """Just within and just beyond every limit, in a frame of twice the reference's width."""
    scan = ScanParams(smallest=30, largest=300, reference_width=640)
    params = SelectionParams(size_range=(0.5, 1.5), aspect_range=(0.5, 3), min_visible=0.6)

    def is_plausible(left, width, height):
        box = np.array([[left, 10.0, left + width, 10 + height]])
        return bool(are_plausible(box, (2000, 1280, 3), scan, params)[0])

    # Heights from 30 * 2 * 0.5 to 300 * 2 * 1.5.
    assert is_plausible(100, 60, 30.1) and not is_plausible(100, 60, 29.9)
    assert is_plausible(100, 900, 899) and not is_plausible(100, 900, 901)
    assert is_plausible(100, 50.1, 100) and not is_plausible(100, 49.9, 100)
    assert is_plausible(100, 299, 100) and not is_plausible(100, 301, 100)
    assert is_plausible(-39, 100, 60) and not is_plausible(-41, 100, 60)
