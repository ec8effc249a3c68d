"""Training of the two-stage detector."""

import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

from conftest import ROOT, random_detector, textured_image
from pipeline_functions import convert_color
from rendered_road.render import render
from rendered_road.sample import random_scene, truth_rows
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.media.encoder import video_writer
from vehicle_detection.media.images import find_images, read_image, write_image
from vehicle_detection.media.mot import read_rows, rows_of
from vehicle_detection.media.videos import VideoInfo
from vehicle_detection.parameters import (
    DEFAULT_TRAINING,
    STILL_PARAMS,
    TrainingParams,
)
from vehicle_detection.tracking.boxes import best_iou, pairwise_iou, pairwise_overlap
from vehicle_detection.two_stage.features import (
    CELL_FEATURES,
    N_FEATURES,
    margins_outside,
    on_whole_pixels,
)
from vehicle_detection.two_stage.proposals import (
    WINDOW_CELL,
    WINDOW_COLUMNS,
    WINDOW_CONTEXT,
    WINDOW_ROWS,
    cell_features,
)
from vehicle_detection.two_stage.refinement import refine
from vehicle_detection.two_stage.training import second_stage
from vehicle_detection.two_stage.training.__main__ import train_detector
from vehicle_detection.two_stage.training.augmentation import (
    cut_frame,
    degrade,
    mirrored,
    random_camera,
    random_crop,
)
from vehicle_detection.two_stage.training.first_stage import (
    context_shape,
    fit_template,
    shift_samples,
    window_features,
    with_shifts,
)
from vehicle_detection.two_stage.training.footage import (
    Example,
    TrainingSet,
    balanced,
    read_boxed_crops,
    read_cameras,
    read_footage,
)
from vehicle_detection.two_stage.training.machines import (
    cluster_centers,
    fit_linear_svm,
    fit_machine,
    fit_shifts,
    kernel_factor,
    kernel_map,
)
from vehicle_detection.two_stage.training.sampling import (
    PatchSamples,
    cut_by_border,
    edge_shifts,
    is_background,
    jittered,
    neighbours,
    random_parts,
    windows_around,
)
from vehicle_detection.two_stage.training.second_stage import (
    boxed_crop_samples,
    frame_boxes,
    frame_samples,
    train_second_stage,
)
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

TRAIN = [sys.executable, "-m", "vehicle_detection.two_stage.training"]


def boxes_of(seed, count, width=320, height=180):
    rng = np.random.default_rng(seed)
    corner = rng.uniform(0, (width - 60, height - 60), size=(count, 2))
    return np.hstack([corner, corner + rng.uniform(10, 60, size=(count, 2))])


# ------------------------------------------------------------------- reading


def test_footage_is_a_folder_or_a_video(tmp_path):
    (tmp_path / "truth.txt").write_text("2,1,10,20,30,40,1,3,1\n2,2,50,20,30,40,0,3,1\n")
    images = [cv2.GaussianBlur(textured_image(seed, 64, 96), (0, 0), 6) for seed in range(4)]
    for number, img in enumerate(images, start=1):
        write_image(tmp_path / "frames" / f"{number}.png", img)
    with video_writer(tmp_path / "clip.mp4", VideoInfo(96, 64, 25, 4), preset="medium") as write:
        for img in images:
            write(img)
    for name in ("frames", "clip.mp4"):
        examples = read_footage(tmp_path / name, tmp_path / "truth.txt", "2:4:2")
        assert len(examples) == 2
        np.testing.assert_array_equal(examples[0].boxes, [(10, 20, 40, 60), (50, 20, 80, 60)])
        assert examples[0].required.tolist() == [True, False]
        assert examples[1].boxes.shape == (0, 4)
        difference = examples[0].read().astype(int) - images[1]
        assert np.abs(difference).mean() < (0.01 if name == "frames" else 5)
    with pytest.raises(ValueError, match="no frame in 7:9"):
        read_footage(tmp_path / "frames", tmp_path / "truth.txt", "7:9")


