"""Leave one camera out: train without a camera, test on it, for all cameras in turn.

    python -m experiments.leave_one_out run DATA [--quick] [--set machine_size=200,1000]
    python -m experiments.leave_one_out report [--quick]
    python -m experiments.leave_one_out compare

The two-stage detector is trained on the cameras of `cameras.csv` but those that are left out.
`--quick` leaves out several at a time and learns from fewer frames: three trainings in place of
eight. `--set` tries other settings than the shipped ones, and keeps their results apart.
`compare` tells whether the quick way ranks settings and folders like the full one. `run` resumes
where it was stopped; `--scheduler` spreads it over machines, see `experiments.table`.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import ast
import hashlib
import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

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


def training_params(quick, changes=()):
    """The settings of a way of training, with some of them changed: (name, value) each."""
    return replace(QUICK_TRAINING if quick else DEFAULT_TRAINING, **dict(changes))


def detector_path(group, quick, folder, changes=()):
    """Where the detector of a group lies that was trained with these settings."""
    return Path(folder) / f"{group}_{settings_of(quick, changes)}.npz"


def train_without(group, data, quick, folder, changes=()):
    """Train without some cameras, unless it was done before; the path of the detector."""
    path = detector_path(group, quick, folder, changes)
    if not path.is_file():
        params = training_params(quick, changes)
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


def run_group(configuration, data, quick, folder, changes=()):
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
    changes : sequence of (str, object)
        Other settings, see `training_params`.

    Returns
    -------
    row : dict
    """
    start = time.perf_counter()
    group = configuration["id"]
    path = train_without(group, data, quick, folder, changes)
    cameras = read_cameras(CAMERAS)
    figures = {
        name_of(camera, part): figures_of_footage(part, path)
        for camera in group.split("+")
        for part in cameras[camera]
    }
    return {
        "id": group,
        "settings": settings_of(quick, changes),
        "seconds": f"{time.perf_counter() - start:.0f}",
        "figures": json.dumps(figures),
    }


def settings_of(quick, changes=()):
    """Short text that changes with the settings that a detector is trained with."""
    every = training_params(quick, changes), MINING_SCAN, CANDIDATE_SCAN, CAMERAS.read_text()
    return hashlib.sha1(repr(every).encode()).hexdigest()[:8]


def results_path(quick, changes=(), folder=RESULTS):
    """Where the results of a way of training lie."""
    words = ["leave_one_out", *["quick"] * quick]
    words += [f"{name}={value}".translate(str.maketrans("", "", " ()")) for name, value in changes]
    return Path(folder) / f"{'_'.join(words)}.csv"


def all_figures(results):
    """Figures of stills and of videos by name, from the rows of a results file."""
    figures = {}
    for row in results.values():
        figures |= json.loads(row["figures"])
    stills = {n: StillFigures(**f) for n, f in figures.items() if "average_precision" in f}
    return stills, {name: one for name, one in figures.items() if name not in stills}


def report(results):
    """Tables of stills and of videos as Markdown, and the mean AP over cameras."""
    stills, videos = all_figures(results)
    lines = [stills_table(stills), ""]
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


def compare(folder=RESULTS):
    """AP of the folders that were scored in the quick and in the full way, as Markdown.

    One column a way and setting; below, how like they rank folders.
    """
    stills = {}
    for path in sorted(Path(folder).glob("leave_one_out*.csv")):
        name = path.stem.removeprefix("leave_one_out").strip("_") or "full"
        stills[name] = all_figures(read_results(path))[0]
    pairs = [
        (name, name.replace("quick", "").strip("_") or "full") for name in stills if "quick" in name
    ]
    pairs = [pair for pair in pairs if pair[1] in stills]
    if not pairs:
        raise ValueError("compare needs results of run with and without --quick")
    names = [name for pair in pairs for name in pair]
    folders = [f for f in stills[names[0]] if all(f in stills[name] for name in names)]
    values = np.array([[stills[n][f].average_precision for n in names] for f in folders])
    lines = [f"| folder | {' | '.join(names)} |", "|---" * (1 + len(names)) + "|"]
    for title, row in zip([*folders, "mean"], [*values, values.mean(axis=0)], strict=True):
        lines.append(f"| {title} | {' | '.join(f'{value:.3f}' for value in row)} |")
    lines.append("")
    for i, (quick, full) in enumerate(pairs):
        rank = spearmanr(values[:, 2 * i], values[:, 2 * i + 1]).statistic
        lines.append(f"rank correlation of folders, {quick} and {full}: {rank:.2f}")
    return "\n".join(lines)


def setting(text):
    """`NAME=VALUE` of the command line as (name, value)."""
    name, _, value = text.partition("=")
    if name not in vars(DEFAULT_TRAINING):
        raise argparse.ArgumentTypeError(f"{name!r} is no attribute of TrainingParams")
    try:
        return name, ast.literal_eval(value)
    except (SyntaxError, ValueError):
        raise argparse.ArgumentTypeError(f"{value!r} is no value") from None


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
    run.add_argument("--only", nargs="+", metavar="CAMERA", help="leave out only these, in turn")
    for command in (run, commands.add_parser("report", help="write the table")):
        command.add_argument("--quick", action="store_true", help="three groups, fewer frames")
        command.add_argument(
            "--set", type=setting, action="append", default=[], metavar="NAME=VALUE",
            help="another setting of TrainingParams; can be given several times",
        )  # fmt: skip
    commands.add_parser("compare", help="whether the quick way ranks like the full one")
    arguments = parser.parse_args()
    if arguments.command == "compare":
        print(compare())
        return
    path = results_path(arguments.quick, arguments.set)
    if arguments.command == "run":
        groups = [c for c in read_cameras(CAMERAS) if c not in RENDERED]
        groups = arguments.only or (QUICK_GROUPS if arguments.quick else groups)
        rest = arguments.data, arguments.quick, arguments.folder, arguments.set
        with workers(arguments.scheduler, arguments.jobs, []):
            run_all(
                [{"id": group} for group in groups], path, run_group, rest,
                lambda _: settings_of(arguments.quick, arguments.set),
            )  # fmt: skip
    text = report(read_results(path))
    write_whole(path.with_suffix(".md"), text + "\n")
    print(text)


if __name__ == "__main__":
    command_line.run(main)
