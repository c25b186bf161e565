"""Compiled steps of a rod in motion: `magmpm.rod.motion` has the formulas and their sources.

Nodes k = 0 .. n with places x and velocities v (n + 1, 3); elements e = 0 .. n - 1 between them with unit quaternions q (n, 4), scalar
first, and angular velocities w (n, 3) rad/s in their own frames.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magmpm.bodies.signed_distance import value
from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.contact_force import PARTS, hold, push
from magmpm.rod.kernels import matrix

# Of an element: length m; twist and bending N m^2; stretch and shear N; moment A m; loss s; masses of its halves kg; inertia kg m^2
ELEMENT = np.dtype(
    [
        ("length", np.float64), ("bend", np.float64, (3,)), ("stretch", np.float64, (3,)), ("moment", np.float64, (3,)),
        ("loss", np.float64), ("mass", np.float64), ("inertia", np.float64, (3,)),
    ]
)  # fmt: skip
# Of the whole: what holds it, and what it touches. Stiffness: of every contact, 1/s^2
SURROUNDINGS = np.dtype(
    [
        ("damping", np.float64), ("held_base", np.int64), ("held_tip", np.int64), ("half", np.float64), ("stiffness", np.float64),
        ("fed", np.int64), ("feed_speed", np.float64), ("feed_exit", np.float64), ("feed_radius", np.float64),
        ("ground", np.int64), ("ground_point", np.float64, (3,)), ("ground_normal", np.float64, (3,)), ("ground_friction", np.float64),
        ("walls", np.int64), ("walls_origin", np.float64, (3,)), ("walls_spacing", np.float64), ("walls_shape", np.int64, (3,)),
        ("walls_friction", np.float64),
    ]
)  # fmt: skip


class State(NamedTuple):
    """Arrays changed by a step: x, v, q, w; old (n + 2, 6): strains of the last step, for losses, of each element, then of the two clamps;
    anchor (n + 1, 3) m: where friction holds the nodes (effects.contact_force)."""

    x: Array
    v: Array
    q: Array
    w: Array
    old: Array
    anchor: Array


@compiled
def _stretch(e, x, R, element, field, old, dt, f, torque):
    """Forces and torques of the stretch and shear of an element, and of the field on it. old (n, 6): strains of the last step."""
    d0, d1, d2 = x[e + 1, 0] - x[e, 0], x[e + 1, 1] - x[e, 1], x[e + 1, 2] - x[e, 2]
    h = element.length
    inside, pull, b = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        inside[i] = R[0, i] * d0 + R[1, i] * d1 + R[2, i] * d2
        b[i] = R[0, i] * field[0] + R[1, i] * field[1] + R[2, i] * field[2]
        s = inside[i] / h - (1.0 if i == 0 else 0.0)
        pull[i] = element.stretch[i] * (s + element.loss * (s - old[e, i]) / dt)
        old[e, i] = s
    m = element.moment
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        torque[e, i] += inside[j] * pull[k] - inside[k] * pull[j]
        mj, mk = (0.0 if j == 0 else m[j]), (0.0 if k == 0 else m[k])
        torque[e, i] += h * (mj * b[k] - mk * b[j])
        along = R[i, 0] * pull[0] + R[i, 1] * pull[1] + R[i, 2] * pull[2] - m[0] * field[i]  # the axial moment stretches with the element
        f[e, i] += along
        f[e + 1, i] -= along


@compiled
def _bend(a, b, length, D, loss, old, dt, ga, gb):
    """Torques of bending and twist between two elements' quaternions a and b onto them, ga and gb, each in its own frame."""
    z = np.empty(3)
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    z[0] = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    z[1] = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    z[2] = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    sign = -1.0 if w < 0 else 1.0
    w *= sign
    M = np.empty(3)
    for i in range(3):
        z[i] *= sign
        M[i] = 4.0 / length * D[i] * (z[i] + loss * (z[i] - old[3 + i]) / dt)
        old[3 + i] = z[i]
    for i in range(3):  # the gradient of 2/l z.D z with turns of either (magmpm.rod.kernels._add_bending)
        j, k = (i + 1) % 3, (i + 2) % 3
        cross = 0.5 * (z[j] * M[k] - z[k] * M[j])
        ga[i] += 0.5 * w * M[i] - cross
        gb[i] -= 0.5 * w * M[i] + cross


