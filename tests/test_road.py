"""What vehicles say of the road."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_detection.two_stage.road import Road, fit_road, lowness, stand_on_road, usual_road


def cars(rng, count, horizon, camera_to_car, heights=(30, 200)):
    """Boxes of cars on a flat road, some a bit higher than others."""
    height = rng.uniform(*heights, count)
    bottom = horizon + camera_to_car * height * rng.normal(1, 0.05, count)
    left = rng.uniform(0, 1000, count)
    return np.stack([left, bottom - height, left + 1.4 * height, bottom], axis=1)


@settings(max_examples=40)
@given(horizon=st.floats(200, 500), camera_to_car=st.floats(0.85, 1.8), seed=st.integers(0, 10_000))
def test_cars_tell_the_road_and_lorries_hardly_change_it(horizon, camera_to_car, seed):
    rng = np.random.default_rng(seed)
    lorries = cars(rng, 10, horizon, camera_to_car / 2.5)
    boxes = np.concatenate([cars(rng, 90, horizon, camera_to_car), lorries])
    road = fit_road(boxes)
    assert road.horizon == pytest.approx(horizon, abs=16)
    assert road.camera_to_car == pytest.approx(camera_to_car, rel=0.15)


def test_one_car_at_one_distance_is_taken_for_a_usual_one():
    boxes = np.tile([(500.0, 400, 640, 500)], (60, 1))
    road = fit_road(boxes)
    assert road.camera_to_car == pytest.approx(0.8)
    assert road.horizon == pytest.approx(420)


def test_parts_of_a_car_do_not_lower_the_camera():
    rng = np.random.default_rng(0)
    whole = np.tile([(500.0, 400, 640, 500)], (60, 1))
    parts = whole.copy()
    parts[:, 1] += rng.uniform(20, 50, 60)
    road = fit_road(np.concatenate([whole, parts[:25]]))
    assert road == Road(420.0, 0.8)


def test_a_sign_above_the_horizon_stands_on_no_road():
    # A car, a lorry, a sign, and a bridge of which the horizon is at the bottom.
    boxes = np.array(
        [(0, 390, 60, 440), (0, 320, 60, 420), (0, 300, 60, 410), (0, 300, 99, 400)], float
    )
    assert stand_on_road(boxes, Road(410.0, 0.8), 1000).tolist() == [True, False, False, False]
    assert stand_on_road(boxes, Road(400.0, 0.8), 1000).tolist() == [True, True, False, False]
    # Three times as high as a car where it stands, and a little more.
    high = np.array([(0, 303, 60, 418), (0, 297, 60, 418)], float)
    assert stand_on_road(high, Road(398.0, 0.8), 1000).tolist() == [False, False]
    assert stand_on_road(high, Road(397.0, 0.8), 1000).tolist() == [True, False]
    # From twice as high up, the ground is twice as far below the horizon.
    assert stand_on_road(boxes, Road(400.0, 1.6), 1000).tolist() == [True, False, False, False]
    # In larger pictures, bumps are larger.
    assert stand_on_road(boxes, Road(410.0, 0.8), 2000).tolist() == [True, True, False, False]


@given(
    horizon=st.floats(0.42, 0.62), height=st.floats(0.057, 0.3), n_rows=st.sampled_from([360, 1080])
)
def test_cars_stand_on_the_usual_road_whatever_the_camera(horizon, height, n_rows):
    bottom = horizon + 0.8 * height
    box = n_rows * np.array([(0, bottom - height, 0.1, bottom)])
    assert stand_on_road(box, usual_road(n_rows), n_rows).tolist() == [True]


def test_trees_above_the_usual_horizon_stand_on_no_road():
    trees = np.array([(100.0, 270, 160, 331), (500, 225, 560, 335)])
    assert stand_on_road(trees, usual_road(720), 720).tolist() == [False, False]


def test_half_a_car_is_too_low_where_it_stands():
    # A car, a lorry, a sports car, the lower half of a car, and one far ahead on a bump.
    boxes = np.array(
        [(0, 410, 9, 510), (0, 210, 9, 510), (0, 430, 9, 510), (0, 460, 9, 510), (0, 434, 9, 464)],
        float,
    )
    low = lowness(boxes, Road(430.0, 0.8), 1000)
    np.testing.assert_allclose(low, [0, 0, 0, 70 / 50 - 0.9, 0], atol=1e-9)
