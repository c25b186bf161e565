"""Contact of the body's surface with obstacles, in the total formulation.

The surface is a set of points (bodies.contact_surface) which move with the nodes of the cell they are in. Effects push each one as a
particle of the mass of the layer it stands for, and the force goes to the nodes by the same splines, so momentum is kept to rounding.
The points of a cell are a patch, left out until it has moved by its distance from the obstacles.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inlined
from magmpm.compiled.simd_views import row
from magmpm.effects.contact_force import PARTS, hold
from magmpm.effects.hooks import add_contact, deepest

ANCHOR = 4  # numbers a point in State.anchor: where friction holds it (3,) m, and whether it does: 0 if it does not touch
STICKS, SLIDES = 1.0, 2.0


class Surface(NamedTuple):
    """Points of the surface, sorted by patch and slab.

    first_patch (slabs + 1,), first_point (patches + 1,): of each slab and patch; first_node (patches,); weights (9 points,): splines along
    x, y, z; place (3 points,) m in the undeformed body; mass (points,) kg, of a layer (dynamics.particle_groups).
    """

    first_patch: Index
    first_point: Index
    first_node: Index
    weights: Array
    place: Array
    mass: Array


@inlined
def _value(field, node, along_x, along_y, weights, at, out):
    """out (3,) += value of a nodal field (3 nodes,) at a point whose splines begin at index `at`."""
    for a in range(3):
        for b in range(3):
            k, w = 3 * (node + a * along_x + b * along_y), weights[at + a] * weights[at + 3 + b]
            for c in range(3):
                share = w * weights[at + 6 + c]
                for i in range(3):
                    out[i] += share * field[k + 3 * c + i]


@compiled
def _fastest(cells, node, v):
    """Speed (m/s) of the fastest of a cell's 27 nodes: nothing in the cell is faster."""
    most = 0.0
    for a in range(3):
        for b in range(3):
            k = 3 * (node + a * cells.along_x + b * cells.along_y)
            for c in range(3):
                most = max(most, v[k + 3 * c] ** 2 + v[k + 3 * c + 1] ** 2 + v[k + 3 * c + 2] ** 2)
    return math.sqrt(most)


@compiled
def touch(slab, step, dt, surface, cells, state, effects):
    """Add the contact of a slab's surface to state.force, and move state.anchor; dt s: for which forces push."""
    x, v, f = np.empty(3), np.empty(3), np.empty(PARTS)
    room = ANCHOR * len(surface.mass)  # then a number a patch: how far it can move before a point of it may touch, m
    for patch in range(surface.first_patch[slab], surface.first_patch[slab + 1]):
        node, most, least = surface.first_node[patch], -np.inf, 0.0
        first, last = surface.first_point[patch], surface.first_point[patch + 1]
        if step > 0 and state.anchor[room + patch] > 0.0:  # the last displacement was dt v; before the first step it may have been another
            state.anchor[room + patch] -= dt * _fastest(cells, node, state.v)
            if state.anchor[room + patch] > 0.0:
                continue
        for p in range(first, last):
            for i in range(3):
                x[i] = surface.place[3 * p + i]
            _value(state.u, node, cells.along_x, cells.along_y, surface.weights, 9 * p, x)
            depth = deepest(effects, step, x)
            most, least = max(most, depth), min(least, depth)
            if not depth > 0.0:
                state.anchor[ANCHOR * p + 3] = 0.0
                continue
            v[:], f[:] = 0.0, 0.0
            if state.anchor[ANCHOR * p + 3] != STICKS:
                _value(state.v, node, cells.along_x, cells.along_y, surface.weights, 9 * p, v)
            add_contact(effects, step, x, v, surface.mass[p], dt, f)
            anchor = row(state.anchor, ANCHOR * p)
            if state.anchor[ANCHOR * p + 3] == 0.0:
                for i in range(3):
                    anchor[i] = x[i]
            state.anchor[ANCHOR * p + 3] = SLIDES if hold(x, anchor, f) else STICKS
            _push(state.force, node, cells.along_x, cells.along_y, surface.weights, 9 * p, f)
        state.anchor[room + patch] = -most if most < 0.0 and least > -np.inf else 0.0  # -inf: past an obstacle's end, who knows how far


@inlined
def _push(force, node, along_x, along_y, weights, at, f):
    """force (3 nodes,) += f (3,) by a point's splines, which begin at index `at`."""
    for a in range(3):
        for b in range(3):
            k, w = 3 * (node + a * along_x + b * along_y), weights[at + a] * weights[at + 3 + b]
            for c in range(3):
                share = w * weights[at + 6 + c]
                for i in range(3):
                    force[k + 3 * c + i] += share * f[i]


@compiled
def at_points(surface, along_x, along_y, first_node, u, v, x, speed):
    """Write position x (n, 3) m and velocity (n, 3) m/s of the points; u, v (3 nodes,); first_node (n,)."""
    for p in range(len(surface.mass)):
        x[p], speed[p] = surface.place[3 * p : 3 * p + 3], 0.0
        _value(u, first_node[p], along_x, along_y, surface.weights, 9 * p, x[p])
        _value(v, first_node[p], along_x, along_y, surface.weights, 9 * p, speed[p])
