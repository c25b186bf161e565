"""magnetic_interaction: the magnetized segments turn and pull each other.

A segment is divided into blocks that are as close to cubes as its shape allows. A block acts as a dipole with the moment
m = sum V F Br/mu0 of its particles, at their mean position x. Dipoles of different segments act on each other, with the energy
E = -1/2 sum m_a . B_b(x_a); for blocks that touch it is 15 % smaller, as for cubes. The particles of block a get the stress
P = -(1/mu0) B_a (x) Br, with B_a the field of all other segments' dipoles at x_a, and the force grad(m_a . B_a), spread evenly over the
block's volume. These are the exact derivatives of E: the forces of each pair cancel, and so do their torques together with those on the
moments. The field of a segment in itself (its demagnetizing field) is left out.

B_a and the forces are kept in `data` and computed again (`refresh`) for the deformed body: in statics at every step
(statics.interacting); in motion as often as they change by a fiftieth, for the middle of that time (dynamics.time_loop). In between they
act as a load of fixed direction, whose energy is `energy`; `shared_energy` is E itself.
Sources: dipole fields, Jackson, Classical Electrodynamics, 3rd ed., section 5.6; a cube has no quadrupole moment.
"""

from typing import Any

import numpy as np
from pydantic import Field

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, inlined, inner, task_body
from magmpm.compiled.parallel import over_parts, task
from magmpm.effects.base import (
    BodyChange,
    BodyEffect,
    MarkedParticles,
    Records,
    SceneLike,
    one_record,
)
from magmpm.effects.hooks import register
from magmpm.errors import SceneError
from magmpm.fields.dipole import MU0, K

MOST_BLOCKS = 3000  # blocks: a refresh then takes about 0.2 s
# Two cubes face to face interact less than two dipoles, by this fraction: (1/2 - 3/2 N) / (1/(2 pi)) = 0.849, with N = 0.1983 the
# demagnetizing factor of a 2 x 1 x 1 prism along its length (Aharoni, J. Appl. Phys. 83 (1998) 3432).
TOUCHING_PRISM = 0.151
DIPOLES_FROM = 1.35  # distance in edges from which on cubes interact as dipoles
LEAST_DISTANCE = 1e-100  # m: of two blocks at one place the terms are 0, not nan
LOAD_SIZE = 6  # floats per block: B/mu0 (3) A/m, force per volume (3) N/m^3
DTYPE = np.dtype([("share", np.float64), ("blocks", np.int8)])


