"""The total formulation's step written without the mechanism of effects: what a scene without effects is measured against.

The loop of transfer.total.advance, with everything about effects struck out.
"""

from __future__ import annotations

import numpy as np

from magmpm.jit import kernel, prange
from magmpm.simd import (
    flag_unless_positive,
    load,
    lowest,
    smaller,
    splat,
    store,
    total,
)
from magmpm.transfer.lanes import determinant, neo_hookean
from magmpm.transfer.total import _project, _projected, gather, scatter


@kernel
def advance(
    steps, dt, slab_first, cell_group, cell_node, cell_shear, cell_bulk, along_x, along_y, pattern, splines, volume, moments, modes, count,
    active,
    inverse_mass, u, v, force, low,
):  # fmt: skip
    """`steps` steps of dt (s); arguments as of transfer.total.advance."""
    slabs = len(slab_first) - 1
    flat_volume = volume.reshape(-1)
    most = 1
    for cell in range(len(cell_node)):
        most = max(most, cell_group[cell + 1] - cell_group[cell])
    for step in range(steps):
        for colour in range(2):
            for half in prange((slabs + 1 - colour) // 2):
                slab = 2 * half + colour
                F, J, c = np.empty(72 * most), np.empty(8 * most), np.empty(4)
                P, f, work, value = np.empty(72), np.empty(24), np.empty(72), np.empty(24 * most)
                f[:] = 0.0
                least, bad = splat(np.inf), splat(0.0)
                for cell in range(slab_first[slab], slab_first[slab + 1]):
                    first, last, node = cell_group[cell], cell_group[cell + 1], cell_node[cell]
                    c[:] = 0.0
                    for group in range(first, last):
                        at = 72 * (group - first)
                        gather(u, node, along_x, along_y, splines, pattern[group], F, at, value, at // 3)
                        for i in range(3):
                            store(F, at + 32 * i, load(F, at + 32 * i) + 1.0)
                        det = determinant(F, at)
                        store(J, 8 * (group - first), det)
                        least, bad = smaller(det, least), flag_unless_positive(det, bad)
                        _project(modes, moments[group], group, 8 * (group - first), count, flat_volume, J, c)
                    for group in range(first, last):
                        at = 72 * (group - first)
                        det = load(J, 8 * (group - first))
                        change = det - 1.0 if count == 0 else _projected(modes, moments[group], count, c)
                        neo_hookean(F, at, det, cell_shear[cell], change * cell_bulk[cell], P)
                        V = load(flat_volume, 8 * group)
                        for i in range(9):
                            store(P, 8 * i, load(P, 8 * i) * V)
                        scatter(force, node, along_x, along_y, splines, pattern[group], P, f, work)
                low[slab] = lowest(least) if total(bad) == 0.0 else np.nan
        broken = False
        for slab in range(slabs):
            broken = broken or not low[slab] > 0.0
        if broken:
            force[:] = 0.0
            return step
        for k in prange(len(active)):
            n = 3 * active[k]
            for i in range(3):
                v[n + i] += dt * inverse_mass[n + i] * force[n + i]
                force[n + i] = 0.0
            for i in range(3):
                u[n + i] += dt * v[n + i]
    return steps
