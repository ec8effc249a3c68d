"""The picture with which a training ends: what is confused, and how sure the classifier is."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from sklearn.metrics import confusion_matrix

# Orange and blue that colour-blind people tell apart, see `media.drawing`.
_COLORS = {"other": "#d55e00", "vehicle": "#0072b2"}
_N_WORST = 8


def draw_confusion(images: np.ndarray, labels: np.ndarray, scores: np.ndarray) -> Figure:
    """Figure with the confusion matrix, the scores of both classes, and the worst images.

    Parameters
    ----------
    images : ndarray of uint8, shape (n, side, side, 3)
        RGB.
    labels : ndarray of int, shape (n,)
        1 for vehicles.
    scores : ndarray of float, shape (n,)
        Decision function, positive for vehicles.

    Returns
    -------
    figure : matplotlib.figure.Figure
    """
    figure = plt.figure(figsize=(12, 7), layout="constrained")
    parts: Any = figure.subfigures(3, 1, height_ratios=(2.2, 1, 1))
    top, *rows = parts
    matrix, histogram = top.subplots(1, 2, width_ratios=(1, 2))
    _draw_matrix(matrix, labels, scores)
    _draw_histogram(histogram, labels, scores)
    for row, label, name in zip(rows, (1, 0), ("vehicles", "others"), strict=True):
        wrongness = np.where(labels == label, scores * (1 - 2 * label), -np.inf)
        worst = np.argsort(-wrongness, kind="stable")[:_N_WORST]
        worst = worst[np.isfinite(wrongness[worst])]
        row.suptitle(f"most wrong {name}, with their scores", fontsize=10)
        for axis, i in zip(row.subplots(1, _N_WORST), worst, strict=False):
            axis.imshow(images[i])
            axis.set_title(f"{scores[i]:.2f}", fontsize=9)
        for axis in row.axes:
            axis.axis("off")
    return figure


def _draw_matrix(axis, labels, scores):
    """Counts of what is taken for what."""
    counts = confusion_matrix(labels, scores > 0, labels=[1, 0])
    axis.imshow(counts / np.maximum(1, counts.sum(axis=1, keepdims=True)), cmap="Blues", vmin=0)
    for (row, column), count in np.ndenumerate(counts):
        color = "white" if row == column and count else "black"
        axis.text(column, row, str(count), ha="center", va="center", color=color)
    names = "vehicle", "other"
    axis.set(xticks=(0, 1), yticks=(0, 1), xticklabels=names, yticklabels=names)
    axis.set(xlabel="taken for", ylabel="is")


def _draw_histogram(axis, labels, scores):
    """How the scores of both classes spread."""
    edges = np.linspace(min(scores.min(), -0.1), max(scores.max(), 0.1), 50)
    for label, (name, color) in enumerate(_COLORS.items()):
        axis.hist(scores[labels == label], edges, alpha=0.6, label=name, color=color)
    axis.axvline(0, color="black", linewidth=1)
    axis.set(xlabel="decision function", ylabel="images", yscale="symlog")
    axis.legend()
