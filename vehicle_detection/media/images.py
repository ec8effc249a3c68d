"""Images in and out, with errors that name the file.

Colour order is settled here: what OpenCV reads as BGR leaves as RGB.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
from PIL import Image

from vehicle_detection.media.files import write_whole

# Formats as Pillow names them, with the suffixes that are usual.
IMAGE_FORMATS = {
    "PNG": (".png",),
    "JPEG": (".jpg", ".jpeg"),
    "BMP": (".bmp",),
    "WEBP": (".webp",),
    "TIFF": (".tif", ".tiff"),
}
IMAGE_SUFFIXES = {suffix for suffixes in IMAGE_FORMATS.values() for suffix in suffixes}


def natural_order(path: Path) -> list:
    """Key that sorts paths with their numbers as numbers: 2.jpg before 10.jpg."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def is_hidden(path: Path) -> bool:
    """Whether a path within a folder is hidden: left-overs, and what macOS puts beside files."""
    return any(part.startswith(".") for part in path.parts)


def find_images(folder: str | os.PathLike) -> list:
    """All images under a folder, at any depth, in the natural order of their paths.

    Hidden files are left out, and whatever has not an image's suffix.

    Raises
    ------
    FileNotFoundError
        The folder is missing, or holds no image.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder")
    found = (path for path in folder.rglob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
    seen = [path for path in found if not is_hidden(path.relative_to(folder)) and path.is_file()]
    if not seen:
        raise FileNotFoundError(f"{folder}: no images in it")
    return sorted(seen, key=natural_order)


def image_format(file: BinaryIO) -> str | None:
    """Name of an image's format by its header, None for what is no image known here."""
    try:
        with Image.open(file, formats=list(IMAGE_FORMATS)) as image:
            return image.format
    except Image.DecompressionBombError:
        # It is one all right, and too large.
        return "too large"
    except (OSError, ValueError, SyntaxError):
        return None


def read_image(path: str | os.PathLike) -> np.ndarray:
    """Read an image as RGB uint8, whatever its file holds and is called.

    Gray images get three equal channels, an alpha channel is dropped, 16 bits
    become 8.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; it is empty, truncated, far too large or no image.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such image")
    content = path.read_bytes()
    try:
        # Reads no more than the header.
        with Image.open(io.BytesIO(content), formats=list(IMAGE_FORMATS)) as image:
            kind = image.format
    except Image.DecompressionBombError as error:
        raise ValueError(f"{path}: too large: {error}") from error
    except (OSError, ValueError, SyntaxError) as error:
        raise ValueError(f"{path}: not a readable image: replace or delete it") from error
    # Several pictures in one file are JPEG as well, and Pillow calls them MPO.
    if kind in ("JPEG", "MPO") and not _is_whole_jpeg(content):
        raise ValueError(f"{path}: truncated: replace or delete it")
    try:
        img = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR_RGB)
    except cv2.error:
        img = None
    if img is None:
        raise ValueError(f"{path}: not a readable image: replace or delete it")
    return img


def read_images(paths: Iterable) -> list:
    """Read many images; those that cannot be read are all named.

    Raises
    ------
    ValueError
        With a line for each.
    """
    images, wrong = [], []
    for path in paths:
        try:
            images.append(read_image(path))
        except (OSError, ValueError) as error:
            wrong.append(str(error))
    if wrong:
        raise ValueError("\n".join(wrong))
    return images


def _is_whole_jpeg(content):
    """Whether a picture's end-of-image marker is there: decoders invent what is missing.

    Segments are skipped by their lengths, so that a thumbnail's end does not count, nor what a
    camera has written behind the picture.
    """
    place = 2
    while True:
        place = content.find(b"\xff", place)
        if place < 0 or place + 2 > len(content):
            return False
        marker = content[place + 1]
        if marker == 0xD9:
            return True
        if marker in (0x00, 0x01, 0xFF) or 0xD0 <= marker <= 0xD8:
            # Part of the data, or a marker without a length; a fill byte may be followed by one.
            place += 1 if marker == 0xFF else 2
        else:
            place += 2 + int.from_bytes(content[place + 2 : place + 4])


def encoded_image(path: Path, img: np.ndarray) -> bytes:
    """An RGB image in the format of a path's suffix.

    Raises
    ------
    ValueError
        There is no such format.
    """
    try:
        done, encoded = cv2.imencode(path.suffix, cv2.cvtColor(img, cv2.COLOR_RGB2BGR))
    except cv2.error:
        done = False
    if not done:
        raise ValueError(f"{path}: cannot be written as an image")
    return encoded.tobytes()


def write_image(path: str | os.PathLike, img: np.ndarray) -> None:
    """Write an RGB image, whole or not at all."""
    write_whole(path, encoded_image(Path(path), img))
