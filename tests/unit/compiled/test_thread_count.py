"""compiled.thread_count: the steps of a small body use the fastest number of threads."""

from __future__ import annotations

import time

import numba
import pytest

from magmpm.compiled import thread_count as threads
from magmpm.compiled.thread_count import Threads

pytestmark = pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="there is one thread only")


@pytest.mark.parametrize("slow", [1, 2])
def test_the_quicker_number_is_taken_and_the_other_tried_again(slow: int) -> None:
    """One number of threads takes far longer than the other."""
    before, taken = numba.get_num_threads(), []

    def work() -> tuple[int, bool]:
        taken.append(numba.get_num_threads())
        time.sleep(0.05 if numba.get_num_threads() == slow else 0.0)
        return 10, False

    numba.set_num_threads(2)
    try:
        chosen = Threads(500)
        for _ in range(2 * threads.AGAIN):
            assert chosen.run(work) == (10, False)
            assert numba.get_num_threads() == 2
    finally:
        numba.set_num_threads(before)
    start = taken[: 2 * threads.TRIES]
    assert start.count(1) == start.count(2) == threads.TRIES
    rest = taken[2 * threads.TRIES :]
    assert rest.count(slow) == 1, "once in AGAIN calls"
    assert taken[threads.AGAIN] == slow


def test_a_large_body_takes_all_threads() -> None:
    found = []
    Threads(threads.MANY).run(lambda: (found.append(numba.get_num_threads()) or 1, False))  # type: ignore[func-returns-value]
    assert found == [numba.get_num_threads()]


def test_the_number_is_put_back_where_steps_fail() -> None:
    before = numba.get_num_threads()
    with pytest.raises(ZeroDivisionError):
        Threads(10).run(lambda: (1 // 0, False))
    assert numba.get_num_threads() == before
