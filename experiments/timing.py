"""Times of calls: medians, because machines are noisy."""

import time

import numpy as np


def once(function):
    """Milliseconds of one call."""
    start = time.perf_counter()
    function()
    return 1000 * (time.perf_counter() - start)


def milliseconds(function, repeats):
    """Median time of a call in milliseconds, after one call to warm up."""
    function()
    return float(np.median([once(function) for _ in range(repeats)]))


def alternately(functions, rounds):
    """Median milliseconds of several functions, called in turn, round after round.

    Parameters
    ----------
    functions : dict of str to callable
    rounds : int

    Returns
    -------
    times : dict of str to float
    """
    times = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            times[name].append(once(function))
    return {name: float(np.median(values)) for name, values in times.items()}