def test_what_enters_teaches_before_it_is_required(tmp_path):
    img = textured_image(0, 60, 200)
    write_image(tmp_path / "frames" / "1.png", img)
    write_image(tmp_path / "frames" / "2.png", img)
    lines = [
        "1,1,170,10,30,40,0,3,0.4",  # Enters; a third of it is seen.
        "1,2,0,10,30,40,0,3,0.3",
        "1,3,90,10,30,40,0,3,0.4",  # Hidden, not cut by the frame's side.
        "1,4,0,10,30,40,0,3,0.9",  # Never required.
        "1,-1,0,10,30,40,0,3,1",
        "1,5,50,10,30,40,1,3",
        "2,1,150,10,40,40,1,3,0.6", "2,2,0,10,40,40,1,3,0.6", "2,3,90,10,40,40,1,3,0.6",
        "2,-1,0,10,40,40,1,3,1",
    ]  # fmt: skip
    (tmp_path / "truth.txt").write_text("\n".join(line.split("  #")[0] for line in lines))
    example = read_footage(tmp_path / "frames", tmp_path / "truth.txt")[0]
    np.testing.assert_allclose(example.visibility, [0.4, 0.3, 0.4, 0, 0, 1])
    assert example.required.tolist() == [False] * 5 + [True]
    # A seed that leaves the frame as it is.
    seeds = map(np.random.default_rng, range(500))
    views = (random_camera(example, rng) for rng in seeds)
    vehicles = next(own for seen, _, own in views if np.array_equal(seen, img))
    assert vehicles.tolist() == [True, False, False, False, False, True]


def test_boxed_crops_are_the_images_that_have_a_box(tmp_path):
    for number in range(1, 6):
        write_image(tmp_path / "crops" / f"{number}.png", textured_image(number, 64, 64))
    truth = tmp_path / "truth.txt"
    truth.write_text("2,1,10,5,44,50,1,3,1\n3,1,9,9,9,9,0,3,1\n4,1,0,8,60,48,1,3,1\n")
    crops = read_boxed_crops(tmp_path / "crops", truth)
    assert [crop.source.name for crop in crops] == ["2.png", "4.png"]
    assert [crop.boxes.tolist() for crop in crops] == [[[10, 5, 54, 55]], [[0, 8, 60, 56]]]
    assert all(crop.required.tolist() == [True] for crop in crops)
    truth.write_text("9,1,10,5,44,50,1,3,1\n")
    with pytest.raises(ValueError, match="truth.txt: no box for any image of .*crops"):
        read_boxed_crops(tmp_path / "crops", truth)


# -------------------------------------------------------------- augmentation


def test_a_mirrored_box_holds_the_mirrored_pixels():
    img, boxes = textured_image(0, 60, 100), np.array([(10.0, 20, 40, 50)])
    flipped, (box,) = mirrored(img, boxes)
    left, top, right, bottom = box.astype(int)
    np.testing.assert_array_equal(flipped[top:bottom, left:right], img[20:50, 10:40][:, ::-1])
    np.testing.assert_array_equal(mirrored(flipped, box[None])[1], boxes)


def test_a_frame_that_is_cut_shows_less_of_what_it_cuts():
    boxes = np.array([(0.0, 0, 40, 20), (30, 0, 90, 20), (45, 0, 65, 20), (60, 0, 90, 20)])
    visibility = np.array([1, 0.75, 0.5, 1])
    img = textured_image(0, 40, 100)
    cut, inside, left_over = cut_frame(img, boxes, visibility, np.array([0, 0, 0.5, 0]))
    np.testing.assert_array_equal(cut, img[:, :50])
    np.testing.assert_array_equal(inside, [(0, 0, 40, 20), (30, 0, 50, 20), (45, 0, 50, 20)])
    np.testing.assert_allclose(left_over, [1, 0.25, 0.125])
    # A corner: a tenth of the columns and a quarter of the rows.
    cut, inside, left_over = cut_frame(img, boxes, visibility, np.array([0.1, 0.25, 0, 0]))
    np.testing.assert_array_equal(cut, img[10:, 10:])
    np.testing.assert_array_equal(inside[:2], [(0, 0, 30, 10), (20, 0, 80, 10)])
    np.testing.assert_allclose(left_over, [0.375, 0.375, 0.25, 0.5])