class MagneticInteraction(BodyEffect):
    """The magnetized segments turn and pull each other.

    Parameters
    ----------
    blocks_across : int, optional
        Number of dipoles across a segment's thickness (and as densely along it); 3
        unless given.

    Examples
    --------
    >>> from magmpm import MagneticInteraction
    >>> MagneticInteraction(blocks_across=4).blocks_across
    4
    """

    PHASE = "force"
    REFRESHED = DTYPE
    blocks_across: int = Field(
        default=3,
        strict=True,
        ge=1,
        le=5,
        description=(
            "Number of dipoles across a segment's thickness (and as densely along it); 3 unless "
            "given."
        ),
        examples=[3],
    )

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels; fields and forces are zero until `refresh`."""
        if strength == 0.0 or len(scene.magnetized_regions()) < 2:
            return ()
        return one_record(DTYPE, np.zeros(LOAD_SIZE * MOST_BLOCKS), share=strength)

    def marks(self, particles: Any, remanence: Array) -> Array:
        """Block of each particle (n,), -1 for none. Raises SceneError where there are more than MOST_BLOCKS blocks."""
        segment = particles.segment
        volume = particles.volume
        cell = particles.cell if particles.box is None else particles.box
        block = np.full(len(volume), -1.0)
        count = 0
        for k in np.unique(segment[remanence.any(axis=1)]):
            own = np.flatnonzero(segment == k)
            layers = [_layers(cell[own, axis], volume[own]) for axis in range(3)]
            wide = min(int(layer.max()) + 1 for layer in layers)
            each = max(1, wide // self.blocks_across)  # cells along a block's edge
            place = []
            for layer in layers:
                cells = int(layer.max()) + 1
                pieces = max(1, round(cells / each))
                if (
                    cells % 2 and pieces % 2 == 0
                ):  # an even number of blocks in an odd number of layers is not its own mirror image
                    pieces += 1
                place.append((2 * layer + 1) * pieces // (2 * cells))  # by the middle of the layer
            _, number = np.unique(np.stack(place, axis=1), axis=0, return_inverse=True)
            block[own] = count + number.ravel()
            count += int(number.max()) + 1
        if count > MOST_BLOCKS:
            raise SceneError(
                "effects.magnetic_interaction.blocks_across",
                received=str(self.blocks_across),
                found=f"the segments make {count} blocks",
                rule=f"at most {MOST_BLOCKS} blocks are allowed",
                remedy="write a smaller blocks_across, or use fewer cells_across",
            )
        return block

    @staticmethod
    def refresh(data: Array, particles: MarkedParticles, x: Array, F: Array) -> float:
        """Fields and forces of the deformed body into data, in place. Returns E, J."""
        field, force, moments, sizes = _act_on(particles, x, F)
        rows = data[: LOAD_SIZE * len(sizes)].reshape(-1, LOAD_SIZE)
        rows[:, :3] = field / MU0
        rows[:, 3:] = force / sizes[:, None]
        return -0.5 * float(np.sum(moments * field))

    @staticmethod
    def coordinates(particles: MarkedParticles, x: Array, F: Array) -> Array:
        """mu0 times the moment, T m^3, and volume times the place, m^4, of each block."""
        places, moments, sizes, _ = dipoles(particles, x, F)
        return np.concatenate([MU0 * moments, sizes[:, None] * places], axis=1).ravel()

    @staticmethod
    def refresh_change(
        change: Array, particles: MarkedParticles, x: Array, F: Array, by: BodyChange
    ) -> None:
        """Change of fields and forces with remanence, place and deformation, into change."""
        places, moments, sizes, of = dipoles(particles, x, F)
        moved, bent, _, _ = dipoles(particles, by.x, by.F)
        turned = dipoles(particles._replace(remanence=by.remanence), x, F)[1]
        field = np.zeros_like(places)
        force = np.zeros_like(places)
        _act_change(places, moments, np.cbrt(sizes), of, moved, bent + turned, field, force)
        rows = change[: LOAD_SIZE * len(sizes)].reshape(-1, LOAD_SIZE)
        rows[:, :3], rows[:, 3:] = field / MU0, force / sizes[:, None]

    @staticmethod
    def shared_energy(particles: MarkedParticles, x: Array, F: Array) -> float:
        """E = -1/2 sum m . B, J."""
        field, _, moments, _ = _act_on(particles, x, F)
        return -0.5 * float(np.sum(moments * field))


def _layers(cell: Index, volume: Array) -> Index:
    """Layer of cells (from 0) of each particle; a first or last layer less than half full is joined to the next one.

    Blocks consist of whole cells: particles are at the Gauss points of a cell, and only their mean is the center of the cell's material.
    """
    layer = cell - cell.min()
    sizes = np.bincount(layer, volume)
    if len(sizes) > 2:
        usual = np.median(sizes)
        if sizes[-1] < 0.5 * usual:
            layer = np.minimum(layer, len(sizes) - 2)
        if sizes[0] < 0.5 * usual:
            layer = np.maximum(layer, 1) - 1
    return np.asarray(layer)


def _act_on(particles: MarkedParticles, x: Array, F: Array) -> tuple[Array, Array, Array, Array]:
    """Field (k, 3) T, force (k, 3) N, moment (k, 3) A m^2 and volume (k,) m^3 of the blocks; arguments as of `Effect.refresh`."""
    places, moments, sizes, of = dipoles(particles, x, F)
    field = np.zeros_like(places)
    force = np.zeros_like(places)
    _act(places, moments, np.cbrt(sizes), of, field, force)
    return field, force, moments, sizes


def dipoles(particles: MarkedParticles, x: Array, F: Array) -> tuple[Array, Array, Array, Index]:
    """Places (k, 3) m, moments (k, 3) A m^2, volumes (k,) m^3 and segment (k,) of the blocks."""
    block, segment, volume, remanence = particles
    count = int(block.max()) + 1
    sizes = np.zeros(count)
    of = np.zeros(count, np.int64)
    places = np.zeros((count, 3))
    moments = np.zeros((count, 3))
    whole = np.ascontiguousarray
    _gather(
        whole(block),
        whole(segment),
        volume,
        whole(remanence),
        whole(x),
        whole(F),
        sizes,
        of,
        places,
        moments,
    )
    return places, moments, sizes, of


@compiled
def _gather(block, segment, volume, remanence, x, F, sizes, of, places, moments):
    """Add up the blocks' volumes (k,), places and moments (k, 3), and write the segment (k,) of each."""
    for p in range(len(block)):
        if block[p] < 0.0:
            continue
        k = int(block[p])
        of[k] = segment[p]
        sizes[k] += volume[p]
        for i in range(3):
            places[k, i] += volume[p] * x[p, i]
            magnetization = (
                F[p, i, 0] * remanence[p, 0]
                + F[p, i, 1] * remanence[p, 1]
                + F[p, i, 2] * remanence[p, 2]
            )
            moments[k, i] += volume[p] / MU0 * magnetization
    for k in range(len(sizes)):
        for i in range(3):
            places[k, i] /= sizes[k]


