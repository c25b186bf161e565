"""What ends a run of steps early: what both formulations' kernels look at in every step.

`watch` (5,) float64 goes in and out of a kernel:

0  the stiffness (m^2/s^2, lanes.stiffest over density) above which the time step may be too long for the body
1  the largest share of the body's stiffness by which a particle's may change in a step; beyond it steps do not resolve the motion
2  out: largest stiffness since the watch was set
3  out: largest change in a step since then, over the largest stiffness
4  out: why the steps ended: GOING, BROKEN, STIFF or QUICK
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.jit import compiled

GOING, BROKEN, STIFF, QUICK = 0.0, 1.0, 2.0, 3.0
LIMIT, SHARE, HIGHEST, QUICKEST, WHY = range(5)


def unlimited() -> np.ndarray:
    """A watch that ends steps only where the body breaks."""
    return np.array([np.inf, np.inf, 0.0, 0.0, GOING])


@compiled
def stops(watch, low, high, change):  # type: ignore[no-untyped-def]
    """Whether the steps end here. low, high, change (slabs,): smallest det F, largest stiffness, largest change of it in the last step."""
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