@compiled
def _touch(p, table, x, anchor, t, mass, f):
    """Add to f (3,) N the contact of the disc around a node with ground and wall, and move its anchor (effects.contact_force).

    t (3,): the rod's direction there. The rim of a disc that meets the wall head on is no nearer to it than its middle.
    """
    pushed = np.zeros(PARTS)
    if p.ground == 1:
        n = p.ground_normal
        cosine = t[0] * n[0] + t[1] * n[1] + t[2] * n[2]
        below = p.half * math.sqrt(max(0.0, 1.0 - cosine * cosine))
        for i in range(3):
            below -= (x[i] - p.ground_point[i]) * n[i]
        if below > 0.0:
            push(below, n[0], n[1], n[2], 0.0, mass, p.stiffness, 1.0, 1.0, 0.0, p.ground_friction, pushed)
    if p.walls == 1:
        s = p.walls_spacing
        a, b, c = (x[0] - p.walls_origin[0]) / s, (x[1] - p.walls_origin[1]) / s, (x[2] - p.walls_origin[2]) / s
        nx, ny, nz = p.walls_shape[0], p.walls_shape[1], p.walls_shape[2]
        if 0.5 <= a < nx - 1.5 and 0.5 <= b < ny - 1.5 and 0.5 <= c < nz - 1.5:
            room, n0, n1, n2 = value(a, b, c, s, ny, nz, table)
            size = math.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            if room < p.half and size > 0.0:
                n0, n1, n2 = n0 / size, n1 / size, n2 / size
                cosine = t[0] * n0 + t[1] * n1 + t[2] * n2
                beyond = p.half * math.sqrt(max(0.0, 1.0 - cosine * cosine)) - room
                if beyond > 0.0:
                    push(beyond, n0, n1, n2, 0.0, mass, p.stiffness, 1.0, 1.0, 0.0, p.walls_friction, pushed)
    hold(x, anchor, pushed)
    for i in range(3):
        f[i] += pushed[i]


@compiled
def _spin(q, w, torque, inertia, dt, damping):
    """Euler's equations of an element: w and q a step on; I dw/dt = (I w) x w + torque."""
    I0, I1, I2 = inertia[0], inertia[1], inertia[2]
    a0 = (torque[0] + (I1 - I2) * w[1] * w[2]) / I0
    a1 = (torque[1] + (I2 - I0) * w[2] * w[0]) / I1
    a2 = (torque[2] + (I0 - I1) * w[0] * w[1]) / I2
    w[0], w[1], w[2] = damping * (w[0] + dt * a0), damping * (w[1] + dt * a1), damping * (w[2] + dt * a2)
    x, y, z = 0.5 * dt * w[0], 0.5 * dt * w[1], 0.5 * dt * w[2]
    a, b, c, d = q[0], q[1], q[2], q[3]
    p0, p1 = a - b * x - c * y - d * z, b + a * x + c * z - d * y
    p2, p3 = c + a * y - b * z + d * x, d + a * z + b * y - c * x
    size = math.sqrt(p0 * p0 + p1 * p1 + p2 * p2 + p3 * p3)
    q[0], q[1], q[2], q[3] = p0 / size, p1 / size, p2 / size, p3 / size


@compiled
def _inside(p, x, e):
    """True if the guide of a feed holds element e: its middle is before the exit."""
    return p.fed == 1 and 0.5 * (x[e, 0] + x[e + 1, 0]) < p.feed_exit and x[e, 1] ** 2 + x[e, 2] ** 2 < p.feed_radius**2


