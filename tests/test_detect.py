"""The command line of detect.py."""

import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import detect
from conftest import CASES, ROOT, moving_frames, random_detector, textured_image, write_video
from vehicle import Vehicle
from vehicle_detection.media.images import write_image
from vehicle_detection.media.mot import mot_rows
from vehicle_detection.media.videos import read_frames, video_info
from vehicle_detection.parameters import STILL_PARAMS
from vehicle_detection.two_stage.model import save_detector
from vehicle_detection.two_stage.vehicle import TwoStageVehicle


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
    result = run(clip, images, "--out", out, "--method", "G", "--param", param, "--split-screen")
    assert result.returncode == 0, result.stderr
    assert {path.name for path in out.iterdir()} == {
        "clip.mp4", "clip.txt", "clip_split.mp4", "still.png", "still.txt",
    }  # fmt: skip
    assert len(list(read_frames(out / "clip.mp4"))) == 20
    assert len(list(read_frames(out / "clip_split.mp4"))) == 20
    rows = np.loadtxt(out / "clip.txt", delimiter=",", ndmin=2)
    vehicle = Vehicle(None, param)
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
    vehicle = TwoStageVehicle(None, tmp_path / "detector.npz")
    found = [vehicle.detect(frame) for frame in read_frames(clip)]
    lines = (tmp_path / "out/clip.txt").read_text().splitlines()
    assert lines == [row for n, one in enumerate(found, start=1) for row in mot_rows(n, one)]
    assert video_info(tmp_path / "out/clip_split.mp4").n_frames == 9
    still = TwoStageVehicle(None, tmp_path / "detector.npz", STILL_PARAMS)
    rows = mot_rows(1, still.detect(next(moving_frames(1))))
    assert (tmp_path / "out/still.txt").read_text().splitlines() == rows
    assert len(rows) > 0


def test_without_arguments_the_shipped_clip_is_meant():
    arguments = detect.parse_arguments([])
    assert arguments.inputs == [ROOT / "videos/drive.mp4"] and arguments.inputs[0].is_file()
    assert arguments.out == Path("output") and arguments.method == "two-stage"
    for path in detect.SHIPPED_PARAMS.values():
        assert path.is_file()


@pytest.mark.parametrize("option", [("--horizon", "0.5"), ("--scan-every", "3")])
def test_options_of_the_other_method_are_refused(tmp_path, option):
    write_image(tmp_path / "still.png", next(moving_frames(1)))
    result = run(tmp_path / "still.png", "--out", tmp_path / "out", *option)
    assert result.returncode == 2
    assert "--horizon and --scan-every go with --method G or B only" in result.stderr


@pytest.mark.parametrize(
    "name, message",
    [
        ("gone.mp4", "no such file"),
        ("notes.txt", "neither an image nor a video"),
        ("text.mp4", "not a readable video"),
        ("text.png", "not a readable image"),
    ],
)
def test_detect_names_bad_input(param, tmp_path, name, message):
    if name != "gone.mp4":
        (tmp_path / name).write_text("no picture")
    out = tmp_path / "out"
    result = run(tmp_path / name, "--out", out, "--method", "G", "--param", param)
    assert result.returncode == 1
    last = result.stderr.splitlines()[-1]
    assert last.startswith(f"error: {tmp_path / name}: ") and message in last
    assert not out.exists() or list(out.iterdir()) == []


def test_two_inputs_of_one_name_get_two_outputs(param, tmp_path):
    for folder in ("a", "b"):
        write_image(tmp_path / folder / "same.png", next(moving_frames(1)))
    out = tmp_path / "out"
    command = tmp_path / "a", tmp_path / "b", "--out", out, "--method", "G", "--param", param
    assert run(*command).returncode == 0
    names = {"same.png", "same.txt", "same_2.png", "same_2.txt"}
    assert {path.name for path in out.iterdir()} == names
    again = run(*command)
    assert again.returncode == 1 and "is there already" in again.stderr
    assert run(*command, "--overwrite", "--quiet").stdout == ""


