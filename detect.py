"""Find the vehicles in images and videos, without a notebook.

python detect.py                         the shipped clip -> output/
python detect.py drive.mp4 --out output
python detect.py drive.mp4 --method G    the write-up's pipeline
"""

from __future__ import annotations

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vehicle_detection import command_line
from vehicle_detection.command_line import FAILED, LOSSES, add_version, nonempty_path
from vehicle_detection.parameters import (
    FILTER_PRESETS,
    METHODS,
    SEARCH_PRESETS,
    STILL_PARAMS,
    VIDEO_PARAMS,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from vehicle_detection.media.inputs import Source
    from vehicle_detection.media.mot import Rows
    from vehicle_detection.parameters import SearchParams

ROOT = Path(__file__).parent
SHIPPED_PARAMS = {
    "two-stage": ROOT / "param/detector.npz",
    "G": ROOT / "param/svc_pickle.p",
    "B": ROOT / "param/svc_b.p",
}
FORMAT_NAMES = ("mot", "csv", "json", "coco", "yolo")
# From a large file to a long wait.
ENCODER_PRESETS = (
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow",
)  # fmt: skip


def parse_arguments(arguments: list | None = None) -> argparse.Namespace:
    """Command line to a namespace; `--help` explains it."""
    parser = argparse.ArgumentParser(
        description="Box the vehicles in images and videos. Writes an annotated copy of each "
        "input and a file of boxes, in pixels of the frame as read.",
        epilog="examples: detect.py drive.mp4; detect.py photos/ --format coco --out boxes; "
        "detect.py drive.mp4 --method G --split-screen; detect.py rtsp://camera/stream. "
        "Exit code: 0 all done, 1 some input failed, 2 wrong usage, 3 frames of a video could "
        "not be decoded, 130 interrupted.",
    )
    parser.add_argument(
        "inputs", nargs="*", type=path_or_address, default=[ROOT / "videos/drive.mp4"],
        help="images, videos, folders of them, or the address of a stream; default: the shipped "
        "clip",
    )  # fmt: skip
    add_output_options(parser)
    add_detector_options(parser)
    add_search_options(parser)
    add_report_options(parser)
    add_run_options(parser)
    add_live_options(parser)
    chosen = parser.parse_args(arguments)
    chosen.report = chosen.report or chosen.embed or bool(chosen.truth)
    chosen.is_live = chosen.camera is not None or any(isinstance(i, str) for i in chosen.inputs)
    mistake = contradiction(chosen)
    if mistake:
        parser.error(mistake)
    return chosen


def path_or_address(text: str) -> Path | str:
    """An input: the address of a stream stays text, all else is a path."""
    if text.startswith(("rtsp://", "rtsps://", "http://", "https://")):
        return text
    return nonempty_path(text)


def contradiction(chosen: argparse.Namespace) -> str:
    """What is wrong with options that do not go together; empty if nothing is."""
    if chosen.method == "two-stage" and (chosen.horizon, chosen.scan_every) != (None, None):
        return "--horizon and --scan-every go with --method G or B only"
    if chosen.camera_height is not None and (chosen.method != "two-stage" or not chosen.calib):
        return "--camera-height goes with --calib and --method two-stage only"
    of_files = "report", "split_screen", "resume", "scheduler"
    if chosen.is_live and (chosen.form != "mot" or any(getattr(chosen, n) for n in of_files)):
        return "a stream has no --format, --report, --split-screen, --resume or --scheduler"
    if chosen.is_live and len(chosen.inputs) > 1:
        return "one stream at a time, and nothing beside it"
    return ""


def add_output_options(parser: argparse.ArgumentParser) -> None:
    """Options that say what is written, and where."""
    parser.add_argument(
        "--out", type=nonempty_path, default=Path("output"),
        help="folder to write to, default: output",
    )  # fmt: skip
    parser.add_argument(
        "--format", choices=FORMAT_NAMES, default=FORMAT_NAMES[0], dest="form",
        help="of the boxes: MOTChallenge rows (default), the same with a head, frames as JSON, "
        "COCO, or YOLO as CVAT takes it",
    )  # fmt: skip
    parser.add_argument(
        "--overwrite", action="store_true", help="replace results that are there already"
    )
    parser.add_argument(
        "--split-screen", action="store_true", help="of videos, also one of every step"
    )
    parser.add_argument(
        "--preset", choices=ENCODER_PRESETS, default=ENCODER_PRESETS[0],
        help="of the video encoder: a larger file or a longer wait",
    )  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="print nothing but what is wrong")
    add_version(parser)


def add_detector_options(parser: argparse.ArgumentParser) -> None:
    """Options that pick the detector and describe the camera."""
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
        "--calib", type=Path,
        help="calibration file: pictures are then drawn undistorted, and with two stages the "
        "metres to each vehicle are told, in csv, json and coco too",
    )  # fmt: skip
    parser.add_argument(
        "--camera-height", type=float, metavar="METRES",
        help="above the road, for distances; default: that of a car, by what is seen",
    )  # fmt: skip


