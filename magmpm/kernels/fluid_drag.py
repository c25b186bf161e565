"""A fluid around a body in motion: its drag on pieces of the surface, and the mass of it that the body carries along.

A piece (bodies.wetted_surface) moves with the 27 nodes of the cell it is in; effects say the force on it (the hook `drag`), which goes to
the nodes by the same splines, so momentum is kept to rounding. Forces on a node that carries fluid along first accelerate that, too: of the
force f on a node of mass m with the added mass m a n n^T + m b (1 - n n^T) the body gets (1 + a n n^T + b (1 - n n^T))^-1 f.
"""

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.by_address import address
from magmpm.compiled.jit import compiled, inner
from magmpm.compiled.parallel import TOGETHER
from magmpm.effects.calls import call_each, given_for
from magmpm.kernels.equilibrium import STENCIL


class WettedPieces(NamedTuple):
    """Pieces (n,) sorted by slab, flat: first (slabs + 1,): of each slab; node (n,): the first of its cell; place (3 n,) m.

    weights, along, over (27 n,): the splines of its nodes, and their slopes (1/m) along its two tangents; tangents (6 n,); law (k n,):
    its numbers in the effect's law; normal (3 n,): in the present shape, the axis of a rod or a normal, by its length the piece's size over
    that at rest. Of each active node (m,): of (m,): the piece whose direction it takes; carried (2 m,): a and b of its added mass.
    """

    first: Index
    node: Index
    place: Array
    weights: Array
    along: Array
    over: Array
    tangents: Array
    law: Array
    normal: Array
    of: Index
    carried: Array


@compiled
def _gather(piece, pieces, along_x, along_y, state, x, v):
    """Write to x and v (3,) the place (m) and velocity (m/s) of a piece, and its direction to pieces.normal."""
    node = pieces.node[piece]
    first = np.zeros(3)
    second = np.zeros(3)
    for i in range(3):
        x[i] = pieces.place[3 * piece + i]
        v[i] = 0.0
        first[i] = pieces.tangents[6 * piece + i]
        second[i] = pieces.tangents[6 * piece + 3 + i]
    for k in range(STENCIL):
        n = 3 * (node + k // 9 * along_x + k // 3 % 3 * along_y + k % 3)
        at = STENCIL * piece + k
        for i in range(3):
            x[i] += pieces.weights[at] * state.u[n + i]
            v[i] += pieces.weights[at] * state.v[n + i]
            first[i] += pieces.along[at] * state.u[n + i]
            second[i] += pieces.over[at] * state.u[n + i]
    normal = pieces.normal[3 * piece : 3 * piece + 3]
    if second[0] == 0.0 and second[1] == 0.0 and second[2] == 0.0:  # of a rod: its axis
        normal[:] = first
        return
    normal[0] = first[1] * second[2] - first[2] * second[1]
    normal[1] = first[2] * second[0] - first[0] * second[2]
    normal[2] = first[0] * second[1] - first[1] * second[0]


@compiled
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
        node = pieces.node[begin + k]
        for j in range(STENCIL):
            n = 3 * (node + j // 9 * cells.along_x + j // 3 % 3 * cells.along_y + j % 3)
            share = pieces.weights[STENCIL * (begin + k) + j]
            for i in range(3):
                state.force[n + i] += share * f[k, i]


@inner
def carry(part, given):
    """Let the forces on some active nodes accelerate the fluid that they carry along as well."""
    pieces, nodes, state = given
    first = TOGETHER * part
    last = min(first + TOGETHER, len(nodes.active))
    for k in range(first, last):
        f = state.force[3 * nodes.active[k] : 3 * nodes.active[k] + 3]
        n = pieces.normal[3 * pieces.of[k] : 3 * pieces.of[k] + 3]
        square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2]
        out = (n[0] * f[0] + n[1] * f[1] + n[2] * f[2]) / square if square > 0.0 else 0.0
        across = 1.0 / (1.0 + pieces.carried[2 * k])
        beside = 1.0 / (1.0 + pieces.carried[2 * k + 1])
        for i in range(3):
            f[i] = beside * f[i] + (across - beside) * out * n[i]
