"""Boxes of a clip or picture in the formats of other programs, written and read.

One source of boxes, `Boxes`, several writers; and readers for those formats in which people
keep their truth.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vehicle_detection.media.images import natural_order
from vehicle_detection.media.mot import Rows, mot_lines, read_rows

CATEGORY = "vehicle"
_MOST_BYTES = 200_000_000


@dataclass(frozen=True)
class Boxes:
    """The boxes of one input.

    Attributes
    ----------
    name : str
        Of the image or video file.
    is_video : bool
    size : (width, height)
        Of its frames, in pixels.
    n_frames : int
    rows : Rows
    """

    name: str
    is_video: bool
    size: tuple
    n_frames: int
    rows: Rows

    def picture_name(self, frame: int) -> str:
        """File name of a frame, as CVAT calls the frames of a video."""
        return f"frame_{frame - 1:06d}.jpg" if self.is_video else self.name


def as_mot(boxes: Boxes) -> bytes:
    """MOTChallenge rows, see `mot`."""
    return "".join(line + "\n" for line in mot_lines(boxes.rows)).encode()


_COLUMNS = ("frame", "id", "left", "top", "width", "height", "score")


def as_csv(boxes: Boxes) -> bytes:
    """The same with a line of column names, for spreadsheets and pandas."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*_COLUMNS, *(["metres"] if boxes.rows.distances is not None else [])])
    for record in _records(boxes.rows):
        writer.writerow(record.values())
    return text.getvalue().encode()


def as_json(boxes: Boxes) -> bytes:
    """Frames with their vehicles."""
    frames: dict = {}
    for record in _records(boxes.rows):
        frames.setdefault(record.pop("frame"), []).append(record)
    content = {
        "file": boxes.name,
        "width": boxes.size[0],
        "height": boxes.size[1],
        "frame_count": boxes.n_frames,
        "frames": [{"frame": frame, "vehicles": found} for frame, found in frames.items()],
    }
    return json.dumps(content, indent=1).encode()


def as_coco(boxes: Boxes) -> bytes:
    """COCO's object detection [1]_, with score and track of every annotation.

    References
    ----------
    .. [1] T.-Y. Lin et al., "Microsoft COCO: Common Objects in Context", ECCV 2014.
    """
    width, height = boxes.size
    images = [
        {"id": n, "file_name": boxes.picture_name(n), "width": width, "height": height}
        for n in range(1, boxes.n_frames + 1)
    ]
    annotations = [
        {
            "id": i,
            "image_id": record["frame"],
            "category_id": 1,
            "bbox": [record[name] for name in ("left", "top", "width", "height")],
            "area": record["width"] * record["height"],
            "iscrowd": 0,
            "score": record["score"],
            "track_id": record["id"],
            "attributes": {"track_id": record["id"]} | _metres(record),
        }
        for i, record in enumerate(_records(boxes.rows), start=1)
    ]
    categories = [{"id": 1, "name": CATEGORY, "supercategory": ""}]
    content = {"images": images, "annotations": annotations, "categories": categories}
    return json.dumps(content).encode()


def _metres(record):
    """The distance of a record, if it is known."""
    return {"metres": record["metres"]} if record.get("metres") is not None else {}


def as_yolo(boxes: Boxes) -> bytes:
    """YOLO's text for a picture; for a video the archive of such texts that CVAT takes [1]_.

    References
    ----------
    .. [1] https://docs.cvat.ai/docs/dataset_management/formats/format-yolo
    """
    texts = {n: "" for n in range(1, boxes.n_frames + 1)}
    for record in _records(boxes.rows):
        texts[record["frame"]] += _yolo_line(record, boxes.size)
    if not boxes.is_video:
        return texts[1].encode()
    folder, content = "obj_train_data", io.BytesIO()
    names = {n: f"{folder}/{boxes.picture_name(n)}" for n in texts}
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("obj.names", f"{CATEGORY}\n")
        archive.writestr("obj.data", "classes = 1\ntrain = train.txt\nnames = obj.names\n")
        archive.writestr("train.txt", "".join(f"{name}\n" for name in names.values()))
        for n, text in texts.items():
            archive.writestr(f"{names[n].removesuffix('.jpg')}.txt", text)
    return content.getvalue()


def _yolo_line(record, size):
    """Class, and center and size of a box as shares of the picture."""
    width, height = record["width"] / size[0], record["height"] / size[1]
    x, y = record["left"] / size[0] + width / 2, record["top"] / size[1] + height / 2
    return f"0 {x:.6f} {y:.6f} {width:.6f} {height:.6f}\n"


def _records(rows):
    """Yield each row as a dict of plain numbers by `_COLUMNS`, and metres if they are known."""
    metres = [None] * len(rows.ids) if rows.distances is None else rows.distances.tolist()
    sizes = rows.boxes[:, 2:] - rows.boxes[:, :2]
    for values in zip(rows.frames, rows.ids, rows.boxes, sizes, rows.scores, metres, strict=True):
        frame, identity, (left, top, *_), (width, height), score, distance = values
        numbers = (left, top, width, height)
        plain = [int(n) if n == int(n) else float(n) for n in numbers]
        record = dict(
            zip(_COLUMNS, (int(frame), int(identity), *plain, round(float(score), 3)), strict=True)
        )
        if rows.distances is not None:
            record["metres"] = None if distance != distance else round(distance, 1)
        yield record


