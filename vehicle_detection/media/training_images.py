"""Training images as windows: read on all cores, whatever their size."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from tqdm.auto import tqdm

from vehicle_detection.compiled.threads import side_by_side
from vehicle_detection.media.images import find_images, read_image

# Handing images over one by one takes about as long again as reading them.
_IMAGES_PER_RUN = 500
# Share of the images that tests a classifier.
HELD_OUT = 0.2
# Long enough that neighbours which show the same car mostly share one run.
_RUN_LENGTH = 100


def read_window(path: str | os.PathLike, window_size: int) -> tuple:
    """Read an image as a window; one of another size is resized.

    Returns
    -------
    img : ndarray of uint8, shape (window_size, window_size, 3)
        RGB.
    resized : bool
    """
    img = read_image(path)
    if img.shape[:2] == (window_size, window_size):
        return img, False
    return cv2.resize(img, (window_size, window_size), interpolation=cv2.INTER_AREA), True


def read_windows(paths: list, window_size: int) -> np.ndarray:
    """Read many images as windows, with a progress bar; says how many had to be resized.

    Parameters
    ----------
    paths : list of Path
    window_size : int

    Returns
    -------
    images : ndarray of uint8, shape (len(paths), window_size, window_size, 3)
        RGB.

    Raises
    ------
    ValueError
        Naming every file that is none, see `images.read_image`.
    """
    wrong = []
    images = np.empty((len(paths), window_size, window_size, 3), np.uint8)
    resized = np.zeros(len(paths), bool)
    with tqdm(total=len(paths), desc="images", unit="image") as progress:

        def fill(first):
            """Read the run of images that begins here."""
            run = range(first, min(first + _IMAGES_PER_RUN, len(paths)))
            for i in run:
                try:
                    images[i], resized[i] = read_window(paths[i], window_size)
                except (OSError, ValueError) as error:
                    wrong.append(str(error))
            progress.update(len(run))

        side_by_side(fill, range(0, len(paths), _IMAGES_PER_RUN))
    if wrong:
        raise ValueError("\n".join(sorted(wrong)))
    if resized.any():
        size, first = f"{window_size}x{window_size}", paths[resized.argmax()]
        print(f"resized to {size}: {resized.sum()} images, the first {first}")
    return images


@dataclass(frozen=True)
class TrainingImages:
    """All images of a training set, in the order in which they were taken.

    Attributes
    ----------
    images : ndarray of uint8, shape (n, 64, 64, 3)
        RGB.
    labels : ndarray of int, shape (n,)
        1 for vehicles.
    sources : ndarray of int, shape (n,)
        Which folder each is from: each folder was cut from videos of its own.
    """

    images: np.ndarray
    labels: np.ndarray
    sources: np.ndarray


def numbers_in(path: Path) -> tuple:
    """Folder and number of an image file: sorting by it gives the order of taking."""
    digits = re.findall(r"\d+", path.stem)
    return path.parent, int(digits[-1]) if digits else 0


def load_training_set(folder: str | os.PathLike) -> TrainingImages:
    """Read folder/vehicles and folder/non-vehicles.

    Raises
    ------
    FileNotFoundError, ValueError
        A folder is missing or empty; an image cannot be read.
    """
    paths, labels = [], []
    for label, name in ((1, "vehicles"), (0, "non-vehicles")):
        found = sorted(find_images(Path(folder) / name), key=numbers_in)
        paths += found
        labels += [label] * len(found)
    folders = [str(path.parent) for path in paths]
    _, sources = np.unique(folders, return_inverse=True)
    return TrainingImages(read_windows(paths, 64), np.array(labels), sources)


def hold_out_ends(sources: np.ndarray) -> np.ndarray:
    """Hold out the last images of every source, a whole run of the video.

    Neighbours show the same car, so a random split tests on near copies.

    Parameters
    ----------
    sources : ndarray of int, shape (n,)

    Returns
    -------
    held_out : ndarray of bool, shape (n,)
    """
    held_out = np.zeros(len(sources), bool)
    for source in np.unique(sources):
        own = np.flatnonzero(sources == source)
        held_out[own[round(len(own) * (1 - HELD_OUT)) :]] = True
    return held_out


def runs_of(sources: np.ndarray) -> np.ndarray:
    """Number of the run of neighbours each image belongs to, ndarray of int, shape (n,)."""
    position = np.zeros(len(sources), int)
    for source in np.unique(sources):
        own = sources == source
        position[own] = np.arange(own.sum()) // _RUN_LENGTH
    return np.unique(np.stack([sources, position]), axis=1, return_inverse=True)[1]
