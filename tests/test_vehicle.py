"""`Vehicle`: the two-stage detector with a memory."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from conftest import ROOT, random_detector, textured_image
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.media.drawing import identity_color
from vehicle_detection.media.mot import Rows, read_rows
from vehicle_detection.media.videos import read_frames
from vehicle_detection.parameters import STILL_SCAN, STILL_TRACKS, TrackParams
from vehicle_detection.two_stage.model import save_detector
from vehicle_detection.two_stage.vehicle import Vehicle, are_whole_cars

EAGER = TrackParams(birth=0.2, most_evidence=2.0, miss_cost=0.7)


@pytest.fixture
def path(tmp_path):
    """Parameter file of a detector with random weights."""
    save_detector(random_detector(3), tmp_path / "detector.npz")
    return tmp_path / "detector.npz"


def frames(count, rows=180, columns=320):
    ground = textured_image(0, rows, columns)
    for i in range(count):
        yield np.roll(ground, 2 * i, axis=1)


def rows_of(all_detections):
    """Detections of the frames from 1 on as rows of a MOTChallenge file."""
    numbers = [np.full(len(d.ids), n) for n, d in enumerate(all_detections, start=1)]
    return Rows(
        np.concatenate(numbers),
        np.concatenate([d.ids for d in all_detections]),
        np.concatenate([d.boxes for d in all_detections]).astype(float),
        np.concatenate([d.scores for d in all_detections]),
        np.full(sum(map(len, numbers)), -1.0),
    )


def test_boxes_are_whole_pixels_of_the_frame_with_identities_of_their_own(path):
    vehicle = Vehicle(None, path, track_params=EAGER)
    n_boxes = 0
    for frame in frames(12):
        detections = vehicle.detect(frame)
        boxes, ids = detections.boxes, detections.ids
        assert boxes.dtype.kind == "i" and boxes.shape == (len(ids), 4)
        assert (boxes >= 0).all() and (boxes <= (320, 180, 320, 180)).all()
        assert len(set(ids.tolist())) == len(ids) == len(detections.scores) and (ids > 0).all()
        assert len(detections.candidates) == len(detections.candidate_evidence)
        n_boxes += len(boxes)
    assert n_boxes > 0


@pytest.mark.parametrize("left, is_bridged", [(10, False), (190, True)])
def test_a_gap_is_bridged_only_beside_what_is_seen(path, left, is_bridged):
    vehicle = Vehicle(None, path)
    vehicle.detect(textured_image(0, 180, 320))
    known, nearer = np.array([[20.0, 60, 80, 100]]), np.array([[left, 40.0, left + 100, 110]])
    for boxes in (known, nearer):
        vehicle._tracker.predict()
        detections = vehicle._follow(boxes, boxes, np.array([6.0]))
    assert (detections.scores == 0).any() == is_bridged
    assert len(detections.boxes) == 1 + is_bridged


def test_a_vehicle_out_of_sight_is_looked_for_where_it_is_expected(path, monkeypatch):
    looked_at = []

    def see_nothing(img, boxes, detector):
        """What `look_closer` says of places without a vehicle."""
        looked_at[:] = boxes
        return boxes, np.full(len(boxes), -5.0)

    monkeypatch.setattr("vehicle.look_closer", see_nothing)
    vehicle = Vehicle(None, path)
    frame = textured_image(0, 180, 320)
    vehicle.detect(frame)
    known = np.array([[120.0, 80, 180, 120]])
    for boxes in [known] * 5 + [known[:0]] * 15:
        vehicle._tracker.predict()
        vehicle._follow(boxes, boxes, np.full(len(boxes), 2.0))
    vehicle.detect(frame)
    for place in (known[0], [127.5, 85, 172.5, 115]):
        assert np.abs(np.array(looked_at) - place).max(axis=1).min() < 1


def test_reset_forgets(path):
    vehicle = Vehicle(None, path, track_params=EAGER)
    first = [vehicle.detect(frame) for frame in frames(8)]
    vehicle.reset()
    again = [vehicle.detect(frame) for frame in frames(8)]
    assert sum(len(one.candidates) for one in first) > 0
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.candidates, other.candidates)
        np.testing.assert_array_equal(one.boxes, other.boxes)
        np.testing.assert_array_equal(one.ids, other.ids)


def test_known_vehicles_tell_where_others_may_stand(path, monkeypatch):
    # A car, the lower half of one, a sign, and another far above, all scored alike.
    boxes = np.array(
        [(20, 92, 76, 132), (120, 112, 150, 132), (220, 60, 260, 90), (220, 10, 260, 40)], float
    )
    searched = []

    def propose(_, levels, *__):
        searched.append(sum(level.rows * level.columns for level in levels))
        return boxes, None

    monkeypatch.setattr("vehicle.propose", propose)
    monkeypatch.setattr("vehicle.look_closer", lambda _, found, __: (found, np.full(4, 3.0)))
    vehicle = Vehicle(None, path, STILL_SCAN, TrackParams(birth=100, most_evidence=100))
    (frame,) = frames(1)
    before = vehicle.detect(frame)
    np.testing.assert_array_equal(before.candidates, boxes[:3])
    np.testing.assert_array_equal(before.candidate_scores, [3, 3, 3])
    vehicle.reset()
    vehicle._seen = np.tile(boxes[:1], (60, 1))
    after = vehicle.detect(frame)
    # The road vanishes in row 100, and cars are as high as 5 / 4 of what they are below it.
    np.testing.assert_array_equal(after.candidates, boxes[:2])
    excess = (132 - 100 - 1.8) / 20 - 0.8 - 0.1
    np.testing.assert_allclose(after.candidate_scores, [3, 3 - 3 * excess])
    assert searched[1] < 0.9 * searched[0]


def test_only_whole_cars_tell_where_the_road_is(path):
    # A car, a lorry, a car cut by the right border, and one cut at the bottom.
    boxes = [(100, 60, 160, 100), (20, 40, 60, 90), (280, 60, 320, 90), (180, 120, 270, 180)]
    assert are_whole_cars(np.array(boxes, float), (180, 320, 3)).tolist() == [True, *3 * [False]]
    vehicle = Vehicle(None, path)
    # What is found in this frame must begin no tracks of its own.
    unsure = replace(vehicle.detector.scorer, bias=np.float32([-100]))
    vehicle.detector = replace(vehicle.detector, scorer=unsure)
    assert (vehicle.detect(textured_image(0, 180, 320)).candidate_scores < 0).all()
    vehicle._tracker.predict()
    vehicle._follow(np.empty((0, 4)), np.array(boxes[:2], float), np.array([6.0, 6.0]))
    np.testing.assert_allclose(vehicle._seen, boxes[:1])


def test_frames_of_two_sizes_are_refused(path):
    vehicle = Vehicle(None, path)
    vehicle.detect(textured_image(0, 180, 320))
    with pytest.raises(ValueError, match="after one of"):
        vehicle.detect(textured_image(0, 360, 640))


def test_pictures_show_the_vehicles(path):
    vehicle = Vehicle(None, path, STILL_SCAN, TrackParams())
    (frame,) = frames(1)
    drawn = vehicle.process_image(frame)
    vehicle.reset()
    detections = vehicle.detect(frame)
    left, top, right, bottom = detections.boxes[-1]
    edge = drawn[bottom - 1, left : right - 1]
    assert (edge == identity_color(detections.ids[-1])).all()
    pictures = vehicle.step_pictures(frame, detections)
    assert len(pictures) == len(vehicle.titles) == 4
    assert all(picture.shape == frame.shape for picture in pictures)
    np.testing.assert_array_equal(pictures[3], drawn)
    assert vehicle.draw_split_screen(frame, detections).shape == frame.shape


def test_the_shipped_detector_follows_the_vehicles_of_the_shipped_clip():
    vehicle = Vehicle(None, ROOT / "param/detector.npz")
    clip = islice(read_frames(ROOT / "videos/drive.mp4"), 60)
    found = rows_of([vehicle.detect(frame) for frame in clip])
    figures = evaluate(read_rows(ROOT / "videos/drive.gt.txt"), found, range(1, 61))
    assert figures["recall"] > 0.85 and figures["precision"] > 0.95
    assert figures["mean IoU"] > 0.75 and figures["identity switches"] <= 1


def test_the_shipped_detector_finds_vehicles_in_stills():
    vehicle = Vehicle(None, ROOT / "param/detector.npz", STILL_SCAN, STILL_TRACKS)
    clip = islice(read_frames(ROOT / "videos/drive.mp4"), 0, 150, 30)
    truth = read_rows(ROOT / "videos/drive.gt.txt")
    numbers, found = range(1, 151, 30), []
    for frame in clip:
        vehicle.reset()
        found.append(vehicle.detect(frame))
    rows = rows_of(found)
    rows = replace(rows, frames=np.array(numbers)[rows.frames - 1])
    chosen = truth.only(np.isin(truth.frames, numbers))
    figures = evaluate(chosen, rows, range(1, 151))
    assert figures["recall"] > 0.75 and figures["precision"] > 0.9


def test_an_entering_vehicle_of_the_real_video_is_boxed_within_ten_frames(real_data):
    # A part of the video that the detector has learned from: whether it works at all.
    truth = read_rows(real_data / "truth/project_video.gt.txt")
    vehicle = Vehicle(None, ROOT / "param/detector.npz")
    clip = islice(read_frames(real_data / "udacity/project_video.mp4"), 240)
    figures = evaluate(truth, rows_of([vehicle.detect(frame) for frame in clip]), range(1, 241))
    assert figures["frames to first box"]["1 from 162"] <= 10
    assert figures["recall"] > 0.9 and figures["false positives"] <= 2
