"""Boxes in the formats of other programs, read by those programs or by hand."""

import contextlib
import io
import json
import zipfile

import motmetrics
import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pycocotools.coco import COCO

import detect
from vehicle_detection.media.formats import FORMATS, Boxes, frame_size, read_boxes
from vehicle_detection.media.mot import Rows


def some_rows(*values):
    """Rows from (frame, id, left, top, right, bottom, score)."""
    table = np.array(values, float).reshape(-1, 7)
    frames, ids = table[:, :2].astype(np.int64).T
    return Rows(frames, ids, table[:, 2:6], table[:, 6], np.full(len(table), -1.0))


ROWS = some_rows(
    (1, 1, 10, 20, 60, 50, 1.25), (1, 2, 100, 40, 140, 70, 0.5), (3, 1, 12, 20, 62, 51, 2.0)
)
CLIP = Boxes("drive.mp4", True, (320, 180), 4, ROWS)
STILL = Boxes("a.jpg", False, (320, 180), 1, ROWS.within(range(1, 2)))


def written(tmp_path, name, boxes=CLIP):
    form = FORMATS[name]
    path = tmp_path / ("boxes" + (form.of_video if boxes.is_video else form.of_image))
    path.write_bytes(form.write(boxes))
    return path


def test_motmetrics_reads_mot(tmp_path):
    table = motmetrics.io.loadtxt(written(tmp_path, "mot"), fmt="mot15-2D")
    assert table.index.tolist() == [(1, 1), (1, 2), (3, 1)]
    # That library counts pixels from 1.
    assert table.loc[(1, 1), ["X", "Y", "Width", "Height"]].tolist() == [9, 19, 50, 30]
    assert table["Confidence"].tolist() == [1.25, 0.5, 2.0]


def test_pandas_reads_csv(tmp_path):
    table = pandas.read_csv(written(tmp_path, "csv"))
    assert list(table.columns) == ["frame", "id", "left", "top", "width", "height", "score"]
    assert table.to_numpy().tolist()[1] == [1, 2, 100, 40, 40, 30, 0.5]


def test_json_has_frames_with_vehicles(tmp_path):
    content = json.loads(written(tmp_path, "json").read_bytes())
    assert (content["file"], content["width"], content["frame_count"]) == ("drive.mp4", 320, 4)
    assert [frame["frame"] for frame in content["frames"]] == [1, 3]
    assert content["frames"][1]["vehicles"] == [
        {"id": 1, "left": 12, "top": 20, "width": 50, "height": 31, "score": 2.0}
    ]


def test_pycocotools_reads_coco(tmp_path):
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO(str(written(tmp_path, "coco")))
    assert [coco.imgs[i]["file_name"] for i in sorted(coco.imgs)][0] == "frame_000000.jpg"
    assert len(coco.imgs) == 4 and coco.loadCats(1)[0]["name"] == "vehicle"
    (annotation,) = coco.loadAnns(coco.getAnnIds(imgIds=[3]))
    assert annotation["bbox"] == [12, 20, 50, 31] and annotation["area"] == 50 * 31
    assert annotation["track_id"] == 1


def test_yolo_of_a_picture_is_text(tmp_path):
    first, second = written(tmp_path, "yolo", STILL).read_text().splitlines()
    assert first == "0 0.109375 0.194444 0.156250 0.166667"
    assert second.startswith("0 0.375000 ")


def test_yolo_of_a_video_is_the_archive_that_cvat_takes(tmp_path):
    with zipfile.ZipFile(written(tmp_path, "yolo")) as archive:
        names = archive.namelist()
        assert {"obj.names", "obj.data", "train.txt"} <= set(names)
        assert (
            archive.read("train.txt").decode().splitlines()[0] == "obj_train_data/frame_000000.jpg"
        )
        assert archive.read("obj_train_data/frame_000001.txt") == b""
        assert len(archive.read("obj_train_data/frame_000000.txt").splitlines()) == 2


@pytest.mark.parametrize("name", list(FORMATS))
def test_boxes_come_back(tmp_path, name):
    back = read_boxes(written(tmp_path, name), (320, 180))
    assert back.frames.tolist() == [1, 1, 3]
    np.testing.assert_allclose(back.boxes, ROWS.boxes, atol=1e-3)
    if name != "yolo":
        assert back.ids.tolist() == [1, 2, 1] and back.scores.tolist() == [1.25, 0.5, 2.0]


@given(
    values=st.lists(
        st.tuples(*[st.integers(1, 9)] * 2, *[st.integers(0, 150)] * 2, *[st.integers(1, 20)] * 2),
        max_size=6,
        unique_by=lambda v: v[:2],
    )
)
def test_whatever_is_written_is_read(tmp_path_factory, values):
    rows = some_rows(*[(f, i, x, y, x + w, y + h, 1) for f, i, x, y, w, h in sorted(values)])
    for name in ("mot", "coco", "yolo"):
        path = written(
            tmp_path_factory.getbasetemp(), name, Boxes("v.mp4", True, (320, 180), 9, rows)
        )
        back = read_boxes(path, (320, 180))
        assert sorted(back.frames.tolist()) == rows.frames.tolist()
        np.testing.assert_allclose(
            np.sort(back.boxes, axis=0), np.sort(rows.boxes, axis=0), atol=1e-3
        )


def test_coco_of_other_programs(tmp_path):
    """Numbers of the images are any; their names tell the order; crowds are ignored."""
    content = {
        "images": [{"id": 7, "file_name": "10.jpg"}, {"id": 3, "file_name": "9.jpg"}],
        "annotations": [
            {"image_id": 7, "bbox": [1, 2, 3, 4], "iscrowd": 1},
            {"image_id": 3, "bbox": [1.5, 2, 3, 4], "attributes": {"track_id": 5}},
        ],
    }
    path = tmp_path / "truth.json"
    path.write_text(json.dumps(content))
    rows = read_boxes(path, is_truth=True)
    assert rows.frames.tolist() == [2, 1] and rows.scores.tolist() == [0, 1]
    assert rows.ids.tolist() == [-1, 5]


@pytest.mark.parametrize(
    "content",
    [
        b"", b"[]", b"{}", b'{"images": [], "annotations": [{"image_id": 1}]}',
        b'{"images": [{"id": 1, "file_name": "a"}], "annotations": '
        b'[{"image_id": 1, "bbox": [0, 0, -1, 1]}]}',
    ],
)  # fmt: skip
def test_what_is_no_format_is_named(tmp_path, content):
    for name in ("boxes.json", "boxes.zip"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=rf"{name}: no boxes that can be read"):
            read_boxes(tmp_path / name, (320, 180))
    with pytest.raises(FileNotFoundError, match="no such file of boxes"):
        read_boxes(tmp_path / "gone.json")


def test_yolo_needs_a_size(tmp_path):
    with pytest.raises(ValueError, match="say how large"):
        read_boxes(written(tmp_path, "yolo"))
    assert frame_size("1280x720") == (1280, 720)
    for text in ("1280", "0x720", "ax b", "1280x720x3", "-1x5"):
        with pytest.raises(ValueError, match="WIDTHxHEIGHT"):
            frame_size(text)


def test_the_command_line_knows_every_format():
    assert tuple(FORMATS) == detect.FORMAT_NAMES
