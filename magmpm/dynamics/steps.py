"""Steps of a motion under effects that change from step to step."""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

from magmpm.compiled.arrays import Array
from magmpm.effects.hooks import each_record
from magmpm.kernels.watch import GOING, WHY


class Look(NamedTuple):
    """A motion at a moment: x, v (n, 3) m, m/s and F (n, 3, 3) of its particles, in the model's order; kinetic energy, J."""

    x: Array
    v: Array
    F: Array
    kinetic: float


Records = tuple[Any, ...]  # records and data of each effect, in turn: effects.collect


class Motion(Protocol):
    """What takes steps: dynamics.total_lagrangian.TotalMotion, dynamics.apic.UpdatedMotion."""

    watch: Array  # kernels.watch

    def advance(self, steps: int, dt: float, effects: Records, /) -> tuple[int, bool]:
        """Take up to `steps` steps of dt (s). Returns how many were taken, and whether the motion broke."""


def from_step(named: Records, step: int) -> Records:
    """The records from one of their steps on; of what does not change in time there is one record for all."""
    return each_record(lambda records: records[step:] if len(records) > 1 else records, named)


def at_step(named: Records, step: int) -> Records:
    """The records of one step, or the last there are."""
    return each_record(lambda records: records[min(step, len(records) - 1) :][:1], named)


def take(motion: Motion, named: Records, steps: int, dt: float) -> tuple[int, bool]:
    """Take up to `steps` steps of dt (s). Returns how many were taken, fewer where the motion's watch ended them, and whether it broke."""
    taken = 0
    while taken < steps:
        gone, broken = motion.advance(steps - taken, dt, from_step(named, taken))
        taken += gone
        if motion.watch[WHY] != GOING:  # else the updated formulation only wants its particles sorted again
            return taken, broken
    return taken, False
