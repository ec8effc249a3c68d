"""Work side by side: the same results in the same order, also for calls within calls."""

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vehicle_detection.compiled.threads import share, side_by_side


@given(st.lists(st.integers(), max_size=20))
def test_results_come_in_the_order_of_the_items(items):
    assert side_by_side(lambda n: n * n, items) == [n * n for n in items]


@given(st.integers(0, 50), st.integers(-1, 100))
def test_parts_cover_everything_once(length, n_parts):
    parts = share(lambda first, last: list(range(first, last)), length, n_parts)
    assert sum(parts, []) == list(range(length))


def test_calls_within_calls_end():
    def nested(depth):
        """A tree of calls with many more leaves than there are threads."""
        return 1 if depth == 0 else sum(side_by_side(nested, [depth - 1] * 4))

    results = []
    thread = threading.Thread(target=lambda: results.append(nested(4)), daemon=True)
    thread.start()
    thread.join(timeout=60)
    assert results == [256]


def threads_within(n_items):
    """The threads that work on calls within the first of some calls."""

    def inner(_):
        """Long enough for another thread to wake up."""
        time.sleep(0.02)
        return threading.get_ident()

    def outer(n):
        """Only the first makes calls, so that the other threads have nothing to do."""
        return {threading.get_ident(), *side_by_side(inner, range(4))} if n == 0 else set()

    return side_by_side(outer, range(n_items))[0]


def test_calls_within_calls_stay_in_their_thread():
    assert len(threads_within(2)) == 1


def test_calls_within_a_single_one_are_shared():
    assert len(threads_within(1)) > 1


def test_calls_after_one_that_failed_are_shared_again():
    def fail(_):
        """Fails at once."""
        raise KeyError

    with pytest.raises(KeyError):
        side_by_side(fail, range(2))
    meeting = threading.Barrier(2)
    # Each waits for the other: one thread alone would not get past it.
    side_by_side(lambda _: meeting.wait(timeout=60), range(2))


@pytest.mark.parametrize("culprit", [0, 3])
def test_errors_reach_the_caller(culprit):
    def fail(n):
        """Fails for one of the items."""
        if n == culprit:
            raise KeyError(n)
        return n

    with pytest.raises(KeyError):
        side_by_side(fail, list(range(4)))
