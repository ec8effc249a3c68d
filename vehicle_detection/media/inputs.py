"""What a command line names: images and videos, and where the results of each go."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from vehicle_detection.media.files import require_free
from vehicle_detection.media.formats import FORMATS, Boxes
from vehicle_detection.media.images import (
    IMAGE_SUFFIXES,
    image_format,
    is_hidden,
    natural_order,
)
from vehicle_detection.media.videos import VIDEO_SUFFIXES
from vehicle_detection.media.videos import is_video as holds_video

if TYPE_CHECKING:
    from vehicle_detection.media.mot import Rows


@dataclass(frozen=True)
class Source:
    """An input and the names of its outputs.

    Attributes
    ----------
    path : Path
    is_video : bool
        Else it is an image.
    form : str
        Of the file of boxes, one of `formats.FORMATS`.
    picture, rows : Path
        The annotated copy, and the file of boxes.
    split_screen : Path
        Of a video.
    """

    path: Path
    is_video: bool
    form: str
    picture: Path
    rows: Path
    split_screen: Path

    @property
    def report(self) -> Path:
        """The page about a video."""
        return self.split_screen.with_name(f"{self.picture.stem}_report.html")

    @property
    def outputs(self) -> list:
        """All files that may be written for it."""
        of_video = [self.split_screen, self.report] if self.is_video else []
        return [self.picture, self.rows, *of_video]

    def encoded(self, rows: Rows, frame_shape: tuple, n_frames: int) -> bytes:
        """Content of the file of boxes."""
        size = frame_shape[1], frame_shape[0]
        boxes = Boxes(self.path.name, self.is_video, size, n_frames, rows)
        return FORMATS[self.form].write(boxes)


def gather_inputs(paths: Iterable, out: str | os.PathLike, form: str = "mot") -> list:
    """Images and videos that some paths name, folders being searched at any depth.

    What a file is, its content says, not its name. Of folders, hidden files and what lies in
    the output folder are left out; so is what is neither image nor video.

    Parameters
    ----------
    paths : iterable of Path
    out : path
        Folder to write to. Folders that are searched keep their structure there, and where two
        inputs have one name, the second gets a number.
    form : str
        Of the files of boxes, one of `formats.FORMATS`.

    Returns
    -------
    sources : list of Source

    Raises
    ------
    FileNotFoundError, ValueError
        A path is missing, a folder holds neither image nor video, a file is neither.
    """
    out, sources, taken = Path(out), [], set()
    for path in map(Path, paths):
        found = list(_in_folder(path, out)) if path.is_dir() else [(path, Path(path.name))]
        if not found:
            raise FileNotFoundError(f"{path}: no images or videos in it")
        for one, name in found:
            source = _with_free_names(one, _kind(one), form, out / name, taken)
            taken.update(map(_key, source.outputs))
            sources.append(source)
    return sources


def _in_folder(folder, out):
    """Yield the path of each image and video, and its name within the folder."""
    # Results of earlier runs, if they lie within the folder.
    skipped = out.resolve()
    has_results = folder.resolve() in skipped.parents
    for path in sorted(folder.rglob("*"), key=natural_order):
        name = path.relative_to(folder)
        if not path.is_file() or is_hidden(name):
            continue
        is_result = has_results and path.resolve().is_relative_to(skipped)
        if not is_result and _is_known(path):
            yield path, name


def _is_known(path):
    """Whether a file is an image or a video, or is called like one and should be."""
    return path.suffix.lower() in IMAGE_SUFFIXES | VIDEO_SUFFIXES or _kind_by_content(path)


def _kind_by_content(path):
    """ "image", "video" or None, also for what cannot be read."""
    try:
        with open(path, "rb") as file:
            if image_format(file):
                return "image"
    except OSError:
        return None
    return "video" if holds_video(path) else None


def _kind(path):
    """As `_kind_by_content`; what is called like one, but is none, fails when it is read."""
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder")
    if not path.is_file():
        raise ValueError(f"{path}: is no regular file")
    kind = _kind_by_content(path)
    if kind is None:
        if path.suffix.lower() not in IMAGE_SUFFIXES | VIDEO_SUFFIXES:
            raise ValueError(f"{path}: neither an image nor a video that is known here")
        kind = "image" if path.suffix.lower() in IMAGE_SUFFIXES else "video"
    return kind


def _with_free_names(path, kind, form, output, taken):
    """The source with the first names that no other has."""
    suffix = output.suffix if output.suffix.lower() in IMAGE_SUFFIXES else ".png"
    is_video = kind == "video"
    of_rows = FORMATS[form].of_video if is_video else FORMATS[form].of_image
    for stem in _stems(output.stem):
        beside = output.with_name
        source = Source(
            path, is_video, form, beside(stem + (".mp4" if is_video else suffix)),
            beside(stem + of_rows), beside(f"{stem}_split.mp4"),
        )  # fmt: skip
        if not taken.intersection(map(_key, source.outputs)):
            return source
    raise AssertionError("there is always another number")


def _stems(stem) -> Iterator[str]:
    """Yield a name, then the name with numbers."""
    yield stem
    number = 2
    while True:
        yield f"{stem}_{number}"
        number += 1


def _key(path):
    """What two names share that are one file, on systems that do not tell case apart too."""
    return str(path).casefold()


def require_no_input(sources: list, others: Iterable = ()) -> None:
    """Refuse outputs that would replace an input.

    Parameters
    ----------
    sources : list of Source
    others : iterable of path or None
        Files that are read beside them.

    Raises
    ------
    FileExistsError
        Naming the file.
    """
    inputs = {source.path.resolve() for source in sources}
    inputs |= {Path(other).resolve() for other in others if other}
    for source in sources:
        for output in source.outputs:
            if output.resolve() in inputs:
                raise FileExistsError(f"{output}: is an input: use another --out")


def require_free_outputs(sources: Iterable, overwrite: bool) -> None:
    """Refuse outputs that would replace a file that was there before.

    Raises
    ------
    FileExistsError
        Naming the file.
    """
    for source in sources:
        for output in source.outputs:
            try:
                require_free(output, overwrite)
            except FileExistsError:
                raise
            except OSError:
                # A name that cannot be, such as one that is too long, fails when it is written.
                continue
