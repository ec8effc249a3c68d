"""Videos in, a frame at a time, by FFmpeg's libraries.

Reading, what is done with the frames, and writing overlap: each has a thread, and short queues
between them keep memory flat however long the video is. docs/files.md explains what is kept.
"""

from __future__ import annotations

import bisect
import contextlib
import heapq
import math
import os
import queue
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import av
import numpy as np
from av.filter import Graph
from av.video.reformatter import VideoReformatter

# Containers of cameras. Playlists and scripts, which make FFmpeg open other files, are none.
_CONTAINERS = "mov,matroska,webm,avi,mpegts,mpeg,asf,flv,gif,ogg,dv,mxf"
# Of videos, for folders and for what cannot be read; what a file is, its content says.
VIDEO_SUFFIXES = {
    ".mp4", ".m4v", ".mov", ".3gp", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".mpg",
    ".mpeg", ".vob", ".wmv", ".flv", ".gif", ".ogv", ".dv", ".mxf",
}  # fmt: skip
# So many frames wait between two threads.
QUEUE_LENGTH = 8
# Headers are often off by a frame or two.
_INEXACT_HEADER = 2
# Read or written at a time.
IO_BYTES = 1 << 18
# As FFmpeg numbers a matrix, primaries or a transfer function that is not named.
UNSPECIFIED = 2
# Decoding runs beside the search. Threads that take turns at one frame each need more
# time in all than one thread does.
_DECODERS = max(1, (os.cpu_count() or 1) // 2)


@dataclass(frozen=True)
class VideoInfo:
    """What is known of a video before its frames are read.

    Attributes
    ----------
    width, height : int
        Of the upright picture, in pixels.
    fps : float
        Mean number of frames a second.
    n_frames : int
        What the file promises: good for a progress bar, and for nothing else. 0 if it is silent.
    time_base : Fraction or None
        Unit of the frames' times, in seconds; None for a frame.
    sample_aspect_ratio : Fraction or None
        Width of a pixel by its height.
    colors : (int, int, int)
        Matrix, primaries and transfer function, as FFmpeg numbers them [1]_.
    metadata : dict of str to str
        Such as creation time and place.

    References
    ----------
    .. [1] ITU-T H.273, "Coding-independent code points for video signal type identification".
    """

    width: int
    height: int
    fps: float
    n_frames: int
    time_base: Fraction | None = None
    sample_aspect_ratio: Fraction | None = None
    colors: tuple = (UNSPECIFIED,) * 3
    metadata: dict = field(default_factory=dict)


class Frame(NamedTuple):
    """A frame of a video.

    Attributes
    ----------
    number : int
        From 1. Frames that could not be decoded are counted.
    time : int
        In `VideoInfo.time_base`.
    rgb : ndarray of uint8, shape (rows, columns, 3)
        RGB, upright.
    """

    number: int
    time: int
    rgb: np.ndarray


def is_video(path: str | os.PathLike) -> bool:
    """Whether a file is a container of cameras that holds a picture."""
    try:
        with open(path, "rb") as file, open_container(file) as container:
            stream = container.streams.best("video")
            return stream is not None and bool(stream.codec_context) and stream.width > 0
    except (av.FFmpegError, OSError):
        return False


def video_info(path: str | os.PathLike) -> VideoInfo:
    """What a video's header and first frame say.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; it is no readable video.
    """
    with _opened(path) as (container, stream), contextlib.closing(_decode(container, stream)) as it:
        first = next((item for item in it if isinstance(item, av.VideoFrame)), None)
        if first is None:
            raise ValueError(f"{path}: not one frame can be decoded")
        width, height = first.width, first.height
        aspect = stream.sample_aspect_ratio or None
        if _quarter_turns(first) % 2:
            width, height = height, width
            aspect = 1 / aspect if aspect else None
        rate = stream.average_rate or stream.guessed_rate or Fraction(25)
        n_frames = stream.frames
        if not n_frames and container.duration:
            n_frames = round(container.duration / av.time_base * rate)
        colors = first.colorspace, first.color_primaries, first.color_trc
        return VideoInfo(
            width, height, float(rate), n_frames, stream.time_base, aspect,
            tuple(int(color) for color in colors), dict(container.metadata),
        )  # fmt: skip


def read_frames(path: str | os.PathLike) -> Iterator:
    """Yield the frames of a video as RGB uint8, read ahead by a thread.

    Raises
    ------
    FileNotFoundError, ValueError
        As `video_info`; or a frame cannot be decoded: those behind it would have wrong numbers.
    """
    reader = VideoReader(path)
    for frame in reader:
        reader.require_whole()
        yield frame.rgb
    reader.require_whole()


class VideoReader:
    """The frames of a video, once; what can be decoded is read, and the rest is told.

    Parameters
    ----------
    path : path

    Attributes
    ----------
    info : VideoInfo
    lost : list of (int, int)
        First and last number of frames that could not be decoded, as far as it was read.
    """

    def __init__(self, path: str | os.PathLike):
        self._path = path
        self.info = video_info(path)
        self.lost: list = []

    def __iter__(self) -> Iterator[Frame]:
        """Yield each `Frame`, read ahead by a thread."""
        n_read = 0
        for number, time, rgb, lost in _ahead(self._read()):
            self.lost = lost
            if rgb is not None:
                n_read += 1
                yield Frame(number, time, rgb)
        if not n_read:
            raise ValueError(f"{self._path}: not one frame can be decoded")

    def require_whole(self) -> None:
        """Raise ValueError if a frame was lost."""
        if self.lost:
            raise ValueError(f"{self._path}: {self.losses()}")

    def losses(self) -> str:
        """What was lost, in words."""
        count = sum(last - first + 1 for first, last in self.lost)
        where = ", ".join(f"{a}-{b}" if b > a else str(a) for a, b in self.lost[:5])
        more = " and more" if len(self.lost) > 5 else ""
        return f"{count} frame{'s' * (count > 1)} cannot be decoded: {where}{more}"

    def _read(self):
        """Yield number, time, frame and what is lost so far; the last has no frame."""
        with _opened(self._path) as (container, stream):
            numbers = _Numbers(stream)
            start, to_rgb = _start(container, stream), _ToRGB()
            for item in _decode(container, stream):
                if isinstance(item, av.VideoFrame):
                    number = numbers.of(item.pts)
                    yield number, item.pts - start, to_rgb(item), list(numbers.lost)
                else:
                    numbers.note(item)
            numbers.end()
            yield None, None, None, list(numbers.lost)


def _start(container, stream):
    """When a video begins, in units of its stream."""
    return round((container.start_time or 0) / (av.time_base * stream.time_base))


def open_container(file: BinaryIO) -> Any:
    """An open video file as PyAV's container.

    FFmpeg is never given the name, of which it might make something else.
    """
    return av.open(
        file, buffer_size=IO_BYTES, metadata_errors="replace",
        container_options={"format_whitelist": _CONTAINERS},
    )  # fmt: skip


@contextlib.contextmanager
def _opened(path):
    """Container and best video stream of a file."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such video")
    with open(path, "rb") as file:
        try:
            container = open_container(file)
        except (av.FFmpegError, OSError) as error:
            raise ValueError(f"{path}: not a readable video: {error.strerror}") from error
        with container:
            stream = container.streams.best("video")
            if stream is None or not stream.codec_context:
                raise ValueError(f"{path}: no video in it that can be decoded")
            stream.thread_type = "AUTO"
            stream.codec_context.thread_count = _DECODERS
            yield container, stream


class _Packet(NamedTuple):
    """A compressed frame was handed to the decoder: to be shown or not, or in vain."""

    time: int | None
    is_hidden: bool
    failed: bool


class _BrokenOff(NamedTuple):
    """The container ends where it should not."""


def _decode(container, stream):
    """Yield frames, deinterlaced, and between them what `_Numbers` must know."""
    deinterlace = _Deinterlacer(stream)
    correct = _IndexTimes(container, stream)
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except av.FFmpegError:
            yield _BrokenOff()
            break
        if packet is None:
            break
        if packet.size:
            correct(packet)
            time = packet.pts if packet.pts is not None else packet.dts
            yield _Packet(time, packet.is_discard, False)
        try:
            yield from _with_times(deinterlace(packet.decode()), stream)
        except av.FFmpegError:
            yield _Packet(None, False, True)
    yield from _with_times(deinterlace.rest(), stream)


def _with_times(frames, stream):
    """Frames that have one: the decoder knows none of what has no packet of its own."""
    for frame in frames:
        if frame.pts is None:
            frame.pts = frame.dts
        if frame.pts is not None:
            yield frame


class _IndexTimes:
    """Times by the index of a file, where the container itself only counts what it finds.

    AVI does: behind a damaged place every frame would come too early.
    """

    def __init__(self, container: Any, stream: Any):
        entries = stream.index_entries if container.format.name == "avi" else ()
        # Without an index in the file, FFmpeg has no more than its first entries.
        is_whole = len(entries) >= stream.frames - _INEXACT_HEADER
        self._entries = sorted((e.pos, e.timestamp) for e in entries) if is_whole else []

    def __call__(self, packet: Any) -> None:
        """Put a packet where the index has what lies at its place in the file."""
        i = bisect.bisect_right(self._entries, (packet.pos, math.inf))
        if i and packet.dts is not None:
            shift = self._entries[i - 1][1] - packet.dts
            packet.dts += shift
            packet.pts = None if packet.pts is None else packet.pts + shift


class _Deinterlacer:
    """Full frames from interlaced ones; others pass as they are."""

    def __init__(self, stream: Any):
        self._stream = stream
        self._graph: Graph | None = None

    def __call__(self, frames: list) -> Iterator:
        for frame in frames:
            if self._graph is None and frame.interlaced_frame:
                self._begin()
            if self._graph is None:
                yield frame
            else:
                self._graph.push(frame)
                yield from self._pulled()

    def rest(self) -> Iterator:
        """Yield the frames that were waiting for their successors."""
        if self._graph is not None:
            self._graph.push(None)
            yield from self._pulled()

    def _begin(self):
        self._graph = Graph()
        source = self._graph.add_buffer(template=self._stream)
        # A frame for a frame, so that their numbers stay.
        bwdif = self._graph.add("bwdif", "mode=send_frame:deint=interlaced")
        sink = self._graph.add("buffersink")
        source.link_to(bwdif)
        bwdif.link_to(sink)
        self._graph.configure()

    def _pulled(self):
        while True:
            try:
                frame = self._graph.pull()
            except (av.BlockingIOError, av.EOFError):
                return
            # The filter counts in halves.
            frame.pts = round(frame.pts * frame.time_base / self._stream.time_base)
            yield frame


class _Numbers:
    """True numbers of frames: those that are lost count.

    Where the container counts frames instead of time, gaps are frames. Elsewhere a packet is one,
    and of as many as failed, those are lost whose time has passed.
    """

    def __init__(self, stream: Any):
        rate = stream.average_rate or stream.guessed_rate
        self._counts_frames = bool(rate) and stream.time_base * rate == 1
        self._promised = stream.frames
        self._waiting: list = []
        self._n_failed = self._number = 0
        self._last: int | None = None
        self._is_broken_off = False
        self.lost: list = []

    def note(self, item: _Packet | _BrokenOff) -> None:
        """Take in what the decoder was given, and where it failed."""
        if isinstance(item, _BrokenOff):
            self._is_broken_off = True
        elif item.failed:
            self._n_failed += 1
        elif item.is_hidden:
            self._promised -= 1
        elif item.time is not None:
            heapq.heappush(self._waiting, item.time)

    def of(self, time: int) -> int:
        """Number of the frame of this time."""
        n_overdue = 0
        while self._waiting and self._waiting[0] <= time:
            n_overdue += heapq.heappop(self._waiting) < time
        self._lose(min(n_overdue, self._n_failed))
        if self._counts_frames and self._last is not None:
            self._lose(max(0, time - self._last - 1 - n_overdue))
        self._last = time
        self._number += 1
        return self._number

    def end(self) -> None:
        """There are no more frames."""
        self._lose(min(len(self._waiting), self._n_failed))
        missing = self._promised - self._number
        if missing > (0 if self._is_broken_off else _INEXACT_HEADER):
            self._lose(missing)

    def _lose(self, count):
        if count > 0:
            self.lost.append((self._number + 1, self._number + count))
            self._number += count
            self._n_failed = max(0, self._n_failed - count)


def _quarter_turns(frame):
    """Quarter turns, counterclockwise, that make a frame upright."""
    return round(frame.rotation / 90) % 4


class _ToRGB:
    """Decoded frames as RGB uint8, upright."""

    def __init__(self):
        self._convert = VideoReformatter()
        self._size: tuple | None = None

    def __call__(self, frame: av.VideoFrame) -> np.ndarray:
        # A camera that changes its resolution goes on in that of its first frame.
        width, height = self._size = self._size or (frame.width, frame.height)
        rgb = self._convert.reformat(frame, width, height, format="rgb24").to_ndarray()
        turns = _quarter_turns(frame)
        return np.ascontiguousarray(np.rot90(rgb, turns)) if turns else rgb


def _ahead(items):
    """Run a generator in a thread, a few items ahead of its reader."""
    buffer = queue.Queue(QUEUE_LENGTH)
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
        finally:
            items.close()

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
