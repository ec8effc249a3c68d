"""Tracks: identities over time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_detection.media.drawing import draw_vehicles, identity_color
from vehicle_detection.parameters import TrackParams
from vehicle_detection.tracking.boxes import pairwise_iou
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


def test_two_vehicles_keep_their_identities_whatever_the_order():
    tracker = Tracker(TrackParams())
    first = step(tracker, boxes(box_at(100), box_at(400)))
    assert first == [1, 2]
    for i in range(1, 30):
        near, far = box_at(100 + 4 * i), box_at(400 - 3 * i)
        assert step(tracker, boxes(far, near)) == [2, 1]


def test_a_vehicle_out_of_sight_is_known_again_where_its_speed_takes_it():
    tracker = Tracker(TrackParams(max_missed=30))
    for i in range(20):
        step(tracker, boxes(box_at(100 + 5 * i)))
    for _ in range(30):
        assert step(tracker, boxes()) == []
    assert step(tracker, boxes(box_at(100 + 5 * 50))) == [1]
    # 155 pixels, more than twice its width, from where it was last seen.
    assert pairwise_iou(boxes(box_at(350)), boxes(box_at(195)))[0, 0] == 0


def test_a_vehicle_that_was_hidden_is_known_again_though_its_box_shrank():
    # A car that overtakes covers it from the left: less and less looks like a vehicle.
    seen = [(box_at(100), 1.0)] * 20
    seen += [(np.array([100 + 6 * i, 100, 160, 140]), 0.8 - 0.2 * i) for i in range(8)]

    def identity_after(kept_velocity):
        """Of a box where it was, forty frames later."""
        tracker = Tracker(TrackParams(max_missed=50, kept_velocity=kept_velocity))
        for box, score in seen:
            tracker.predict()
            tracker.update(boxes(box), np.array([score]))
        for _ in range(40):
            step(tracker, boxes())
        return step(tracker, boxes(box_at(100)))

    assert identity_after(kept_velocity=0.8) == [1]
    assert identity_after(kept_velocity=1.0) == [2]


def test_what_hides_a_vehicle_does_not_take_its_identity():
    # The one in front is twice as high, and its box covers half of the other's.
    hidden, nearer = np.array([100, 100, 160, 140]), np.array([80, 95, 170, 175])

    def identity_of_the_nearer(max_growth):
        tracker = Tracker(TrackParams(max_growth=max_growth))
        for _ in range(10):
            step(tracker, boxes(hidden))
        return step(tracker, boxes(nearer))

    assert pairwise_iou(boxes(hidden), boxes(nearer))[0, 0] > 0.2
    assert identity_of_the_nearer(max_growth=1.4) == [2]
    assert identity_of_the_nearer(max_growth=np.inf) == [1]


def test_gaps_are_bridged_while_there_is_evidence():
    tracker = Tracker(TrackParams(most_evidence=8, miss_cost=1.5))
    for i in range(10):
        step(tracker, boxes(box_at(100 + 5 * i)))
        assert tracker.bridged() == []
    shown = []
    for _ in range(7):
        step(tracker, boxes())
        shown.append([track.identity for track in tracker.bridged()])
    assert shown == [[1]] * 5 + [[]] * 2


def test_a_vehicle_comes_out_again_side_first():
    def identity_of_its_right_side(reach):
        tracker = Tracker(TrackParams(reach=reach))
        for _ in range(10):
            step(tracker, boxes(box_at(100)))
        for _ in range(10):
            step(tracker, boxes())
        return step(tracker, boxes((152, 100, 168, 140)))

    assert identity_of_its_right_side(reach=0.25) == [1]
    assert identity_of_its_right_side(reach=0) == [2]


@pytest.mark.parametrize(("score", "least", "most"), [(1.5, 6, 20), (0.1, 1, 6), (-0.5, 0, 0)])
def test_a_box_moves_its_track_by_how_sure_it_is(score, least, most):
    tracker = Tracker(TrackParams(most_evidence=8))
    for _ in range(20):
        tracker.predict()
        tracker.update(boxes(box_at(100)), np.array([1.0]))
    tracker.predict()
    (track,) = tracker.update(boxes(box_at(120)), np.array([score]))
    assert track.identity == 1
    assert least <= track.box[0] - 100 <= most


def test_a_vehicle_away_for_too_long_is_another():
    tracker = Tracker(TrackParams(max_missed=3))
    step(tracker, boxes(box_at(100)))
    for _ in range(3):
        step(tracker, boxes())
    assert step(tracker, boxes(box_at(100))) == [1]
    for _ in range(4):
        step(tracker, boxes())
    assert step(tracker, boxes(box_at(100))) == [2]


EVIDENCE = dict(birth=4.0, most_evidence=8.0, miss_cost=0.7)


def identities_of(tracker, rows, score):
    """Of the last of some frames with one box each."""
    for row in rows:
        tracker.predict()
        tracks = tracker.update(boxes(row), np.array([score]))
    return [track.identity for track in tracks if track]


def test_what_lies_where_a_vehicle_is_hidden_does_not_move_it():
    tracker = Tracker(TrackParams(max_missed=50, **EVIDENCE))
    assert identities_of(tracker, [box_at(100)] * 10, 1.0) == [1]
    for _ in range(15):
        step(tracker, boxes())
    ground = [box_at(100 + 10 * i) for i in range(2, 8)]
    assert identities_of(tracker, ground, 0.5) == [0]
    for _ in range(10):
        step(tracker, boxes())
    assert identities_of(tracker, [box_at(100)] * 6, 1.0) == [1]


def test_a_vehicle_that_is_framed_otherwise_is_the_same():
    tracker = Tracker(TrackParams(max_growth=1.4, **EVIDENCE))
    assert identities_of(tracker, [box_at(100)] * 10, 1.0) == [1]
    framed = box_at(100, y=80, height=70)
    assert identities_of(tracker, [framed] * 2, 1.5) == [0]
    assert [track.identity for track in tracker.bridged()] == [1]
    assert identities_of(tracker, [framed], 1.5) == [1]
    # The track before is gone: it would otherwise be shown beside.
    assert tracker.bridged() == []


def test_a_gap_of_one_vehicle_does_not_give_its_identity_to_the_next():
    tracker = Tracker(TrackParams(reach=0.25, **EVIDENCE))
    assert identities_of(tracker, [box_at(100)] * 20, 1.0) == [1]
    for _ in range(3):
        assert step(tracker, boxes(box_at(100), box_at(158))) == [1, 0]
    assert step(tracker, boxes(box_at(158))) == [2]
    assert [track.identity for track in tracker.bridged()] == [1]


def test_absent_are_vehicles_that_have_missed_a_frame():
    tracker = Tracker(TrackParams(**EVIDENCE))
    for _ in range(10):
        tracker.predict()
        assert len(tracker.absent()) == 0
        # The second never is a vehicle.
        tracker.update(boxes(box_at(100), box_at(300)), np.array([1.0, 0.1]))
    step(tracker, boxes())
    tracker.predict()
    np.testing.assert_allclose(tracker.absent(), boxes(box_at(100)), atol=0.1)


def box_out_of_sight(visible_of, others_of, score=None):
    """Where a vehicle of 60 x 40 pixels at 100 is expected, hidden by degrees.

    Of its `width`, `visible_of(width)` is in sight, and `others_of(width)` are
    there; at the end it has boxes of that score, or none.
    """
    tracker = Tracker(TrackParams(kept_velocity=0.8, **EVIDENCE))
    # Far away at first: only the width before it is hidden counts.
    for width in [30] * 10 + [60] * 50 + list(range(60, 18, -2)):
        tracker.predict()
        others = others_of(width)
        # Little to be seen means low scores.
        scores = np.append(0.5 if width < 60 else 1.0, np.ones(len(others)))
        tracker.update(np.concatenate([boxes(visible_of(width)), others]), scores)
    for _ in range(15):
        tracker.predict()
        seen = boxes() if score is None else boxes(visible_of(width))
        scores = np.append(np.full(len(seen), score or 0.0), np.ones(len(others)))
        tracker.update(np.concatenate([seen, others]), scores)
    step(tracker, others)
    tracker.predict()
    (box,) = tracker.absent()
    return box


def right_hidden(width):
    return box_at(100, width=width)


def left_hidden(width):
    return box_at(160 - width, width=width)


def coverer(left, bottom=170):
    return boxes((left, 90, left + 100, bottom))


@pytest.mark.parametrize("score", [None, -1.0])
@pytest.mark.parametrize(
    "visible_of, others_of",
    [
        (right_hidden, lambda width: coverer(100 + width)),
        (left_hidden, lambda width: coverer(60 - width)),
    ],
)
def test_behind_a_nearer_vehicle_it_is_as_wide_as_it_was(visible_of, others_of, score):
    left, _, right, _ = box_out_of_sight(visible_of, others_of, score)
    assert abs(left - 100) < 6
    assert abs(right - 160) < 6


@pytest.mark.parametrize(
    "others_of",
    [
        lambda width: coverer(400),
        # Farther away: it hides nothing.
        lambda width: coverer(100 + width, bottom=120),
        lambda width: boxes((0, 90, 300, 170)),
    ],
)
def test_where_no_side_is_known_to_be_hidden_it_stays_as_it_was_seen(others_of):
    left, _, right, _ = box_out_of_sight(right_hidden, others_of)
    assert right - left < 30


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_identities_go_to_those_that_fit_best(order):
    tracker = Tracker(TrackParams())
    assert step(tracker, boxes(box_at(100))) == [1]
    for _ in range(5):
        step(tracker, boxes())
    found = boxes(box_at(138), box_at(100))[list(order)]
    assert step(tracker, found) == [(2, 1)[i] for i in order]


def test_time_out_of_sight_starts_anew_with_every_box():
    tracker = Tracker(TrackParams(max_missed=10))
    for _ in range(5):
        assert step(tracker, boxes(box_at(100))) == [1]
        for _ in range(8):
            step(tracker, boxes())


def test_what_is_farther_away_hides_nothing():
    tracker = Tracker(TrackParams(max_missed=10, max_growth=1.4))
    gone, lorry = box_at(100), np.array([90, 20, 190, 130])
    assert step(tracker, boxes(gone, lorry)) == [1, 2]
    for _ in range(12):
        assert step(tracker, boxes(lorry)) == [2]
    assert step(tracker, boxes(lorry, gone)) == [2, 3]


@pytest.mark.parametrize(("left", "identity"), [(0, 2), (200, 1), (400, 2)])
def test_what_leaves_at_the_side_does_not_come_back(left, identity):
    tracker = Tracker(TrackParams(max_missed=50))

    def identities(of_frame):
        tracker.predict()
        tracks = tracker.update(of_frame, np.ones(len(of_frame)), n_columns=460)
        return [track.identity for track in tracks]

    for _ in range(3):
        assert identities(boxes(box_at(left))) == [1]
    for _ in range(5):
        assert identities(boxes()) == []
    assert identities(boxes(box_at(left))) == [identity]


@pytest.mark.parametrize("at_left", [True, False])
@pytest.mark.parametrize(("growth", "identity"), [(4, 1), (-4, 2)])
def test_what_was_coming_in_at_the_side_has_not_left(at_left, growth, identity):
    tracker = Tracker(TrackParams(max_missed=50, kept_velocity=0.8))

    def identities(of_frame):
        tracker.predict()
        tracks = tracker.update(of_frame, np.ones(len(of_frame)), n_columns=460)
        return [track.identity for track in tracks]

    for n in range(8):
        width = 60 + growth * n
        box = box_at(0 if at_left else 460 - width, width=width)
        assert identities(boxes(box)) == [1]
    for _ in range(5):
        assert identities(boxes()) == []
    assert identities(boxes(box)) == [identity]


@pytest.mark.parametrize(("n_frames", "identity"), [(45, 1), (60, 3)])
def test_hidden_frames_count_a_fifth(n_frames, identity):
    # A car draws level with one farther away, stays before it, and falls back again.
    tracker = Tracker(TrackParams(max_missed=10, max_growth=1.4))
    hidden, nearer = box_at(100), np.array([90, 80, 190, 160])
    assert step(tracker, boxes(hidden, nearer)) == [1, 2]
    for _ in range(n_frames):
        assert step(tracker, boxes(nearer)) == [2]
    assert step(tracker, boxes(nearer, hidden)) == [2, identity]


def test_frames_count_whole_where_the_other_vehicle_is_beside():
    tracker = Tracker(TrackParams(max_missed=10))
    gone, beside = box_at(100), box_at(140)
    assert step(tracker, boxes(gone, beside)) == [1, 2]
    for _ in range(12):
        assert step(tracker, boxes(beside)) == [2]
    assert step(tracker, boxes(beside, gone)) == [2, 3]


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
    return track.identity if track and track.is_shown else None


def test_a_vehicle_is_shown_once_its_scores_add_up():
    tracker = Tracker(TrackParams(birth=2.5, most_evidence=4))
    scores = [0.8, 0.8, 0.8, 0.8, 0.8]
    assert [shown(tracker, boxes(box_at(100)), s) for s in scores] == [None] * 3 + [1, 1]


def test_evidence_is_capped_and_used_up():
    tracker = Tracker(TrackParams(birth=2, most_evidence=3, miss_cost=1))
    here = boxes(box_at(100))
    for _ in range(10):
        assert shown(tracker, here, 2.0) == 1
    # Three of evidence last for three frames, and one to show that they are gone.
    assert [shown(tracker, here, -1.0) for _ in range(4)] == [1, 1, 1, None]
    # Back again it must be proved anew, and is the same vehicle.
    assert [shown(tracker, here, 1.5) for _ in range(2)] == [None, 1]


def test_frames_without_a_box_cost_evidence():
    tracker = Tracker(TrackParams(birth=2, most_evidence=3, miss_cost=1.5))
    here = boxes(box_at(100))
    assert shown(tracker, here, 3.0) == 1
    for _ in range(3):
        step(tracker, boxes())
    assert shown(tracker, here, 1.0) is None


@pytest.mark.parametrize(
    ("left", "bottom", "n_frames"),
    [(200, 160, 3), (130, 160, 6), (115, 160, 3), (130, 139, 3)],
    ids=["beside", "half in sight", "out of sight", "behind"],
)
def test_a_frame_costs_less_where_a_nearer_vehicle_covers_half_of_the_place(left, bottom, n_frames):
    # Three of evidence, and one a frame or half of it.
    params = TrackParams(min_iou=0.5, birth=2, most_evidence=3, miss_cost=1)
    tracker = Tracker(params)
    tracker.predict()
    (gone,) = tracker.update(boxes(box_at(100)), np.array([3.0]))
    other = np.array([left, 60, left + 100, bottom])
    for n in range(1, 9):
        tracker.predict()
        tracker.update(boxes(other), np.array([3.0]))
        assert gone.is_shown == (n <= n_frames)


def test_a_box_of_neutral_score_adds_nothing_and_one_below_it_takes_away():
    tracker = Tracker(TrackParams(birth=2, most_evidence=3, neutral_score=0.25))
    here = boxes(box_at(100))
    # 1.25 is 1 of evidence; a positive score of less than a quarter is none.
    assert [shown(tracker, here, s) for s in (1.25, 0.25, 0.25, 1.0, 1.25)] == [None] * 4 + [1]
    for _ in range(22):
        assert shown(tracker, here, 0.125) == 1
    assert shown(tracker, here, 0.125) is None


def test_what_never_was_a_vehicle_is_forgotten():
    tracker = Tracker(TrackParams(birth=2, most_evidence=3))
    for _ in range(20):
        assert shown(tracker, boxes(box_at(100)), 0.5) is None
        assert shown(tracker, boxes(box_at(100)), -0.6) is None
    assert len(tracker.predict()) == 0


def test_a_box_that_is_no_vehicle_begins_no_track():
    tracker = Tracker(TrackParams())
    assert tracker.update(boxes(box_at(100)), np.array([-0.1])) == [None]
    assert len(tracker.predict()) == 0


def test_a_hidden_vehicle_does_not_take_the_box_of_the_one_before_it():
    tracker = Tracker(TrackParams(miss_cost=0.1))
    for i in range(10):
        step(tracker, boxes(box_at(90), box_at(300 - 20 * i)))
    # For a frame there is only the first; then a box a little nearer to where
    # the second was going.
    assert step(tracker, boxes(box_at(90))) == [1]
    assert step(tracker, boxes(box_at(84))) == [1]


def test_the_box_of_a_vehicle_after_a_gap_is_not_its_neighbours():
    tracker = Tracker(TrackParams(miss_cost=0.1))
    for _ in range(10):
        assert step(tracker, boxes(box_at(90), box_at(60))) == [1, 2]
    # One of them has a box in turn: where it lies tells whose it is.
    assert step(tracker, boxes(box_at(90))) == [1]
    assert step(tracker, boxes(box_at(60))) == [2]
    assert step(tracker, boxes(box_at(90))) == [1]


def test_expected_are_those_of_the_frame_before():
    tracker = Tracker(TrackParams(miss_cost=0.1))
    step(tracker, boxes(box_at(100), box_at(300)))
    step(tracker, boxes(box_at(300)))
    np.testing.assert_allclose(tracker.predict(), boxes(box_at(300)))


@pytest.mark.parametrize(
    "wrong",
    [
        {"min_iou": 0},
        {"min_iou": 1},
        {"max_missed": -1},
        {"process_noise": 0},
        {"birth": -1},
        {"birth": 2, "most_evidence": 1},
        {"miss_cost": 0},
        {"neutral_score": -0.1},
        {"kept_velocity": 1.1},
        {"max_growth": 1},
        {"reach": -0.1},
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
