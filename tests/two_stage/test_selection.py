"""Which candidates remain, against brute force."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import random_boxes
from vehicle_detection.parameters import SelectionParams
from vehicle_detection.two_stage.selection import non_max_suppression, overlap_conflicts

PARAMS = SelectionParams(max_iou=0.5, max_covered=0.7)


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
        return common / (sum(areas) - common) > 0.5 or is_part

    kept = []
    for i in np.argsort(-scores):
        if not any(in_conflict(boxes[i], boxes[k]) for k in kept):
            kept.append(i)
    assert non_max_suppression(overlap_conflicts(boxes, PARAMS), scores).tolist() == kept


def test_of_equal_scores_the_earlier_one_stays():
    boxes = np.array([(0.0, 0, 40, 20), (3, 0, 43, 20), (90, 0, 130, 20)])
    conflicts = overlap_conflicts(boxes, PARAMS)
    assert non_max_suppression(conflicts, np.array([1.0, 1, 2])).tolist() == [2, 0]