def test_one_bad_file_stops_no_other(param, tmp_path):
    write_image(tmp_path / "in/good.png", next(moving_frames(1)))
    (tmp_path / "in/bad.png").write_text("text")
    (tmp_path / "in/bad.mp4").write_text("text")
    out = tmp_path / "out"
    result = run(tmp_path / "in", "--out", out, "--method", "G", "--param", param)
    assert result.returncode == 1 and "wrote 1 of 3" in result.stdout
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 2 and {path.name for path in out.iterdir()} == {"good.png", "good.txt"}


def test_losses_have_a_code_of_their_own(tmp_path):
    result = run(CASES / "damaged.mp4", "--out", tmp_path, "--quiet")
    assert result.returncode == 3
    expected = f"warning: {CASES / 'damaged.mp4'}: 1 frame cannot be decoded: 41"
    assert result.stderr.strip() == expected
    numbers = {int(line.split(",")[0]) for line in (tmp_path / "damaged.txt").open()}
    assert 150 in numbers and 41 not in numbers


@pytest.mark.parametrize("shape", [(2, 2), (16, 16), (2000, 3), (63, 200)])
def test_frames_too_small_to_search_are_said(param, tmp_path, shape):
    write_image(tmp_path / "img.png", np.zeros((*shape, 3), np.uint8))
    for method in (["--method", "G", "--param", param], []):
        result = run(tmp_path / "img.png", "--out", tmp_path / "out", *method)
        assert result.returncode == 1
        assert f"no window fits a frame of {shape[1]}x{shape[0]}" in result.stderr


def test_an_input_is_never_overwritten(param, tmp_path):
    write_image(tmp_path / "still.png", next(moving_frames(1)))
    before = (tmp_path / "still.png").read_bytes()
    options = "--out", tmp_path, "--method", "G", "--param", param, "--overwrite"
    result = run(tmp_path / "still.png", *options)
    assert result.returncode == 1 and "is an input: use another --out" in result.stderr
    assert (tmp_path / "still.png").read_bytes() == before


def test_what_is_wrong_with_a_frame_names_the_file(param, tmp_path):
    write_image(tmp_path / "tiny.png", textured_image(0, 20, 320))
    result = run(
        tmp_path / "tiny.png", "--out", tmp_path / "out", "--method", "G", "--param", param
    )
    assert result.returncode == 1
    assert result.stderr.splitlines()[-1].startswith(
        f"error: {tmp_path / 'tiny.png'}: no window fits"
    )


def test_a_run_is_continued(tmp_path):
    """What has its results from the same settings is skipped, and nothing else."""
    save_detector(random_detector(3), tmp_path / "detector.npz")
    for name in ("a", "b"):
        write_image(tmp_path / f"in/{name}.png", next(moving_frames(1)))
    out = tmp_path / "out"
    command = tmp_path / "in", "--out", out, "--param", tmp_path / "detector.npz", "--resume"
    assert "wrote 2 of 2" in run(*command).stdout
    assert "wrote 0 of 0" in run(*command).stdout
    (out / "b.txt").unlink()
    assert "wrote 1 of 1" in run(*command).stdout
    write_image(tmp_path / "in/a.png", textured_image(1, 180, 320))
    assert "wrote 1 of 1" in run(*command).stdout
    assert "wrote 2 of 2" in run(*command, "--format", "json").stdout
    save_detector(random_detector(4), tmp_path / "detector.npz")
    assert "wrote 2 of 2" in run(*command).stdout
    (out / ".finished.json").write_text("[1")
    damaged = run(*command)
    assert damaged.returncode == 1 and "damaged: delete it" in damaged.stderr


@pytest.fixture
def drives(tmp_path):
    """Three short clips and a still, with the shipped detector some boxes in each."""
    for name in ("gps_track.mp4", "av1.mp4", "sound.mp4"):
        (tmp_path / "in").mkdir(exist_ok=True)
        shutil.copy(CASES / name, tmp_path / "in")
    return tmp_path / "in"


def texts(folder):
    return {path.name: path.read_text() for path in folder.glob("*.txt")}