def add_report_options(parser: argparse.ArgumentParser) -> None:
    """Options of the page about a video."""
    group = parser.add_argument_group("report", "of videos")
    group.add_argument(
        "--report", action="store_true",
        help="also a page to browse: panels, vehicles over time, frames to look at",
    )  # fmt: skip
    group.add_argument("--embed", action="store_true", help="the page is one file, video inside")
    group.add_argument(
        "--truth", type=nonempty_path, help="true boxes of the video, for errors in the page"
    )


def add_run_options(parser: argparse.ArgumentParser) -> None:
    """Options for many inputs."""
    group = parser.add_argument_group("many inputs")
    group.add_argument(
        "--resume", action="store_true",
        help="keep a list of what is finished, and skip what was finished with the same settings",
    )  # fmt: skip
    group.add_argument(
        "--jobs", type=int, default=1, help="inputs at once; -1: one a core; default: 1"
    )
    group.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT",
        help="of a Dask cluster whose workers see the same files: inputs are spread over it",
    )  # fmt: skip


def add_live_options(parser: argparse.ArgumentParser) -> None:
    """Options of cameras and streams."""
    group = parser.add_argument_group("live", "an RTSP or HTTP address as input, or a camera")
    group.add_argument("--camera", type=int, metavar="N", help="number of a camera of this machine")
    group.add_argument("--seconds", type=float, help="stop after so long; default: Ctrl-C")


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

        params = STILL_PARAMS if is_still else VIDEO_PARAMS
        height = replace(params.distance, camera_height=arguments.camera_height)
        return TwoStageVehicle(*paths, replace(params, distance=height))
    from vehicle import Vehicle
    from vehicle_detection.classifier import load_classifier

    calib, param = paths
    classifier = load_classifier(param, arguments.trust)
    heat_filter = FILTER_PRESETS["still" if is_still else arguments.method]
    return Vehicle(calib, classifier, chosen_search(arguments), heat_filter)


def annotate(source: Source, arguments: argparse.Namespace, vehicle: Any = None) -> tuple:
    """Detect in one input and write what was found.

    Parameters
    ----------
    source : Source
    arguments : argparse.Namespace
    vehicle : TwoStageVehicle or Vehicle, optional
        To detect with; made as the command line asks by default.

    Returns
    -------
    source : Source
    failure, losses : str
        What went wrong, and which frames could not be decoded; empty if nothing.
    """
    from vehicle_detection.media.annotate import annotate_image, annotate_video
    from vehicle_detection.report.page import report_data

    try:
        vehicle = vehicle or open_vehicle(arguments, is_still=not source.is_video)
        if not source.is_video:
            annotate_image(source, vehicle)
            return source, "", ""
        truth = read_truth(arguments, source) if arguments.truth else None
        split_screen = arguments.split_screen or arguments.report
        options = split_screen, arguments.preset, arguments.quiet
        found = annotate_video(source, vehicle, *options)
        if arguments.report:
            told = vehicle.titles, parameters_of(vehicle, arguments)
            write_report(source, report_data(source.path.name, found, *told, truth), arguments)
        return source, "", found.losses
    except (OSError, ValueError) as error:
        return source, str(error), ""


def parameters_of(vehicle: Any, arguments: argparse.Namespace) -> str:
    """All parameters of a detector, as text for its report."""
    from pprint import pformat

    return pformat({"method": arguments.method, **vehicle.settings()}, width=100)


def write_report(source: Source, data: dict, arguments: argparse.Namespace) -> None:
    """Write the page of a video beside its split screen, or with that inside."""
    from vehicle_detection.media.files import write_whole
    from vehicle_detection.report.page import page

    video = source.split_screen if arguments.embed else source.split_screen.name
    write_whole(source.report, page(data, video, arguments.embed))


def read_truth(arguments: argparse.Namespace, source: Source) -> Rows:
    """True boxes of a video for its report; they must lie in its frames."""
    from vehicle_detection.media.formats import read_boxes
    from vehicle_detection.media.mot import require_within
    from vehicle_detection.media.videos import video_info

    info = video_info(source.path)
    truth = read_boxes(arguments.truth, (info.width, info.height), is_truth=True)
    require_within(truth, (info.height, info.width), arguments.truth)
    return truth


def one_after_the_other(sources: list, arguments: argparse.Namespace) -> Iterator:
    """Yield what `annotate` returns, images first, with a progress bar for each video."""
    from tqdm.auto import tqdm

    images = [source for source in sources if not source.is_video]
    if images:
        still = open_vehicle(arguments, is_still=True)
        for source in tqdm(images, "images", unit="image", disable=arguments.quiet):
            yield annotate(source, arguments, still)
    for source in sources:
        if source.is_video:
            yield annotate(source, arguments, open_vehicle(arguments, is_still=False))


