"""Videos in and out, a frame at a time, by FFmpeg's libraries.

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
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import av
import numpy as np
from av.filter import Graph
from av.video.reformatter import VideoReformatter

from vehicle_detection.media.files import written_whole
from vehicle_detection.media.planes import UNSPECIFIED, planes_of
from vehicle_detection.media.sound import copies
from vehicle_detection.media.timeline import Timeline

# Containers of cameras. Playlists and scripts, which make FFmpeg open other files, are none.
_CONTAINERS = "mov,matroska,webm,avi,mpegts,mpeg,asf,flv,gif,ogg,dv,mxf"
# Of videos, for folders and for what cannot be read; what a file is, its content says.
VIDEO_SUFFIXES = {
    ".mp4", ".m4v", ".mov", ".3gp", ".mkv", ".webm", ".avi", ".ts", ".mts", ".m2ts", ".mpg",
    ".mpeg", ".vob", ".wmv", ".flv", ".gif", ".ogv", ".dv", ".mxf",
}  # fmt: skip
_MUXERS = {".mp4": "mp4", ".m4v": "mp4", ".mov": "mov", ".mkv": "matroska", ".avi": "avi"}
# What plays before it is loaded, and what can be played while it is written.
_WHOLE = {"movflags": "faststart"}
_LIVE = {"movflags": "frag_keyframe+empty_moov", "flush_packets": "1"}
# Of libx264, its own default: lower is larger and better.
_QUALITY = "23"
_QUEUE_LENGTH = 8
# Headers are often off by a frame or two.
_INEXACT_HEADER = 2
_IO_BYTES = 1 << 18
# Decoding runs beside the search. Threads that take turns at one frame each need more
# time in all than one thread does.
_DECODERS = max(1, (os.cpu_count() or 1) // 2)
# FFmpeg's number.
_LIMITED_RANGE = 1


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
        with open(path, "rb") as file, _container(file) as container:
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


def _container(file):
    """An open file as a container.

    FFmpeg is never given the name, of which it might make something else.
    """
    return av.open(
        file, buffer_size=_IO_BYTES, metadata_errors="replace",
        container_options={"format_whitelist": _CONTAINERS},
    )  # fmt: skip


@contextlib.contextmanager
def _opened(path):
    """Container and best video stream of a file."""
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such video")
    with open(path, "rb") as file:
        try:
            container = _container(file)
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
        self._frames: queue.Queue = queue.Queue(_QUEUE_LENGTH)
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
            av.open(self._file, "w", *self._target.container, buffer_size=_IO_BYTES, io_open=reopen)
        )
        output.metadata.update(info.metadata)
        stream = _video_stream(output, info, self._target.codec_options)
        copied = None
        if source:
            beside = stack.enter_context(open(source, "rb"))  # noqa: SIM115, the stack closes it
            copied = copies(stack.enter_context(_container(beside)), output)
        for frame in self._planes(first, stream.codec_context.time_base):
            for packet in stream.encode(frame):
                if copied:
                    output.mux(copied.until(packet.dts * packet.time_base))
                output.mux(packet)
        output.mux(stream.encode(None))
        if copied:
            output.mux(copied.until(None))

    def _planes(self, item, time_base):
        """Yield frames as the codec takes them, with rising times."""
        timeline, matrix = Timeline(), self._target.info.colors[0]
        while item is not None:
            rgb, time = item
            frame = av.VideoFrame.from_numpy_buffer(planes_of(rgb, matrix), "yuv420p")
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
    context.colorspace, context.color_primaries, context.color_trc = info.colors
    context.color_range = _LIMITED_RANGE
    return stream
