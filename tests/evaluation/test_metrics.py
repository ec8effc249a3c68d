"""Figures of evaluate.py against counting by hand and brute force."""

import itertools
import json
import re
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import CASES, ROOT
from vehicle_detection.evaluation.hota import hota
from vehicle_detection.evaluation.metrics import (
    drop_ignored,
    errors_by_frame,
    evaluate,
    match,
    precision_recall,
)
from vehicle_detection.media.mot import (
    Rows,
    all_frames,
    frame_range,
    mot_rows,
    read_rows,
    require_sizes,
    require_within,
    rows_of,
    rows_of_detections,
)
from vehicle_detection.tracking.boxes import pairwise_iou


def rows(*values):
    """Rows from (frame, id, left, top, right, bottom, score)."""
    values = np.array(values, float).reshape(-1, 7)
    frames, ids = values[:, :2].astype(int).T
    return Rows(frames, ids, values[:, 2:6], values[:, 6], visibility=np.full(len(values), -1.0))


TRUTH = rows(
    (1, 1, 0, 0, 40, 40, 1), (2, 1, 0, 0, 40, 40, 1), (3, 1, 0, 0, 40, 40, 1),
    (1, 2, 100, 0, 150, 50, 1), (2, 2, 100, 0, 150, 50, 1), (3, 2, 100, 0, 150, 50, 1),
    (1, 101, 300, 0, 400, 100, 0), (2, 101, 300, 0, 400, 100, 0), (3, 101, 300, 0, 400, 100, 0),
)  # fmt: skip


def test_counts_by_hand():
    detections = rows(
        # Vehicle 1: exact, exact, missed. Vehicle 2: half of it, exact, exact.
        (1, 7, 0, 0, 40, 40, 0.9), (2, 7, 0, 0, 40, 40, 0.9),
        (1, 8, 100, 0, 150, 30, 0.8), (2, 8, 100, 0, 150, 50, 0.8), (3, 9, 100, 0, 150, 50, 0.8),
        # In the ignore region by more than half; by less; nowhere near.
        (1, 20, 290, 0, 330, 40, 0.5), (2, 21, 270, 0, 310, 40, 0.5), (3, 22, 600, 0, 640, 40, 0.5),
    )  # fmt: skip
    misses, false_positives = errors_by_frame(TRUTH, detections, range(1, 4))
    assert misses.tolist() == [0, 0, 1] and false_positives.tolist() == [0, 1, 1]
    figures = evaluate(TRUTH, detections)
    assert figures["recall"] == pytest.approx(5 / 6)
    assert figures["precision"] == pytest.approx(5 / 7)
    assert figures["false positives"] == 2 and figures["misses"] == 1
    assert figures["false positives per frame"] == pytest.approx(2 / 3)
    assert figures["mean IoU"] == pytest.approx((1 + 1 + 0.6 + 1 + 1) / 5)
    assert figures["identity switches"] == 1
    assert figures["MOTA"] == pytest.approx(1 - (1 + 2 + 1) / 6)
    assert figures["recall by height"]["40-60 px"] == pytest.approx(5 / 6)
    assert figures["frames to first box"] == {"1 from 1": 0, "2 from 1": 0}


def test_without_identities_there_are_no_switches():
    detections = rows((1, -1, 0, 0, 40, 40, 1), (2, -1, 0, 0, 40, 40, 1), (2, -1, 9, 90, 20, 99, 1))
    figures = evaluate(TRUTH, detections)
    assert figures["IDF1"] is None and figures["identity switches"] is None
    assert figures["MOTA"] == pytest.approx(1 - (4 + 1) / 6)
    assert figures["frames to first box"] == {"1 from 1": 0, "2 from 1": None}


