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
from numpy.typing import NDArray
from pydantic import Field

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, kernel, prange
from magmpm.effects.base import BodyChange, BodyEffect, MarkedParticles, Records, SceneLike, one_record
from magmpm.effects.hooks import register
from magmpm.errors import SceneError
from magmpm.fields.dipole import MU0, K

MOST = 3000  # blocks: a refresh then takes about 0.2 s
# Two cubes face to face interact less than two dipoles, by this fraction: (1/2 - 3/2 N) / (1/(2 pi)) = 0.849, with N = 0.1983 the
# demagnetizing factor of a 2 x 1 x 1 prism along its length (Aharoni, J. Appl. Phys. 83 (1998) 3432).
TOUCHING = 0.151
NEAR = 1.35  # distance in edges from which on cubes interact as dipoles
SIZE = 6  # floats per block: B/mu0 (3) A/m, force per volume (3) N/m^3
DTYPE = np.dtype([("share", np.float64), ("blocks", np.int8)])


class MagneticInteraction(BodyEffect):
    """The magnetized segments turn and pull each other."""

    PHASE = "force"
    REFRESHED = DTYPE
    blocks_across: int = Field(
        default=3, strict=True, ge=1, le=5,
        description="Dipoles that stand for a segment, across its thickness (and as densely along it); 3 unless given.", examples=[3],
    )  # fmt: skip

    def records(self, scene: SceneLike, strength: float = 1.0, times: Array | None = None) -> Records:
        """Parameters for the kernels; fields and forces are zero until `refresh`."""
        if strength == 0.0 or len(scene.magnetized_regions()) < 2:
            return ()
        return one_record(DTYPE, np.zeros(SIZE * MOST), share=strength)

    def marks(self, particles: Any, remanence: Array) -> Array:
        """Block of each particle (n,), -1 for none. Raises SceneError where there are more than MOST blocks."""
        segment, volume = particles.segment, particles.volume
        cell = particles.cell if particles.box is None else particles.box
        block, count = np.full(len(volume), -1.0), 0
        for k in np.unique(segment[remanence.any(axis=1)]):
            own = np.flatnonzero(segment == k)
            layers = [_layers(cell[own, axis], volume[own]) for axis in range(3)]
            wide = min(int(layer.max()) + 1 for layer in layers)
            each = max(1, wide // self.blocks_across)  # cells along a block's edge
            place = []
            for layer in layers:
                cells = int(layer.max()) + 1
                pieces = max(1, round(cells / each))
                if cells % 2 and pieces % 2 == 0:  # an even number of blocks in an odd number of layers is not its own mirror image
                    pieces += 1
                place.append((2 * layer + 1) * pieces // (2 * cells))  # by the middle of the layer
            _, number = np.unique(np.stack(place, axis=1), axis=0, return_inverse=True)
            block[own] = count + number.ravel()
            count += int(number.max()) + 1
        if count > MOST:
            raise SceneError(
                "effects.magnetic_interaction.blocks_across", received=str(self.blocks_across), found=f"the segments make {count} blocks",
                rule=f"there may be {MOST} blocks at most", remedy="write a smaller blocks_across, or use fewer cells_across",
            )  # fmt: skip
        return block

    @staticmethod
    def refresh(data: Array, particles: MarkedParticles, x: Array, F: Array) -> None:
        """Fields and forces of the deformed body into data, in place."""
        field, force, _, sizes = _act_on(particles, x, F)
        rows = data[: SIZE * len(sizes)].reshape(-1, SIZE)
        rows[:, :3], rows[:, 3:] = field / MU0, force / sizes[:, None]

    @staticmethod
    def refresh_change(change: Array, particles: MarkedParticles, x: Array, F: Array, by: BodyChange) -> None:
        """Change of fields and forces with remanence, place and deformation, into change."""
        places, moments, sizes, of = dipoles(particles, x, F)
        moved, bent, _, _ = dipoles(particles, by.x, by.F)
        turned = dipoles(particles._replace(remanence=by.remanence), x, F)[1]
        field, force = np.zeros_like(places), np.zeros_like(places)
        _act_change(places, moments, np.cbrt(sizes), of, moved, bent + turned, field, force)
        rows = change[: SIZE * len(sizes)].reshape(-1, SIZE)
        rows[:, :3], rows[:, 3:] = field / MU0, force / sizes[:, None]

    @staticmethod
    def shared_energy(particles: MarkedParticles, x: Array, F: Array) -> float:
        """E = -1/2 sum m . B, J."""
        field, _, moments, _ = _act_on(particles, x, F)
        return -0.5 * float(np.sum(moments * field))


def _layers(cell: NDArray[np.int64], volume: Array) -> NDArray[np.int64]:
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
    field, force = np.zeros_like(places), np.zeros_like(places)
    _act(places, moments, np.cbrt(sizes), of, field, force)
    return field, force, moments, sizes


def dipoles(particles: MarkedParticles, x: Array, F: Array) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    """Places (k, 3) m, moments (k, 3) A m^2, volumes (k,) m^3 and segment (k,) of the blocks."""
    block, segment, volume, remanence = particles
    on = np.flatnonzero(block >= 0)
    number = block[on].astype(np.int64)
    sizes: Array = np.bincount(number, volume[on]).astype(float)
    moment = volume[on, None] * np.einsum("nij,nj->ni", F[on], remanence[on, :3]) / MU0
    moments: Array = np.stack([np.bincount(number, moment[:, i]) for i in range(3)], axis=1)
    places: Array = np.stack([np.bincount(number, volume[on] * x[on, i]) / sizes for i in range(3)], axis=1)
    of = np.zeros(len(sizes), np.int64)
    of[number] = segment[on]
    return places, moments, sizes, of


@kernel
def _act(places, moments, edges, of, field, force):
    """Field (k, 3) T of the other segments' dipoles at each dipole, and the force (k, 3) N on it. edges (k,) m: of cubes as large.

    E_ab = g(r) (energy of the dipoles), with g from NEAR and TOUCHING; the derivatives include that of g.
    """
    for a in prange(len(places)):
        m0, m1, m2 = moments[a, 0], moments[a, 1], moments[a, 2]
        b0, b1, b2, f0, f1, f2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for b in range(len(places)):
            if of[b] == of[a]:
                continue
            x, y, z = places[a, 0] - places[b, 0], places[a, 1] - places[b, 1], places[a, 2] - places[b, 2]
            n0, n1, n2 = moments[b, 0], moments[b, 1], moments[b, 2]
            r2 = x * x + y * y + z * z
            r = np.sqrt(r2)
            s = K / (r2 * r2 * r)
            nd, md, mn = n0 * x + n1 * y + n2 * z, m0 * x + m1 * y + m2 * z, m0 * n0 + m1 * n1 + m2 * n2
            d = 0.5 * (edges[a] + edges[b])
            t = (NEAR - r / d) / (NEAR - 1.0)
            g, slope = 1.0, 0.0
            if t > 0.0:  # touching: 1 - TOUCHING smoothstep(t)
                t = min(t, 1.0)
                g = 1.0 - TOUCHING * t * t * (3.0 - 2.0 * t)
                slope = TOUCHING * 6.0 * t * (1.0 - t) / ((NEAR - 1.0) * d)
            pair = s * (3.0 * md * nd - mn * r2)  # m . B
            b0 += g * s * (3.0 * nd * x - n0 * r2)
            b1 += g * s * (3.0 * nd * y - n1 * r2)
            b2 += g * s * (3.0 * nd * z - n2 * r2)
            c = mn - 5.0 * md * nd / r2
            along = slope * pair / r
            f0 += g * 3.0 * s * (md * n0 + nd * m0 + c * x) + along * x
            f1 += g * 3.0 * s * (md * n1 + nd * m1 + c * y) + along * y
            f2 += g * 3.0 * s * (md * n2 + nd * m2 + c * z) + along * z
        field[a, 0], field[a, 1], field[a, 2] = b0, b1, b2
        force[a, 0], force[a, 1], force[a, 2] = f0, f1, f2


@kernel
def _act_change(places, moments, edges, of, dplaces, dmoments, dfield, dforce):
    """Directional derivative of `_act`, by the chain rule line by line: dfield (k, 3) T and dforce (k, 3) N of a change of the dipoles'
    places dplaces (k, 3) m and moments dmoments (k, 3) A m^2.
    """
    for a in prange(len(places)):
        for b in range(len(places)):
            if of[b] == of[a]:
                continue
            r2, dr2, nd, dnd, md, dmd, mn, dmn = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(3):
                x, dx = places[a, i] - places[b, i], dplaces[a, i] - dplaces[b, i]
                m, dm, n, dn = moments[a, i], dmoments[a, i], moments[b, i], dmoments[b, i]
                r2, dr2 = r2 + x * x, dr2 + 2.0 * x * dx
                nd, dnd = nd + n * x, dnd + dn * x + n * dx
                md, dmd = md + m * x, dmd + dm * x + m * dx
                mn, dmn = mn + m * n, dmn + dm * n + m * dn
            r = np.sqrt(r2)
            dr, s = dr2 / (2.0 * r), K / (r2 * r2 * r)
            ds = -2.5 * s * dr2 / r2
            d = 0.5 * (edges[a] + edges[b])
            t = (NEAR - r / d) / (NEAR - 1.0)
            g, slope, dslope = 1.0, 0.0, 0.0
            if t > 0.0:
                steep = 6.0 * TOUCHING / ((NEAR - 1.0) * d)
                if t < 1.0:
                    dslope = -steep * (1.0 - 2.0 * t) / ((NEAR - 1.0) * d) * dr
                t = min(t, 1.0)
                g, slope = 1.0 - TOUCHING * t * t * (3.0 - 2.0 * t), steep * t * (1.0 - t)
            gs, dgs = g * s, slope * dr * s + g * ds
            pair = s * (3.0 * md * nd - mn * r2)
            dpair = ds * (3.0 * md * nd - mn * r2) + s * (3.0 * (dmd * nd + md * dnd) - dmn * r2 - mn * dr2)
            c = mn - 5.0 * md * nd / r2
            dc = dmn - 5.0 * (dmd * nd + md * dnd - md * nd * dr2 / r2) / r2
            along = slope * pair / r
            dalong = (dslope * pair + slope * dpair - along * dr) / r
            for i in range(3):
                x, dx = places[a, i] - places[b, i], dplaces[a, i] - dplaces[b, i]
                m, dm, n, dn = moments[a, i], dmoments[a, i], moments[b, i], dmoments[b, i]
                dfield[a, i] += dgs * (3.0 * nd * x - n * r2) + gs * (3.0 * (dnd * x + nd * dx) - dn * r2 - n * dr2)
                change = dgs * (md * n + nd * m + c * x) + gs * (dmd * n + md * dn + dnd * m + nd * dm + dc * x + c * dx)
                dforce[a, i] += 3.0 * change + dalong * x + along * dx


@compiled
def _row(data, magnet):
    """Index in data of the first number of a particle's block; -1 for none."""
    if len(magnet) < 4 or magnet[3] < 0.0:
        return -1
    return SIZE * int(magnet[3])


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
