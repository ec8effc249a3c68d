"""What was finished in a folder, and with which settings, so that a run can be continued."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING

from vehicle_detection.media.files import write_whole

if TYPE_CHECKING:
    from vehicle_detection.media.inputs import Source

_NAME = ".finished.json"


def digest(path: str | os.PathLike) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


class Journal:
    """Finished inputs of a folder, in its `.finished.json`.

    Parameters
    ----------
    folder : Path
    settings : dict
        All that results depend on, beside the input itself.

    Raises
    ------
    ValueError
        The file is damaged.
    """

    def __init__(self, folder: Path, settings: dict):
        self._path = folder / _NAME
        self._settings = json.dumps(settings, sort_keys=True)
        self._finished: dict = {}
        self._begun: dict = {}
        if self._path.is_file():
            try:
                self._finished = dict(json.loads(self._path.read_bytes()))
            except (TypeError, ValueError) as error:
                raise ValueError(f"{self._path}: damaged: delete it") from error

    def is_finished(self, source: Source, wanted: set) -> bool:
        """Whether an input was finished with these settings, and its results are there.

        Parameters
        ----------
        source : Source
        wanted : set of str
            Names of the results that should be there, as attributes of the source.
        """
        names = wanted if source.is_video else wanted & {"picture", "rows"}
        are_there = all(getattr(source, name).is_file() for name in names)
        return are_there and self._finished.get(str(source.picture)) == self._key(source)

    def knows(self, source: Source) -> bool:
        """Whether results of this name were made here before."""
        return str(source.picture) in self._finished

    def begin(self, source: Source) -> None:
        """Note how an input is before it is read: it may grow meanwhile."""
        self._begun[str(source.picture)] = self._key(source)

    def finish(self, source: Source) -> None:
        """An input that was begun is finished."""
        self._finished[str(source.picture)] = self._begun[str(source.picture)]
        write_whole(self._path, json.dumps(self._finished, indent=1))

    def _key(self, source):
        """Of settings and input: size and time of change stand for its content."""
        state = source.path.stat()
        text = f"{self._settings} {source.path.resolve()} {state.st_size} {state.st_mtime_ns}"
        return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()
