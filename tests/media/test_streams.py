"""A stream of this machine: newest frames, what is dropped, and a clean end."""

import os
import signal
import subprocess
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import pytest

from conftest import CASES, ROOT
from vehicle_detection.media.mot import read_rows
from vehicle_detection.media.streams import LiveReader, annotate_stream
from vehicle_detection.media.videos import VideoReader, read_frames
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

FRAMES = [cv2.cvtColor(f, cv2.COLOR_RGB2BGR) for f in read_frames(CASES / "sound.mp4")]


@pytest.fixture
def stream():
    """An address that sends a clip as motion JPEG, 25 frames a second, over and over if asked."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            rounds = 1000 if "endless" in self.path else 1
            for frame in FRAMES * rounds:
                content = cv2.imencode(".jpg", frame)[1].tobytes()
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(content)}"
                try:
                    self.wfile.write(head.encode() + b"\r\n\r\n" + content + b"\r\n")
                except OSError:
                    return
                time.sleep(0.04)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


def test_a_slow_reader_gets_the_newest_frames(stream):
    reader, numbers = LiveReader(f"{stream}/clip.mjpg"), []
    assert (reader.info.width, reader.info.height) == (480, 272)
    for frame in reader:
        assert frame.rgb.shape == (272, 480, 3)
        numbers.append(frame.number)
        time.sleep(0.15)
    reader.close()
    assert numbers == sorted(set(numbers)) and len(numbers) < 40
    assert reader.n_dropped + len(numbers) == numbers[-1] > 60


def test_boxes_and_video_of_a_stream(stream, tmp_path):
    said = annotate_stream(f"{stream}/clip.mjpg", tmp_path, TwoStageVehicle())
    rows = read_rows(tmp_path / "live.txt")
    assert len(rows.frames) > 10 and "frames searched" in said
    shown = list(VideoReader(tmp_path / "live.mp4"))
    assert f"{len(shown)} frames searched" in said
    # As long as it took, whatever was dropped.
    assert 2 < shown[-1].time * float(VideoReader(tmp_path / "live.mp4").info.time_base) < 20
    with pytest.raises(FileExistsError):
        annotate_stream(f"{stream}/clip.mjpg", tmp_path, TwoStageVehicle())


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_it_can_be_stopped_at_any_moment(stream, tmp_path, how):
    process = subprocess.Popen(
        [sys.executable, "detect.py", f"{stream}/endless.mjpg", "--out", tmp_path],
        cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"OPENCV_FFMPEG_LOGLEVEL": "-8"},
    )  # fmt: skip
    for _ in range(300):
        time.sleep(0.1)
        if (tmp_path / "live.txt").exists() and (tmp_path / "live.txt").stat().st_size > 2000:
            break
    # What was found is there while it runs.
    assert len(read_rows(tmp_path / "live.txt").frames) > 30
    process.send_signal(how)
    stdout, stderr = process.communicate(timeout=60)
    if how != signal.SIGKILL:
        assert process.returncode == 0 and "frames searched" in stdout
        assert "Traceback" not in stderr
        assert len(list(VideoReader(tmp_path / "live.mp4"))) > 5


def test_it_stops_after_so_long(stream, tmp_path):
    begin = time.monotonic()
    annotate_stream(f"{stream}/endless.mjpg", tmp_path, TwoStageVehicle(), seconds=2)
    assert 2 <= time.monotonic() - begin < 30


@pytest.mark.parametrize("address", [99, "http://127.0.0.1:9/none.mjpg"])
def test_what_sends_nothing_is_said(address, tmp_path):
    with pytest.raises(OSError, match="no picture comes"):
        LiveReader(address)
