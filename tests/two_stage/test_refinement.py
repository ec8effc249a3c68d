"""Refinement: boxes are scored and moved, vehicles twice."""

import numpy as np
import pytest

from conftest import random_boxes, random_detector, textured_image
from vehicle_detection.tracking.boxes import move_edges
from vehicle_detection.two_stage.features import (
    cut_patches,
    describe_patches,
    margins_outside,
    on_whole_pixels,
)
from vehicle_detection.two_stage.refinement import look, refine


def test_edges_move_by_shares_of_the_box():
    moved = move_edges(np.array([(100.0, 50, 200, 90)]), np.array([(-0.1, 0.25, 0.2, 0)]))
    np.testing.assert_allclose(moved, [(90, 60, 220, 90)])


def test_a_box_is_scored_as_it_is_and_moved():
    img, detector = textured_image(4, 240, 320), random_detector(0)
    boxes = on_whole_pixels(random_boxes(np.random.default_rng(0), 5))
    moved, scores = look(img, boxes, detector)
    for i, box in enumerate(boxes):
        outside = margins_outside(box[None], img.shape)
        features = describe_patches(cut_patches(img, box[None]), outside)
        score, *shifts = detector.machine.predict(features)[0]
        assert scores[i] == pytest.approx(score, abs=1e-4)
        expected = move_edges(box[None], np.array([shifts]))[0]
        np.testing.assert_allclose(moved[i], expected, atol=1e-3)
        assert not np.allclose(expected, box)


def test_what_scores_as_a_vehicle_is_looked_at_again():
    img, detector = textured_image(4, 240, 320), random_detector(0)
    none = refine(img, np.empty((0, 4)), detector)
    assert none.boxes.shape == (0, 4) and none.scores.shape == (0,)
    boxes = random_boxes(np.random.default_rng(0), 20)
    first_boxes, first_scores = look(img, boxes, detector)
    second_boxes, second_scores = look(img, first_boxes, detector)
    found = refine(img, boxes, detector)
    hot = first_scores > 0
    assert 0 < hot.sum() < 20
    np.testing.assert_allclose(found.boxes[hot], second_boxes[hot], atol=1e-3)
    np.testing.assert_allclose(found.scores[hot], second_scores[hot], atol=1e-4)
    np.testing.assert_allclose(found.boxes[~hot], first_boxes[~hot], atol=1e-3)
    np.testing.assert_allclose(found.scores[~hot], first_scores[~hot], atol=1e-4)


def test_predictions_are_looked_at_once():
    img, detector = textured_image(4, 240, 320), random_detector(0)
    boxes = random_boxes(np.random.default_rng(0), 20)
    once_boxes, once_scores = look(img, boxes, detector)
    first_hot = int(np.argmax(once_scores > 0))
    found = refine(img, boxes, detector, n_predicted=first_hot + 1)
    np.testing.assert_allclose(found.boxes[: first_hot + 1], once_boxes[: first_hot + 1], atol=1e-3)
    np.testing.assert_allclose(
        found.scores[: first_hot + 1], once_scores[: first_hot + 1], atol=1e-4
    )
    others = refine(img, boxes[first_hot + 1 :], detector)
    np.testing.assert_allclose(found.boxes[first_hot + 1 :], others.boxes, atol=1e-3)
    np.testing.assert_allclose(found.scores[first_hot + 1 :], others.scores, atol=1e-4)


def test_a_mirrored_frame_has_mirrored_vehicles():
    img, detector = textured_image(4, 240, 320), random_detector(0)
    boxes = on_whole_pixels(random_boxes(np.random.default_rng(0), 20))
    turned = np.stack([320 - boxes[:, 2], boxes[:, 1], 320 - boxes[:, 0], boxes[:, 3]], axis=1)
    moved, scores = look(img, boxes, detector, mirrored=True)
    of_turned, turned_scores = look(img[:, ::-1], turned, detector, mirrored=True)
    back = np.stack(
        [320 - of_turned[:, 2], of_turned[:, 1], 320 - of_turned[:, 0], of_turned[:, 3]], axis=1
    )
    np.testing.assert_allclose(scores, turned_scores, atol=2e-3)
    np.testing.assert_allclose(moved, back, atol=0.05)
    _, once = look(img, boxes, detector)
    assert not np.allclose(scores, once, atol=0.01)
