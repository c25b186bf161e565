"""What both formulations do with a group of eight particles: neo-Hookean stress, and what the effects add.

A matrix of a group is a flat array (9 8,), row by row, each entry eight lanes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inlined
from magmpm.compiled.simd import WIDTH, cube_root_guess, highest, load, magnitude, store
from magmpm.compiled.simd_views import matrix, single, vector
from magmpm.effects.hooks import (
    add_contact,
    add_narrow_force,
    add_narrow_rate_stress,
    add_narrow_stress,
    add_wide_force,
    add_wide_rate_stress,
    add_wide_stress,
    any_near,
    has_contact,
    has_force,
    has_narrow,
    has_other_contact,
    has_rate_stress,
    has_stress,
    has_wide_near,
    wide_near,
)


@compiled
def any_effect(effects):
    """Whether any effect acts on particles; known while compiling."""
    return has_stress(effects) or has_force(effects) or has_rate_stress(effects) or has_contact(effects)


@compiled
def inverse_cube_root(x):
    """x^(-1/3) of positive, normal lanes to a few units in the last place: Newton's method on y^-3 = x, from a guess good to 4 %.

    Each step squares the error and doubles it: 4e-2, 3e-3, 2e-5, 1e-9, 1e-18. Elsewhere (x <= 0) the value means nothing.
    """
    y = cube_root_guess(x)
    third = x * (1.0 / 3.0)
    for _ in range(4):
        y = y * (4.0 / 3.0 - third * y * y * y)
    return y


@compiled
def determinant(F, at):
    """det F of a group, F (9 8,) from index `at`."""
    a, b, c = load(F, at), load(F, at + 8), load(F, at + 16)
    d, e, f = load(F, at + 24), load(F, at + 32), load(F, at + 40)
    g, h, i = load(F, at + 48), load(F, at + 56), load(F, at + 64)
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


@compiled
def neo_hookean(F, at, J, shear, pressure, P):
    """First Piola-Kirchhoff stress P (9 8,) of a group: G J^(-2/3) (F - I1/3 F^-T) + p J F^-T (materials.stress).

    Returns G J^(-2/3), I1 = |F|^2 and I2 = |cof F|^2, from which `stiffest` and `stiffest_in_space` are found.
    """
    a, b, c = load(F, at), load(F, at + 8), load(F, at + 16)
    d, e, f = load(F, at + 24), load(F, at + 32), load(F, at + 40)
    g, h, i = load(F, at + 48), load(F, at + 56), load(F, at + 64)
    root = inverse_cube_root(J)
    scale = shear * root * root
    I1 = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
    k = pressure - scale * I1 / (3.0 * J)
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    D, E, Q = c * h - b * i, a * i - c * g, b * g - a * h
    R, S, T = b * f - c * e, c * d - a * f, a * e - b * d
    store(P, 0, scale * a + k * A)
    store(P, 8, scale * b + k * B)
    store(P, 16, scale * c + k * C)
    store(P, 24, scale * d + k * D)
    store(P, 32, scale * e + k * E)
    store(P, 40, scale * f + k * Q)
    store(P, 48, scale * g + k * R)
    store(P, 56, scale * h + k * S)
    store(P, 64, scale * i + k * T)
    return scale, I1, A * A + B * B + C * C + D * D + E * E + Q * Q + R * R + S * S + T * T


@compiled
def stiffest(J, scale, I1, I2, pressure, bulk):
    """About the largest eigenvalue, Pa, of the tangent dP/dF of a group: what the largest stable step goes with.

    The tangent (materials.tangent) is g 1 + a H(x)H + b swap(H, H) - 2/3 g (F(x)H + H(x)F) with g = G J^(-2/3), H = F^-T,
    a = 2/9 g I1 + p J + K J^2 and b = g I1/3 - p J. The first three are bounded term by term, |H(x)H| = |swap| = |H|^2 = I2/J^2; the
    last is left out: it is negative where the others are large. 3 K + 6 G at rest, where the true one is 3 K.
    """
    r = 1.0 / J
    shape, turned = scale * I1 * (1.0 / 3.0), pressure * J
    along = shape * (2.0 / 3.0) + turned + bulk * J * J
    return scale + (0.5 * (along + magnitude(along)) + magnitude(shape - turned)) * I2 * r * r


@compiled
def stiffest_in_space(J, scale, I1, pressure, bulk):
    """The same, Pa, of the tangent with respect to places now, dP F^T/d grad u, per undeformed volume."""
    shape, turned = scale * I1 * (1.0 / 3.0), pressure * J
    along = shape * (2.0 / 3.0) + turned + bulk * J * J
    return shape + 3.0 * (0.5 * (along + magnitude(along)) + magnitude(shape - turned))


@inlined
def touches(effects, step, group, x, volume):
    """Whether contact may push a particle of a group, x (3 8,)."""
    if has_wide_near(effects) and highest(wide_near(effects, step, vector(x, 0))) > 0.0:
        return True
    if has_other_contact(effects):
        for lane in range(WIDTH):
            if volume[WIDTH * group + lane] != 0.0 and any_near(effects, step, single(x, lane)):  # 0: a lane without a particle
                return True
    return False


class GroupRoom(NamedTuple):
    """A group of eight particles as effects see it, flat.

    F (9 8,) from an index that goes with it; P Pa, dF/dt 1/s (9 8,); x m, v m/s, load per volume f N/m^3 (3 8,); spare (72,) to work in.
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
    """Room for groups whose deformation gradients are in F."""
    return GroupRoom(F, np.empty(72), np.empty(72), np.empty(24), np.empty(24), np.empty(24), np.empty(72))


