"""Find the vehicles in images and videos, without a notebook.

python detect.py                         the shipped clip -> output/
python detect.py drive.mp4 --out output
python detect.py drive.mp4 --method G    the write-up's pipeline
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vehicle_detection.parameters import (
    FILTER_PRESETS,
    METHODS,
    SEARCH_PRESETS,
    STILL_PARAMS,
    VIDEO_PARAMS,
)

if TYPE_CHECKING:
    from vehicle_detection.parameters import SearchParams

ROOT = Path(__file__).parent
SHIPPED_PARAMS = {
    "two-stage": ROOT / "param/detector.npz",
    "G": ROOT / "param/svc_pickle.p",
    "B": ROOT / "param/svc_b.p",
}
# From a large file to a long wait.
ENCODER_PRESETS = (
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow",
)  # fmt: skip


def parse_arguments(arguments: list | None = None) -> argparse.Namespace:
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        description="Box the vehicles in images and videos. Writes an annotated copy of each "
        "input and a text file of boxes, MOTChallenge rows in pixels of the frame as read.",
        epilog="examples: detect.py drive.mp4; detect.py photos/ --out boxes; "
        "detect.py drive.mp4 --method G --split-screen",
    )
    parser.add_argument(
        "inputs", nargs="*", type=Path, default=[ROOT / "videos/drive.mp4"],
        help="images, folders of them, videos; default: the shipped clip",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=Path("output"), help="folder to write to, default: output"
    )
    parser.add_argument(
        "--method", choices=METHODS, default=METHODS[0],
        help="two-stage: proposals, refinement and tracks (default); G, B: the pipeline of a "
        "write-up, with windows and heat",
    )  # fmt: skip
    parser.add_argument(
        "--param", type=Path,
        help="from two_stage.training or, with --method G or B, from train.py; default: shipped",
    )  # fmt: skip
    parser.add_argument(
        "--trust", nargs="+", default=[], metavar="MODULE.CLASS",
        help="classes to admit in a classifier's file, beside scikit-learn's scaler and SVMs",
    )  # fmt: skip
    parser.add_argument(
        "--calib", type=Path, help="calibration file: pictures are then drawn undistorted"
    )
    parser.add_argument(
        "--split-screen", action="store_true", help="of videos, also one of every step"
    )
    parser.add_argument(
        "--preset", choices=ENCODER_PRESETS, default=ENCODER_PRESETS[0],
        help="of the video encoder: a larger file or a longer wait",
    )  # fmt: skip
    add_search_options(parser)
    chosen = parser.parse_args(arguments)
    if chosen.method == "two-stage" and (chosen.horizon, chosen.scan_every) != (None, None):
        parser.error("--horizon and --scan-every go with --method G or B only")
    return chosen


def add_search_options(parser: argparse.ArgumentParser) -> None:
    """Options that spare the write-ups' search some windows."""
    group = parser.add_argument_group("fewer windows", "with --method G or B")
    group.add_argument(
        "--horizon", type=share, metavar="SHARE",
        help="where the road vanishes, as a share of the picture's height (0.57, say): visit "
        "only windows that could frame a vehicle on the road",
    )  # fmt: skip
    group.add_argument(
        "--scan-every", type=int, metavar="N",
        help="visit all windows in every Nth frame, in others only those near known vehicles",
    )  # fmt: skip


def share(text: str) -> float:
    """A number between 0 and 1 from the command line."""
    value = float(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError("a share lies between 0 and 1")
    return value


def chosen_search(arguments: argparse.Namespace) -> SearchParams:
    """The preset search, with what the command line changes of it."""
    search = SEARCH_PRESETS[arguments.method]
    if arguments.horizon is not None:
        search = replace(search, horizon=arguments.horizon * search.reference_size[1])
    if arguments.scan_every is not None:
        search = replace(search, scan_every=arguments.scan_every)
    return search


def open_vehicle(arguments: argparse.Namespace, is_still: bool) -> Any:
    """The detector that the command line asks for.

    Parameters
    ----------
    arguments : argparse.Namespace
        See `parse_arguments`.
    is_still : bool
        For pictures on their own instead of a video.

    Returns
    -------
    vehicle : TwoStageVehicle or Vehicle

    Raises
    ------
    FileNotFoundError, ValueError
        A parameter file is missing or of another kind.
    """
    paths = arguments.calib, arguments.param or SHIPPED_PARAMS[arguments.method]
    if arguments.method == "two-stage":
        from vehicle_detection.two_stage.vehicle import TwoStageVehicle

        return TwoStageVehicle(*paths, STILL_PARAMS if is_still else VIDEO_PARAMS)
    from vehicle import Vehicle
    from vehicle_detection.classifier import load_classifier

    calib, param = paths
    classifier = load_classifier(param, arguments.trust)
    heat_filter = FILTER_PRESETS["still" if is_still else arguments.method]
    return Vehicle(calib, classifier, chosen_search(arguments), heat_filter)


def run(arguments: argparse.Namespace) -> None:
    """Annotate all inputs."""
    # Not at the top: `--help` would wait for the video and array libraries.
    from tqdm.auto import tqdm

    from vehicle_detection.media.annotate import (
        annotate_image,
        annotate_video,
        gather_inputs,
        require_free_names,
    )

    images, videos = gather_inputs(arguments.inputs)
    require_free_names(images, videos, arguments.out)
    if images:
        still = open_vehicle(arguments, is_still=True)
        for path in tqdm(images, "images", unit="image"):
            annotate_image(path, arguments.out, still)
    for path in videos:
        vehicle = open_vehicle(arguments, is_still=False)
        annotate_video(path, arguments.out, vehicle, arguments.split_screen, arguments.preset)
    print(f"wrote {len(images)} images and {len(videos)} videos to {arguments.out}")


def main() -> None:
    """Run the command line."""
    arguments = parse_arguments()
    try:
        run(arguments)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
