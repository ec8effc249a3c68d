"""Tracks: which box of this frame is which vehicle of the frames before.

boxes -> predictions -> assignment -> correction -> identities

Every vehicle has a Kalman filter of constant velocity. Its prediction is held
against the boxes of the frame; what matches corrects it, boxes of low scores
less than others, and what does not match begins a track of its own. A vehicle
without a box is expected where it was for a while: what becomes a vehicle there
has its identity.
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
    max_growth : float
        A box that is more times as high as the prediction, or as many times
        lower, is not the track's but that of what hides it. The square of this
        decides whether what becomes a vehicle where another was is that one.
    reach : float
        Where vehicles out of sight are looked for, boxes and predictions are
        widened on each side by this share of their width: what comes out first
        is one side of a vehicle.
    max_missed : int
        Frames that a track outlives without a box. Those in which a nearer
        vehicle hides it count a fifth: overtaking can take long.
    measurement_noise, process_noise : float
        Standard deviations as shares of a vehicle's height: of the edges of a
        box whose score is 1 or more, and of the change of their velocity from frame
        to frame.
    kept_velocity : float
        Share of its velocity that a vehicle keeps from frame to frame when it is
        out of sight, or its box has no positive score: what its box did last
        was mostly to shrink behind what hides it.
    birth : float
        Evidence, the sum of a track's scores, each less `neutral_score`, that makes it a vehicle.
    most_evidence : float
        No track gathers more, so that what has gone is soon let go.
    neutral_score : float
        Score of a box that neither adds to the evidence nor takes from it: what was
        taken for a vehicle and is none goes on scoring little more than 0.
    miss_cost : float
        Evidence that a frame without a box takes away; less by the share that a nearer
        vehicle covers of where it is expected, if some of it should be in sight.
    """

    min_iou: float = 0.2
    max_growth: float = np.inf
    reach: float = 0.0
    max_missed: int = 50
    measurement_noise: float = 0.1
    process_noise: float = 0.01
    kept_velocity: float = 1.0
    birth: float = 0.0
    most_evidence: float = 1.0
    neutral_score: float = 0.0
    miss_cost: float = 1.0

    def __post_init__(self):
        if not 0 < self.min_iou < 1:
            raise ValueError(f"min_iou lies between 0 and 1, not at {self.min_iou}")
        if self.max_growth <= 1 or self.reach < 0:
            raise ValueError("max_growth is above 1, and reach starts at 0")
        if self.max_missed < 0:
            raise ValueError("max_missed starts at 0")
        if min(self.measurement_noise, self.process_noise) <= 0:
            raise ValueError("noise is above 0")
        if not 0 <= self.kept_velocity <= 1:
            raise ValueError(f"kept_velocity lies between 0 and 1, not at {self.kept_velocity}")
        if not 0 <= self.birth <= self.most_evidence:
            raise ValueError(f"birth {self.birth} lies outside 0..{self.most_evidence}")
        if self.miss_cost <= 0 or self.neutral_score < 0:
            raise ValueError("miss_cost is above 0, and neutral_score starts at 0")


# Boxes that come from heat have lasted already.
HEAT_TRACKS = TrackParams()

# A vehicle ends at the frame's side if it does within this share of its width.
_AT_SIDE = 1 / 8
# Share by which a box of a score of 1 or more, in clear sight then, corrects how
# wide a vehicle is taken to be.
_NEW_WIDTH = 0.1
# Of the overlap with a track that had no box in the frame before: where it is, is less sure.
_WEIGHT_IF_MISSED = 0.5
# A vehicle without a box is hidden if a nearer one covers this share of where it
# is expected; of so many such frames each counts for one.
_HIDDEN, _HIDDEN_FRAMES = 0.5, 5
# Covered by more than this it is out of sight, or a second track of what covers it: it is
# let go of as fast as what nothing hides.
_OUT_OF_SIGHT = 0.7


