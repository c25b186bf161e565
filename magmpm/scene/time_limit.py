"""Time limit of solvers. When the time is over they end by themselves, with what they have.

with limited(600.0):
    run(scene, folder="runs/long")
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple

from magmpm.errors import InputError, TimeOver


class _Limit(NamedTuple):
    seconds: float
    until: float  # s of the clock
    clock: Callable[[], float]


_limits: ContextVar[tuple[_Limit, ...]] = ContextVar("limits", default=())


@contextmanager
def limited(
    seconds: float | None, clock: Callable[[], float] = time.perf_counter
) -> Iterator[None]:
    """A context in which solvers raise TimeOver, a SolveError, once so many seconds are over; None: they may take what they take.

    They look at the clock before each factorization, and after each chunk of a motion's steps; not while kernels are compiled, a field is
    put on a table or a rod is solved. The state is the last good Result, as of other failures; what runs along time has written its
    frames up to then, and goes on from the last of them with resume=True. clock: what counts the seconds, such as time.process_time.
    Raises InputError where seconds is not above zero.
    """
    if seconds is None:
        yield
        return
    if not seconds > 0.0:
        raise InputError(
            "time limit",
            received=f"{seconds:g} s",
            rule="must be above zero",
            remedy="give seconds, or none",
        )
    before = _limits.set((*_limits.get(), _Limit(seconds, clock() + seconds, clock)))
    try:
        yield
    finally:
        _limits.reset(before)


def check() -> None:
    """Called by solvers at each step. Raises TimeOver."""
    for limit in _limits.get():
        if limit.clock() > limit.until:
            raise TimeOver(f"time limit of {limit.seconds:g} s reached; allow more")
