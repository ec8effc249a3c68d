"""What a video holds beside its picture, copied packet by packet."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import av

from vehicle_detection.media.timeline import Timeline

# What players read in an mp4 file; other sound is encoded anew.
_COPIED_SOUND = {"aac", "mp3", "ac3", "eac3", "alac", "opus", "flac", "mp2"}
# Samples of a frame, and of a second.
_AAC_SAMPLES = 1024
_AAC_RATES = (8000, 11025, 12000, 16000, 22050, 24000, 32000, 44100, 48000, 88200, 96000)
_COPIED_TEXT = {"mov_text"}


class Copies:
    """Packets of sound and subtitles in the order of time.

    Parameters
    ----------
    packets : iterator of Packet
        Of the output's streams, in order.
    """

    def __init__(self, packets: Iterator):
        self._packets = packets
        self._next = next(packets, None)

    def until(self, time: Fraction | None) -> list:
        """The packets before a time in seconds that were not taken yet; all for None."""
        found = []
        while self._next is not None and (time is None or _time(self._next) <= time):
            found.append(self._next)
            self._next = next(self._packets, None)
        return found


def copies(container: Any, output: Any) -> Copies:
    """What of a video can be copied beside the picture; may be nothing.

    Parameters
    ----------
    container : av.container.InputContainer
        Open as long as packets are taken.
    output : av.container.OutputContainer
        Gets a stream for each that is copied.
    """
    writers = {}
    for stream in container.streams:
        writer = _writer(stream, output)
        if writer is not None:
            writers[stream] = writer
    # Told to demux no streams, PyAV demuxes all.
    if not writers:
        return Copies(iter(()))
    start = Fraction(container.start_time or 0, av.time_base)
    return Copies(_packets(container, writers, start))


def _writer(stream, output):
    """What makes packets of an output stream from those of a stream; None leaves it out."""
    context = stream.codec_context
    if context is None:
        return None
    if stream.type == "subtitle" and context.name in _COPIED_TEXT:
        return _Copier(output.add_stream_from_template(stream))
    if stream.type != "audio":
        return None
    if not context.sample_rate:
        warnings.warn("a track without any sound is left out", stacklevel=2)
        return None
    if context.name.removesuffix("float") in _COPIED_SOUND:
        return _Copier(output.add_stream_from_template(stream))
    return _Encoder(output, context)


class _Copier:
    """Packets as they are."""

    n_lost = 0

    def __init__(self, stream: Any):
        self._stream = stream

    def __call__(self, packet: Any) -> list:
        packet.stream = self._stream
        return [packet]

    def rest(self) -> list:
        """Nothing is kept."""
        return []


class _Encoder:
    """Sound that the container cannot hold, as AAC."""

    def __init__(self, output: Any, context: Any):
        self.n_lost = 0
        # Some files say how many channels there are, and not where.
        layout = "mono" if context.layout.nb_channels == 1 else "stereo"
        rate = min(_AAC_RATES, key=lambda one: abs(one - context.sample_rate))
        self._stream = output.add_stream("aac", rate=rate, layout=layout, format="fltp")
        self._resample = av.AudioResampler("fltp", layout, rate, frame_size=_AAC_SAMPLES)

    def __call__(self, packet: Any) -> list:
        try:
            frames = packet.decode()
        except av.FFmpegError:
            # A damaged packet is a crackle.
            self.n_lost += 1
            return []
        return [p for f in frames for r in self._resample.resample(f) for p in self._encoded(r)]

    def rest(self) -> list:
        """Packets of what the encoder still holds."""
        frames = self._resample.resample(None)
        return [p for f in frames for p in self._encoded(f)] + self._encoded(None)

    def _encoded(self, frame):
        return list(self._stream.encode(frame))


def _packets(container, writers, start):
    """Yield packets of all output streams, times from the start of the video."""
    packets = container.demux(list(writers))
    timelines = {stream: Timeline() for stream in writers}
    while True:
        try:
            packet = next(packets, None)
        except av.FFmpegError as error:
            warnings.warn(f"sound ends early: {error.strerror}", stacklevel=2)
            break
        if packet is None:
            break
        if packet.dts is None:
            continue
        shift = round(start / packet.time_base)
        packet.pts = packet.dts if packet.pts is None else packet.pts
        dts = timelines[packet.stream].after(packet.dts - shift)
        packet.pts, packet.dts = packet.pts - packet.dts + dts, dts
        yield from writers[packet.stream](packet)
    for writer in writers.values():
        yield from writer.rest()
        if writer.n_lost:
            warnings.warn(f"{writer.n_lost} packets of sound are damaged", stacklevel=2)


def _time(packet):
    return packet.dts * packet.time_base
