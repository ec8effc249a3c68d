"""What is learned from: footage with true boxes, and images of the training set."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vehicle_detection.media.images import find_images, read_image
from vehicle_detection.media.mot import frame_range, read_rows, require_within
from vehicle_detection.media.videos import VIDEO_SUFFIXES, read_frames

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams


@dataclass(frozen=True)
class Example:
    """A frame of footage with its vehicles.

    Attributes
    ----------
    source : Path or ndarray
        Where to read the frame, or the frame itself, RGB.
    boxes : ndarray of float, shape (n, 4)
    required : ndarray of bool, shape (n,)
        The others are ignore regions: neither vehicles nor nothing.
    visibility : ndarray of float, shape (n,)
        How much is seen of each vehicle, from 0 to 1; 0 if it is nowhere required. What
        the frame's side cuts teaches how vehicles enter, before they are required.
    """

    source: Any
    boxes: np.ndarray
    required: np.ndarray
    visibility: np.ndarray

    def read(self) -> np.ndarray:
        """The frame, RGB."""
        return read_image(self.source) if isinstance(self.source, Path) else self.source


@dataclass(frozen=True)
class TrainingSet:
    """All that is learned from.

    Attributes
    ----------
    examples : list of Example
    crops : list of Path
        Vehicles cut out tightly and squashed to squares: any shape may have
        been theirs.
    square_crops : list of Path
        Vehicles cut out as squares.
    boxed_crops : list of Example
        Vehicles cut out with a margin, and their boxes.
    non_vehicles : list of Path
    """

    examples: list
    crops: list
    square_crops: list
    boxed_crops: list
    non_vehicles: list


@dataclass(frozen=True)
class Footage:
    """A video or a folder of images, its true boxes, and which frames are meant.

    Attributes
    ----------
    path, truth : path
    frames : str
        See `mot.frame_range`.
    """

    path: str | os.PathLike
    truth: str | os.PathLike
    frames: str = "1:1000000"

    def read(self) -> list:
        """Its frames as a list of Example, see `read_footage`."""
        return read_footage(self.path, self.truth, self.frames)


def read_cameras(path: str | os.PathLike, without: Sequence = ()) -> dict:
    """Footage by camera from a CSV file.

    Parameters
    ----------
    path : path
        Columns camera, footage, truth, frames; the last may be empty. Paths are relative to
        the working directory.
    without : sequence of str
        Cameras to leave out.

    Returns
    -------
    cameras : dict of str to list of Footage

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing or lacks a column; a camera to leave out is not in it.
    """
    path, cameras = Path(path), {}
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such list of cameras")
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    try:
        for row in rows:
            footage = Footage(row["footage"], row["truth"], row["frames"] or "1:1000000")
            cameras.setdefault(row["camera"], []).append(footage)
    except KeyError as error:
        raise ValueError(f"{path}: no column {error}") from error
    unknown = set(without) - set(cameras)
    if unknown:
        raise ValueError(f"{path}: no camera {', '.join(sorted(unknown))}")
    return {name: parts for name, parts in cameras.items() if name not in without}


def read_footage(
    path: str | os.PathLike, truth: str | os.PathLike, frames: str = "1:1000000"
) -> list:
    """Frames of a video or of a folder of images, with their true boxes.

    Parameters
    ----------
    path, truth : path
        The n-th image of a folder, in the order of names, is frame n.
    frames : str
        See `mot.frame_range`. Those of a video are held in memory, three bytes a
        pixel; images are read when they are needed.

    Returns
    -------
    examples : list of Example

    Raises
    ------
    FileNotFoundError, ValueError
        A file is missing or cannot be read; no frame is left.
    """
    path, rows, numbers = Path(path), read_rows(truth, is_truth=True), frame_range(frames)
    is_video = path.suffix.lower() in VIDEO_SUFFIXES
    sources = read_frames(path) if is_video else find_images(path)
    required = rows.scores == 1
    # What is never required, or has no identity, may be no vehicle at all.
    is_vehicle = required | np.isin(rows.ids, rows.ids[required & (rows.ids >= 0)])
    visibility = np.where(is_vehicle, rows.visibility, 0)
    visibility[required & (rows.visibility < 0)] = 1
    examples = []
    for number, source in enumerate(sources, start=1):
        if number >= numbers.stop:
            break
        if number in numbers:
            own = rows.frames == number
            if is_video:
                require_within(rows.only(own), source.shape, truth)
            examples.append(Example(source, rows.boxes[own], required[own], visibility[own]))
    if not examples:
        raise ValueError(f"{path}: no frame in {frames}")
    return examples


def read_boxed_crops(folder: str | os.PathLike, truth: str | os.PathLike) -> list:
    """Those images of a folder that have a true box, as `read_footage`."""
    examples = [example for example in read_footage(folder, truth) if example.required.any()]
    if not examples:
        raise ValueError(f"{truth}: no box for any image of {folder}")
    return examples


def images_of_folders(folders: list) -> list:
    """All images of some folders, see `files.find_images`."""
    return [path for folder in folders for path in find_images(folder)]


def balanced(examples: list, params: TrainingParams) -> list:
    """Examples of one camera, thinned out or repeated to as many as every camera has.

    Parameters
    ----------
    examples : list of Example
    params : TrainingParams

    Returns
    -------
    examples : list of Example
        Evenly spread over those given.
    """
    count = min(params.per_camera, params.most_repeats * len(examples))
    if count <= len(examples):
        return [examples[i * len(examples) // count] for i in range(count)]
    return [examples[i % len(examples)] for i in range(count)]


def with_generators(examples: list, *seed) -> list:
    """Each example with random numbers of its own, the same on any number of cores."""
    return [(example, np.random.default_rng([*seed, i])) for i, example in enumerate(examples)]
