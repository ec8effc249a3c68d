"""The learned parameters of the two-stage detector, and their file."""

from __future__ import annotations

import hashlib
import os
import zipfile
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np

from vehicle_detection.media.files import written_whole
from vehicle_detection.two_stage.features import CELL_FEATURES, N_FEATURES
from vehicle_detection.two_stage.proposals import WINDOW_COLUMNS, WINDOW_CONTEXT, WINDOW_ROWS

FORMAT_VERSION = 10
# Of the second stage: the decision function, and shifts of left, top, right and bottom.
N_OUTPUTS = 5
# Ten times what a detector takes, and more than any of its numbers.
_MOST_BYTES, _LARGEST = 50_000_000, 1e6


@dataclass(frozen=True)
class Template:
    """Linear SVM and ridge regression of the first stage.

    Attributes
    ----------
    weights : ndarray of float32, shape (rows, columns, CELL_FEATURES)
        Of the SVM, by the cells of a window.
    bias : float
    shift_weights : ndarray of float32, shape (rows + 6, columns + 6, CELL_FEATURES, 4)
        Of the regression, by the cells of a window and `WINDOW_CONTEXT` around it.
    shift_bias : ndarray of float32, shape (4,)
    """

    weights: np.ndarray
    bias: float
    shift_weights: np.ndarray
    shift_bias: np.ndarray


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
        components = features @ self._transposed_projection + self.offset
        squares = _squared_lengths(components)
        # |x - c|^2 = |x|^2 + |c|^2 - 2 x c, as one product instead of three passes.
        extended = np.hstack([components, squares, np.ones_like(squares)])
        exponents = extended @ self._extended_centers
        return np.exp(exponents, out=exponents) @ self.weights.T + self.bias

    # BLAS takes twice as long for few rows by a large matrix that is a transposed view.
    @cached_property
    def _transposed_projection(self):
        """Shape (n_features, n_components)."""
        return np.ascontiguousarray(self.projection.T)

    @cached_property
    def _extended_centers(self):
        """What extended components are multiplied by; shape (n_components + 2, n)."""
        squares = _squared_lengths(self.centers)
        rows = np.hstack([-2 * self.centers, np.ones_like(squares), squares])
        return np.ascontiguousarray(np.float32(-self.gamma) * rows.T)


def _squared_lengths(rows):
    """Squared length of every row, shape (n, 1)."""
    return np.einsum("ij,ij->i", rows, rows)[:, None]


@dataclass(frozen=True)
class Detector:
    """All that the two-stage detector learns.

    Attributes
    ----------
    templates : tuple of Template
        The first stage.
    machine : KernelMachine
        The second stage: from the features of a patch, see `features.describe_patches`, to
        its decision function and the shifts of its edges, in widths and heights of the box.
    """

    templates: tuple
    machine: KernelMachine


def save_detector(detector: Detector, path: str | os.PathLike) -> None:
    """Write a detector as a NumPy archive; it appears under its name only when whole."""
    arrays: dict = {"format_version": np.int64(FORMAT_VERSION)}
    for i, template in enumerate(detector.templates):
        arrays |= {f"template{i}_{name}": value for name, value in vars(template).items()}
    machine = {field.name: getattr(detector.machine, field.name) for field in fields(KernelMachine)}
    arrays |= {f"machine_{name}": _half(value) for name, value in machine.items()}
    arrays["sha256"] = _checksum(arrays)
    with written_whole(path) as file:
        np.savez_compressed(file, **arrays)


def _checksum(arrays):
    """SHA-256 of names and values, as an array of bytes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        value = np.asarray(arrays[name])
        digest.update(f"{name} {value.dtype.str} {value.shape} ".encode())
        digest.update(value.tobytes())
    return np.frombuffer(digest.digest(), np.uint8)


def _half(value):
    """Large arrays at half their precision, which no score shows in its second digit."""
    return value.astype(np.float16) if np.size(value) > 100_000 else value


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
        arrays = _read_arrays(path)
        templates = tuple(
            _read_template(arrays, f"template{i}", columns)
            for i, columns in enumerate(WINDOW_COLUMNS)
        )
        machine = _read_machine(arrays, "machine")
    except Exception as error:
        raise ValueError(f"{path}: not a detector of two_stage.training: {error}") from error
    return Detector(templates, machine)


def _read_arrays(path):
    """All arrays of an archive by name: small ones, of finite numbers, as they were written."""
    with zipfile.ZipFile(path) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > _MOST_BYTES:
        raise ValueError(f"{size} bytes when unpacked, at most {_MOST_BYTES} are read")
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    version = arrays.get("format_version", np.int64(0))
    if version.shape != () or version != FORMAT_VERSION:
        raise ValueError(f"format {version}, not {FORMAT_VERSION}")
    checksum = arrays.pop("sha256")
    if not np.array_equal(checksum, _checksum(arrays)):
        raise ValueError("it is damaged: its checksum does not agree")
    del arrays["format_version"]
    for name, values in arrays.items():
        if values.dtype.kind != "f" or values.dtype.byteorder == ">":
            raise ValueError(f"{name} is {values.dtype}, not little-endian floats")
        if not (np.abs(values.astype(float)) <= _LARGEST).all():
            raise ValueError(f"{name} holds numbers that are not finite, or huge")
    return {name: values.astype(np.float32) for name, values in arrays.items()}


def _require_shape(array, shape):
    # Compiled code looks at no bounds.
    if array.shape != shape:
        raise ValueError(f"an array of {array.shape} instead of {shape}")


def _read_template(arrays, name, columns):
    values = [arrays[f"{name}_{field.name}"] for field in fields(Template)]
    around = 2 * WINDOW_CONTEXT
    shapes = (
        (WINDOW_ROWS, columns, CELL_FEATURES), (),
        (WINDOW_ROWS + around, columns + around, CELL_FEATURES, 4), (4,),
    )  # fmt: skip
    for array, shape in zip(values, shapes, strict=True):
        _require_shape(array, shape)
    weights, bias, *shifts = values
    return Template(weights, float(bias), *shifts)


def _read_machine(arrays, name):
    values = [arrays[f"{name}_{field.name}"] for field in fields(KernelMachine)]
    n_components, n_centers = len(values[1]), len(values[2])
    shapes = (
        (n_components, N_FEATURES), (n_components,), (n_centers, n_components),
        (N_OUTPUTS, n_centers), (N_OUTPUTS,), (),
    )  # fmt: skip
    for array, shape in zip(values, shapes, strict=True):
        _require_shape(array, shape)
    *arrays, gamma = values
    if not gamma > 0:
        raise ValueError(f"gamma {gamma} is not above 0")
    return KernelMachine(*arrays, gamma=float(gamma))
