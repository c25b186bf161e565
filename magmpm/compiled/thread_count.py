"""How many threads a small body's steps take: as many as are soonest done.

A step of a thousand particles takes some 30 us, and its parallel loops wait for the slowest thread: where something else wants the same
cores, two threads have been ten times slower than one (0.2 against 9 million particle-steps a second, 320 particles). Results have
the same bits at any number, so it is measured as the steps go on, and measured again now and then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numba

MANY = 20_000  # particles: from there on all threads are worth it
TRIES = 3  # calls with each number at the start, since the first may load or compile a kernel
AGAIN = 100  # calls from one trial of the other number to the next

Taken = TypeVar("Taken", bound=tuple[int, bool])


class Threads:
    """For one motion. `seconds`: of a step, by number of threads, when last measured."""

    def __init__(self, particles: int) -> None:
        self.few = particles < MANY
        self.calls = 0
        self.seconds: dict[int, float] = {}

    def run(self, advance: Callable[[], Taken]) -> Taken:
        """Call advance, which returns how many steps it took and more, with one thread or all."""
        most = numba.get_num_threads()
        if most == 1 or not self.few:
            return advance()
        count = self._choice(most)
        begun = time.perf_counter()
        numba.set_num_threads(count)
        try:
            taken = advance()
        finally:
            numba.set_num_threads(most)
        self.calls += 1
        if taken[0]:
            a_step = (time.perf_counter() - begun) / taken[0]
            starting = self.calls <= 2 * TRIES
            self.seconds[count] = min(a_step, self.seconds.get(count, a_step)) if starting else a_step
        return taken

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Around what is done once in a while, not at every step: one thread for a small body, so that none waits for another."""
        most = numba.get_num_threads()
        numba.set_num_threads(1 if self.few else most)
        try:
            yield
        finally:
            numba.set_num_threads(most)

    def _choice(self, most: int) -> int:
        if self.calls < 2 * TRIES:
            return (1, most)[self.calls % 2]
        best = 1 if self.seconds.get(1, 0.0) <= self.seconds.get(most, 0.0) else most
        return best if self.calls % AGAIN else 1 + most - best
