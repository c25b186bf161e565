"""Contact of the body's surface with obstacles, in the total formulation.

The surface is a set of points (bodies.contact_surface) which move with the nodes of the cell they are in. Effects push each one as a
particle of the mass of the layer it stands for, and the force goes to the nodes by the same splines, so momentum is kept to rounding.
The points of a cell are a patch, left out while it is farther from every obstacle than it is wide.
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
def _spread(nodes, cells, node, u):
    """Middle of the deformed places of a cell's 27 nodes, m, and their largest distance from it: nothing in the cell is farther away."""
    middle = np.zeros(3)
    for a in range(3):
        for b in range(3):
            k = 3 * (node + a * cells.along_x + b * cells.along_y)
            for i in range(9):
                middle[i % 3] += (nodes.place[k + i] + u[k + i]) / 27.0
    most = 0.0
    for a in range(3):
        for b in range(3):
            k = 3 * (node + a * cells.along_x + b * cells.along_y)
            for c in range(3):
                square = 0.0
                for i in range(3):
                    square += (nodes.place[k + 3 * c + i] + u[k + 3 * c + i] - middle[i]) ** 2
                most = max(most, square)
    return middle, math.sqrt(most)


@compiled
def touch(slab, step, dt, surface, cells, nodes, state, effects):
    """Add the contact of a slab's surface to state.force, and move state.anchor; dt s: for which forces push."""
    x, v, f = np.empty(3), np.empty(3), np.empty(PARTS)
    flags = ANCHOR * len(surface.mass)  # then a number a patch: 1 while some of its points may be held
    for patch in range(surface.first_patch[slab], surface.first_patch[slab + 1]):
        node = surface.first_node[patch]
        first, last = surface.first_point[patch], surface.first_point[patch + 1]
        middle, wide = _spread(nodes, cells, node, state.u)
        depth = deepest(effects, step, middle)
        if depth + wide < 0.0 and depth > -np.inf:  # an obstacle that ends somewhere says -inf there: points may still touch it
            if state.anchor[flags + patch] != 0.0:
                state.anchor[flags + patch] = 0.0
                for p in range(first, last):
                    state.anchor[ANCHOR * p + 3] = 0.0
            continue
        state.anchor[flags + patch] = 1.0
        for p in range(first, last):
            for i in range(3):
                x[i] = surface.place[3 * p + i]
            _value(state.u, node, cells.along_x, cells.along_y, surface.weights, 9 * p, x)
            if not deepest(effects, step, x) > 0.0:
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
