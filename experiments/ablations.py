"""What each rule of the two-stage detector is worth: errors with it and without it.

    python -m experiments.ablations

Every clip is run with a detector of `leave_one_out --quick` that has not learned from its
camera. Errors are false positives and misses at an IoU of 0.5; for stills, the mean average
precision over folders is given. Errors hang on which levels are visited in which frame, so a clip
is run several times, each time with one frame more before it, and means are given.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed, parallel_config

from experiments.leave_one_out import QUICK_GROUPS, detector_path
from vehicle_detection import command_line
from vehicle_detection.compiled.processes import begin_worker
from vehicle_detection.evaluation.metrics import evaluate
from vehicle_detection.evaluation.stills import score_folder
from vehicle_detection.media.files import write_whole
from vehicle_detection.media.images import find_images, read_image
from vehicle_detection.media.mot import frame_range, read_rows, rows_of_detections
from vehicle_detection.media.videos import read_frames
from vehicle_detection.parameters import (
    DEFAULT_ROAD,
    DEFAULT_SCAN,
    DEFAULT_SELECTION,
    DEFAULT_TRACKS,
    STILL_PARAMS,
    VIDEO_PARAMS,
    TwoStageParams,
)
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

SHARED, DETECTORS = Path("../shared"), Path("output/leave_one_out")
TABLE = Path(__file__).parents[1] / "docs/ablations.md"
# So many frames before a clip.
_STARTS = range(3)
# Frames, truth, which are judged, and the group whose detector has not learned from them.
CLIPS = {
    "project 1-630": ("udacity/project_video.mp4", "truth/project_video.gt.txt", "1:630", 2),
    "dashcam1": ("extra/dashcam1.mp4", "param/dashcam1.gt.txt", "11:511", 2),
    "driving": ("extra/driving.mp4", "param/driving.gt.txt", "129:296", 2),
    "kitti_tracking": (
        "footage/kitti_tracking_0002/images", "footage/kitti_tracking_0002/gt.txt", "1:91", 0,
    ),
    "rendered": ("videos/drive.mp4", "videos/drive.gt.txt", "1:150", 0),
}  # fmt: skip
STILLS = {
    "kitti_object": 0, "nuscenes_front": 0,
    "camvid": 1, "camvid_more": 1, "nuscenes_1600": 1, "dusk_clip": 1,
}  # fmt: skip


def selection(**changes):
    """All rules but some of the selection."""
    return TwoStageParams(selection=replace(DEFAULT_SELECTION, **changes))


def road(**changes):
    """All rules but some of the road."""
    return TwoStageParams(road=replace(DEFAULT_ROAD, **changes))


def tracks(**changes):
    """All rules but some of the tracks."""
    return TwoStageParams(tracks=replace(DEFAULT_TRACKS, **changes))


VARIANTS = {
    "none": VIDEO_PARAMS,
    "no road (cost 0)": road(cost=0),
    "cars of 1000 frames tell the road (n_frames)": road(n_frames=1000),
    "parts of better boxes stay (max_covered 1)": selection(max_covered=1),
    "lorries tell the road too (whole_car_aspect 0)": selection(whole_car_aspect=0),
    "scores less 0.1 instead of 0.5 (score_offset)": tracks(score_offset=0.1),
    "confirmed at once (confirm_at 0)": tracks(confirm_at=0),
    "a third of the levels a frame (n_groups 3)": TwoStageParams(
        scan=replace(DEFAULT_SCAN, n_groups=3)
    ),
    "videos are looked at mirrored, too": TwoStageParams(mirrored=True),
}
STILL_VARIANTS = {"stills are not looked at mirrored": replace(STILL_PARAMS, mirrored=False)}


def located(path):
    """Where a file of a clip is: beside the program or in the shared data."""
    own = Path(__file__).parents[1] / path
    return own if own.exists() else SHARED / path


def frames_of(path):
    """Frames of a video or of a folder of images."""
    return map(read_image, find_images(path)) if path.is_dir() else read_frames(path)


def errors_on(clip, rules):
    """Mean false positives, misses and identity switches of a variant on a clip."""
    path, truth, judged, group = clip
    judged = frame_range(judged)
    vehicle = TwoStageVehicle(None, detector_path(QUICK_GROUPS[group], True, DETECTORS), rules)
    rows = read_rows(located(truth), is_truth=True)
    errors = []
    for start in _STARTS:
        vehicle.reset()
        frames = islice(frames_of(located(path)), judged[-1])
        before = [next(frames)] * (start + 1)
        found = [vehicle.detect(frame) for frame in chain(before, frames)][start:]
        figures = evaluate(rows, rows_of_detections(found), judged)
        names = "false positives", "misses", "identity switches"
        errors.append([figures[name] or 0 for name in names])
    return np.mean(errors, axis=0)


def precision_on_stills(params):
    """Mean average precision of a variant over the folders of stills."""
    values = []
    for name, group in STILLS.items():
        detector = detector_path(QUICK_GROUPS[group], True, DETECTORS)
        vehicle = TwoStageVehicle(None, detector, params)
        values.append(score_folder(SHARED / "footage" / name, vehicle).average_precision)
    return float(np.mean(values))


def row_of(name, rules, base):
    """A row of the table: errors by clip, and AP where selection or road differ."""
    cells = []
    for clip in CLIPS.values():
        false, missed, switches = errors_on(clip, rules)
        cells.append(f"{false:.0f}+{missed:.0f}" + (f" ({switches:.1f} sw)" if switches else ""))
    per_still = rules == base or (rules.selection, rules.road) != (base.selection, base.road)
    of_stills = replace(STILL_PARAMS, selection=rules.selection, road=rules.road)
    cells.append(f"{precision_on_stills(of_stills):.3f}" if per_still else "same")
    return f"| {name} | {' | '.join(cells)} |"


def row_of_stills(name, params):
    """A row of what only stills differ in."""
    return f"| {name} |{' same |' * len(CLIPS)} {precision_on_stills(params):.3f} |"


def main():
    """Write docs/ablations.md."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.ablations",
        description=__doc__.splitlines()[0],
        epilog="example: %(prog)s --jobs 2",
    )
    parser.add_argument("--jobs", type=int, default=-1, help="processes, default: one a core")
    arguments = parser.parse_args()
    missing = [g for g in QUICK_GROUPS if not detector_path(g, True, DETECTORS).is_file()]
    if missing or not SHARED.is_dir():
        raise ValueError(f"run experiments.leave_one_out run --quick first: no {missing}")
    with parallel_config("loky", n_jobs=arguments.jobs, initializer=begin_worker):
        calls = [delayed(row_of)(*variant, VIDEO_PARAMS) for variant in VARIANTS.items()]
        calls += [delayed(row_of_stills)(*variant) for variant in STILL_VARIANTS.items()]
        rows = Parallel()(calls)
    heads = [*CLIPS, "AP of stills"]
    lines = [
        "# Ablations", "",
        "What each rule of the two-stage detector is worth, switched off or changed alone. Cells",
        "are false positives + misses at an IoU of 0.5, identity switches in brackets. Every clip",
        "is run with a detector that has not learned from its camera, three times, with none to",
        "two frames before it; means are given. The last column is the mean average precision over",
        "six folders of stills.", "",
        "```sh", "python -m experiments.leave_one_out run DATA --quick",
        "python -m experiments.ablations", "```", "",
        f"| rule off | {' | '.join(heads)} |", "|---" * (1 + len(heads)) + "|", *rows, "",
    ]  # fmt: skip
    write_whole(TABLE, "\n".join(lines))
    print("\n".join(rows))


if __name__ == "__main__":
    command_line.run(main)