def test_required_vehicle_in_an_ignore_region_still_counts():
    truth = rows((1, 1, 0, 0, 50, 50, 1), (1, 101, 0, 0, 200, 200, 0))
    detections = rows((1, -1, 0, 0, 50, 50, 1), (1, -1, 100, 100, 150, 150, 1))
    assert len(drop_ignored(truth, detections).frames) == 1
    assert evaluate(truth, detections)["precision"] == 1


def test_false_alarms_count_where_the_truth_is_silent():
    figures = evaluate(TRUTH, rows((9, -1, 500, 0, 540, 40, 1)))
    assert figures["frames"] == 9 and figures["false positives"] == 1


def test_nothing_found():
    figures = evaluate(TRUTH, rows())
    assert figures["recall"] == 0 and figures["mean IoU"] is None and figures["IDF1"] is None
    assert figures["frames to first box"] == {"1 from 1": None, "2 from 1": None}


def test_truth_without_identities():
    # Two vehicles without a number in frame 1, one of them found; one in frame 3, found.
    truth = rows((1, -1, 0, 0, 40, 40, 1), (1, -1, 80, 0, 40, 40, 1), (3, -1, 0, 0, 40, 40, 1))
    found = rows((1, 5, 0, 0, 40, 40, 1), (3, 5, 0, 0, 40, 40, 1))
    figures = evaluate(truth, found)
    assert (figures["recall"], figures["misses"]) == (pytest.approx(2 / 3), 1)
    assert figures["MOTA"] == pytest.approx(2 / 3)
    assert figures["IDF1"] is None and figures["identity switches"] is None
    assert figures["frames to first box"] == {}


def test_ignore_regions_need_no_identity():
    truth = rows((1, 4, 0, 0, 40, 40, 1), (1, -1, 80, 0, 120, 40, 0), (2, 4, 0, 0, 40, 40, 1))
    found = rows((1, 7, 0, 0, 40, 40, 1), (2, 8, 0, 0, 40, 40, 1))
    figures = evaluate(truth, found)
    assert figures["identity switches"] == 1
    assert figures["frames to first box"] == {"4 from 1": 0}


@pytest.mark.parametrize(
    ("text", "numbers"), [("2:4", [2, 3, 4]), ("11:61:25", [11, 36, 61]), ("3:3", [3])]
)
def test_ranges_of_frames(text, numbers):
    assert list(frame_range(text)) == numbers


@pytest.mark.parametrize(
    "text", ["", "3", "a:b", "1:2:3:4", "1:2:x", "1:2:0", "0:5", "5:3", "5:3:-1"]
)
def test_what_is_no_range_of_frames(text):
    with pytest.raises(ValueError, match="frames are A:B"):
        frame_range(text)


def test_frames_between_steps_do_not_count():
    truth = rows((1, 1, 0, 0, 40, 40, 1), (3, 1, 0, 0, 40, 40, 1))
    found = rows((1, 1, 0, 0, 40, 40, 1), (2, 1, 90, 0, 40, 40, 1), (3, 1, 90, 0, 40, 40, 1))
    figures = evaluate(truth, found, frame_range("1:3:2"))
    assert (figures["frames"], figures["misses"], figures["false positives"]) == (2, 1, 1)


def test_frames_are_chosen():
    figures = evaluate(TRUTH, rows_of([[], [(0, 0, 40, 40)], []]), range(2, 3))
    assert figures["frames"] == 1 and figures["recall"] == 0.5 and figures["precision"] == 1


boxes = st.lists(
    st.tuples(*[st.integers(0, 30)] * 2, *[st.integers(1, 30)] * 2), min_size=0, max_size=4
).map(lambda b: np.array([(x, y, x + w, y + h) for x, y, w, h in b], float).reshape(-1, 4))


