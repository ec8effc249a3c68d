"""MOTChallenge rows, the format of all box files here.

    frame,id,left,top,width,height,score,class,visibility

Frames count from 1, lengths are pixels of the frame as read.

References
----------
.. [1] L. Leal-Taixe et al., "MOTChallenge 2015", arXiv:1504.01942.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

_FIELDS = "frame,id,left,top,width,height,score"
_N_FIELDS, _MOST_FIELDS = 9, 10
# No spelling that Python alone would take for a number.
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
# Four days of video. Whole numbers up to the other are exact as floats.
_MOST_FRAMES, _LARGEST = 10_000_000, 2**40
# Fewer boxes may all lie in the upper left corner.
_ENOUGH_ROWS = 10


@dataclass(frozen=True)
class Rows:
    """Rows of a MOTChallenge file.

    Attributes
    ----------
    frames, ids : ndarray of int, shape (n,)
    boxes : ndarray of float, shape (n, 4)
        left, top, right, bottom in pixels.
    scores : ndarray of float, shape (n,)
        The seventh column: score of a detection, conf of a truth row.
    visibility : ndarray of float, shape (n,)
        The ninth column: share of a vehicle that is seen; -1 if it is not known.
    distances : ndarray of float, shape (n,), or None
        Metres, NaN where they are not known.
    """

    frames: np.ndarray
    ids: np.ndarray
    boxes: np.ndarray
    scores: np.ndarray
    visibility: np.ndarray
    distances: np.ndarray | None = None

    def only(self, chosen: np.ndarray) -> Rows:
        """The rows that a mask or index array picks."""
        known = {name: values for name, values in vars(self).items() if values is not None}
        return Rows(**{name: values[chosen] for name, values in known.items()})

    def within(self, frames: range) -> Rows:
        """The rows of a range of frames."""
        after = self.frames - frames.start
        inside = (after >= 0) & (self.frames < frames.stop) & (after % frames.step == 0)
        return self.only(inside)

    def with_unique_ids(self) -> Rows:
        """The same, with an identity of its own, below zero, for each row that has none."""
        numbers = -1 - np.arange(len(self.ids))
        return replace(self, ids=np.where(self.ids < 0, numbers, self.ids))


def frame_range(text: str) -> range:
    """ "A:B" or "A:B:STEP" to a range of frame numbers, from 1, both ends included."""
    try:
        first, last, *step = (int(part) for part in text.split(":"))
        frames = range(first, last + 1, *step)
    except (TypeError, ValueError):
        frames = range(0)
    if not frames or min(frames[0], frames.step) < 1:
        raise ValueError(f"frames are A:B or A:B:STEP, from 1, both included, not {text!r}")
    return frames


def all_frames(truth: Rows, detections: Rows) -> range:
    """Range from 1 to the last frame of both, one frame at least."""
    last = max(truth.frames.max(initial=1), detections.frames.max(initial=1))
    return range(1, int(last) + 1)


def read_rows(path: str | os.PathLike, is_truth: bool = False) -> Rows:
    """Read a MOTChallenge file.

    Parameters
    ----------
    path : path
    is_truth : bool
        Then conf must be 0 or 1.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; a line is not seven to ten numbers, or they mean nothing. The
        message names the line.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of boxes")
    content = path.read_bytes()
    try:
        # Some programs put a mark at the beginning.
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        number = content[: error.start].count(b"\n") + 1
        raise ValueError(f"{path}, line {number}: not plain text: save it as UTF-8") from error
    rows, seen = [], set()
    for number, line in enumerate(lines, start=1):
        if line.strip():
            try:
                rows.append(_row(line, is_truth))
                _require_new(rows[-1], seen)
            except ValueError as error:
                raise ValueError(f"{path}, line {number}: {error}") from error
    values = np.array(rows).reshape(-1, _N_FIELDS)
    boxes = np.hstack([values[:, 2:4], values[:, 2:4] + values[:, 4:6]])
    frames, ids = values[:, :2].astype(np.int64).T
    return Rows(frames, ids, boxes, scores=values[:, 6], visibility=values[:, 8])


def _row(line, is_truth):
    """Nine numbers of a line; class and visibility may be left out."""
    fields = [field.strip() for field in line.split(",")]
    if not 7 <= len(fields) <= _MOST_FIELDS:
        raise ValueError(f"{len(fields)} fields instead of {_FIELDS}")
    for field in fields:
        if not _NUMBER.fullmatch(field):
            raise ValueError(f"{field!r} is no number: a line is {_FIELDS}")
    values = [float(field) for field in fields]
    frame, identity, left, top, width, height, score = values[:7]
    if not 1 <= frame <= _MOST_FRAMES or frame != int(frame):
        raise ValueError(f"frame {fields[0]}: frames count from 1 to {_MOST_FRAMES}")
    if abs(identity) > _LARGEST or identity != int(identity):
        raise ValueError(f"id {fields[1]}: it is a whole number, -1 for none")
    if not (width > 0 and height > 0 and max(map(abs, (left, top, width, height))) <= _LARGEST):
        raise ValueError(f"a box of {fields[4]} x {fields[5]} pixels at {fields[2]}, {fields[3]}")
    if is_truth and score not in (0, 1):
        raise ValueError(f"conf {fields[6]}: of truth it is 1, or 0 for an ignore region")
    return (values + [-1, -1])[:_N_FIELDS]