@inlined
def _radial(r, d):
    """h(r) and h' / r: h = K g(r) / r^5, of blocks whose edges have the mean d, at the distance r, m."""
    q = r / d
    if q >= DIPOLES_FROM:
        h = K / r**5
        return h, -5.0 * h / r**2
    if q >= 1.0:  # g = 1 - TOUCHING_PRISM smoothstep(t)
        t = (DIPOLES_FROM - q) / (DIPOLES_FROM - 1.0)
        bare = K / r**5
        h = bare * (1.0 - TOUCHING_PRISM * t * t * (3.0 - 2.0 * t))
        slope = bare * TOUCHING_PRISM * 6.0 * t * (1.0 - t) / ((DIPOLES_FROM - 1.0) * d)
        return h, (slope - 5.0 * h / r) / r
    most = (1.0 - TOUCHING_PRISM) * K / d**5  # K / r^5 to second order about r = d
    return most * (21.0 - 35.0 * q + 15.0 * q * q), most * (30.0 * q - 35.0) / (d * r)


@inlined
def _radial_change(r, d):
    """Slopes of h and of h' / r (_radial), by r."""
    q = r / d
    if q >= DIPOLES_FROM:
        h = K / r**5
        return -5.0 * h / r, 35.0 * h / r**3
    if q >= 1.0:
        t = (DIPOLES_FROM - q) / (DIPOLES_FROM - 1.0)
        steep = 1.0 / ((DIPOLES_FROM - 1.0) * d)
        bare = K / r**5
        g = 1.0 - TOUCHING_PRISM * t * t * (3.0 - 2.0 * t)
        slope = TOUCHING_PRISM * 6.0 * t * (1.0 - t) * steep
        curve = -TOUCHING_PRISM * 6.0 * (1.0 - 2.0 * t) * steep * steep
        dh = bare * (slope - 5.0 * g / r)
        ddh = bare * (curve - 10.0 * slope / r + 30.0 * g / (r * r))
        return dh, (ddh - dh / r) / r
    most = (1.0 - TOUCHING_PRISM) * K / d**5
    return most * (30.0 * q - 35.0) / d, most * 35.0 / (d * r * r)


@task_body
def _act_on_one(a, given):
    """`_act` on one dipole."""
    places, moments, edges, of, field, force = given
    m0 = moments[a, 0]
    m1 = moments[a, 1]
    m2 = moments[a, 2]
    b0 = 0.0
    b1 = 0.0
    b2 = 0.0
    f0 = 0.0
    f1 = 0.0
    f2 = 0.0
    for b in range(len(places)):
        if of[b] == of[a]:
            continue
        x = places[a, 0] - places[b, 0]
        y = places[a, 1] - places[b, 1]
        z = places[a, 2] - places[b, 2]
        n0 = moments[b, 0]
        n1 = moments[b, 1]
        n2 = moments[b, 2]
        r2 = x * x + y * y + z * z
        h, steep = _radial(np.sqrt(r2) + LEAST_DISTANCE, 0.5 * (edges[a] + edges[b]))
        nd = n0 * x + n1 * y + n2 * z
        md = m0 * x + m1 * y + m2 * z
        mn = m0 * n0 + m1 * n1 + m2 * n2
        b0 += h * (3.0 * nd * x - n0 * r2)
        b1 += h * (3.0 * nd * y - n1 * r2)
        b2 += h * (3.0 * nd * z - n2 * r2)
        along = steep * (3.0 * md * nd - mn * r2) - 2.0 * h * mn
        f0 += 3.0 * h * (md * n0 + nd * m0) + along * x
        f1 += 3.0 * h * (md * n1 + nd * m1) + along * y
        f2 += 3.0 * h * (md * n2 + nd * m2) + along * z
    field[a, 0], field[a, 1], field[a, 2] = b0, b1, b2
    force[a, 0], force[a, 1], force[a, 2] = f0, f1, f2


