"""`TwoStageVehicle`: the two-stage detector over a video, frames in, vehicles out.

predictions of tracks, proposals -> refinement -> selection -> tracks -> vehicles
"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vehicle_detection.media.drawing import draw_boxes, draw_rated, draw_vehicles
from vehicle_detection.media.viewer import Viewer, require_frame
from vehicle_detection.parameters import VIDEO_PARAMS, TwoStageParams
from vehicle_detection.tracking.boxes import clip_to_frame, stack_boxes, touches_border
from vehicle_detection.tracking.tracker import Tracker
from vehicle_detection.two_stage.distance import distances
from vehicle_detection.two_stage.model import load_detector
from vehicle_detection.two_stage.proposals import level_groups, propose
from vehicle_detection.two_stage.refinement import Candidates, refine
from vehicle_detection.two_stage.road import RoadMemory, misplacement, reach
from vehicle_detection.two_stage.selection import non_max_suppression, overlap_conflicts

SHIPPED_DETECTOR = Path(__file__).parents[2] / "param/detector.npz"


@dataclass(frozen=True)
class Detections:
    """What was found in one frame, step by step.

    Attributes
    ----------
    proposals : ndarray of float, shape (n, 4)
        Windows of the first stage, moved, in pixels of the frame as read, like all boxes.
    candidates : ndarray of float, shape (m, 4)
        Refined predictions and proposals that passed the selection.
    candidate_scores : ndarray of float, shape (m,)
        Decision function of each, less what it loses on the road, see `road.misplacement`.
    track_scores : ndarray of float, shape (m,)
        Accumulated score of the track of each candidate, 0 for none, 0 or less for a lost one.
    boxes : ndarray of int, shape (k, 4)
        Vehicles.
    scores : ndarray of float, shape (k,)
        As of the candidates.
    ids : ndarray of int, shape (k,)
        Identity of each vehicle, from 1, the same in every frame.
    distances : ndarray of float, shape (k,), or None
        Metres to each, see `distance.distances`; None without calibration.
    """

    proposals: np.ndarray
    candidates: np.ndarray
    candidate_scores: np.ndarray
    track_scores: np.ndarray
    boxes: np.ndarray
    scores: np.ndarray
    ids: np.ndarray
    distances: np.ndarray | None = None


class TwoStageVehicle(Viewer):
    """Finds vehicles in the frames of one video, handed over in order.

    Frames are searched as the camera gave them. A calibration straightens only the picture
    that is drawn: undistorting before would cut off vehicles that enter at the border.

    Parameters
    ----------
    path_calib : path or None
        Calibration file; None draws on the frame as it is.
    path_param : path or Detector
        File of `two_stage.training`, or what it holds.
    params : TwoStageParams
        `VIDEO_PARAMS`, or `STILL_PARAMS` for pictures on their own.
    """

    titles = ("proposals", "refined, with scores", "accumulated scores", "vehicles")

    def __init__(
        self,
        path_calib: str | os.PathLike | None = None,
        path_param: Any = SHIPPED_DETECTOR,
        params: TwoStageParams = VIDEO_PARAMS,
    ):
        super().__init__(path_calib)
        self.params = params
        self.load_param_detect(path_param)

    def load_param_detect(self, path: str | os.PathLike) -> None:
        """Take a detector, or the path of one; forgets all frames."""
        self.detector: Any = path if hasattr(path, "machine") else load_detector(path)
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next one begins another video."""
        self._frame_shape: tuple | None = None
        self._n_frames = 0
        self._tracker = Tracker(self.params.tracks)
        self._memory = RoadMemory(self.params.road)

    def settings(self) -> dict:
        """Parameters by name, for a report."""
        return asdict(self.params)

    def detect(self, rgb_frame: np.ndarray) -> Detections:
        """Search the next frame of the video.

        Parameters
        ----------
        rgb_frame : ndarray of uint8, shape (rows, columns, 3)
            RGB.

        Returns
        -------
        detections : Detections

        Raises
        ------
        ValueError
            The frame is of another size than the one before, or too small for any window.
        """
        require_frame(rgb_frame, self._frame_shape)
        self._frame_shape = rgb_frame.shape
        road = self._memory.road(len(rgb_frame))
        levels = self._next_levels(road)
        proposals, _ = propose(rgb_frame, levels, self.detector.templates, self.params.scan)
        predicted = self._predicted()
        boxes = np.concatenate([predicted, proposals])
        refined = refine(rgb_frame, boxes, self.detector, len(predicted), self.params.mirrored)
        candidates = self._select(refined, road)
        tracks = self._tracker.update(candidates.boxes, candidates.scores)
        confirmed = [i for i, track in enumerate(tracks) if track and track.is_confirmed]
        vehicles = stack_boxes([tracks[i].box for i in confirmed])
        self._memory.learn(vehicles[self._are_whole_cars(vehicles)])
        return self._detections(proposals, candidates, tracks, confirmed)

    def _next_levels(self, road):
        """A group of levels in turn; all of them in the first frame."""
        rows, columns = self._frame_shape[:2]
        scan = self.params.scan if self._n_frames else replace(self.params.scan, n_groups=1)
        where = reach(road, rows, self.params.road)
        groups = level_groups((rows, columns), scan, where)
        self._n_frames += 1
        return groups[(self._n_frames - 1) % len(groups)]

    def _predicted(self):
        """Predictions of the tracks, cut at the border of the frame like the truth."""
        boxes = clip_to_frame(self._tracker.predict(), self._frame_shape)
        # What has left the frame is no box any more, nor what shrank to nothing.
        return boxes[(boxes[:, 2:] - boxes[:, :2] >= 1).all(axis=1)]

    def _select(self, candidates, road):
        """The candidates that are in conflict with no better one.

        Selected twice: what remains at first tells where the road is.
        """
        boxes = candidates.boxes
        conflicts = overlap_conflicts(boxes, self.params.selection)
        scores = self._penalised(candidates, road)
        kept = non_max_suppression(conflicts, scores)
        whole = kept[self._are_whole_cars(boxes[kept])]
        weights = np.clip(scores[whole] - self.params.tracks.score_offset, 0, 1)
        road = self._memory.road(self._frame_shape[0], boxes[whole], weights)
        scores = self._penalised(candidates, road)
        kept = non_max_suppression(conflicts, scores)
        return Candidates(boxes[kept], scores[kept])

    def _penalised(self, candidates, road):
        """Scores of candidates, less where no vehicle can stand."""
        boxes, params = candidates.boxes, self.params.road
        cost = params.cost * misplacement(boxes, road, params) ** 2 / 2
        # A vehicle that the lower border cuts stands lower than it seems to.
        return candidates.scores - cost * ~touches_border(boxes, self._frame_shape)[:, 3]

    def _are_whole_cars(self, boxes):
        """Which boxes tell where the road is."""
        width, height = (boxes[:, 2:] - boxes[:, :2]).T
        cut = touches_border(boxes, self._frame_shape).any(axis=1)
        return ~cut & (width > self.params.selection.whole_car_aspect * height)

    def _detections(self, proposals, candidates, tracks, confirmed):
        """Vehicles are the confirmed tracks that have a box in this frame."""
        boxes = stack_boxes([tracks[i].box for i in confirmed])
        boxes = clip_to_frame(boxes, self._frame_shape)
        return Detections(
            proposals,
            candidates.boxes,
            candidates.scores,
            track_scores=np.array([track.score if track else 0 for track in tracks]),
            boxes=np.rint(boxes).astype(int),
            scores=candidates.scores[confirmed],
            ids=np.array([tracks[i].identity for i in confirmed], int),
            distances=self._distances(boxes),
        )

    def _distances(self, boxes):
        """Metres to boxes; None without calibration, which knows the focal length."""
        if self.calibration is None:
            return None
        rows, columns = self._frame_shape[:2]
        focal = self.calibration.mtx[1, 1] * columns / self.calibration.image_size[0]
        metres = distances(boxes, self._memory.road(rows), focal, self.params.distance)
        # What the lower border cuts stands lower than it seems to.
        return np.where(touches_border(boxes, self._frame_shape)[:, 3], np.nan, metres)

    def step_pictures(self, rgb_frame: np.ndarray, detections: Any) -> list:
        """What `titles` name, each drawn on the frame.

        Returns
        -------
        pictures : list of four ndarray of uint8, shape (rows, columns, 3)
        """
        candidates, scores = detections.candidates, detections.track_scores
        tracked = scores > 0
        confirm_at = self.params.tracks.confirm_at
        pictures = [
            draw_boxes(rgb_frame, detections.proposals, thickness=2),
            draw_rated(rgb_frame, candidates, detections.candidate_scores, 0),
            draw_rated(rgb_frame, candidates[tracked], scores[tracked], confirm_at),
            draw_vehicles(rgb_frame, detections.boxes, detections.ids),
        ]
        return [self.undistort(picture) for picture in pictures]
