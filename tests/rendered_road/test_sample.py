"""Rendered scenes: the same every time, true boxes, and real enough."""

from itertools import pairwise

import numpy as np
import pytest

from conftest import ROOT
from pipeline_functions import find_cars
from rendered_road.render import BODIES, Actor, Camera, View, _actor_mesh, make_world, render
from rendered_road.sample import (
    cut_scene,
    driving_world,
    random_scene,
    town_scene,
    truth_rows,
)
from vehicle_detection.classifier import load_classifier
from vehicle_detection.parameters import SearchParams


def test_same_seed_same_frame():
    frame, truth = render(random_scene(7), 0.0)
    again, truth_again = render(random_scene(7), 0.0)
    np.testing.assert_array_equal(frame, again)
    assert truth == truth_again
    assert not np.array_equal(frame, render(random_scene(8), 0.0)[0])


@pytest.mark.parametrize("kind", list(BODIES))
@pytest.mark.parametrize("distance, lane", [(12, 0), (25, 1), (40, 2)])
def test_truth_box_is_where_the_vehicle_is_drawn(kind, distance, lane):
    actor = Actor(1, kind, (1.0, 0.0, 1.0), distance, 0.0, lane, style=3)
    empty, _ = render(make_world(3), 0.0)
    frame, (box,) = render(make_world(3, [actor]), 0.0)
    # What no shadow can do: magenta paint makes pixels less green and more red.
    changed = frame.astype(int) - empty
    magenta = (changed[..., 0] - changed[..., 1]) > 30
    rows, columns = np.nonzero(magenta)
    left, top, right, bottom = box.box
    assert left - 1.5 <= columns.min() and columns.max() <= right + 1.5
    assert top - 1.5 <= rows.min() and rows.max() <= bottom + 1.5
    # The paint reaches the sides and the roof; the wheels are below it.
    assert columns.min() < left + 0.06 * (right - left) + 3 or left == 0
    assert columns.max() > right - 0.06 * (right - left) - 4 or right == 1280
    assert rows.min() < top + 0.12 * (bottom - top) + 3


@pytest.mark.parametrize("kind", list(BODIES))
@pytest.mark.parametrize("distance, side", [(2, 1), (3.5, -1), (6, 1), (7, -1)])
def test_box_of_a_vehicle_at_the_border_is_that_of_what_lies_within_the_frame(kind, distance, side):
    empty = make_world(3)
    actor = Actor(1, kind, (1.0, 0.0, 1.0), distance, 0.0, empty.own_lane + side)
    world = make_world(3, [actor])
    (box,) = render(world, 0.0)[1]
    corners = _actor_mesh(View.of(world, 0.0), actor, 0.0)[0]
    corners = corners[corners[:, :, 2].min(axis=1) > 1]
    # Points all along the sides of the triangles.
    points = np.linspace(corners, np.roll(corners, 1, axis=1), 200).reshape(-1, 3)
    pixels = View.of(world, 0.0).distorted(*points.T)
    within = pixels[((pixels >= 0) & (pixels <= (1280, 720))).all(axis=1)]
    np.testing.assert_allclose(box.box, [*within.min(axis=0), *within.max(axis=0)], atol=2.5)
    if distance == 2:
        # What is beside the camera and out of sight reaches farther down.
        assert pixels[:, 1].max() > box.box[3] + 15


def test_nearer_vehicle_hides_the_one_behind():
    lane = make_world(0).own_lane
    far = Actor(1, "saloon", (0.9, 0.9, 0.9), 40, 0.0, lane)
    near = Actor(2, "truck", (0.2, 0.2, 0.5), 15, 0.0, lane)
    world = make_world(0, [far, near])
    _, truth = render(world, 0.0)
    boxes = {box.identity: box for box in truth}
    assert boxes[2].required and boxes[2].visible > 0.9
    assert not boxes[1].required and boxes[1].visible < 0.2


def test_what_lies_further_aside_is_seen_further_aside():
    # The distortion's polynomial turns back at a tangent of about 1.2.
    aside = np.linspace(0, 40, 400)
    points = np.stack([aside, np.zeros_like(aside), np.full_like(aside, 4.0)], axis=1)
    assert (np.diff(Camera().project(points)[:, 0]) > -1e-9).all()


def test_a_vehicle_beside_the_camera_is_boxed_where_it_is_seen():
    # Half of it lies behind the camera, where the distortion's polynomial has turned back.
    truth = render(driving_world(0), 73 / 25)[1]
    (box,) = [box for box in truth if box.identity == 1]
    assert box.box[0] > 1000 and not box.required


