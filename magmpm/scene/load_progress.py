"""Share of the load that a solve in steps has reached, for those who show it."""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple


class LoadStep(NamedTuple):
    """A step of a growing load: the share of it that has been reached, and the one that is sought."""

    reached: float
    sought: float


_step: ContextVar[LoadStep | None] = ContextVar("load_step", default=None)


def now() -> LoadStep | None:
    """The step that is being solved; None where the whole load is on at once."""
    return _step.get()


@contextmanager
def load_step(reached: float, sought: float) -> Iterator[None]:
    """A context in which a solve goes from one share of the load to another."""
    token = _step.set(None if (reached == 0.0 and sought == 1.0) else LoadStep(reached, sought))
    try:
        yield
    finally:
        _step.reset(token)
