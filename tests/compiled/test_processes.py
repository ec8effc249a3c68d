"""Work in several processes, none of which outlives the program."""

import os
import signal
import subprocess
import sys
import time

import pytest

from conftest import ROOT
from vehicle_detection.compiled.processes import each_at_once, in_parallel, workers


def squared(number):
    return number**2


def refused(number):
    raise ValueError(f"no {number}")


@pytest.mark.parametrize("jobs", [1, 2, -1])
def test_results_come_in_order(jobs):
    assert list(in_parallel(squared, list(range(20)), jobs, "x")) == [i**2 for i in range(20)]
    assert list(in_parallel(squared, [], jobs, "x")) == []
    with pytest.raises(ValueError, match="no 1"):
        list(in_parallel(refused, [1], jobs, "x"))


_PROGRAM = """
import os, time
from vehicle_detection import command_line
from vehicle_detection.compiled.processes import each_at_once, in_parallel, workers

def work(number):
    with open("pids", "a") as file:
        file.write(f"{os.getpid()}\\n")
    time.sleep(0.2)

def main():
    list(in_parallel(work, list(range(600)), 2, "x"))

if __name__ == "__main__":
    command_line.run(main)
"""


@pytest.mark.skipif(not os.path.isdir("/proc"), reason="reads /proc")
@pytest.mark.parametrize(
    ("how", "code"), [(signal.SIGKILL, -9), (signal.SIGTERM, 143), (signal.SIGINT, 130)]
)
def test_no_worker_is_left(tmp_path, how, code):
    (tmp_path / "program.py").write_text(_PROGRAM)
    process = subprocess.Popen(
        [sys.executable, "program.py"], cwd=tmp_path, stderr=subprocess.PIPE, text=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    pids = set()
    while len(pids) < 2:
        assert process.poll() is None
        time.sleep(0.1)
        if (tmp_path / "pids").exists():
            pids = set((tmp_path / "pids").read_text().split())
    process.send_signal(how)
    stderr = process.communicate()[1]
    assert process.returncode == code and "Traceback" not in stderr
    for _ in range(100):
        left = [pid for pid in pids if os.path.isdir(f"/proc/{pid}")]
        if not left:
            return
        time.sleep(0.1)
    pytest.fail(f"still there: {left}")


def killed_once(item):
    """Squares a number; the first process to take 3 is killed."""
    number, marker = item
    if number == 3 and not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item, number**2


def test_a_worker_that_is_killed_loses_only_what_it_was_at(tmp_path):
    items = [(number, tmp_path / "marker") for number in range(8)]
    with workers(None, 2):
        results = dict(each_at_once(killed_once, items))
    assert {item[0]: value for item, value in results.items()} == {n: n**2 for n in range(8)}
    assert (tmp_path / "marker").exists()


def test_a_missing_scheduler_is_said():
    pytest.importorskip("distributed", reason="dask.distributed is optional")
    with pytest.raises(OSError, match="tcp://127.0.0.1:9"), workers("tcp://127.0.0.1:9", 1):
        pass
