"""Training of the first stage: windows of vehicles and of everything else, hard negatives."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC
from tqdm.auto import tqdm

from vehicle_detection.compiled.processes import in_parallel
from vehicle_detection.parameters import DEFAULT_ROAD, DEFAULT_SCAN, ScanParams
from vehicle_detection.two_stage.features import CELL_FEATURES, cut_out
from vehicle_detection.two_stage.model import Template
from vehicle_detection.two_stage.proposals import (
    SURROUNDINGS,
    WINDOW_CELL,
    WINDOW_COLUMNS,
    WINDOW_CONTEXT,
    WINDOW_ROWS,
    cell_features,
    level_groups,
    propose,
)
from vehicle_detection.two_stage.road import prior_road, reach
from vehicle_detection.two_stage.training.augmentation import random_camera, random_crop
from vehicle_detection.two_stage.training.footage import with_generators
from vehicle_detection.two_stage.training.machines import fit_shifts
from vehicle_detection.two_stage.training.sampling import (
    edge_shifts,
    is_background,
    jittered,
    windows_around,
)

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams
    from vehicle_detection.two_stage.road import Reach
    from vehicle_detection.two_stage.training.footage import TrainingSet

# Hard negatives: the best windows of each scale.
MINING_SCAN = ScanParams(threshold=-0.5, cells_per_step=1, n_groups=1, n_proposals=3, overlap=0.6)
# A vehicle is one for a template whose shape differs by no more than this factor.
_SHAPE_TOLERANCE = 1.35


class WindowSamples:
    """Features of vehicles and of background, for each of the templates."""

    def __init__(self):
        self._features = [[] for _ in WINDOW_COLUMNS]
        self._labels = [[] for _ in WINDOW_COLUMNS]

    def add(self, samples: Iterable) -> None:
        """More windows: (index of the template, features, label) each."""
        for template, features, label in samples:
            self._features[template].append(features.ravel())
            self._labels[template].append(label)

    def fit(self, seed: int, C: float) -> tuple:
        """A linear SVM for each template; scaling is folded into its weights."""
        return tuple(
            fit_template(np.array(features), np.array(labels), columns, C, seed)
            for features, labels, columns in zip(
                self._features, self._labels, WINDOW_COLUMNS, strict=True
            )
        )


def fit_template(
    features: np.ndarray, labels: np.ndarray, columns: int, C: float, seed: int
) -> Template:
    """Template of a linear SVM that moves no edges; scaling is folded into its weights."""
    if len(set(labels.tolist())) < 2:
        raise ValueError("windows of vehicles or of anything else are missing: give more footage")
    scaler = StandardScaler().fit(features)
    svm = LinearSVC(C=C, random_state=seed, dual=True).fit(scaler.transform(features), labels)
    weights = svm.coef_[0] / scaler.scale_
    bias = float(svm.intercept_[0] - weights @ scaler.mean_)
    no_shifts = np.zeros((*context_shape(columns), CELL_FEATURES, 4), np.float32)
    return Template(
        weights.reshape(WINDOW_ROWS, columns, -1).astype(np.float32), bias,
        no_shifts, np.zeros(4, np.float32),
    )  # fmt: skip


def context_shape(columns: int) -> tuple:
    """Rows and columns of a window with its context, in cells."""
    return WINDOW_ROWS + 2 * WINDOW_CONTEXT, columns + 2 * WINDOW_CONTEXT


def window_features(img: np.ndarray, box: np.ndarray, columns: int, context: int = 0) -> np.ndarray:
    """Cells of a window of a template's shape and of its context, cut out of the frame."""
    left, top, right, bottom = box
    x, y = (right - left) / columns, (bottom - top) / WINDOW_ROWS
    # What its cells are held against, and one more: gradients at a cut edge are those of nowhere.
    beyond = SURROUNDINGS // 2 + 1
    margin = context + beyond
    size = (columns + 2 * margin) * WINDOW_CELL, (WINDOW_ROWS + 2 * margin) * WINDOW_CELL
    x, y = margin * x, margin * y
    whole = np.rint([left - x, top - y, right + x, bottom + y]).astype(int).tolist()
    return cell_features(cut_out(img, whole, size))[beyond:-beyond, beyond:-beyond]


