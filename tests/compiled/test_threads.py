"""Threads within one step."""

import threading
import time

import pytest

from xcg.compiled._jit import for_each


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_results_come_in_the_order_of_the_items(threads):
    def slower_first(k):
        time.sleep(0.01 * (5 - k))
        return k * k

    assert for_each(range(6), slower_first, threads) == [0, 1, 4, 9, 16, 25]


def test_the_calling_thread_takes_part():
    both = threading.Barrier(2, timeout=10)  # is passed by two threads or not at all
    found = for_each(range(2), lambda _: both.wait() >= 0 and threading.get_ident(), 2)
    assert found[0] != found[1] == threading.get_ident()


@pytest.mark.parametrize(("threads", "bad"), [(1, 0), (2, 9)])
def test_an_error_of_the_calling_thread_stops_the_rest(threads, bad):
    done = []

    def fail(k):
        if k == bad:
            msg = f"item {k}"
            raise ValueError(msg)
        time.sleep(0.02)
        done.append(k)

    with pytest.raises(ValueError, match=f"item {bad}"):
        for_each(range(10), fail, threads)
    assert len(done) <= threads  # what the others had begun


def test_an_error_of_another_thread_is_raised():
    both = threading.Barrier(2, timeout=10)

    def fail(k):
        both.wait()
        if k == 0:
            msg = "item 0"
            raise ValueError(msg)

    with pytest.raises(ValueError, match="item 0"):
        for_each(range(2), fail, 2)