def side_by_side(sources: list, arguments: argparse.Namespace) -> Iterator:
    """Yield what `annotate` returns, from several processes, with a progress bar for all."""
    from functools import partial

    from tqdm.auto import tqdm

    from vehicle_detection.compiled.processes import each_at_once, workers
    from vehicle_detection.media.files import sweep

    alone = argparse.Namespace(**(vars(arguments) | {"quiet": True}))
    try:
        with workers(arguments.scheduler, arguments.jobs):
            results = each_at_once(partial(annotate, arguments=alone), sources)
            yield from tqdm(results, "inputs", len(sources), disable=arguments.quiet)
    finally:
        # Of workers that were killed because this program is stopped.
        for folder in {source.picture.parent for source in sources}:
            sweep(folder)


def run(arguments: argparse.Namespace) -> int:
    """Annotate all inputs; what is wrong with one does not stop the others.

    Returns
    -------
    code : int
        See `vehicle_detection.command_line`.
    """
    # Not at the top: `--help` would wait for the video and array libraries.
    from vehicle_detection.media.inputs import gather_inputs
    from vehicle_detection.media.journal import Journal

    if arguments.is_live:
        return run_live(arguments)
    sources = gather_inputs(arguments.inputs, arguments.out, arguments.form)
    # Before any work, for mistakes in parameter and truth files.
    for is_still in {not source.is_video for source in sources}:
        open_vehicle(arguments, is_still)
    if arguments.truth:
        for source in [source for source in sources if source.is_video][:1]:
            read_truth(arguments, source)
    arguments.out.mkdir(parents=True, exist_ok=True)
    journal = Journal(arguments.out, settings_of(arguments)) if arguments.resume else None
    sources = to_be_done(sources, journal, arguments)
    several = arguments.scheduler or arguments.jobs != 1
    annotated = side_by_side if several and len(sources) > 1 else one_after_the_other
    failures, losses = [], []
    for source, failure, lost in annotated(sources, arguments):
        if failure:
            failures.append(failure)
        elif journal:
            journal.finish(source)
        losses += [f"{source.path}: {lost}"] if lost else []
    return report(arguments, len(sources), failures, losses)


def to_be_done(sources: list, journal: Any, arguments: argparse.Namespace) -> list:
    """Inputs that are not finished, once it is sure that nothing of value is replaced."""
    from vehicle_detection.media.inputs import require_free_outputs, require_no_input

    require_no_input(sources, [arguments.truth, arguments.calib, arguments.param])
    if journal is None:
        require_free_outputs(sources, arguments.overwrite)
        return sources
    missing = [source for source in sources if not journal.is_finished(source, wanted(arguments))]
    # What an earlier run has made may be made anew.
    others = [source for source in missing if not journal.knows(source)]
    require_free_outputs(others, arguments.overwrite)
    for source in missing:
        journal.begin(source)
    return missing


def wanted(arguments: argparse.Namespace) -> set:
    """Names of a source's outputs that the command line asks for."""
    names = {"picture", "rows"}
    if arguments.split_screen or arguments.report:
        names.add("split_screen")
    return names | ({"report"} if arguments.report else set())


def run_live(arguments: argparse.Namespace) -> int:
    """Annotate a camera or stream until it ends or is stopped."""
    from vehicle_detection.media.streams import annotate_stream

    address = arguments.inputs[0] if arguments.camera is None else arguments.camera
    vehicle = open_vehicle(arguments, is_still=False)
    arguments.out.mkdir(parents=True, exist_ok=True)
    said = annotate_stream(
        address, arguments.out, vehicle, arguments.seconds, arguments.overwrite, arguments.preset
    )
    if not arguments.quiet:
        print(said)
    return 0


def settings_of(arguments: argparse.Namespace) -> dict:
    """All that results depend on."""
    from vehicle_detection.media.journal import digest

    param = arguments.param or SHIPPED_PARAMS[arguments.method]
    files = arguments.calib, param, arguments.truth
    names = [
        "method", "form", "preset", "split_screen", "report", "embed", "horizon", "scan_every",
        "camera_height",
    ]  # fmt: skip
    settings = {name: getattr(arguments, name) for name in names}
    return settings | {"files": [digest(path) if path else None for path in files]}


def report(arguments: argparse.Namespace, count: int, failures: list, losses: list) -> int:
    """Print how it went; the exit code."""
    for line in losses:
        print(f"warning: {line}", file=sys.stderr)
    for line in failures:
        print(f"error: {line}", file=sys.stderr)
    if not arguments.quiet:
        print(f"wrote {count - len(failures)} of {count} to {arguments.out}")
    if failures:
        return FAILED
    return LOSSES if losses else 0


def main() -> int:
    """Run the command line."""
    return run(parse_arguments())


if __name__ == "__main__":
    command_line.run(main)
