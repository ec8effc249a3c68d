"""Work side by side: compiled code and OpenCV run outside the interpreter's lock."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import cv2

# OpenCV's own threads spin for a while after each of its calls, and take the
# cores from those that are here, and from the encoder.
cv2.setNumThreads(1)

_N_CORES = os.cpu_count() or 1


class _ThisThread(threading.local):
    """Whether this thread works on an item of several; every thread sees its own."""

    is_within = False


_THIS_THREAD = _ThisThread()


def work_alone() -> None:
    """From now on, calls of this thread are done where they are made."""
    _THIS_THREAD.is_within = True


# The caller works too.
_THREADS = ThreadPoolExecutor(max(1, _N_CORES - 1), initializer=work_alone)


def side_by_side(function: Callable, items: Sequence) -> list:
    """Call a function with every item, in as many threads as there are cores.

    What no thread has begun when its result is asked for is done by the
    caller itself. Calls within calls are done where they are made: waking a
    thread takes longer than most of them. A single item is no such call.

    Parameters
    ----------
    function : callable
        Takes an item.
    items : sequence

    Returns
    -------
    results : list
        In the order of the items.
    """
    if _THIS_THREAD.is_within or len(items) < 2:
        return [function(item) for item in items]
    futures = [_THREADS.submit(function, item) for item in items[1:]]
    _THIS_THREAD.is_within = True
    try:
        results = [function(items[0])]
        for future, item in zip(futures, items[1:], strict=True):
            results.append(function(item) if future.cancel() else future.result())
    finally:
        _THIS_THREAD.is_within = False
        # Where one has failed, nobody needs the others.
        for future in futures:
            future.cancel()
    return results


def share(function: Callable, length: int, n_parts: int) -> list:
    """Call function(first, last) for parts of 0..length, side by side.

    Parameters
    ----------
    function : callable
    length : int
    n_parts : int
        At most one a core is made.

    Returns
    -------
    results : list
        One a part.
    """
    n_parts = max(1, min(_N_CORES, n_parts))
    edges = [length * i // n_parts for i in range(n_parts + 1)]
    return side_by_side(lambda part: function(*part), list(pairwise(edges)))
