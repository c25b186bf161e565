"""The number of threads for the steps of a small body, the fastest as measured; and one thread for BLAS.

A step of a thousand particles takes some 30 us, and its parallel loops wait for the slowest thread. If another process uses the same
cores, two threads can be much slower than one (0.2 instead of 9 million particle-steps a second, 320 particles). Results have the same
bits with any number of threads. So the speed is measured during the steps, and measured again from time to time.
"""

import ctypes
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from itertools import product
from typing import Any, TypeVar

import numba

MANY = 20_000  # particles: from this number on, always use all threads
TRIALS_OF_EACH_COUNT = (
    3  # calls with each number at the start: the first may load or compile a kernel
)
RETRIED = 100  # calls between two trials of the other number
WITH_BLAS = ("numpy.linalg.lapack_lite", "scipy.linalg.cython_lapack")  # modules that link it

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


@cache
def _blas_counts() -> list[tuple[Any, Any]]:
    """Functions that read and set the number of threads of each BLAS that NumPy and SciPy link: OpenBLAS, MKL or BLIS.

    The system finds a name in all that a module links. Apple's Accelerate has no such functions. SciPy takes 0.1 s to import: not before.
    """
    ends = product(("", "scipy_"), ("", "64_", "_64"))  # of builds of OpenBLAS
    names = [
        (f"{a}openblas_get_num_threads{b}", f"{a}openblas_set_num_threads{b}") for a, b in ends
    ]
    names += [("MKL_Get_Max_Threads", "MKL_Set_Num_Threads")]
    names += [("bli_thread_get_num_threads", "bli_thread_set_num_threads")]
    linked = [ctypes.CDLL(import_module(module).__file__) for module in WITH_BLAS]
    return [
        (getattr(library, read), getattr(library, write))
        for library, (read, write) in product(linked, names)
        if hasattr(library, read) and hasattr(library, write)
    ]


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS on one thread: the two halves of a factorization already use the threads."""
    before = [(write, read()) for read, write in _blas_counts()]
    try:
        for write, _ in before:
            write(1)
        yield
    finally:
        for write, count in before:
            write(count)