class Track:
    """One vehicle, or what may become one, over time.

    Attributes
    ----------
    identity : int
        From 1; 0 until there was evidence enough.
    is_shown : bool
        There is evidence enough, now.
    evidence : float
    n_missed : int
        Frames since its last box.
    n_hidden : int
        Those of them in which a nearer vehicle hid it.
    box : ndarray of float, shape (4,)
        Where it is, or is expected in this frame.
    """

    def __init__(self, box, score, params):
        self.identity = 0
        self.is_shown = False
        self.evidence = 0.0
        self.n_missed = 0
        self.n_hidden = 0
        self.box = np.asarray(box, float)
        self._params = params
        height = box[3] - box[1]
        variance = (params.measurement_noise * height) ** 2
        self._measurement_noise = variance * np.eye(4)
        # State: four edges, then their velocities in pixels a frame.
        self._filter = cv2.KalmanFilter(8, 4, 0, cv2.CV_64F)
        self._filter.transitionMatrix = np.eye(8) + np.eye(8, k=4)
        self._filter.measurementMatrix = np.eye(4, 8)
        drift = (params.process_noise * height) ** 2
        # White noise on the velocity over one frame moves the edge by half as much.
        self._filter.processNoiseCov = drift * np.kron([[0.25, 0.5], [0.5, 1.0]], np.eye(4))
        self._filter.errorCovPost = variance * np.diag([1.0] * 4 + [0.1] * 4)
        self._filter.statePost = np.concatenate([box, np.zeros(4)])[:, None].astype(float)
        self._width = box[2] - box[0]
        self._weigh(score - self._params.neutral_score)

    def predict(self):
        """One frame on: `box` is where the vehicle is expected."""
        self.n_missed += 1
        self.box = self._filter.predict()[:4, 0].copy()

    def correct(self, box, score):
        """Take in the box of this frame, and what it says.

        The edges of a box that hardly looks like a vehicle are those of
        something else, most often of what hides it. Without a positive score
        they are left alone, and `box` stays what was expected.
        """
        self.n_missed = self.n_hidden = 0
        if score > 0:
            doubt = np.exp(max(0.0, 1 - score))
            self._filter.measurementNoiseCov = doubt * self._measurement_noise
            self.box = self._filter.correct(np.asarray(box, float)[:, None])[:4, 0].copy()
        else:
            self._slow_down()
        if score >= 1:
            self._width += _NEW_WIDTH * (self.box[2] - self.box[0] - self._width)
        self._weigh(score - self._params.neutral_score)

    def miss(self, others):
        """There is no box in this frame; `others`, shape (n, 4), are vehicles that have one."""
        nearer = others[others[:, 3] > self.box[3]]
        area = max(box_areas(self.box[None])[0], 1e-9)
        covered = pairwise_overlap(self.box[None], nearer).max(initial=0) / area
        self.n_hidden += covered > _HIDDEN
        self._slow_down()
        in_sight = 1 - covered if covered < _OUT_OF_SIGHT else 1
        self._weigh(-self._params.miss_cost * in_sight)
        if self.identity and not self.is_shown:
            self._widen_behind(nearer)

    def _widen_behind(self, nearer):
        """Out of sight, it is as wide again as in clear sight, on the side that is hidden.

        What was seen last was the part that a nearer vehicle left in sight. Where
        one covers both sides alike, or neither, nothing is known.
        """
        left, top, right, bottom = self.box
        hidden = max(0.0, self._width - (right - left))
        sides = np.array([[left - hidden, top, left, bottom], [right, top, right + hidden, bottom]])
        covered = pairwise_overlap(sides, nearer).max(axis=1, initial=0)
        if not np.isclose(*covered):
            edge, widening = (0, -hidden) if covered[0] > covered[1] else (2, hidden)
            state = self._filter.statePost.copy()
            state[edge] += widening
            self._filter.statePost = state
            self.box[edge] += widening

    def is_leaving(self, n_columns):
        """Whether it ends at the left or right of the frame, and was not just coming in there."""
        left, _, right, _ = self.box
        near = _AT_SIDE * (right - left)
        left_speed, _, right_speed, _ = self._filter.statePost[4:, 0]
        # The other edge lies where the frame ends, not where the vehicle does.
        at_left = left < near and right_speed <= 0
        at_right = right > n_columns - near and left_speed >= 0
        return at_left or at_right

    def _slow_down(self):
        state = self._filter.statePost.copy()
        state[4:] *= self._params.kept_velocity
        self._filter.statePost = state

    def _weigh(self, evidence):
        self.evidence = min(self.evidence + evidence, self._params.most_evidence)
        if self.evidence < 0:
            self.is_shown = False
            self.evidence = 0.0
        elif self.evidence >= self._params.birth:
            self.is_shown = True


