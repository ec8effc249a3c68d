"""`TwoStageVehicle`: the two-stage detector over a video."""

import math
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from conftest import ROOT, random_detector, textured_image
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.media.drawing import identity_color
from vehicle_detection.media.mot import read_rows, rows_of_detections
from vehicle_detection.media.videos import read_frames
from vehicle_detection.parameters import (
    DEFAULT_TRACKS,
    STILL_PARAMS,
    TrackParams,
    TwoStageParams,
)
from vehicle_detection.two_stage.model import save_detector
from vehicle_detection.two_stage.refinement import Candidates
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

EAGER = TrackParams(confirm_at=0.2, max_score=2.0, score_offset=0.1)


@pytest.fixture
def path(tmp_path):
    """Parameter file of a detector with random weights."""
    save_detector(random_detector(3), tmp_path / "detector.npz")
    return tmp_path / "detector.npz"


def frames(count, rows=180, columns=320):
    ground = textured_image(0, rows, columns)
    for i in range(count):
        yield np.roll(ground, 2 * i, axis=1)


def test_boxes_are_whole_pixels_of_the_frame_with_identities_of_their_own(path):
    vehicle = TwoStageVehicle(None, path, params=TwoStageParams(tracks=EAGER))
    n_boxes = 0
    for frame in frames(12):
        detections = vehicle.detect(frame)
        boxes, ids = detections.boxes, detections.ids
        assert boxes.dtype.kind == "i" and boxes.shape == (len(ids), 4)
        assert (boxes >= 0).all() and (boxes <= (320, 180, 320, 180)).all()
        assert len(set(ids.tolist())) == len(ids) == len(detections.scores) and (ids > 0).all()
        assert len(detections.candidates) == len(detections.track_scores)
        n_boxes += len(boxes)
    assert n_boxes > 0


@pytest.fixture
def scripted(monkeypatch):
    """A vehicle whose stages find what the test says: boxes and scores, frame by frame."""
    looked_at = []

    def play(script, **parameters):
        """Detections of frames with a list of (box, score) each, and what was looked at."""
        vehicle = TwoStageVehicle(None, random_detector(3), **parameters)
        frame, found = textured_image(0, 180, 320), []
        for rows in script:
            boxes = np.array([box for box, _ in rows], float).reshape(-1, 4)
            scores = [score for _, score in rows]

            def refine(_, looked, __, n_predicted, mirrored, boxes=boxes, scores=scores):
                assert len(looked) == n_predicted + len(boxes)
                assert mirrored == vehicle.params.mirrored
                looked_at.append(looked)
                return Candidates(boxes, np.array(scores))

            monkeypatch.setattr(f"{MODULE}.propose", lambda *_, boxes=boxes: (boxes, None))
            monkeypatch.setattr(f"{MODULE}.refine", refine)
            found.append(vehicle.detect(frame))
        return found, looked_at

    return play


MODULE = "vehicle_detection.two_stage.vehicle"
# A car of an 180 x 320 frame, in the distance and near: both stand on the usual road.
FAR, NEAR = (200.0, 80, 228, 100), (90.0, 76, 174, 136)


def test_a_vehicle_without_a_box_is_looked_for_where_it_is_expected(scripted):
    found, looked_at = scripted([[(NEAR, 2.0)]] * 6 + [[]] * 2 + [[(NEAR, 2.0)]])
    assert [one.ids.tolist() for one in found[5:]] == [[1], [], [], [1]]
    for boxes in looked_at[6:9]:
        np.testing.assert_allclose(boxes[:1], [NEAR], atol=1)


def test_a_vehicle_that_is_gone_is_dropped_once_its_score_is_used_up(scripted):
    _, looked_at = scripted([[(NEAR, 1.5)]] * 5 + [[]] * 12)
    # Five times the score less the offset is used up at the offset a frame.
    gathered = 5 * (1.5 - DEFAULT_TRACKS.score_offset)
    assert gathered < DEFAULT_TRACKS.max_score
    n_frames = math.ceil(gathered / DEFAULT_TRACKS.score_offset)
    # What is proposed is looked at beside what is predicted.
    expected = [2] * 4 + [1] * n_frames + [0] * (12 - n_frames)
    assert [len(boxes) for boxes in looked_at[1:]] == expected


def test_what_has_left_the_frame_is_no_longer_looked_for(scripted):
    leaving = [[((200.0 + 20 * i, 80, 250 + 20 * i, 120), 3.0)] for i in range(6)]
    _, looked_at = scripted(leaving + [[]] * 10)
    for boxes in looked_at:
        sides = boxes[:, 2:] - boxes[:, :2]
        assert (sides >= 1).all() and (boxes[:, 0] < 320).all()
    # The track lasts longer than its way out of the frame.
    assert len(looked_at[6]) == 1 and [len(boxes) for boxes in looked_at[8:12]] == [0] * 4


