"""Videos out, a frame at a time, by FFmpeg's libraries; see `media.videos`."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import av
import numpy as np

from vehicle_detection.media.files import written_whole
from vehicle_detection.media.planes import LUMA_SHARES, to_planes
from vehicle_detection.media.sound import Copies, copies
from vehicle_detection.media.timeline import Timeline
from vehicle_detection.media.videos import (
    IO_BYTES,
    QUEUE_LENGTH,
    UNSPECIFIED,
    VideoInfo,
    open_container,
)

_MUXERS = {".mp4": "mp4", ".m4v": "mp4", ".mov": "mov", ".mkv": "matroska", ".avi": "avi"}
# What plays before it is loaded, and what can be played while it is written.
_WHOLE = {"movflags": "faststart"}
_LIVE = {"movflags": "frag_keyframe+empty_moov", "flush_packets": "1"}
# Of libx264, its own default: lower is larger and better.
_QUALITY = "23"
# FFmpeg's number.
_LIMITED_RANGE = 1


@contextlib.contextmanager
def video_writer(
    path: str | os.PathLike,
    info: VideoInfo,
    preset: str = "ultrafast",
    source: str | os.PathLike | None = None,
) -> Iterator:
    """A function that appends an RGB frame to a video; encoding runs beside it.

    The file appears under its name when the block has succeeded. It is H.264 with a colour sample
    for two by two pixels, which every player shows; sides of odd length get a pixel more.

    Parameters
    ----------
    path : path
        Its suffix picks the container: mp4, m4v, mov, mkv or avi.
    info : VideoInfo
        Size, unit of time, shape of pixels, colours and metadata.
    preset : str
        Of libx264: "ultrafast" to "veryslow", a larger file or a longer wait.
    source : path, optional
        A video whose sound and subtitles are copied.

    Yields
    ------
    write : callable
        Takes an ndarray of uint8, shape (height, width, 3), RGB, and its time, one unit more
        than the last if there is none; waits while the encoder has enough to do.

    Raises
    ------
    ValueError
        A frame of another size, no frame at all, another suffix.
    OSError
        The encoder failed.
    """
    path = Path(path)
    with written_whole(path) as file, encoding(file, path, info, preset, source) as write:
        yield write


@contextlib.contextmanager
def encoding(
    file: BinaryIO,
    path: Path,
    info: VideoInfo,
    preset: str = "ultrafast",
    source: str | os.PathLike | None = None,
    is_live: bool = False,
) -> Iterator:
    """As `video_writer`, into an open file that will have this path.

    What is live is written in fragments, so that it can be played at any moment.
    """
    n_written = 0
    if path.suffix.lower() not in _MUXERS:
        raise ValueError(f"{path}: videos are written as {', '.join(_MUXERS)}")

    def write(frame, time=None):
        """Hand a frame to the encoder."""
        nonlocal n_written
        if frame.shape != (info.height, info.width, 3) or frame.dtype != np.uint8:
            raise ValueError(f"{path}: a frame of {frame.shape} does not fit the video")
        encoder.put(frame, n_written if time is None else time)
        n_written += 1

    encoder = _Encoder(file, _Target(path, info, preset, source, is_live))
    try:
        yield write
    finally:
        encoder.close()
    if not n_written:
        raise ValueError(f"{path}: no frame to write")
    encoder.require_success()


@dataclass(frozen=True)
class _Target:
    """What is written, as `encoding` is told."""

    path: Path
    info: VideoInfo
    preset: str
    source: Any
    is_live: bool

    @property
    def container(self):
        """Muxer and its options, as FFmpeg names them."""
        muxer = _MUXERS[self.path.suffix.lower()]
        if self.is_live:
            return muxer, _LIVE
        return muxer, _WHOLE if muxer in ("mp4", "mov") else {}

    @property
    def codec_options(self):
        """Of libx264."""
        options = {"preset": self.preset, "crf": _QUALITY}
        # When it is live, a fragment ends where a key frame comes: every second.
        return options | ({"g": str(round(self.info.fps))} if self.is_live else {})


class _Encoder:
    """A thread that encodes frames into a file, and copies sound beside them.

    Parameters
    ----------
    file : binary file
    target : _Target
    """

    def __init__(self, file: Any, target: _Target):
        self._file, self._target = file, target
        self._failure: Exception | None = None
        self._has_ended = False
        self._frames: queue.Queue = queue.Queue(QUEUE_LENGTH)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, frame: np.ndarray, time: int) -> None:
        """Hand over a frame; waits while the queue is full."""
        self.require_success()
        self._frames.put((frame, time))

    def close(self) -> None:
        """Wait until all is written."""
        self._frames.put(None)
        self._thread.join()

    def require_success(self) -> None:
        """Raise OSError if the encoder has failed."""
        if self._failure is not None:
            raise OSError(f"{self._target.path}: cannot be encoded: {self._failure}")

    def _work(self):
        try:
            with contextlib.ExitStack() as stack:
                self._encode(stack)
        except Exception as error:
            # Behind what FFmpeg says lies what the file system said.
            is_callback = isinstance(error, av.error.PyAVCallbackError)
            self._failure = error.__context__ if is_callback else error
            # Whoever writes must not wait for a place in the queue.
            while not self._has_ended:
                self._next()

    def _next(self):
        """The next frame and its time, None at the end."""
        item = self._frames.get()
        self._has_ended = item is None
        return item

    def _encode(self, stack):
        """Write what is handed over, and each time the sound that belongs before it."""
        first = self._next()
        if first is None:
            return
        info, source = self._target.info, self._target.source
        # The second pass of faststart reads what the first has written.
        reopen = partial(_reopen, self._file.name)
        output = stack.enter_context(
            av.open(self._file, "w", *self._target.container, buffer_size=IO_BYTES, io_open=reopen)
        )
        output.metadata.update(info.metadata)
        stream = _video_stream(output, info, self._target.codec_options)
        copied = Copies(iter(()))
        if source:
            beside = stack.enter_context(open(source, "rb"))  # noqa: SIM115, the stack closes it
            copied = copies(stack.enter_context(open_container(beside)), output)
        for frame in self._planes(first, stream.codec_context.time_base):
            for packet in stream.encode(frame):
                output.mux(copied.until(packet.dts * packet.time_base))
                output.mux(packet)
        output.mux(stream.encode(None))
        output.mux(copied.until(None))

    def _planes(self, item, time_base):
        """Yield frames as the codec takes them, with rising times."""
        timeline, matrix = Timeline(), self._target.info.colors[0]
        while item is not None:
            rgb, time = item
            frame = to_planes(rgb, matrix)
            frame.pts, frame.time_base = timeline.after(time), time_base
            yield frame
            item = self._next()


def _reopen(name, url, flags, options):
    return open(name, "rb")


def _video_stream(output, info, options):
    """The stream to encode to."""
    rate = Fraction(info.fps).limit_denominator(100_000)
    stream = output.add_stream("libx264", rate=rate, options=options)
    stream.width, stream.height = info.width + info.width % 2, info.height + info.height % 2
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    context.time_base = stream.time_base = info.time_base or 1 / rate
    if info.sample_aspect_ratio:
        context.sample_aspect_ratio = info.sample_aspect_ratio
    matrix, context.color_primaries, context.color_trc = info.colors
    context.colorspace = matrix if matrix in LUMA_SHARES else UNSPECIFIED
    context.color_range = _LIMITED_RANGE
    return stream