def test_several_at_once_give_the_same(drives, tmp_path):
    (drives / "bad.mp4").write_text("text")
    for jobs in (1, 2):
        result = run(drives, "--out", tmp_path / f"{jobs}", "--jobs", jobs)
        assert result.returncode == 1 and "wrote 3 of 4" in result.stdout
        assert "bad.mp4: not a readable video" in result.stderr.splitlines()[-1]
    assert texts(tmp_path / "1") == texts(tmp_path / "2")
    assert len(texts(tmp_path / "1")) == 3 and all(texts(tmp_path / "1").values())


def test_over_dask_with_two_workers(drives, tmp_path):
    distributed = pytest.importorskip("distributed", reason="dask.distributed is optional")
    assert run(drives, "--out", tmp_path / "alone").returncode == 0
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as c:
        result = run(drives, "--out", tmp_path / "dask", "--scheduler", c.scheduler_address)
    assert result.returncode == 0, result.stderr
    assert texts(tmp_path / "alone") == texts(tmp_path / "dask")
    assert all(texts(tmp_path / "dask").values())


@pytest.mark.parametrize(
    ("name", "suffix"), [("csv", "csv"), ("coco", "coco.json"), ("yolo", "yolo.zip")]
)
def test_other_formats(tmp_path, name, suffix):
    clip = write_video(tmp_path / "clip.mp4", list(moving_frames(3)))
    result = run(clip, "--out", tmp_path / "out", "--format", name)
    assert result.returncode == 0, result.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"clip.mp4", f"clip.{suffix}"}


@pytest.mark.parametrize(
    "options",
    [
        ["--camera-height", "1.3"],
        ["rtsp://camera/stream", "--format", "coco"],
        ["rtsp://camera/stream", "--report"],
        ["rtsp://camera/stream", "drive.mp4"],
        ["--camera", "0", "--resume"],
    ],
)
def test_options_that_do_not_go_together_are_refused(options):
    with pytest.raises(SystemExit, match="2"):
        detect.parse_arguments(options)


def test_addresses_stay_as_they_are():
    assert detect.parse_arguments(["rtsp://h:554//s/"]).inputs == ["rtsp://h:554//s/"]
    assert detect.parse_arguments(["a//b"]).inputs == [Path("a/b")]


def test_a_wrong_truth_is_said_before_any_work(tmp_path):
    (tmp_path / "truth.txt").write_text("text")
    out = tmp_path / "out"
    result = run(CASES / "gps_track.mp4", "--out", out, "--truth", tmp_path / "truth.txt")
    assert result.returncode == 1 and "truth.txt, line 1" in result.stderr
    assert not out.exists() or not list(out.iterdir())


def test_a_report_that_is_gone_is_made_again(tmp_path):
    command = CASES / "gps_track.mp4", "--out", tmp_path, "--report", "--resume", "--quiet"
    for name in ("gps_track_report.html", "gps_track_split.mp4"):
        assert run(*command).returncode == 0
        (tmp_path / name).unlink()
    assert run(*command).returncode == 0 and (tmp_path / "gps_track_split.mp4").is_file()
    # What nobody here has made is not replaced.
    (tmp_path / "sound.txt").write_text("mine")
    other = CASES / "sound.mp4", "--out", tmp_path, "--resume"
    assert run(*other).returncode == 1 and (tmp_path / "sound.txt").read_text() == "mine"


def test_nothing_is_left_by_workers_that_are_stopped(tmp_path):
    for name in ("a", "b"):
        shutil.copy(ROOT / "videos/drive.mp4", tmp_path / f"{name}.mp4")
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "detect.py", tmp_path, "--out", out, "--jobs", "2", "--quiet"], cwd=ROOT,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    for _ in range(300):
        time.sleep(0.1)
        if out.exists() and len(list(out.iterdir())) >= 4:
            break
    process.terminate()
    assert process.wait() == 143
    for _ in range(80):
        time.sleep(0.1)
        if not list(out.iterdir()):
            return
    pytest.fail(f"still there: {list(out.iterdir())}")
