"""Fetch the course's images, videos and chessboards into data/.

python -m vehicle_detection.media.download                      from where they are published
python -m vehicle_detection.media.download --from path/to/files  from archives already there
"""

from __future__ import annotations

if __name__ == "__main__":
    import vehicle_detection.early_interrupt  # noqa: F401, before the libraries

import argparse
import shutil
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import pooch
import requests

from vehicle_detection import command_line
from vehicle_detection.command_line import nonempty_path
from vehicle_detection.media.files import written_whole
from vehicle_detection.media.images import read_image
from vehicle_detection.media.videos import video_info

_BUCKET = "https://s3.amazonaws.com/udacity-sdc/Vehicle_Tracking"
_COURSE = "https://github.com/udacity/CarND-Vehicle-Detection/raw/master"
_LANES = "https://github.com/udacity/CarND-Advanced-Lane-Lines/raw/master"
# Images of each archive.
ARCHIVES = {"vehicles.zip": 8792, "non-vehicles.zip": 8968}
VIDEOS = ("test_video.mp4", "project_video.mp4")
PICTURES = (
    *(f"test_images/test{i}.jpg" for i in range(1, 7)),
    *(f"camera_cal/calibration{i}.jpg" for i in range(1, 21)),
)
_RETRIES, _TIMEOUT = 4, 30
LICENCES = """\
Licences: the vehicle images are from the GTI vehicle image database (Universidad Politecnica de
Madrid, for research) and from KITTI (CC BY-NC-SA 3.0), packed by Udacity; the other files are from
Udacity's CarND repositories (MIT licence). See docs/data.md before you pass any of them on."""


@dataclass(frozen=True)
class Origin:
    """Where files come from.

    Attributes
    ----------
    mirror : str or None
        Address under which all files lie; None for where each is published.
    folder : Path or None
        Where they lie on this machine; nothing is downloaded then.
    """

    mirror: str | None = None
    folder: Path | None = None

    def address(self, name: str) -> str:
        """Of a file."""
        if self.mirror:
            return f"{self.mirror.rstrip('/')}/{name}"
        if name in ARCHIVES:
            return f"{_BUCKET}/{name}"
        return f"{_LANES if name.startswith('camera_cal') else _COURSE}/{name}"


def fetch(origin: Origin, name: str, folder: Path) -> Path:
    """The path of a file, copied or downloaded unless it is there; it is whole.

    Raises
    ------
    OSError
        It is missing, or does not come after several attempts.
    """
    path = folder / name
    if path.is_file():
        return path
    path.parent.mkdir(parents=True, exist_ok=True)
    if origin.folder:
        with open(origin.folder / name, "rb") as source, written_whole(path) as target:
            shutil.copyfileobj(source, target)
        return path
    address = origin.address(name)
    store = pooch.create(
        folder, base_url="", registry={name: None}, urls={name: address},
        retry_if_failed=_RETRIES,
    )  # fmt: skip
    load = pooch.HTTPDownloader(progressbar=sys.stderr.isatty(), timeout=_TIMEOUT)
    try:
        store.fetch(name, downloader=load)
    except (requests.RequestException, ValueError) as error:
        raise OSError(f"{address}: cannot be downloaded: {error}") from error
    return path


def check(path: Path, is_ours: bool) -> None:
    """Read a file as what it should be.

    Parameters
    ----------
    path : Path
    is_ours : bool
        This run has fetched it, and deletes it if it is something else.

    Raises
    ------
    ValueError
        It is something else.
    """
    try:
        if path.suffix == ".zip":
            with zipfile.ZipFile(path) as archive:
                broken = archive.testzip()
            if broken:
                raise ValueError(f"{path}: {broken} is damaged")
        elif path.suffix == ".mp4":
            video_info(path)
        else:
            read_image(path)
    except (ValueError, EOFError, RuntimeError, zlib.error, zipfile.BadZipFile) as error:
        if is_ours:
            path.unlink()
        what = "run this again" if is_ours else "delete it"
        raise ValueError(f"{path}: not what it should be: {error}: {what}") from error


def unpack(path: Path, folder: Path, n_images: int) -> None:
    """The images of an archive into folder/NAME, all or none.

    Only png files below NAME are taken; what macOS adds is not.

    Raises
    ------
    ValueError
        There are more or fewer images than there should be.
    """
    name = path.stem
    if (folder / name).is_dir():
        return
    with tempfile.TemporaryDirectory(dir=folder, prefix=".unpacked-") as temporary:
        with zipfile.ZipFile(path) as archive:
            members = list(_images(archive.namelist(), name))
            if len(members) != n_images:
                raise ValueError(f"{path}: {len(members)} images instead of {n_images}")
            for member in members:
                archive.extract(member, temporary)
        (Path(temporary) / name).rename(folder / name)


def _images(names: Iterable, folder: str) -> Iterable:
    """Yield the names of the images of a folder within an archive."""
    for name in names:
        parts = PurePosixPath(name).parts
        inside = parts[:1] == (folder,) and ".." not in parts and "\\" not in name
        if inside and name.lower().endswith(".png") and not parts[-1].startswith("._"):
            yield name


def gather(origin: Origin, folder: Path) -> None:
    """All files into a folder; what is there already is left alone."""
    if origin.folder and origin.folder.resolve() == folder.resolve():
        raise ValueError(f"{folder}: archives lie here already: use another --out")
    folder.mkdir(parents=True, exist_ok=True)
    for name in (*PICTURES, *VIDEOS):
        was_there = (folder / name).exists()
        check(fetch(origin, name, folder), is_ours=not was_there)
        print(f"{folder / name}")
    for name, n_images in ARCHIVES.items():
        if not (folder / Path(name).stem).is_dir():
            was_there = (folder / name).exists()
            path = fetch(origin, name, folder)
            check(path, is_ours=not was_there)
            try:
                unpack(path, folder, n_images)
            finally:
                if not was_there:
                    path.unlink()
        print(f"{folder / Path(name).stem}: {n_images} images")


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m vehicle_detection.media.download",
        description="Fetch the course's images, videos and chessboards. What is there already "
        "is kept, so that an interrupted run can be continued.",
        epilog="examples: download --from ~/Downloads; download --mirror http://host/udacity",
    )
    parser.add_argument(
        "--out", type=nonempty_path, default=Path("data"), help="default: %(default)s"
    )
    parser.add_argument(
        "--from", type=nonempty_path, dest="folder", metavar="DIR", help="archives already there"
    )
    parser.add_argument("--mirror", metavar="URL", help="address under which all files lie")
    arguments = parser.parse_args()
    gather(Origin(arguments.mirror, arguments.folder), arguments.out)
    print(LICENCES)


if __name__ == "__main__":
    command_line.run(main)
