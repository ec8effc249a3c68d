"""Tracks: identities over time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline_functions import draw_vehicles, identity_color
from tracks import Tracker, TrackParams, pairwise_iou


def box_at(x, y=100, width=60, height=40):
    return np.array([x, y, x + width, y + height])


def boxes(*rows):
    return np.array(rows, int).reshape(-1, 4)


def test_iou_of_known_boxes():
    a, b = boxes((0, 0, 10, 10)), boxes((5, 0, 15, 10), (20, 20, 30, 30), (0, 0, 10, 10))
    np.testing.assert_allclose(pairwise_iou(a, b), [[50 / 150, 0, 1]])


def test_two_vehicles_keep_their_identities_whatever_the_order():
    tracker = Tracker(TrackParams())
    first = tracker.update(boxes(box_at(100), box_at(400)))
    assert first.tolist() == [1, 2]
    for i in range(1, 30):
        near, far = box_at(100 + 4 * i), box_at(400 - 3 * i)
        assert tracker.update(boxes(far, near)).tolist() == [2, 1]


def test_a_vehicle_out_of_sight_is_known_again_where_its_speed_takes_it():
    tracker = Tracker(TrackParams(max_missed=30))
    for i in range(20):
        tracker.update(boxes(box_at(100 + 5 * i)))
    for _ in range(30):
        assert tracker.update(boxes()).tolist() == []
    assert tracker.update(boxes(box_at(100 + 5 * 50))).tolist() == [1]
    # 155 pixels, more than twice its width, from where it was last seen.
    assert pairwise_iou(boxes(box_at(350)), boxes(box_at(195)))[0, 0] == 0


def test_a_vehicle_away_for_too_long_is_another():
    tracker = Tracker(TrackParams(max_missed=3))
    tracker.update(boxes(box_at(100)))
    for _ in range(3):
        tracker.update(boxes())
    assert tracker.update(boxes(box_at(100))).tolist() == [1]
    for _ in range(4):
        tracker.update(boxes())
    assert tracker.update(boxes(box_at(100))).tolist() == [2]


def test_a_box_elsewhere_is_another_vehicle():
    tracker = Tracker(TrackParams())
    tracker.update(boxes(box_at(100)))
    assert tracker.update(boxes(box_at(155))).tolist() == [2]


def test_all_together_overlap_most():
    # Taken one by one, best first, the first box would take the second's track.
    tracker = Tracker(TrackParams(min_iou=0.05))
    tracker.update(boxes((0, 0, 100, 50), (60, 0, 160, 50)))
    assert tracker.update(boxes((38, 0, 138, 50), (100, 0, 200, 50))).tolist() == [1, 2]


@given(st.lists(st.integers(0, 5), max_size=8), st.integers(0, 2**32 - 1))
def test_identities_are_unique_in_a_frame_and_begin_at_one(counts, seed):
    rng = np.random.default_rng(seed)
    tracker = Tracker(TrackParams())
    seen = set()
    for count in counts:
        corner = rng.integers(0, 200, size=(count, 2))
        ids = tracker.update(np.hstack([corner, corner + rng.integers(1, 90, size=(count, 2))]))
        assert len(ids) == count == len(set(ids.tolist()))
        seen |= set(ids.tolist())
    assert seen == set(range(1, len(seen) + 1))


@pytest.mark.parametrize(
    "wrong",
    [{"min_iou": 0}, {"min_iou": 1}, {"max_missed": -1}, {"process_noise": 0}],
)
def test_track_params_refuse(wrong):
    with pytest.raises(ValueError):
        TrackParams(**wrong)


def test_vehicles_are_drawn_in_their_colours_on_a_copy():
    img = np.zeros((200, 300, 3), np.uint8)
    drawn = draw_vehicles(img, boxes((20, 60, 80, 120), (150, 60, 250, 120)), np.array([3, 7]), 1)
    assert not img.any()
    assert (drawn[119, 20:80] == identity_color(3)).all()
    assert (drawn[60:120, 249] == identity_color(7)).all()
    assert not drawn[130:].any()


def test_the_first_twenty_colours_differ():
    colors = np.array([identity_color(i) for i in range(20)], int)
    distance = np.abs(colors[:, None] - colors[None]).sum(axis=2) + 1000 * np.eye(20, dtype=int)
    assert distance.min() > 20
