"""Loads by which the body acts on itself, in motion: they are held for some steps, since they cost more than a step.

Held at the shape where they were computed, they would lag behind the body by half the time they are held, and a load that lags does work:
it drives or damps the motion. So they are extrapolated from the last two shapes to the middle of the time for which they are held, which
leaves an error of second order, and that time is chosen by how much they change.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.model import Model

FIRST, MOST = 1, 256  # steps for which they are held: the first ones are not extrapolated
CHANGE = 0.02  # of the largest value, while they are held: the error is some thousandths of these loads


class OwnLoads:
    """Keeps the loads near to the shape of a body that moves; `steps`: for how many steps to hold the next ones."""

    def __init__(self, model: Model) -> None:
        self.model, self.steps = model, FIRST
        self._last: list[Array] = []  # tables as computed
        self._elapsed, self._taken = 0.0, 0  # s and steps since then

    def refresh(self, named: tuple[Any, ...], x: Array, F: Array, held: float) -> None:
        """Bring the tables of the effects `named` up to date with particles at x (n, 3) m, F (n, 3, 3), to be held for so many s."""
        acting.refresh(named, self.model, x, F)
        tables = acting.own_tables(named)
        now = [table.copy() for table in tables]
        if self._last and self._elapsed > 0.0:
            for table, before in zip(tables, self._last, strict=True):
                table += (table - before) * (0.5 * held / self._elapsed)
            change = max(_change(new, old) for new, old in zip(now, self._last, strict=True))
            wanted = self._taken * CHANGE / max(change, 1e-3 * CHANGE)
            self.steps = int(np.clip(wanted, max(1.0, self.steps / 4), min(2 * self.steps, MOST)))
        self._last, self._elapsed, self._taken = now, 0.0, 0

    def passed(self, steps: int, dt: float) -> None:
        """So many steps of dt (s) were taken under these loads."""
        self._elapsed, self._taken = self._elapsed + steps * dt, self._taken + steps


def _change(new: Array, old: Array) -> float:
    largest = float(np.abs(new).max(initial=0.0))
    return float(np.abs(new - old).max(initial=0.0)) / largest if largest > 0.0 else 0.0
