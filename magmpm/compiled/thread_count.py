"""The number of threads for the steps of a small body: the fastest, as measured.

A step of a thousand particles takes some 30 us, and its parallel loops wait for the slowest thread. If another process uses the same
cores, two threads can be much slower than one (0.2 instead of 9 million particle-steps a second, 320 particles). Results have the same
bits with any number of threads. So the speed is measured during the steps, and measured again from time to time.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import numba

MANY = 20_000  # particles: from this number on, always use all threads
TRIALS_OF_EACH_COUNT = (
    3  # calls with each number at the start: the first may load or compile a kernel
)
RETRIED = 100  # calls between two trials of the other number

Taken = TypeVar("Taken", bound=tuple[int, bool])


class Threads:
    """Threads of one motion. `seconds`: last measured time of a step, by number of threads."""

    def __init__(self, particles: int) -> None:
        self.few = particles < MANY
        self.calls = 0
        self.seconds: dict[int, float] = {}

    def run(self, advance: Callable[[], Taken]) -> Taken:
        """Call advance with one thread or all. advance returns the number of steps it took, and more."""
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
            starting = self.calls <= 2 * TRIALS_OF_EACH_COUNT
            self.seconds[count] = (
                min(a_step, self.seconds.get(count, a_step)) if starting else a_step
            )
        return taken

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Context for rare work outside the steps: one thread for a small body, so that no thread waits for another."""
        most = numba.get_num_threads()
        numba.set_num_threads(1 if self.few else most)
        try:
            yield
        finally:
            numba.set_num_threads(most)

    def _choice(self, most: int) -> int:
        if self.calls < 2 * TRIALS_OF_EACH_COUNT:
            return (1, most)[self.calls % 2]
        best = 1 if self.seconds.get(1, 0.0) <= self.seconds.get(most, 0.0) else most
        return best if self.calls % RETRIED else 1 + most - best