@pytest.mark.parametrize(("count", "wanted"), [(3, 6), (10, 10), (40, 10)])
def test_cameras_are_balanced(count, wanted):
    params = TrainingParams(per_camera=10, most_repeats=2)
    examples = [Example(n, np.empty((0, 4)), np.empty(0, bool), np.empty(0)) for n in range(count)]
    sources = [example.source for example in balanced(examples, params)]
    assert len(sources) == wanted
    assert set(sources) == set(range(count)) if count <= 10 else sources == list(range(0, 40, 4))


def test_cameras_are_read_from_a_list(tmp_path):
    path = tmp_path / "cameras.csv"
    path.write_text("camera,footage,truth,frames\na,x,t,1:9\na,y,t,\nb,z,u,\n")
    cameras = read_cameras(path, without=["b"])
    assert [part.path for part in cameras["a"]] == ["x", "y"] and list(cameras) == ["a"]
    assert cameras["a"][0].frames == "1:9"
    with pytest.raises(ValueError, match="no camera c"):
        read_cameras(path, without=["c"])
    path.write_text("camera,footage\na,x\n")
    with pytest.raises(ValueError, match=r"cameras\.csv: no column"):
        read_cameras(path)
    with pytest.raises(FileNotFoundError, match="no such list"):
        read_cameras(tmp_path / "gone.csv")


@settings(max_examples=40)
@given(seed=st.integers(0, 10_000))
def test_any_camera_sees_the_vehicle_in_its_box(seed):
    frame = np.full((180, 320, 3), 128, np.uint8)
    frame[60:120, 120:200] = (255, 255, 0)
    example = Example(frame, np.array([(120.0, 60, 200, 120)]), np.array([True]), np.ones(1))
    img, boxes, vehicles = random_camera(example, np.random.default_rng(seed))
    assert img.dtype == np.uint8 and img.shape[1] <= 320 and len(boxes) <= 1
    for left, top, right, bottom in boxes[vehicles].round().astype(int):
        outside = np.ones(img.shape[:2], bool)
        outside[max(0, top - 3) : bottom + 3, max(0, left - 3) : right + 3] = False
        converted = convert_color(img, "YCrCb")
        inside = converted[top + 4 : bottom - 4, left + 4 : right - 4].reshape(-1, 3)
        rest = converted[outside]
        # Yellow is poor in blue chroma, and gray has none, even when colours are faint.
        assert inside[:, 2].mean() < rest[:, 2].mean() - 5


def test_most_cameras_see_the_vehicle():
    frame = np.zeros((180, 320, 3), np.uint8)
    example = Example(frame, np.array([(120.0, 60, 200, 120)]), np.array([True]), np.ones(1))
    seen = [random_camera(example, np.random.default_rng(seed))[2].any() for seed in range(200)]
    assert np.mean(seen) > 0.9


@settings(max_examples=20)
@given(count=st.integers(0, 12), seed=st.integers(0, 1000))
def test_half_of_the_patches_are_degrade(count, seed):
    patches = np.array([textured_image(seed + i, 80, 80) for i in range(count)], np.uint8)
    patches = patches.reshape(-1, 80, 80, 3)
    seen = degrade(patches, np.random.default_rng(seed))
    assert seen.shape == patches.shape and seen.dtype == np.uint8
    np.testing.assert_array_equal(seen, degrade(patches, np.random.default_rng(seed)))
    for before, after in zip(patches, seen, strict=True):
        # What is light stays light, and where it is stays where it is.
        gray = (
            cv2.GaussianBlur(p, (0, 0), 6).astype(float)[..., 1].ravel() for p in (before, after)
        )
        assert np.corrcoef(*gray)[0, 1] > 0.8


