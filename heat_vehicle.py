"""The detector with a memory: frames in, vehicles that last out."""

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np

import calibrate
from classifier import load_classifier
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
    slide_window,
)
from tracks import DEFAULT_TRACKS, Tracker

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
class Detections:
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


class Vehicle:
    """Finds vehicles in the frames of one video, handed over in order.

    Frames are searched as the camera gave them. A calibration straightens
    only the picture that is drawn: undistorting before the search would cut
    off vehicles that enter at the border.

    Parameters
    ----------
    path_calib : path or None
        Calibration of `calibrate.py`; None draws on the frame as it is.
    path_param : path
        Classifier of `train.py`.
    search : SearchParams
    heat_filter : FilterParams
    track_params : TrackParams
        How boxes of one frame find their vehicles in the next.
    """

    def __init__(
        self,
        path_calib=None,
        path_param="param/svc_pickle.p",
        search=SEARCH_PRESETS["G"],
        heat_filter=FILTER_PRESETS["G"],
        track_params=DEFAULT_TRACKS,
    ):
        self.calibration = None
        if path_calib is not None:
            self.load_calibration(path_calib)
        self.search = search
        self.heat_filter = heat_filter
        self.track_params = track_params
        self.load_param_detect(path_param)

    def load_calibration(self, path):
        """Read a calibration, see `calibrate.load_calibration`."""
        self.calibration = calibrate.load_calibration(path)
        self._maps = {}

    def load_param_detect(self, path):
        """Read a classifier, see `classifier.load_classifier`; forgets all frames."""
        self.classifier = load_classifier(path)
        self.reset()

    def reset(self):
        """Forget all frames: the next one begins another video."""
        self._grid = None
        self._frame_shape = None
        self._n_frames = 0
        # Where a close search looks: what may become a vehicle counts too, or
        # nothing would ever last long enough to become one.
        self._warm_places = None
        self._heatmaps = deque(maxlen=self.heat_filter.n_acc)
        self._tracker = Tracker(self.track_params)

    def process_image(self, rgb_frame):
        """The next frame of the video, its vehicles boxed in colours of their own.

        Parameters
        ----------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)

        Returns
        -------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)
            Undistorted if there is a calibration.
        """
        return self.draw(rgb_frame, self.detect(rgb_frame))

    def detect(self, rgb_frame):
        """Search the next frame of the video.

        Parameters
        ----------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)

        Returns
        -------
        detections : Detections

        Raises
        ------
        ValueError
            The frame is of another size than the one before.
        """
        if self._grid is None:
            windows = slide_window(rgb_frame.shape, self.classifier.params, self.search)
            self._grid = HeatGrid.of_windows(windows)
            self._frame_shape = rgb_frame.shape
        elif rgb_frame.shape != self._frame_shape:
            raise ValueError(f"a frame of {rgb_frame.shape} after one of {self._frame_shape}")
        everywhere = self._n_frames % self.search.scan_every == 0
        windows, scores = find_cars(
            rgb_frame, self.classifier, self.search, None if everywhere else self._warm_places
        )
        self._n_frames += 1
        return self.remember(windows[scores > self.search.threshold])

    def remember(self, hot_windows):
        """Add the hot windows of the next frame to the memory, and see what lasts.

        Parameters
        ----------
        hot_windows : ndarray of int, shape (n, 4)
            In pixels of the frame.

        Returns
        -------
        detections : Detections
        """
        heatmap = add_heat(self._grid.zeros(), self._grid.to_cells(hot_windows))
        self._heatmaps.append(heatmap)
        lasting = keep_lasting_heat(np.array(self._heatmaps), self.heat_filter.n_occ_thr)
        filtered = apply_threshold(lasting, self.heat_filter.threshold)
        cells, scores = find_blobs(filtered)
        self._warm_places = self._grid.to_pixels(find_blobs(heatmap + filtered)[0])
        boxes = self._grid.to_pixels(cells)
        ids = self._tracker.update(boxes)
        return Detections(hot_windows, heatmap, filtered, self._grid, boxes, scores, ids)

    def draw(self, rgb_frame, detections):
        """Vehicles on the frame, then undistortion if there is a calibration."""
        return self.undistort(draw_vehicles(rgb_frame, detections.boxes, detections.ids))

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

    def draw_split_screen(self, rgb_frame, detections):
        """The four of `step_pictures` in one picture as large as the frame.

        Returns
        -------
        picture : ndarray of uint8, shape (rows, columns, 3)
        """
        rows, columns = rgb_frame.shape[:2]
        picture = np.zeros_like(rgb_frame)
        quarter = columns // 2, rows // 2
        titles = ["hot windows", "heat of this frame", "heat that lasts", "vehicles"]
        for i, step in enumerate(self.step_pictures(rgb_frame, detections)):
            tile = draw_title(cv2.resize(step, quarter, interpolation=cv2.INTER_AREA), titles[i])
            top, left = i // 2 * quarter[1], i % 2 * quarter[0]
            picture[top : top + quarter[1], left : left + quarter[0]] = tile
        return picture

    def undistort(self, rgb_frame):
        """The frame as a pinhole camera would see it; as it is without calibration."""
        if self.calibration is None:
            return rgb_frame
        if rgb_frame.shape not in self._maps:
            self._maps[rgb_frame.shape] = self.calibration.maps(rgb_frame.shape)
        return cv2.remap(rgb_frame, *self._maps[rgb_frame.shape], cv2.INTER_LINEAR)


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


def draw_title(img, title):
    """The image with a line of text at its top left."""
    size = img.shape[0] / 500
    place = round(20 * size), round(30 * size)
    for color, shift in (((0, 0, 0), 1), ((255, 255, 255), 0)):
        where = place[0] + shift, place[1] + shift
        img = cv2.putText(img, title, where, cv2.FONT_HERSHEY_SIMPLEX, size, color, 1, cv2.LINE_AA)
    return img
