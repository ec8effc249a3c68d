"""Videos in and out, a frame at a time.

Reading, what is done with the frames, and writing overlap: each has a thread,
and short queues between them keep memory flat however long the video is.
"""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vehicle_detection.media.files import written_whole

VIDEO_SUFFIXES = {".mp4", ".avi", ".mov", ".mkv", ".webm"}
_QUEUE_LENGTH = 8
# Decoding runs beside the search. Threads that take turns at one frame each need more
# time in all than one thread does.
_DECODERS = max(1, (os.cpu_count() or 1) // 2)


@dataclass(frozen=True)
class VideoInfo:
    """Size in pixels, frames a second, and how many frames the file promises."""

    width: int
    height: int
    fps: float
    n_frames: int


def video_info(path: str | os.PathLike) -> VideoInfo:
    """What a video's header says.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; it is no readable video.
    """
    capture = _open(path)
    info = VideoInfo(
        int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
        int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        capture.get(cv2.CAP_PROP_FPS),
        int(capture.get(cv2.CAP_PROP_FRAME_COUNT)),
    )
    capture.release()
    return info


def _open(path):
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such video")
    capture = cv2.VideoCapture(str(path), cv2.CAP_ANY, [cv2.CAP_PROP_N_THREADS, _DECODERS])
    if not capture.isOpened() or not capture.get(cv2.CAP_PROP_FPS):
        raise ValueError(f"{path}: not a readable video: convert it to mp4 or replace it")
    return capture


def read_frames(path: str | os.PathLike) -> Iterator:
    """Yield the frames of a video as RGB uint8, read ahead by a thread.

    Raises
    ------
    FileNotFoundError, ValueError
        As `video_info`; or the video ends more than a second early.
    """
    info = video_info(path)
    n_read = 0
    for frame in _ahead(_decode(path)):
        n_read += 1
        yield frame
    # Headers are often off by a frame or two, never by a second.
    if n_read < info.n_frames - info.fps:
        raise ValueError(
            f"{path}: ends after {n_read} of {info.n_frames} frames: "
            "the file is truncated, copy it again"
        )


def _decode(path):
    capture = _open(path)
    try:
        while True:
            read, frame = capture.read()
            if not read:
                return
            yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
    finally:
        capture.release()


def _ahead(items):
    """Run a generator in a thread, a few items ahead of its reader."""
    buffer = queue.Queue(_QUEUE_LENGTH)
    stop = threading.Event()
    end = object()

    def fill():
        """Put items into the buffer, then its end or what went wrong."""
        try:
            for item in items:
                buffer.put(item)
                if stop.is_set():
                    return
            buffer.put(end)
        except Exception as error:
            buffer.put(error)

    thread = threading.Thread(target=fill, daemon=True)
    thread.start()
    try:
        while (item := buffer.get()) is not end:
            if isinstance(item, Exception):
                raise item
            yield item
    finally:
        stop.set()
        while thread.is_alive():
            # Room for the item that the thread may be waiting to put.
            try:
                buffer.get(timeout=0.01)
            except queue.Empty:
                continue


@contextlib.contextmanager
def video_writer(path: str | os.PathLike, info: VideoInfo, preset: str = "ultrafast") -> Iterator:
    """A function that appends an RGB frame to a video; encoding runs beside it.

    The file appears under its name when the block has succeeded.

    Parameters
    ----------
    path : path
        Its suffix picks the container.
    info : VideoInfo
        Size and frame rate.
    preset : str
        Of libx264: "ultrafast" to "veryslow", a larger file or a longer wait.

    Yields
    ------
    write : callable
        Takes an ndarray of uint8, shape (height, width, 3), RGB; waits while
        the encoder has enough to do.

    Raises
    ------
    ValueError
        A frame of another size, or no frame at all.
    OSError
        The encoder failed.
    """
    n_written = 0

    def write(frame):
        """Hand a frame to the encoder."""
        nonlocal n_written
        if frame.shape != (info.height, info.width, 3) or frame.dtype != np.uint8:
            raise ValueError(f"{path}: a frame of {frame.shape} does not fit the video")
        encoder.put(frame)
        n_written += 1

    with written_whole(path) as partial:
        encoder = _Encoder(partial, Path(path), info, preset)
        try:
            yield write
        finally:
            encoder.close()
        if not n_written:
            raise ValueError(f"{path}: no frame to write")
        encoder.require_success()


def _ffmpeg():
    """Path of the ffmpeg that moviepy uses too."""
    # Imported here: only who writes a video needs it.
    import imageio_ffmpeg

    return imageio_ffmpeg.get_ffmpeg_exe()


class _Encoder:
    """The ffmpeg that moviepy brings along, and a thread that feeds it.

    moviepy's own writer hands it RGB, and its conversion to the brightness
    and colour that are encoded takes a third of the time of encoding.

    Parameters
    ----------
    partial, path : Path
        The file to write, and the name it will have.
    info : VideoInfo
    preset : str
    """

    def __init__(self, partial: Path, path: Path, info: VideoInfo, preset: str):
        self._path = path
        # Colour is stored for two by two pixels.
        self._is_even = info.width % 2 == info.height % 2 == 0
        pixels = ["-pix_fmt", "yuv420p"] if self._is_even else ["-pix_fmt", "rgb24"]
        command = [
            _ffmpeg(), "-y", "-loglevel", "error", "-f", "rawvideo", *pixels,
            "-s", f"{info.width}x{info.height}", "-r", str(info.fps), "-i", "-",
            "-vcodec", "libx264", "-preset", preset, str(Path(partial).resolve()),
        ]  # fmt: skip
        # Not a pipe: nobody reads it before the end, and a full one stops ffmpeg.
        self._complaints = tempfile.TemporaryFile()  # noqa: SIM115, `_feed` closes it
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=self._complaints
        )
        self._failure = None
        self._frames = queue.Queue(_QUEUE_LENGTH)
        self._thread = threading.Thread(target=self._feed, daemon=True)
        self._thread.start()

    def put(self, frame: np.ndarray) -> None:
        """Hand over a frame; waits while the queue is full."""
        self.require_success()
        self._frames.put(frame)

    def close(self) -> None:
        """Wait until all is written."""
        self._frames.put(None)
        self._thread.join()

    def require_success(self) -> None:
        """Raise OSError if the encoder has failed."""
        if self._failure is not None:
            raise OSError(f"{self._path}: cannot be encoded: {self._failure}")

    def _feed(self):
        """Write queued frames until None comes; once something went wrong, only take them."""
        while (frame := self._frames.get()) is not None:
            if self._failure is None:
                try:
                    self._write(frame)
                except BrokenPipeError as error:
                    self._failure = self._last_words() if self._process.wait() else repr(error)
                except Exception as error:
                    self._failure = repr(error)
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        if self._process.wait() and self._failure is None:
            self._failure = self._last_words()
        self._complaints.close()

    def _write(self, frame):
        if self._is_even:
            frame = cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420)
        self._process.stdin.write(np.ascontiguousarray(frame))

    def _last_words(self):
        self._complaints.seek(0)
        lines = self._complaints.read().decode(errors="replace").strip().splitlines()
        # The first complaint is the cause of the others.
        return lines[0][:500] if lines else f"ffmpeg ended with status {self._process.returncode}"
