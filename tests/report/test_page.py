"""The page about a video: its data by hand, and the page in a browser, where there is one."""

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from conftest import CASES, ROOT, moving_frames, write_video
from test_detect import run
from vehicle_detection.media.annotate import Found
from vehicle_detection.media.mot import Rows
from vehicle_detection.report.page import page, report_data


def some_rows(*values):
    """Rows from (frame, id, left, top, right, bottom, score)."""
    table = np.array(values, float).reshape(-1, 7)
    frames, ids = table[:, :2].astype(np.int64).T
    return Rows(frames, ids, table[:, 2:6], table[:, 6], np.full(len(table), -1.0))


ROWS = some_rows(
    (1, 1, 0, 0, 40, 40, 1), (2, 1, 0, 0, 40, 40, 2), (2, 2, 90, 0, 120, 30, 0.5),
    (5, 1, 0, 0, 40, 60, 3),
)  # fmt: skip
FOUND = Found(ROWS, [1, 2, 4, 5], [0.0, 0.04, 0.12, 0.16], "1 frame cannot be decoded: 3")
PANELS = ["a", "b", "c", "d"]


def test_vehicles_and_what_deserves_a_look():
    data = report_data("drive.mp4", FOUND, PANELS, "{}")
    first, second = data["vehicles"]
    assert (first["first"], first["last"], first["frames"]) == (1, 5, 3)
    assert first["spans"] == [[1, 2], [5, 5]] and first["score"] == "2.00"
    assert first["heights"] == "40 to 60" and second["spans"] == [[2, 2]]
    assert data["top"] == 3 and data["numbers"] == [1, 2, 4, 5] and data["errors"] is None
    why = dict(zip([w for _, w in data["notable"]], [n for n, _ in data["notable"]], strict=True))
    assert why["no. 1 is missing for 2 frames"] == 3
    assert why["no. 1 changes its size at once"] == 5
    assert why["no. 2 is seen first"] == why["no. 2 is seen last"] == 2
    assert why["1 frame cannot be decoded: 3"] == 1


def test_errors_against_the_truth():
    truth = some_rows((1, 9, 0, 0, 40, 40, 1), (2, 9, 0, 0, 40, 40, 1), (4, 9, 0, 0, 40, 40, 1))
    data = report_data("drive.mp4", FOUND, PANELS, "{}", truth)
    assert data["errors"] == [[2, 0, 1], [4, 1, 0], [5, 0, 1]]
    assert data["figures"]["misses"] == "1" and data["figures"]["false positives"] == "2"
    assert [2, "0 missed, 1 false"] in [list(pair) for pair in data["notable"]]


def test_a_video_without_vehicles():
    none = Found(some_rows(), [1], [0.0], "")
    data = report_data("empty.mp4", none, PANELS, "{}", some_rows())
    assert data["vehicles"] == data["notable"] == data["errors"] == []
    assert "empty.mp4" in page(data, "empty_split.mp4")


def test_names_end_no_script_and_no_attribute(tmp_path):
    data = report_data('</script><b>".mp4', FOUND, PANELS, "{}")
    html = page(data, 'a"b <c>.mp4')
    assert "</script><b>" not in html and 'src="a%22b%20%3Cc%3E.mp4"' in html
    inside = re.search(r'application/json">(.*?)</script>', html, re.DOTALL)[1]
    assert json.loads(inside)["title"] == '</script><b>".mp4'
    assert 'src="REPORT_DATA.mp4"' in page(data, "REPORT_DATA.mp4")
    assert 'src="%FF.mp4"' in page(data, "\udcff.mp4")
    clip = write_video(tmp_path / "clip.mp4", list(moving_frames(3)))
    assert 'src="data:video/mp4;base64,AAAA' in page(data, clip, embed=True)


@pytest.mark.parametrize("embed", [False, True])
def test_the_page_in_a_browser(tmp_path, embed):
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium here to show the page")
    options = ["--embed"] if embed else ["--report"]
    result = run(CASES / "gps_track.mp4", "--out", tmp_path, *options, "--quiet")
    assert result.returncode == 0, result.stderr
    shown = subprocess.run(
        [browser, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=4000",
         "--dump-dom", (tmp_path / "gps_track_report.html").as_uri()],
        capture_output=True, text=True, timeout=120,
    ).stdout  # fmt: skip
    numbers = {line.split(",")[1] for line in (tmp_path / "gps_track.txt").open()}
    for number in numbers:
        assert f">no. {number}</a>" in shown
    assert "frame 1 ·" in shown and "is seen first" in shown and "confirm_at" in shown
    assert (tmp_path / "gps_track_split.mp4").is_file()


def test_a_report_with_truth_and_the_write_ups_method(param, tmp_path):
    (tmp_path / "truth.txt").write_text("1,1,140,149,41,34,1\n")
    command = CASES / "gps_track.mp4", "--out", tmp_path, "--method", "G", "--param", param
    result = run(*command, "--truth", tmp_path / "truth.txt")
    assert result.returncode == 0, result.stderr
    assert '"recall"' in (tmp_path / "gps_track_report.html").read_text()
    result = run(*command, "--overwrite", "--truth", ROOT / "videos/drive.gt.txt")
    assert result.returncode == 1 and "truth of other footage" in result.stderr