@compiled
def _forces(x, anchor, q, old, elements, field, load, around, table, dt, f, torque):
    """Forces f (n + 1, 3) N on the nodes and torques (n, 3) N m on the elements. field (n, 3) T: on them now.

    The first element beyond a guide bends between the exit and its middle: by a length of at least a sixth, which keeps the step stable.
    """
    n, p = len(elements), around[0]
    R, t, one, ends = np.empty((3, 3)), np.empty(3), np.zeros(4), np.zeros((2, 3))
    one[0] = 1.0
    for k in range(n + 1):
        for i in range(3):
            f[k, i] = load[k, i]
    for e in range(n):
        matrix(q[e], R)
        for i in range(3):
            torque[e, i] = R[0, i] * load[n + 1 + e, 0] + R[1, i] * load[n + 1 + e, 1] + R[2, i] * load[n + 1 + e, 2]
        _stretch(e, x, R, elements[e], field[e], old, dt, f, torque)
        if p.ground == 1 or p.walls == 1:
            for i in range(3):
                t[i] = R[i, 0]
            before = elements[e - 1].mass if e > 0 else 0.0
            _touch(p, table, x[e], anchor[e], t, elements[e].mass + before, f[e])
            if e == n - 1:
                _touch(p, table, x[n], anchor[n], t, elements[e].mass, f[n])
    for e in range(n - 1):
        here, there = elements[e], elements[e + 1]
        length = 0.5 * (here.length + there.length)
        for i in range(3):  # two halves in series
            t[i] = 2.0 * length / (here.length / here.bend[i] + there.length / there.bend[i])
        if _inside(p, x, e) and not _inside(p, x, e + 1):
            length = max(0.5 * (x[e + 1, 0] + x[e + 2, 0]) - p.feed_exit, there.length / 6.0)
            for i in range(3):
                t[i] = there.bend[i]
        _bend(q[e], q[e + 1], length, t, 0.5 * (here.loss + there.loss), old[e], dt, torque[e], torque[e + 1])
    if p.held_base == 1:
        _bend(one, q[0], 0.5 * elements[0].length, elements[0].bend, elements[0].loss, old[n], dt, ends[0], torque[0])
    if p.held_tip == 1:
        last = elements[n - 1]
        _bend(q[n - 1], one, 0.5 * last.length, last.bend, last.loss, old[n + 1], dt, torque[n - 1], ends[1])


@compiled
def advance(state, elements, field, load, around, table, dt, steps):
    """`steps` steps of dt (s); changes State in place. field (2, n, 3) T: on the elements, at the first and after the last step;
    load (2 n + 1, 3): N on the nodes, then N m on the elements; around: SURROUNDINGS (1,)."""
    x, v, q, w, old, anchor = state
    n, p = len(elements), around[0]
    f, torque, now = np.empty((n + 1, 3)), np.empty((n, 3)), np.empty((n, 3))
    left = math.exp(-p.damping * dt)
    for step in range(steps):
        share = step / steps
        for e in range(n):
            for i in range(3):
                now[e, i] = (1.0 - share) * field[0, e, i] + share * field[1, e, i]
        _forces(x, anchor, q, old, elements, now, load, around, table, dt, f, torque)
        for k in range(n + 1):
            mass = (elements[k].mass if k < n else 0.0) + (elements[k - 1].mass if k > 0 else 0.0)
            guided = (k < n and _inside(p, x, k)) or (k > 0 and _inside(p, x, k - 1))
            held = (p.held_base == 1 and k == 0) or (p.held_tip == 1 and k == n)
            for i in range(3):
                v[k, i] = 0.0 if held or guided else left * (v[k, i] + dt * f[k, i] / mass)
            if guided:
                v[k, 0] = p.feed_speed
        for e in range(n):
            if _inside(p, x, e):
                w[e, 0], w[e, 1], w[e, 2] = 0.0, 0.0, 0.0
            else:
                _spin(q[e], w[e], torque[e], elements[e].inertia, dt, left)
        for k in range(n + 1):
            for i in range(3):
                x[k, i] += dt * v[k, i]
