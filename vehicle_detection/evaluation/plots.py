"""The figures of an evaluation as text and as a picture."""

import matplotlib.pyplot as plt
import numpy as np

from vehicle_detection.evaluation.metrics import errors_by_frame, precision_recall


def table(figures):
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


def draw_evaluation(truth, detections, frames, iou_threshold=0.5):
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
    timeline.fill_between(frames, misses, step="mid", color="tab:orange", label="missed")
    timeline.fill_between(
        frames, -np.array(alarms), step="mid", color="tab:red", label="false positives"
    )
    timeline.set(xlabel="frame", ylabel="boxes")
    timeline.legend(loc="upper right")
    return figure
