"""Train the two-stage detector on footage with true boxes, and on crops.

    python train_detector.py --footage VIDEO TRUTH 1:630 --footage SCENES TRUTH \\
        --crops VEHICLES --non-vehicles NON_VEHICLES

footage -> windows -> first stage -> mining -> proposals -> regressor -> scorer
"""

import argparse
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from scipy.linalg import block_diag
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA
from sklearn.kernel_approximation import Nystroem
from sklearn.linear_model import Ridge
from sklearn.metrics.pairwise import rbf_kernel
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC
from tqdm import tqdm

from rendered_road.sample import in_parallel
from vehicle_detection.evaluation.metrics import frame_range, read_rows
from vehicle_detection.media.images import VIDEO_SUFFIXES, find_images, read_image
from vehicle_detection.media.training_images import read_window
from vehicle_detection.media.videos import read_frames
from vehicle_detection.tracking.tracker import box_areas, pairwise_iou, pairwise_overlap
from vehicle_detection.two_stage.detector import (
    DEFAULT_SCAN,
    N_BORDERS,
    SURROUNDINGS,
    WINDOW_CELL,
    WINDOW_COLUMNS,
    WINDOW_ROWS,
    Detector,
    KernelMachine,
    ScanParams,
    Template,
    all_cells,
    cell_features,
    chroma_features,
    cut_out,
    cut_patches,
    inner_cells,
    level_groups,
    luma_and_chroma,
    margins_outside,
    move_edges,
    on_whole_pixels,
    patch_features,
    propose,
    save_detector,
)

# A vehicle lower than this, or of which less is seen, shows too little to learn from.
_LOWEST, _LEAST_SEEN = 13, 1 / 3
# Boxes that overlap a vehicle more than the first are vehicles, those that
# overlap it less than the second are none; what lies between teaches neither.
_VEHICLE_IOU, _NOTHING_IOU = 0.6, 0.4
# Side of the training set's images, in pixels.
_CROP_SIDE = 64
# What is scored right by more than this teaches nothing new.
_SURE = 0.5
# So often each crop with a box is looked at, as another camera might have taken it.
_CROP_VIEWS = 8
# Components of patches and centers of kernels: what is a vehicle shows in more
# details than where its edges are, but there are more places for edges. Sums over 64
# numbers, or over 128 with the four borders, fill a processor's registers to the end.
_SCORER_SIZE = 124, 2000
_REGRESSOR_SIZE = 64, 3000
# Median score of the vehicles the scorer learned from.
_USUAL_SCORE = 1.5
# The regressor's components are found among so many principal ones, by gradients
# at so many patches.
_N_PRINCIPAL, _N_GRADIENTS = 600, 12_000


@dataclass(frozen=True)
class Example:
    """A frame of footage with its vehicles.

    Attributes
    ----------
    source : Path or ndarray
        Where to read the frame, or the frame itself, RGB.
    boxes : ndarray of float, shape (n, 4)
    required : ndarray of bool, shape (n,)
        The others are ignore regions: neither vehicles nor nothing.
    visibility : ndarray of float, shape (n,)
        How much is seen of each vehicle, from 0 to 1; 0 if it is nowhere required. What
        the frame's side cuts teaches how vehicles enter, before they are required.
    """

    source: object
    boxes: np.ndarray
    required: np.ndarray
    visibility: np.ndarray

    def read(self):
        """The frame, RGB."""
        return read_image(self.source) if isinstance(self.source, Path) else self.source


@dataclass(frozen=True)
class TrainingSet:
    """All that is learned from.

    Attributes
    ----------
    examples : list of Example
    crops : list of Path
        Vehicles cut out tightly and squashed to squares: any shape may have
        been theirs.
    square_crops : list of Path
        Vehicles cut out as squares.
    boxed_crops : list of Example
        Vehicles cut out with a margin, and their boxes.
    non_vehicles : list of Path
    """

    examples: list
    crops: list
    square_crops: list
    boxed_crops: list
    non_vehicles: list


def parse_arguments(arguments=None):
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        description="Train the two-stage detector.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument(
        "--footage",
        nargs="+",
        action="append",
        required=True,
        metavar="FOOTAGE TRUTH [A:B[:STEP]]",
        help="a video or a folder of images, MOTChallenge rows of its vehicles, and which frames "
        "to learn from; can be given several times",
    )
    folders = {
        "--crops": "images of vehicles, cut out tightly and squashed to squares, like KITTI's",
        "--square-crops": "images of vehicles, cut out as squares, like GTI's",
        "--non-vehicles": "images without vehicles",
    }
    for name, what in folders.items():
        parser.add_argument(name, nargs="+", default=[], metavar="FOLDER", help=what)
    parser.add_argument(
        "--boxed-crops",
        nargs=2,
        action="append",
        default=[],
        metavar=("FOLDER", "TRUTH"),
        help="images of vehicles with a margin, and MOTChallenge rows of some of them, the n-th "
        "image, in the order of names, being frame n; can be given several times",
    )
    parser.add_argument("--out", type=Path, default=Path("param/detector.npz"))
    parser.add_argument("--seed", type=int, default=0, help="of all that is random")
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1: one a core")
    return parser.parse_args(arguments)


