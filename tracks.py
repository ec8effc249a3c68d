"""Tracks: which box of this frame is which vehicle of the frames before.

boxes -> predictions -> assignment -> correction -> identities

Every vehicle has a Kalman filter of constant velocity. Its prediction is held
against the boxes of the frame; what matches corrects it, what does not match
begins a track of its own. A vehicle out of sight keeps its track, and so its
identity, for a while, but is not shown.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment


@dataclass(frozen=True)
class TrackParams:
    """How boxes become tracks.

    Attributes
    ----------
    min_iou : float
        A box may be a track's only if it overlaps the prediction this much.
    max_missed : int
        Frames that a track outlives without a box.
    measurement_noise, process_noise : float
        Standard deviations as shares of a vehicle's height: of a box's
        edges, and of the change of their velocity from frame to frame.
    """

    min_iou: float = 0.2
    max_missed: int = 50
    measurement_noise: float = 0.1
    process_noise: float = 0.01

    def __post_init__(self):
        if not 0 < self.min_iou < 1:
            raise ValueError(f"min_iou lies between 0 and 1, not at {self.min_iou}")
        if self.max_missed < 0:
            raise ValueError("max_missed starts at 0")
        if min(self.measurement_noise, self.process_noise) <= 0:
            raise ValueError("noise is above 0")


DEFAULT_TRACKS = TrackParams()


class Track:
    """One vehicle over time.

    Attributes
    ----------
    identity : int
    n_missed : int
        Frames since its last box.
    """

    def __init__(self, identity, box, params):
        self.identity = identity
        self.n_missed = 0
        height = box[3] - box[1]
        # State: four edges, then their velocities in pixels a frame.
        self._filter = cv2.KalmanFilter(8, 4, 0, cv2.CV_64F)
        self._filter.transitionMatrix = np.eye(8) + np.eye(8, k=4)
        self._filter.measurementMatrix = np.eye(4, 8)
        self._filter.measurementNoiseCov = np.eye(4) * (params.measurement_noise * height) ** 2
        drift = (params.process_noise * height) ** 2
        # White noise on the velocity over one frame moves the edge by half as much.
        self._filter.processNoiseCov = drift * np.kron([[0.25, 0.5], [0.5, 1.0]], np.eye(4))
        self._filter.errorCovPost = (
            np.diag([1.0] * 4 + [0.1] * 4) * (params.measurement_noise * height) ** 2
        )
        self._filter.statePost = np.concatenate([box, np.zeros(4)])[:, None].astype(float)

    def predict(self):
        """One frame on; returns the box expected there, ndarray of float, shape (4,)."""
        self.n_missed += 1
        return self._filter.predict()[:4, 0].copy()

    def correct(self, box):
        """Take in the box of this frame."""
        self.n_missed = 0
        self._filter.correct(np.asarray(box, float)[:, None])


def pairwise_overlap(boxes, others):
    """Intersection of every box with every other, in square pixels, shape (n, m)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    return np.clip(high - low, 0, None).prod(axis=2)


def pairwise_iou(boxes, others):
    """Intersection over union of every box with every other, shape (n, m)."""
    common = pairwise_overlap(boxes, others)
    areas, other_areas = (_areas(b) for b in (boxes, others))
    union = areas[:, None] + other_areas[None] - common
    return np.divide(common, union, out=np.zeros_like(common, float), where=union > 0)


def _areas(boxes):
    return (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)


class Tracker:
    """All tracks of one video.

    Parameters
    ----------
    params : TrackParams
    """

    def __init__(self, params):
        self.params = params
        self._tracks = []
        self._n_identities = 0

    def update(self, boxes):
        """Whose the boxes of the next frame are.

        Parameters
        ----------
        boxes : ndarray, shape (n, 4)

        Returns
        -------
        ids : ndarray of int, shape (n,)
            From 1, constant per vehicle, each at most once.
        """
        predictions = np.array([track.predict() for track in self._tracks]).reshape(-1, 4)
        owners = self._assign(boxes, predictions)
        for box, owner in zip(boxes, owners, strict=True):
            if owner.n_missed:
                owner.correct(box)
        self._tracks = [t for t in self._tracks if t.n_missed <= self.params.max_missed]
        return np.array([owner.identity for owner in owners], int)

    def _assign(self, boxes, predictions):
        """Track of every box, so that the overlap of all together is largest; new ones begin."""
        iou = pairwise_iou(boxes, predictions)
        gain = np.where(iou >= self.params.min_iou, iou, 0)
        pairs = zip(*linear_sum_assignment(gain, maximize=True), strict=True)
        known = {row: self._tracks[column] for row, column in pairs if gain[row, column] > 0}
        return [known.get(row) or self._begin(box) for row, box in enumerate(boxes)]

    def _begin(self, box):
        self._n_identities += 1
        self._tracks.append(Track(self._n_identities, box, self.params))
        return self._tracks[-1]
