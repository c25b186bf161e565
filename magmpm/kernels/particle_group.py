"""Stress and load that effects add to a group of eight particles.

A matrix of a group is a flat array (9 8,), row by row, each entry eight lanes.
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inlined, only_where
from magmpm.compiled.simd import WIDTH, load
from magmpm.compiled.simd_views import matrix, vector
from magmpm.effects.hooks import (
    add_narrow_force,
    add_narrow_rate_stress,
    add_narrow_stress,
    add_wide_force,
    add_wide_rate_stress,
    add_wide_stress,
    any_has,
    has_force,
    has_rate_stress,
    has_stress,
)


@compiled
def any_effect(effects):
    """True if any effect but contact acts on particles. Known at compile time."""
    return has_stress(effects) or has_force(effects) or has_rate_stress(effects)


class GroupRoom(NamedTuple):
    """Flat arrays for a group of eight particles, as effects use them.

    F (9 8,) from an index passed with it; P Pa, dF/dt 1/s (9 8,); x m, v m/s, load f N/m^3 (3 8,); spare (72,): work space.
    """

    F: Array
    P: Array
    dF: Array
    x: Array
    v: Array
    f: Array
    spare: Array


@inlined
def group_room(F):
    """Work space for groups with deformation gradients in F."""
    return GroupRoom(
        F, np.empty(72), np.empty(72), np.empty(24), np.empty(24), np.zeros(24), np.empty(72)
    )  # no effect: no load


@compiled
def _lane_by_lane(effects, step, group, F, at, P, dF, x, f, remanence, density, volume):
    """Add the effects with hooks for one particle at a time."""
    F3 = F[at : at + 9 * WIDTH].reshape(3, 3, WIDTH)
    P3 = P.reshape(3, 3, WIDTH)
    dF3 = dF.reshape(3, 3, WIDTH)
    x2 = x.reshape(3, WIDTH)
    f2 = f.reshape(3, WIDTH)
    columns = len(remanence) // len(density)
    magnets = remanence[WIDTH * columns * group : WIDTH * columns * (group + 1)].reshape(
        columns, WIDTH
    )
    for lane in range(WIDTH):
        V = volume[WIDTH * group + lane]
        if V == 0.0:  # a lane without a particle
            continue
        rho = density[WIDTH * group + lane]
        m = magnets[:, lane]
        place = x2[:, lane]
        deformed = F3[:, :, lane]
        force = f2[:, lane]
        add_narrow_stress(effects, step, m, rho, place, deformed, P3[:, :, lane])
        add_narrow_force(effects, step, m, rho, place, deformed, force)
        add_narrow_rate_stress(effects, step, rho, deformed, dF3[:, :, lane], P3[:, :, lane])


_add_narrow = only_where(
    "effects", any_has("stress", "force", "rate_stress", wide=False), _lane_by_lane
)


@inlined
def add_effects(effects, step, group, at, particles, work):
    """Add the effects to the stress P (Pa) and load f (N/m^3) of a group in work (GroupRoom), with F from index `at`.

    particles: a record with remanence (groups 3 8,), or (groups 4 8,) where an effect marks particles (acting.marked), and density and
    volume (groups 8,).
    Flat arrays and views, no slices: counting references would cost as much as an effect, and did where an array met a branch.
    """
    F, P, dF, x, _, f, _ = work
    remanence = particles.remanence
    density = particles.density
    volume = particles.volume
    rho = load(density, WIDTH * group)
    m = vector(remanence, WIDTH * (len(remanence) // len(density)) * group)
    place = vector(x, 0)
    deformed = matrix(F, at)
    out = matrix(P, 0)
    add_wide_stress(effects, step, m, rho, place, deformed, out)
    add_wide_force(effects, step, m, rho, place, deformed, vector(f, 0))
    add_wide_rate_stress(effects, step, rho, deformed, matrix(dF, 0), out)
    _add_narrow(effects, step, group, F, at, P, dF, x, f, remanence, density, volume)
