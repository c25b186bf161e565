"""The step of the total formulation without the mechanism of effects: the baseline for scenes without effects.

The loop of kernels.total_lagrangian_step.advance line by line, without everything about effects and otherwise unchanged: the watch on
stiffness and det F is part of every step. tests/unit/project/test_benchmarks.py compares the two line by line, and their results.
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.jit import kernel, prange
from magmpm.compiled.simd import (
    flag_unless_positive,
    highest,
    larger,
    load,
    lowest,
    magnitude,
    smaller,
    splat,
    store,
    total,
)
from magmpm.kernels.particle_group import determinant, neo_hookean, stiffest
from magmpm.kernels.total_lagrangian_step import _project, _projected, gather, scatter
from magmpm.kernels.watch import stops


@kernel
def advance(
    steps, dt, slab_first, cell_group, cell_node, cell_shear, cell_bulk, along_x, along_y, pattern, splines, volume, moments, modes, count,
    density, active, inverse_mass, u, v, force, stiffness, watch, slab_low, slab_high, slab_change,
):  # fmt: skip
    """`steps` steps of dt (s); the arguments are those of kernels.total_lagrangian_step.advance."""
    slabs = len(slab_first) - 1
    flat_volume, flat_density = volume.reshape(-1), density.reshape(-1)
    most = 1
    for cell in range(len(cell_node)):
        most = max(most, cell_group[cell + 1] - cell_group[cell])
    for step in range(steps):
        for colour in range(2):
            for half in prange((slabs + 1 - colour) // 2):
                slab = 2 * half + colour
                F, J, c = np.empty(72 * most), np.empty(8 * most), np.empty(4)
                P, f, work = np.empty(72), np.empty(24), np.empty(72)
                value = np.empty(24 * most)
                f[:] = 0.0
                least, bad, high, change = splat(np.inf), splat(0.0), splat(0.0), splat(0.0)
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
                        swollen = det - 1.0 if count == 0 else _projected(modes, moments[group], count, c)
                        pressure = swollen * cell_bulk[cell]
                        scale, I1, I2 = neo_hookean(F, at, det, cell_shear[cell], pressure, P)
                        stiff = stiffest(det, scale, I1, I2, pressure, cell_bulk[cell]) / load(flat_density, 8 * group)
                        high = larger(stiff, high)
                        change = larger(magnitude(stiff - load(stiffness, 8 * group)), change)
                        store(stiffness, 8 * group, stiff)
                        V = load(flat_volume, 8 * group)
                        for i in range(9):
                            store(P, 8 * i, load(P, 8 * i) * V)
                        scatter(force, node, along_x, along_y, splines, pattern[group], P, f, work)
                slab_low[slab] = lowest(least) if total(bad) == 0.0 else np.nan
                slab_high[slab], slab_change[slab] = highest(high), highest(change)
        if stops(watch, slab_low, slab_high, slab_change):
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


def steps_of(motion, steps, dt, u, v):  # type: ignore[no-untyped-def]
    """Take steps of dt (s) of a TotalMotion without effects, on displacements u and velocities v (3 nodes,), in place."""
    p = motion.packed
    return advance(
        steps, dt, p.slab_first, p.cell_group, p.cell_node, p.cell_shear, p.cell_bulk, *p.along, p.pattern, p.splines, p.volume, p.moments,
        p.modes, p.mode_count, p.density, p.active, p.inverse_mass, u, v, motion.force, motion.stiffness, motion.watch, *motion.slab,
    )  # fmt: skip
