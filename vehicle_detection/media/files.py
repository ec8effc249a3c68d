"""Files that appear under their name only when they are whole."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SHIPPED = Path(__file__).parents[2] / "param"
TRAINED = Path("output")


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
def written_whole(path: str | os.PathLike) -> Iterator:
    """A temporary path beside `path` that takes its name if the block succeeds.

    The suffix stays, for encoders choose the format by it.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{os.getpid()}.partial.{path.name}")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def write_whole(path: str | os.PathLike, content: bytes | str) -> None:
    """Write bytes or text to a file that appears under its name only when whole."""
    with written_whole(path) as partial:
        if isinstance(content, bytes):
            partial.write_bytes(content)
        else:
            partial.write_text(content)