@pytest.mark.parametrize(("score", "count"), [(0.55, 1), (0.45, 0)])
def test_a_still_shows_what_scores_enough(scripted, score, count):
    (found,), _ = scripted([[(NEAR, score)]], params=STILL_PARAMS)
    assert len(found.boxes) == count


def test_a_sign_above_the_road_loses_score(scripted):
    sign = (250.0, 30, 274, 55)
    (before,), _ = scripted([[(sign, 3.0)]])
    (after,), _ = scripted([[(FAR, 3.0), (NEAR, 3.0), (sign, 3.0)]])
    # Before a car has been seen it may be one on another road, but hardly.
    assert 0 < before.candidate_scores[0] < 3
    scores = dict(zip(map(tuple, after.candidates), after.candidate_scores, strict=True))
    assert scores[FAR] > 2.5 and scores[NEAR] > 2.5 and scores[sign] < before.candidate_scores[0]


def test_half_a_car_loses_score_beside_whole_ones(scripted):
    half = (240.0, 110, 284, 136)
    found, _ = scripted([[(FAR, 3.0), (NEAR, 3.0), (half, 3.0)]] * 12)
    scores = dict(zip(map(tuple, found[-1].candidates), found[-1].candidate_scores, strict=True))
    assert scores[half] < scores[NEAR] - 0.5


def test_lorries_and_what_the_border_cuts_do_not_tell_the_road(scripted):
    # All of these end far below; were they cars, the horizon would be taken to be lower.
    lorry, cut = (20.0, 40, 100, 160), (250.0, 100, 320, 150)
    known = [[(FAR, 2.0), (NEAR, 2.0)]] * 6
    alone, _ = scripted(known)
    beside, _ = scripted([rows + [(lorry, 2.0), (cut, 2.0)] for rows in known])
    for one, other in zip(alone, beside, strict=True):
        assert one.candidate_scores[0] == pytest.approx(other.candidate_scores[0], abs=1e-3)


def test_reset_forgets(path):
    vehicle = TwoStageVehicle(None, path, params=TwoStageParams(tracks=EAGER))
    first = [vehicle.detect(frame) for frame in frames(8)]
    vehicle.reset()
    again = [vehicle.detect(frame) for frame in frames(8)]
    assert sum(len(one.candidates) for one in first) > 0
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.candidates, other.candidates)
        np.testing.assert_array_equal(one.boxes, other.boxes)
        np.testing.assert_array_equal(one.ids, other.ids)


def test_frames_of_two_sizes_are_refused(path):
    vehicle = TwoStageVehicle(None, path)
    vehicle.detect(textured_image(0, 180, 320))
    with pytest.raises(ValueError, match="after one of"):
        vehicle.detect(textured_image(0, 360, 640))


def test_pictures_show_the_vehicles(path):
    vehicle = TwoStageVehicle(None, path, replace(STILL_PARAMS, tracks=EAGER))
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
    vehicle = TwoStageVehicle(None, ROOT / "param/detector.npz")
    clip = islice(read_frames(ROOT / "videos/drive.mp4"), 60)
    found = rows_of_detections([vehicle.detect(frame) for frame in clip])
    figures = evaluate(read_rows(ROOT / "videos/drive.gt.txt"), found, range(1, 61))
    assert figures["recall"] > 0.85 and figures["precision"] > 0.95
    assert figures["mean IoU"] > 0.75 and figures["identity switches"] <= 1


def test_the_shipped_detector_finds_vehicles_in_stills():
    vehicle = TwoStageVehicle(None, ROOT / "param/detector.npz", STILL_PARAMS)
    clip = islice(read_frames(ROOT / "videos/drive.mp4"), 0, 150, 30)
    truth = read_rows(ROOT / "videos/drive.gt.txt")
    numbers, found = range(1, 151, 30), []
    for frame in clip:
        vehicle.reset()
        found.append(vehicle.detect(frame))
    rows = rows_of_detections(found)
    rows = replace(rows, frames=np.array(numbers)[rows.frames - 1])
    chosen = truth.only(np.isin(truth.frames, numbers))
    figures = evaluate(chosen, rows, range(1, 151))
    assert figures["recall"] > 0.75 and figures["precision"] > 0.9


def test_an_entering_vehicle_of_the_real_video_is_boxed_within_ten_frames(real_data):
    # A part of the video that the detector has learned from: whether it works at all.
    truth = read_rows(real_data / "truth/project_video.gt.txt")
    vehicle = TwoStageVehicle(None, ROOT / "param/detector.npz")
    clip = islice(read_frames(real_data / "udacity/project_video.mp4"), 240)
    figures = evaluate(
        truth, rows_of_detections([vehicle.detect(frame) for frame in clip]), range(1, 241)
    )
    assert figures["frames to first box"]["1 from 162"] <= 10
    assert figures["recall"] > 0.9 and figures["false positives"] <= 2
