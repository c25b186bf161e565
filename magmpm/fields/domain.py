"""The box in which a body may need the field: what it can reach, without the space of magnets and wires."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.fields.magnets import Solid
from magmpm.fields.schedule import places, sample_times
from magmpm.fields.sources import FieldSource

KEPT_OFF = 0.25  # of the gap between the undeformed body and a magnet: distance from the magnet at which the box ends


@dataclass(frozen=True)
class Box:
    """A box in the sources' frame, corners (3,) m. cut: names of the sources for which it was cut."""

    lower: Array
    upper: Array
    cut: tuple[str, ...] = ()

    def holds(self, points: Array) -> NDArray[np.bool_]:
        """Which points (n, 3) are in it."""
        return np.all((points >= self.lower) & (points <= self.upper), axis=1)

    def meets(self, lower: Array, upper: Array) -> bool:
        """True if another box has a point in common with this one."""
        return bool(np.all(lower <= self.upper) and np.all(upper >= self.lower))

    @property
    def volume(self) -> float:
        return float(np.prod(self.upper - self.lower))

    def text(self) -> str:
        """For messages: "-40 to 44, -44 to 44, -44 to 44 mm"."""
        return ", ".join(f"{1e3 * a:.3g} to {1e3 * b:.3g}" for a, b in zip(self.lower, self.upper)) + " mm"


def reach(body: Box, anchored: bool) -> Box:
    """Box that a body can reach from its undeformed box: a held body, its diagonal from the middle of its lower x face.

    A free body may go anywhere; its box gets one diagonal on each side, and users may set a larger one.
    """
    diagonal = float(np.linalg.norm(body.upper - body.lower))
    if anchored:
        base = (body.lower + body.upper) / 2
        base[0] = body.lower[0]
        return Box(base - 1.05 * diagonal, base + 1.05 * diagonal)
    return Box(body.lower - diagonal, body.upper + diagonal)


def seen_from_sources(field: FieldSource, box: Box) -> Box:
    """The box around a box of space in the frame of the sources, over all of the schedule."""
    corners = np.array([[(box.lower, box.upper)[b][i] for i, b in enumerate(c)] for c in np.ndindex(2, 2, 2)])
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for place in places(field, sample_times(field)):
        local = (corners - place["origin"]) @ place["frame"].reshape(3, 3)
        lower, upper = np.minimum(lower, local.min(axis=0)), np.maximum(upper, local.max(axis=0))
    return Box(lower, upper)


def cut_for(box: Box, body: Box, obstacles: list[Solid], *, keeps_off: float | None = None) -> Box | None:
    """The box, cut by planes so that it contains the body but no obstacle; None where no plane separates the two.

    keeps_off: it is cut for obstacles just outside of it as well, of which it then keeps as far off, and at least so many m off where a
    plane can be. Nothing cut: the box itself.
    """
    for solid in obstacles:
        low, high = solid.box()
        if keeps_off is None and not box.meets(low, high):
            continue
        found: list[tuple[float, Box]] = []
        for k in range(3):
            for sign in (1, -1):
                gap = (low[k] - body.upper[k]) if sign > 0 else (body.lower[k] - high[k])
                if gap <= 0:
                    continue
                lower, upper = box.lower.copy(), box.upper.copy()
                if sign > 0:
                    upper[k] = min(upper[k], low[k] - KEPT_OFF * gap)
                else:
                    lower[k] = max(lower[k], high[k] + KEPT_OFF * gap)
                found.append((KEPT_OFF * gap, Box(lower, upper, box.cut)))
        if not found:
            return None
        least = min(keeps_off or 0.0, max(kept for kept, _ in found))
        largest = max((one for kept, one in found if kept >= least), key=lambda one: one.volume)
        if largest.volume == box.volume:
            continue  # it keeps off already
        box = largest
        if solid.name not in box.cut:
            box = replace(box, cut=(*box.cut, solid.name))
    return box
