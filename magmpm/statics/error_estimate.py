"""How far a solution is from the exact one, told from the same scene on several grids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array

ORDER = 1.5  # of convergence at the rim of a clamp: docs/design.md
SAFETY = 1.5


@dataclass(frozen=True)
class Rung:
    """One grid's answer: cells across, cell size (m), the points (k, 3) m that the error is meant at."""

    cells: int
    size: float
    points: Array


def distance(one: Array, other: Array) -> float:
    """Largest distance (m) between points (k, 3) m and their partners."""
    return float(np.linalg.norm(one - other, axis=1).max())


def error_of_finest(rungs: Sequence[Rung]) -> float:
    """Bound (m) of the error of the last of at least two rungs, coarse to fine."""
    coarse, fine = rungs[-2:]
    ratio = (coarse.size / fine.size) ** ORDER
    return SAFETY * distance(coarse.points, fine.points) / (ratio - 1.0)


def error_at(rungs: Sequence[Rung], cells: int) -> float:
    """The same, foretold for another number of cells."""
    last = rungs[-1]
    return error_of_finest(rungs) * (last.cells / cells) ** ORDER
