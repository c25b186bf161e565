"""Loads by which a body acts on itself, in motion: computed at every step, or held for some steps where that adds no energy.

Computed at every step, for the shape at its start, such a load is a part of leapfrog like any other: over any number of steps its energy
neither grows nor falls. Where the body has many blocks that costs more than a step, so the load is held. Held at the shape where it was
computed it would lag behind the body and do work: so it is extrapolated from the last two shapes to the middle of the steps for which it is
held. But a body that vibrates changes its load within the time for which it is held, and the work that is wrong feeds the vibration.

The energy E that belongs to these loads is known, and so is their work. With y the shape half a step before a load is computed, from which
on it acts, a load that is held adds (its work from y to the next y) + (the change of E from y to the next y). `added` is the sum since the
motion began; it may be at most ADDED of the largest kinetic energy, or of the largest change of E. A load is held for as long as the next
one will add at most a part PART of what is left, and change by at most MOST_CHANGE_OF_HELD_LOAD; what it adds grows as the cube of the
steps. Where nothing is left, the load is computed at every step.
Sources: Tuckerman, Berne, Martyna, J. Chem. Phys. 97 (1992) 1990, loads with steps of their own; Skeel, Biesiadecki, Ann. Numer. Math. 1
(1994) 191, and Ma, Izaguirre, Skeel, SIAM J. Sci. Comput. 24 (2003) 1951: held for half a period of a vibration or longer they feed it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers, Plain
from magmpm.effects import acting
from magmpm.effects.base import Records
from magmpm.model import Model

MOST_STEPS_HELD = 256  # steps for which a load may be held
SINGLE = (
    8  # loads of one step each before one is held for two: what they cost to try is then a tenth
)
MOST_CHANGE_OF_HELD_LOAD = (
    0.02  # of the largest value of a load: how much it may change while it is held
)
ADDED = 1e-3  # of the largest energy: what held loads may add in all
# a load: how fast it is forgotten what loads added; where a body turns round they add nothing, but
# the next ones do
RELEASE = 0.97
PART = 1 / 8  # of what is left of that: what the next one may add


class OwnLoads:
    """Keeps the loads near to the shape of a body that moves.

    steps: for how many steps to hold the next load; added J: what held loads have added; scale J: the largest energy so far.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.added = 0.0
        self.scale = 0.0
        self._start: float | None = None  # E at the first look, J
        self._rate = (
            0.0  # J: what the next load adds, over the cube of the steps for which it is held
        )
        self.begin()

    def begin(self) -> None:
        """Begin with loads of one step each, as at every frame: so a motion that is resumed there has the same loads."""
        self.steps = 1
        self._single = 0
        self._held: _Held | None = None
        self._before: tuple[list[Array], int] | None = (
            None  # tables as computed, and the steps since
        )

    def state(self) -> NamedNumbers:
        """Numbers that `restore` needs, at a frame."""
        return {"own_added": self.added, "own_scale": self.scale, "own_rate": self._rate} | (
            {} if self._start is None else {"own_start": self._start}
        )

    def restore(self, state: Plain) -> None:
        """Go back to a `state`."""
        self.added = state.get("own_added", 0.0)
        self.scale = state.get("own_scale", 0.0)
        self._rate = state.get("own_rate", 0.0)
        self._start = state.get("own_start")
        self.begin()

    def kept(self) -> Plain:
        """All that `rewind` needs within the same process; nothing in it is changed later."""
        return dict(vars(self))

    def rewind(self, kept: Plain) -> None:
        """Go back to what `kept` returned."""
        vars(self).update(kept)

    def compute(self, named: Records, motion: Any) -> float:
        """Bring the tables of the effects `named` up to date with a TotalMotion. Returns their energy, J."""
        return acting.refresh(named, self.model, *motion.shape(motion.u))

    def renew(self, named: Records, motion: Any) -> int:
        """Load the tables for the next steps. Returns for how many of them these are to be held."""
        energy = self.compute(named, motion)
        tables = acting.own_tables(named)
        if self.steps == 1 and self._single < SINGLE:
            self._single += 1
            self._before = [table.copy() for table in tables], 0
            self._held = None
            return 1
        early = acting.coordinates(
            named, self.model, *motion.shape(motion.u - motion.lag * motion.v)
        )
        now = acting.coordinates(named, self.model, *motion.shape(motion.u))
        exact = (
            energy - _dot(tables, early) + _dot(tables, now)
        )  # E half a step before, to first order: all that E and work differ by
        self._look(energy, motion)
        if self._held is not None:
            self._judge(exact, early, tables)
        else:
            self._try()
        true = [table.copy() for table in tables]
        if self._before is not None:
            for table, before in zip(tables, self._before[0], strict=True):
                table += (table - before) * (0.5 * (self.steps - 1) / max(self._before[1], 1))
        self._before = true, 0
        self._held = _Held([table.copy() for table in tables], early, exact)
        return self.steps

    def passed(self, steps: int) -> None:
        """Note that so many steps were taken under these loads."""
        if self._before is not None:
            self._before = self._before[0], self._before[1] + steps

    def _look(self, energy: float, motion: Any) -> None:
        """Note the largest energies."""
        self._start = energy if self._start is None else self._start
        kinetic = 0.5 * float(
            motion.packed.mass.lumped @ (motion.v.reshape(-1, 3) ** 2).sum(axis=1)
        )
        self.scale = max(self.scale, kinetic, abs(energy - self._start))

    def _left(self) -> float:
        """Energy that the next load may add, J."""
        return PART * (ADDED * self.scale - abs(self.added))

    def _try(self) -> None:
        """Hold the next load for two steps, where that adds no more than it may by what the loads before it added."""
        self.steps = 2 if 2**3 * self._rate <= self._left() else 1
        self._rate *= RELEASE
        self._single = 0

    def _judge(self, exact: float, early: list[Array], tables: list[Array]) -> None:
        """Count what the load that was held has added, and choose for how long to hold the next."""
        held = self._held
        assert held is not None
        assert self._before is not None
        tables_before, taken = self._before
        if taken == 0:
            return
        moved = [new - old for new, old in zip(early, held.early, strict=True)]
        added = _dot(held.tables, moved) + exact - held.exact
        self.added += added
        left = self._left()
        change = max(_change(new, old) for new, old in zip(tables, tables_before, strict=True))
        self._rate = max(abs(added) / taken**3, RELEASE * self._rate)
        by_energy = 0.0 if left <= 0.0 else (left / max(self._rate, 1e-60)) ** (1 / 3)
        by_change = taken * MOST_CHANGE_OF_HELD_LOAD / max(change, 1e-30)
        self.steps = int(np.clip(min(by_energy, by_change), 1, min(2 * taken, MOST_STEPS_HELD)))
        self._single = 0


class _Held:
    """A load that is held: its tables, and the coordinates and the energy E (J) of the body half a step before it was computed."""

    def __init__(self, tables: list[Array], early: list[Array], exact: float) -> None:
        self.tables = tables
        self.early = early
        self.exact = exact


def _dot(tables: list[Array], coordinates: list[Array]) -> float:
    """Work (J) of loads along these coordinates."""
    return sum(
        float(table[: len(along)] @ along) for table, along in zip(tables, coordinates, strict=True)
    )


def _change(new: Array, old: Array) -> float:
    largest = float(np.abs(new).max(initial=0.0))
    return float(np.abs(new - old).max(initial=0.0)) / largest if largest > 0.0 else 0.0