def test_degraded_patches_show_less():
    patches = np.array([textured_image(i, 80, 80) for i in range(200)])
    seen = degrade(patches, np.random.default_rng(0))
    changed = (seen != patches).any(axis=(1, 2, 3))
    # Of that half, three in twenty are left as they are by chance.
    assert 0.3 < changed.mean() < 0.55
    steps = (np.abs(np.diff(p.astype(float), axis=2)).mean() for p in (patches, seen))
    assert np.divide(*steps) > 1.15


@given(count=st.integers(0, 6), seed=st.integers(0, 1000))
def test_parts_and_jittered_boxes(count, seed):
    rng, boxes = np.random.default_rng(seed), boxes_of(seed, count)
    parts = random_parts(boxes, rng)
    areas = (boxes[:, 2:] - boxes[:, :2]).prod(axis=1)
    np.testing.assert_allclose(
        np.diagonal(pairwise_overlap(parts, boxes)), (parts[:, 2:] - parts[:, :2]).prod(axis=1)
    )
    share = np.diagonal(pairwise_overlap(parts, boxes)) / areas
    assert ((share > 0.08) & (share <= 1)).all()
    beside = neighbours(boxes, rng)
    np.testing.assert_allclose(beside[:, 2:] - beside[:, :2], boxes[:, 2:] - boxes[:, :2])
    assert (np.abs(beside - boxes) <= 1.5 * np.tile(boxes[:, 2:] - boxes[:, :2], 2) + 1e-9).all()
    assert (np.diagonal(pairwise_iou(jittered(boxes, 0.03, rng), boxes)) > 0.7).all()


@given(n=st.integers(0, 6), m=st.integers(0, 6), seed=st.integers(0, 1000))
def test_background_overlaps_no_box(n, m, seed):
    windows, boxes = boxes_of(seed, n), boxes_of(seed + 1, m)
    free = is_background(windows, boxes, 0.3, 0.5)
    for window, is_free in zip(windows, free, strict=True):
        rows = window[None]
        iou = pairwise_iou(rows, boxes).max(initial=0)
        share = pairwise_overlap(rows, boxes).max(initial=0)
        assert is_free == (iou < 0.3 and share < 0.5 * (window[2:] - window[:2]).prod())
    np.testing.assert_array_equal(
        best_iou(windows, boxes) == 0, is_background(windows, boxes, 1e-9, 2)
    )


def test_crops_of_any_size_are_taken_whole(tmp_path):
    small = textured_image(0, 64, 64)
    write_image(tmp_path / "small.png", small)
    write_image(
        tmp_path / "large.png", cv2.resize(small, (128, 192), interpolation=cv2.INTER_CUBIC)
    )
    first = [
        random_crop(tmp_path / f"{n}.png", np.random.default_rng(3)) for n in ("small", "large")
    ]
    assert first[0].shape == first[1].shape == (64, 64, 3)
    assert np.corrcoef(first[0][..., 0].ravel(), first[1][..., 0].ravel())[0, 1] > 0.9


@given(seed=st.integers(0, 1000))
def test_the_border_cuts_one_side_of_a_box(seed):
    box = np.array([10.0, 20, 74, 84])
    cut, outside = cut_by_border(box, np.random.default_rng(seed))
    side = int(outside.argmax())
    assert outside.sum() == 1
    others = [i for i in range(4) if i != side]
    np.testing.assert_array_equal(cut[others], box[others])
    axis = side % 2
    assert 0.45 * 64 <= cut[2 + axis] - cut[axis] <= 64


def test_every_border_cuts():
    box = np.array([10.0, 20, 74, 84])
    sides = [cut_by_border(box, np.random.default_rng(seed))[1].argmax() for seed in range(60)]
    assert set(sides) == {0, 1, 2, 3}


