"""Metres to vehicles, from where they stand on a flat road.

Rows below the horizon are the focal length times the height of the camera by the distance [1]_.
Over a crest or in a dip the road is not flat, and the distance is wrong by as much as the row
in which it vanishes moves.

References
----------
.. [1] D. Hoiem, A. Efros and M. Hebert, "Putting Objects in Perspective", CVPR 2006.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from vehicle_detection.parameters import DistanceParams
    from vehicle_detection.two_stage.road import Road


def distances(boxes: np.ndarray, road: Road, focal: float, params: DistanceParams) -> np.ndarray:
    """Metres from the camera to the near end of each vehicle.

    Parameters
    ----------
    boxes : ndarray of float, shape (n, 4)
    road : Road
        Its horizon, and the height of the camera by that of a car.
    focal : float
        Focal length in pixels of the frame.
    params : DistanceParams

    Returns
    -------
    metres : ndarray of float, shape (n,)
        NaN for what stands too near the horizon to say.
    """
    horizon, ratio = road.mean
    height = params.camera_height or ratio * params.car_height
    below = boxes[:, 3] - horizon
    # Where the row of the horizon is uncertain by as much, nothing is known.
    clear = below > params.n_std * np.sqrt(road.covariance[0, 0])
    return np.where(clear, focal * height / np.where(clear, below, 1), np.nan)
