"""What ends a run of steps early: what both formulations' kernels look at in every step.

`watch` (5,) float64 goes in and out of a kernel:

0  the stiffness (m^2/s^2, materials.stiffest over density) above which the time step may be too long for the body
1  the largest share of the body's stiffness by which a particle's may change in a step; beyond it steps do not resolve the motion
2  out: largest stiffness since the watch was set
3  out: largest change in a step since then, over the largest stiffness
4  out: why the steps ended: GOING, BROKEN, STIFF or QUICK
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inlined
from magmpm.compiled.simd import highest, lowest, total

GOING, BROKEN, STIFF, QUICK = 0.0, 1.0, 2.0, 3.0
LIMIT, SHARE, HIGHEST, QUICKEST, WHY = range(5)


class Slabs(NamedTuple):
    """What the last step saw in each slab of particles (slabs,): smallest det F; largest stiffness, and largest change of it, m^2/s^2."""

    low: Array
    high: Array
    change: Array


def new_slabs(count: int) -> Slabs:
    """Of so many slabs."""
    return Slabs(np.zeros(count), np.zeros(count), np.zeros(count))


def unlimited() -> Array:
    """A watch that ends steps only where the body breaks."""
    return np.array([np.inf, np.inf, 0.0, 0.0, GOING])


@inlined
def see(slabs, slab, least, bad, high, change):
    """Write down a slab's step, given lane by lane; bad: not 0 where some det F is 0 or less, or no number."""
    slabs.low[slab] = lowest(least) if total(bad) == 0.0 else np.nan
    slabs.high[slab], slabs.change[slab] = highest(high), highest(change)


@compiled
def stops(watch, slabs):
    """Whether the steps end here."""
    low, high, change = slabs
    most, changed = 0.0, 0.0
    for slab in range(len(low)):
        if not low[slab] > 0.0:  # also where it is no number
            watch[WHY] = BROKEN
            return True
        most, changed = max(most, high[slab]), max(changed, change[slab])
    watch[HIGHEST], watch[QUICKEST] = max(watch[HIGHEST], most), max(watch[QUICKEST], changed / most)
    watch[WHY] = GOING
    if most > watch[LIMIT]:
        watch[WHY] = STIFF
    elif changed > watch[SHARE] * most:
        watch[WHY] = QUICK
    return watch[WHY] != GOING


@compiled
def clear(values):
    """Zeros everywhere: the grid of a step that is not taken."""
    values[:] = 0.0
