"""A camera or a stream, live: the newest frame is searched, and what comes meanwhile is dropped.

What is found is written while it comes, so that nothing is lost when it is stopped.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from vehicle_detection.command_line import Terminated
from vehicle_detection.media.encoder import encoding
from vehicle_detection.media.files import require_free
from vehicle_detection.media.mot import mot_rows
from vehicle_detection.media.videos import Frame, VideoInfo

if TYPE_CHECKING:
    from vehicle_detection.media.viewer import Viewer

# Of the times that are written, a second.
_TICKS = 1000
_SECONDS_TO_WAIT = 10


class LiveReader:
    """Frames of a camera or stream, the newest whenever one is asked for.

    Parameters
    ----------
    address : int or str
        Number of a camera, or an RTSP or HTTP address.

    Attributes
    ----------
    info : VideoInfo
        Times are milliseconds since the first frame.
    n_dropped : int
        Frames that came while an earlier one was being searched.

    Raises
    ------
    OSError
        There is no such camera or stream, or it sends no picture.
    """

    def __init__(self, address: int | str):
        self._address = address
        self._capture = cv2.VideoCapture(address)
        read, frame = self._capture.read()
        if not read:
            self._capture.release()
            raise OSError(f"{address}: no picture comes from this camera or stream")
        rows, columns = frame.shape[:2]
        fps = self._capture.get(cv2.CAP_PROP_FPS)
        fps = fps if 1 <= fps <= 240 else 25
        self.info = VideoInfo(columns, rows, fps, 0, time_base=Fraction(1, _TICKS))
        self.n_dropped = 0
        self._newest: tuple | None = None
        self._has_new, self._lock = threading.Event(), threading.Lock()
        self._is_stopped = self._is_over = False
        self._begin = time.monotonic()
        self._put(1, frame)
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def __iter__(self) -> Iterator[Frame]:
        """Yield the newest frame each time, until the stream ends or nothing comes any more."""
        while self._has_new.wait(_SECONDS_TO_WAIT):
            with self._lock:
                newest, self._newest = self._newest, None
                self._has_new.clear()
                if self._is_over:
                    self._has_new.set()
            if newest is None:
                return
            number, when, frame = newest
            yield Frame(number, when, cv2.cvtColor(frame, cv2.COLOR_BGR2RGB))

    def close(self) -> None:
        """Stop receiving. A stream that has stalled is left to its thread."""
        self._is_stopped = True
        self._thread.join(_SECONDS_TO_WAIT)

    def _receive(self):
        number = 1
        while not self._is_stopped:
            read, frame = self._capture.read()
            if not read:
                break
            number += 1
            self._put(number, frame)
        # Here, because no other thread may do it while this one reads.
        self._capture.release()
        with self._lock:
            self._is_over = True
            self._has_new.set()

    def _put(self, number, frame):
        when = round((time.monotonic() - self._begin) * _TICKS)
        with self._lock:
            self.n_dropped += self._newest is not None
            self._newest = number, when, frame
            self._has_new.set()


def annotate_stream(
    address: int | str,
    folder: Path,
    vehicle: Viewer,
    seconds: float | None = None,
    overwrite: bool = False,
    preset: str = "ultrafast",
) -> str:
    """Detect in a camera or stream until it ends, or is stopped by Ctrl-C or SIGTERM.

    Writes live.mp4 and live.txt into the folder while it runs: both can be read at any moment.

    Parameters
    ----------
    address : int or str
        See `LiveReader`.
    folder : Path
    vehicle : Viewer
        Is reset first.
    seconds : float, optional
        Stop after so long.
    overwrite : bool
        Replace files that are there.
    preset : str
        Of the encoder, see `encoder.video_writer`.

    Returns
    -------
    summary : str
        How many frames were searched and dropped.
    """
    vehicle.reset()
    path, rows = (require_free(folder / name, overwrite) for name in ("live.mp4", "live.txt"))
    reader, count = LiveReader(address), 0
    begin = time.monotonic()
    with ExitStack() as stack:
        stack.callback(reader.close)
        text = stack.enter_context(open(rows, "w", buffering=1))
        video: Any = stack.enter_context(open(path, "w+b", buffering=0))
        # Fragments: what is there can be played, whatever happens next.
        write = stack.enter_context(encoding(video, path, reader.info, preset, is_live=True))
        # That is how a live run is meant to end.
        stack.enter_context(suppress(KeyboardInterrupt, Terminated))
        for frame in reader:
            detections = vehicle.detect(frame.rgb)
            write(vehicle.draw(frame.rgb, detections), frame.time)
            text.writelines(f"{line}\n" for line in mot_rows(frame.number, detections))
            count += 1
            if seconds is not None and time.monotonic() - begin >= seconds:
                break
    return f"{count} frames searched, {reader.n_dropped} dropped"
