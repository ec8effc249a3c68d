"""The two-stage detector with a memory: frames in, vehicles out.

proposals and known vehicles -> a closer look -> the road -> tracks -> vehicles
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline_functions import draw_boxes, draw_vehicles
from vehicle_detection.media.viewer import Viewer
from vehicle_detection.tracking.tracker import Tracker, TrackParams, pairwise_iou
from vehicle_detection.two_stage.detector import (
    DEFAULT_SCAN,
    ScanParams,
    are_plausible,
    are_rivals,
    keep_wholes,
    level_groups,
    load_detector,
    look_closer,
    margins_outside,
    move_edges,
    near_horizon,
    propose,
)
from vehicle_detection.two_stage.road import fit_road, lowness, stand_on_road, usual_road

DEFAULT_TRACKS = TrackParams(
    min_iou=0.2, max_growth=1.4, reach=0.25, max_missed=75,
    measurement_noise=0.1, process_noise=0.01, kept_velocity=0.8,
    birth=2.0, most_evidence=8.0, neutral_score=0.35, miss_cost=0.9,
)  # fmt: skip
# A still is searched at all scales at once, and has no other frame to agree with.
STILL_SCAN = ScanParams(cells_per_step=1, n_groups=1, n_proposals=12)
STILL_TRACKS = TrackParams(birth=0.5)

# A proposal that overlaps a known vehicle this much shows nothing else.
_SAME_IOU = 0.6
# What was last seen of a vehicle was often framed together with what hid it: it is
# looked for at three quarters of the size too.
_SMALLER = np.array([1, 1, -1, -1]) / 8
# Where two boxes are rivals, the one that goes on with a track is believed more.
_TRUST_IN_TRACKS = 0.5
# Only vehicles tell where the road is, and they do so from some twenty boxes on.
_ENOUGH_SEEN, _MOST_SEEN = 20, 500
# What a box's score loses for being lower than a car where it stands.
_COST_OF_LOWNESS = 3


@dataclass(frozen=True)
class Detections:
    """What was found in one frame, step by step.

    Attributes
    ----------
    proposals : ndarray of float, shape (n, 4)
        Windows of the first stage, in pixels of the frame as read, like all boxes.
    candidates : ndarray of float, shape (m, 4)
        Where the closer look has moved the tracks of the frame before, vehicles
        out of sight, and the proposals that are not near a track; without what is
        implausible or part of a better one.
    candidate_scores, candidate_evidence : ndarray of float, shape (m,)
        Decision function of each, less what it costs to be lower than a car where
        it stands; evidence of the track it belongs to, 0 for none.
    boxes : ndarray of int, shape (k, 4)
    scores : ndarray of float, shape (k,)
        As of the candidates; 0 for a vehicle that has no box in this frame, and is
        shown where it is expected.
    ids : ndarray of int, shape (k,)
        Identity of each vehicle, from 1, the same in every frame.
    """

    proposals: np.ndarray
    candidates: np.ndarray
    candidate_scores: np.ndarray
    candidate_evidence: np.ndarray
    boxes: np.ndarray
    scores: np.ndarray
    ids: np.ndarray


class Vehicle(Viewer):
    """Finds vehicles in the frames of one video, handed over in order.

    Frames are searched as the camera gave them. A calibration straightens
    only the picture that is drawn: undistorting before the search would cut
    off vehicles that enter at the border.

    Parameters
    ----------
    path_calib : path or None
        Calibration of `calibrate.py`; None draws on the frame as it is.
    path_param : path
        Detector of `train_detector.py`.
    scan : ScanParams
    track_params : TrackParams
        How candidates of one frame go on with those of the frames before, and
        how much evidence makes a vehicle of them.
    """

    titles = ("windows of the first stage", "moved and scored", "evidence", "vehicles")

    def __init__(
        self,
        path_calib=None,
        path_param="param/detector.npz",
        scan=DEFAULT_SCAN,
        track_params=DEFAULT_TRACKS,
    ):
        super().__init__(path_calib)
        self.scan = scan
        self.track_params = track_params
        self.load_param_detect(path_param)

    def load_param_detect(self, path):
        """Read a detector, see `detector.load_detector`; forgets all frames."""
        self.detector = load_detector(path)
        self.reset()

    def reset(self):
        """Forget all frames: the next one begins another video."""
        super().reset()
        self._tracker = Tracker(self.track_params)
        # Boxes of whole cars of late: they tell where the road is.
        self._seen = np.empty((0, 4))

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
            The frame is of another size than the one before, or too small.
        """
        self._require_same_size(rgb_frame)
        road = fit_road(self._seen) if len(self._seen) > _ENOUGH_SEEN else None
        proposals = self._propose(rgb_frame, road)
        self._n_frames += 1
        expected = self._on_frame(self._tracker.predict())
        absent = self._tracker.absent()
        absent = self._on_frame(np.concatenate([absent, move_edges(absent, _SMALLER)]))
        fresh = pairwise_iou(proposals, expected).max(axis=1, initial=0) < _SAME_IOU
        looked_at = np.concatenate([expected, absent, proposals[fresh]])
        boxes, scores = look_closer(rgb_frame, looked_at, self.detector)
        plausible = are_plausible(boxes, rgb_frame.shape, self.scan)
        plausible &= stand_on_road(boxes, road or usual_road(len(rgb_frame)), len(rgb_frame))
        if road is not None:
            # Of what the border cuts, only the bonnet may be in sight.
            whole = 1 - margins_outside(boxes, rgb_frame.shape).max(axis=1)
            scores = scores - _COST_OF_LOWNESS * whole * lowness(boxes, road, len(rgb_frame))
        trusted = scores + _TRUST_IN_TRACKS * (np.arange(len(boxes)) < len(expected))
        plausible = np.flatnonzero(plausible)
        kept = plausible[keep_wholes(boxes[plausible], trusted[plausible])]
        return self._follow(proposals, boxes[kept], scores[kept])

    def _on_frame(self, boxes):
        """Boxes cut at the frame's border, without those that cannot be vehicles there."""
        rows, columns = self._frame_shape[:2]
        # Truth ends where the frame ends, and so does what was learned from it.
        boxes = np.clip(boxes, 0, (columns, rows, columns, rows))
        return boxes[are_plausible(boxes, self._frame_shape, self.scan)]

    def _propose(self, rgb_frame, road):
        """Proposals of a group of levels, of all of them in the first frame."""
        scan = self.scan
        if self._n_frames == 0:
            scan = replace(scan, n_groups=1)
        if road is not None:
            scan = near_horizon(scan, road.horizon / len(rgb_frame), road.camera_to_car)
        groups = level_groups(rgb_frame.shape[:2], scan)
        levels = groups[self._n_frames % len(groups)]
        return propose(rgb_frame, levels, self.detector.templates, scan)[0]

    def _follow(self, proposals, candidates, scores):
        """Hand the candidates of a frame to the tracks; vehicles are those with evidence."""
        tracks = self._tracker.update(candidates, scores, self._frame_shape[1])
        evidence = np.array([track.evidence if track else 0 for track in tracks])
        shown = [i for i, track in enumerate(tracks) if track and track.is_shown]
        seen = np.array([tracks[i].box for i in shown]).reshape(-1, 4)
        bridged = [track for track in self._tracker.bridged() if self._may_be_at(track.box, seen)]
        vehicles = [tracks[i] for i in shown] + bridged
        vehicle_scores = np.concatenate([scores[shown], np.zeros(len(bridged))])
        rows, columns = self._frame_shape[:2]
        boxes = np.array([track.box for track in vehicles]).reshape(-1, 4)
        whole_cars = seen[are_whole_cars(seen, self._frame_shape)]
        self._seen = np.concatenate([self._seen, whole_cars])[-_MOST_SEEN:]
        boxes = np.clip(np.rint(boxes), 0, (columns, rows, columns, rows)).astype(int)
        ids = np.array([track.identity for track in vehicles], int)
        return Detections(proposals, candidates, scores, evidence, boxes, vehicle_scores, ids)

    def _may_be_at(self, box, seen):
        """Whether a vehicle without a box may be where it is expected, beside those seen."""
        plausible = are_plausible(box[None], self._frame_shape, self.scan)[0]
        return plausible and not are_rivals(box[None], seen).any()

    def step_pictures(self, rgb_frame, detections):
        """What `titles` name, each drawn on the frame.

        Returns
        -------
        pictures : list of four ndarray of uint8, shape (rows, columns, 3)
        """
        candidates, evidence = detections.candidates, detections.candidate_evidence
        followed = evidence > 0
        birth = self.track_params.birth
        pictures = [
            draw_boxes(rgb_frame, detections.proposals, thickness=2),
            draw_rated(rgb_frame, candidates, detections.candidate_scores, 0),
            draw_rated(rgb_frame, candidates[followed], evidence[followed], birth),
            draw_vehicles(rgb_frame, detections.boxes, detections.ids),
        ]
        return [self.undistort(picture) for picture in pictures]


