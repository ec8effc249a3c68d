"""Refinement: boxes are scored where they are, and moved."""

import numpy as np
import pytest

from conftest import random_boxes, random_detector, textured_image
from vehicle_detection.two_stage.features import (
    cut_patches,
    describe_patches,
    margins_outside,
    on_whole_pixels,
)
from vehicle_detection.two_stage.proposals import move_edges
from vehicle_detection.two_stage.refinement import refine


def test_edges_move_by_shares_of_the_box():
    moved = move_edges(np.array([(100.0, 50, 200, 90)]), np.array([(-0.1, 0.25, 0.2, 0)]))
    np.testing.assert_allclose(moved, [(90, 60, 220, 90)])


def test_boxes_are_scored_and_moved_each_by_itself():
    img = textured_image(4, 240, 320)
    detector = random_detector(0)
    none = refine(img, np.empty((0, 4)), detector)
    assert none.boxes.shape == (0, 4) and none.scores.shape == (0,)
    boxes = on_whole_pixels(random_boxes(np.random.default_rng(0), 5))
    found = refine(img, boxes, detector)
    for i, box in enumerate(boxes):
        outside = margins_outside(box[None], img.shape)
        features = describe_patches(cut_patches(img, box[None]), outside)
        score, *shifts = detector.machine.predict(features)[0]
        assert found.scores[i] == pytest.approx(score, abs=1e-4)
        moved = move_edges(box[None], np.array([shifts]))[0]
        np.testing.assert_allclose(found.boxes[i], moved, atol=1e-3)
        assert not np.allclose(moved, box)
