"""Mass on nodes that is right for affine motion: lumped mass with a correction of low rank.

Lumped mass lies farther out than the body: splines have the second moment h^2 / 4 along each axis, so a body of mass M turns with the
inertia I + M (h_y^2 + h_z^2) / 4 about x: 75 % too much for a cube of two cells, 19 % for four. The consistent mass M_ab = sum of
m_p N_a N_b is right, but its inverse is full. So for some fields A of nodal values the inverse is corrected:

    inverse mass = 1/m + A (C^-1 - L^-1) A',   C = A'M A,   L = A'm A,   m the lumped mass.

This is the inverse of a symmetric, positive mass that equals M on these fields and m beside them: momentum, angular momentum and energy
stay exact, and rigid and affine motion have the inertia of the particles. It adds to 1/m, because m - M has no negative eigenvalue (no
spline is negative). Steps become shorter by it: with hats 0.70, 0.78 and 0.82 of those of lumped mass at 2, 3 and 4 cells (measured).

A component without an axis has the fields 1, x, y, z. A straight body has hats along x, two cells apart, times 1, y, z, so that bending
and torsion have their inertia too. What is held has these on its free nodes. Directions of A without mass are left out.

Fed bodies keep the lumped mass: their guide holds nodes that change in time.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from magmpm.compiled.arrays import Array, Index, Mask, Plain
from magmpm.kernels.mass_correction import FIELDS, KNOTS_APART, Correction
from magmpm.model import Model

NO_MASS = (
    1e-10  # of the largest entry of a matrix: an eigenvalue below it is a direction without mass
)


@dataclass(frozen=True)
class Chain:
    """The fields of one component. hats (planes, knots): their values at its planes, which are numbers start to stop; gain, excess:
    C^-1 - L^-1 and L^-1 (L - C) L^-1; factors: pivot and link of C and L (kernels.mass_correction).
    """

    hats: Array
    start: int
    stop: int
    gain: Array
    excess: Array
    factors: tuple[tuple[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class NodalMass:
    """lumped (nodes,) kg; the correction as kernels take it, and its chains."""

    lumped: Array
    correction: Correction
    chains: tuple[Chain, ...]

    def momentum(self, v: Array) -> Array:
        """Mass times velocity, (nodes, 3) kg m/s, at velocities v (nodes, 3) m/s of nodes that can move."""
        p = self.lumped[:, None] * v
        return np.asarray(p - self.lumped[:, None] * self._through(p, "excess"))

    def accelerated(self, p: Array, inverse: Array) -> Array:
        """Inverse mass times p, (nodes, 3); inverse (nodes, 3) 1/kg: of the lumped mass, 0 where nothing moves."""
        return np.asarray(inverse * p + self._through(p, "gain") * (inverse > 0))

    def _through(self, p: Array, which: str) -> Array:
        """A X A' p for a matrix X of each chain."""
        c = self.correction
        out = np.zeros_like(p)
        if not self.chains:
            return out
        arm = c.arm.reshape(-1, 2)[c.order]
        sizes = np.diff(c.first)
        fields = np.column_stack([np.ones(len(arm)), arm])
        moments = np.add.reduceat(
            fields[:, :, None] * (p[c.order] * c.moving)[:, None, :], c.first[:-1], axis=0
        )
        added = np.empty_like(moments)  # (planes, fields, 3)
        for chain in self.chains:
            load = np.einsum("pk,pfi->kfi", chain.hats, moments[chain.start : chain.stop]).reshape(
                -1, 3
            )
            answer = (getattr(chain, which) @ load).reshape(-1, FIELDS, 3)
            added[chain.start : chain.stop] = np.einsum("pk,kfi->pfi", chain.hats, answer)
        out[c.order] = np.einsum("nf,nfi->ni", fields, np.repeat(added, sizes, axis=0)) * c.moving
        return out


