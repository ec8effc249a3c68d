"""The road, as vehicles tell it: where it vanishes, and how high vehicles are on it.

On a flat road the bottom of a vehicle lies below the horizon by its height in
pixels times h / H, h being the height of the camera and H that of the vehicle,
both in metres [1]_. What hangs above the horizon is no vehicle, and what is
much lower than a car where it stands is mostly a part of one.

References
----------
.. [1] D. Hoiem, A. Efros and M. Hebert, "Putting Objects in Perspective",
       CVPR 2006.
"""

from dataclasses import dataclass

import numpy as np

# h / H of a camera behind the windscreen and a car, and how much it weighs
# against all vehicles together: as much as one in eighty of them.
_USUAL = 0.8
_WEIGHT_OF_USUAL = 1 / 80
# Where a road may vanish that no vehicle has told of yet, as a share of the frame's
# rows: hardly any camera looks farther down, and of a road that vanishes at 0.42, cars
# higher than a seventeenth of the frame are still taken to stand on this one.
_USUAL_HORIZON = 0.46
# Vehicles differ so much in h / H; what differs more weighs less.
_SPREAD = 0.15
# Height of a lorry by that of a car: roads let pass up to four metres or little more.
_HIGHEST = 3
# What a car may be lower than most, in heights of the camera by its own; and how
# far bumps may take it, as a share of the frame's rows.
_SLACK, _BUMP = 0.1, 0.01


@dataclass(frozen=True)
class Road:
    """What vehicles say of the road and the camera.

    Attributes
    ----------
    horizon : float
        Row in which the road vanishes.
    camera_to_car : float
        Height of the camera by that of a car.
    """

    horizon: float
    camera_to_car: float


def usual_road(n_rows):
    """What to take for the road of a frame of `n_rows` before any vehicle tells of it."""
    return Road(_USUAL_HORIZON * n_rows, _USUAL)


def fit_road(boxes):
    """The road on which most of some vehicles stand, by regression in which outliers weigh less.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
        Cars of some frames; at least one, and all of some height.

    Returns
    -------
    road : Road
        Its `camera_to_car` is at least the usual one: what says less is mostly
        parts of a car at one distance, taken for whole ones.
    """
    bottom, height = boxes[:, 3], boxes[:, 3] - boxes[:, 1]
    # Divided by their height, boxes of all sizes err alike.
    ratio, inverse = bottom / height, 1 / height
    horizon, camera_to_car = np.median(bottom - _USUAL * height), _USUAL
    columns = np.stack([np.ones(len(boxes)), inverse], axis=1)
    for _ in range(3):
        errors = np.abs(ratio - inverse * horizon - camera_to_car)
        weights = 1 / len(boxes) / np.maximum(1, errors / _SPREAD)
        left = columns.T @ (weights[:, None] * columns)
        right = columns.T @ (weights * ratio)
        left[0, 0] += _WEIGHT_OF_USUAL
        right[0] += _WEIGHT_OF_USUAL * _USUAL
        camera_to_car, horizon = np.linalg.solve(left, right)
    if camera_to_car < _USUAL:
        return Road(float(np.median(bottom - _USUAL * height)), _USUAL)
    return Road(float(horizon), float(camera_to_car))


def stand_on_road(boxes, road, n_rows):
    """Which boxes could frame a vehicle that stands on the road.

    Lorries are up to three times as high as cars; signs and bridges have their
    bottom above the horizon, or not far enough below.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    road : Road
    n_rows : int
        Of the frame.

    Returns
    -------
    standing : ndarray of bool, shape (n,)
    """
    below = boxes[:, 3] - road.horizon + _BUMP * n_rows
    return below > road.camera_to_car / _HIGHEST * (boxes[:, 3] - boxes[:, 1])


def lowness(boxes, road, n_rows):
    """How much lower than cars boxes are where they stand.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    road : Road
    n_rows : int
        Of the frame.

    Returns
    -------
    lowness : ndarray of float, shape (n,)
        From 0, for what may be a car, in heights of the camera by that of the box:
        the lower half of a car has `camera_to_car`, less a tenth.
    """
    below = boxes[:, 3] - road.horizon - _BUMP * n_rows
    excess = below / (boxes[:, 3] - boxes[:, 1]) - road.camera_to_car
    return np.maximum(0, excess - _SLACK)