def are_whole_cars(boxes, frame_shape):
    """Which vehicles tell where the road is: wider than high, and not cut by the border.

    Lorries and vans, as high as wide or higher, would be taken for nearer cars.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    frame_shape : (rows, columns, ...)

    Returns
    -------
    whole_cars : ndarray of bool, shape (n,)
    """
    width, height = (boxes[:, 2:] - boxes[:, :2]).T
    return (width > 1.1 * height) & (margins_outside(boxes, frame_shape) < 1).all(axis=1)


def draw_rated(img, boxes, values, threshold):
    """Boxes with a number each: green from the threshold on, red below.

    Parameters
    ----------
    img : ndarray of uint8, shape (rows, columns, 3)
        RGB.
    boxes : ndarray, shape (n, 4)
    values : ndarray of float, shape (n,)
    threshold : float
    """
    img = img.copy()
    font_scale = img.shape[0] / 900
    for (left, top, right, bottom), value in zip(boxes.round().astype(int), values, strict=True):
        color = (0, 200, 0) if value >= threshold else (255, 60, 60)
        cv2.rectangle(img, (left, top), (right - 1, bottom - 1), color, 2)
        place = left, max(top - 4, round(20 * font_scale))
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(img, f"{value:.1f}", place, font, font_scale, color, 2, cv2.LINE_AA)
    return img
