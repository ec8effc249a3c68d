"""Tracks: identities over time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_detection.media.drawing import draw_vehicles, identity_color
from vehicle_detection.parameters import TrackParams
from vehicle_detection.tracking.boxes import (
    best_iou,
    clip_to_frame,
    pairwise_iou,
    touches_border,
)
from vehicle_detection.tracking.tracker import Tracker


def box_at(x, y=100, width=60, height=40):
    return np.array([x, y, x + width, y + height])


def boxes(*rows):
    return np.array(rows, int).reshape(-1, 4)


def step(tracker, of_frame):
    """Identities of boxes that are all vehicles for sure."""
    tracker.predict()
    return [track.identity for track in tracker.update(of_frame, np.ones(len(of_frame)))]


def test_iou_of_known_boxes():
    a, b = boxes((0, 0, 10, 10)), boxes((5, 0, 15, 10), (20, 20, 30, 30), (0, 0, 10, 10))
    np.testing.assert_allclose(pairwise_iou(a, b), [[50 / 150, 0, 1]])


def test_edges_at_the_border_are_told_on_all_sides():
    own = np.array([(0, 50, 80, 90), (-9, 60, 81, 99.5), (116, 1.5, 200, 42), (1, 1, 199, 99)])
    touches = touches_border(own, (100, 200, 3))
    expected = [(1, 0, 0, 0), (1, 0, 0, 1), (0, 0, 1, 0), (0, 0, 0, 0)]
    np.testing.assert_array_equal(touches, expected)
    assert touches_border(own[:0], (100, 200)).shape == (0, 4)


def test_two_vehicles_keep_their_identities_whatever_the_order():
    tracker = Tracker(TrackParams())
    first = step(tracker, boxes(box_at(100), box_at(400)))
    assert first == [1, 2]
    for i in range(1, 30):
        near, far = box_at(100 + 4 * i), box_at(400 - 3 * i)
        assert step(tracker, boxes(far, near)) == [2, 1]


def test_a_gap_is_bridged_where_its_speed_takes_the_vehicle():
    tracker = Tracker(TrackParams(max_score=15.5))
    for i in range(40):
        step(tracker, boxes(box_at(100 + 5 * i)))
    for _ in range(30):
        assert step(tracker, boxes()) == []
    assert step(tracker, boxes(box_at(100 + 5 * 70))) == [1]
    # 155 pixels, more than twice its width, from where it was last seen.
    assert pairwise_iou(boxes(box_at(350)), boxes(box_at(195)))[0, 0] == 0


def test_gaps_are_bridged_while_there_is_evidence():
    # Ten times a score of 1, less half, are used up at half a frame.
    for gap, identity in ((9, 1), (10, 2)):
        tracker = Tracker(TrackParams(max_score=8))
        for i in range(10):
            assert step(tracker, boxes(box_at(100 + 5 * i))) == [1]
        for _ in range(gap):
            step(tracker, boxes())
        assert step(tracker, boxes(box_at(100 + 5 * (9 + gap + 1)))) == [identity]


EVIDENCE = dict(confirm_at=2.0, max_score=8.0)


def identities_of(tracker, rows, score):
    """Of the last of some frames with one box each."""
    for row in rows:
        tracker.predict()
        tracks = tracker.update(boxes(row), np.array([score]))
    return [track.identity for track in tracks if track]


def test_a_gap_of_one_vehicle_does_not_give_its_identity_to_the_next():
    tracker = Tracker(TrackParams(**EVIDENCE))
    assert identities_of(tracker, [box_at(100)] * 20, 1.0) == [1]
    for _ in range(3):
        assert step(tracker, boxes(box_at(100), box_at(158))) == [1, 0]
    assert step(tracker, boxes(box_at(158))) == [2]
    assert step(tracker, boxes(box_at(100), box_at(158))) == [1, 2]


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_identities_go_to_those_that_fit_best(order):
    tracker = Tracker(TrackParams(max_score=8))
    for _ in range(6):
        assert step(tracker, boxes(box_at(100))) == [1]
    for _ in range(5):
        step(tracker, boxes())
    found = boxes(box_at(138), box_at(100))[list(order)]
    assert step(tracker, found) == [(2, 1)[i] for i in order]


def test_a_box_elsewhere_is_another_vehicle():
    tracker = Tracker(TrackParams())
    step(tracker, boxes(box_at(100)))
    assert step(tracker, boxes(box_at(155))) == [2]


def test_all_together_overlap_most():
    # Taken one by one, best first, the first box would take the second's track.
    tracker = Tracker(TrackParams(min_iou=0.05))
    step(tracker, boxes((0, 0, 100, 50), (60, 0, 160, 50)))
    assert step(tracker, boxes((38, 0, 138, 50), (100, 0, 200, 50))) == [1, 2]


@given(st.lists(st.integers(0, 5), max_size=8), st.integers(0, 2**32 - 1))
def test_identities_are_unique_in_a_frame_and_begin_at_one(counts, seed):
    rng = np.random.default_rng(seed)
    tracker = Tracker(TrackParams())
    seen = set()
    for count in counts:
        corner = rng.integers(0, 200, size=(count, 2))
        ids = step(tracker, np.hstack([corner, corner + rng.integers(1, 90, size=(count, 2))]))
        assert len(ids) == count == len(set(ids))
        seen |= set(ids)
    assert seen == set(range(1, len(seen) + 1))


def shown(tracker, of_frame, score):
    """Identity of the one box of a frame, None if it is not shown."""
    tracker.predict()
    (track,) = tracker.update(of_frame, np.array([score]))
    return track.identity if track and track.is_confirmed else None


def test_a_vehicle_is_confirmed_once_its_scores_add_up():
    tracker = Tracker(TrackParams(confirm_at=2.5, max_score=4))
    scores = [1.3, 1.3, 1.3, 1.3, 1.3]
    assert [shown(tracker, boxes(box_at(100)), s) for s in scores] == [None] * 3 + [1, 1]


def test_evidence_is_capped_and_used_up():
    tracker = Tracker(TrackParams(confirm_at=2, max_score=3))
    here = boxes(box_at(100))
    for _ in range(10):
        assert shown(tracker, here, 2.5) == 1
    # Three of evidence last for less than three frames.
    assert [shown(tracker, here, -0.5) for _ in range(4)] == [1, 1, None, None]
    # Back again it must be proved anew, and is another.
    assert [shown(tracker, here, 1.5) for _ in range(2)] == [None, 2]


def test_frames_without_a_box_cost_evidence():
    tracker = Tracker(TrackParams(confirm_at=2, max_score=3))
    here = boxes(box_at(100))
    assert shown(tracker, here, 3.0) == 1
    for _ in range(5):
        step(tracker, boxes())
    assert shown(tracker, here, 1.0) is None


def test_a_box_of_score_offset_adds_nothing_and_one_below_it_takes_away():
    tracker = Tracker(TrackParams(confirm_at=2, max_score=3, score_offset=0.25))
    here = boxes(box_at(100))
    # 1.25 is 1 of evidence; a positive score of less than a quarter is none.
    assert [shown(tracker, here, s) for s in (1.25, 0.25, 0.25, 1.0, 1.25)] == [None] * 4 + [1]
    for _ in range(21):
        assert shown(tracker, here, 0.125) == 1
    assert shown(tracker, here, 0.125) is None


def test_what_never_was_a_vehicle_is_forgotten():
    tracker = Tracker(TrackParams(confirm_at=2, max_score=3))
    for _ in range(20):
        assert shown(tracker, boxes(box_at(100)), 0.9) is None
        assert shown(tracker, boxes(box_at(100)), -0.6) is None
    assert len(tracker.predict()) == 0


def test_a_box_that_is_no_vehicle_begins_no_track():
    tracker = Tracker(TrackParams())
    assert tracker.update(boxes(box_at(100)), np.array([-0.1])) == [None]
    assert len(tracker.predict()) == 0


def test_the_box_of_a_vehicle_after_a_gap_is_not_its_neighbours():
    tracker = Tracker(TrackParams())
    for _ in range(10):
        assert step(tracker, boxes(box_at(90), box_at(60))) == [1, 2]
    # One of them has a box in turn: where it lies tells whose it is.
    assert step(tracker, boxes(box_at(90))) == [1]
    assert step(tracker, boxes(box_at(60))) == [2]
    assert step(tracker, boxes(box_at(90))) == [1]


def test_all_tracks_are_predicted_until_they_are_lost():
    tracker = Tracker(TrackParams(confirm_at=2, max_score=3))
    known, fresh = box_at(100), box_at(300)
    for _ in range(3):
        step(tracker, boxes(known))
    step(tracker, boxes(fresh))
    np.testing.assert_allclose(tracker.predict(), boxes(known, fresh), atol=0.1)
    tracker.update(boxes(), np.empty(0))
    np.testing.assert_allclose(tracker.predict(), boxes(known), atol=0.1)


@pytest.mark.parametrize(
    "wrong",
    [
        {"min_iou": 0},
        {"min_iou": 1},
        {"process_noise": 0},
        {"confirm_at": -1},
        {"confirm_at": 2, "max_score": 1},
        {"score_offset": 0},
    ],
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


class Reference:
    """A Kalman filter of constant velocity, from the textbook [1]_.

    References
    ----------
    .. [1] Y. Bar-Shalom, X. R. Li and T. Kirubarajan, "Estimation with Applications to Tracking
           and Navigation", 2001, sections 5.2 and 6.3.2.
    """

    def __init__(self, box, params):
        eye, zero = np.eye(4), np.zeros((4, 4))
        self.state = np.concatenate([box, np.zeros(4)])
        self.covariance = np.block([[eye, zero], [zero, 0.1 * eye]])
        self.step = np.block([[eye, eye], [zero, eye]])
        gain = np.vstack([eye / 2, eye])
        self.process = params.process_noise**2 * gain @ gain.T

    def predict(self):
        self.state = self.step @ self.state
        self.covariance = self.step @ self.covariance @ self.step.T + self.process

    def correct(self, box):
        seen = np.eye(4, 8)
        innovation = seen @ self.covariance @ seen.T + np.eye(4)
        gain = self.covariance @ seen.T @ np.linalg.inv(innovation)
        self.state = self.state + gain @ (box - seen @ self.state)
        self.covariance = (np.eye(8) - gain @ seen) @ self.covariance


@given(seed=st.integers(0, 2**32 - 1))
def test_tracks_move_like_the_textbooks_filter(seed):
    rng = np.random.default_rng(seed)
    params = TrackParams(max_score=50, process_noise=0.3)
    tracker, box = Tracker(params), np.array([300.0, 200, 720, 590])
    tracker.update(box[None], np.array([20.0]))
    reference = Reference(box, params)
    for _ in range(12):
        expected = tracker.predict()
        reference.predict()
        np.testing.assert_allclose(expected[0], reference.state[:4], rtol=1e-9)
        if rng.random() < 0.2:
            tracker.update(np.empty((0, 4)), np.empty(0))
            continue
        found, score = expected[0] + rng.normal(0, 4, 4), rng.uniform(-1, 2)
        (track,) = tracker.update(found[None], np.array([score]))
        reference.correct(found)
        np.testing.assert_allclose(track.box, reference.state[:4], rtol=1e-9)


def test_geometry_of_boxes():
    own = np.array([(0.0, 0, 10, 10), (50, 50, 60, 60)])
    others = np.array([(5.0, 0, 15, 10), (0, 0, 10, 5)])
    np.testing.assert_allclose(best_iou(own, others), [0.5, 0])
    assert best_iou(own, others[:0]).tolist() == [0, 0] and best_iou(own[:0], own).shape == (0,)
    clipped = clip_to_frame(np.array([(-5.0, -6, 250, 130)]), (100, 200, 3))
    np.testing.assert_array_equal(clipped, [(0, 0, 200, 100)])
    nothing = pairwise_iou(np.zeros((1, 4)), np.zeros((1, 4)))
    assert nothing.dtype == float and nothing.tolist() == [[0]]
    # Of whole numbers too, the share is none.
    assert pairwise_iou(boxes((0, 0, 2, 1)), boxes((1, 0, 3, 1)))[0, 0] == pytest.approx(1 / 3)
