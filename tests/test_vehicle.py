"""`Vehicle`, the write-up's class, against the published way at full size."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from moviepy import VideoFileClip

from conftest import ROOT, moving_frames, random_classifier, textured_image
from experiments import reference
from pipeline_functions import are_near, find_cars
from vehicle import Vehicle
from vehicle_detection.media.calibration import Calibration, save_calibration
from vehicle_detection.media.drawing import identity_color
from vehicle_detection.media.videos import read_frames
from vehicle_detection.parameters import (
    FEATURE_PRESETS,
    FILTER_PRESETS,
    SEARCH_PRESETS,
    FeatureParams,
    FilterParams,
)


@pytest.mark.parametrize("preset", ["G", "B"])
def test_vehicle_equals_the_full_size_reference(param, preset):
    vehicle = Vehicle(None, param, heat_filter=FILTER_PRESETS[preset])
    slow = reference.Detector(vehicle.classifier, SEARCH_PRESETS["G"], FILTER_PRESETS[preset])
    n_boxes = 0
    for frame in moving_frames(18):
        detections = vehicle.detect(frame)
        np.testing.assert_array_equal(detections.boxes, slow.detect(frame))
        n_boxes += len(detections.boxes)
    assert n_boxes > 0


def test_process_image_draws_the_boxes(param):
    vehicle = Vehicle(None, param, heat_filter=FilterParams(1, 1, 0))
    frame = next(moving_frames(1))
    drawn = vehicle.process_image(frame)
    vehicle.reset()
    detections = vehicle.detect(frame)
    left, top, right, bottom = detections.boxes[0]
    assert (drawn[top, left : right - 1] == identity_color(detections.ids[0])).all()
    assert drawn.shape == frame.shape and len(vehicle.step_pictures(frame, detections)) == 4
    assert vehicle.draw_split_screen(frame, detections).shape == frame.shape


def test_calibration_straightens_only_the_picture(param, tmp_path):
    mtx = np.array([[300.0, 0, 160], [0, 300, 90], [0, 0, 1]])
    save_calibration(
        Calibration(mtx, np.array([[-0.3, 0.1, 0, 0, 0]]), (320, 180)), tmp_path / "calib.p"
    )
    straight = Vehicle(tmp_path / "calib.p", param)
    plain = Vehicle(None, param)
    frame = next(moving_frames(1))
    detections = straight.detect(frame)
    np.testing.assert_array_equal(detections.boxes, plain.detect(frame).boxes)
    expected = cv2.undistort(plain.draw(frame, detections), mtx, straight.calibration.dist)
    difference = np.abs(straight.draw(frame, detections).astype(int) - expected)
    assert np.mean(difference) < 1 and not np.array_equal(expected, frame)


def test_between_scans_only_known_places_are_visited(param):
    search = replace(SEARCH_PRESETS["G"], scan_every=3)
    vehicle = Vehicle(None, param, search, FilterParams(1, 1, 2))
    full = Vehicle(None, param, heat_filter=FilterParams(1, 1, 2))
    known = None
    for number, frame in enumerate(moving_frames(7)):
        detections = vehicle.detect(frame)
        expected = full.detect(frame).hot_windows
        if number % 3:
            expected = expected[are_near(expected, known)]
        np.testing.assert_array_equal(detections.hot_windows, expected)
        known = [*detections.hot_windows, *detections.boxes]
        known = boxes_around(known, frame.shape)
    assert len(known) > 0


def boxes_around(boxes, shape):
    """Bounding boxes of all that hangs together."""
    return reference.boxes_of(reference.heatmap_of(boxes, shape), 0)


def test_reset_forgets(param):
    vehicle = Vehicle(None, param)
    frames = list(moving_frames(20))
    first = [vehicle.detect(frame).filtered for frame in frames]
    vehicle.reset()
    again = [vehicle.detect(frame).filtered for frame in frames]
    np.testing.assert_array_equal(first, again)


def test_frames_of_two_sizes_are_refused(param):
    vehicle = Vehicle(None, param)
    vehicle.detect(textured_image(0, 180, 320))
    with pytest.raises(ValueError, match="after one of"):
        vehicle.detect(textured_image(0, 360, 640))


def test_filter_params_refuse():
    with pytest.raises(ValueError, match="n_occ_thr"):
        FilterParams(n_acc=3, n_occ_thr=4, threshold=1)


def test_shipped_classifier_is_preset_g():
    vehicle = Vehicle(ROOT / "param/calib.p", ROOT / "param/svc_pickle.p")
    assert vehicle.classifier.params == FEATURE_PRESETS["G"]
    assert vehicle.classifier.data_counts == {"vehicles": 8792, "non-vehicles": 8968}


def test_the_write_ups_own_line_works_as_it_stands(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    out = tmp_path / "annotated.mp4"
    VideoFileClip("videos/drive.mp4").image_transform(
        Vehicle("./param/calib.p", "./param/svc_pickle.p").process_image
    ).write_videofile(str(out), logger=None)
    assert sum(1 for _ in read_frames(out)) == sum(1 for _ in read_frames("videos/drive.mp4"))


def test_a_vehicle_has_the_write_ups_parameters_and_takes_a_classifier(classifier_g):
    vehicle = Vehicle(None, classifier_g)
    assert (vehicle.n_acc, vehicle.n_occ_thr, vehicle.threshold) == (15, 4, 12)
    assert vehicle.calibration is None
    vehicle.load_calibration(ROOT / "param/calib.p")
    assert vehicle.calibration.mtx.shape == (3, 3)
    assert vehicle.process_image(next(moving_frames(1, 360, 640))).shape == (360, 640, 3)


def test_any_classifier_with_a_decision_function_will_do():
    linear = random_classifier(FeatureParams(hist_color="RGB"))

    class Own:
        """Scores like the linear one, without telling its weights."""

        params = linear.params

        def decision_function(self, features):
            return linear.decision_function(features)

    frame = next(moving_frames(1))
    ours, theirs = Vehicle(None, Own()), Vehicle(None, linear)
    hot = ours.detect(frame).hot_windows
    np.testing.assert_array_equal(hot, theirs.detect(frame).hot_windows)
    assert len(hot) > 0


@pytest.mark.parametrize("limits", [(0, 640), (400, 1280)])
def test_x_limits_leave_out_windows(limits):
    classifier = random_classifier(FeatureParams(hist_color="RGB"))
    frame = next(moving_frames(1, 720, 1280))
    everywhere, scores = find_cars(frame, classifier, SEARCH_PRESETS["G"])
    windows, own = find_cars(frame, classifier, replace(SEARCH_PRESETS["G"], x_limits=limits))
    within = (everywhere[:, 0] >= limits[0]) & (everywhere[:, 2] <= limits[1])
    np.testing.assert_array_equal(windows, everywhere[within])
    np.testing.assert_allclose(own, scores[within], atol=1e-5)