def pairwise_overlap(boxes, others):
    """Intersection of every box with every other, in square pixels, shape (n, m)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    return np.clip(high - low, 0, None).prod(axis=2)


def pairwise_iou(boxes, others):
    """Intersection over union of every box with every other, shape (n, m)."""
    common = pairwise_overlap(boxes, others)
    areas, other_areas = (box_areas(b) for b in (boxes, others))
    union = areas[:, None] + other_areas[None] - common
    return np.divide(common, union, out=np.zeros_like(common, float), where=union > 0)


def box_areas(boxes):
    """Areas of boxes, shape (n,)."""
    return (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)


def _widened(boxes, share):
    """Boxes with a share of their width added on each side."""
    aside = share * (boxes[:, 2] - boxes[:, 0])
    return boxes + aside[:, None] * (-1, 0, 1, 0)


class Tracker:
    """All tracks of one video: `predict`, then `update`, frame by frame.

    Parameters
    ----------
    params : TrackParams
    """

    def __init__(self, params):
        self.params = params
        self._tracks = []
        self._n_identities = 0

    def predict(self):
        """Move all tracks one frame on.

        Returns
        -------
        boxes : ndarray of float, shape (n, 4)
            Where those are expected that had a box in the frame before.
        """
        for track in self._tracks:
            track.predict()
        followed = [track.box for track in self._tracks if track.n_missed == 1]
        return np.array(followed).reshape(-1, 4)

    def absent(self):
        """After `predict`: where vehicles are expected that had no box before, shape (n, 4)."""
        absent = [track.box for track in self._tracks if track.identity and track.n_missed > 1]
        return np.array(absent).reshape(-1, 4)

    def update(self, boxes, scores, n_columns=None):
        """Whose the boxes of this frame are.

        Parameters
        ----------
        boxes : ndarray, shape (n, 4)
        scores : ndarray, shape (n,)
            Positive for vehicles.
        n_columns : int, optional
            Of the frame. A vehicle that went out of sight at its side has left.

        Returns
        -------
        tracks : list of Track or None
            The track of each box, each at most once; None for a box of no
            track that does not begin one, for its score is not positive.
        """
        owners = self._assign(boxes)
        for i, (box, score) in enumerate(zip(boxes, scores, strict=True)):
            if score <= 0 and owners[i] is not None and not owners[i].is_shown:
                # Ground where something has looked like a vehicle before.
                owners[i] = None
            elif owners[i] is not None:
                owners[i].correct(box, score)
            elif score > 0:
                owners[i] = Track(box, float(score), self.params)
                self._tracks.append(owners[i])
        seen = [track.box for track in self._tracks if track.is_shown and not track.n_missed]
        seen = np.array(seen).reshape(-1, 4)
        for track in self._tracks:
            if track.n_missed:
                track.miss(seen)
        self._identify([t for t in self._tracks if t.is_shown and not t.identity])
        self._tracks = [track for track in self._tracks if self._is_kept(track, n_columns)]
        return owners

    def bridged(self):
        """Tracks of vehicles that have no box in this frame, but evidence left."""
        return [track for track in self._tracks if track.is_shown and track.n_missed]

    def _assign(self, boxes):
        """Known track of every box or None.

        Vehicles choose before what is not yet one; among each, so that the
        overlap of all together is largest, where that with a track that had no
        box in the frame before counts less. Vehicles long out of sight do not
        choose: where they are expected, anything may lie.
        """
        owners = [None] * len(boxes)
        choosing = [track for track in self._tracks if track.is_shown or not track.identity]
        for are_vehicles in (True, False):
            tracks = [track for track in choosing if (track.identity > 0) == are_vehicles]
            free = [i for i, owner in enumerate(owners) if owner is None]
            were_missed = [track.n_missed > 1 for track in tracks]
            gain = self._gain(boxes[free], tracks, were_missed, self.params.max_growth)
            gain *= np.where(were_missed, _WEIGHT_IF_MISSED, 1)
            for row, column in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
                if gain[row, column] > 0:
                    owners[free[row]] = tracks[column]
        return owners

    def _identify(self, vehicles):
        """Give what has become a vehicle the identity of one without a box there, or a new one."""
        absent = [track for track in self._tracks if track.identity and track.n_missed]
        boxes = np.array([track.box for track in vehicles]).reshape(-1, 4)
        # Of a vehicle that comes out again, little can be seen at first.
        limit = self.params.max_growth**2
        gain = self._gain(boxes, absent, [not track.is_shown for track in absent], limit)
        for row, column in zip(*linear_sum_assignment(gain, maximize=True), strict=True):
            if gain[row, column] > 0:
                vehicles[row].identity = absent[column].identity
                self._tracks.remove(absent[column])
        for vehicle in vehicles:
            if not vehicle.identity:
                self._n_identities += 1
                vehicle.identity = self._n_identities

    def _gain(self, boxes, tracks, are_out_of_sight, max_growth):
        """IoU of every box with every prediction, 0 where it is not the track's; shape (n, m)."""
        if not len(boxes) or not tracks:
            return np.zeros((len(boxes), len(tracks)))
        expected = np.array([track.box for track in tracks])
        heights, own_heights = (b[:, 3] - b[:, 1] for b in (boxes, expected))
        growth = heights[:, None] / np.maximum(own_heights, 1e-9)
        iou = pairwise_iou(boxes, expected)
        if any(are_out_of_sight):
            wide, expected_wide = (_widened(b, self.params.reach) for b in (boxes, expected))
            iou = np.where(are_out_of_sight, pairwise_iou(wide, expected_wide), iou)
        alike = np.maximum(growth, 1 / np.maximum(growth, 1e-9)) <= max_growth
        return np.where(alike & (iou >= self.params.min_iou), iou, 0)

    def _is_kept(self, track, n_columns):
        """What was a vehicle may come back for a while, unless it left at a side of the frame.

        What never was one must go on growing.
        """
        if not track.identity:
            return track.evidence > 0
        if not track.is_shown and n_columns is not None and track.is_leaving(n_columns):
            return False
        n_absent = track.n_missed - track.n_hidden
        return n_absent + track.n_hidden / _HIDDEN_FRAMES <= self.params.max_missed