@settings(max_examples=80)
@given(required=boxes, detected=boxes, threshold=st.floats(0.1, 0.9))
def test_match_finds_as_many_pairs_as_there_can_be(required, detected, threshold):
    iou = pairwise_iou(required, detected)
    for i, a in enumerate(required.astype(int)):
        for k, b in enumerate(detected.astype(int)):
            first, second = np.zeros((2, 70, 70), bool)
            first[a[1] : a[3], a[0] : a[2]] = second[b[1] : b[3], b[0] : b[2]] = True
            assert iou[i, k] == pytest.approx((first & second).sum() / (first | second).sum())
    found, partners = match(required, detected, threshold)
    assert (iou[found, partners] >= threshold).all()
    assert len(set(found)) == len(found) and len(set(partners)) == len(partners)
    few, many = sorted((len(required), len(detected)))
    table = iou if len(required) == few else iou.T
    best = max(
        sum(table[i, k] >= threshold for i, k in enumerate(order))
        for order in itertools.permutations(range(many), few)
    )
    assert len(found) == best


def test_precision_recall_follows_the_score():
    detections = rows(
        (1, -1, 0, 0, 40, 40, 0.9), (2, -1, 0, 0, 40, 40, 0.8), (3, -1, 500, 0, 540, 40, 0.1)
    )
    thresholds, precision, recall = precision_recall(TRUTH, detections)
    assert (np.diff(thresholds) >= 0).all() and (np.diff(recall) <= 0).all()
    assert precision[0] == pytest.approx(2 / 3) and recall[0] == pytest.approx(2 / 6)
    assert precision[thresholds > 0.2][0] == 1


def test_command_line(tmp_path):
    truth, detections = tmp_path / "truth.txt", tmp_path / "boxes.txt"
    truth.write_text("1,1,0,0,40,40,1,3,1\n2,1,0,0,40,40,1,3,1\n")
    detections.write_text("1,-1,0,0,40,40,5.000,-1,-1,-1\n")
    command = [sys.executable, "-m", "vehicle_detection.evaluation", truth, detections]
    result = subprocess.run(
        [*command, "--json", "--picture", tmp_path / "p.png"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert json.loads(result.stdout)["recall"] == 0.5
    assert (tmp_path / "p.png").stat().st_size > 1000
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "mean IoU                    1.000" in result.stdout


def test_class_and_visibility_may_be_left_out(tmp_path):
    (tmp_path / "boxes.txt").write_text(
        "3,7,10,20,30,40,1\n3,8,10,20,30,40,0,3\n4,7,10,20,30,40,0,3,0.25\n4,-1,0,0,5,5,2.5,-1,-1,-1\n"
    )
    rows = read_rows(tmp_path / "boxes.txt")
    np.testing.assert_array_equal(rows.boxes[0], (10, 20, 40, 60))
    assert rows.scores.tolist() == [1, 0, 0, 2.5]
    assert rows.visibility.tolist() == [-1, -1, 0.25, -1]
    assert rows.only(rows.ids == 7).visibility.tolist() == [-1, 0.25]


GOOD = "1,1,10,20,30,40,1\n"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1,1,0,0", "4 fields"),
        ("1,1,10,5,20,5,30,5,40,5,1", "11 fields"),
        ("1;2;10;20;30;40;1", "1 fields"),
        ("# a comment", "1 fields"),
        ("a,b,c,d,e,f,g", "'a' is no number"),
        ("1,2,nan,0,4,4,1", "'nan' is no number"),
        ("0x1,2,0,0,4,4,1", "'0x1' is no number"),
        ("1_0,2,0,0,4,4,1", "'1_0' is no number"),
        ("0,2,0,0,4,4,1", "frame 0: frames count from 1"),
        ("1.5,2,0,0,4,4,1", "frame 1.5"),
        ("1000000000,2,0,0,4,4,1", "frame 1000000000"),
        ("1,1e30,0,0,4,4,1", "id 1e30"),
        ("1,1,0,0,4,4,1", "id 1 twice in frame 1"),
        ("1,2,10,20,-30,-40,1", "a box of -30 x -40"),
        ("1,2,10,20,0,0,1", "a box of 0 x 0"),
        ("1,2,-1e300,0,2e300,4,1", "a box of 2e300"),
        ("1,2,0,0,4,4,0.5", "conf 0.5"),
        ("1,2,0,0,4,4,-1", "conf -1"),
    ],
)
def test_a_bad_line_is_named(tmp_path, line, message):
    (tmp_path / "boxes.txt").write_text(GOOD + line + "\n")
    with pytest.raises(ValueError, match=rf"boxes\.txt, line 2: .*{re.escape(message)}"):
        read_rows(tmp_path / "boxes.txt", is_truth=True)


