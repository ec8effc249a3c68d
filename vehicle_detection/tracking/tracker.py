"""The tracker: which box of this frame is which vehicle of the frames before.

Every track has a Kalman filter of constant velocity. Scores accumulate: a track is confirmed as
a vehicle once their sum is high enough, and is lost when it is used up.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from scipy.optimize import linear_sum_assignment

from vehicle_detection.tracking.boxes import pairwise_iou, stack_boxes

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrackParams


class Track:
    """One vehicle, or what may become one, over time.

    Attributes
    ----------
    identity : int
        From 1, given once the track is confirmed as a vehicle; 0 until then.
    score : float
        Accumulated score, at most `TrackParams.max_score`; a track without any is lost.
    box : ndarray of float, shape (4,)
        Where it is, or is expected in this frame.
    """

    def __init__(self, box: np.ndarray, score: float, params: Any):
        self.identity = 0
        self.score = 0.0
        self.box = np.asarray(box, float)
        self._params = params
        self._filter = _kalman_filter(self.box, params)
        self._accumulate(score)

    @property
    def is_confirmed(self) -> bool:
        """It is a vehicle, and not lost."""
        return self.identity > 0 and self.score > 0

    def predict(self) -> None:
        """One frame on: `box` is where the vehicle is expected."""
        self.box = self._filter.predict()[:4, 0].copy()

    def correct(self, box: np.ndarray, score: float) -> None:
        """Take in the box of this frame."""
        self.box = self._filter.correct(np.asarray(box, float)[:, None])[:4, 0].copy()
        self._accumulate(score)

    def miss(self) -> None:
        """There is no box in this frame."""
        self._accumulate(0)

    def _accumulate(self, score):
        self.score = min(self.score + score - self._params.score_offset, self._params.max_score)


def _kalman_filter(box, params):
    """Filter of four edges and their velocities in pixels a frame.

    The measurement noise is 1: only the ratio to the process noise counts.
    """
    kalman = cv2.KalmanFilter(8, 4, 0, cv2.CV_64F)
    kalman.transitionMatrix = np.eye(8) + np.eye(8, k=4)
    kalman.measurementMatrix = np.eye(4, 8)
    kalman.measurementNoiseCov = np.eye(4)
    # White noise on the velocity over one frame moves the edge by half as much.
    kalman.processNoiseCov = params.process_noise**2 * np.kron([[0.25, 0.5], [0.5, 1.0]], np.eye(4))
    kalman.errorCovPost = np.kron(np.diag([1.0, 0.1]), np.eye(4))
    kalman.statePost = np.concatenate([box, np.zeros(4)])[:, None].astype(float)
    return kalman


class Tracker:
    """All tracks of one video: `predict`, then `update`, frame by frame.

    Parameters
    ----------
    params : TrackParams
    """

    def __init__(self, params: TrackParams):
        self.params = params
        self._tracks = []
        self._n_identities = 0

    def predict(self) -> np.ndarray:
        """Move all tracks one frame on.

        Returns
        -------
        boxes : ndarray of float, shape (n, 4)
            Where they are expected.
        """
        for track in self._tracks:
            track.predict()
        return stack_boxes([track.box for track in self._tracks])

    def update(self, boxes: np.ndarray, scores: np.ndarray) -> list:
        """Give the boxes of this frame to the tracks.

        Parameters
        ----------
        boxes : ndarray, shape (n, 4)
        scores : ndarray, shape (n,)
            Positive for vehicles.

        Returns
        -------
        tracks : list of Track or None
            The track of each box, each at most once; None for a box that belongs to no track
            and starts none, because its score is not above `score_offset`.
        """
        owners = self._assign(boxes)
        for track in set(self._tracks).difference(owners):
            track.miss()
        for i, (box, score) in enumerate(zip(boxes, scores, strict=True)):
            if owners[i] is not None:
                owners[i].correct(box, score)
            elif score > self.params.score_offset:
                owners[i] = Track(box, float(score), self.params)
                self._tracks.append(owners[i])
        self._tracks = [track for track in self._tracks if track.score > 0]
        for track in self._tracks:
            if not track.identity and track.score >= self.params.confirm_at:
                self._n_identities += 1
                track.identity = self._n_identities
        return owners

    def _assign(self, boxes):
        """The track of every box, or None: all together so that the sum of IoU is largest."""
        owners = [None] * len(boxes)
        expected = stack_boxes([track.box for track in self._tracks])
        iou = pairwise_iou(boxes, expected)
        iou[iou < self.params.min_iou] = 0
        for row, column in zip(*linear_sum_assignment(iou, maximize=True), strict=True):
            if iou[row, column] > 0:
                owners[row] = self._tracks[column]
        return owners
