"""Vehicle, video files and the command line of detect.py."""

import subprocess
import sys
import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest

from conftest import ROOT, random_classifier, random_detector, textured_image
from experiments.table import reference
from pipeline_functions import are_near
from vehicle_detection.classifier import save_classifier
from vehicle_detection.media.calibration import Calibration, save_calibration
from vehicle_detection.media.drawing import identity_color
from vehicle_detection.media.images import write_image
from vehicle_detection.media.mot import mot_rows
from vehicle_detection.media.videos import VideoInfo, read_frames, video_info, video_writer
from vehicle_detection.parameters import (
    FEATURE_PRESETS,
    SEARCH_PRESETS,
    STILL_SCAN,
    STILL_TRACKS,
    FeatureParams,
)
from vehicle_detection.two_stage.model import save_detector
from vehicle_detection.two_stage.vehicle import FILTER_PRESETS, FilterParams, HeatVehicle, Vehicle


def moving_frames(count, rows=180, columns=320):
    """Noise with a bright patch that wanders to the right."""
    ground = textured_image(0, rows, columns) // 2
    for i in range(count):
        frame = ground.copy()
        frame[110:150, 40 + 6 * i : 100 + 6 * i] = (250, 240, 60)
        yield frame


@pytest.fixture
def param(tmp_path):
    """Parameter file of a classifier with random weights; about half of all windows are hot."""
    path = tmp_path / "svc.p"
    save_classifier(random_classifier(FeatureParams(spatial_color="HLS", hist_color="RGB")), path)
    return path


def write_video(path, frames, fps=25):
    frames = list(frames)
    rows, columns = frames[0].shape[:2]
    with video_writer(path, VideoInfo(columns, rows, fps, len(frames))) as write:
        for frame in frames:
            write(frame)
    return path


# ------------------------------------------------------------------- vehicle


@pytest.mark.parametrize("preset", ["G", "B"])
def test_vehicle_equals_the_full_size_reference(param, preset):
    vehicle = HeatVehicle(None, param, heat_filter=FILTER_PRESETS[preset])
    slow = reference.Detector(vehicle.classifier, SEARCH_PRESETS["G"], FILTER_PRESETS[preset])
    n_boxes = 0
    for frame in moving_frames(18):
        detections = vehicle.detect(frame)
        np.testing.assert_array_equal(detections.boxes, slow.detect(frame))
        n_boxes += len(detections.boxes)
    assert n_boxes > 0


def test_process_image_draws_the_boxes(param):
    vehicle = HeatVehicle(None, param, heat_filter=FilterParams(1, 1, 0))
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
    straight = HeatVehicle(tmp_path / "calib.p", param)
    plain = HeatVehicle(None, param)
    frame = next(moving_frames(1))
    detections = straight.detect(frame)
    np.testing.assert_array_equal(detections.boxes, plain.detect(frame).boxes)
    expected = cv2.undistort(plain.draw(frame, detections), mtx, straight.calibration.dist)
    difference = np.abs(straight.draw(frame, detections).astype(int) - expected)
    assert np.mean(difference) < 1 and not np.array_equal(expected, frame)


def test_between_scans_only_known_places_are_visited(param):
    search = replace(SEARCH_PRESETS["G"], scan_every=3)
    vehicle = HeatVehicle(None, param, search, FilterParams(1, 1, 2))
    full = HeatVehicle(None, param, heat_filter=FilterParams(1, 1, 2))
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
    vehicle = HeatVehicle(None, param)
    frames = list(moving_frames(20))
    first = [vehicle.detect(frame).filtered for frame in frames]
    vehicle.reset()
    again = [vehicle.detect(frame).filtered for frame in frames]
    np.testing.assert_array_equal(first, again)


def test_frames_of_two_sizes_are_refused(param):
    vehicle = HeatVehicle(None, param)
    vehicle.detect(textured_image(0, 180, 320))
    with pytest.raises(ValueError, match="after one of"):
        vehicle.detect(textured_image(0, 360, 640))


def test_filter_params_refuse():
    with pytest.raises(ValueError, match="n_occ_thr"):
        FilterParams(n_acc=3, n_occ_thr=4, threshold=1)


# --------------------------------------------------------------------- video


