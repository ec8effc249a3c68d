"""Times of what is written, frames and sound alike."""

from __future__ import annotations


class Timeline:
    """Times that only rise: where a source goes back, as joined recordings do, it goes on."""

    def __init__(self):
        self._last: int | None = None
        self._step, self._shift = 1, 0

    def after(self, time: int) -> int:
        """The time, or one step after the last where that is not before it."""
        if self._last is not None:
            if time + self._shift <= self._last:
                self._shift = self._last + self._step - time
            self._step = time + self._shift - self._last
        self._last = time + self._shift
        return self._last
