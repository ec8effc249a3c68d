"""What vehicles say of the road, against hand-computed values and simulated cars."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_detection.parameters import RoadParams
from vehicle_detection.two_stage.road import (
    Road,
    RoadMemory,
    misplacement,
    prior_road,
    reach,
    update_road,
)

PARAMS = RoadParams()


def cars(rng, count, horizon, camera_to_car, heights=(30, 200)):
    """Boxes of cars on a flat road, some a bit higher than others."""
    height = rng.uniform(*heights, count)
    bottom = horizon + camera_to_car * height * rng.normal(1, 0.05, count)
    left = rng.uniform(0, 1000, count)
    return np.stack([left, bottom - height, left + 1.4 * height, bottom], axis=1)


def learned(boxes, n_rows=720):
    """The road that some boxes tell, all of them cars for sure."""
    return update_road(n_rows, boxes, np.ones(len(boxes)), PARAMS)


@settings(max_examples=40)
@given(horizon=st.floats(220, 450), camera_to_car=st.floats(0.7, 1.3), seed=st.integers(0, 10_000))
def test_cars_tell_the_road_and_lorries_hardly_change_it(horizon, camera_to_car, seed):
    rng = np.random.default_rng(seed)
    lorries = cars(rng, 6, horizon, camera_to_car / 2.5)
    road = learned(np.concatenate([cars(rng, 94, horizon, camera_to_car), lorries]))
    assert road.mean[0] == pytest.approx(horizon, abs=20)
    assert road.mean[1] == pytest.approx(camera_to_car, abs=0.2)


def test_without_cars_nothing_is_learned():
    prior = prior_road(720, PARAMS)
    np.testing.assert_array_equal(learned(np.empty((0, 4))).mean, prior.mean)
    np.testing.assert_allclose(prior.mean, (0.46 * 720, 0.95))
    np.testing.assert_allclose(np.sqrt(np.diag(prior.covariance)), (0.08 * 720, 0.2))


def test_one_car_is_the_textbook_update():
    # Bottom / height = horizon / height + ratio, one observation: the car's height varies.
    variance = 0.2**2
    prior = prior_road(720, PARAMS)
    road = learned(np.array([(0.0, 400, 140, 500)]))
    column = np.array([1 / 100, 1])
    gain = prior.covariance @ column / (column @ prior.covariance @ column + variance)
    mean = prior.mean + gain * (5 - column @ prior.mean)
    # The error is below one standard deviation: nothing is downweighted.
    assert abs(5 - column @ road.mean) < np.sqrt(variance)
    np.testing.assert_allclose(road.mean, mean)
    np.testing.assert_allclose(
        road.covariance, prior.covariance - np.outer(gain, column) @ prior.covariance
    )


def test_wrong_boxes_are_outvoted_or_forgotten():
    # Far up between trees, and small.
    wrong, memory = np.array([(1207.0, 211, 1270, 239)]), RoadMemory(PARAMS)
    for _ in range(10):
        memory.learn(wrong)
    for _ in range(PARAMS.n_frames):
        memory.learn(np.empty((0, 4)))
    np.testing.assert_allclose(memory.road(720).mean, prior_road(720, PARAMS).mean)
    for _ in range(10):
        memory.learn(wrong)
    rng = np.random.default_rng(0)
    for _ in range(80):
        memory.learn(cars(rng, 3, 420, 0.9))
    assert memory.road(720).mean[0] == pytest.approx(420, abs=40)


KNOWN = Road(np.array([400.0, 0.8]), np.zeros((2, 2)))


def test_vehicles_from_sports_car_to_lorry_are_in_place():
    # A car 100 high ends 80 below the horizon, a lorry 300 high too.
    boxes = np.array([(0.0, 380, 140, 480), (0, 180, 200, 480), (0, 280, 200, 480)])
    np.testing.assert_allclose(misplacement(boxes, KNOWN, PARAMS), 0, atol=1e-9)


def test_what_hangs_or_is_too_low_is_misplaced_by_hand_computed_deviations():
    # A sign that ends 20 above the horizon: a lorry as high would end 0.8 / 3 of 60 below.
    # Half a car: 50 high where cars are 100 high.
    boxes = np.array([(0.0, 320, 60, 380), (0, 430, 140, 480)])
    expected = [(16 + 20) / (0.2 * 60), (80 - 40) / (0.2 * 50)]
    np.testing.assert_allclose(misplacement(boxes, KNOWN, PARAMS), expected)


@given(height=st.floats(0.02, 0.4), bottom=st.floats(0.1, 1))
def test_the_less_is_known_the_less_is_misplaced(height, bottom):
    box = 720 * np.array([(0, bottom - height, 0.1, bottom)])
    prior = prior_road(720, PARAMS)
    sure = Road(prior.mean, prior.covariance / 100)
    assert misplacement(box, prior, PARAMS) <= misplacement(box, sure, PARAMS) + 1e-9


def test_the_scan_reaches_where_vehicles_can_stand():
    where = reach(prior_road(1000, PARAMS), 1000, PARAMS)
    # Two standard deviations around the mean.
    np.testing.assert_allclose(where.horizon, (300, 620), atol=1e-9)
    np.testing.assert_allclose(where.ratio, (0.55 / 3, 1.35), atol=1e-9)
    rng = np.random.default_rng(0)
    known = reach(learned(cars(rng, 50, 400, 0.9), 1000), 1000, PARAMS)
    assert 300 < known.horizon[0] <= 400 <= known.horizon[1] < 500


def test_memory_forgets_what_is_long_ago():
    memory, rng = RoadMemory(RoadParams(n_frames=50)), np.random.default_rng(1)
    memory.learn(cars(rng, 200, 500, 0.9))
    assert memory.road(720).mean[0] == pytest.approx(500, abs=20)
    for _ in range(50):
        memory.learn(cars(rng, 1, 330, 0.9))
    assert memory.road(720).mean[0] == pytest.approx(330, abs=20)
    for _ in range(50):
        memory.learn(np.empty((0, 4)))
    np.testing.assert_allclose(memory.road(720).mean, prior_road(720, PARAMS).mean)


def test_the_cars_of_a_frame_count_beside_those_remembered():
    rng, memory = np.random.default_rng(1), RoadMemory(PARAMS)
    memory.learn(cars(rng, 3, 330, 0.9))
    own = cars(rng, 60, 250, 0.9)
    assert memory.road(720, own, np.ones(60)).mean[0] == pytest.approx(250, abs=20)
    np.testing.assert_allclose(memory.road(720, own, np.zeros(60)).mean, memory.road(720).mean)


@pytest.mark.parametrize(
    "wrong",
    [
        {"horizon": (0, 0.1)},
        {"spread": 0},
        {"n_frames": 0},
        {"lorry_to_car": 0.5},
        {"cost": -1},
    ],
)
def test_road_params_refuse(wrong):
    with pytest.raises(ValueError):
        RoadParams(**wrong)