def test_a_detection_may_have_any_score(tmp_path):
    (tmp_path / "boxes.txt").write_text("1,1,0,0,4,4,0.5\n1,-1,0,0,4,4,-2\n1,-1,0,0,4,4,3\n")
    assert read_rows(tmp_path / "boxes.txt").scores.tolist() == [0.5, -2, 3]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "ascii"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_editors_leave_their_marks(tmp_path, encoding, end):
    text = (GOOD + " 2, 1, 10, 20, 30, 40, 0 \n\n").replace("\n", end)
    (tmp_path / "boxes.txt").write_bytes(text.encode(encoding))
    assert read_rows(tmp_path / "boxes.txt", is_truth=True).frames.tolist() == [1, 2]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "latin-1"])
def test_what_is_no_plain_text_is_said(tmp_path, encoding):
    (tmp_path / "boxes.txt").write_bytes((GOOD + "\u00e4").encode(encoding))
    with pytest.raises(ValueError, match=r"boxes\.txt, line \d"):
        read_rows(tmp_path / "boxes.txt")
    with pytest.raises(FileNotFoundError, match="no such file of boxes"):
        read_rows(tmp_path / "gone.txt")


@given(content=st.binary(max_size=60) | st.text("0123456789,.-e\n ", max_size=60).map(str.encode))
def test_no_content_breaks_the_reader(tmp_path_factory, content):
    path = tmp_path_factory.getbasetemp() / "fuzzed.txt"
    path.write_bytes(content)
    try:
        rows = read_rows(path, is_truth=True)
    except ValueError as error:
        assert "fuzzed.txt, line " in str(error)
    else:
        assert (rows.frames >= 1).all() and np.isfinite(rows.boxes).all()


def test_corners_in_place_of_sizes_are_noticed(tmp_path):
    rows = read_rows(CASES / "corners.gt.txt", is_truth=True)
    with pytest.raises(ValueError, match="left,top,right,bottom instead of"):
        require_sizes(rows, "corners.gt.txt")
    truth = read_rows(ROOT / "videos/drive.gt.txt", is_truth=True)
    require_sizes(truth, "drive.gt.txt")
    require_within(truth, (720, 1280, 3), "drive.gt.txt")
    with pytest.raises(ValueError, match="640x360: is this the truth of other footage"):
        require_within(truth, (360, 640, 3), "drive.gt.txt")


def test_frames_without_rows_take_no_time():
    rows = rows_of([[(0, 0, 9, 9)]])
    late = replace(rows, frames=np.array([5_000_000]))
    figures = evaluate(late, late)
    assert figures["recall"] == 1 and figures["frames"] == 5_000_000
    misses, false_positives = errors_by_frame(late, rows, range(1, 5_000_001))
    assert misses.sum() == 1 and misses[-1] == 1 and false_positives[0] == 1


def test_json_is_valid_without_truth(tmp_path):
    (tmp_path / "none.txt").write_text("\n")
    (tmp_path / "found.txt").write_text("1,1,0,0,4,4,0.5\n")
    command = [sys.executable, "-m", "vehicle_detection.evaluation", tmp_path / "none.txt"]
    for detections in ("found.txt", "none.txt"):
        result = subprocess.run(
            [*command, tmp_path / detections, "--json"], cwd=ROOT, capture_output=True, check=True
        )

        def refuse(name):
            raise AssertionError(name)

        figures = json.loads(result.stdout, parse_constant=refuse)
        assert figures["MOTA"] is None and figures["recall"] is None


