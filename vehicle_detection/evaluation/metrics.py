"""Figures of boxes against the truth.

Truth rows with conf 0 are ignore regions: a detection that matches no required vehicle and
lies by half of its own area in one is neither right nor wrong.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import motmetrics
import numpy as np
from scipy.optimize import linear_sum_assignment

from vehicle_detection.evaluation.hota import hota
from vehicle_detection.media.mot import all_frames
from vehicle_detection.tracking.boxes import pairwise_iou, pairwise_overlap

if TYPE_CHECKING:
    from vehicle_detection.media.mot import Rows

HEIGHT_EDGES = (30, 40, 60, 100, np.inf)
# A vehicle that comes back after this many frames has to be found anew.
_NEW_ENTRY_GAP = 25


def match(required: np.ndarray, detected: np.ndarray, iou_threshold: float = 0.5) -> tuple:
    """Pairs of boxes that overlap enough, as many as possible, best first.

    Parameters
    ----------
    required, detected : ndarray of float, shapes (n, 4), (m, 4)
    iou_threshold : float

    Returns
    -------
    rows, columns : ndarray of int
        Indices of the pairs.
    """
    iou = pairwise_iou(required, detected)
    # A pair more outweighs any IoU of the others.
    gain = np.where(iou >= iou_threshold, min(iou.shape) + iou, 0)
    rows, columns = linear_sum_assignment(gain, maximize=True)
    good = gain[rows, columns] > 0
    return rows[good], columns[good]


def drop_ignored(truth: Rows, detections: Rows, iou_threshold: float = 0.5) -> Rows:
    """Detections without those that the ignore regions excuse.

    Parameters
    ----------
    truth, detections : Rows

    Returns
    -------
    detections : Rows
    """
    counted = np.ones(len(detections.frames), bool)
    for frame in np.unique(detections.frames):
        here = np.flatnonzero(detections.frames == frame)
        of_frame = truth.frames == frame
        required = truth.boxes[of_frame & (truth.scores == 1)]
        ignored = truth.boxes[of_frame & (truth.scores == 0)]
        boxes = detections.boxes[here]
        _, matched = match(required, boxes, iou_threshold)
        areas = np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(axis=1), 1e-9)
        covered = pairwise_overlap(boxes, ignored).max(axis=1, initial=0) / areas
        excused = covered >= 0.5
        excused[matched] = False
        counted[here[excused]] = False
    return detections.only(counted)


def accumulate(
    truth: Rows, detections: Rows, frames: range, iou_threshold: float = 0.5
) -> motmetrics.MOTAccumulator:
    """Match frame by frame with motmetrics.

    Parameters
    ----------
    truth, detections : Rows
        Required vehicles; detections that count; both `with_unique_ids`.
    frames : range

    Returns
    -------
    accumulator : motmetrics.MOTAccumulator
    """
    accumulator = motmetrics.MOTAccumulator()
    for frame in _with_rows(truth, detections, frames):
        wanted, found = truth.frames == frame, detections.frames == frame
        distance = 1 - pairwise_iou(truth.boxes[wanted], detections.boxes[found])
        distance[distance > 1 - iou_threshold] = np.nan
        accumulator.update(truth.ids[wanted], detections.ids[found], distance, frameid=frame)
    return accumulator


def _with_rows(truth, detections, frames):
    """The frames of a range that hold any row: there may be millions without."""
    numbers = np.union1d(truth.within(frames).frames, detections.within(frames).frames)
    return numbers.tolist()


_METRICS = {
    "recall": "recall",
    "precision": "precision",
    "num_false_positives": "false positives",
    "num_misses": "misses",
    "motp": "mean distance",
    "mota": "MOTA",
    "idf1": "IDF1",
    "num_switches": "identity switches",
    "num_fragmentations": "fragmentations",
}


def evaluate(
    truth: Rows, detections: Rows, frames: range | None = None, iou_threshold: float = 0.5
) -> dict:
    """All figures of detections against the truth.

    Parameters
    ----------
    truth, detections : Rows
    frames : range, optional
        From 1 to the last of both by default.
    iou_threshold : float

    Returns
    -------
    figures : dict
        Plain numbers, and two dicts: recall by height, and by vehicle the
        frames from its entry to its first box. HOTA, IDF1, switches
        and fragmentations are None where truth or detections carry no identity,
        and MOTA then counts misses and false positives only; by vehicle there
        is nothing where the truth carries none.
    """
    frames = frames or all_frames(truth, detections)
    truth, detections = truth.within(frames), detections.within(frames)
    truth_has_identities = not (truth.ids[truth.scores == 1] < 0).any()
    both_have = truth_has_identities and (detections.ids >= 0).any()
    truth, detections = truth.with_unique_ids(), detections.with_unique_ids()
    required = truth.only(truth.scores == 1)
    counted = drop_ignored(truth, detections, iou_threshold)
    accumulator = accumulate(required, counted, frames, iou_threshold)
    summary = motmetrics.metrics.create().compute(accumulator, metrics=list(_METRICS), name="all")
    figures = {name: summary.loc["all", metric] for metric, name in _METRICS.items()}
    figures = {
        name: int(value) if isinstance(value, np.integer) else _number_or_none(value)
        for name, value in figures.items()
    }
    figures["HOTA"] = hota(required, counted) if both_have else None
    figures["frames"] = len(frames)
    figures["required boxes"] = len(required.frames)
    figures["false positives per frame"] = figures["false positives"] / len(frames)
    distance = figures.pop("mean distance")
    figures["mean IoU"] = None if distance is None else 1 - distance
    if not both_have:
        figures |= dict.fromkeys(("HOTA", "IDF1", "identity switches", "fragmentations"))
        errors = figures["misses"] + figures["false positives"]
        figures["MOTA"] = 1 - errors / max(1, len(required.frames))
    if not len(required.frames):
        figures["MOTA"] = None
    found = _found(accumulator, required)
    figures["recall by height"] = _recall_by_height(required, found)
    figures["frames to first box"] = _entry_delays(required, found) if truth_has_identities else {}
    return figures


def _number_or_none(value):
    """A float, None for what has no value."""
    return float(value) if np.isfinite(value) else None


def _found(accumulator, required):
    """Which required boxes were matched, ndarray of bool."""
    events = accumulator.mot_events.reset_index()
    hits = events[events["Type"].isin(["MATCH", "SWITCH"])]
    pairs = set(zip(hits["FrameId"].astype(int), hits["OId"].astype(int), strict=True))
    return np.array(
        [pair in pairs for pair in zip(required.frames, required.ids, strict=True)], bool
    )


def _recall_by_height(required, found):
    heights = required.boxes[:, 3] - required.boxes[:, 1]
    recalls = {}
    for low, high in zip(HEIGHT_EDGES[:-1], HEIGHT_EDGES[1:], strict=True):
        chosen = (heights >= low) & (heights < high)
        name = f"{low}-{high} px" if np.isfinite(high) else f"{low} px and more"
        recalls[name] = float(found[chosen].mean()) if chosen.any() else None
    return recalls


def _entry_delays(required, found):
    """Frames from each entry of a vehicle to its first box; None if there never is one."""
    delays = {}
    for identity in np.unique(required.ids):
        own = required.ids == identity
        frames, hits = required.frames[own], found[own]
        starts = np.flatnonzero(np.diff(frames, prepend=-(10**9)) > _NEW_ENTRY_GAP)
        for start, stop in zip(starts, [*starts[1:], len(frames)], strict=True):
            seen = np.flatnonzero(hits[start:stop])
            delay = int(frames[start + seen[0]] - frames[start]) if len(seen) else None
            delays[f"{identity} from {frames[start]}"] = delay
    return delays


def precision_recall(
    truth: Rows, detections: Rows, iou_threshold: float = 0.5, steps: int = 40
) -> tuple:
    """Precision and recall over the threshold on the score.

    Returns
    -------
    thresholds, precision, recall : ndarray of float, shape (steps,)
    """
    required = truth.only(truth.scores == 1)
    if not len(detections.scores):
        return tuple(np.zeros((3, 0)))
    thresholds = np.quantile(detections.scores, np.linspace(0, 0.99, steps))
    curve = []
    for threshold in thresholds:
        kept = drop_ignored(truth, detections.only(detections.scores >= threshold), iou_threshold)
        n_matched = sum(
            len(match(required.boxes[required.frames == frame],
                      kept.boxes[kept.frames == frame], iou_threshold)[0])
            for frame in np.unique(kept.frames)
        )  # fmt: skip
        curve.append(
            (n_matched / max(1, len(kept.frames)), n_matched / max(1, len(required.frames)))
        )
    precision, recall = np.array(curve).T
    return thresholds, precision, recall


def errors_by_frame(
    truth: Rows, detections: Rows, frames: range, iou_threshold: float = 0.5
) -> tuple:
    """Misses and false positives of every frame.

    Parameters
    ----------
    truth, detections : Rows
    frames : range
    iou_threshold : float

    Returns
    -------
    misses, false_positives : ndarray of int, shape (len(frames),)
    """
    truth, detections = truth.within(frames), detections.within(frames)
    required, counted = (
        truth.only(truth.scores == 1),
        drop_ignored(truth, detections, iou_threshold),
    )
    misses, false_positives = np.zeros((2, len(frames)), int)
    for frame in _with_rows(truth, detections, frames):
        wanted = required.boxes[required.frames == frame]
        found = counted.boxes[counted.frames == frame]
        n_matched = len(match(wanted, found, iou_threshold)[0])
        i = frames.index(frame)
        misses[i], false_positives[i] = len(wanted) - n_matched, len(found) - n_matched
    return misses, false_positives