@compiled
def _act(places, moments, edges, of, field, force):
    """Field (k, 3) T of the other segments' dipoles at each dipole, and the force (k, 3) N on it. edges (k,) m: of cubes as large.

    E_ab = -h(r) (3 (m . x) (n . x) - (m . n) r^2), with x from b to a; the derivatives include that of h.
    """
    over_parts(len(places), task(_act_on_one, (places, moments, edges, of, field, force)))


@task_body
def _act_change_of_one(a, given):
    """`_act_change` of one dipole."""
    places, moments, edges, of, dplaces, dmoments, dfield, dforce = given
    for b in range(len(places)):
        if of[b] == of[a]:
            continue
        r2 = 0.0
        dr2 = 0.0
        nd = 0.0
        dnd = 0.0
        md = 0.0
        dmd = 0.0
        mn = 0.0
        dmn = 0.0
        for i in range(3):
            x = places[a, i] - places[b, i]
            dx = dplaces[a, i] - dplaces[b, i]
            m = moments[a, i]
            dm = dmoments[a, i]
            n = moments[b, i]
            dn = dmoments[b, i]
            r2 = r2 + x * x
            dr2 = dr2 + 2.0 * x * dx
            nd = nd + n * x
            dnd = dnd + dn * x + n * dx
            md = md + m * x
            dmd = dmd + dm * x + m * dx
            mn = mn + m * n
            dmn = dmn + dm * n + m * dn
        r = np.sqrt(r2) + LEAST_DISTANCE
        d = 0.5 * (edges[a] + edges[b])
        h, steep = _radial(r, d)
        slope, bend = _radial_change(r, d)
        dr = dr2 / (2.0 * r)
        dh = slope * dr
        dsteep = bend * dr
        both = 3.0 * md * nd - mn * r2
        dboth = 3.0 * (dmd * nd + md * dnd) - dmn * r2 - mn * dr2
        along = steep * both - 2.0 * h * mn
        dalong = dsteep * both + steep * dboth - 2.0 * (dh * mn + h * dmn)
        for i in range(3):
            x = places[a, i] - places[b, i]
            dx = dplaces[a, i] - dplaces[b, i]
            m = moments[a, i]
            dm = dmoments[a, i]
            n = moments[b, i]
            dn = dmoments[b, i]
            dfield[a, i] += dh * (3.0 * nd * x - n * r2) + h * (
                3.0 * (dnd * x + nd * dx) - dn * r2 - n * dr2
            )
            turned = dh * (md * n + nd * m) + h * (dmd * n + md * dn + dnd * m + nd * dm)
            dforce[a, i] += 3.0 * turned + dalong * x + along * dx


@compiled
def _act_change(places, moments, edges, of, dplaces, dmoments, dfield, dforce):
    """Directional derivative of `_act`, by the chain rule line by line: dfield (k, 3) T and dforce (k, 3) N of a change of the dipoles'
    places dplaces (k, 3) m and moments dmoments (k, 3) A m^2.
    """
    over_parts(
        len(places),
        task(_act_change_of_one, (places, moments, edges, of, dplaces, dmoments, dfield, dforce)),
    )


@inner
def _row(data, magnet):
    """Index in data of the first number of a particle's block; -1 for none."""
    if len(magnet) < 4 or magnet[3] < 0.0:
        return -1
    return LOAD_SIZE * int(magnet[3])


@compiled
def energy(effect, data, magnet, rho, x, F):
    """-(1/mu0) B . (F Br) - f . x, J/m^3: of the load at its present values."""
    at = _row(data, magnet)
    if at < 0:
        return 0.0
    total = 0.0
    for i in range(3):
        total -= data[at + i] * (F[i, 0] * magnet[0] + F[i, 1] * magnet[1] + F[i, 2] * magnet[2])
        total -= data[at + 3 + i] * x[i]
    return effect.share * total


@compiled
def stress(effect, data, magnet, rho, x, F, P):
    """P -= (1/mu0) B (x) Br, Pa."""
    at = _row(data, magnet)
    if at < 0:
        return
    for i in range(3):
        for j in range(3):
            P[i, j] -= effect.share * data[at + i] * magnet[j]


@compiled
def force(effect, data, magnet, rho, x, F, f):
    """f += the block's force over its volume, N/m^3."""
    at = _row(data, magnet)
    if at < 0:
        return
    for i in range(3):
        f[i] += effect.share * data[at + 3 + i]


register(DTYPE, energy=energy, stress=stress, force=force)
