"""Refinement: boxes are moved and scored where they then are."""

import numpy as np
import pytest

from conftest import random_boxes, random_detector, textured_image
from vehicle_detection.two_stage.features import (
    chroma_features,
    cut_patches,
    luma_and_chroma,
    margins_outside,
    on_whole_pixels,
    patch_features,
    regressor_features,
    scorer_features,
)
from vehicle_detection.two_stage.refinement import move_edges, refine


def test_edges_move_by_shares_of_the_box():
    moved = move_edges(np.array([(100.0, 50, 200, 90)]), np.array([(-0.1, 0.25, 0.2, 0)]))
    np.testing.assert_allclose(moved, [(90, 60, 220, 90)])


def test_boxes_are_scored_where_they_were_moved():
    img = textured_image(4, 240, 320)
    detector = random_detector(0)

    def described(box, cells):
        planes = luma_and_chroma(cut_patches(img, box[None]))
        outside = margins_outside(box[None], img.shape)
        luma, contrast = patch_features(planes)
        if cells is scorer_features:
            return scorer_features(luma, outside)
        return regressor_features(luma, chroma_features(planes, contrast), outside)

    none = refine(img, np.empty((0, 4)), detector)
    assert none.boxes.shape == (0, 4) and none.scores.shape == (0,)
    boxes = random_boxes(np.random.default_rng(0), 5)
    found = refine(img, boxes, detector)
    for box, own_box, score in zip(on_whole_pixels(boxes), found.boxes, found.scores, strict=True):
        shift = detector.regressor.predict(described(box, regressor_features))
        moved_box = on_whole_pixels(move_edges(box[None], shift))[0]
        np.testing.assert_allclose(moved_box, own_box)
        alone = detector.scorer.predict(described(own_box, scorer_features))
        assert score == pytest.approx(alone[0, 0], abs=1e-4)
