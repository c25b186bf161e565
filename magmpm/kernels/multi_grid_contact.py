"""Contact between connected components of a body. Each component has its own mass and momentum on the grid.

Where two components share a node, touch and approach each other, both get the velocity of their common center of mass: no slip, no rebound.
Components that move apart are left alone. The gap between them is read off their masses: for a half-space, the ratio of mass to slope of
mass at a node depends only on the distance of the node from the surface, in cells (`distances`).

Sources: Bardenhagen, Brackbill, Sulsky, CMAME 187 (2000) 529 (contact of velocity fields, normals from slopes of mass); Nairn, Hammerquist,
Smith, CMAME 362 (2020) 112859 (without a measured distance, components would feel each other across a gap).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, kernel, prange

CLOSE = 0.5  # cells: components touch below this gap. Flat faces rest this far apart; round ones and edges come closer (docs/effects.md)
BESIDE = 1.25  # cells: a node may be half as far from the middle of the gap; deep in a thin part the surface can't be located
REACH = 1.5  # cells: how far from its surface nodes feel the mass of a half-space


def filling(distance: Array) -> Array:
    """Share of a node's spline that a half-space fills, 0 to 1; distance (n,) of the nodes from its surface in cells, positive outside."""
    t = np.clip(np.abs(distance), 0.0, REACH)
    outside = np.where(t < 0.5, 0.5 - 0.75 * t + t**3 / 3, (1.5 - t) ** 3 / 6)
    return np.asarray(np.where(distance < 0, 1.0 - outside, outside))


@compiled
def share(mass, rise):
    """q of `distances`, from the mass at a node and its rise over one cell."""
    return (mass / (mass + rise)) ** (1.0 / 3.0)


def distances(points: int = 65) -> Array:
    """Distance (points,), in cells, from a half-space's surface for evenly spaced q from 0 to 1 (`share`).

    q^3 = m / (m + h dm/dn), m the mass at a node and dm/dn its slope by central differences over two cells: q falls evenly with distance.
    """
    t = np.linspace(-REACH, REACH, 3001)[:-1]
    known = np.append(share(filling(t), 0.5 * (filling(t - 1.0) - filling(t + 1.0))), 0.0)
    return np.interp(np.linspace(0.0, 1.0, points), known[::-1], np.append(t, REACH)[::-1])


@compiled
def _slope(momentum, weight, node, strides, h, out):
    """Slope (3,) of a component's mass at a node, kg/m, into out; returns its distance from the surface as q of `distances`."""
    rise = 0.0  # over one cell
    for axis in range(3):
        up, down = node + strides[axis], node - strides[axis]
        out[axis] = (momentum[4 * up] + weight[up] - momentum[4 * down] - weight[down]) / (2.0 * h[axis])
        rise += (out[axis] * h[axis]) ** 2
    mass = momentum[4 * node] + weight[node]
    return share(mass, np.sqrt(rise))


@compiled
def _read(curve, q):
    """Distance in cells for a value of q, by linear interpolation (`distances`)."""
    at = q * (len(curve) - 1)
    k = min(int(at), len(curve) - 2)
    return curve[k] + (at - k) * (curve[k + 1] - curve[k])


@compiled
def _meet(momentum, weight, fixed, one, other, strides, h, curve, slopes):
    """Contact of two components at a node: rows `one` and `other` of the grid. slopes (2, 3): work space."""
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
        approach += (va - vb) * (slopes[1, i] - slopes[0, i])  # the normal points from one to the other: where the other's mass grows
    if not approach > 0.0:
        return
    for i in range(1, 4):
        common = 0.0 if still_a or still_b else (momentum[a + i] + momentum[b + i]) / (momentum[a] + momentum[b])
        momentum[a + i], momentum[b + i] = common * momentum[a], common * momentum[b]


class Contact(NamedTuple):
    """Contact between components. may_meet: whether any two can meet; low, high (3,): box of nodes that two may reach, high excluded.

    weight (components nodes,) kg: mass of held particles, or (0,) with one component; curve: `distances`.
    """

    may_meet: bool
    low: Index
    high: Index
    weight: Array
    curve: Array


@kernel
def meet(momentum, fixed, contact, h, strides, nodes):
    """Contact of all components, each with its own grid of `nodes` nodes, wherever they may meet.

    momentum (4 components nodes,): mass and momentum; fixed (components nodes,): whether held particles keep the node at rest.
    Masses do not change, so planes of nodes can be done in parallel. strides (3,): steps in node number along the axes; h (3,) m.
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
