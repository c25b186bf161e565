"""self_contact: the body's parts and folds touch each other and separate again.

It is a property of the updated formulation. STL parts that do not touch in the undeformed body have a grid each, and act on each other
when they come nearer than half a cell (kernels.multi_grid_contact): they stick (no slip) while they are pressed together, and separate
freely. Folds of one component share grid nodes, and so velocities: they cannot pass through each other, act on each other from a distance
of one to two cells, stick, and separate over some hundred steps (dynamics.drift_correction). Naming self_contact selects that formulation;
it has no hooks and no settings, and no further cost.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.effects.base import Advice, Contact, Effect, Records, RestEstimate, SceneLike, Touching
from magmpm.effects.contact_law import Friction, Stiffness, law, stable_step
from magmpm.effects.estimates import MEASURE, no_rest

WITHIN = 1.5  # cells: a larger gap is reported as this


class SelfContact(Effect):
    """The body's parts and folds touch each other and separate again. No settings: it switches to the updated formulation."""

    PHASE = "contact"
    ONLY_IN_MOTION = True
    friction: Friction = 0.0
    stiffness: Stiffness = 1.0

    def records(self, scene: SceneLike, strength: float = 1.0, times: Array | None = None) -> Records:
        """Nothing for the kernels: the formulation does it."""
        return ()

    def stable_step(self, model: Any) -> float:
        """Largest stable step, s."""
        found = law(model.scene, self.stiffness, self.friction)
        return stable_step(2 * found["stiffness"], 2 * found.get("damping", 0.0))

    def report(self, model: Any, x: Array, touching: Touching, dt: float) -> Contact | None:
        """Nothing: its pairs report (dynamics.body_contact)."""
        return None

    @classmethod
    def advice(cls, scene: SceneLike, body: RestEstimate) -> Advice:
        """Estimate whether the body would overlap itself in equilibrium if nothing prevented it."""
        if (why := no_rest(scene)) is not None:
            return Advice(None, f"not estimated: {why}; {MEASURE}; needs the updated formulation")
        points = body.rest(scene)
        s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        along = np.column_stack([s, 0 * s, 0 * s])
        apart = 4 * math.pi * body.half  # a loop whose sides touch is longer
        room = gap(points, along, size=2 * body.half, apart=apart, within=max(apart, 4 * body.half))
        if room > 0:
            clear = f"at rest the body is {'nowhere near' if math.isinf(room) else f'{1e3 * room:.3g} mm from'} itself"
            if scene.solver.dynamic is None:
                return Advice(0.0, f"{clear}; needs the updated formulation")
            return Advice(None, f"{clear}, how near on its way is not estimated: {MEASURE}; needs the updated formulation")
        return Advice(-room, f"at rest the body would be {-1e3 * room:.3g} mm through itself; needs the updated formulation")


def gap(position: Array, reference: Array, size: float, apart: float, within: float) -> float:
    """Smallest gap (m) between surfaces of the body that are not neighbors in it; negative: they overlap; inf: none is near.

    position, reference (n, 3) m: particles now and in the undeformed body; size m: distance between the outermost particles of two surfaces
    in contact; apart m: particles nearer than that in the undeformed body are neighbors (a few cells more than the body's thickness);
    within m: search distance, at most `apart`.
    """
    from scipy.spatial import cKDTree  # imported only where it is used

    pairs = cKDTree(position).query_pairs(within, output_type="ndarray")
    rest = np.linalg.norm(reference[pairs[:, 0]] - reference[pairs[:, 1]], axis=1)
    pairs = pairs[rest > apart]
    if not len(pairs):
        return float("inf")
    now = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    return float(now.min()) - size