def crop_windows(training_set: TrainingSet, rng: np.random.Generator) -> Iterator:
    """Yield the training set's images as windows, see `WindowSamples.add`."""
    # Crops show cars, and no car is higher than wide.
    shapes_of_cars = [i for i, columns in enumerate(WINDOW_COLUMNS) if columns >= WINDOW_ROWS]
    shapes = dict.fromkeys(training_set.crops, shapes_of_cars)
    shapes |= dict.fromkeys(training_set.square_crops, [WINDOW_COLUMNS.index(WINDOW_ROWS)])
    for path, templates in tqdm(shapes.items(), "crops", unit="image"):
        img = random_crop(path, rng)
        for i in templates:
            size = WINDOW_COLUMNS[i] * WINDOW_CELL, WINDOW_ROWS * WINDOW_CELL
            yield i, cell_features(cv2.resize(img, size, interpolation=cv2.INTER_AREA)), 1
    for path in tqdm(training_set.non_vehicles, "non-vehicles", unit="image"):
        img = random_crop(path, rng)
        crop_side = len(img)
        for i, columns in enumerate(WINDOW_COLUMNS):
            longer = max(columns, WINDOW_ROWS)
            height, width = (crop_side * side // longer for side in (WINDOW_ROWS, columns))
            top, left = (rng.integers(0, crop_side - side + 1) for side in (height, width))
            size = columns * WINDOW_CELL, WINDOW_ROWS * WINDOW_CELL
            part = img[top : top + height, left : left + width]
            cut = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
            yield i, cell_features(cut), 0


def frame_windows(item: tuple, params: TrainingParams) -> list:
    """Windows of a frame: its vehicles, and its surroundings at random.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)
    params : TrainingParams

    Returns
    -------
    samples : list
        See `WindowSamples.add`.
    """
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    return [
        *vehicle_windows(img, boxes[required], rng, params.window_jitter),
        *surrounding_windows(img, boxes, rng, params.n_random),
    ]


def vehicle_windows(
    img: np.ndarray, boxes: np.ndarray, rng: np.random.Generator, jitter: float
) -> Iterator:
    """Yield vehicles of a frame, for the templates whose shape is near theirs."""
    for box in np.concatenate([jittered(boxes, jitter, rng) for _ in range(2)]):
        for i in templates_of(box):
            yield i, window_features(img, box, WINDOW_COLUMNS[i]), 1


def templates_of(box: np.ndarray) -> list:
    """Indices of the templates that a vehicle is one for."""
    shape = (box[2] - box[0]) / (box[3] - box[1])
    off = np.abs(np.log(shape * WINDOW_ROWS / np.array(WINDOW_COLUMNS)))
    return np.flatnonzero(off < np.log(_SHAPE_TOLERANCE)).tolist()


def surrounding_windows(
    img: np.ndarray, boxes: np.ndarray, rng: np.random.Generator, count: int
) -> Iterator:
    """Yield windows of a frame with no vehicle in them, at random."""
    rows, columns = img.shape[:2]
    where = prior_reach(rows)
    for i, window_columns in enumerate(WINDOW_COLUMNS):
        sizes = np.log([DEFAULT_SCAN.smallest, DEFAULT_SCAN.largest])
        height = np.exp(rng.uniform(*sizes, count)) * columns / DEFAULT_SCAN.reference_width
        half = np.stack([height * window_columns / WINDOW_ROWS, height], axis=1) / 2
        x = rng.uniform(0, columns, count)
        low = where.horizon[0] + (where.ratio[0] - 0.5) * height
        y = rng.uniform(low, where.horizon[1] + (where.ratio[1] - 0.5) * height)
        middle = np.stack([x, y], axis=1)
        windows = np.hstack([middle - half, middle + half])
        for window in windows[is_background(windows, boxes, 0.3, 0.3)]:
            yield i, window_features(img, window, window_columns), 0


def mined_windows(item: tuple, templates: tuple) -> list:
    """What the first stage takes for vehicles in a frame and is background, as `frame_windows`."""
    example, rng = item
    img, boxes, _ = random_camera(example, rng)
    windows = proposals_of(img, templates, MINING_SCAN)
    samples = []
    for window in windows[is_background(windows, boxes, 0.35, 0.6)]:
        i = nearest_template(window)
        samples.append((i, window_features(img, window, WINDOW_COLUMNS[i]), 0))
    return samples


def nearest_template(window: np.ndarray) -> int:
    """Index of the template whose shape is nearest to that of a window."""
    shape = (window[2] - window[0]) / (window[3] - window[1])
    return int(np.argmin(np.abs(np.array(WINDOW_COLUMNS) / WINDOW_ROWS - shape)))


def shift_samples(item: tuple, templates: tuple, params: TrainingParams) -> list:
    """Windows on and around the vehicles of a frame, and where their edges are from there.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)
    templates : tuple of Template
        That move no edges.
    params : TrainingParams

    Returns
    -------
    samples : list of (int, ndarray, ndarray)
        Index of the template, cells of the window and its context as float16, and shifts.
    """
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    vehicles = boxes[required]
    found = [proposals_of(img, templates, MINING_SCAN)]
    for box in np.repeat(vehicles, 2, axis=0):
        shapes = [WINDOW_COLUMNS[i] / WINDOW_ROWS for i in templates_of(box)]
        found += [windows_around(box[None], s, params.shift_jitter, rng) for s in shapes]
    windows = np.concatenate(found)
    shifts = edge_shifts(windows, vehicles, params.background_iou)
    samples = []
    for window, shift in zip(windows, shifts, strict=True):
        if not np.isnan(shift[0]):
            i = nearest_template(window)
            cells = window_features(img, window, WINDOW_COLUMNS[i], WINDOW_CONTEXT)
            samples.append((i, cells.astype(np.float16), shift))
    return samples


def with_shifts(templates: tuple, samples: list, alpha: float) -> tuple:
    """Templates that move edges, by what `shift_samples` found in many frames."""
    moving = []
    for i, template in enumerate(templates):
        own = [(cells, shift) for index, cells, shift in samples if index == i]
        if not own:
            raise ValueError("vehicles of some shape are missing: give more footage")
        cells, shifts = map(np.array, zip(*own, strict=True))
        weights, bias = fit_shifts(cells.reshape(len(cells), -1).astype(np.float32), shifts, alpha)
        weights = weights.reshape(template.shift_weights.shape)
        moving.append(replace(template, shift_weights=weights, shift_bias=bias))
    return tuple(moving)


def proposals_of(img: np.ndarray, templates: tuple, scan: Any) -> np.ndarray:
    """Proposals of a frame of which nothing is known, shape (n, 4)."""
    (levels,) = level_groups(img.shape[:2], scan, prior_reach(len(img)))
    return propose(img, levels, templates, scan)[0]


def prior_reach(n_rows: int) -> Reach:
    """Where vehicles can stand in a frame of `n_rows` of which nothing is known."""
    return reach(prior_road(n_rows, DEFAULT_ROAD), n_rows, DEFAULT_ROAD)


def train_templates(
    training_set: TrainingSet, seed: int, jobs: int, params: TrainingParams
) -> tuple:
    """The first stage, with hard negatives mined in rounds.

    Parameters
    ----------
    training_set : TrainingSet
    seed, jobs : int
    params : TrainingParams

    Returns
    -------
    templates : tuple of Template
    """
    rng = np.random.default_rng([seed, 1])
    samples = WindowSamples()
    samples.add(crop_windows(training_set, rng))
    examples = training_set.examples
    items = with_generators(examples, seed, 2)
    for found in in_parallel(partial(frame_windows, params=params), items, jobs, "windows"):
        samples.add(found)
    templates = samples.fit(seed, params.template_C)
    for mining in range(params.mining_rounds):
        chosen = [examples[i] for i in rng.permutation(len(examples))[: params.mining_frames]]
        items = with_generators(chosen, seed, 3, mining)
        mine = partial(mined_windows, templates=templates)
        for found in in_parallel(mine, items, jobs, "mining"):
            samples.add(found)
        templates = samples.fit(seed, params.template_C)
    of_frames = partial(shift_samples, templates=templates, params=params)
    found = in_parallel(of_frames, with_generators(examples, seed, 4), jobs, "edges")
    return with_shifts(
        templates, [sample for own in found for sample in own], params.template_alpha
    )
