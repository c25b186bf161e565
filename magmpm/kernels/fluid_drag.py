"""A fluid around a body in motion: its drag on pieces of the surface, and the mass of it that the body carries along.

A piece (bodies.wetted_surface) moves with the 27 nodes of the cell it is in; effects say the force on it (the hook `drag`), which goes to
the nodes by the same splines, so momentum is kept to rounding. Forces on a node that carries fluid along first accelerate that, too: of the
force f on a node of mass m with the added mass m a n n^T + m b (1 - n n^T) the body gets (1 + a n n^T + b (1 - n n^T))^-1 f.
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.by_address import address
from magmpm.compiled.jit import inner, task_body
from magmpm.compiled.parallel import TOGETHER
from magmpm.effects.calls import call_each, given_for
from magmpm.kernels.impulses import SPLINES, add_force, sum_at


class WettedPieces(NamedTuple):
    """Pieces (n,) sorted by slab, flat: first (slabs + 1,): of each slab; node (n,): the first of its cell; place (3 n,) m; axial (n,): 1
    of a rod's, whose direction is its axis.

    weights, along, over (SPLINES n,): the splines of its nodes, and their slopes (1/m) along its two tangents; tangents (6 n,); law (k n,):
    its numbers in the effect's law; normal (3 n,): in the present shape, the axis of a rod or a normal, by its length the piece's size over
    that at rest. Of each active node (m,): of (m,): the piece whose direction it takes; carried (2 m,): a and b of its added mass.
    """

    first: Index
    node: Index
    place: Array
    axial: Index
    weights: Array
    along: Array
    over: Array
    tangents: Array
    law: Array
    normal: Array
    of: Index
    carried: Array


@inner
def _gather(piece, pieces, along_x, along_y, state, x, v):
    """Write to x and v (3,) the place (m) and velocity (m/s) of a piece, and its direction to pieces.normal."""
    to = (SPLINES * piece, pieces.node[piece], along_x, along_y)
    tangent = pieces.tangents
    n = 6 * piece
    moved = sum_at(pieces.weights, *to, state.u)
    speed = sum_at(pieces.weights, *to, state.v)
    a, b, c = sum_at(pieces.along, *to, state.u)
    a += tangent[n]
    b += tangent[n + 1]
    c += tangent[n + 2]
    for i in range(3):
        x[i] = pieces.place[3 * piece + i] + moved[i]
        v[i] = speed[i]
    normal = pieces.normal
    n = 3 * piece
    if pieces.axial[piece] > 0:
        normal[n] = a
        normal[n + 1] = b
        normal[n + 2] = c
        return
    p, q, r = sum_at(pieces.over, *to, state.u)
    p += tangent[2 * n + 3]
    q += tangent[2 * n + 4]
    r += tangent[2 * n + 5]
    normal[n] = b * r - c * q
    normal[n + 1] = c * p - a * r
    normal[n + 2] = a * q - b * p


@inner
def immerse(slab, step, dt, pieces, cells, state, calls):
    """Add the drag on the pieces of a slab to state.force."""
    if len(calls.drag) == 0:
        return
    begin = pieces.first[slab]
    count = pieces.first[slab + 1] - begin
    x = np.empty((count, 3))
    v = np.empty((count, 3))
    f = np.zeros((count, 3))
    for k in range(count):
        _gather(begin + k, pieces, cells.along_x, cells.along_y, state, x[k], v[k])
    given = given_for()
    at = given[0]
    at.x = address(x, 0)
    at.v = address(v, 0)
    at.force = address(f, 0)
    at.normal = address(pieces.normal, 3 * begin)
    at.columns = len(pieces.law) // len(pieces.node)
    at.law = address(pieces.law, at.columns * begin)
    call_each(calls.drag, step, 0, count, dt, address(given, 0))
    for k in range(count):
        on = (pieces.weights, SPLINES * (begin + k), pieces.node[begin + k])
        force = (f[k, 0], f[k, 1], f[k, 2])
        add_force(*on, cells.along_x, cells.along_y, force, state.force)


@task_body
def carry(part, given):
    """Let the forces on some active nodes accelerate the fluid that they carry along as well."""
    pieces, nodes, state = given
    first = TOGETHER * part
    last = min(first + TOGETHER, len(nodes.active))
    for k in range(first, last):
        node = 3 * nodes.active[k]
        piece = 3 * pieces.of[k]
        n0 = pieces.normal[piece]
        n1 = pieces.normal[piece + 1]
        n2 = pieces.normal[piece + 2]
        f = state.force
        out = n0 * f[node] + n1 * f[node + 1] + n2 * f[node + 2]
        across = 1.0 / (1.0 + pieces.carried[2 * k])
        beside = 1.0 / (1.0 + pieces.carried[2 * k + 1])
        out *= (across - beside) / (n0 * n0 + n1 * n1 + n2 * n2)
        f[node] = beside * f[node] + out * n0
        f[node + 1] = beside * f[node + 1] + out * n1
        f[node + 2] = beside * f[node + 2] + out * n2
