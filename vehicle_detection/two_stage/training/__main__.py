"""Train the two-stage detector on footage with true boxes, and on images of vehicles.

    python -m vehicle_detection.two_stage.training --footage VIDEO TRUTH 1:630 \\
        --footage SCENES TRUTH --crops VEHICLES --non-vehicles NON_VEHICLES --out FILE.npz

footage -> windows -> first stage -> hard negatives -> proposals -> second stage
"""

from __future__ import annotations

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vehicle_detection import command_line
from vehicle_detection.evaluation.confusion import draw_confusion
from vehicle_detection.media.files import write_whole, written_whole
from vehicle_detection.parameters import DEFAULT_TRAINING, QUICK_TRAINING
from vehicle_detection.two_stage.model import save_detector
from vehicle_detection.two_stage.training.card import model_card
from vehicle_detection.two_stage.training.first_stage import train_templates
from vehicle_detection.two_stage.training.footage import (
    Footage,
    TrainingSet,
    balanced,
    images_of_folders,
    read_boxed_crops,
    read_cameras,
)
from vehicle_detection.two_stage.training.second_stage import (
    scored_patches,
    train_second_stage,
)

if TYPE_CHECKING:
    from vehicle_detection.parameters import TrainingParams
    from vehicle_detection.two_stage.model import Detector

_FRAMES_TO_DRAW = 100


def add_source_options(parser: argparse.ArgumentParser) -> None:
    """Options that say what is learned from."""
    parser.add_argument(
        "--footage", nargs="+", action="append", default=[], metavar="FOOTAGE TRUTH [A:B[:STEP]]",
        help="a video or a folder of images, MOTChallenge rows of its vehicles, and which frames "
        "to learn from: one camera; can be given several times",
    )  # fmt: skip
    parser.add_argument(
        "--cameras", type=Path, metavar="FILE.csv",
        help="footage of many cameras: columns camera, footage, truth, frames",
    )  # fmt: skip
    parser.add_argument("--without", nargs="+", default=[], metavar="CAMERA", help="of --cameras")
    folders = {
        "--crops": "images of vehicles, cut out tightly and squashed to squares, like KITTI's",
        "--square-crops": "images of vehicles, cut out as squares, like GTI's",
        "--non-vehicles": "images without vehicles",
    }
    for name, what in folders.items():
        parser.add_argument(name, nargs="+", default=[], metavar="FOLDER", help=what)
    parser.add_argument(
        "--boxed-crops", nargs=2, action="append", default=[], metavar=("FOLDER", "TRUTH"),
        help="images of vehicles with a margin, and MOTChallenge rows of some of them, the n-th "
        "image, in the order of names, being frame n; can be given several times",
    )  # fmt: skip


def parse_arguments(arguments: list | None = None) -> argparse.Namespace:
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        prog="python -m vehicle_detection.two_stage.training",
        description="Train the two-stage detector.",
        epilog="example: %(prog)s --cameras cameras.csv --out output/detector.npz",
    )
    add_source_options(parser)
    parser.add_argument(
        "--out", type=Path, default=Path("output/detector.npz"), help="default: %(default)s"
    )
    parser.add_argument("--seed", type=int, default=0, help="of all that is random, default: 0")
    parser.add_argument("--jobs", type=int, default=-1, help="processes, default: one a core")
    parser.add_argument("--quick", action="store_true", help="fewer frames of each camera")
    return parser.parse_args(arguments)


def gather(arguments: argparse.Namespace, params: Any) -> TrainingSet:
    """The training set that the command line names, balanced by camera.

    Raises
    ------
    FileNotFoundError, ValueError
        A file is missing or cannot be read; there is no footage.
    """
    for footage in arguments.footage:
        if not 2 <= len(footage) <= 3:
            raise ValueError(f"--footage {' '.join(footage)}: a path, its truth, and A:B")
    cameras = {footage[0]: [Footage(*footage)] for footage in arguments.footage}
    if arguments.cameras:
        cameras |= read_cameras(arguments.cameras, arguments.without)
    if not cameras:
        raise ValueError("no footage: give --footage or --cameras")
    examples = []
    for name, parts in cameras.items():
        own = [example for part in parts for example in part.read()]
        chosen = balanced(own, params)
        print(f"{name}: {len(own)} frames, {len(chosen)} learned from")
        examples += chosen
    return TrainingSet(
        examples=examples,
        crops=images_of_folders(arguments.crops),
        square_crops=images_of_folders(arguments.square_crops),
        boxed_crops=[c for pair in arguments.boxed_crops for c in read_boxed_crops(*pair)],
        non_vehicles=images_of_folders(arguments.non_vehicles),
    )


def train_detector(
    training_set: TrainingSet,
    seed: int = 0,
    jobs: int = -1,
    params: TrainingParams = DEFAULT_TRAINING,
) -> Detector:
    """Both stages, one after the other.

    Parameters
    ----------
    training_set : TrainingSet
    seed : int
    jobs : int
        Processes; -1 for one a core.
    params : TrainingParams

    Returns
    -------
    detector : Detector
    """
    templates = train_templates(training_set, seed, jobs, params)
    return train_second_stage(training_set, templates, seed, jobs, params)


def draw_training(
    training_set: TrainingSet, detector: Detector, arguments: argparse.Namespace, params: Any
) -> None:
    """Draw what the second stage confuses in some frames that it learned from."""
    step = max(1, len(training_set.examples) // _FRAMES_TO_DRAW)
    examples = training_set.examples[::step]
    scored = scored_patches(examples, detector, arguments.seed, params)
    with written_whole(arguments.out.with_suffix(".png")) as file:
        draw_confusion(*scored).savefig(file, dpi=90)


def main() -> None:
    """Run the command line."""
    arguments = parse_arguments()
    params = QUICK_TRAINING if arguments.quick else DEFAULT_TRAINING
    start = time.perf_counter()
    training_set = gather(arguments, params)
    print(", ".join(f"{len(v)} {k}" for k, v in vars(training_set).items()))
    detector = train_detector(training_set, arguments.seed, arguments.jobs, params)
    save_detector(detector, arguments.out)
    draw_training(training_set, detector, arguments, params)
    sources = {name: len(values) for name, values in vars(training_set).items()}
    command = shlex.join(["python", "-m", "vehicle_detection.two_stage.training", *sys.argv[1:]])
    card = model_card(arguments.out, sources, command, params)
    write_whole(arguments.out.with_suffix(".md"), card)
    print(f"wrote {arguments.out} after {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    command_line.run(main)