@given(n=st.integers(0, 6), m=st.integers(0, 3), seed=st.integers(0, 1000))
def test_shifts_lead_to_the_nearest_vehicle(n, m, seed):
    boxes, vehicles = boxes_of(seed, n), boxes_of(seed + 1, m)
    shifts = edge_shifts(boxes, vehicles, 0.2)
    iou = pairwise_iou(boxes, vehicles)
    assert shifts.shape == (n, 4)
    for box, shift, own in zip(boxes, shifts, iou, strict=True):
        if own.max(initial=0) > 0.2:
            width, height = box[2:] - box[:2]
            moved = box + shift * (width, height, width, height)
            np.testing.assert_allclose(moved, vehicles[own.argmax()])
        else:
            assert np.isnan(shift).all()


@given(count=st.integers(0, 6), shape=st.floats(0.5, 2), seed=st.integers(0, 1000))
def test_windows_around_boxes_have_one_shape_and_their_size(count, shape, seed):
    boxes, rng = boxes_of(seed, count), np.random.default_rng(seed)
    still = windows_around(boxes, shape, 0.0, rng)
    width, height = (still[:, 2:] - still[:, :2]).T
    np.testing.assert_allclose(width, shape * height)
    np.testing.assert_allclose(width * height, (boxes[:, 2:] - boxes[:, :2]).prod(axis=1))
    np.testing.assert_allclose(still[:, :2] + still[:, 2:], boxes[:, :2] + boxes[:, 2:])
    assert (np.diagonal(pairwise_iou(windows_around(boxes, shape, 0.03, rng), still)) > 0.7).all()


def crop_of(box, seed=0):
    img = textured_image(seed, 64, 64)
    return Example(img, np.array([box], float), np.array([True]), np.ones(1))


@pytest.mark.parametrize(
    "box, ends", [((3, 8, 58, 60), (0, 0, 0, 0)), ((0, 8, 58, 60), (1, 0, 0, 0))]
)
def test_a_crop_ends_only_where_it_cuts_the_vehicle(monkeypatch, box, ends):
    moved = np.array([box, (2, 7, 63, 64), (1, 4, 50, 61)], float)
    monkeypatch.setattr(second_stage, "with_moved_edges", lambda *_: np.tile(moved, (3, 1)))
    monkeypatch.setattr(second_stage, "random_camera", lambda e, _: (e.read(), e.boxes, e.required))
    item = crop_of(box), np.random.default_rng(0)
    samples = boxed_crop_samples(item, DEFAULT_TRAINING)
    windows = on_whole_pixels(np.tile(moved, (3, 1)))
    size = np.tile(windows[:, 2:] - windows[:, :2], 2)
    np.testing.assert_allclose(windows + samples.shifts * size, np.tile(box, (9, 1)))
    outside = margins_outside(windows, (64, 64))
    # All margins lie outside of the picture on the left, some of them below and on the right.
    assert (outside[:, 0] > 0).all() and (outside[:, 2:].max(axis=0) > 0).all()
    np.testing.assert_allclose(samples.features[:, -4:], outside * ends, atol=1e-3)
    # It tells edges, and nothing of what is no vehicle.
    assert (samples.labels == -1).all()


def test_every_boxed_crop_is_looked_at_eight_times(monkeypatch):
    learned = []
    monkeypatch.setattr(second_stage, "fit_machine", lambda samples, *_: learned.append(samples))
    crops = [crop_of((6, 8, 58, 60), seed) for seed in range(3)]
    train_second_stage(TrainingSet([], [], [], crops, []), (), 0, 1, DEFAULT_TRAINING)
    features = learned[0].features
    assert features.shape[1] == N_FEATURES and len(features) == len(learned[0].shifts)
    # Three windows each; of some the cut frame leaves too little.
    assert 0.6 * 72 < len(features) <= 72
    assert len(np.unique(features, axis=0)) == len(features)


