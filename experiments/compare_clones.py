"""Time the detectors of this clone and of another one on the same frames.

    git worktree add ../before TAG
    python -m experiments.compare_clones ../before --video project_video.mp4

Machines are noisy: the clones take turns, a new process each time, and medians are printed.
"""

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from vehicle_detection import command_line

_ROOT = Path(__file__).parents[1]
# Runs in either clone; the first frames only warm up.
_TIMES = """
import json, sys, time
from itertools import islice
from vehicle import Vehicle
from vehicle_detection.media.videos import read_frames
from vehicle_detection.two_stage.vehicle import TwoStageVehicle

frames = list(islice(read_frames(sys.argv[1]), int(sys.argv[2])))
vehicles = {"write-up G": Vehicle(None, "param/svc_pickle.p"), "two stages": TwoStageVehicle()}
times = {}
for name, vehicle in vehicles.items():
    for frame in frames[:20]:
        vehicle.detect(frame)
    vehicle.reset()
    times[name] = []
    for frame in frames:
        start = time.perf_counter()
        vehicle.detect(frame)
        times[name].append(time.perf_counter() - start)
print(json.dumps(times))
"""


def frame_times(clone, video, n_frames):
    """Milliseconds of every frame by detector, in a new process of a clone.

    Raises
    ------
    ValueError
        The clone cannot run them.
    """
    command = [sys.executable, "-c", _TIMES, Path(video).resolve(), str(n_frames)]
    variables = {**os.environ, "PYTHONPATH": str(clone)}
    result = subprocess.run(command, cwd=clone, env=variables, capture_output=True, text=True)
    if result.returncode:
        reason = result.stderr.strip().splitlines()
        raise ValueError(f"{clone}: {reason[-1] if reason else result.returncode}")
    return {name: 1000 * np.array(own) for name, own in json.loads(result.stdout).items()}


def compare(clones, video, n_frames, rounds):
    """Medians by detector and clone, of the medians of all rounds.

    Parameters
    ----------
    clones : list of path
    video : path
    n_frames, rounds : int

    Returns
    -------
    times : dict of str to ndarray of float, shape (len(clones),)
        Milliseconds a frame.
    """
    found = [[frame_times(clone, video, n_frames) for clone in clones] for _ in range(rounds)]
    return {
        name: np.median([[np.median(own[name]) for own in turn] for turn in found], axis=0)
        for name in found[0][0]
    }


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.compare_clones", description=__doc__.splitlines()[0]
    )
    parser.add_argument("other", type=Path, help="another clone or worktree of this project")
    parser.add_argument("--video", type=Path, default=Path("videos/drive.mp4"))
    parser.add_argument("--frames", type=int, default=200, help="default: %(default)s")
    parser.add_argument("--rounds", type=int, default=5, help="default: %(default)s")
    arguments = parser.parse_args()
    if not (arguments.other / "vehicle.py").is_file():
        raise ValueError(f"{arguments.other}: no clone of this project")
    clones = [_ROOT, arguments.other.resolve()]
    times = compare(clones, arguments.video, arguments.frames, arguments.rounds)
    print("milliseconds a frame: this clone, the other, ratio")
    for name, (own, other) in times.items():
        print(f"  {name:12}{own:8.2f}{other:8.2f}{own / other:8.2f}")


if __name__ == "__main__":
    command_line.run(main)