def test_rows_go_to_a_file_and_come_back(tmp_path):
    """What a detector returns, as a file and as rows, is the same."""
    frames = [
        SimpleNamespace(
            boxes=np.array([(1, 2, 30, 40), (50, 60, 90, 99)]),
            ids=np.array([3, 1]),
            scores=np.array([0.5, 1.25]),
        ),
        SimpleNamespace(boxes=np.empty((0, 4), int), ids=np.empty(0, int), scores=np.empty(0)),
        SimpleNamespace(boxes=np.array([(5, 5, 9, 9)]), ids=np.array([3]), scores=np.array([2.0])),
    ]
    lines = [line for n, one in enumerate(frames, start=1) for line in mot_rows(n, one)]
    assert lines[0] == "1,3,1,2,29,38,0.500,-1,-1,-1"
    (tmp_path / "boxes.txt").write_text("\n".join(lines))
    read, made = read_rows(tmp_path / "boxes.txt"), rows_of_detections(frames)
    assert made.frames.tolist() == [1, 1, 3] and made.boxes.dtype == float
    for name in ("frames", "ids", "boxes", "scores", "visibility"):
        np.testing.assert_array_equal(getattr(read, name), getattr(made, name))
    assert all_frames(read, made) == range(1, 4) and all_frames(rows(), rows()) == range(1, 2)
    assert all_frames(rows(), made) == all_frames(made, rows()) == range(1, 4)


def test_the_threshold_on_iou_is_used_everywhere():
    truth = rows((1, 1, 0, 0, 40, 40, 1), (1, 9, 0, 0, 50, 50, 0))
    # Seven tenths of the vehicle, and wholly in an ignore region.
    found = rows((1, 4, 0, 0, 40, 28, 0.9))
    for threshold, recall in ((0.6, 1), (0.8, 0)):
        figures = evaluate(truth, found, iou_threshold=threshold)
        assert (figures["recall"], figures["false positives"]) == (recall, 0)
        misses, alarms = errors_by_frame(truth, found, range(1, 2), threshold)
        assert (misses.tolist(), alarms.tolist()) == ([1 - recall], [0])
        precision, recalls = precision_recall(truth, found, threshold, steps=3)[1:]
        assert precision.tolist() == recalls.tolist() == [recall] * 3


def test_other_frames_excuse_nothing():
    truth = rows((1, 9, 0, 0, 50, 50, 0), (2, 1, 100, 0, 140, 40, 1))
    found = rows((1, 4, 100, 0, 140, 40, 0.9), (2, 4, 0, 0, 40, 40, 0.9), (2, 5, 10, 0, 60, 40, 1))
    assert len(drop_ignored(truth, found).frames) == 3
    # By half is enough, by less is not.
    truth = rows((1, 9, 0, 0, 50, 50, 0))
    found = rows((1, 4, 30, 0, 70, 40, 1), (1, 5, 31, 0, 71, 40, 1))
    assert drop_ignored(truth, found).ids.tolist() == [5]


def test_identities_count_from_nought():
    truth = rows((1, 0, 0, 0, 40, 40, 1), (2, 0, 0, 0, 40, 40, 1))
    found = rows((1, 0, 0, 0, 40, 40, 1), (2, 0, 0, 0, 40, 40, 1))
    figures = evaluate(truth, found)
    assert figures["IDF1"] == 1 and figures["required boxes"] == 2
    assert figures["frames to first box"] == {"0 from 1": 0}
    assert type(figures["misses"]) is int and type(figures["recall"]) is float
    none = evaluate(truth, rows_of([[], []]))
    assert set(figures) == set(none) and none["MOTA"] == 0
    assert evaluate(rows((1, -1, 0, 0, 9, 9, 1)), rows())["MOTA"] == 0
    unknown = rows((1, -5, 0, 0, 4, 4, 1), (1, -5, 8, 8, 9, 9, 1)).with_unique_ids().ids
    assert len(set(unknown.tolist())) == 2 and (unknown < 0).all()


