"""MOTChallenge rows, the format of all box files here.

    frame,id,left,top,width,height,score,class,visibility

Frames count from 1, lengths are pixels of the frame as read.

References
----------
.. [1] L. Leal-Taixe et al., "MOTChallenge 2015", arXiv:1504.01942.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np


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
    """

    frames: np.ndarray
    ids: np.ndarray
    boxes: np.ndarray
    scores: np.ndarray
    visibility: np.ndarray

    def only(self, chosen: np.ndarray) -> Rows:
        """The rows that a mask or index array picks."""
        return Rows(**{name: values[chosen] for name, values in vars(self).items()})

    def within(self, frames: range) -> Rows:
        """The rows of a range of frames."""
        return self.only(np.isin(self.frames, frames))

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


def read_rows(path: str | os.PathLike) -> Rows:
    """Read a MOTChallenge file.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; a row is not seven or more numbers.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of boxes")
    lines = [line for line in path.read_text().splitlines() if line.strip()]
    try:
        rows = [[float(v) for v in line.split(",")] for line in lines]
        if min(map(len, rows), default=7) < 7:
            raise ValueError("fewer than seven")
        # Class and visibility may be left out.
        values = np.array([(row + [-1, -1])[:9] for row in rows]).reshape(-1, 9)
        if not np.isfinite(values).all():
            raise ValueError("not a finite number")
    except ValueError as error:
        raise ValueError(f"{path}: rows are to be frame,id,left,top,width,height,score") from error
    boxes = np.hstack([values[:, 2:4], values[:, 2:4] + values[:, 4:6]])
    frames, ids = values[:, :2].astype(int).T
    return Rows(frames, ids, boxes, scores=values[:, 6], visibility=values[:, 8])


def rows_of(boxes: np.ndarray) -> Rows:
    """Rows of boxes without identity or score, from one array (n, 4) a frame."""
    counts = [len(of_frame) for of_frame in boxes]
    frames = np.repeat(np.arange(1, len(boxes) + 1), counts)
    stacked = np.concatenate([np.reshape(of_frame, (-1, 4)) for of_frame in boxes])
    unknown = np.full(len(frames), -1)
    scores = np.ones(len(frames))
    return Rows(frames, unknown, stacked.astype(float), scores, visibility=unknown.astype(float))


def rows_of_detections(detections: list) -> Rows:
    """Rows of the detections of the frames of a video, from frame 1 on.

    Parameters
    ----------
    detections : list
        With `boxes`, `ids` and `scores` each, as `detect` returns them.

    Returns
    -------
    rows : Rows
    """
    frames = np.repeat(np.arange(1, len(detections) + 1), [len(one.ids) for one in detections])
    boxes = np.concatenate([one.boxes for one in detections]).astype(float)
    ids, scores = (np.concatenate([getattr(d, n) for d in detections]) for n in ("ids", "scores"))
    return Rows(frames, ids, boxes, scores, visibility=np.full(len(frames), -1.0))


def mot_rows(frame_number: int, detections: Any) -> list:
    """Detections of one frame as rows of a MOTChallenge file.

    Parameters
    ----------
    frame_number : int
        From 1.
    detections : Detections

    Returns
    -------
    rows : list of str
        frame,id,left,top,width,height,score,-1,-1,-1, the id constant per vehicle.

    References
    ----------
    .. [1] L. Leal-Taixe et al., "MOTChallenge 2015", arXiv:1504.01942.
    """
    return [
        f"{frame_number},{identity},{left},{top},{right - left},{bottom - top},{score:.3f},-1,-1,-1"
        for identity, (left, top, right, bottom), score in zip(
            detections.ids, detections.boxes, detections.scores, strict=True
        )
    ]
