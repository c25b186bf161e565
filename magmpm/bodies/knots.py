"""Grid cells of a straight body: equal ones along it, in runs between the places where its stiffness jumps.

Where two materials meet, the strain jumps. Splines follow it if a cell face lies there and the knot is repeated: then the displacement
stays continuous and its slope may jump. Errors of jointed bodies fall with the square of the cell size in this way, and only with the cell
size without it (docs/accuracy.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magmpm.bodies.grid import Grid, Run
from magmpm.compiled.arrays import Array

SHORT = 0.5  # cells: in motion, a joint nearer to the next one, or to an end, gets no knot: thin cells would need short steps
THIN = 0.02  # cells: the same at rest, and the least width of the cell that takes what is left
FEWEST = 3  # cells along a body


@dataclass(frozen=True)
class Knots:
    """Layout of the cells in a straight body. joints: the segments at whose far end the stiffness jumps; from_tip: cells of the requested
    size are counted from the tip, or from the next joint, and the one nearest to the base takes the remainder; like: the grid of nearly the
    same body, for as many cells everywhere; at_rest: in an equilibrium joints may be near each other, and the cells of a tube lie around
    its axis (bodies.polar_grid)."""

    joints: tuple[int, ...] = ()
    from_tip: bool = False
    like: Grid | None = None
    at_rest: bool = False


EVEN = Knots()


def runs_along(ends: Array, h: float, across: int, knots: Knots) -> tuple[int, float, tuple[Run, ...]]:
    """Cells of about h m along a body whose segments end at `ends` (k,) m, `across` of which make its thickness: their number, the least
    width (m), and their runs (none if all are equal)."""
    like, length = knots.like, float(ends[-1])
    if like is None:
        joints = _kept(ends, (THIN if knots.from_tip or knots.at_rest else SHORT) * h, knots.joints)
    else:
        joints = [run.after for run in like.runs if run.after is not None]
    from_tip = knots.from_tip and (length >= (FEWEST - 0.5) * h if like is None else bool(like.runs))
    if not joints and not from_tip:
        along = max(FEWEST, round(length / h)) if like is None else like.cells[0]
        return along, length / along, ()
    faces = [0.0, *ends[joints].tolist(), length]
    widths = np.diff(faces)
    counts = [_count(width / h, across, from_tip) for width in widths] if like is None else _counts(like.runs)
    runs: list[Run] = []
    for start, width, count, after in zip(faces, widths.tolist(), counts, [None, *joints], strict=False):
        rest = width - (count - 1) * h
        if from_tip and count > 1:
            runs += [Run(start, rest, 1, after), Run(start + rest, h, count - 1)]
        else:
            runs.append(Run(start, width / count, count, after))
    return sum(counts), min(run.width for run in runs), tuple(runs)


def _count(width: float, across: int, from_tip: bool) -> int:
    """Cells in a run that is `width` cells wide, where `across` make the body's thickness: none is wider than requested by more than THIN.
    From the tip, the first one takes THIN to 1 + THIN: a new cell begins with almost no width, and changes the answer by as little. Else
    twice as many cells across are twice as many in each run: nested grids tell each other's error, and do not agree by chance."""
    if across > 2 and across % 2 == 0 and not from_tip:
        return 2 * _count(width / 2, across // 2, from_tip)
    return max(1, math.ceil(width - THIN))


def _kept(ends: Array, least: float, joints: tuple[int, ...]) -> list[int]:
    """The joints that get a knot, chosen from the tip on."""
    kept, last = [], float(ends[-1])
    for joint in reversed(joints):
        if min(last - ends[joint], ends[joint]) >= least:
            kept.append(joint)
            last = ends[joint]
    return kept[::-1]


def _counts(runs: tuple[Run, ...]) -> list[int]:
    """Cells between repeated knots."""
    counts = [0]
    for run in runs:
        if run.after is not None:
            counts.append(0)
        counts[-1] += run.cells
    return counts