@inlined
def add_effects(effects, step, dt, group, at, touched, particles, work):
    """What the effects add to the stress P (Pa) and load f (N/m^3) of a group, work (GroupRoom) with its F from index `at`.

    touched: whether contact may push the group (`touches`); particles: with remanence (groups 3 8,), or (groups 4 8,) where an effect marks
    particles (effects.marked), and density and volume (groups 8,).
    Flat arrays and no slices: counting references to them would cost as much as an effect.
    """
    F, P, dF, x, v, f, spare = work
    remanence, density, volume = particles.remanence, particles.density, particles.volume
    rho = load(density, WIDTH * group)
    m, place, deformed, out = vector(remanence, WIDTH * (len(remanence) // len(density)) * group), vector(x, 0), matrix(F, at), matrix(P, 0)
    add_wide_stress(effects, step, m, rho, place, deformed, out)
    add_wide_force(effects, step, m, rho, place, deformed, vector(f, 0))
    add_wide_rate_stress(effects, step, rho, deformed, matrix(dF, 0), out)
    if has_narrow(effects):
        _lane_by_lane(effects, step, group, F, at, P, dF, x, f, remanence, density, volume)
    if has_contact(effects) and touched:
        _contacts(effects, step, dt, group, x, v, f, spare, density, volume)


@compiled
def _lane_by_lane(effects, step, group, F, at, P, dF, x, f, remanence, density, volume):
    """What the effects add whose hooks serve one particle."""
    F3, P3, dF3 = F[at : at + 9 * WIDTH].reshape(3, 3, WIDTH), P.reshape(3, 3, WIDTH), dF.reshape(3, 3, WIDTH)
    x2, f2 = x.reshape(3, WIDTH), f.reshape(3, WIDTH)
    columns = len(remanence) // len(density)
    magnets = remanence[WIDTH * columns * group : WIDTH * columns * (group + 1)].reshape(columns, WIDTH)
    for lane in range(WIDTH):
        V = volume[WIDTH * group + lane]
        if V == 0.0:  # a lane without a particle
            continue
        rho, m = density[WIDTH * group + lane], magnets[:, lane]
        place, deformed, force = x2[:, lane], F3[:, :, lane], f2[:, lane]
        add_narrow_stress(effects, step, m, rho, place, deformed, P3[:, :, lane])
        add_narrow_force(effects, step, m, rho, place, deformed, force)
        add_narrow_rate_stress(effects, step, rho, deformed, dF3[:, :, lane], P3[:, :, lane])


@compiled
def _contacts(effects, step, dt, group, x, v, f, room, density, volume):
    """What contact adds to the loads, particle by particle; room (3 8,) to work in."""
    force = room
    for lane in range(WIDTH):
        V = volume[WIDTH * group + lane]
        if V != 0.0:  # a lane with a particle
            for i in range(3):
                force[WIDTH * i + lane] = 0.0
            add_contact(effects, step, single(x, lane), single(v, lane), density[WIDTH * group + lane] * V, dt, single(force, lane))
            per_volume = 1.0 / V
            for i in range(3):
                f[WIDTH * i + lane] += per_volume * force[WIDTH * i + lane]