@dataclass(frozen=True)
class Format:
    """How boxes are written.

    Attributes
    ----------
    write : callable
        From `Boxes` to bytes.
    of_image, of_video : str
        Suffix of the file.
    """

    write: Callable
    of_image: str
    of_video: str


FORMATS = {
    "mot": Format(as_mot, ".txt", ".txt"),
    "csv": Format(as_csv, ".csv", ".csv"),
    "json": Format(as_json, ".json", ".json"),
    "coco": Format(as_coco, ".coco.json", ".coco.json"),
    "yolo": Format(as_yolo, ".txt", ".yolo.zip"),
}


# ---------------------------------------------------------------------- readers


def read_boxes(path: str | os.PathLike, size: tuple | None = None, is_truth: bool = False) -> Rows:
    """Read boxes: MOTChallenge, COCO or this project's own (.json), YOLO (.zip), .csv.

    Parameters
    ----------
    path : path
    size : (width, height), optional
        Of the frames, in pixels: YOLO's boxes are shares of it.
    is_truth : bool
        See `mot.read_rows`. Boxes of the other formats all count, but COCO's crowds, which are
        ignore regions.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; it is of none of these formats.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        return read_rows(path, is_truth)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file of boxes")
    # What is none of these can fail in any way whatever.
    try:
        return _rows(_READERS[suffix](path, size, is_truth))
    except Exception as error:
        raise ValueError(f"{path}: no boxes that can be read: {error!r}") from error


def _rows(values):
    """Rows of (frame, id, left, top, width, height, score); with what they must be checked."""
    table = np.array(list(values), float).reshape(-1, 7)
    if not np.isfinite(table).all() or (table[:, 4:6] <= 0).any() or (table[:, 0] < 1).any():
        raise ValueError("frames before the first, boxes without area, or no finite numbers")
    boxes = np.hstack([table[:, 2:4], table[:, 2:4] + table[:, 4:6]])
    frames, ids = table[:, :2].astype(np.int64).T
    return Rows(frames, ids, boxes, table[:, 6], visibility=np.full(len(table), -1.0))


def _read_json(path, _, is_truth):
    """Yield (frame, id, left, top, width, height, score or conf) of every box."""
    content = json.loads(path.read_bytes())
    if "frames" not in content:
        yield from _read_coco(content, is_truth)
        return
    for frame in content["frames"]:
        for vehicle in frame["vehicles"]:
            yield frame["frame"], *(vehicle[name] for name in _COLUMNS[1:])


def _read_csv(path, *_):
    """As `_read_json`."""
    with open(path, newline="") as file:
        for row in csv.DictReader(file):
            yield tuple(float(row[name]) for name in _COLUMNS)


def _read_coco(content, is_truth):
    """As `_read_json`, of every annotation."""
    numbers = _frame_numbers({image["id"]: image["file_name"] for image in content["images"]})
    for annotation in content["annotations"]:
        attributes = annotation.get("attributes", {})
        identity = annotation.get("track_id", attributes.get("track_id", -1))
        required = float(not annotation.get("iscrowd", 0))
        score = required if is_truth else annotation.get("score", 1.0)
        yield numbers[annotation["image_id"]], identity, *annotation["bbox"], score


def _frame_numbers(names):
    """Number of each picture, from 1: that of its name, or its place among all names."""
    found = {key: re.search(r"frame_(\d+)\.\w+$", name) for key, name in names.items()}
    if all(found.values()):
        return {key: int(number[1]) + 1 for key, number in found.items()}
    ordered = sorted(names, key=lambda key: natural_order(Path(names[key])))
    return {key: i for i, key in enumerate(ordered, start=1)}


def _read_yolo(path, size, _):
    """Yield (frame, -1, left, top, width, height, 1) of every line of every text."""
    if size is None:
        raise ValueError("its boxes are shares of the frame: say how large that is (--size)")
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > _MOST_BYTES:
            raise ValueError("too large")
        names = [n for n in archive.namelist() if n.endswith(".txt") and "/" in n]
        numbers = _frame_numbers({name: name for name in names})
        for name in names:
            for line in archive.read(name).decode().splitlines():
                _, x, y, width, height, *_ = map(float, line.split())
                left, top = (x - width / 2) * size[0], (y - height / 2) * size[1]
                yield numbers[name], -1, left, top, width * size[0], height * size[1], 1


_READERS: dict = {".json": _read_json, ".csv": _read_csv, ".zip": _read_yolo}


def frame_size(text: str) -> tuple:
    """ "1280x720" from the command line to (1280, 720)."""
    match: Any = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not match or "0" in match.groups():
        raise ValueError(f"a size is WIDTHxHEIGHT in pixels, not {text!r}")
    return int(match[1]), int(match[2])
