"""Files that appear whole or not at all, whatever happens to their writer."""

import os
import signal
import subprocess
import sys

import pytest

from conftest import ROOT
from vehicle_detection.media import files
from vehicle_detection.media.files import require_free, write_whole, written_whole


def test_nothing_half_written_is_left(tmp_path):
    path = tmp_path / "new" / "result.txt"
    with pytest.raises(RuntimeError), written_whole(path) as file:
        file.write(b"half")
        raise RuntimeError
    assert list(path.parent.iterdir()) == []
    write_whole(path, "whole, ä")
    write_whole(path, b"whole again")
    assert [p.name for p in path.parent.iterdir()] == ["result.txt"]
    assert path.read_text() == "whole again"


def test_what_was_there_stays_until_the_end(tmp_path):
    path = tmp_path / "result.txt"
    path.write_text("before")
    with written_whole(path) as file:
        file.write(b"after")
        assert path.read_text() == "before"
    assert path.read_text() == "after"
    assert oct(path.stat().st_mode & 0o777) == oct(0o666 & ~_umask())


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_what_is_no_file_is_not_replaced(tmp_path):
    for path in (tmp_path, "/dev/null"):
        with pytest.raises(OSError, match="is no regular file"):
            write_whole(path, "text")


def test_a_link_is_not_followed(tmp_path):
    (tmp_path / "target.txt").write_text("mine")
    (tmp_path / "result.txt").symlink_to(tmp_path / "target.txt")
    write_whole(tmp_path / "result.txt", "new")
    assert (tmp_path / "target.txt").read_text() == "mine"
    assert (tmp_path / "result.txt").read_text() == "new"


_WRITER = """
import sys, time
from vehicle_detection.media.files import written_whole
with written_whole(sys.argv[1]) as file:
    file.write(b"half")
    print("ready", flush=True)
    time.sleep(60)
"""


def test_what_a_killed_process_left_is_swept_and_nothing_else(tmp_path):
    def writer(name):
        process = subprocess.Popen(
            [sys.executable, "-c", _WRITER, str(tmp_path / name)],
            cwd=ROOT, stdout=subprocess.PIPE,
        )  # fmt: skip
        process.stdout.readline()
        return process

    killed, living = writer("killed.txt"), writer("living.txt")
    try:
        killed.send_signal(signal.SIGKILL)
        killed.wait()
        (tmp_path / ".somebody-elses.partial").touch()
        assert len(list(tmp_path.iterdir())) == 3
        files._sweep_once.cache_clear()
        write_whole(tmp_path / "result.txt", "whole")
        names = sorted(path.name for path in tmp_path.iterdir())
        assert names[0] == ".somebody-elses.partial" and names[2] == "result.txt"
        assert names[1].startswith(".vehicles-") and len(names) == 3
    finally:
        for process in (killed, living):
            process.kill()
            process.wait()
            process.stdout.close()


def test_a_result_that_is_there_is_kept(tmp_path):
    assert require_free(tmp_path / "new.mp4", overwrite=False) == tmp_path / "new.mp4"
    (tmp_path / "old.mp4").touch()
    with pytest.raises(FileExistsError, match=r"old\.mp4 is there already"):
        require_free(tmp_path / "old.mp4", overwrite=False)
    assert require_free(tmp_path / "old.mp4", overwrite=True)
