"""The learned parameters of the two-stage detector, and their file."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np

from vehicle_detection.media.files import written_whole
from vehicle_detection.two_stage.features import (
    CELL_FEATURES,
    N_REGRESSOR_FEATURES,
    N_SCORER_FEATURES,
)
from vehicle_detection.two_stage.proposals import WINDOW_COLUMNS, WINDOW_ROWS

FORMAT_VERSION = 8


@dataclass(frozen=True)
class Template:
    """Linear SVM of the first stage.

    Attributes
    ----------
    weights : ndarray of float32, shape (rows, columns, CELL_FEATURES)
    bias : float
    """

    weights: np.ndarray
    bias: float


@dataclass(frozen=True)
class KernelMachine:
    """f(x) = sum_i weights_i exp(-gamma |P x + offset - centers_i|^2) + bias.

    Attributes
    ----------
    projection : ndarray of float32, shape (n_components, n_features)
        P; scaling and principal components in one.
    offset : ndarray of float32, shape (n_components,)
    centers : ndarray of float32, shape (n, n_components)
    weights : ndarray of float32, shape (n_outputs, n)
    bias : ndarray of float32, shape (n_outputs,)
    gamma : float
    """

    projection: np.ndarray
    offset: np.ndarray
    centers: np.ndarray
    weights: np.ndarray
    bias: np.ndarray
    gamma: float

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Outputs for features of float32, shape (n, n_features), shape (n, n_outputs)."""
        components = features @ self.projection.T + self.offset
        distances = _squared_lengths(components)[:, None] + self._squared_centers
        distances -= 2 * (components @ self.centers.T)
        return np.exp(np.float32(-self.gamma) * distances) @ self.weights.T + self.bias

    @cached_property
    def _squared_centers(self):
        return _squared_lengths(self.centers)


def _squared_lengths(rows):
    """Squared length of every row, shape (n,)."""
    return np.einsum("ij,ij->i", rows, rows)


@dataclass(frozen=True)
class Detector:
    """All that the two-stage detector learns.

    Attributes
    ----------
    templates : tuple of Template
    scorer : KernelMachine
        From the luma and colours of a patch to a decision function.
    regressor : KernelMachine
        From all cells of a patch to shifts of the four edges, in widths and
        heights of the box.
    """

    templates: tuple
    scorer: KernelMachine
    regressor: KernelMachine


def save_detector(detector: Detector, path: str | os.PathLike) -> None:
    """Write a detector as a NumPy archive; it appears under its name only when whole."""
    arrays: dict = {"format_version": FORMAT_VERSION}
    for i, template in enumerate(detector.templates):
        arrays |= {f"template{i}_{name}": value for name, value in vars(template).items()}
    for name in ("scorer", "regressor"):
        machine = getattr(detector, name)
        own = {field.name: getattr(machine, field.name) for field in fields(machine)}
        arrays |= {f"{name}_{key}": _half(value) for key, value in own.items()}
    with written_whole(path) as partial, open(partial, "wb") as file:
        np.savez_compressed(file, **arrays)


def _half(value):
    """Large arrays at half their precision, which no score shows in its second digit."""
    return value.astype(np.float16) if np.size(value) > 10_000 else value


def load_detector(path: str | os.PathLike) -> Detector:
    """Read what `save_detector` wrote.

    Raises
    ------
    FileNotFoundError, ValueError
        There is no such file; it is not of this format.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such parameter file: train one, see docs/training.md")
    # What is no such archive can fail in any way whatever.
    try:
        with np.load(path) as arrays:
            if arrays["format_version"] != FORMAT_VERSION:
                raise ValueError(f"format {arrays['format_version']}, not {FORMAT_VERSION}")
            templates = tuple(
                Template(arrays[f"template{i}_weights"], float(arrays[f"template{i}_bias"]))
                for i in range(len(WINDOW_COLUMNS))
            )
            scorer = _read_machine(arrays, "scorer", N_SCORER_FEATURES, 1)
            regressor = _read_machine(arrays, "regressor", N_REGRESSOR_FEATURES, 4)
        for template, columns in zip(templates, WINDOW_COLUMNS, strict=True):
            _require_shape(template.weights, (WINDOW_ROWS, columns, CELL_FEATURES))
    except Exception as error:
        raise ValueError(f"{path}: not a detector of two_stage.training: {error}") from error
    return Detector(templates, scorer, regressor)


def _require_shape(array, shape):
    # Compiled code looks at no bounds.
    if array.shape != shape:
        raise ValueError(f"an array of {array.shape} instead of {shape}")


def _read_machine(arrays, name, n_features, n_outputs):
    fields = ("projection", "offset", "centers", "weights", "bias")
    values = [arrays[f"{name}_{field}"].astype(np.float32) for field in fields]
    n_components, n_centers = len(values[1]), len(values[2])
    shapes = (
        (n_components, n_features), (n_components,), (n_centers, n_components),
        (n_outputs, n_centers), (n_outputs,),
    )  # fmt: skip
    for array, shape in zip(values, shapes, strict=True):
        _require_shape(array, shape)
    return KernelMachine(*values, gamma=float(arrays[f"{name}_gamma"]))
