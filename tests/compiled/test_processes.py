"""Work in several processes, none of which outlives the program."""

import os
import signal
import subprocess
import sys
import time

import pytest

from conftest import ROOT
from vehicle_detection.compiled.processes import in_parallel


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
from vehicle_detection.compiled.processes import in_parallel

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
