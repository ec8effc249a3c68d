import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from experiments import compare_clones
from vehicle_detection.media.encoder import video_writer
from vehicle_detection.media.videos import VideoInfo

ROOT = Path(compare_clones.__file__).parents[1]


def test_medians_of_rounds_by_clone(monkeypatch):
    times = iter([[1, 9, 2], [30, 10, 20], [4, 4, 4], [40, 40, 40], [3, 3, 3], [60, 60, 60]])
    calls = []

    def measured(clone, video, n_frames):
        calls.append(clone)
        return {"a": np.array(next(times))}

    monkeypatch.setattr(compare_clones, "frame_times", measured)
    found = compare_clones.compare(["own", "other"], "v.mp4", 3, 3)
    assert calls == ["own", "other"] * 3
    np.testing.assert_array_equal(found["a"], [3, 40])


def test_a_clone_is_timed_in_a_process_of_its_own(tmp_path):
    with video_writer(tmp_path / "v.mp4", VideoInfo(320, 180, 25, 3)) as write:
        for value in (50, 60, 70):
            write(np.full((180, 320, 3), value, np.uint8))
    times = compare_clones.frame_times(ROOT, tmp_path / "v.mp4", 2)
    assert {name: len(own) for name, own in times.items()} == {"write-up G": 2, "two stages": 2}
    assert all((own > 0).all() for own in times.values())
    with pytest.raises(ValueError, match=str(tmp_path)):
        compare_clones.frame_times(tmp_path, tmp_path / "v.mp4", 2)


def test_what_is_no_clone_is_refused(tmp_path):
    command = [sys.executable, "-m", "experiments.compare_clones", str(tmp_path)]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 1 and "no clone of this project" in result.stderr