def test_windows_on_vehicles_tell_edges_and_others_do_not(scenes, detector):
    (example,) = read_footage(scenes / "train", scenes / "train.txt", "3:3")
    samples = shift_samples((example, np.random.default_rng(5)), detector.templates, SMALL)
    assert len(samples) > 0
    for i, cells, shift in samples:
        assert cells.shape == (*context_shape(WINDOW_COLUMNS[i]), CELL_FEATURES)
        assert np.isfinite(shift).all() and np.abs(shift).max() < 1.5
    none = replace(example, required=example.required & False, visibility=0 * example.visibility)
    assert shift_samples((none, np.random.default_rng(5)), detector.templates, SMALL) == []


def test_a_frame_teaches_vehicles_background_and_edges(scenes, detector):
    (example,) = read_footage(scenes / "train", scenes / "train.txt", "3:3")
    templates = detector.templates
    item = example, np.random.default_rng(5)
    img, boxes, labels, shifts = frame_boxes(item, templates, None, SMALL)
    assert {0, 1} <= set(labels.tolist()) <= {-1, 0, 1}
    seen, vehicles, required = random_camera(example, np.random.default_rng(5))
    np.testing.assert_array_equal(img, seen)
    iou = best_iou(boxes, vehicles[required])
    assert (iou[labels == 1] > SMALL.vehicle_iou).all()
    assert (iou[labels == 0] < SMALL.background_iou).all()
    np.testing.assert_array_equal(np.isnan(shifts[:, 0]), iou <= SMALL.background_iou)
    samples = frame_samples((example, np.random.default_rng(5)), templates, None, SMALL)
    np.testing.assert_array_equal(samples.labels, labels)
    _, moved, *_ = frame_boxes((example, np.random.default_rng(5)), templates, detector, SMALL)
    np.testing.assert_array_equal(moved[: len(boxes)], boxes)
    again = on_whole_pixels(refine(img, boxes, detector).boxes)
    np.testing.assert_allclose(moved[len(boxes) :], again)
    hard = frame_samples((example, np.random.default_rng(5)), templates, detector, SMALL)
    scores = detector.machine.predict(hard.features.astype(np.float32))[:, 0]
    assert (hard.labels >= 0).all()
    assert (scores * (2 * hard.labels - 1) < SMALL.sure_score + 0.02).all()
    assert 0 < len(hard.labels) < 2 * (labels >= 0).sum()


# ------------------------------------------------------------------- fitting


def test_a_window_that_lies_on_cells_has_the_cells_of_the_frame():
    img = textured_image(3, 120, 160)
    cells = cell_features(img)
    size = WINDOW_ROWS * WINDOW_CELL
    left, top = 10 * WINDOW_CELL, 8 * WINDOW_CELL
    own = window_features(img, (left, top, left + size, top + size), WINDOW_ROWS)
    np.testing.assert_allclose(own, cells[8:16, 10:18], atol=1e-6)


def test_a_window_with_its_context_has_the_cells_around_it():
    img = textured_image(3, 120, 200)
    size = WINDOW_ROWS * WINDOW_CELL
    left, top = 15 * WINDOW_CELL, 10 * WINDOW_CELL
    box = (left, top, left + size, top + size)
    around = window_features(img, box, WINDOW_ROWS, WINDOW_CONTEXT)
    assert around.shape == (*context_shape(WINDOW_ROWS), CELL_FEATURES)
    np.testing.assert_allclose(around, cell_features(img)[7:21, 12:26], atol=1e-6)


def test_templates_move_edges_by_what_was_found():
    rng, templates = np.random.default_rng(0), random_detector(0).templates
    samples = []
    for i in np.repeat(range(4), 60):
        cells = rng.random((*context_shape(WINDOW_COLUMNS[i]), CELL_FEATURES))
        samples.append((i, cells.astype(np.float16), 0.1 * i + 0.2 * cells[1, 2, :4]))
    moving = with_shifts(templates, samples, alpha=1.0)
    for i, cells, shift in samples:
        found = np.tensordot(cells.astype(float), moving[i].shift_weights, 3) + moving[i].shift_bias
        np.testing.assert_allclose(found, shift, atol=0.02)
    for old, new in zip(templates, moving, strict=True):
        np.testing.assert_array_equal(old.weights, new.weights)
    with pytest.raises(ValueError, match="give more footage"):
        with_shifts(templates, samples[:60], alpha=1.0)


