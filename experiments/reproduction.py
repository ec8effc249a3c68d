"""Why the reproduction of write-up G differs from its own code: one change at a time.

    python -m experiments.reproduction DATA --video project_video.mp4 --truth project_video.gt.txt

Every variant is trained with five seeds and run over the whole video. The table gives mean and
range of recall and precision at an IoU of 0.5.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
from sklearn.model_selection import train_test_split
from tqdm.auto import tqdm

from pipeline_functions import extract_features
from train import fit_linear
from vehicle import Vehicle
from vehicle_detection import command_line
from vehicle_detection.classifier import Classifier
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.media.mot import read_rows, rows_of
from vehicle_detection.media.training_images import HELD_OUT, load_training_set
from vehicle_detection.media.videos import read_frames
from vehicle_detection.parameters import FEATURE_PRESETS, SEARCH_PRESETS

SEEDS = range(5)
HALVES = {"1-630": range(1, 631), "631-1260": range(631, 1261)}
_C = 0.001


@dataclass(frozen=True)
class Variant:
    """One way to read the write-up.

    Attributes
    ----------
    loss : str
        Of the SVM, "squared_hinge" or "hinge".
    all_images : bool
        Learn from all images instead of four fifths.
    undistorted : bool
        Search undistorted frames; boxes are then those of undistorted pixels.
    band_top : int
        First row of the band of scale 1.
    """

    loss: str = "squared_hinge"
    all_images: bool = False
    undistorted: bool = False
    band_top: int = 400


# The base is the published video's; the shipped preset begins at row 380.
VARIANTS = {
    "from row 400, as G's video": Variant(),
    "hinge loss": Variant(loss="hinge"),
    "all images": Variant(all_images=True),
    "undistorted first": Variant(undistorted=True),
    "band of scale 1 from 380: shipped": Variant(band_top=380),
    "undistorted, hinge": Variant(loss="hinge", undistorted=True),
    "from 380, undistorted, hinge": Variant(loss="hinge", undistorted=True, band_top=380),
}


def search_of(variant):
    """G's search with the variant's band."""
    (scale, _, bottom), *others = SEARCH_PRESETS["G"].bands
    return replace(SEARCH_PRESETS["G"], bands=((scale, variant.band_top, bottom), *others))


def train_variants(data):
    """A classifier for every seed, loss and share of the images.

    Returns
    -------
    classifiers : dict of (seed, loss, all_images) to Classifier
    """
    training_set, params = load_training_set(data), FEATURE_PRESETS["G"]
    features, labels = extract_features(training_set.images, params), training_set.labels
    kinds = {(v.loss, v.all_images) for v in VARIANTS.values()}
    classifiers = {}
    for seed, (loss, all_images) in tqdm(list(product(SEEDS, kinds)), "training"):
        chosen, _ = train_test_split(
            np.arange(len(labels)), test_size=HELD_OUT, shuffle=True, random_state=seed
        )
        chosen = slice(None) if all_images else chosen
        scaler, svm = fit_linear(features[chosen], labels[chosen], _C, seed, loss)
        classifiers[seed, loss, all_images] = Classifier(svm, scaler, params, {})
    return classifiers


def detect_all(classifiers, calib, video):
    """Boxes of every frame for every variant and seed, decoding the video once.

    Returns
    -------
    boxes : dict of (variant name, seed) to list of ndarray, shape (n, 4)
    """
    vehicles = {}
    for (name, variant), seed in product(VARIANTS.items(), SEEDS):
        classifier = classifiers[seed, variant.loss, variant.all_images]
        vehicles[name, seed] = Vehicle(calib, classifier, search_of(variant))
    boxes = {key: [] for key in vehicles}
    for frame in tqdm(read_frames(video), "frames"):
        straight = next(iter(vehicles.values())).undistort(frame)
        for (name, seed), vehicle in vehicles.items():
            searched = straight if VARIANTS[name].undistorted else frame
            boxes[name, seed].append(vehicle.detect(searched).boxes)
    return boxes


def table(boxes, truth):
    """Recall and precision of every variant, mean and range over the seeds, as Markdown."""
    heads = [f"{figure} {half}" for half in HALVES for figure in ("recall", "precision")]
    lines = [f"| variant | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|"]
    for name in VARIANTS:
        cells = []
        for frames in HALVES.values():
            found = [evaluate(truth, rows_of(boxes[name, seed]), frames) for seed in SEEDS]
            for figure in ("recall", "precision"):
                values = [one[figure] for one in found]
                cells.append(f"{np.mean(values):.3f} ({min(values):.3f}-{max(values):.3f})")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.reproduction",
        description=__doc__.splitlines()[0],
        epilog="example: %(prog)s data param/calib.p --video drive.mp4 --truth drive.gt.txt",
    )
    parser.add_argument("data", type=Path, help="folder with vehicles/ and non-vehicles/")
    parser.add_argument("--video", type=Path, required=True)
    parser.add_argument("--truth", type=Path, required=True)
    parser.add_argument("--calib", type=Path, default=Path("param/calib.p"))
    arguments = parser.parse_args()
    boxes = detect_all(train_variants(arguments.data), arguments.calib, arguments.video)
    print(table(boxes, read_rows(arguments.truth, is_truth=True)))


if __name__ == "__main__":
    command_line.run(main)
