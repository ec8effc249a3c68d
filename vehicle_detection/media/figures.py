"""Pictures side by side, for the notebooks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

# Rows of a frame in which traffic is, as shares of its height.
_ROAD_ROWS = 0.42, 0.95


def crop_to_road(img: np.ndarray) -> np.ndarray:
    """The rows of a frame in which traffic is: details stay legible at the width of a page."""
    first, last = (round(share * len(img)) for share in _ROAD_ROWS)
    return img[first:last]


def show(
    images: Sequence,
    titles: Sequence | None = None,
    columns: int = 2,
    width: float = 12,
    cmap: str = "gray",
) -> Figure:
    """Figure with a grid of images.

    Parameters
    ----------
    images : sequence of ndarray
        RGB of uint8, or one channel of any range.
    titles : sequence of str, optional
    columns : int
    width : float
        Of the figure, in inches; its height follows.
    cmap : str
        Matplotlib's name of the colours for images of one channel.

    Returns
    -------
    figure : matplotlib.figure.Figure
    """
    images = list(images)
    rows = -(-len(images) // columns)
    height, breadth = images[0].shape[:2]
    title_height = 0.3 if titles else 0.05
    cell = width / columns
    figure, axes = plt.subplots(
        rows, columns, figsize=(width, rows * (cell * height / breadth + title_height)),
        squeeze=False, layout="constrained",
    )  # fmt: skip
    for axis in axes.flat:
        axis.axis("off")
    for i, (axis, image) in enumerate(zip(axes.flat, images, strict=False)):
        axis.imshow(image, cmap=cmap)
        if titles:
            axis.set_title(titles[i], fontsize=10)
    return figure


def show_steps(rows: Sequence, titles: Sequence, width: float = 16) -> Figure:
    """Figure of several frames, one a row, with the pictures of every step side by side.

    Parameters
    ----------
    rows : sequence of (label, list of ndarray)
        What to write beside a row, and its pictures, RGB of uint8.
    titles : sequence of str
        Of the steps; they are numbered.
    width : float
        Of the figure, in inches.

    Returns
    -------
    figure : matplotlib.figure.Figure
    """
    columns = len(titles)
    height, breadth = crop_to_road(rows[0][1][0]).shape[:2]
    figure, axes = plt.subplots(
        len(rows), columns, figsize=(width, 0.3 + len(rows) * width / columns * height / breadth),
        squeeze=False, layout="constrained",
    )  # fmt: skip
    for (label, pictures), own in zip(rows, axes, strict=True):
        for picture, axis in zip(pictures, own, strict=True):
            axis.imshow(crop_to_road(picture))
            axis.set(xticks=[], yticks=[])
        own[0].set_ylabel(label)
    for number, (title, axis) in enumerate(zip(titles, axes[0], strict=True), start=1):
        axis.set_title(f"{number} {title}", fontsize=11)
    return figure


def live(function: Callable, values: dict, widgets: bool = True) -> Any:
    """Show the pictures of a function, and again whenever a slider is moved.

    Parameters
    ----------
    function : callable
        Takes the names of `values`; returns pictures and their titles.
    values : dict of str to sequence
        What each may be; the middle one is shown first.
    widgets : bool
        Whether anybody is there to move them.

    Returns
    -------
    panel : ipywidgets.Widget or None
        None without widgets, or where they are not installed: the first figure is all there is.
    """

    def draw(**chosen):
        """Show what the function makes of some values."""
        pictures, titles = function(**chosen)
        show([crop_to_road(picture) for picture in pictures], titles)

    first = {name: choices[len(choices) // 2] for name, choices in values.items()}
    draw(**first)
    if not widgets:
        return None
    try:
        from ipywidgets import SelectionSlider, interactive
    except ImportError:
        return None
    sliders = {
        name: SelectionSlider(options=choices, value=first[name], continuous_update=False)
        for name, choices in values.items()
    }
    return interactive(draw, **sliders)


def show_histograms(histograms: Sequence, titles: Sequence, channel_names: Sequence) -> Figure:
    """Figure with one row of bar charts for each image, a chart for each channel.

    Parameters
    ----------
    histograms : sequence of ndarray, shape (channels * bins,)
        As `pipeline_functions.color_hist` returns them.
    titles, channel_names : sequence of str

    Returns
    -------
    figure : matplotlib.figure.Figure
    """
    n_channels = len(channel_names)
    figure, axes = plt.subplots(
        len(histograms), n_channels, figsize=(12, 2.2 * len(histograms)),
        sharex=True, squeeze=False, layout="constrained",
    )  # fmt: skip
    for row, histogram, title in zip(axes, histograms, titles, strict=True):
        for axis, counts, name in zip(
            row, np.split(histogram, n_channels), channel_names, strict=True
        ):
            edges = np.linspace(0, 256, len(counts) + 1)
            axis.stairs(counts, edges, fill=True, color="steelblue")
            axis.set_title(f"{title}, {name}", fontsize=10)
    return figure