@pytest.mark.parametrize(("rows", "columns"), [(180, 320), (181, 321)])
def test_video_comes_back_in_rgb(tmp_path, rows, columns):
    frames = list(moving_frames(12, rows, columns))
    path = write_video(tmp_path / "clip.mp4", frames)
    info = video_info(path)
    assert (info.width, info.height, info.fps, info.n_frames) == (columns, rows, 25, 12)
    back = list(read_frames(path))
    assert len(back) == 12
    patch = back[3][120:140, 70:100].reshape(-1, 3).mean(axis=0)
    np.testing.assert_allclose(patch, (250, 240, 60), atol=12)


def test_reader_can_be_left_early(tmp_path):
    path = write_video(tmp_path / "clip.mp4", moving_frames(60))
    before = threading.active_count()
    frames = read_frames(path)
    next(frames)
    frames.close()
    assert threading.active_count() == before


def test_bad_videos_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"gone\.mp4: no such video"):
        video_info(tmp_path / "gone.mp4")
    (tmp_path / "text.mp4").write_text("no video")
    with pytest.raises(ValueError, match=r"text\.mp4: not a readable video"):
        video_info(tmp_path / "text.mp4")


def test_truncated_video_is_named(tmp_path):
    path = write_video(tmp_path / "clip.avi", moving_frames(100))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 3])
    with pytest.raises(ValueError, match=r"clip\.avi: (ends after|not a readable video)"):
        list(read_frames(path))


def test_failed_video_leaves_nothing(tmp_path):
    info = VideoInfo(320, 180, 25, 2)
    with pytest.raises(RuntimeError), video_writer(tmp_path / "a.mp4", info) as write:
        write(next(moving_frames(1)))
        raise RuntimeError
    with (
        pytest.raises(ValueError, match="does not fit the video"),
        video_writer(tmp_path / "b.mp4", info) as write,
    ):
        write(textured_image(0, 90, 160))
    with pytest.raises(ValueError, match="no frame"), video_writer(tmp_path / "d.mp4", info):
        pass
    with (
        pytest.raises(OSError, match=r"/c\.mp4: cannot be encoded: .*no preset"),
        video_writer(tmp_path / "c.mp4", info, "no preset") as write,
    ):
        for frame in moving_frames(40):
            write(frame)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("head -c 100000 > /dev/null; echo out of paper >&2; exit 3", "out of paper"),
        ("head -c 100000 > /dev/null; exit 0", "BrokenPipeError"),
        ("head -c 300000 /dev/zero | tr '\\0' x >&2; cat > /dev/null; exit 1", "x"),
        ("cat > /dev/null; exit 4", "status 4"),
    ],
)
def test_an_encoder_that_fails_midway_is_named(tmp_path, monkeypatch, script, reason):
    encoder = tmp_path / "encoder"
    encoder.write_text(f"#!/bin/sh\n{script}\n")
    encoder.chmod(0o755)
    monkeypatch.setattr("video.FFMPEG_BINARY", str(encoder))
    with pytest.raises(OSError, match=rf"/clip\.mp4: cannot be encoded: .*{reason}"):
        write_video(tmp_path / "clip.mp4", moving_frames(40))
    assert list(tmp_path.iterdir()) == [encoder]


# ---------------------------------------------------------------- detect.py


def run(*arguments):
    return subprocess.run(
        [sys.executable, "detect.py", *map(str, arguments)],
        cwd=ROOT, capture_output=True, text=True,
    )  # fmt: skip


def test_detect_writes_pictures_and_boxes(param, tmp_path):
    clip = write_video(tmp_path / "clip.mp4", moving_frames(20))
    images = tmp_path / "images"
    write_image(images / "still.png", next(moving_frames(1)))
    out = tmp_path / "out"
    result = run(clip, images, "--out", out, "--filter", "G", "--param", param, "--split-screen")
    assert result.returncode == 0, result.stderr
    assert {path.name for path in out.iterdir()} == {
        "clip.mp4", "clip.txt", "clip_split.mp4", "still.png", "still.txt",
    }  # fmt: skip
    assert len(list(read_frames(out / "clip.mp4"))) == 20
    assert len(list(read_frames(out / "clip_split.mp4"))) == 20
    rows = np.loadtxt(out / "clip.txt", delimiter=",", ndmin=2)
    vehicle = HeatVehicle(None, param)
    found = [vehicle.detect(frame) for frame in read_frames(clip)]
    expected = [
        (number, identity, left, top, right - left, bottom - top)
        for number, detections in enumerate(found, start=1)
        for identity, (left, top, right, bottom) in zip(
            detections.ids, detections.boxes, strict=True
        )
    ]
    assert len(rows) > 0 and rows[:, 1].min() == 1
    np.testing.assert_array_equal(rows[:, :6], expected)
    assert (rows[:, 7:] == -1).all()


