"""Training of the second stage: patches of vehicles and of everything else."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from vehicle_detection.compiled.processes import in_parallel
from vehicle_detection.parameters import ScanParams
from vehicle_detection.tracking.boxes import best_iou
from vehicle_detection.two_stage.features import (
    N_BORDERS,
    cut_patches,
    describe_patches,
    margins_outside,
    on_whole_pixels,
)
from vehicle_detection.two_stage.model import Detector
from vehicle_detection.two_stage.refinement import refine
from vehicle_detection.two_stage.training.augmentation import (
    degrade,
    random_camera,
    random_crop,
)
from vehicle_detection.two_stage.training.first_stage import proposals_of
from vehicle_detection.two_stage.training.footage import with_generators
from vehicle_detection.two_stage.training.machines import fit_machine
from vehicle_detection.two_stage.training.sampling import (
    PatchSamples,
    cut_by_border,
    edge_shifts,
    is_background,
    joined,
    neighbours,
    random_parts,
    with_moved_edges,
)

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams
    from vehicle_detection.two_stage.training.footage import TrainingSet

CANDIDATE_SCAN = ScanParams(
    threshold=-1.0, cells_per_step=1, n_groups=1, n_proposals=4, overlap=0.6
)


def candidates(
    img: np.ndarray,
    boxes: np.ndarray,
    required: np.ndarray,
    templates: tuple,
    rng: np.random.Generator,
) -> np.ndarray:
    """Proposals of a frame and its vehicles with edges moved at random.

    Those that may be neither vehicle nor background are left out.

    Returns
    -------
    windows : ndarray of float, shape (n, 4)
    """
    windows = proposals_of(img, templates, CANDIDATE_SCAN)
    vehicles = boxes[required]
    moved = with_moved_edges(vehicles, rng)
    parts = [random_parts(vehicles, rng) for _ in range(2)]
    windows = np.concatenate([windows, moved, *parts, neighbours(vehicles, rng)])
    clear = is_background(windows, boxes[~required], 0.3, 0.5)
    return windows[clear | (best_iou(windows, vehicles) > 0.5)]


def frame_boxes(item: tuple, templates: tuple, detector: Any, params: TrainingParams) -> tuple:
    """Boxes of a frame to learn from, as another camera might have taken it.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)
    templates : tuple of Template
    detector : Detector or None
        Every box is learned from where it leaves it, too: tracks look there again.
    params : TrainingParams

    Returns
    -------
    img : ndarray of uint8, shape (rows, columns, 3)
    boxes : ndarray of float, shape (n, 4)
    labels, shifts : ndarray
        See `PatchSamples`.
    """
    example, rng = item
    img, vehicles, required = random_camera(example, rng)
    boxes = on_whole_pixels(candidates(img, vehicles, required, templates, rng))
    if detector is not None:
        boxes = np.concatenate([boxes, on_whole_pixels(refine(img, boxes, detector).boxes)])
    iou = best_iou(boxes, vehicles[required])
    # A part of a vehicle is none, or it would be found beside the whole.
    is_other = (iou < params.background_iou) & is_background(boxes, vehicles[~required], 0.3, 0.5)
    labels = np.select([iou > params.vehicle_iou, is_other], [1, 0], -1)
    return img, boxes, labels, edge_shifts(boxes, vehicles[required], params.background_iou)


def frame_samples(
    item: tuple, templates: tuple, detector: Any, params: TrainingParams
) -> PatchSamples:
    """Patches of a frame, see `frame_boxes`; with a detector, only what it is not sure of."""
    img, boxes, labels, shifts = frame_boxes(item, templates, detector, params)
    patches = degrade(cut_patches(img, boxes), item[1])
    features = describe_patches(patches, margins_outside(boxes, img.shape))
    samples = PatchSamples(features.astype(np.float16), labels, shifts)
    if detector is None:
        return samples
    right = np.where(labels == 1, 1, -1) * detector.machine.predict(features)[:, 0]
    return samples.only((labels >= 0) & (right < params.sure_score))


def boxed_crop_samples(item: tuple, params: TrainingParams) -> PatchSamples:
    """A vehicle that was cut out of a frame with a margin: it tells where its edges are."""
    example, rng = item
    img, vehicles, required = random_camera(example, rng)
    boxes = on_whole_pixels(with_moved_edges(vehicles[required], rng))
    # What cut the vehicle may as well have been the end of the frame; beyond a margin it goes on.
    ends = (margins_outside(vehicles, img.shape) == 1).any(axis=0)
    patches = degrade(cut_patches(img, boxes), rng)
    features = describe_patches(patches, margins_outside(boxes, img.shape) * ends)
    shifts = edge_shifts(boxes, vehicles[required], params.background_iou)
    return PatchSamples(features.astype(np.float16), np.full(len(boxes), -1), shifts)


def crop_samples(item: tuple, params: TrainingParams) -> PatchSamples:
    """Patches of an image of the training set.

    It is taken whole, as if it were cut by the frame's border, and, if it shows a vehicle, in
    parts that are none.

    Parameters
    ----------
    item : ((path, label), numpy.random.Generator)
    params : TrainingParams
    """
    (path, label), rng = item
    img = random_crop(path, rng)
    whole = np.array([0.0, 0.0, len(img), len(img)])
    cut, outside = cut_by_border(whole, rng)
    parts = random_parts(np.tile(whole, (2 * label, 1)), rng)
    parts = parts[best_iou(parts, whole[None]) < params.background_iou]
    boxes = np.concatenate([[whole, cut], parts])
    all_outside = np.zeros((len(boxes), N_BORDERS))
    all_outside[1] = outside
    features = describe_patches(degrade(cut_patches(img, boxes), rng), all_outside)
    labels = np.array([label, label, *np.zeros(len(parts), int)])
    return PatchSamples(features.astype(np.float16), labels, np.full((len(boxes), 4), np.nan))


def scored_patches(examples: list, detector: Any, seed: int, params: TrainingParams) -> tuple:
    """Patches of some frames as the second stage sees them, to be drawn.

    Parameters
    ----------
    examples : list of Example
    detector : Detector
    seed : int
    params : TrainingParams

    Returns
    -------
    patches : ndarray of uint8, shape (n, side, side, 3)
        RGB.
    labels : ndarray of int, shape (n,)
    scores : ndarray of float, shape (n,)
    """
    found = []
    for item in with_generators(examples, seed, 10):
        img, boxes, labels, _ = frame_boxes(item, detector.templates, None, params)
        boxes, labels = boxes[labels >= 0], labels[labels >= 0]
        patches = cut_patches(img, boxes)
        features = describe_patches(patches, margins_outside(boxes, img.shape))
        found.append((patches, labels, detector.machine.predict(features)[:, 0]))
    patches, labels, scores = map(np.concatenate, zip(*found, strict=True))
    return patches, labels, scores


def train_second_stage(
    training_set: TrainingSet, templates: tuple, seed: int, jobs: int, params: TrainingParams
) -> Detector:
    """The second stage, with one round of hard patches, beside the first.

    Parameters
    ----------
    training_set : TrainingSet
    templates : tuple of Template
    seed, jobs : int
    params : TrainingParams

    Returns
    -------
    detector : Detector
    """
    images = [(path, 1) for path in 2 * (training_set.crops + training_set.square_crops)]
    images += [(path, 0) for path in training_set.non_vehicles]
    boxed = with_generators(params.crop_views * training_set.boxed_crops, seed, 9)
    samples = [
        *in_parallel(
            partial(crop_samples, params=params), with_generators(images, seed, 6), jobs, "images"
        ),
        *in_parallel(partial(boxed_crop_samples, params=params), boxed, jobs, "boxed crops"),
    ]
    detector: Any = None
    for mining in range(2):
        items = with_generators(training_set.examples, seed, 7, mining)
        of_frames = partial(frame_samples, templates=templates, detector=detector, params=params)
        samples = [joined([*samples, *in_parallel(of_frames, items, jobs, "patches")])]
        machine = fit_machine(samples[0], np.random.default_rng([seed, 8]), params)
        detector = Detector(templates, machine)
    return detector