def test_vehicle_grows_smaller_as_it_drives_away():
    world = make_world(2, [Actor(1, "suv", (0.5, 0.1, 0.1), 15, 10.0, 1)])
    heights = []
    for time in (0.0, 1.0, 3.0):
        (box,) = render(world, time)[1]
        heights.append(box.box[3] - box.box[1])
    assert heights[0] > 1.3 * heights[1] > 1.6 * heights[2]


def test_truth_rows_are_motchallenge():
    _, truth = render(random_scene(11), 0.0)
    rows = np.array([row.split(",") for row in truth_rows(5, truth)], float)
    assert rows.shape == (len(truth), 9)
    assert (rows[:, 0] == 5).all() and len(set(rows[:, 1])) == len(rows)
    assert ((rows[:, 6] == 0) | (rows[:, 5] >= 29.9)).all()
    assert (rows[:, 2] >= 0).all() and (rows[:, 2] + rows[:, 4] <= 1280.1).all()


def test_vehicles_come_in_beside_the_camera_in_lanes_of_their_own():
    beside = 0
    for seed in range(40):
        world = random_scene(seed)
        for lane in range(world.n_lanes):
            own = [actor for actor in world.actors if round(actor.lane) == lane]
            places = sorted((a.distance, a.distance + BODIES[a.kind].length) for a in own)
            assert all(front < rear for (_, front), (rear, _) in pairwise(places))
            near = [rear for rear, _ in places if rear < 5]
            assert not near or lane != world.own_lane
            beside += len(near)
    assert 20 < beside < 80


def test_driving_world_has_overtaking_and_oncoming_traffic():
    world = driving_world(0)
    assert 0 < world.own_lane < world.n_lanes - 1
    own = [actor for actor in world.actors if not actor.oncoming]
    assert any(a.distance < 0 and a.speed > 0 for a in own)
    assert any(a.lane_change for a in own)
    assert any(a.oncoming for a in world.actors)


def test_training_images_have_both_classes():
    _, _, (vehicles, others) = cut_scene(21)
    assert len(vehicles) >= 2 and len(others) >= 6
    assert {img.shape for img in vehicles + others} == {(64, 64, 3)}


def test_classifier_of_photographs_knows_rendered_vehicles():
    # The shipped classifier has seen photographs only. Windows of many sizes
    # all over the picture: the scenes are tested here, not the search.
    classifier = load_classifier(ROOT / "param/svc_pickle.p")
    search = SearchParams(
        bands=(
            (0.75, 370, 520), (1, 360, 560), (1.5, 340, 600), (2, 320, 650),
            (3, 270, 720), (4, 250, 720),
        ),
        cells_per_step=1,
    )  # fmt: skip
    found = []
    for seed in range(300, 308):
        frame, truth = render(random_scene(seed), 0.0)
        windows, scores = find_cars(frame, classifier, search)
        hot = windows[scores > 0]
        for box in truth:
            if box.required and box.box[3] - box.box[1] > 40:
                found.append(overlaps(np.array(box.box), hot).max(initial=0) >= 0.35)
    assert len(found) > 20
    assert np.mean(found) >= 0.8


def overlaps(box, others):
    """IoU of a box with each of others."""
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    common = np.clip(high - low, 0, None).prod(axis=1)
    area = (box[2:] - box[:2]).prod() + (others[:, 2:] - others[:, :2]).prod(axis=1)
    return common / (area - common)


def test_a_town_shows_vehicles_from_all_sides():
    aspects = []
    for seed in range(4):
        frame, truth = render(town_scene(seed), 0.0)
        assert frame.shape == (720, 1280, 3)
        boxes = np.array([box.box for box in truth if box.required])
        aspects += ((boxes[:, 2] - boxes[:, 0]) / (boxes[:, 3] - boxes[:, 1])).tolist()
    # From behind a car is about as wide as high, from the side at least twice as wide.
    assert min(aspects) < 1.3 and max(aspects) > 2


@pytest.mark.parametrize("yaw", [0.5, np.pi / 2, np.pi, -2.0])
def test_truth_of_a_turned_vehicle_is_where_it_is_drawn(yaw):
    actor = Actor(1, "estate", (1.0, 0.0, 1.0), 18.0, 0.0, 1.0, yaw=yaw, style=3)
    empty, _ = render(make_world(3), 0.0)
    frame, (box,) = render(make_world(3, [actor]), 0.0)
    changed = frame.astype(int) - empty
    rows, columns = np.nonzero((changed[..., 0] - changed[..., 1]) > 30)
    left, top, right, bottom = box.box
    assert left - 1.5 <= columns.min() < left + 0.1 * (right - left) + 3
    assert right - 0.1 * (right - left) - 4 < columns.max() <= right + 1.5
    assert top - 1.5 <= rows.min() < top + 0.15 * (bottom - top) + 3
