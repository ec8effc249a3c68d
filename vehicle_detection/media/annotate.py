"""Images and videos in, annotated copies and box files out."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from tqdm.auto import tqdm

from vehicle_detection.media.encoder import encoding
from vehicle_detection.media.files import written_whole
from vehicle_detection.media.images import encoded_image, read_image
from vehicle_detection.media.mot import joined, rows_of_detections
from vehicle_detection.media.videos import VideoReader

if TYPE_CHECKING:
    from vehicle_detection.media.inputs import Source
    from vehicle_detection.media.mot import Rows
    from vehicle_detection.media.viewer import Viewer


@dataclass(frozen=True)
class Found:
    """What was found in a video.

    Attributes
    ----------
    rows : Rows
    numbers : list of int
        Of the frames that were decoded.
    times : list of float
        When each is shown, in seconds.
    losses : str
        Which frames could not be decoded, in words; empty if all could.
    """

    rows: Rows
    numbers: list
    times: list
    losses: str


@contextmanager
def naming(source: str | os.PathLike) -> Iterator:
    """Put the file's name before what is wrong with a frame of it."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from error


def annotate_image(source: Source, vehicle: Viewer) -> Rows:
    """Detect in one image; write the annotated image and its boxes, both or neither.

    Parameters
    ----------
    source : Source
    vehicle : Viewer
        Is reset first.

    Returns
    -------
    rows : Rows
    """
    img = read_image(source.path)
    vehicle.reset()
    with naming(source.path):
        detections = vehicle.detect(img)
        picture = encoded_image(source.picture, vehicle.draw(img, detections))
    rows = rows_of_detections([detections])
    with written_whole(source.picture) as image, written_whole(source.rows) as text:
        image.write(picture)
        text.write(source.encoded(rows, img.shape, 1))
    return rows


def annotate_video(
    source: Source,
    vehicle: Viewer,
    split_screen: bool = False,
    preset: str = "ultrafast",
    quiet: bool = False,
) -> Found:
    """Detect in a video; write the annotated video and its boxes, all or nothing.

    Parameters
    ----------
    source : Source
    vehicle : Viewer
        Is reset first.
    split_screen : bool
        Also write `source.split_screen`, see `Viewer.draw_split_screen`.
    preset : str
        Of the encoder, see `encoder.video_writer`.
    quiet : bool
        Without a progress bar.

    Returns
    -------
    found : Found
    """
    reader = VideoReader(source.path)
    vehicle.reset()
    drawings = {source.picture: vehicle.draw}
    if split_screen:
        drawings[source.split_screen] = vehicle.draw_split_screen
    rows: list = []
    numbers, times = [], []
    with ExitStack() as stack:
        # Encoders end first, then all files get their names.
        text = stack.enter_context(written_whole(source.rows))
        files = [stack.enter_context(written_whole(path)) for path in drawings]
        writers = [
            stack.enter_context(encoding(file, path, reader.info, preset, source.path))
            for file, path in zip(files, drawings, strict=True)
        ]
        promised, name = reader.info.n_frames or None, source.path.name
        for frame in tqdm(reader, name, promised, unit="frame", disable=quiet):
            with naming(source.path):
                detections = vehicle.detect(frame.rgb)
                pictures = [draw(frame.rgb, detections) for draw in drawings.values()]
            for write, picture in zip(writers, pictures, strict=True):
                write(picture, frame.time)
            rows.append(rows_of_detections([detections], [frame.number]))
            numbers.append(frame.number)
            times.append(float(frame.time * (reader.info.time_base or 1)))
        shape = reader.info.height, reader.info.width
        text.write(source.encoded(joined(rows), shape, numbers[-1]))
    return Found(joined(rows), numbers, times, reader.losses() if reader.lost else "")
