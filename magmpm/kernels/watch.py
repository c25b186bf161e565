"""Checks in every step of a motion that can end a run of steps early.

`watch` (5,) float64 is both input and output of a kernel:

0  in: stiffness (m^2/s^2, materials.stiffest over density) above which the time step may be too long for the body
1  in: largest change of a particle's stiffness in one step, as a share of the body's stiffness; beyond it steps do not resolve the motion
2  out: largest stiffness since the watch was set
3  out: largest change in one step since then, over the largest stiffness
4  out: why the steps ended: GOING, BROKEN, STIFF or QUICK
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import inlined, inner
from magmpm.compiled.simd import highest, lowest, total
from magmpm.kernels.flutter import no_flutter

GOING = 0.0
BROKEN = 1.0
STIFF = 2.0
QUICK = 3.0
LIMIT, SHARE, HIGHEST, QUICKEST, WHY = range(5)


class Slabs(NamedTuple):
    """The last step in each slab of particles (slabs,): smallest det F; largest stiffness, and its largest change, m^2/s^2; how many
    patches of the surface have friction, and slide; the sum of their pushes, N. flutter: kernels.flutter."""

    low: Array
    high: Array
    change: Array
    rubs: Array
    slides: Array
    push: Array
    flutter: Array


def new_slabs(count: int) -> Slabs:
    """Room for this many slabs."""
    low, high, change, rubs, slides, push = np.zeros((6, count))
    return Slabs(low, high, change, rubs, slides, push, no_flutter())


def unlimited() -> Array:
    """A watch that ends steps only where some det F is 0, negative or NaN."""
    return np.array([np.inf, np.inf, 0.0, 0.0, GOING])


@inlined
def see(slabs, slab, least, bad, high, change):
    """Store the extremes of a slab, given lane by lane. bad: not 0 where some det F is 0, negative or NaN."""
    slabs.low[slab] = lowest(least) if total(bad) == 0.0 else np.nan
    slabs.high[slab], slabs.change[slab] = highest(high), highest(change)


@inner
def stops(watch, slabs):
    """Update the watch; return whether the steps must end here."""
    most = 0.0
    changed = 0.0
    for slab in range(len(slabs.low)):
        if not slabs.low[slab] > 0.0:  # also where it is NaN
            watch[WHY] = BROKEN
            return True
        most = max(most, slabs.high[slab])
        changed = max(changed, slabs.change[slab])
    watch[HIGHEST], watch[QUICKEST] = (
        max(watch[HIGHEST], most),
        max(watch[QUICKEST], changed / most),
    )
    watch[WHY] = GOING
    if most > watch[LIMIT]:
        watch[WHY] = STIFF
    elif changed > watch[SHARE] * most:
        watch[WHY] = QUICK
    return watch[WHY] != GOING


@inner
def clear(values):
    """Set all values to zero: the grid of a step that is not taken."""
    values[:] = 0.0
