"""How every script ends: an exit code, one line for a mistake, nothing left behind.

| code | meaning |
|---|---|
| 0 | all done |
| 1 | nothing done, or not all: the lines say what is wrong with which input |
| 2 | the command line is wrong |
| 3 | all done, but of some video not every frame could be decoded |
| 130, 143 | stopped by Ctrl-C, by SIGTERM |
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable
from importlib.metadata import version as package_version
from pathlib import Path
from typing import NoReturn

from vehicle_detection import __version__

FAILED, LOSSES, INTERRUPTED, TERMINATED = 1, 3, 130, 143


class Terminated(BaseException):
    """SIGTERM has come. Like KeyboardInterrupt, no error that anybody handles."""


def run(main: Callable[[], int | None]) -> NoReturn:
    """Call a script's main function and end the program with its exit code.

    Parameters
    ----------
    main : callable
        Returns an exit code, None for 0. An OSError or ValueError of it is a mistake of the
        user's and becomes a line; any other error is one of the program's and is shown whole.
    """
    _use_any_console()
    signal.signal(signal.SIGINT, _on_interrupt)
    signal.signal(signal.SIGTERM, _on_terminate)
    try:
        code = main() or 0
        sys.stdout.flush()
    except KeyboardInterrupt:
        end_now("interrupted", INTERRUPTED)
    except Terminated:
        end_now("terminated", TERMINATED)
    except BrokenPipeError:
        # Whoever reads has heard enough.
        end_now("", FAILED)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        code = FAILED
    sys.exit(code)


def _use_any_console():
    """Closed streams swallow what is printed; a character that a console lacks is escaped."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, open to the end
        elif hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def _on_interrupt(*_):
    # One is enough: a second must not stop what the first has begun to tidy up.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


def _on_terminate(*_):
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise Terminated


def end_now(message: str, code: int) -> NoReturn:
    """End at once: threads that still decode or encode are of no use any more."""
    try:
        if message:
            print(f"\n{message}", file=sys.stderr, flush=True)
    finally:
        os._exit(code)


def add_version(parser: argparse.ArgumentParser) -> None:
    """The option `--version`: of the project and of what its results depend on most."""
    parser.add_argument("--version", action=_Version, nargs=0, help="print versions and end")


class _Version(argparse.Action):
    """Prints versions when it is met; looking them up takes time."""

    def __call__(self, parser, *_):
        names = ("numpy", "opencv-python-headless", "scikit-learn", "numba", "av")
        packages = ", ".join(f"{name} {package_version(name)}" for name in names)
        print(f"vehicle detection {__version__} ({packages})")
        parser.exit()


def nonempty_path(text: str) -> Path:
    """A path from the command line; an empty one is a mistake, not the working directory."""
    if not text:
        raise argparse.ArgumentTypeError("a path is empty")
    return Path(text)
