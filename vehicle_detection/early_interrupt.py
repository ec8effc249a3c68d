"""An interrupt while a script's libraries load ends in one line.

Scripts import this first, and only if they are run: it replaces the program's last handler.
"""

from __future__ import annotations

import sys
from types import TracebackType

from vehicle_detection.command_line import INTERRUPTED, end_now


def end_quietly(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    """Handle what nobody has handled: interrupts in one line, all else as Python does."""
    if issubclass(kind, KeyboardInterrupt):
        end_now("interrupted", INTERRUPTED)
    sys.__excepthook__(kind, error, traceback)


sys.excepthook = end_quietly
