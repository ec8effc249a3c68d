"""The road, as vehicles tell it: where it vanishes, and how high vehicles are on it.

On a flat road the bottom of a vehicle lies below the horizon by its height in pixels times
h / H, h being the height of the camera and H that of the vehicle, both in metres [1]_. What is
known of horizon and h / H is a Gaussian: a wide one before any vehicle has been seen, a narrow
one after some. Boxes that stand where no vehicle can lose score by how sure that is.

References
----------
.. [1] D. Hoiem, A. Efros and M. Hebert, "Putting Objects in Perspective", CVPR 2006.
.. [2] C. Bishop, "Pattern Recognition and Machine Learning", 2006, section 3.3 (Bayesian
       linear regression).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vehicle_detection.tracking.boxes import box_heights

if TYPE_CHECKING:
    from vehicle_detection.parameters import RoadParams


@dataclass(frozen=True)
class Road:
    """What is known of the road and the camera: a Gaussian.

    Attributes
    ----------
    mean : ndarray of float, shape (2,)
        Row in which the road vanishes; height of the camera by that of a car.
    covariance : ndarray of float, shape (2, 2)
    """

    mean: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True)
class Reach:
    """Where vehicles can stand, given what is known of the road.

    Attributes
    ----------
    horizon : (float, float)
        First and last row in which the road may vanish.
    ratio : (float, float)
        Least and largest distance of a vehicle's bottom from the horizon by its height.
    """

    horizon: tuple
    ratio: tuple


def prior_road(n_rows: int, params: Any) -> Road:
    """What is known of the road in frames of `n_rows` before any vehicle has been seen."""
    scale = np.array([n_rows, 1.0])
    mean, std = zip(params.horizon, params.camera_to_car, strict=True)
    return Road(scale * mean, np.diag((scale * std) ** 2))


def reach(road: Road, n_rows: int, params: RoadParams) -> Reach:
    """Where to scan for vehicles: all but the least likely places.

    Parameters
    ----------
    road : Road
    n_rows : int
        Of the frame.
    params : RoadParams

    Returns
    -------
    reach : Reach
    """
    std = np.sqrt(np.diag(road.covariance))
    low, high = road.mean - params.n_std * std, road.mean + params.n_std * std
    horizon = np.clip([low[0], high[0]], 0, n_rows)
    ratio = np.maximum([low[1] / params.lorry_to_car, high[1]], 0)
    return Reach(tuple(horizon.tolist()), tuple(ratio.tolist()))


def update_road(n_rows: int, boxes: np.ndarray, weights: np.ndarray, params: RoadParams) -> Road:
    """What is known after some cars have been seen, by Bayesian linear regression [2]_.

    Parameters
    ----------
    n_rows : int
        Of the frame.
    boxes : ndarray of float, shape (n, 4)
        Whole cars, of some height.
    weights : ndarray of float, shape (n,)
        How sure it is that each is a car, from 0 to 1.
    params : RoadParams

    Returns
    -------
    road : Road
    """
    prior = prior_road(n_rows, params)
    if not len(boxes):
        return prior
    # Divided by the height of the box: bottom / h = horizon / h + ratio.
    heights = box_heights(boxes)
    columns = np.stack([1 / heights, np.ones(len(boxes))], axis=1)
    target = boxes[:, 3] / heights
    precision = np.linalg.inv(prior.covariance)
    mean = prior.mean
    for _ in range(4):
        error = np.abs(target - columns @ mean) / params.spread
        robust = weights / np.maximum(1, error) / params.spread**2
        posterior = precision + columns.T @ (robust[:, None] * columns)
        pull = precision @ prior.mean + columns.T @ (robust * target)
        mean = np.linalg.solve(posterior, pull)
    return Road(mean, np.linalg.inv(posterior))


def misplacement(boxes: np.ndarray, road: Road, params: RoadParams) -> np.ndarray:
    """By how many standard deviations boxes stand where no vehicle can.

    A box may be that of a car, or of a vehicle up to `params.lorry_to_car` times as high.
    What stands higher hangs above the road; what stands lower is too low for a car there.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    road : Road
    params : RoadParams

    Returns
    -------
    deviation : ndarray of float, shape (n,)
        From 0.
    """
    heights = box_heights(boxes)
    horizon, ratio = road.mean
    below = boxes[:, 3] - horizon
    hanging = ratio * heights / params.lorry_to_car - below
    low = below - ratio * heights
    variance = (params.spread * heights) ** 2
    columns = np.stack([np.ones(len(boxes)), heights], axis=1)
    variance += np.einsum("ij,jk,ik->i", columns, road.covariance, columns)
    return np.maximum(0, np.maximum(hanging, low)) / np.sqrt(variance)


class RoadMemory:
    """Whole cars of the last frames, and the road they tell.

    Parameters
    ----------
    params : RoadParams
    """

    def __init__(self, params: RoadParams):
        self.params = params
        self._cars = np.empty((0, 4))
        # By how many frames each is behind.
        self._ages = np.empty(0, int)

    def learn(self, cars: np.ndarray) -> None:
        """Add the whole cars of the next frame, shape (n, 4); forget those of long ago."""
        cars = np.concatenate([self._cars, cars])
        ages = np.concatenate([self._ages + 1, np.zeros(len(cars) - len(self._cars), int)])
        recent = ages < self.params.n_frames
        self._cars, self._ages = cars[recent], ages[recent]

    def road(
        self, n_rows: int, cars: np.ndarray | None = None, weights: np.ndarray | None = None
    ) -> Road:
        """What is known of the road, from the cars remembered and those of this frame.

        Parameters
        ----------
        n_rows : int
            Of the frame.
        cars, weights : ndarray of float, shapes (n, 4) and (n,), optional
            Of this frame, see `update_road`.

        Returns
        -------
        road : Road
        """
        boxes, all_weights = self._cars, np.ones(len(self._cars))
        if cars is not None:
            boxes = np.concatenate([boxes, cars])
            all_weights = np.concatenate([all_weights, weights])
        return update_road(n_rows, boxes, all_weights, self.params)
