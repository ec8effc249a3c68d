"""Videos in and out, and what is wrong with some."""

import threading

import numpy as np
import pytest

from conftest import moving_frames, textured_image, write_video
from vehicle_detection.media.videos import VideoInfo, read_frames, video_info, video_writer


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
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(encoder))
    with pytest.raises(OSError, match=rf"/clip\.mp4: cannot be encoded: .*{reason}"):
        write_video(tmp_path / "clip.mp4", moving_frames(40))
    assert list(tmp_path.iterdir()) == [encoder]