# ------------------------------------------------------------------- reading


def read_footage(path, truth, frames="1:1000000"):
    """Frames of a video or of a folder of images, with their true boxes.

    Parameters
    ----------
    path, truth : path
        The n-th image of a folder, in the order of names, is frame n.
    frames : str
        See `evaluate.frame_range`. Those of a video are held in memory, three bytes a
        pixel; images are read when they are needed.

    Returns
    -------
    examples : list of Example

    Raises
    ------
    FileNotFoundError, ValueError
        A file is missing or cannot be read; no frame is left.
    """
    path, rows, numbers = Path(path), read_rows(truth), frame_range(frames)
    is_video = path.suffix.lower() in VIDEO_SUFFIXES
    sources = read_frames(path) if is_video else find_images(path)
    required = rows.scores == 1
    # What is never required, or has no identity, may be no vehicle at all.
    is_vehicle = required | np.isin(rows.ids, rows.ids[required & (rows.ids >= 0)])
    visibility = np.where(is_vehicle, rows.visibility, 0)
    visibility[required & (rows.visibility < 0)] = 1
    examples = []
    for number, source in enumerate(sources, start=1):
        if number >= numbers.stop:
            break
        if number in numbers:
            own = rows.frames == number
            examples.append(Example(source, rows.boxes[own], required[own], visibility[own]))
    if not examples:
        raise ValueError(f"{path}: no frame in {frames}")
    return examples


def read_boxed_crops(folder, truth):
    """Those images of a folder that have a true box, as `read_footage`."""
    examples = [example for example in read_footage(folder, truth) if example.required.any()]
    if not examples:
        raise ValueError(f"{truth}: no box for any image of {folder}")
    return examples


# -------------------------------------------------------------- augmentation