def test_a_template_folds_its_scaling():
    rng = np.random.default_rng(0)
    features = rng.normal(4, 3, size=(60, WINDOW_ROWS * 8 * 2)).astype(np.float32)
    labels = (features[:, 5] > 4).astype(int)
    template = fit_template(features, labels, 8, C=1.0, seed=0)
    scores = (features * template.weights.ravel()).sum(axis=1) + template.bias
    assert template.weights.shape == (WINDOW_ROWS, 8, 2)
    assert not template.shift_weights.any() and not template.shift_bias.any()
    assert ((scores > 0) == labels).mean() > 0.95


def samples_of(features, labels, shifts):
    return PatchSamples(features.astype(np.float16), labels, shifts)


@pytest.mark.parametrize("C", [0.01, 0.1, 1])
def test_the_machine_learns_what_is_not_linear(C):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, 1500, 1))
    features = np.repeat(np.hstack([x, y]), 150, axis=1) + rng.normal(0, 0.1, size=(1500, 300))
    features = features.astype(np.float32)
    radius = np.hypot(x, y)[:, 0]
    labels = (radius > 1.2).astype(int)
    shifts = np.stack([radius, -radius, radius**2, np.zeros(1500)], axis=1) / 10
    # Of some it is not known what they are, of others not where their edges are.
    known = labels.copy()
    known[:100] = -1
    given = np.where(np.arange(1500)[:, None] % 3 > 0, shifts, np.nan)
    samples = samples_of(features[:1000], known[:1000], given[:1000])
    machine = fit_machine(samples, np.random.default_rng(1), TrainingParams(machine_C=C))
    outputs = machine.predict(features[1000:])
    assert outputs.shape == (500, 5) and outputs.dtype == np.float32
    assert ((outputs[:, 0] > 0) == labels[1000:]).mean() > (0.9 if C == 0.1 else 0.6)
    error = np.abs(outputs[:, 1:] - shifts[1000:]).mean()
    assert error < 0.3 * np.abs(shifts[1000:] - shifts.mean(axis=0)).mean()
    median = np.median(machine.predict(features[100:1000])[labels[100:1000] > 0, 0])
    np.testing.assert_allclose(median, 1.5, rtol=2e-2)


def test_the_map_is_that_of_nystroem():
    rng = np.random.default_rng(3)
    samples, centers = rng.normal(size=(2, 90, 6)).astype(np.float32)
    mapped = kernel_map(samples, centers, 0.1, kernel_factor(centers, 0.1), n_rows=40)
    expected = Nystroem(gamma=0.1, n_components=90).fit(centers).transform(samples)
    np.testing.assert_allclose(mapped @ mapped.T, expected @ expected.T, atol=2e-3)


def test_shifts_are_ridge_regression_on_scaled_features():
    rng = np.random.default_rng(2)
    features = (rng.normal(5, 3, size=(400, 30)) * np.linspace(3, 0.1, 30)).astype(np.float32)
    shifts = features[:, :4] / 50 + rng.normal(0, 0.01, size=(400, 4))
    weights, bias = fit_shifts(features, shifts, alpha=10)
    expected = make_pipeline(StandardScaler(), Ridge(alpha=10)).fit(features, shifts)
    np.testing.assert_allclose(features @ weights + bias, expected.predict(features), atol=1e-3)


@pytest.mark.parametrize("C", [0.01, 1.0])
def test_the_svm_is_that_of_liblinear(C):
    rng = np.random.default_rng(4)
    features = rng.normal(size=(600, 20)).astype(np.float32)
    labels = (features[:, 0] + 0.5 * rng.normal(size=600) > 0.8).astype(int)
    svm = LinearSVC(C=C, dual=False, class_weight="balanced", tol=1e-8).fit(features, labels)
    coef, intercept = fit_linear_svm(features, labels, C)
    np.testing.assert_allclose(coef, svm.coef_[0], atol=2e-3)
    assert intercept == pytest.approx(svm.intercept_[0], abs=2e-3)


