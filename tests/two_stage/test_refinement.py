"""Refinement: boxes are moved and scored where they then are."""

from dataclasses import replace

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
from vehicle_detection.two_stage.refinement import merge, move_edges, refine


def refined(img, boxes, detector, discard_below=-1.0):
    """Boxes and scores of `refine`."""
    none = np.empty((0, 4))
    candidates = refine(img, merge(none, boxes, 0.6), detector, discard_below)
    return candidates.boxes, candidates.scores


def test_proposals_of_what_is_predicted_are_left_out():
    predicted = np.array([(0.0, 0, 40, 20), (100, 0, 140, 20)])
    proposals = np.array([(4.0, 0, 44, 20), (20, 0, 60, 20), (200, 0, 240, 20)])
    merged = merge(predicted, proposals, same_iou=0.6)
    np.testing.assert_array_equal(merged.boxes, [*predicted, *proposals[1:]])
    assert merged.is_tracked.tolist() == [True, True, False, False]
    assert merged.only([2]).boxes.tolist() == [[20, 0, 60, 20]]
    assert len(merge(predicted[:0], proposals, 0.6).boxes) == 3


def test_edges_move_by_shares_of_the_box():
    moved = move_edges(np.array([(100.0, 50, 200, 90)]), np.array([(-0.1, 0.25, 0.2, 0)]))
    np.testing.assert_allclose(moved, [(90, 60, 220, 90)])


def test_the_closer_look_scores_where_it_moved_the_box():
    img = textured_image(4, 240, 320)
    detector = random_detector(0)

    def described(box, cells):
        planes = luma_and_chroma(cut_patches(img, box[None]))
        outside = margins_outside(box[None], img.shape)
        luma, contrast = patch_features(planes)
        if cells is scorer_features:
            return scorer_features(luma, outside)
        return regressor_features(luma, chroma_features(planes, contrast), outside)

    none, no_scores = refined(img, np.empty((0, 4)), detector)
    assert none.shape == (0, 4) and no_scores.shape == (0,)
    boxes = random_boxes(np.random.default_rng(0), 5)
    moved, scores = refined(img, boxes, detector, discard_below=-np.inf)
    for box, own_box, score in zip(on_whole_pixels(boxes), moved, scores, strict=True):
        shift = detector.regressor.predict(described(box, regressor_features))
        moved_box = on_whole_pixels(move_edges(box[None], shift))[0]
        np.testing.assert_allclose(moved_box, own_box)
        alone = detector.scorer.predict(described(own_box, scorer_features))
        assert score == pytest.approx(alone[0, 0], abs=1e-4)


def test_what_is_hopeless_where_it_was_proposed_is_not_moved():
    img, detector = textured_image(4, 240, 320), random_detector(0)
    boxes = on_whole_pixels(random_boxes(np.random.default_rng(0), 9))
    outside = margins_outside(boxes, img.shape)
    features, _ = patch_features(luma_and_chroma(cut_patches(img, boxes)))
    own = detector.scorer.predict(scorer_features(features, outside))[:, 0]
    # So that the middle one is at the limit, and half of them are below it.
    limited = detector.scorer.bias - np.float32(np.median(own) + 1)
    detector = replace(detector, scorer=replace(detector.scorer, bias=limited))
    hopeless = own < np.median(own)
    moved, scores = refined(img, boxes, detector)
    np.testing.assert_array_equal(moved[hopeless], boxes[hopeless])
    np.testing.assert_allclose(scores[hopeless], own[hopeless] - np.median(own) - 1, atol=1e-4)
    others = own > np.median(own)
    assert others.sum() == hopeless.sum() == 4
    assert (moved[others] != boxes[others]).any()