def nodal_mass(
    model: Model,
    weights: Array,
    base: Index,
    strides: tuple[int, int],
    nodes: tuple[Array, Array, Array],
    active: Index,
) -> NodalMass:
    """The mass of a model's nodes. weights (n, 3, 3): values of the particles' splines; base (n,): their first nodes, whose neighbors along
    x and y are `strides` farther; nodes: lumped mass, its inverse (3 nodes,) and places (nodes, 3) m; active: nodes with mass.
    """
    mass = nodes[0]
    inverse = nodes[1].reshape(-1, 3)
    place = nodes[2]
    free: Mask = np.asarray((inverse > 0).any(axis=1) & (model.scene.effects.feed is None))
    component = _components(base, strides, free)
    order = np.lexsort((np.arange(len(mass)), component))
    order = order[free[order]]
    key = np.column_stack([component[order], order // strides[0]])
    first = np.append(
        np.flatnonzero(np.any(np.diff(key, axis=0, prepend=-1) != 0, axis=1)), len(order)
    ).astype(np.int64)
    planes = len(first) - 1
    plane_of = np.full(len(mass), planes)
    plane_of[order] = np.repeat(np.arange(planes), np.diff(first))
    arm = _arms(mass, place[:, 1:], component, free) / model.grid.spacing[1:]
    consistent = _planes_mass(model, weights, base, strides, arm, plane_of, planes)
    fields = np.column_stack([np.ones(len(order)), arm[order]])
    each = mass[order, None, None] * fields[:, :, None] * fields[:, None, :]
    lumped = np.add.reduceat(each, first[:-1]) if planes else each
    x = place[order[first[:-1]], 0] / model.grid.spacing[0]
    starts = np.append(np.flatnonzero(np.diff(key[first[:-1], 0], prepend=-1)), planes)
    slender = model.line is not None
    chains = []
    left = np.zeros(planes, np.int64)
    share = np.zeros(planes)
    knots = [0]
    for start, stop in pairwise(starts.tolist()):
        at = _knots(x[start:stop], slender)
        here = np.clip(np.searchsorted(at, x[start:stop], side="right") - 1, 0, len(at) - 2)
        share[start:stop] = (x[start:stop] - at[here]) / (at[here + 1] - at[here])
        left[start:stop] = knots[-1] + here
        hats = np.zeros((stop - start, len(at)))
        rows = np.arange(stop - start)
        hats[rows, here], hats[rows, here + 1] = 1.0 - share[start:stop], share[start:stop]
        affine = None if slender else at - x[start:stop].mean()
        chains.append(_chain(hats, start, stop, consistent[start:stop], lumped[start:stop], affine))
        knots.append(knots[-1] + len(at))
    return NodalMass(
        mass,
        Correction(
            order=order,
            first=first,
            arm=arm.ravel(),
            plane=plane_of[active],
            left=left,
            share=share,
            moving=np.array([1.0, 0.0 if model.plane_strain else 1.0, 1.0]),
            plane_of=plane_of,
            moment=np.zeros((len(left) + 1, 9)),
            added=np.zeros((len(left) + 1, 9)),
            **_of_chains(chains, knots),
        ),
        tuple(chains),
    )


def _of_chains(chains: list[Chain], knots: list[int]) -> Plain:
    """The arrays of a Correction that hold its chains, by name."""
    factors = (
        [
            np.concatenate([[c.factors[k][m] for k in range(2)] for c in chains], axis=1)
            for m in range(2)
        ]
        if chains
        else []
    )
    empty = np.zeros((2, 0, FIELDS, FIELDS)), np.zeros((2, 0, KNOTS_APART, FIELDS, FIELDS))
    pivot, link = (np.ascontiguousarray(f) for f in factors or empty)
    return {
        "chain": np.array(knots),
        "pivot": pivot,
        "link": link,
        "chain_of": np.repeat(np.arange(len(chains)), np.diff(knots)),
        "gain": np.concatenate([np.zeros(0), *[chain.gain.ravel() for chain in chains]]),
        "gain_at": np.cumsum([0, *[chain.gain.size for chain in chains]]),
        "load": np.zeros((knots[-1], 9)),
        "ahead": np.zeros((knots[-1], 9)),
        "answer": np.zeros((2, knots[-1], 9)),
    }


def _components(base: Index, strides: tuple[int, int], free: Mask) -> Index:
    """Connected component that each free node is in (nodes,): cells connect the free nodes of their particles."""
    from scipy.sparse import coo_matrix, csgraph  # 0.1 s to import

    cells = np.unique(base)
    offset = np.array([a * strides[0] + b * strides[1] + c for a, b, c in np.ndindex(3, 3, 3)])
    near = cells[:, None] + offset
    head = near[
        np.arange(len(near)), free[near].argmax(axis=1)
    ]  # a free node of each cell, if there is one
    on = free[near] & free[head][:, None]
    one = np.broadcast_to(head[:, None], near.shape)[on]
    other = near[on]
    graph = coo_matrix((np.ones(len(one), np.int8), (one, other)), shape=(len(free), len(free)))
    return np.asarray(csgraph.connected_components(graph, directed=False)[1], np.int64)


def _arms(mass: Array, place: Array, component: Index, free: Mask) -> Array:
    """y and z (nodes, 2) m of the free nodes from the center of the masses on them, by component; 0 for others."""
    weight = mass * free
    count = component.max() + 1
    whole = np.bincount(component, weight, count)
    sums = np.column_stack([np.bincount(component, weight * place[:, k], count) for k in range(2)])
    centers = sums / np.where(whole > 0, whole, 1.0)[:, None]
    return np.asarray((place - centers[component]) * free[:, None])


def _planes_mass(
    model: Model,
    weights: Array,
    base: Index,
    strides: tuple[int, int],
    arm: Array,
    plane_of: Index,
    planes: int,
) -> Array:
    """Consistent mass of the fields 1, y, z of planes with the same and the next two: (planes, 3, 3, 3), kg."""
    mass = model.density * model.particles.volume
    found = np.zeros((planes + 1, 3, FIELDS, FIELDS))
    values = np.zeros((3, len(base), FIELDS))
    on = np.full((3, len(base)), planes)
    for a, b, c in np.ndindex(3, 3, 3):
        node = base + a * strides[0] + b * strides[1] + c
        share = weights[:, 0, a] * weights[:, 1, b] * weights[:, 2, c] * (plane_of[node] < planes)
        values[a] += share[:, None] * np.column_stack([np.ones(len(node)), arm[node]])
        on[a] = np.minimum(on[a], plane_of[node])
    for a in range(3):
        for b in range(a, 3):
            for i, j in np.ndindex(FIELDS, FIELDS):
                found[:, b - a, i, j] += np.bincount(
                    on[a], mass * values[a, :, i] * values[b, :, j], planes + 1
                )
    return found[:planes]


def _knots(x: Array, slender: bool) -> Array:
    """x of a chain's knots: of every second plane of nodes, or, where the body is not slender, of the first and the last."""
    spaces = (
        max(1, round((len(x) - 1) / 2)) if slender else 1
    )  # bending and torsion of two cells are then right to 0.5 %
    at = x[np.round(np.linspace(0, len(x) - 1, spaces + 1)).astype(int)]
    return at if len(x) > 1 else at[0] + np.array([0.0, 1.0])


def _chain(
    hats: Array, start: int, stop: int, consistent: Array, lumped: Array, affine: Array | None
) -> Chain:
    """A chain from the masses of its planes (_planes_mass; lumped (planes, 3, 3)). affine: x of two knots of 1, x, y, z alone, or None."""
    count = len(hats)
    k = FIELDS * hats.shape[1]
    whole = np.zeros((count, FIELDS, count, FIELDS))
    for d in range(min(3, count)):
        rows = np.arange(count - d)
        whole[rows, :, rows + d, :] += consistent[: count - d, d]
        if d:
            whole[rows + d, :, rows, :] += consistent[: count - d, d].transpose(0, 2, 1)
    H = np.kron(hats, np.eye(FIELDS))
    C = H.T @ whole.reshape(count * FIELDS, -1) @ H
    L = np.einsum("pk,pij,pl->kilj", hats, lumped, hats).reshape(k, k)
    low = inverted(L)
    if affine is None:
        gain = inverted(C) - low
    else:
        T = np.kron(np.column_stack([np.ones(2), affine]), np.eye(FIELDS))[:, [0, 3, 1, 2]]
        T = L @ low @ T  # what mass lies on
        gain = T @ (inverted(T.T @ C @ T) - inverted(T.T @ L @ T)) @ T.T
        C = inverted(low + gain)
    return Chain(hats, start, stop, gain, low @ (L - C) @ low, (_factors(C), _factors(L)))


def _factors(matrix: Array) -> tuple[Array, Array]:
    """Block factors L D L' of a matrix: inverse pivots D^-1 (knots, 3, 3), and the links L (knots, KNOTS_APART, 3, 3) to the blocks
    before."""
    count = len(matrix) // FIELDS
    block = matrix.reshape(count, FIELDS, count, FIELDS).transpose(0, 2, 1, 3)
    own, pivot, link = (
        *np.zeros((2, count, FIELDS, FIELDS)),
        np.zeros((count, KNOTS_APART, FIELDS, FIELDS)),
    )
    for k in range(count):
        for d in range(min(KNOTS_APART, k), 0, -1):
            left = block[k, k - d].copy()
            for e in range(d + 1, min(KNOTS_APART, k) + 1):
                left -= link[k, e - 1] @ own[k - e] @ link[k - d, e - d - 1].T
            link[k, d - 1] = left @ pivot[k - d]
        own[k] = block[k, k] - sum(
            link[k, d] @ own[k - 1 - d] @ link[k, d].T for d in range(min(KNOTS_APART, k))
        )
        values, vectors = np.linalg.eigh((own[k] + own[k].T) / 2)
        inverse = np.where(
            values > NO_MASS * np.abs(block[k, k]).max(),
            1.0 / np.where(values > 0, values, 1.0),
            0.0,
        )
        pivot[k] = vectors * inverse @ vectors.T
    return pivot, link


def inverted(matrix: Array) -> Array:
    """Inverse of a symmetric, positive matrix on the directions that have mass."""
    return np.asarray(np.linalg.pinv(matrix, rcond=NO_MASS, hermitian=True))