def observe(model: Any, x: Array) -> Contact:
    """The gap of a model's body with its particles at x (n, 3) m, as a contact: depth is minus the gap (m), at least -WITHIN cells; count
    is the number of pairs of particles nearer than a cell; the force on the whole body is zero. For STL parts the distance of particles
    from the undeformed surface is taken into account.

    Two particles are not neighbors if they belong to components that do not touch in the undeformed body; in one part, if they were
    farther from each other than twice its thickness and 3 cells; in different parts of a component, if their distance was 3 cells.
    """
    scene, rest = model.scene, model.particles.position
    shape, cell = scene.body.shape, scene.cell
    within = WITHIN * cell + max(2 * shape.depth(scene.resolution.cells_across, scene.resolution.particles_per_cell), cell)
    component, part = shape.components(model.particles), shape.part_of(model.particles)
    a, b = _near(x, rest, model.particles.cell, component, part, within=within, apart=3 * cell, in_part=3 * cell + 2 * scene.thickness)
    now = np.linalg.norm(x[a] - x[b], axis=1)
    near, of = np.unique(np.concatenate([a, b]), return_inverse=True)
    depths = shape.depths(model.particles, near, scene.resolution.cells_across, scene.resolution.particles_per_cell)
    size = depths[of].reshape(2, -1).sum(axis=0)
    depth = -float((now - size).min(initial=WITHIN * cell))
    return Contact(force=np.zeros(3), count=int(np.count_nonzero(now < cell)), depth=depth)


def _near(
    x: Array, rest: Array, cell: NDArray[np.integer], component: NDArray[np.int64], part: NDArray[np.integer], *, within: float,
    apart: float, in_part: float,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
    """Pairs of particles within a distance (m) that are not neighbors: they are of two components, or were farther than `apart` (m) from
    each other in the undeformed body, or than `in_part` (m) in the same part.

    x, rest (n, 3) m: now and undeformed; cell (n, 3), component, part (n,): of each. A body has a hundred times as many pairs of neighbors
    as of others, so pairs of cells that hold only neighbors are dropped before pairs of particles are formed.
    """
    from scipy.spatial import cKDTree  # imported only where it is used

    cluster = _numbered(cell, part)
    order, count = np.argsort(cluster, kind="stable"), np.bincount(cluster)
    first = np.cumsum(count) - count
    now, then = _balls(x[order], first, count), _balls(rest[order], first, count)
    a, b = cKDTree(now[0]).query_pairs(within + 2 * now[1], output_type="ndarray").T
    one = order[first]  # a particle of each cluster, for its part and component
    kept = _apart(then[0][a] - then[0][b], one[a], one[b], component, part, apart - 2 * then[1], in_part - 2 * then[1])
    a, b = a[kept], b[kept]
    # every particle of one with every particle of the other
    many = count[a] * count[b]
    which = np.repeat(np.arange(len(a)), many)
    of_pair = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
    i = order[first[a][which] + of_pair // count[b][which]]
    j = order[first[b][which] + of_pair % count[b][which]]
    near = (x[i, 0] - x[j, 0]) ** 2 + (x[i, 1] - x[j, 1]) ** 2 + (x[i, 2] - x[j, 2]) ** 2 <= within**2
    i, j = i[near], j[near]
    kept = _apart(rest[i] - rest[j], i, j, component, part, apart, in_part)
    return i[kept], j[kept]


def _apart(
    between: Array, a: NDArray[np.int64], b: NDArray[np.int64], component: NDArray[np.int64], part: NDArray[np.integer], apart: float,
    in_part: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """Which particles a and b (k,), `between` (k, 3) m from each other undeformed, are not neighbors."""
    far = np.where(part[a] == part[b], in_part, apart)
    return np.asarray((np.linalg.norm(between, axis=1) > far) | (component[a] != component[b]))


def _numbered(cell: NDArray[np.integer], part: NDArray[np.integer]) -> NDArray[np.int64]:
    """Which cell of which part each particle (n,) is in, numbered from 0."""
    shape = (*(np.ptp(cell, axis=0) + 1).tolist(), int(part.max()) + 1)
    key = np.ravel_multi_index((*(cell - cell.min(axis=0)).T, part), shape)
    return np.asarray(np.unique(key, return_inverse=True)[1].reshape(-1), dtype=np.int64)


def _balls(x: Array, first: NDArray[np.int64], count: NDArray[np.int64]) -> tuple[Array, float]:
    """Centers (k, 3) of clusters, and the radius around them that holds every particle, m; x (n, 3) m in the order of the clusters."""
    center = np.add.reduceat(x, first, axis=0) / count[:, None]
    return center, float(np.sqrt(((x - np.repeat(center, count, axis=0)) ** 2).sum(axis=1).max()))
