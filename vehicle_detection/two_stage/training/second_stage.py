"""Training of the second stage: patches of vehicles and of everything else."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from vehicle_detection.compiled.processes import in_parallel
from vehicle_detection.parameters import ScanParams
from vehicle_detection.tracking.boxes import best_iou, pairwise_iou
from vehicle_detection.two_stage.features import (
    N_BORDERS,
    cut_patches,
    describe_for_regressor,
    describe_for_scorer,
    luma_and_chroma,
    margins_outside,
    on_whole_pixels,
)
from vehicle_detection.two_stage.refinement import move_boxes, score_boxes
from vehicle_detection.two_stage.training.augmentation import (
    degrade,
    random_camera,
    random_crop,
)
from vehicle_detection.two_stage.training.first_stage import proposals_of
from vehicle_detection.two_stage.training.footage import with_generators
from vehicle_detection.two_stage.training.kernel_machines import fit_regressor, fit_scorer
from vehicle_detection.two_stage.training.sampling import (
    cut_by_border,
    is_background,
    neighbours,
    random_parts,
    with_moved_edges,
)

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams
    from vehicle_detection.two_stage.model import KernelMachine
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


def edge_samples(item: tuple, templates: tuple, params: TrainingParams) -> tuple:
    """Patches around the vehicles of a frame, and the shifts of their edges.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)
    templates : tuple of Template
    params : TrainingParams

    Returns
    -------
    features : ndarray of float16, shape (n, n_features)
    shifts : ndarray of float, shape (n, 4)
        In widths and heights of the patch's box.
    """
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    windows = candidates(img, boxes, required, templates, rng)
    return _edges(img, windows, boxes[required], (np.ones(N_BORDERS), params), rng)


def crop_edge_samples(item: tuple, params: Any) -> tuple:
    """As `edge_samples`, of a vehicle that was cut out of a frame with a margin."""
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    # What cut the vehicle may as well have been the end of the frame; beyond a margin it goes on.
    ends = (margins_outside(boxes, img.shape) == 1).any(axis=0)
    return _edges(img, with_moved_edges(boxes[required], rng), boxes[required], (ends, params), rng)


def _edges(img, windows, vehicles, ends_and_params, rng):
    """Windows around vehicles as `edge_samples`; ends are 0 on sides where no frame ends."""
    ends, params = ends_and_params
    windows = on_whole_pixels(windows[best_iou(windows, vehicles) > params.background_iou])
    own = np.empty((0, 4))
    if len(windows):
        own = vehicles[pairwise_iou(windows, vehicles).argmax(axis=1)]
    size = np.tile(windows[:, 2:] - windows[:, :2], 2)
    outside = margins_outside(windows, img.shape) * ends
    planes = luma_and_chroma(degrade(cut_patches(img, windows), rng))
    return describe_for_regressor(planes, outside).astype(np.float16), (own - windows) / size


def train_regressor(
    training_set: TrainingSet, templates: tuple, seed: int, jobs: int, params: Any
) -> KernelMachine:
    """From patches around vehicles to the shifts of their edges, a KernelMachine."""
    items = with_generators(training_set.examples, seed, 4)
    crops = with_generators(params.crop_views * training_set.boxed_crops, seed, 9)
    of_frames = partial(edge_samples, templates=templates, params=params)
    of_crops = partial(crop_edge_samples, params=params)
    found = [
        *in_parallel(of_frames, items, jobs, "edges"),
        *in_parallel(of_crops, crops, jobs, "boxed crops"),
    ]
    features, shifts = map(np.concatenate, zip(*found, strict=True))
    print(f"edges: {len(features)} patches")
    return fit_regressor(features, shifts, np.random.default_rng([seed, 5]), params)


def patch_samples(item: tuple, machines: tuple, params: TrainingParams) -> tuple:
    """Patches of a frame where the regressor has moved them, vehicles and background.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)
    machines : (templates, regressor, scorer)
        With a scorer, what it is already sure of, and right, is left out; it may be None.
    params : TrainingParams

    Returns
    -------
    features : ndarray of float16, shape (n, n_features)
    labels : ndarray of int, shape (n,)
    """
    example, rng = item
    templates, regressor, scorer = machines
    img, boxes, required = random_camera(example, rng)
    windows, labels = clear_windows(img, boxes, required, (templates, regressor), rng, params)
    planes = luma_and_chroma(degrade(cut_patches(img, windows), rng))
    features = describe_for_scorer(planes, margins_outside(windows, img.shape))
    if scorer is not None:
        hard = scorer.predict(features)[:, 0] * (2 * labels - 1) < params.sure_score
        features, labels = features[hard], labels[hard]
    return features.astype(np.float16), labels


def clear_windows(
    img: np.ndarray,
    boxes: np.ndarray,
    required: np.ndarray,
    machines: tuple,
    rng: np.random.Generator,
    params: TrainingParams,
) -> tuple:
    """Candidates of a frame where the regressor has moved them: clear vehicles, clear background.

    Returns
    -------
    windows : ndarray of float, shape (n, 4)
    labels : ndarray of int, shape (n,)
    """
    templates, regressor = machines
    proposed = candidates(img, boxes, required, templates, rng)
    windows = move_boxes(img, proposed, regressor)
    iou = best_iou(windows, boxes[required])
    # A part of a vehicle is none, or it would be found beside the whole.
    is_other = (iou < params.background_iou) & is_background(windows, boxes[~required], 0.3, 0.5)
    clear = (iou > params.vehicle_iou) | is_other
    return windows[clear], (iou[clear] > params.vehicle_iou).astype(int)


def crop_samples(item: tuple, params: TrainingParams) -> tuple:
    """Patches of an image of the training set, as `patch_samples`.

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
    planes = luma_and_chroma(degrade(cut_patches(img, boxes), rng))
    features = describe_for_scorer(planes, all_outside).astype(np.float16)
    return features, np.array([label, label, *np.zeros(len(parts), int)])


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
    for example, rng in with_generators(examples, seed, 10):
        img, boxes, required = random_camera(example, rng)
        windows, labels = clear_windows(
            img, boxes, required, (detector.templates, detector.regressor), rng, params
        )
        found.append(
            (cut_patches(img, windows), labels, score_boxes(img, windows, detector.scorer))
        )
    patches, labels, scores = map(np.concatenate, zip(*found, strict=True))
    return patches, labels, scores


def train_scorer(
    training_set: TrainingSet, machines: tuple, seed: int, jobs: int, params: TrainingParams
) -> KernelMachine:
    """From patches to vehicle or not, a KernelMachine, with one round of hard patches.

    Parameters
    ----------
    training_set : TrainingSet
    machines : (templates, regressor)
    seed, jobs : int
    params : TrainingParams

    Returns
    -------
    scorer : KernelMachine
    """
    images = [(path, 1) for path in 2 * (training_set.crops + training_set.square_crops)]
    images += [(path, 0) for path in training_set.non_vehicles]
    of_images = partial(crop_samples, params=params)
    found = list(in_parallel(of_images, with_generators(images, seed, 6), jobs, "images"))
    scorer: Any = None
    for mining in range(2):
        items = with_generators(training_set.examples, seed, 7, mining)
        of_frames = partial(patch_samples, machines=(*machines, scorer), params=params)
        found += in_parallel(of_frames, items, jobs, "patches")
        features, labels = map(np.concatenate, zip(*found, strict=True))
        rng = np.random.default_rng([seed, 8])
        chosen = rng.permutation(len(labels))[: params.most_patches]
        scorer = fit_scorer(features[chosen], labels[chosen], rng, params)
    return scorer
