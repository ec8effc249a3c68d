"""Images in and out, with errors that name the file.

Colour order is settled here: what OpenCV reads as BGR leaves as RGB.
"""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from vehicle_detection.media.files import write_whole

IMAGE_SUFFIXES = {".png", ".jpg", ".jpeg"}


def find_images(folder: str | os.PathLike) -> list:
    """All images under a folder, at any depth, in the order of their paths.

    Raises
    ------
    FileNotFoundError
        The folder is missing, or holds no image.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder")
    paths = sorted(p for p in folder.rglob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
    if not paths:
        raise FileNotFoundError(f"{folder}: no png or jpg images in it")
    return paths


def read_image(path: str | os.PathLike) -> np.ndarray:
    """Read an image as RGB uint8, whatever its file holds.

    Gray images get three equal channels, an alpha channel is dropped, 16 bits
    become 8.

    Raises
    ------
    FileNotFoundError, ValueError
        The file is missing; it is empty, truncated or no image.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such image")
    content = np.frombuffer(path.read_bytes(), np.uint8)
    if path.suffix.lower() in {".jpg", ".jpeg"} and not _ends_as_jpeg(content):
        raise ValueError(f"{path}: truncated: replace or delete it")
    img = cv2.imdecode(content, cv2.IMREAD_COLOR_RGB) if content.size else None
    if img is None:
        raise ValueError(f"{path}: not a readable image: replace or delete it")
    return img


def _ends_as_jpeg(content):
    """Whether the end-of-image marker is there: decoders invent what is missing.

    It is looked for behind the last start of scan, for a thumbnail has an end
    of its own, and a camera may write more behind the picture's.
    """
    whole = content.tobytes()
    return b"\xff\xd9" in whole[whole.rfind(b"\xff\xda") :]


def write_image(path: str | os.PathLike, img: np.ndarray) -> None:
    """Write an RGB image, whole or not at all."""
    path = Path(path)
    done, encoded = cv2.imencode(path.suffix, cv2.cvtColor(img, cv2.COLOR_RGB2BGR))
    if not done:
        raise ValueError(f"{path}: cannot be written as an image")
    write_whole(path, encoded.tobytes())