def test_recall_by_height_and_late_entries():
    numbers = [*range(1, 11), *range(36, 40), *range(65, 69)]
    truth = rows(*[(n, 1, 0, 0, 40, 29 if n < 11 else 30, 1) for n in numbers])
    found = rows(*[(n, 1, 0, 0, 40, 30, 1) for n in numbers if 3 < n < 11 or n > 66])
    figures = evaluate(truth, found)
    # Twenty-five frames away are the same visit, twenty-six are another.
    assert figures["frames to first box"] == {"1 from 1": 3, "1 from 36": None, "1 from 65": 2}
    recalls = figures["recall by height"]
    assert recalls["30-40 px"] == pytest.approx(2 / 8) and recalls["100 px and more"] is None


def test_a_curve_of_nothing_is_empty():
    thresholds, precision, recall = precision_recall(TRUTH, rows())
    assert thresholds.shape == precision.shape == recall.shape == (0,)
    assert len(precision_recall(TRUTH, rows((1, -1, 0, 0, 9, 9, 1)))[0]) == 40


def test_chosen_rows():
    own = rows(*[(n, n, 0, 0, 9, 9, 1) for n in range(1, 12)])
    assert own.within(range(3, 10, 3)).frames.tolist() == [3, 6, 9]
    assert own.within(range(20, 30)).frames.tolist() == []
    assert rows_of([[(1, 2, 3, 4)], []]).ids.tolist() == [-1]


def test_the_last_frame_and_the_largest_id(tmp_path):
    path = tmp_path / "boxes.txt"
    path.write_text(f"10000000,{2**40},0,0,4,4,1\n")
    assert read_rows(path).ids.tolist() == [2**40]
    path.write_text("10000001,1,0,0,4,4,1")
    with pytest.raises(ValueError, match="line 1: frame 10000001"):
        read_rows(path)


def test_hota_by_hand():
    """One vehicle in four frames, found in three of them under two numbers, and a false alarm.

    At every threshold there are 3 matches, 1 miss, 1 false alarm: detection 3 / 5. The match of
    number 7 in two frames has association 2 / 4, that of number 8 in one frame 1 / 4.
    """
    truth = rows(*[(n, 1, 0, 0, 40, 40, 1) for n in range(1, 5)])
    found = rows(
        (1, 7, 0, 0, 40, 40, 1), (2, 7, 0, 0, 40, 40, 1), (3, 8, 0, 0, 40, 40, 1),
        (4, 9, 300, 0, 340, 40, 1),
    )  # fmt: skip
    association = (2 * 2 / 4 + 1 / 4) / 3
    assert hota(truth, found) == pytest.approx(np.sqrt(3 / 5 * association))
    assert hota(truth, truth) == 1 and hota(truth, rows()) == 0 and hota(rows(), found) is None
    assert evaluate(truth, found)["HOTA"] == pytest.approx(hota(truth, found))
    # A box of an IoU of 0.6 is found at twelve of the nineteen thresholds.
    lower = rows(*[(n, 7, 0, 0, 40, 24, 1) for n in range(1, 5)])
    assert hota(truth, lower) == pytest.approx(12 / 19)


def test_hota_matches_what_belongs_together():
    """Two boxes that overlap one vehicle: the one that follows it longest is taken."""
    truth = rows(*[(n, 1, 0, 0, 100, 100, 1) for n in range(1, 11)])
    faithful = [(n, 3, 0, 0, 100, 90, 1) for n in range(1, 11)]
    found = rows(*faithful, (5, 4, 0, 0, 100, 100, 1))
    # Nine tenths are enough for eighteen thresholds: ten matches and a false alarm.
    expected = 18 * np.sqrt(10 / 11)
    assert hota(truth, found) * 19 == pytest.approx(expected, abs=0.35)