def _require_new(row, seen):
    """Raise ValueError if the vehicle has a box in this frame already."""
    frame, identity = row[:2]
    if identity >= 0 and (frame, identity) in seen:
        raise ValueError(f"id {identity:.0f} twice in frame {frame:.0f}")
    seen.add((frame, identity))


def require_sizes(rows: Rows, path: str | os.PathLike) -> None:
    """Notice rows of left, top, right, bottom.

    Among vehicles in a frame, some are narrower than their distance from the left, or lower
    than that from the top.

    Raises
    ------
    ValueError
        None is.
    """
    size = rows.boxes[:, 2:] - rows.boxes[:, :2]
    if len(size) >= _ENOUGH_ROWS and (size > rows.boxes[:, :2]).all():
        raise ValueError(
            f"{path}: in every line the third field is below the fifth and the fourth below the "
            "sixth: these seem to be left,top,right,bottom instead of left,top,width,height"
        )


def require_within(rows: Rows, frame_shape: tuple, path: str | os.PathLike) -> None:
    """Notice the truth of another frame size.

    Parameters
    ----------
    rows : Rows
    frame_shape : (rows, columns, ...)
    path : path
        Named in the message.

    Raises
    ------
    ValueError
        A required box lies with its centre outside of the frame.
    """
    required = rows.boxes[rows.scores == 1]
    centers = (required[:, :2] + required[:, 2:]) / 2
    height, width = frame_shape[:2]
    outside = ((centers < 0) | (centers > (width, height))).any(axis=1)
    if outside.any():
        raise ValueError(
            f"{path}: a box around {centers[outside][0].round().tolist()} in frames of "
            f"{width}x{height}: is this the truth of other footage?"
        )


def rows_of(boxes: np.ndarray) -> Rows:
    """Rows of boxes without identity or score, from one array (n, 4) a frame."""
    counts = [len(of_frame) for of_frame in boxes]
    frames = np.repeat(np.arange(1, len(boxes) + 1), counts)
    stacked = np.concatenate([np.reshape(of_frame, (-1, 4)) for of_frame in boxes])
    unknown = np.full(len(frames), -1)
    scores = np.ones(len(frames))
    return Rows(frames, unknown, stacked.astype(float), scores, visibility=unknown.astype(float))


def rows_of_detections(detections: list, numbers: Sequence | None = None) -> Rows:
    """Rows of the detections of the frames of a video.

    Parameters
    ----------
    detections : list
        With `boxes`, `ids` and `scores` each, as `detect` returns them.
    numbers : sequence of int, optional
        Of the frames; from 1 on by default.

    Returns
    -------
    rows : Rows
    """
    counts = [len(one.ids) for one in detections]
    frames = np.repeat(range(1, len(detections) + 1) if numbers is None else numbers, counts)
    boxes = stacked([one.boxes for one in detections], (0, 4)).astype(float)
    ids, scores = (stacked([getattr(d, n) for d in detections], 0) for n in ("ids", "scores"))
    metres: list = [getattr(one, "distances", None) for one in detections]
    return Rows(
        frames.astype(np.int64),
        ids.astype(np.int64),
        boxes,
        scores,
        visibility=np.full(len(frames), -1.0),
        distances=None if not metres or metres[0] is None else np.concatenate(metres),
    )


def stacked(arrays: list, empty: Any) -> np.ndarray:
    """Arrays one after the other, also if there is none; `empty` is the shape of nothing."""
    return np.concatenate([np.empty(empty), *arrays])


def joined(parts: list) -> Rows:
    """Rows one after the other, also if there are none."""
    if not parts:
        return rows_of_detections([])
    names = [name for name, values in vars(parts[0]).items() if values is not None]
    return Rows(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})


def mot_lines(rows: Rows) -> list:
    """Lines of a MOTChallenge file: frame,id,left,top,width,height,score,-1,-1,-1."""
    sizes = rows.boxes[:, 2:] - rows.boxes[:, :2]
    values = zip(rows.frames, rows.ids, rows.boxes, sizes, rows.scores, strict=True)
    return [
        f"{frame},{identity},{left:.10g},{top:.10g},{width:.10g},{height:.10g},{score:.3f},-1,-1,-1"
        for frame, identity, (left, top, _, _), (width, height), score in values
    ]


def mot_rows(frame_number: int, detections: Any) -> list:
    """Detections of one frame as lines of a MOTChallenge file.

    Parameters
    ----------
    frame_number : int
        From 1.
    detections : Detections

    Returns
    -------
    lines : list of str
    """
    return mot_lines(rows_of_detections([detections], [frame_number]))
