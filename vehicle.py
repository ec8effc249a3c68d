"""The write-ups' way with a memory: heat of the last frames in, vehicles that last out."""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import label

from pipeline_functions import (
    SEARCH_PRESETS,
    HeatGrid,
    add_heat,
    apply_threshold,
    draw_boxes,
    draw_vehicles,
    find_blobs,
    find_cars,
    keep_lasting_heat,
    labeled_boxes,
    slide_window,
)
from vehicle_detection.classifier import load_classifier
from vehicle_detection.media.viewer import Viewer
from vehicle_detection.tracking.tracker import HEAT_TRACKS, Tracker

# Hot windows on one place that the pictures of heat show at their brightest.
_HEAT_FULL_SCALE = 8


@dataclass(frozen=True)
class FilterParams:
    """How the heat of the last frames becomes boxes.

    Attributes
    ----------
    n_acc : int
        Heatmaps that are kept.
    n_occ_thr : int
        Heat that is one object in space and time must be seen in this many
        frames; at 1 nothing is dropped.
    threshold : float
        The sum of the kept heatmaps must be above it.
    """

    n_acc: int
    n_occ_thr: int
    threshold: float

    def __post_init__(self):
        if not 1 <= self.n_occ_thr <= self.n_acc:
            raise ValueError(f"n_occ_thr {self.n_occ_thr} lies outside 1..{self.n_acc}")


FILTER_PRESETS = {
    "G": FilterParams(n_acc=15, n_occ_thr=4, threshold=12),
    "B": FilterParams(n_acc=10, n_occ_thr=1, threshold=25),
    # A still has no other frame to agree with: two windows have to.
    "still": FilterParams(n_acc=1, n_occ_thr=1, threshold=1),
}


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


class HeatVehicle(Viewer):
    """Finds vehicles as write-ups G and B do: windows, heat, what lasts.

    Parameters
    ----------
    path_calib : path or None
        See `Viewer`.
    path_param : path
        Classifier of `train.py`.
    search : SearchParams
    heat_filter : FilterParams
    track_params : TrackParams
        How boxes of one frame find their vehicles in the next.
    """

    titles = ("hot windows", "heat of this frame", "heat that lasts", "vehicles")

    def __init__(
        self,
        path_calib=None,
        path_param="param/svc_pickle.p",
        search=SEARCH_PRESETS["G"],
        heat_filter=FILTER_PRESETS["G"],
        track_params=HEAT_TRACKS,
    ):
        super().__init__(path_calib)
        self.search = search
        self.heat_filter = heat_filter
        self.track_params = track_params
        self.load_param_detect(path_param)

    def load_param_detect(self, path):
        """Read a classifier, see `classifier.load_classifier`; forgets all frames."""
        self.classifier = load_classifier(path)
        self.reset()

    def reset(self):
        """Forget all frames: the next one begins another video."""
        super().reset()
        self._tracker = Tracker(self.track_params)
        self._grid = None
        self._warmth = None
        self._heatmaps = deque(maxlen=self.heat_filter.n_acc)

    def detect(self, rgb_frame):
        """Search the next frame of the video.

        Parameters
        ----------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)

        Returns
        -------
        detections : HeatDetections

        Raises
        ------
        ValueError
            The frame is of another size than the one before.
        """
        self._require_same_size(rgb_frame)
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

    def remember(self, hot_windows):
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
        lasting = keep_lasting_heat(np.array(self._heatmaps), self.heat_filter.n_occ_thr)
        filtered = apply_threshold(lasting, self.heat_filter.threshold)
        cells, scores = find_blobs(filtered)
        self._warmth = heatmap + filtered
        boxes = self._grid.to_pixels(cells)
        self._tracker.predict()
        # What lasts needs no further evidence.
        tracks = self._tracker.update(boxes, np.ones(len(boxes)))
        ids = np.array([track.identity for track in tracks], int)
        return HeatDetections(hot_windows, heatmap, filtered, self._grid, boxes, scores, ids)

    def step_pictures(self, rgb_frame, detections):
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
            draw_heat(rgb_frame, lasting, _HEAT_FULL_SCALE * self.heat_filter.n_acc),
            draw_vehicles(rgb_frame, detections.boxes, detections.ids),
        ]
        return [self.undistort(picture) for picture in pictures]


def draw_heat(img, heatmap, full_scale):
    """The image darkened, with heat glowing on it.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    heatmap : ndarray, shape (rows, columns)
    full_scale : float
        Heat that is drawn at its brightest.
    """
    level = np.clip(255 * heatmap / full_scale, 0, 255).astype(np.uint8)
    glow = cv2.applyColorMap(level, cv2.COLORMAP_HOT)[..., ::-1]
    return cv2.addWeighted(img, 0.4, glow, 0.9, 0)
