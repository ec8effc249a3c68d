"""How a detector shows what it found: boxes, undistortion, split screen."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from typing import Any

import cv2
import numpy as np

from vehicle_detection.compiled.threads import share
from vehicle_detection.media.calibration import load_calibration
from vehicle_detection.media.drawing import draw_title, draw_vehicles
from vehicle_detection.parameters import DEFAULT_FRAME

_ROWS_WORTH_A_THREAD = 100


class Viewer(ABC):
    """Draws the detections of the frames of one video.

    A class on top of this one finds them.

    Parameters
    ----------
    path_calib : path or None
        Calibration file, see `calibration.save_calibration`; None draws on the frame as it is.

    Attributes
    ----------
    titles : tuple of str
        Of the four `step_pictures`.
    """

    titles: tuple = ()

    def __init__(self, path_calib: str | os.PathLike | None):
        self.calibration = None
        if path_calib is not None:
            self.load_calibration(path_calib)

    @abstractmethod
    def reset(self) -> None:
        """Forget all frames: the next one begins another video."""

    @abstractmethod
    def detect(self, rgb_frame: np.ndarray) -> Any:
        """Detections of the next frame, with `boxes` and `ids`."""

    @abstractmethod
    def step_pictures(self, rgb_frame: np.ndarray, detections: Any) -> list:
        """What `titles` name, each drawn on the frame."""

    @abstractmethod
    def settings(self) -> dict:
        """Parameters by name, for a report."""

    def load_calibration(self, path: str | os.PathLike) -> None:
        """Read a calibration, see `calibration.load_calibration`."""
        self.calibration = load_calibration(path)
        self._maps = {}

    def process_image(self, rgb_frame: np.ndarray) -> np.ndarray:
        """Detect in the next frame of the video and draw its vehicles.

        Parameters
        ----------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)
            RGB.

        Returns
        -------
        picture : ndarray of uint8, shape (rows, columns, 3)
            RGB; undistorted if there is a calibration.
        """
        return self.draw(rgb_frame, self.detect(rgb_frame))

    def draw(self, rgb_frame: np.ndarray, detections: Any) -> np.ndarray:
        """Vehicles on a copy of the frame, then undistortion if there is a calibration."""
        metres = getattr(detections, "distances", None)
        picture = draw_vehicles(rgb_frame, detections.boxes, detections.ids, metres=metres)
        return self.undistort(picture)

    def draw_split_screen(self, rgb_frame: np.ndarray, detections: Any) -> np.ndarray:
        """The four `step_pictures` in one picture as large as the frame.

        Returns
        -------
        picture : ndarray of uint8, shape (rows, columns, 3)
        """
        rows, columns = rgb_frame.shape[:2]
        picture = np.zeros_like(rgb_frame)
        quarter = columns // 2, rows // 2
        for i, step in enumerate(self.step_pictures(rgb_frame, detections)):
            small = cv2.resize(step, quarter, interpolation=cv2.INTER_AREA)
            top, left = i // 2 * quarter[1], i % 2 * quarter[0]
            tile = draw_title(small, f"{i + 1} {self.titles[i]}")
            picture[top : top + quarter[1], left : left + quarter[0]] = tile
        return picture

    def undistort(self, rgb_frame: np.ndarray) -> np.ndarray:
        """The frame as a pinhole camera would see it; as it is without calibration."""
        if self.calibration is None:
            return rgb_frame
        if rgb_frame.shape not in self._maps:
            self._maps[rgb_frame.shape] = self.calibration.maps(rgb_frame.shape)
        places, fractions = self._maps[rgb_frame.shape]
        picture = np.empty(rgb_frame.shape, np.uint8)

        def fill(first, last):
            """Some rows of the picture."""
            maps = places[first:last], fractions[first:last]
            cv2.remap(rgb_frame, *maps, cv2.INTER_LINEAR, dst=picture[first:last])

        share(fill, len(picture), len(picture) // _ROWS_WORTH_A_THREAD)
        return picture


def require_frame(rgb_frame: np.ndarray, shape: tuple | None) -> None:
    """Raise ValueError unless a frame can be searched and has the shape of the one before.

    Parameters
    ----------
    rgb_frame : ndarray
    shape : tuple or None
        Of the frame before, None for none.
    """
    if rgb_frame.dtype != np.uint8 or rgb_frame.ndim != 3 or rgb_frame.shape[2] != 3:
        raise ValueError(f"no RGB frame of bytes: {rgb_frame.dtype} of shape {rgb_frame.shape}")
    if shape not in (None, rgb_frame.shape):
        raise ValueError(f"a frame of {rgb_frame.shape} after one of {shape}")
    rows, columns = rgb_frame.shape[:2]
    smallest, tallest = DEFAULT_FRAME.smallest_side, DEFAULT_FRAME.tallest
    if min(rows, columns) < smallest or rows > tallest * columns:
        raise ValueError(
            f"no window fits a frame of {columns}x{rows}: both sides need {smallest} pixels, "
            f"and the height is at most {tallest} times the width"
        )
