"""How long the two-stage detector takes: by stage, by size of frame, by vehicles, by clips.

Run by `python -m experiments.benchmark --detector two-stage`.
"""

import subprocess
import sys
from itertools import cycle
from pathlib import Path

import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from experiments.timing import alternately, milliseconds, once
from rendered_road.render import Actor, make_world, render
from vehicle_detection.two_stage.features import (
    cut_patches,
    describe_patches,
    margins_outside,
)
from vehicle_detection.two_stage.proposals import level_groups, propose
from vehicle_detection.two_stage.refinement import refine
from vehicle_detection.two_stage.road import prior_road, reach
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

FRAME_SIZES = ((640, 360), (1280, 720), (1920, 1080), (3840, 2160))
VEHICLE_COUNTS = (0, 1, 2, 5, 10, 20)
CLIP_COUNTS = (1, 2)
_GRAY = (0.5, 0.5, 0.5)
# In metres, and in lanes.
_CARS_AHEAD, _CAR_SPACING = 45.0, 0.65
_ROOT = Path(__file__).parents[1]


def stages(frames, detector):
    """Milliseconds a frame of every stage, the road not yet known."""
    vehicle = TwoStageVehicle(None, detector)
    for frame in frames:
        proposals = vehicle.detect(frame).proposals
    scan, learned, params = vehicle.params.scan, vehicle.detector, vehicle.params.road
    where = reach(prior_road(len(frame), params), len(frame), params)
    groups = cycle(level_groups(frame.shape[:2], scan, where))
    outside = margins_outside(proposals, frame.shape)
    patches = cut_patches(frame, proposals)
    features = describe_patches(patches, outside)
    calls = {
        "first stage": lambda: propose(frame, next(groups), learned.templates, scan),
        "second stage": lambda: refine(frame, proposals, learned),
        "of it, patches": lambda: cut_patches(frame, proposals),
        "of it, features": lambda: describe_patches(patches, outside),
        "of it, kernel machine": lambda: learned.machine.predict(features),
    }
    # As `refine` does.
    with threadpool_limits(1, "blas"):
        times = {name: milliseconds(call, 40) for name, call in calls.items()}
    return times | {"proposals, for comparison": len(proposals)}


def whole_frames(frames, detector):
    """Milliseconds of the whole detector: median, 99th percentile, and their ratio."""
    vehicle = TwoStageVehicle(None, detector)
    vehicle.detect(frames[0])
    times = [once(lambda f=frame: vehicle.detect(f)) for frame in frames]
    median, worst = np.percentile(times, (50, 99))
    return {"median": median, "99th percentile": worst, "ratio": worst / median}


def by_size(frames, detector, rounds=5):
    """Milliseconds a frame by pixels, the same frames at every size, in turn."""
    calls = {}
    for size in FRAME_SIZES:
        vehicle = TwoStageVehicle(None, detector)
        upcoming = cycle([cv2.resize(frame, size) for frame in frames[:20]])
        vehicle.detect(next(upcoming))
        calls[size[0] * size[1]] = lambda v=vehicle, u=upcoming: [
            v.detect(next(u)) for _ in range(20)
        ]
    return {pixels: value / 20 for pixels, value in alternately(calls, rounds).items()}


def traffic(count, seed=3):
    """A rendered plain with so many cars side by side, so that none hides another."""
    middle = make_world(seed).own_lane - _CAR_SPACING * (count - 1) / 2
    actors = [
        Actor(i + 1, "saloon", _GRAY, _CARS_AHEAD, 0.0, middle + _CAR_SPACING * i, style=i)
        for i in range(count)
    ]
    return make_world(seed, actors)


def by_vehicles(detector, rounds=5):
    """Milliseconds a frame by vehicles in it, once all that are found have tracks."""
    calls = {}
    for count in VEHICLE_COUNTS:
        vehicle, (frame, _) = TwoStageVehicle(None, detector), render(traffic(count), 0.0)
        for _ in range(15):
            vehicle.detect(frame)
        calls[count] = lambda v=vehicle, f=frame: [v.detect(f) for _ in range(20)]
    return {count: value / 20 for count, value in alternately(calls, rounds).items()}


def by_clips(clip, n_frames, folder, detector, rounds=3):
    """Milliseconds a frame of `detect.py` by clips at a time, a process each, with its start."""
    calls = {}
    for count in CLIP_COUNTS:
        clips = []
        for i in range(count):
            clips.append(folder / f"clip_{count}_{i}.mp4")
            clips[-1].write_bytes(Path(clip).read_bytes())
        command = [sys.executable, "detect.py", *clips, "--jobs", str(count), "--param", detector]
        command += ["--out", folder / "clips", "--overwrite", "--quiet"]
        calls[count] = lambda c=command: subprocess.run(c, cwd=_ROOT, check=True)
    times = alternately(calls, rounds)
    return {count: value / (count * n_frames) for count, value in times.items()}
