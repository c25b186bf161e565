"""Steps of a motion with effects that change from step to step."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from magmpm.compiled.arrays import Array
from magmpm.effects.hooks import each_record
from magmpm.kernels.watch import GOING, WHY


class Kinematics(NamedTuple):
    """Kinematics of a motion at one time: x m, v m/s (n, 3) and F (n, 3, 3) of its particles, in the model's order; kinetic energy, J."""

    x: Array
    v: Array
    F: Array
    kinetic: float


Records = tuple[Any, ...]  # records and data of each effect, in turn: effects.acting.collect


class Motion(Protocol):
    """A motion that takes steps: dynamics.total_lagrangian.TotalMotion, or a test's."""

    watch: Array  # kernels.watch

    def advance(self, steps: int, dt: float, effects: Records, /) -> tuple[int, bool]:
        """Take up to `steps` steps of dt (s). Returns the number taken, and whether the motion broke."""


def from_step(named: Records, step: int) -> Records:
    """The records from a given step on. An effect that is constant in time has one record for all steps."""
    return each_record(lambda records: records[step:] if len(records) > 1 else records, named)


def at_step(named: Records, step: int) -> Records:
    """The records of one step, or the last ones if there are fewer."""
    return each_record(lambda records: records[min(step, len(records) - 1) :][:1], named)


def take(motion: Motion, named: Records, steps: int, dt: float) -> tuple[int, bool]:
    """Take up to `steps` steps of dt (s). Returns the number taken, fewer if the motion's watch ended them, and whether it broke."""
    taken = 0
    while taken < steps:
        gone, broken = motion.advance(steps - taken, dt, from_step(named, taken))
        taken += gone
        if motion.watch[WHY] != GOING:  # otherwise pairs of a body that touches itself were listed again
            return taken, broken
    return taken, False
