"""Files that appear under their name only when they are whole."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import BinaryIO

try:
    import fcntl
except ImportError:  # Windows, where an open file cannot be deleted anyway.
    fcntl = None

SHIPPED = Path(__file__).parents[2] / "param"
TRAINED = Path("output")
_PARTIAL = ".vehicles-{}.partial"


def trained_or_shipped(name: str) -> Path:
    """A parameter file of this name: the one trained here, or else the shipped one.

    Parameters
    ----------
    name : str
        Such as "svc_pickle.p".

    Returns
    -------
    path : Path
        In `output/` of the working directory, or in `param/` beside the program.
    """
    trained = TRAINED / name
    return trained if trained.is_file() else SHIPPED / name


@contextmanager
def written_whole(path: str | os.PathLike) -> Iterator[BinaryIO]:
    """A new binary file that takes its name if the block succeeds.

    Until then it lies beside `path` under a random, hidden name, and is locked: what a process
    that was killed has left there is deleted by the next one.

    Yields
    ------
    file : binary file
        To be read, written and searched in.

    Raises
    ------
    OSError
        The folder cannot be written to, or what bears the name is no regular file.
    """
    path = Path(path)
    if path.exists() and not path.is_file():
        raise OSError(f"{path}: is no regular file, and is not replaced")
    path.parent.mkdir(parents=True, exist_ok=True)
    _sweep_once(path.parent.resolve())
    partial, file = _new_file(path.parent)
    try:
        with file:
            yield file
            file.flush()
            if fcntl:
                # While it is locked, so that nobody sweeps it away.
                partial.replace(path)
        if not fcntl:
            partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _new_file(folder):
    """A file with a name of its own, locked; nothing that lies there is followed or opened."""
    while True:
        partial = folder / _PARTIAL.format(secrets.token_hex(8))
        file = open(partial, "x+b")  # noqa: SIM115, the caller closes it
        if not fcntl:
            return partial, file
        fcntl.flock(file, fcntl.LOCK_EX)
        # Another process may have swept it away before it was locked.
        if partial.exists():
            return partial, file
        file.close()


@cache
def _sweep_once(folder):
    """As `sweep`, at the first file that is written into a folder."""
    sweep(folder)


def sweep(folder: Path) -> None:
    """Delete the partial files that processes which are gone have left in a folder."""
    for partial in folder.glob(_PARTIAL.format("*")):
        with suppress(OSError):
            if fcntl:
                with open(partial, "rb") as file:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    partial.unlink()
            else:
                partial.unlink()


def write_whole(path: str | os.PathLike, content: bytes | str) -> None:
    """Write bytes, or text as UTF-8, to a file that appears under its name only when whole."""
    with written_whole(path) as file:
        file.write(content if isinstance(content, bytes) else content.encode())


def require_free(path: str | os.PathLike, overwrite: bool) -> Path:
    """The path of a file to write, if there is none yet or it may be replaced.

    Raises
    ------
    FileExistsError
        There is one, and `overwrite` is false.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} is there already: allow to overwrite it, or write elsewhere")
    return path
