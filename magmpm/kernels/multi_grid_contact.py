"""Connected components of a body that meet on a grid where each has its own mass and momentum: what approaches and touches moves as one.

At a node that two components share, their velocities are made those of their common centre of mass where they approach each other (no slip,
no rebound) and touch; what moves apart is left alone. How far apart they are there is read off their masses: of a half-space, the ratio of
mass to slope of mass at a node depends on nothing but the node's distance from the surface, in cells (`distances`).

Sources: Bardenhagen, Brackbill, Sulsky, CMAME 187 (2000) 529 (contact of velocity fields, normals from slopes of mass); Nairn, Hammerquist,
Smith, CMAME 362 (2020) 112859 (why components would feel each other at a distance unless it is measured).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, kernel, prange

CLOSE = 0.5  # cells: nearer than this touches. Flat faces rest so far apart; what is round or has edges is felt later (docs/effects.md)
BESIDE = 1.25  # cells: twice as far from the middle of the gap a node may be; deep in a thin part its surface can't be told
REACH = 1.5  # cells: mass of a half-space is felt as far from its surface


def filling(distance: Array) -> Array:
    """What a half-space fills of nodes' splines, at distances (n,) from its surface in cells, positive outside: 0 to 1."""
    t = np.clip(np.abs(distance), 0.0, REACH)
    outside = np.where(t < 0.5, 0.5 - 0.75 * t + t**3 / 3, (1.5 - t) ** 3 / 6)
    return np.asarray(np.where(distance < 0, 1.0 - outside, outside))


@compiled
def share(mass, rise):
    """q of `distances`: mass at a node, rise of mass in a cell."""
    return (mass / (mass + rise)) ** (1.0 / 3.0)


def distances(points: int = 65) -> Array:
    """Distance (points,), in cells, from a half-space's surface at evenly spaced q from 0 to 1 (`share`).

    q^3 = m / (m + h dm/dn), m the mass at a node and dm/dn its slope by central differences over two cells: q falls evenly with distance.
    """
    t = np.linspace(-REACH, REACH, 3001)[:-1]
    known = np.append(share(filling(t), 0.5 * (filling(t - 1.0) - filling(t + 1.0))), 0.0)
    return np.interp(np.linspace(0.0, 1.0, points), known[::-1], np.append(t, REACH)[::-1])


@compiled
def _slope(momentum, weight, node, strides, h, out):
    """Slope (3,) of a component's mass at a node, kg/m, into out; returns the node's distance from its surface as q of `distances`."""
    rise = 0.0  # a cell
    for axis in range(3):
        up, down = node + strides[axis], node - strides[axis]
        out[axis] = (momentum[4 * up] + weight[up] - momentum[4 * down] - weight[down]) / (2.0 * h[axis])
        rise += (out[axis] * h[axis]) ** 2
    mass = momentum[4 * node] + weight[node]
    return share(mass, np.sqrt(rise))


@compiled
def _read(curve, q):
    """The distance, in cells, at q of `distances`."""
    at = q * (len(curve) - 1)
    k = min(int(at), len(curve) - 2)
    return curve[k] + (at - k) * (curve[k + 1] - curve[k])


@compiled
def _meet(momentum, weight, fixed, one, other, strides, h, curve, slopes):
    """Two components at a node: rows `one` and `other` of the grid. slopes (2, 3): room to work in."""
    a, b = 4 * one, 4 * other
    still_a, still_b = fixed[one] != 0, fixed[other] != 0
    if (still_a and still_b) or not (still_a or momentum[a] > 0.0) or not (still_b or momentum[b] > 0.0):
        return
    from_one = _read(curve, _slope(momentum, weight, one, strides, h, slopes[0]))
    from_other = _read(curve, _slope(momentum, weight, other, strides, h, slopes[1]))
    if from_one + from_other > CLOSE or abs(from_one - from_other) > BESIDE:
        return
    approach = 0.0
    for i in range(3):
        va = 0.0 if still_a else momentum[a + 1 + i] / momentum[a]
        vb = 0.0 if still_b else momentum[b + 1 + i] / momentum[b]
        approach += (va - vb) * (slopes[1, i] - slopes[0, i])  # from one to the other: where the other's mass grows
    if not approach > 0.0:
        return
    for i in range(1, 4):
        common = 0.0 if still_a or still_b else (momentum[a + i] + momentum[b + i]) / (momentum[a] + momentum[b])
        momentum[a + i], momentum[b + i] = common * momentum[a], common * momentum[b]


class Contact(NamedTuple):
    """What components need to meet. may_meet: whether any two can; low, high (3,): the box of nodes that two may reach, exclusive.

    weight (components nodes,) kg: mass of what is held, or (0,) with one component; curve: `distances`.
    """

    may_meet: bool
    low: Index
    high: Index
    weight: Array
    curve: Array


@kernel
def meet(momentum, fixed, contact, h, strides, nodes):
    """All components, each with a grid of a box of `nodes`, at the nodes where they may meet.

    momentum (4 components nodes,): mass and momentum; fixed (components nodes,): whether what is held there keeps the node at rest.
    Masses are not changed, so planes of nodes may be done at the same time. strides (3,): from node to node along the axes; h (3,) m.
    """
    low, high, weight, curve = contact.low, contact.high, contact.weight, contact.curve
    every = len(fixed)
    for plane in prange(low[0], high[0]):
        slopes = np.empty((2, 3))
        for line in range(low[1], high[1]):
            begin = plane * strides[0] + line * strides[1]
            for node in range(begin + low[2], begin + high[2]):
                for one in range(node, every, nodes):
                    if momentum[4 * one] + weight[one] > 0.0:
                        for other in range(one + nodes, every, nodes):
                            if momentum[4 * other] + weight[other] > 0.0:
                                _meet(momentum, weight, fixed, one, other, strides, h, curve, slopes)
