"""How scripts end: codes, one line for a mistake, a traceback for a bug."""

import os
import signal
import subprocess
import sys
import time

import pytest

from conftest import ROOT, moving_frames, write_video

SCRIPTS = [
    ["detect.py"],
    ["train.py"],
    ["-m", "vehicle_detection.evaluation"],
    ["-m", "vehicle_detection.evaluation.stills"],
    ["-m", "vehicle_detection.media.calibration"],
    ["-m", "vehicle_detection.two_stage.training"],
    ["-m", "rendered_road.sample"],
]


def program(tmp_path, body):
    """A script whose main function has this body."""
    lines = "".join(f"    {line}\n" for line in body.splitlines())
    (tmp_path / "script.py").write_text(
        "from vehicle_detection import command_line\nimport sys, time\n"
        f"def main():\n{lines}\ncommand_line.run(main)\n"
    )
    return [sys.executable, str(tmp_path / "script.py")]


def run(command, **options):
    environment = os.environ | {"PYTHONPATH": str(ROOT)} | options.pop("env", {})
    return subprocess.run(command, capture_output=True, env=environment, cwd=ROOT, **options)


@pytest.mark.parametrize(
    ("body", "code", "stderr"),
    [
        ("pass", 0, b""),
        ("return 3", 3, b""),
        ("raise ValueError('wrong size')", 1, b"error: wrong size\n"),
        ("open('/nowhere')", 1, b"error: [Errno 2] No such file or directory: '/nowhere'\n"),
        ("raise KeyboardInterrupt", 130, b"\ninterrupted\n"),
    ],
)
def test_exit_codes(tmp_path, body, code, stderr):
    result = run(program(tmp_path, body))
    assert (result.returncode, result.stderr) == (code, stderr)


def test_a_bug_is_shown_whole(tmp_path):
    result = run(program(tmp_path, "{}['key']"))
    assert result.returncode == 1
    assert b"Traceback" in result.stderr and b"KeyError" in result.stderr


@pytest.mark.parametrize(("how", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_what_was_begun_is_tidied_up(tmp_path, how, code):
    body = "try:\n    print('ready', flush=True)\n    time.sleep(60)\nfinally:\n"
    body += "    time.sleep(0.3)\n    print('tidy', flush=True)"
    process = subprocess.Popen(
        program(tmp_path, body), stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    process.stdout.readline()
    process.send_signal(how)
    time.sleep(0.1)
    process.send_signal(how)
    stdout, stderr = process.communicate()
    assert (process.returncode, stdout) == (code, b"tidy\n")
    assert len(stderr.strip().splitlines()) == 1


@pytest.mark.parametrize("script", SCRIPTS, ids=" ".join)
def test_an_interrupt_while_libraries_load_is_one_line(script, tmp_path):
    process = subprocess.Popen(
        [sys.executable, *script, str(tmp_path / "nothing")], cwd=ROOT, stderr=subprocess.PIPE
    )
    time.sleep(0.15)
    # Some library may take the first for a failed import of its own.
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
        time.sleep(0.2)
    stderr = process.communicate()[1].strip().splitlines()
    # If it was too early, Python itself ends; if too late, the input is missing.
    assert process.returncode in (130, -signal.SIGINT, 1, 2)
    if process.returncode == 130:
        # Rendering has begun in one of them, and shows its progress.
        assert stderr[-1] == b"interrupted"
        assert b"Traceback" not in b"".join(stderr) and b"arning" not in b"".join(stderr)


@pytest.mark.parametrize("script", SCRIPTS, ids=" ".join)
def test_help_is_there_whatever_the_console(script, tmp_path):
    closed = subprocess.run(
        [sys.executable, *script, "--help"], cwd=ROOT, stdout=subprocess.PIPE,
        env=os.environ | {"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "HOME": str(tmp_path / "no")},
    )  # fmt: skip
    assert closed.returncode == 0 and b"usage" in closed.stdout


def test_closed_streams_and_pipes_end_nothing_badly(tmp_path):
    command = program(tmp_path, "for _ in range(100000):\n    print('line')")
    quoted = " ".join(command)
    result = run(["sh", "-c", f"{quoted} | head -1"])
    assert result.stdout == b"line\n" and result.stderr == b""
    assert run(["sh", "-c", f"{quoted} >&- 2>&-"]).returncode == 0


def test_names_that_a_console_lacks_are_escaped(tmp_path):
    clip = write_video(tmp_path / "Stra\u00dfe \U0001f697.mp4", moving_frames(3))
    result = run(
        [sys.executable, "detect.py", clip, "--out", tmp_path / "out"],
        env={"LC_ALL": "C", "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
    )
    assert result.returncode == 0, result.stderr
    result = run(
        [sys.executable, "detect.py", tmp_path / "\u00e4.mp4"],
        env={"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"},
    )
    assert result.returncode == 1 and b"Traceback" not in result.stderr


def test_an_empty_path_is_a_mistake():
    result = run([sys.executable, "detect.py", ""])
    assert result.returncode == 2 and b"a path is empty" in result.stderr
