"""The figures of an evaluation as text and as a picture."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Sequence
from itertools import islice
from typing import TYPE_CHECKING

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from vehicle_detection.evaluation.metrics import errors_by_frame, precision_recall
from vehicle_detection.media.drawing import WHITE, draw_boxes, draw_vehicles
from vehicle_detection.media.figures import crop_to_road, show
from vehicle_detection.media.videos import read_frames

if TYPE_CHECKING:
    from vehicle_detection.media.mot import Rows
    from vehicle_detection.media.viewer import Viewer


def table(figures: dict) -> str:
    """Figures as lines of text."""
    lines = []
    for name, value in figures.items():
        if isinstance(value, dict):
            inner = ", ".join(f"{key}: {_number(v)}" for key, v in value.items())
            lines.append(f"{name:28}{inner}")
        else:
            lines.append(f"{name:28}{_number(value)}")
    return "\n".join(lines)


def _number(value):
    if value is None:
        return "-"
    return str(value) if isinstance(value, int) else f"{value:.3f}"


def draw_evaluation(
    truth: Rows, detections: Rows, frames: range, iou_threshold: float = 0.5
) -> Figure:
    """Figure with the precision-recall curve and a timeline of errors over a range of frames.

    Returns
    -------
    figure : matplotlib.figure.Figure
    """
    figure, (curve, timeline) = plt.subplots(
        2, 1, figsize=(10, 7), height_ratios=(2, 1), layout="constrained"
    )
    truth, detections = truth.within(frames), detections.within(frames)
    _, precision, recall = precision_recall(truth, detections, iou_threshold)
    curve.plot(recall, precision, marker=".")
    curve.set(xlabel="recall", ylabel="precision", xlim=(0, 1.02), ylim=(0, 1.02))
    misses, alarms = errors_by_frame(truth, detections, frames, iou_threshold)
    timeline.fill_between(frames, misses, step="mid", color="tab:blue", label="missed")
    timeline.fill_between(
        frames, -np.array(alarms), step="mid", color="tab:orange", label="false positives"
    )
    timeline.set(xlabel="frame", ylabel="boxes")
    timeline.legend(loc="upper right")
    return figure


def steps_from(video: str | os.PathLike, vehicle: Viewer, first_frame: int, count: int = 5) -> list:
    """Step pictures of some frames, of the last ones if the video is shorter.

    Parameters
    ----------
    video : path
    vehicle : Viewer
        Is reset first.
    first_frame : int
        The frame before the first to be shown.
    count : int

    Returns
    -------
    rows : list of (str, list)
        Title and `Viewer.step_pictures`, as `figures.show_steps` takes them.
    """
    vehicle.reset()
    last = deque(maxlen=count)
    for number, frame in enumerate(islice(read_frames(video), first_frame + count), start=1):
        last.append((f"frame {number}", frame, vehicle.detect(frame)))
    return [(title, vehicle.step_pictures(frame, found)) for title, frame, found in last]


def show_worst(
    video: str | os.PathLike, vehicle: Viewer, truth: Rows, errors: np.ndarray, count: int = 6
) -> Figure | None:
    """Figure of the frames with the most errors, true boxes in white.

    Parameters
    ----------
    video : path
    vehicle : Viewer
        Detects in the whole video anew.
    truth : Rows
    errors : ndarray of int, shape (n,)
        Of each frame, from the first.
    count : int
        Frames to show, at most.

    Returns
    -------
    figure : matplotlib.figure.Figure or None
        None if no frame has an error.
    """
    worst = {int(i) + 1 for i in errors.argsort(stable=True)[::-1][:count] if errors[i] > 0}
    required = truth.only(truth.scores == 1)
    pictures, titles = [], []
    vehicle.reset()
    for number, frame in enumerate(read_frames(video), start=1):
        detections = vehicle.detect(frame)
        if number in worst:
            own = required.boxes[required.frames == number]
            picture = draw_boxes(frame, own, WHITE, thickness=7)
            pictures.append(crop_to_road(draw_vehicles(picture, detections.boxes, detections.ids)))
            titles.append(f"frame {number}: {errors[number - 1]} wrong")
    return show(pictures, titles, columns=2) if pictures else None


def side_by_side(video: str | os.PathLike, vehicles: dict, frames: Sequence) -> tuple:
    """What several detectors find in the same frames.

    Parameters
    ----------
    video : path
    vehicles : dict of str to Viewer
        Are reset first.
    frames : sequence of int
        Numbers of the frames to draw, from 1; the last one if the video is shorter.

    Returns
    -------
    pictures : list of ndarray of uint8, shape (rows, columns, 3)
        Frame by frame, detector by detector.
    detections : dict of str to list
        Of every frame of the video.
    """
    for vehicle in vehicles.values():
        vehicle.reset()
    pictures, detections = [], {name: [] for name in vehicles}

    def drawn():
        """The newest frame with what each detector has found."""
        return [draw_vehicles(frame, own[-1].boxes, own[-1].ids) for own in detections.values()]

    for number, frame in enumerate(read_frames(video), start=1):
        for name, vehicle in vehicles.items():
            detections[name].append(vehicle.detect(frame))
        if number in frames:
            pictures += drawn()
    return pictures or drawn(), detections
