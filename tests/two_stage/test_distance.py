"""Metres to vehicles, by hand and against the rendered road, which knows them."""

from dataclasses import replace

import numpy as np
import pytest

from rendered_road.render import render
from rendered_road.sample import FPS, driving_world
from vehicle_detection.media.calibration import Calibration, save_calibration
from vehicle_detection.parameters import VIDEO_PARAMS, DistanceParams
from vehicle_detection.tracking.boxes import pairwise_iou
from vehicle_detection.two_stage.distance import distances
from vehicle_detection.two_stage.road import Road
from vehicle_detection.two_stage.vehicle import TwoStageVehicle


def test_distances_by_hand():
    boxes = np.array([(0.0, 380, 60, 430), (0, 390, 60, 405), (0, 300, 50, 360)])
    road = Road(np.array([400.0, 0.9]), np.diag([2.0**2, 0.1**2]))
    # 1000 pixels of focal length, and a camera at 1.35 m: 30 rows below the horizon are 45 m.
    found = distances(boxes, road, 1000, DistanceParams(camera_height=1.35))
    assert found[0] == pytest.approx(45) and found[1] == pytest.approx(270)
    assert np.isnan(found[2])
    # Nine tenths of a car of 1.5 m are as high.
    np.testing.assert_allclose(distances(boxes, road, 1000, DistanceParams())[:2], found[:2])
    unsure = Road(road.mean, np.diag([10.0**2, 0.1**2]))
    assert np.isnan(distances(boxes, unsure, 1000, DistanceParams())[1])
    with pytest.raises(ValueError, match="heights are above 0"):
        DistanceParams(camera_height=0)


def test_distances_on_the_rendered_road(tmp_path):
    """Median error under a tenth up to 50 m, with the camera's height."""
    world = driving_world(0)
    camera = world.camera
    dist, size = np.array([camera.dist]), (camera.width, camera.height)
    calibration = Calibration(camera.mtx, dist, size)
    save_calibration(calibration, tmp_path / "calib.p")
    height = DistanceParams(camera_height=camera.mount_height)
    params = replace(VIDEO_PARAMS, distance=height)
    vehicle = TwoStageVehicle(tmp_path / "calib.p", params=params)
    errors = []
    for i in range(0, 60):
        frame, truth = render(world, i / FPS)
        found = vehicle.detect(frame)
        if i < 20 or not len(found.boxes):
            continue
        own = [box for box in truth if box.required and box.distance < 50]
        iou = pairwise_iou(np.array([box.box for box in own]).reshape(-1, 4), found.boxes)
        for k, box in enumerate(own):
            best = iou[k].argmax()
            if iou[k, best] > 0.5:
                errors.append(found.distances[best] / box.distance - 1)
    assert len(errors) > 30
    assert np.median(np.abs(errors)) < 0.1, np.quantile(errors, [0.1, 0.5, 0.9])