def test_detect_with_two_stages_writes_what_vehicle_finds(tmp_path):
    save_detector(random_detector(3), tmp_path / "detector.npz")
    clip = write_video(tmp_path / "clip.mp4", moving_frames(9))
    write_image(tmp_path / "still.png", next(moving_frames(1)))
    options = "--out", tmp_path / "out", "--param", tmp_path / "detector.npz", "--split-screen"
    result = run(clip, tmp_path / "still.png", *options)
    assert result.returncode == 0, result.stderr
    vehicle = Vehicle(None, tmp_path / "detector.npz")
    found = [vehicle.detect(frame) for frame in read_frames(clip)]
    lines = (tmp_path / "out/clip.txt").read_text().splitlines()
    assert lines == [row for n, one in enumerate(found, start=1) for row in mot_rows(n, one)]
    assert video_info(tmp_path / "out/clip_split.mp4").n_frames == 9
    still = Vehicle(None, tmp_path / "detector.npz", STILL_SCAN, STILL_TRACKS)
    rows = mot_rows(1, still.detect(next(moving_frames(1))))
    assert (tmp_path / "out/still.txt").read_text().splitlines() == rows
    assert len(rows) > 0


@pytest.mark.parametrize("option", [("--search", "B"), ("--horizon", "0.5"), ("--scan-every", "3")])
def test_options_of_the_other_way_are_refused(tmp_path, option):
    write_image(tmp_path / "still.png", next(moving_frames(1)))
    result = run(tmp_path / "still.png", "--out", tmp_path / "out", *option)
    assert result.returncode == 1
    assert f"error: {option[0]} goes with --filter G or B only" in result.stderr


@pytest.mark.parametrize(
    "name, message",
    [
        ("gone.mp4", "no such video"),
        ("notes.txt", "neither an image nor a video"),
        ("text.mp4", "not a readable video"),
        ("text.png", "not a readable image"),
    ],
)
def test_detect_names_bad_input(param, tmp_path, name, message):
    if name != "gone.mp4":
        (tmp_path / name).write_text("no picture")
    out = tmp_path / "out"
    result = run(tmp_path / name, "--out", out, "--filter", "G", "--param", param)
    assert result.returncode == 1
    last = result.stderr.splitlines()[-1]
    assert last.startswith(f"error: {tmp_path / name}: ") and message in last
    assert not out.exists() or list(out.iterdir()) == []


def test_two_inputs_of_one_name_are_refused(param, tmp_path):
    for folder in ("a", "b"):
        write_image(tmp_path / folder / "same.png", next(moving_frames(1)))
    result = run(
        tmp_path / "a", tmp_path / "b", "--out", tmp_path / "out", "--filter", "G", "--param", param
    )
    assert result.returncode == 1 and "is taken: use another --out" in result.stderr


def test_an_input_is_never_overwritten(param, tmp_path):
    write_image(tmp_path / "still.png", next(moving_frames(1)))
    before = (tmp_path / "still.png").read_bytes()
    result = run(tmp_path / "still.png", "--out", tmp_path, "--filter", "G", "--param", param)
    assert result.returncode == 1 and "is taken: use another --out" in result.stderr
    assert (tmp_path / "still.png").read_bytes() == before


def test_what_is_wrong_with_a_frame_names_the_file(param, tmp_path):
    write_image(tmp_path / "tiny.png", textured_image(0, 20, 320))
    result = run(
        tmp_path / "tiny.png", "--out", tmp_path / "out", "--filter", "G", "--param", param
    )
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].startswith(
        f"error: {tmp_path / 'tiny.png'}: no window fits"
    )


def test_shipped_classifier_is_preset_g():
    vehicle = HeatVehicle(ROOT / "param/calib.p", ROOT / "param/svc_pickle.p")
    assert vehicle.classifier.params == FEATURE_PRESETS["G"]
    assert vehicle.classifier.data_counts == {"vehicles": 8792, "non-vehicles": 8968}
