"""Leave one camera out: train without a camera, test on it, for all cameras in turn.

    python -m experiments.leave_one_out run DATA [--quick]
    python -m experiments.leave_one_out report

The two-stage detector is trained on the cameras of `cameras.csv` but those that are left out.
`--quick` leaves out several at a time and learns from fewer frames: three trainings in place of
eight. `run` resumes where it was stopped; `--scheduler` spreads it over machines, see
`experiments.table`.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import hashlib
import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from experiments.table import RESULTS, read_results, run_all
from vehicle_detection import command_line
from vehicle_detection.compiled.processes import workers
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.evaluation.stills import StillFigures, score_folder
from vehicle_detection.evaluation.stills import table as stills_table
from vehicle_detection.media.files import write_whole
from vehicle_detection.media.mot import frame_range, read_rows, rows_of_detections
from vehicle_detection.media.videos import VIDEO_SUFFIXES, read_frames
from vehicle_detection.parameters import (
    DEFAULT_TRAINING,
    QUICK_TRAINING,
    STILL_PARAMS,
)
from vehicle_detection.two_stage.model import save_detector
from vehicle_detection.two_stage.training.__main__ import gather, parse_arguments, train_detector
from vehicle_detection.two_stage.training.first_stage import MINING_SCAN
from vehicle_detection.two_stage.training.footage import read_cameras
from vehicle_detection.two_stage.training.second_stage import CANDIDATE_SCAN
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

CAMERAS = Path(__file__).parent / "cameras.csv"
# Left out together by --quick: two groups of still cameras, and the videos.
QUICK_GROUPS = ("kitti+nuscenes_front", "camvid+nuscenes_1600+dusk", "project+dashcam1+driving")
# Rendered scenes are learned from, never tested on.
RENDERED = ("motorway", "town")
GTI = ("Far", "Left", "Right", "MiddleClose")


def training_arguments(data, without):
    """Arguments of `two_stage.training` for the training set and all cameras but some."""
    words = ["--cameras", str(CAMERAS), "--without", *without]
    words += ["--crops", f"{data}/vehicles/KITTI_extracted"]
    words += ["--square-crops", *(f"{data}/vehicles/GTI_{side}" for side in GTI)]
    words += ["--non-vehicles", f"{data}/non-vehicles"]
    for side in GTI:
        words += [
            "--boxed-crops",
            f"{data}/vehicles/GTI_{side}",
            f"param/gti_{side.lower()}.gt.txt",
        ]
    return parse_arguments(words)


def detector_path(group, quick, folder):
    """Where the detector of a group lies that was trained with these settings."""
    return Path(folder) / f"{group}_{settings_of(quick)}.npz"


def train_without(group, data, quick, folder):
    """Train without some cameras, unless it was done before; the path of the detector."""
    path = detector_path(group, quick, folder)
    if not path.is_file():
        params = QUICK_TRAINING if quick else DEFAULT_TRAINING
        training_set = gather(training_arguments(data, group.split("+")), params)
        if quick:
            training_set = replace(
                training_set,
                crops=training_set.crops[::2],
                square_crops=training_set.square_crops[::2],
                non_vehicles=training_set.non_vehicles[::2],
            )
        save_detector(train_detector(training_set, jobs=1, params=params), path)
    return path


def is_video(part):
    """Whether footage is a video; else it is a folder of stills."""
    return Path(part.path).suffix.lower() in VIDEO_SUFFIXES


def name_of(camera, part):
    """Of footage in a table: the camera of a video, the folder of stills."""
    return camera if is_video(part) else Path(part.truth).parent.name


def figures_of_footage(part, detector):
    """Figures of a folder of stills, picture by picture, or of a video, as a dict."""
    if not is_video(part):
        vehicle = TwoStageVehicle(None, detector, STILL_PARAMS)
        return asdict(score_folder(Path(part.truth).parent, vehicle))
    vehicle = TwoStageVehicle(None, detector)
    found = [vehicle.detect(frame) for frame in read_frames(part.path)]
    first, last, *_ = part.frames.split(":")
    truth, judged = read_rows(part.truth, is_truth=True), frame_range(f"{first}:{last}")
    figures = evaluate(truth, rows_of_detections(found), judged)
    wanted = ("recall", "precision", "mean IoU", "identity switches", "MOTA")
    return {name: figures[name] for name in wanted}


def run_group(configuration, data, quick, folder):
    """Train without the cameras of a group and test on them.

    Parameters
    ----------
    configuration : dict
        Its `id` is the cameras to leave out, joined by "+".
    data : path
        The training set.
    quick : bool
    folder : path
        For detectors.

    Returns
    -------
    row : dict
    """
    start = time.perf_counter()
    group = configuration["id"]
    path = train_without(group, data, quick, folder)
    cameras = read_cameras(CAMERAS)
    figures = {
        name_of(camera, part): figures_of_footage(part, path)
        for camera in group.split("+")
        for part in cameras[camera]
    }
    return {
        "id": group,
        "settings": settings_of(quick),
        "seconds": f"{time.perf_counter() - start:.0f}",
        "figures": json.dumps(figures),
    }


def settings_of(quick):
    """Short text that changes with the settings that a detector is trained with."""
    params = QUICK_TRAINING if quick else DEFAULT_TRAINING
    every = params, MINING_SCAN, CANDIDATE_SCAN, CAMERAS.read_text()
    return hashlib.sha1(repr(every).encode()).hexdigest()[:8]


def report(results):
    """Tables of stills and of videos as Markdown, and the mean AP over cameras."""
    figures = {}
    for row in results.values():
        figures |= json.loads(row["figures"])
    stills = {n: StillFigures(**f) for n, f in figures.items() if "average_precision" in f}
    lines = [stills_table(stills), ""]
    videos = {name: one for name, one in figures.items() if name not in stills}
    if videos:
        columns = list(next(iter(videos.values())))
        lines += [f"| video | {' | '.join(columns)} |", "|---" * (1 + len(columns)) + "|"]
        for name, one in videos.items():
            values = ["-" if one[c] is None else f"{one[c]:.3f}" for c in columns]
            lines.append(f"| {name} | {' | '.join(values)} |")
    return "\n".join([*lines, "", f"mean AP over cameras: {mean_over_cameras(stills):.3f}"])


def mean_over_cameras(stills):
    """Mean AP over cameras, of a camera over its folders."""
    of_camera = {}
    for camera, parts in read_cameras(CAMERAS).items():
        names = [name_of(camera, part) for part in parts]
        values = [stills[name].average_precision for name in names if name in stills]
        if values:
            of_camera[camera] = np.mean(values)
    return float(np.mean(list(of_camera.values())))


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.leave_one_out",
        description=__doc__.splitlines()[0],
        epilog="example: %(prog)s run data --quick",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="train and test what has no result yet")
    run.add_argument("data", type=Path, help="folder with vehicles/ and non-vehicles/")
    run.add_argument("--folder", type=Path, default=Path("output/leave_one_out"))
    run.add_argument("--jobs", type=int, default=-1, help="processes, default: one a core")
    run.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="of a Dask cluster")
    for command in (run, commands.add_parser("report", help="write the table")):
        command.add_argument("--quick", action="store_true", help="two groups, fewer frames")
    arguments = parser.parse_args()
    results_path = RESULTS / f"leave_one_out{'_quick' if arguments.quick else ''}.csv"
    if arguments.command == "run":
        groups = [c for c in read_cameras(CAMERAS) if c not in RENDERED]
        groups = QUICK_GROUPS if arguments.quick else groups
        rest = arguments.data, arguments.quick, arguments.folder
        with workers(arguments.scheduler, arguments.jobs, []):
            run_all(
                [{"id": group} for group in groups], results_path, run_group, rest,
                lambda _: settings_of(arguments.quick),
            )  # fmt: skip
    text = report(read_results(results_path))
    write_whole(results_path.with_suffix(".md"), text + "\n")
    print(text)


if __name__ == "__main__":
    command_line.run(main)
