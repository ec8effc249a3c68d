"""Images and videos in, annotated copies and box files out."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from tqdm.auto import tqdm

from vehicle_detection.media.files import written_whole
from vehicle_detection.media.images import encoded_image, read_image
from vehicle_detection.media.mot import joined, rows_of_detections
from vehicle_detection.media.videos import VideoReader, encoding

if TYPE_CHECKING:
    from vehicle_detection.media.inputs import Source
    from vehicle_detection.media.mot import Rows
    from vehicle_detection.media.viewer import Viewer


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
) -> str:
    """Detect in a video; write the annotated video and its boxes, all or nothing.

    Parameters
    ----------
    source : Source
    vehicle : Viewer
        Is reset first.
    split_screen : bool
        Also write `source.split_screen`, see `Viewer.draw_split_screen`.
    preset : str
        Of the encoder, see `videos.video_writer`.
    quiet : bool
        Without a progress bar.

    Returns
    -------
    losses : str
        Which frames could not be decoded, in words; empty if all could.
    """
    reader = VideoReader(source.path)
    vehicle.reset()
    drawings = {source.picture: vehicle.draw}
    if split_screen:
        drawings[source.split_screen] = vehicle.draw_split_screen
    found: list = []
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
            found.append(rows_of_detections([detections], [frame.number]))
        shape = reader.info.height, reader.info.width
        last = frame.number if found else 0
        text.write(source.encoded(joined(found), shape, last))
    return reader.losses() if reader.lost else ""