def test_clusters_or_the_samples_themselves():
    rng = np.random.default_rng(0)
    middles = np.array([(0, 0), (10, 0), (0, 10)])
    samples = (middles[:, None] + rng.normal(0, 0.1, size=(3, 200, 2))).reshape(-1, 2)
    centers = cluster_centers(samples, 60)
    assert centers.shape == (60, 2)
    to_middle = np.linalg.norm(centers[:, None] - middles[None], axis=2)
    assert to_middle.min(axis=1).max() < 0.5
    assert set(to_middle.argmin(axis=1).tolist()) == {0, 1, 2}
    np.testing.assert_array_equal(cluster_centers(samples[:50], 60), samples[:50])


# ---------------------------------------------------------------- end to end


# As small as still finds something.
SMALL = TrainingParams(
    per_camera=14, most_repeats=1, machine_size=(50, 300), mining_rounds=1,
)  # fmt: skip


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """Some rendered scenes with their truth, and three more for testing."""
    folder = tmp_path_factory.mktemp("rendered")
    rows = {"train": [], "test": []}
    for seed in range(17):
        part = "train" if seed < 14 else "test"
        frame, truth = render(random_scene(seed + 300), 0.0)
        number = seed + 1 if part == "train" else seed - 13
        write_image(folder / part / f"{number:03d}.png", frame)
        rows[part] += truth_rows(number, truth)
    for part, text in rows.items():
        (folder / f"{part}.txt").write_text("".join(text))
    return folder


def trained(scenes):
    """A detector of the scenes."""
    examples = balanced(read_footage(scenes / "train", scenes / "train.txt"), SMALL)
    return train_detector(TrainingSet(examples, [], [], [], []), jobs=1, params=SMALL)


@pytest.fixture(scope="module")
def detector(scenes):
    return trained(scenes)


def test_a_detector_of_rendered_scenes_finds_vehicles_in_others(scenes, detector):
    vehicle = TwoStageVehicle(None, detector, STILL_PARAMS)
    found = []
    for path in find_images(scenes / "test"):
        vehicle.reset()
        found.append(vehicle.detect(read_image(path)).boxes)
    figures = evaluate(read_rows(scenes / "test.txt"), rows_of(found))
    # Fourteen scenes are few: one vehicle in three, where chance would find none.
    assert figures["recall"] > 0.33 and figures["precision"] > 0.5
    assert figures["mean IoU"] > 0.65


def test_the_same_seed_trains_the_same_detector(scenes, detector):
    again = trained(scenes)
    for one, other in zip(detector.templates, again.templates, strict=True):
        np.testing.assert_allclose(one.weights, other.weights, atol=1e-5)
        np.testing.assert_allclose(one.shift_weights, other.shift_weights, atol=1e-5)
    one, other = detector.machine, again.machine
    np.testing.assert_allclose(one.weights, other.weights, rtol=0.05, atol=0.01)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("gone.mp4", "truth.txt"), "gone.mp4: no such"),
        (("frames", "gone.txt"), "gone.txt: no such file of boxes"),
        (("frames", "truth.txt", "5:6"), "no frame in 5:6"),
        (("frames", "truth.txt", "1:1"), "give more footage"),
    ],
)
def test_bad_input_is_named(tmp_path, arguments, message):
    (tmp_path / "truth.txt").write_text("1,1,10,20,30,40,1,3,1\n")
    write_image(tmp_path / "frames/1.png", textured_image(0, 64, 96))
    given = [tmp_path / arguments[0], tmp_path / arguments[1], *arguments[2:]]
    command = [
        *TRAIN, "--footage", *given, "--out", tmp_path / "d.npz",
    ]  # fmt: skip
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 1 and message in result.stderr.splitlines()[-1]
    assert result.stderr.splitlines()[-1].startswith("error: ")
