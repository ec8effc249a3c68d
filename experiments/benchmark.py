"""How long everything takes, and against what.

    python -m experiments.benchmark [--detector G|two-stage] [--video V] [--data FOLDER] [--json]

Machines are noisy: whatever is compared runs alternately, and medians are
printed. The reference is the published way, window by window on scikit-image,
in `experiments/reference.py`.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

import cv2
import matplotlib.pyplot as plt
import numpy as np
from moviepy import VideoFileClip
from sklearn.preprocessing import StandardScaler
from sklearn.svm import LinearSVC

from experiments import benchmark_two_stage, reference
from experiments.timing import alternately, milliseconds, once
from pipeline_functions import (
    convert_color,
    dense_features,
    dense_scores,
    extract_features,
    find_cars,
    slide_window,
)
from train import fit_linear
from vehicle import Vehicle
from vehicle_detection import command_line
from vehicle_detection.classifier import load_classifier
from vehicle_detection.compiled.hog import hog_blocks
from vehicle_detection.media.annotate import annotate_video
from vehicle_detection.media.encoder import video_writer
from vehicle_detection.media.files import written_whole
from vehicle_detection.media.images import find_images, read_image
from vehicle_detection.media.inputs import gather_inputs
from vehicle_detection.media.training_images import load_training_set
from vehicle_detection.media.videos import (
    VideoInfo,
    VideoReader,
    read_frames,
    video_info,
)
from vehicle_detection.parameters import (
    FEATURE_PRESETS,
    FILTER_PRESETS,
    SEARCH_PRESETS,
    SearchParams,
)
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

FRAME_SIZES = ((640, 360), (1280, 720), (1920, 1080))


# --------------------------------------------------------------- one frame


def resized_bands(frame, search):
    """The bands of a frame at the size in which they are searched."""
    for _, top, (width, height), size in reference.bands(frame.shape, search):
        yield cv2.resize(frame[top : top + height, :width], size)


def stages(frames, paths):
    """Milliseconds a frame of every stage, one after the other."""
    vehicle = Vehicle(*paths[:2])
    classifier, search = vehicle.classifier, vehicle.search
    params, frame = classifier.params, frames[0]
    bands = list(resized_bands(frame, search))
    converted = [convert_color(band, params.hog_color) for band in bands]
    for warm_up in [*frames[:20], frame]:
        detections = vehicle.detect(warm_up)
    hog = params.orientations, params.pix_per_cell, params.cells_per_block
    calls = {
        "undistort": lambda: vehicle.undistort(frame),
        "resize": lambda: list(resized_bands(frame, search)),
        "colour": lambda: [convert_color(band, params.hog_color) for band in bands],
        "HOG": lambda: [hog_blocks(img, *hog) for img in converted],
        "colour, HOG and features": lambda: [
            dense_features(band, params, search.cells_per_step) for band in bands
        ],
        "colour, HOG and scores": lambda: [
            dense_scores(band, params, search.cells_per_step, *classifier.linear) for band in bands
        ],
        "search": lambda: find_cars(frame, classifier, search),
        "heat, labels and tracks": lambda: vehicle.remember(detections.hot_windows),
        "drawing": lambda: vehicle.draw(frame, detections),
    }
    return {name: milliseconds(call, 25) for name, call in calls.items()}


def detector(frames, paths):
    """Whole detector against the published way of doing all of it, milliseconds a frame."""
    vehicle = Vehicle(None, paths[1])
    slow = reference.Detector(vehicle.classifier, vehicle.search, FILTER_PRESETS["G"])
    for frame in frames[:15]:
        hot = vehicle.detect(frame).hot_windows
        slow.heatmaps.append(reference.heatmap_of(hot, frame.shape))
    two_stages = TwoStageVehicle(None, paths[2])
    upcoming = cycle(frames)
    times = alternately(
        {
            "detector": lambda: [vehicle.detect(next(upcoming)) for _ in range(20)],
            "two stages": lambda: [two_stages.detect(next(upcoming)) for _ in range(20)],
            "reference": lambda: slow.detect(next(upcoming)),
        },
        rounds=7,
    )
    times["detector"] /= 20
    times["two stages"] /= 20
    return times | {
        "ratio": times["reference"] / times["detector"],
        "ratio, two stages": times["reference"] / times["two stages"],
    }


# --------------------------------------------------------------- whole jobs


def video_job(clip, paths, folder, preset="ultrafast"):
    """Annotating a video against copying it with moviepy, milliseconds a frame."""
    vehicle = Vehicle(None, paths[1])
    sparing = Vehicle(None, paths[1], replace(SEARCH_PRESETS["G"], scan_every=3))
    two_stages = TwoStageVehicle(None, paths[2])
    (source,) = gather_inputs([clip], folder / "job")

    def job(one):
        """The whole job with a detector."""
        return lambda: annotate_video(source, one, preset=preset, quiet=True)

    times = alternately(
        {
            "video job": job(vehicle),
            "video job, scan every 3": job(sparing),
            "video job, two stages": job(two_stages),
            "plain copy": lambda: copy_video(clip, folder / "copy.mp4", preset),
            "own copy": lambda: own_copy(clip, folder / "own.mp4", preset),
        },
        rounds=3,
    )
    n_frames = video_info(clip).n_frames
    times = {name: value / n_frames for name, value in times.items()}
    return times | {
        "ratio": times["video job"] / times["plain copy"],
        "ratio, scan every 3": times["video job, scan every 3"] / times["plain copy"],
        "ratio, two stages": times["video job, two stages"] / times["plain copy"],
        "ratio, two stages to own copy": times["video job, two stages"] / times["own copy"],
        "frames a second": 1000 / times["video job"],
    }


def copy_video(source, target, preset):
    """Decode and encode a video with moviepy, and nothing else."""
    with VideoFileClip(str(source)) as clip:
        clip.write_videofile(str(target), preset=preset, audio=False, logger=None)


def own_copy(source, target, preset):
    """Decode and encode a video as `detect.py` does, and nothing else."""
    reader = VideoReader(source)
    with video_writer(target, reader.info, preset, source) as write:
        for frame in reader:
            write(frame.rgb, frame.time)


def reference_training(vehicles, others, params):
    """Train as published: one image after the other, scikit-image, one core."""
    features = []
    for path in vehicles + others:
        img = read_image(path)
        features.append(reference.band_features(img, params, 1)[0, 0])
    labels = np.repeat([1, 0], [len(vehicles), len(others)])
    scaled = StandardScaler().fit_transform(np.array(features))
    LinearSVC(C=0.001).fit(scaled, labels)


def fast_training(data, params):
    """Read, describe and fit all images."""
    training_set = load_training_set(data)
    features = extract_features(training_set.images, params)
    fit_linear(features, training_set.labels, C=0.001, seed=0)


def training(data):
    """Seconds from images to classifier, against the reference, preset G."""
    params = FEATURE_PRESETS["G"]
    vehicles, others = find_images(data / "vehicles"), find_images(data / "non-vehicles")
    times = alternately(
        {
            "training": lambda: fast_training(data, params),
            "reference": lambda: reference_training(vehicles, others, params),
        },
        rounds=3,
    )
    times = {f"{name}, s": value / 1000 for name, value in times.items()}
    return times | {"ratio": times["reference, s"] / times["training, s"]}


_PEAK = """
import re, sys
from pathlib import Path
from vehicle import Vehicle
from vehicle_detection.media.annotate import annotate_video
from vehicle_detection.media.inputs import gather_inputs
(source,) = gather_inputs([sys.argv[1]], sys.argv[2])
annotate_video(source, Vehicle(None, sys.argv[3]))
# Not getrusage: its peak includes that of the process this one was forked from.
print(int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024)
"""


def peak_memory(frames, info, paths, folder, lengths):
    """Peak memory of the video job in MB, by number of frames; reads /proc, Linux only."""
    peaks = {}
    for length in lengths:
        clip = write_clip(folder / f"{length}.mp4", frames, info, length)
        result = subprocess.run(
            [sys.executable, "-c", _PEAK, clip, folder / "job", paths[1]],
            cwd=Path(__file__).parents[1], capture_output=True, text=True, check=True,
        )  # fmt: skip
        peaks[f"{length} frames"] = float(result.stdout)
    return peaks


def write_clip(path, frames, info, length):
    """A video of `length` frames, those given over and over."""
    with video_writer(path, VideoInfo(info.width, info.height, info.fps, length)) as write:
        for i in range(length):
            write(frames[i % len(frames)])
    return path


# ------------------------------------------------------------------- growth


def growth(frames, paths):
    """Milliseconds by frame size, by number of windows, by number of frames."""
    classifier = load_classifier(paths[1])
    search = SEARCH_PRESETS["G"]
    by_size, by_windows, by_frames = {}, {}, {}
    for size in FRAME_SIZES:
        resized = cv2.resize(frames[0], size)
        by_size[size[0] * size[1]] = milliseconds(
            lambda f=resized: find_cars(f, classifier, search), 15
        )
    for cells in (8, 4, 2, 1):
        other = SearchParams(bands=search.bands, cells_per_step=cells)
        n_windows = len(slide_window(frames[0].shape, classifier.params, other))
        by_windows[n_windows] = milliseconds(
            lambda s=other: find_cars(frames[0], classifier, s), 15
        )
    vehicle = Vehicle(None, paths[1])
    for count in (10, 30, 100):
        vehicle.reset()
        by_frames[count] = once(
            lambda n=count: [vehicle.detect(frames[i % len(frames)]) for i in range(n)]
        )
    return {"pixels": by_size, "windows": by_windows, "frames": by_frames}


def draw_growth(figures):
    """Figure of milliseconds by several things, log-log but where something is 0."""
    size = 4 * len(figures), 3.5
    figure, axes = plt.subplots(1, len(figures), figsize=size, layout="constrained")
    for axis, (name, times) in zip(axes, figures.items(), strict=True):
        axis.plot(list(times), list(times.values()), marker="o")
        scale = "symlog" if 0 in times else "log"
        axis.set(xlabel=name, ylabel="milliseconds", xscale=scale, yscale="log")
        axis.set_xticks(list(times), [f"{x:,}" for x in times], rotation=30)
        axis.set_ylim(1, 2 * max(times.values()))
        axis.minorticks_off()
        axis.yaxis.set_major_formatter("{x:g}")
        axis.grid(which="both", alpha=0.3)
    return figure


# --------------------------------------------------------------- command line


def first_frames(video):
    """Up to two hundred frames of a video."""
    return list(islice(read_frames(video), 200))


def measure_two_stage(arguments, folder):
    """Every figure of the two-stage detector, as a dict of dicts, and those to be drawn."""
    detector = arguments.two_stage_param.resolve()
    frames = first_frames(arguments.video)
    clip = write_clip(folder / "clip.mp4", frames, video_info(arguments.video), arguments.frames)
    figures = {
        "milliseconds a frame": benchmark_two_stage.whole_frames(frames, detector),
        "milliseconds a frame, by stage": benchmark_two_stage.stages(frames, detector),
    }
    by_clips = benchmark_two_stage.by_clips(clip, arguments.frames, folder, detector)
    curves = {
        "pixels": benchmark_two_stage.by_size(frames, detector),
        "vehicles": benchmark_two_stage.by_vehicles(detector),
        "clips at a time": by_clips,
    }
    return figures, curves


def measure(arguments, folder):
    """Every figure of the pipeline, as a dict of dicts, and those to be drawn."""
    paths = [p.resolve() for p in (arguments.calib, arguments.param, arguments.two_stage_param)]
    info = video_info(arguments.video)
    frames = first_frames(arguments.video)
    clip = write_clip(folder / "clip.mp4", frames, info, arguments.frames)
    figures = {
        "milliseconds a frame, by stage": stages(frames, paths),
        "milliseconds a frame, detector": detector(frames, paths),
        "milliseconds a frame, video": video_job(clip, paths, folder),
        "peak memory of the video job, MB": peak_memory(
            frames, info, paths, folder, (100, 400, 1260)
        ),
    }
    if arguments.data:
        figures["training"] = training(arguments.data)
    return figures, growth(frames, (None, arguments.param))


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(
        description="Time the detector, its stages and its jobs.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
        epilog="example: %(prog)s --json",
    )
    parser.add_argument("--video", type=Path, default=Path("videos/drive.mp4"))
    parser.add_argument("--frames", type=int, default=300, help="length of the video job")
    parser.add_argument(
        "--data", type=Path, help="G: folder with vehicles/ and non-vehicles/, also time training"
    )
    parser.add_argument("--param", type=Path, default=Path("param/svc_pickle.p"))
    parser.add_argument(
        "--detector", choices=("G", "two-stage"), default="G", help="which one to take apart"
    )
    parser.add_argument("--two-stage-param", type=Path, default=Path("param/detector.npz"))
    parser.add_argument("--calib", type=Path, default=Path("param/calib.p"))
    parser.add_argument("--out", type=Path, default=Path("output"), help="for the figures")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    arguments = parser.parse_args()
    is_two_stage = arguments.detector == "two-stage"
    if is_two_stage and arguments.data:
        parser.error("--data belongs to --detector G")
    with tempfile.TemporaryDirectory() as folder:
        run = measure_two_stage if is_two_stage else measure
        figures, curves = run(arguments, Path(folder))
    figures |= {f"milliseconds by {name}": times for name, times in curves.items()}
    if arguments.json:
        print(json.dumps(figures, indent=1))
    else:
        for title, values in figures.items():
            print(title)
            for name, value in values.items():
                print(f"  {name!s:28}{value:10.2f}")
    name = "growth_two_stage.png" if is_two_stage else "growth.png"
    with written_whole(arguments.out / name) as file:
        draw_growth(curves).savefig(file, dpi=90)


if __name__ == "__main__":
    command_line.run(main)
