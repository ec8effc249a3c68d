"""`Vehicle`, the write-up's class: the heat of the last frames in, vehicles that last out.

    VideoFileClip("drive.mp4").image_transform(Vehicle(calib, param).process_image)

hot windows -> heat -> heat of the last frames -> threshold -> labels -> boxes
"""

from __future__ import annotations

import os
from collections import deque
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import label

from pipeline_functions import (
    HeatGrid,
    add_heat,
    apply_threshold,
    find_blobs,
    find_cars,
    keep_lasting_heat,
    labeled_boxes,
    slide_window,
)
from vehicle_detection.classifier import load_classifier
from vehicle_detection.media.drawing import draw_boxes, draw_heat, draw_vehicles
from vehicle_detection.media.viewer import Viewer, require_frame
from vehicle_detection.parameters import FILTER_PRESETS, HEAT_TRACKS, SEARCH_PRESETS
from vehicle_detection.tracking.tracker import Tracker

if TYPE_CHECKING:
    from vehicle_detection.parameters import FilterParams, SearchParams

SHIPPED_CLASSIFIER = Path(__file__).parent / "param/svc_pickle.p"
# Hot windows on one place that the pictures of heat show at their brightest.
_HEAT_FULL_SCALE = 8


@dataclass(frozen=True)
class HeatDetections:
    """What was found in one frame, step by step.

    Attributes
    ----------
    hot_windows : ndarray of int, shape (n, 4)
        In pixels of the frame as read, like all boxes.
    heatmap, filtered : ndarray of float, shape (grid rows, grid columns)
        Heat of this frame; heat over time, thresholded.
    grid : HeatGrid
        The grid of both.
    boxes : ndarray of int, shape (n, 4)
    scores : ndarray of float, shape (n,)
        Highest heat within each box.
    ids : ndarray of int, shape (n,)
        Identity of each vehicle, from 1, the same in every frame.
    """

    hot_windows: np.ndarray
    heatmap: np.ndarray
    filtered: np.ndarray
    grid: HeatGrid
    boxes: np.ndarray
    scores: np.ndarray
    ids: np.ndarray


class Vehicle(Viewer):
    """Finds vehicles in the frames of one video, handed over in order, as write-up G does.

    The search runs on the frame as the camera gave it; a calibration straightens the
    picture that is drawn.

    Parameters
    ----------
    path_calib : path or None
        Calibration file; None draws on the frame as it is.
    path_param : path or object
        File of `train.py`; or a classifier with `params`, a FeatureParams, and
        `decision_function`, see `pipeline_functions.find_cars`.
    search : SearchParams
    heat_filter : FilterParams
        Its values are the attributes `n_acc`, `n_occ_thr` and `threshold`.

    Attributes
    ----------
    n_acc, n_occ_thr : int
    threshold : float
        See `FilterParams`.
    """

    titles = ("hot windows", "heat", "filtered heat", "boxes")

    def __init__(
        self,
        path_calib: str | os.PathLike | None = None,
        path_param: Any = SHIPPED_CLASSIFIER,
        search: SearchParams = SEARCH_PRESETS["G"],
        heat_filter: FilterParams = FILTER_PRESETS["G"],
    ):
        super().__init__(path_calib)
        self.search = search
        self.n_acc = heat_filter.n_acc
        self.n_occ_thr = heat_filter.n_occ_thr
        self.threshold = heat_filter.threshold
        self.load_param_detect(path_param)

    def load_param_detect(self, path: str | os.PathLike) -> None:
        """Take a classifier, or the path of one; forgets all frames."""
        has_scores = hasattr(path, "decision_function")
        self.classifier = path if has_scores else load_classifier(path)
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next one begins another video."""
        self._frame_shape: tuple | None = None
        self._n_frames = 0
        self._tracker = Tracker(HEAT_TRACKS)
        self._grid: Any = None
        self._warmth: np.ndarray | None = None
        self._heatmaps = deque(maxlen=self.n_acc)

    def settings(self) -> dict:
        """Parameters by name, for a report."""
        n_acc, n_occ_thr, threshold = self.n_acc, self.n_occ_thr, self.threshold
        return {
            "filter": {"n_acc": n_acc, "n_occ_thr": n_occ_thr, "threshold": threshold},
            "search": asdict(self.search),
            "features": asdict(self.classifier.params),
        }

    def detect(self, rgb_frame: np.ndarray) -> HeatDetections:
        """Search the next frame of the video.

        Parameters
        ----------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)
            RGB.

        Returns
        -------
        detections : HeatDetections

        Raises
        ------
        ValueError
            The frame is of another size than the one before, or too small for any window.
        """
        require_frame(rgb_frame, self._frame_shape)
        self._frame_shape = rgb_frame.shape
        if self._grid is None:
            windows = slide_window(rgb_frame.shape, self.classifier.params, self.search)
            self._grid = HeatGrid.of_windows(windows)
        everywhere = self._n_frames % self.search.scan_every == 0
        places = None if everywhere else self._warm_places()
        windows, scores = find_cars(rgb_frame, self.classifier, self.search, places)
        self._n_frames += 1
        return self.remember(windows[scores > self.search.threshold])

    def _warm_places(self):
        """Boxes in pixels around all that was warm or filtered in the frame before.

        What may become a vehicle counts too, or nothing would ever last long
        enough to become one.
        """
        labels, _ = label(self._warmth)
        return self._grid.to_pixels(labeled_boxes(labels))

    def remember(self, hot_windows: np.ndarray) -> HeatDetections:
        """Add the hot windows of the next frame to the memory, and see what lasts.

        Parameters
        ----------
        hot_windows : ndarray of int, shape (n, 4)
            In pixels of the frame.

        Returns
        -------
        detections : HeatDetections
        """
        heatmap = add_heat(self._grid.zeros(), self._grid.to_cells(hot_windows))
        self._heatmaps.append(heatmap)
        lasting = keep_lasting_heat(np.array(self._heatmaps), self.n_occ_thr)
        filtered = apply_threshold(lasting, self.threshold)
        cells, scores = find_blobs(filtered)
        self._warmth = heatmap + filtered
        boxes = self._grid.to_pixels(cells)
        self._tracker.predict()
        # What lasts needs no further evidence.
        enough = np.full(len(boxes), self._tracker.params.max_score)
        tracks: list = self._tracker.update(boxes, enough)
        ids = np.array([track.identity for track in tracks], dtype=int)
        return HeatDetections(hot_windows, heatmap, filtered, self._grid, boxes, scores, ids)

    def step_pictures(self, rgb_frame: np.ndarray, detections: Any) -> list:
        """Hot windows, heat, heat that lasts and boxes, each drawn on the frame.

        Returns
        -------
        pictures : list of four ndarray of uint8, shape (rows, columns, 3)
        """
        grid, shape = detections.grid, rgb_frame.shape
        heat, lasting = (
            grid.expand(heatmap, shape) for heatmap in (detections.heatmap, detections.filtered)
        )
        pictures = [
            draw_boxes(rgb_frame, detections.hot_windows, thickness=2),
            draw_heat(rgb_frame, heat, _HEAT_FULL_SCALE),
            draw_heat(rgb_frame, lasting, _HEAT_FULL_SCALE * self.n_acc),
            draw_vehicles(rgb_frame, detections.boxes, detections.ids),
        ]
        return [self.undistort(picture) for picture in pictures]