def random_camera(example, rng):
    """The frame as another camera might have taken it, with its boxes.

    Narrower, mirrored, smaller, blurred, of other exposure and colour,
    compressed: each with a chance of its own.

    Parameters
    ----------
    example : Example
    rng : numpy.random.Generator

    Returns
    -------
    img : ndarray of uint8, shape (rows, columns, 3)
    boxes : ndarray of float, shape (n, 4)
    vehicles : ndarray of bool, shape (n,)
        The others are neither vehicles nor nothing.
    """
    img, boxes = example.read(), example.boxes
    at_side = (boxes[:, 0] < 1) | (boxes[:, 2] > img.shape[1] - 1)
    visibility = np.where(example.required | at_side, example.visibility, 0)
    if rng.random() < 0.4:
        img, boxes, visibility = narrowed(img, boxes, visibility, rng.uniform(0.6, 1))
    if rng.random() < 0.5:
        img, boxes = mirrored(img, boxes)
    if rng.random() < 0.8:
        scale = np.exp(rng.uniform(np.log(0.4), 0)) if rng.random() < 0.6 else 1
        img = cv2.resize(img, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        boxes = boxes * scale
        if rng.random() < 0.4:
            img = cv2.GaussianBlur(img, (0, 0), rng.uniform(0.3, 1.0))
        img = random_exposure(img, rng)
        if rng.random() < 0.5:
            img = compressed(img, rng.integers(30, 90))
    rows, columns = img.shape[:2]
    boxes = np.clip(boxes, 0, (columns, rows, columns, rows))
    width, height = (boxes[:, 2:] - boxes[:, :2]).T
    vehicles = (visibility >= _LEAST_SEEN) & (height >= _LOWEST) & (width > height / 3)
    return np.ascontiguousarray(img), boxes, vehicles


def narrowed(img, boxes, visibility, share):
    """The left `share` of a frame, the boxes in it, and how much is seen of each there."""
    columns = round(img.shape[1] * share)
    cut = boxes.copy()
    cut[:, [0, 2]] = np.minimum(boxes[:, [0, 2]], columns)
    left_over = (cut[:, 2] - cut[:, 0]) / np.maximum(boxes[:, 2] - boxes[:, 0], 1e-9)
    seen = left_over > 0
    return img[:, :columns], cut[seen], (visibility * left_over)[seen]


def mirrored(img, boxes):
    """Left and right exchanged."""
    columns = img.shape[1]
    left, top, right, bottom = boxes.T
    return img[:, ::-1], np.stack([columns - right, top, columns - left, bottom], axis=1)


def random_exposure(img, rng):
    """Other gain, gamma, haze, white balance and saturation."""
    if rng.random() < 0.3:
        return img
    gain = np.exp(rng.normal(0, 0.06, 3) + rng.normal(0, 0.25))
    gamma = np.exp(rng.normal(0, 0.25))
    haze = rng.uniform(0, 0.12) * (rng.random() < 0.4)
    values = np.clip(gain * np.linspace(0, 1, 256)[:, None], 0, 1) ** gamma
    curve = 255 * (haze + (1 - haze) * values)
    img = cv2.LUT(np.ascontiguousarray(img), curve.astype(np.uint8)[None])
    if rng.random() < 0.45:
        gray = cv2.cvtColor(cv2.cvtColor(img, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        saturation = rng.uniform(0.3, 1.4)
        img = cv2.addWeighted(img, saturation, gray, 1 - saturation, 0)
    return img


def random_crop(path, rng):
    """An image of the training set as another camera might have taken it.

    Returns
    -------
    img : ndarray of uint8, shape (_CROP_SIDE, _CROP_SIDE, 3)
        RGB.
    """
    img, _ = read_window(path, _CROP_SIDE)
    if rng.random() < 0.5:
        img = img[:, ::-1]
    if rng.random() < 0.6:
        small = max(8, int(_CROP_SIDE * np.exp(rng.uniform(np.log(0.25), 0))))
        img = cv2.resize(img, (small, small), interpolation=cv2.INTER_AREA)
    size = _CROP_SIDE, _CROP_SIDE
    img = cv2.resize(random_exposure(img, rng), size, interpolation=cv2.INTER_LINEAR)
    return img


def worn(patches, rng):
    """Half of some patches as a worse camera might have shown them.

    Of fewer pixels, out of focus, compressed, in haze or in shade. A vehicle far away
    is so in any camera's picture, and most that are learned from are near.

    Parameters
    ----------
    patches : ndarray of uint8, shape (n, side, side, 3)
        RGB.
    rng : numpy.random.Generator

    Returns
    -------
    patches : ndarray of uint8, shape (n, side, side, 3)
    """
    seen = patches.copy()
    for i in np.flatnonzero(rng.random(len(patches)) < 0.5):
        seen[i] = _worn(patches[i], rng)
    return seen


def _worn(patch, rng):
    size = patch.shape[1::-1]
    if rng.random() < 0.7:
        side = round(size[0] * np.exp(rng.uniform(np.log(0.22), np.log(0.88))))
        small = cv2.resize(patch, (side, side), interpolation=cv2.INTER_AREA)
        if rng.random() < 0.5:
            small = cv2.GaussianBlur(small, (0, 0), rng.uniform(0.4, 1.0))
        if rng.random() < 0.6:
            small = compressed(small, rng.integers(25, 80))
        patch = cv2.resize(small, size, interpolation=cv2.INTER_LINEAR)
    if rng.random() < 0.5:
        black = rng.uniform(0, 80)
        white = rng.uniform(black + 60, 255)
        gamma = np.exp(rng.normal(0, 0.35))
        curve = black + (white - black) * np.linspace(0, 1, 256) ** gamma
        patch = cv2.LUT(patch, curve.astype(np.uint8))
    return patch


def compressed(img, quality):
    """The image as JPEG of this quality, from 0 to 100, shows it."""
    encoded = cv2.imencode(".jpg", img, [cv2.IMWRITE_JPEG_QUALITY, int(quality)])[1]
    return cv2.imdecode(encoded, cv2.IMREAD_COLOR)


def jittered(boxes, spread, rng):
    """Boxes with every edge moved at random by about `spread` of the size."""
    shifts = np.clip(rng.normal(0, spread, boxes.shape), -2 * spread, 2 * spread)
    return move_edges(boxes, shifts)


def with_moved_edges(boxes, rng):
    """Each box three times, its edges moved at random, once by little."""
    return np.concatenate([jittered(boxes, spread, rng) for spread in (0.04, 0.1, 0.1)])


def random_parts(boxes, rng):
    """A part of each box, three tenths to all of its width and height."""
    size = boxes[:, 2:] - boxes[:, :2]
    part = size * rng.uniform(0.3, 1, size.shape)
    corner = boxes[:, :2] + (size - part) * rng.uniform(0, 1, size.shape)
    return np.hstack([corner, corner + part])


def neighbours(boxes, rng):
    """A place on or around each box, where tracks that go astray end up."""
    size = boxes[:, 2:] - boxes[:, :2]
    aside = size * rng.uniform(-1.5, 1.5, size.shape)
    return boxes + np.hstack([aside, aside])


# --------------------------------------------------------------- first stage


class WindowSamples:
    """Features of vehicles and of nothing, for each of the templates."""

    def __init__(self):
        self._features = [[] for _ in WINDOW_COLUMNS]
        self._labels = [[] for _ in WINDOW_COLUMNS]

    def add(self, samples):
        """More windows: (index of the template, features, label) each."""
        for template, features, label in samples:
            self._features[template].append(features.ravel())
            self._labels[template].append(label)

    def fit(self, seed, C=5e-4):
        """A linear SVM for each template; scaling is folded into its weights."""
        return tuple(
            fit_template(np.array(features), np.array(labels), columns, C, seed)
            for features, labels, columns in zip(
                self._features, self._labels, WINDOW_COLUMNS, strict=True
            )
        )


def fit_template(features, labels, columns, C, seed):
    """Template of a linear SVM; scaling is folded into its weights."""
    if len(set(labels.tolist())) < 2:
        raise ValueError("windows of vehicles or of anything else are missing: give more footage")
    scaler = StandardScaler().fit(features)
    svm = LinearSVC(C=C, random_state=seed, dual=True).fit(scaler.transform(features), labels)
    weights = svm.coef_[0] / scaler.scale_
    bias = float(svm.intercept_[0] - weights @ scaler.mean_)
    return Template(weights.reshape(WINDOW_ROWS, columns, -1).astype(np.float32), bias)


def window_features(img, box, columns):
    """Cells of a window of a template's shape, cut out of the frame with their surroundings."""
    left, top, right, bottom = box
    x, y = (right - left) / columns, (bottom - top) / WINDOW_ROWS
    # What its cells are held against, and one more: gradients at a cut edge are those of nowhere.
    margin = SURROUNDINGS // 2 + 1
    size = (columns + 2 * margin) * WINDOW_CELL, (WINDOW_ROWS + 2 * margin) * WINDOW_CELL
    x, y = margin * x, margin * y
    whole = np.rint([left - x, top - y, right + x, bottom + y]).astype(int).tolist()
    return cell_features(cut_out(img, whole, size))[margin:-margin, margin:-margin]


def crop_windows(training_set, rng):
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
        for i, columns in enumerate(WINDOW_COLUMNS):
            longer = max(columns, WINDOW_ROWS)
            height, width = (_CROP_SIDE * side // longer for side in (WINDOW_ROWS, columns))
            top, left = (rng.integers(0, _CROP_SIDE - side + 1) for side in (height, width))
            size = columns * WINDOW_CELL, WINDOW_ROWS * WINDOW_CELL
            part = img[top : top + height, left : left + width]
            cut = cv2.resize(part, size, interpolation=cv2.INTER_AREA)
            yield i, cell_features(cut), 0


def frame_windows(item):
    """Windows of a frame: its vehicles, and its surroundings at random.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)

    Returns
    -------
    samples : list
        See `WindowSamples.add`.
    """
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    return [
        *vehicle_windows(img, boxes[required], rng),
        *surrounding_windows(img, boxes, rng),
    ]


def vehicle_windows(img, boxes, rng):
    """Yield vehicles of a frame, for the templates whose shape is near theirs."""
    for box in np.concatenate([jittered(boxes, 0.03, rng) for _ in range(2)]):
        shape = (box[2] - box[0]) / (box[3] - box[1])
        for i, columns in enumerate(WINDOW_COLUMNS):
            if abs(np.log(shape * WINDOW_ROWS / columns)) < np.log(1.35):
                yield i, window_features(img, box, columns), 1


def surrounding_windows(img, boxes, rng, count=6):
    """Yield windows of a frame with no vehicle in them, at random."""
    rows, columns = img.shape[:2]
    low, high = DEFAULT_SCAN.horizon
    for i, window_columns in enumerate(WINDOW_COLUMNS):
        height = DEFAULT_SCAN.smallest * columns / 1280 * np.exp(rng.uniform(0, 2.2, count))
        half = np.stack([height * window_columns / WINDOW_ROWS, height], axis=1) / 2
        x = rng.uniform(0, columns, count)
        y = rng.uniform(low * rows - 0.2 * height, high * rows + 0.4 * height)
        middle = np.stack([x, y], axis=1)
        windows = np.hstack([middle - half, middle + half])
        for window in windows[is_nothing(windows, boxes, 0.3, 0.3)]:
            yield i, window_features(img, window, window_columns), 0


def is_nothing(windows, boxes, iou, covered):
    """Which windows overlap every box by less than an IoU and by less than a share of theirs."""
    if not len(boxes):
        return np.ones(len(windows), bool)
    share = pairwise_overlap(windows, boxes) / box_areas(windows)[:, None]
    return (pairwise_iou(windows, boxes).max(axis=1) < iou) & (share.max(axis=1) < covered)


def mined_windows(item, templates):
    """What the first stage takes for vehicles in a frame and is nothing, as `frame_windows`."""
    example, rng = item
    img, boxes, _ = random_camera(example, rng)
    scan = ScanParams(cells_per_step=1, n_groups=1, n_proposals=3, n_entering=0, overlap=0.6)
    windows, _ = propose(img, level_groups(img.shape[:2], scan)[0], templates, scan)
    samples = []
    for window in windows[is_nothing(windows, boxes, 0.35, 0.6)]:
        shape = (window[2] - window[0]) / (window[3] - window[1])
        i = int(np.argmin(np.abs(np.array(WINDOW_COLUMNS) / WINDOW_ROWS - shape)))
        samples.append((i, window_features(img, window, WINDOW_COLUMNS[i]), 0))
    return samples


def with_generators(examples, *seed):
    """Each example with random numbers of its own, the same on any number of cores."""
    return [(example, np.random.default_rng([*seed, i])) for i, example in enumerate(examples)]


def train_templates(training_set, seed, jobs, rounds=2):
    """The first stage, with hard negatives mined in rounds."""
    rng = np.random.default_rng([seed, 1])
    samples = WindowSamples()
    samples.add(crop_windows(training_set, rng))
    examples = training_set.examples
    items = with_generators(examples, seed, 2)
    for found in in_parallel(frame_windows, items, jobs, "windows"):
        samples.add(found)
    templates = samples.fit(seed)
    for mining in range(rounds):
        chosen = [examples[i] for i in rng.permutation(len(examples))[:300]]
        items = with_generators(chosen, seed, 3, mining)
        for found in in_parallel(
            partial(mined_windows, templates=templates), items, jobs, "mining"
        ):
            samples.add(found)
        templates = samples.fit(seed)
    return templates


# -------------------------------------------------------------- second stage


def candidates(img, boxes, required, templates, rng):
    """Proposals of a frame and its vehicles with edges moved at random.

    Those that may be neither vehicle nor nothing are left out.

    Returns
    -------
    windows : ndarray of float, shape (n, 4)
    """
    scan = ScanParams(
        threshold=-1.0, cells_per_step=1, n_groups=1, n_proposals=4, n_entering=0, overlap=0.6
    )
    windows, _ = propose(img, level_groups(img.shape[:2], scan)[0], templates, scan)
    vehicles = boxes[required]
    moved = with_moved_edges(vehicles, rng)
    parts = [random_parts(vehicles, rng) for _ in range(2)]
    windows = np.concatenate([windows, moved, *parts, neighbours(vehicles, rng)])
    clear = is_nothing(windows, boxes[~required], 0.3, 0.5)
    return windows[clear | (best_iou(windows, vehicles) > 0.5)]


def best_iou(windows, boxes):
    """Largest IoU of each window with any box."""
    return pairwise_iou(windows, boxes).max(axis=1, initial=0)


def edge_samples(item, templates):
    """Patches around the vehicles of a frame, and the shifts of their edges.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)
    templates : tuple of Template

    Returns
    -------
    features : ndarray of float16, shape (n, n_features)
    shifts : ndarray of float, shape (n, 4)
        In widths and heights of the patch's box.
    """
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    windows = candidates(img, boxes, required, templates, rng)
    return _edges(img, windows, boxes[required], np.ones(N_BORDERS), rng)


def crop_edge_samples(item):
    """As `edge_samples`, of a vehicle that was cut out of a frame with a margin."""
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    # It goes on beyond the margin; but what cut the vehicle may as well have been the frame's end.
    ends = (margins_outside(boxes, img.shape) == 1).any(axis=0)
    return _edges(img, with_moved_edges(boxes[required], rng), boxes[required], ends, rng)


def _edges(img, windows, vehicles, ends, rng):
    """Windows around vehicles as `edge_samples`; `ends` is 0 on sides where no frame ends."""
    windows = on_whole_pixels(windows[best_iou(windows, vehicles) > _NOTHING_IOU])
    own = np.empty((0, 4))
    if len(windows):
        own = vehicles[pairwise_iou(windows, vehicles).argmax(axis=1)]
    size = np.tile(windows[:, 2:] - windows[:, :2], 2)
    outside = margins_outside(windows, img.shape) * ends
    planes = luma_and_chroma(worn(cut_patches(img, windows), rng))
    features, contrast = patch_features(planes)
    features = all_cells(features, chroma_features(planes, contrast), outside)
    return features.astype(np.float16), (own - windows) / size


def train_regressor(training_set, templates, seed, jobs):
    """From patches around vehicles to the shifts of their edges."""
    items = with_generators(training_set.examples, seed, 4)
    crops = with_generators(_CROP_VIEWS * training_set.boxed_crops, seed, 9)
    found = [
        *in_parallel(partial(edge_samples, templates=templates), items, jobs, "edges"),
        *in_parallel(crop_edge_samples, crops, jobs, "boxed crops"),
    ]
    features, shifts = map(np.concatenate, zip(*found, strict=True))
    print(f"edges: {len(features)} patches")
    return fit_regressor(features, shifts, np.random.default_rng([seed, 5]))


def fit_components(features, n_components, rng):
    """Scaling and principal components of cells, borders apart; as an affine map, float32."""
    if len(features) < n_components:
        raise ValueError(f"only {len(features)} patches to learn from: give more footage")
    chosen = rng.permutation(len(features))[:15_000]
    scaler = StandardScaler()
    # Cells that are nearly always empty would weigh most if they were scaled up.
    some = scaler.fit_transform(features[chosen, :-N_BORDERS].astype(np.float32))
    scale = np.maximum(scaler.scale_, 0.01)
    some *= scaler.scale_ / scale
    pca = PCA(n_components, svd_solver="randomized", random_state=0).fit(some)
    projection = pca.components_ / scale
    offset = -(projection @ scaler.mean_) - pca.components_ @ pca.mean_
    # A margin outside of the frame is as far from one inside as one patch from another.
    border = np.sqrt(2 * pca.explained_variance_.sum()) * np.eye(N_BORDERS)
    projection = block_diag(projection, border)
    offset = np.concatenate([offset, np.zeros(N_BORDERS)])
    return projection.astype(np.float32), offset.astype(np.float32)


def apply_components(features, projection, offset, n_rows=5000):
    """Components of many features, a part at a time."""
    parts = (features[i : i + n_rows] for i in range(0, len(features), n_rows))
    return np.concatenate([part.astype(np.float32) @ projection.T + offset for part in parts])


def fit_regressor(features, shifts, rng, alpha=1.0):
    """Ridge regression on Gaussians around some of the samples, fitted twice.

    First on many principal components, the directions along which patches differ
    most; then on those few along which the first fit changes most, for they say
    where the edges are: what colour a vehicle has does not.

    References
    ----------
    .. [1] A. Radhakrishnan, D. Beaglehole, P. Pandit and M. Belkin, "Mechanism
           for feature learning in neural networks and backpropagation-free
           machine learning models", Science 383, 2024.
    """
    n_components, n_centers = _REGRESSOR_SIZE
    n_principal = min(_N_PRINCIPAL, len(features), features.shape[1] - N_BORDERS)
    projection, offset = fit_components(features, max(n_components, n_principal), rng)
    components = apply_components(features, projection, offset)
    chosen = rng.permutation(len(components))
    centers = components[chosen[:n_centers]]
    first, gamma = fit_ridge(components, centers, shifts, alpha)
    some = components[chosen[:_N_GRADIENTS]]
    directions = steepest_directions(some, centers, first.coef_, gamma, n_components)
    components, centers = components @ directions.T, centers @ directions.T
    ridge, gamma = fit_ridge(components, centers, shifts, alpha)
    # One row after the other, as they are multiplied.
    weights = ridge.coef_.astype(np.float32, order="C")
    bias = ridge.intercept_.astype(np.float32)
    return KernelMachine(
        directions @ projection, directions @ offset, centers, weights, bias, gamma
    )


def fit_ridge(components, centers, targets, alpha):
    """Ridge regression on Gaussians, and their gamma: one by the sum of the variances."""
    gamma = float(1 / components.var(axis=0).sum())
    kernel = rbf_kernel(components.astype(float), centers.astype(float), gamma)
    return Ridge(alpha=alpha, solver="cholesky").fit(kernel, targets), gamma


def steepest_directions(components, centers, weights, gamma, count, power=0.35):
    """Directions in which f(x) = sum_i weights_i exp(-gamma |x - centers_i|^2) changes most.

    Parameters
    ----------
    components : ndarray, shape (n, n_components)
        Where to look at f.
    centers : ndarray, shape (n_centers, n_components)
    weights : ndarray, shape (n_outputs, n_centers)
    gamma : float
    count : int
    power : float
        Of the eigenvalues. 1/2 would give the gradients' own lengths, and leave too
        little of all directions but the steepest.

    Returns
    -------
    directions : ndarray of float32, shape (count, n_components)
        Eigenvectors of the sum of the gradients' outer products, the steepest first
        and of length 1, the others as much shorter as their eigenvalues are smaller.
    """
    kernel = rbf_kernel(components, centers, gamma)
    outer = np.zeros((components.shape[1],) * 2)
    for own in weights:
        pull = kernel * own
        gradients = pull @ centers - pull.sum(axis=1, keepdims=True) * components
        outer += gradients.T @ gradients
    values, vectors = np.linalg.eigh(outer)
    values, vectors = values[::-1][:count], vectors[:, ::-1][:, :count]
    lengths = np.maximum(values / values[0], 0) ** power
    return (vectors * lengths).T.astype(np.float32)


def patch_samples(item, templates, regressor, scorer=None):
    """Patches of a frame where the regressor has moved them, vehicles and nothing.

    Parameters
    ----------
    item : (Example, numpy.random.Generator)
    templates : tuple of Template
    regressor : KernelMachine
    scorer : KernelMachine, optional
        Leave out what it is already sure of, and right.

    Returns
    -------
    features : ndarray of float16, shape (n, n_features)
    labels : ndarray of int, shape (n,)
    """
    example, rng = item
    img, boxes, required = random_camera(example, rng)
    windows = on_whole_pixels(candidates(img, boxes, required, templates, rng))
    outside = margins_outside(windows, img.shape)
    planes = luma_and_chroma(cut_patches(img, windows))
    features, contrast = patch_features(planes)
    chroma = chroma_features(planes, contrast)
    shifts = regressor.predict(all_cells(features, chroma, outside))
    windows = on_whole_pixels(move_edges(windows, shifts))
    iou = best_iou(windows, boxes[required])
    # A part of a vehicle is none, or it would be found beside the whole.
    nothing = (iou < _NOTHING_IOU) & is_nothing(windows, boxes[~required], 0.3, 0.5)
    clear = (iou > _VEHICLE_IOU) | nothing
    windows = windows[clear]
    patches = worn(cut_patches(img, windows), rng)
    features, _ = patch_features(luma_and_chroma(patches))
    features = inner_cells(features, margins_outside(windows, img.shape))
    labels = (iou[clear] > _VEHICLE_IOU).astype(int)
    if scorer is not None:
        hard = scorer.predict(features)[:, 0] * (2 * labels - 1) < _SURE
        features, labels = features[hard], labels[hard]
    return features.astype(np.float16), labels


def crop_patches(training_set, rng):
    """Yield patches of the training set's images, as `patch_samples`.

    Each is taken whole, as if it were cut by the frame's border, and, of
    vehicles, in parts that are none.
    """
    whole = np.array([0.0, 0.0, _CROP_SIDE, _CROP_SIDE])
    labeled = [(path, 1) for path in 2 * (training_set.crops + training_set.square_crops)]
    labeled += [(path, 0) for path in training_set.non_vehicles]
    for path, label in tqdm(labeled, "crops", unit="image"):
        cut, outside = cut_by_border(whole, rng)
        parts = random_parts(np.tile(whole, (2 * label, 1)), rng)
        parts = parts[best_iou(parts, whole[None]) < _NOTHING_IOU]
        boxes = np.concatenate([[whole, cut], parts])
        all_outside = np.zeros((len(boxes), N_BORDERS))
        all_outside[1] = outside
        patches = worn(cut_patches(random_crop(path, rng), boxes), rng)
        features, _ = patch_features(luma_and_chroma(patches))
        features = inner_cells(features, all_outside)
        yield features.astype(np.float16), np.array([label, label, *np.zeros(len(parts), int)])


def cut_by_border(box, rng):
    """What is left of a box where the frame's left or right border cuts it.

    Returns
    -------
    box : ndarray of float, shape (4,)
    outside : ndarray of float, shape (N_BORDERS,)
        See `detector.margins_outside`.
    """
    side = rng.choice([0, 2])
    box, outside = box.copy(), np.zeros(N_BORDERS)
    box[side] += rng.uniform(0, 0.55) * (box[2 - side] - box[side])
    outside[side] = 1
    return box, outside


def train_scorer(training_set, templates, regressor, seed, jobs, rounds=1):
    """From the inner cells of patches to vehicle or not, with hard patches mined in rounds."""
    samples = list(crop_patches(training_set, np.random.default_rng([seed, 6])))
    scorer = None
    for mining in range(rounds + 1):
        items = with_generators(training_set.examples, seed, 7, mining)
        find = partial(patch_samples, templates=templates, regressor=regressor, scorer=scorer)
        samples += in_parallel(find, items, jobs, "patches")
        features, labels = map(np.concatenate, zip(*samples, strict=True))
        scorer = fit_scorer(features, labels, np.random.default_rng([seed, 8]))
    return scorer


def fit_scorer(features, labels, rng, C=0.1):
    """Linear SVM on the map that approximates an RBF kernel by clusters of the samples.

    Its decision function is scaled so that the vehicles it learned from have a median of
    `_USUAL_SCORE`: how much evidence a score is must not depend on C.

    A kernel SVM on as many samples would keep thousands of support vectors,
    and each costs time in every frame. As many clusters are of vehicles as of
    anything else.

    Parameters
    ----------
    features : ndarray of float32, shape (n, N_INNER_FEATURES)
        See `detector.inner_cells`: the last are the margins outside of the frame.
    labels : ndarray, shape (n,)
        Positive for vehicles.
    rng : numpy.random.Generator
    C : float

    Returns
    -------
    scorer : KernelMachine

    References
    ----------
    .. [1] C. Williams and M. Seeger, "Using the Nystroem Method to Speed Up
           Kernel Machines", NIPS 2000.
    .. [2] K. Zhang, I. Tsang and J. Kwok, "Improved Nystroem Low-Rank
           Approximation and Error Analysis", ICML 2008.
    """
    print(f"patches: {len(labels)}, {labels.mean():.0%} vehicles")
    n_components, n_centers = _SCORER_SIZE
    projection, offset = fit_components(features, n_components, rng)
    components = apply_components(features, projection, offset)
    gamma = float(1 / components[:, :n_components].var(axis=0).sum())
    centers = np.concatenate(
        [cluster_centers(components[labels == label], n_centers // 2) for label in (0, 1)]
    )
    nystroem = Nystroem(gamma=gamma, n_components=len(centers), random_state=0).fit(centers)
    mapped = nystroem.transform(components).astype(np.float32)
    svm = LinearSVC(C=C, dual=False, class_weight="balanced", max_iter=200).fit(mapped, labels)
    scale = np.float32(_USUAL_SCORE / np.median(svm.decision_function(mapped[labels > 0])))
    weights = scale * (nystroem.normalization_.T @ svm.coef_[0])[None].astype(np.float32)
    centers = nystroem.components_.astype(np.float32)
    bias = scale * svm.intercept_.astype(np.float32)
    return KernelMachine(projection, offset, centers, weights, bias, gamma)


def cluster_centers(components, count):
    """Centers of clusters, or the samples themselves if they are fewer; shape (n, n_components)."""
    if len(components) <= count:
        return components
    clusters = KMeans(count, init="random", max_iter=10, random_state=0).fit(components)
    return clusters.cluster_centers_


def train_detector(training_set, seed=0, jobs=-1):
    """Both stages, one after the other.

    Parameters
    ----------
    training_set : TrainingSet
    seed : int
    jobs : int
        Processes; -1 for one a core.

    Returns
    -------
    detector : Detector
    """
    templates = train_templates(training_set, seed, jobs)
    regressor = train_regressor(training_set, templates, seed, jobs)
    scorer = train_scorer(training_set, templates, regressor, seed, jobs)
    return Detector(templates, scorer, regressor)


def images_of_folders(folders):
    """All images of some folders, see `files.find_images`."""
    return [path for folder in folders for path in find_images(folder)]


def main():
    """Run the command line."""
    arguments = parse_arguments()
    start = time.perf_counter()
    try:
        for footage in arguments.footage:
            if not 2 <= len(footage) <= 3:
                raise ValueError(f"--footage {' '.join(footage)}: a path, its truth, and A:B")
        examples = [e for footage in arguments.footage for e in read_footage(*footage)]
        training_set = TrainingSet(
            examples=examples,
            crops=images_of_folders(arguments.crops),
            square_crops=images_of_folders(arguments.square_crops),
            boxed_crops=[c for pair in arguments.boxed_crops for c in read_boxed_crops(*pair)],
            non_vehicles=images_of_folders(arguments.non_vehicles),
        )
        print(", ".join(f"{len(v)} {k}" for k, v in vars(training_set).items()))
        detector = train_detector(training_set, arguments.seed, arguments.jobs)
        save_detector(detector, arguments.out)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")
    print(f"wrote {arguments.out} after {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
