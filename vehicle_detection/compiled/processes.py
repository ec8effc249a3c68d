"""Work in several processes, none of which outlives the program."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence

from joblib import Parallel, delayed, parallel_config
from joblib.externals.loky.process_executor import TerminatedWorkerError
from threadpoolctl import threadpool_limits
from tqdm.auto import tqdm

from vehicle_detection.command_line import Terminated
from vehicle_detection.compiled.threads import work_alone

_SECONDS_BETWEEN_LOOKS = 0.5
_SECONDS_TO_TIDY = 1.5
_ATTEMPTS = 5
_TIDYING = "ignore:resource_tracker"


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
    _stop_quietly()
    with parallel_config("loky", n_jobs=jobs, initializer=begin_worker):
        parallel = Parallel(return_as="generator")
    yield from tqdm(parallel(delayed(function)(item) for item in items), title, len(items))


@contextlib.contextmanager
def workers(scheduler: str | None, jobs: int, large: Sequence = ()) -> Iterator:
    """Run joblib's work on this machine's cores, or on the workers of a Dask scheduler.

    Parameters
    ----------
    scheduler : str or None
        Address of a `dask scheduler`, tcp://host:port.
    jobs : int
        Processes on this machine; -1 for one a core.
    large : sequence
        What is sent to the workers once instead of with every task.

    Raises
    ------
    ValueError
        Dask is not installed, or there is no such scheduler.
    """
    if scheduler is None:
        _stop_quietly()
        with parallel_config("loky", n_jobs=jobs, initializer=begin_worker):
            yield
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise ValueError("--scheduler needs: pip install -r requirements-dask.txt") from error

    with Client(scheduler), parallel_config(backend="dask", scatter=list(large)):
        yield


def each_at_once(function: Callable, items: list) -> Iterator:
    """Yield function(item) as they are done, within `workers`.

    What a process was at when it was killed is begun again, by another.

    Parameters
    ----------
    function : callable
        Returns a tuple that begins with its item.
    items : list

    Raises
    ------
    RuntimeError
        Processes are killed again and again.
    """
    missing = list(items)
    for _ in range(_ATTEMPTS):
        parallel = Parallel(return_as="generator_unordered", pre_dispatch="all", batch_size=1)
        try:
            for result in parallel(delayed(function)(item) for item in missing):
                missing.remove(result[0])
                yield result
            return
        except TerminatedWorkerError:
            continue
    raise RuntimeError(f"workers were killed {_ATTEMPTS} times: {len(missing)} left")


def _stop_quietly():
    """Joblib's process that tidies up behind a stopped program need not say that it does."""
    others = os.environ.get("PYTHONWARNINGS", "")
    if _TIDYING not in others:
        os.environ["PYTHONWARNINGS"] = ",".join(filter(None, [others, _TIDYING]))


def begin_worker() -> None:
    """What every worker process does first.

    It leaves interrupts to the program, uses one core, and ends when the program does, however
    that was.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    threadpool_limits(1)
    work_alone()
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()


def _stop(*_):
    raise Terminated


def _end_with(parent):
    """End this process when its parent is no longer there, after what it does has tidied up."""
    while os.getppid() == parent:
        time.sleep(_SECONDS_BETWEEN_LOOKS)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_SECONDS_TO_TIDY)
    os._exit(1)
