"""Images and videos in, annotated copies and box files out."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm.auto import tqdm

from vehicle_detection.media.files import write_whole
from vehicle_detection.media.images import IMAGE_SUFFIXES, find_images, read_image, write_image
from vehicle_detection.media.mot import mot_rows
from vehicle_detection.media.videos import (
    VIDEO_SUFFIXES,
    read_frames,
    video_info,
    video_writer,
)

if TYPE_CHECKING:
    from vehicle_detection.media.viewer import Viewer


def write_rows(path: str | os.PathLike, rows: list) -> None:
    """Write rows of text to a file, whole or not at all."""
    write_whole(path, "".join(row + "\n" for row in rows))


@contextmanager
def naming(source: str | os.PathLike) -> Iterator:
    """Put the file's name before what is wrong with a frame of it."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error


def annotate_image(source: Path, folder: Path, vehicle: Viewer) -> list:
    """Detect in one image; write the annotated image and its boxes into a folder.

    Parameters
    ----------
    source, folder : Path
    vehicle : Viewer
        Is reset first.

    Returns
    -------
    rows : list of str
        See `mot.mot_rows`.
    """
    img = read_image(source)
    vehicle.reset()
    with naming(source):
        detections = vehicle.detect(img)
        picture = vehicle.draw(img, detections)
    write_image(folder / source.name, picture)
    rows = mot_rows(1, detections)
    write_rows(folder / f"{source.stem}.txt", rows)
    return rows


def annotate_video(
    source: Path,
    folder: Path,
    vehicle: Viewer,
    split_screen: bool = False,
    preset: str = "ultrafast",
) -> list:
    """Detect in a video; write the annotated video and its boxes into a folder.

    Parameters
    ----------
    source, folder : Path
    vehicle : Viewer
        Is reset first.
    split_screen : bool
        Also write STEM_split.mp4, see `Viewer.draw_split_screen`.
    preset : str
        Of the encoder, see `videos.video_writer`.

    Returns
    -------
    rows : list of str
        See `mot.mot_rows`.
    """
    info = video_info(source)
    vehicle.reset()
    drawings = {folder / f"{source.stem}.mp4": vehicle.draw}
    if split_screen:
        drawings[folder / f"{source.stem}_split.mp4"] = vehicle.draw_split_screen
    rows = []
    with ExitStack() as stack:
        writers = [stack.enter_context(video_writer(path, info, preset)) for path in drawings]
        frames = tqdm(read_frames(source), source.name, info.n_frames, unit="frame")
        for frame_number, frame in enumerate(frames, start=1):
            with naming(source):
                detections = vehicle.detect(frame)
                pictures = [draw(frame, detections) for draw in drawings.values()]
            for write, picture in zip(writers, pictures, strict=True):
                write(picture)
            rows += mot_rows(frame_number, detections)
    write_rows(folder / f"{source.stem}.txt", rows)
    return rows


def gather_inputs(paths: Any) -> tuple:
    """Split paths into images and videos; folders are opened for their images.

    Returns
    -------
    images, videos : list of Path

    Raises
    ------
    FileNotFoundError, ValueError
        A path is missing, is a folder without images, or is neither image nor video by its
        suffix.
    """
    images, videos = [], []
    for path in paths:
        if path.is_dir():
            images += find_images(path)
        elif path.suffix.lower() in IMAGE_SUFFIXES:
            images.append(path)
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            videos.append(path)
        elif path.exists():
            raise ValueError(f"{path}: neither an image nor a video that is known here")
        else:
            raise FileNotFoundError(f"{path}: no such file or folder")
    return images, videos


def require_free_names(images: np.ndarray, videos: list, folder: str | os.PathLike) -> None:
    """Refuse inputs whose outputs would overwrite an input or each other.

    Raises
    ------
    ValueError
        Naming the input.
    """
    taken = {path.resolve() for path in images + videos}
    for path in images + videos:
        names = [path.name, f"{path.stem}.txt"]
        if path in videos:
            names = [f"{path.stem}.mp4", f"{path.stem}_split.mp4", f"{path.stem}.txt"]
        for name in names:
            output = (folder / name).resolve()
            if output in taken:
                raise ValueError(f"{path}: its output {folder / name} is taken: use another --out")
            taken.add(output)
