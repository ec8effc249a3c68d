"""Work in several processes, none of which outlives the program."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator

from joblib import Parallel, delayed, parallel_config
from threadpoolctl import threadpool_limits
from tqdm.auto import tqdm

from vehicle_detection.compiled.threads import work_alone

_SECONDS_BETWEEN_LOOKS = 0.5


def in_parallel(function: Callable, items: list, jobs: int, title: str) -> Iterator:
    """Yield function(item) of all items in order, from several processes, with a progress bar.

    Parameters
    ----------
    function : callable
        Takes an item; picklable.
    items : list
    jobs : int
        Processes; -1 for one a core.
    title : str
        Of the progress bar.
    """
    with parallel_config("loky", n_jobs=jobs, initializer=begin_worker):
        parallel = Parallel(return_as="generator")
    yield from tqdm(parallel(delayed(function)(item) for item in items), title, len(items))


def begin_worker() -> None:
    """What every worker process does first.

    It leaves interrupts to the program, uses one core, and ends when the program does, however
    that was.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threadpool_limits(1)
    work_alone()
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _end_with(parent):
    """End this process when its parent is no longer there."""
    while os.getppid() == parent:
        time.sleep(_SECONDS_BETWEEN_LOOKS)
    os._exit(1)
