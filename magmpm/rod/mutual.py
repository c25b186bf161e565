"""The magnetized segments' field on each other along a rod, for estimates of `effects.magnetic_interaction`.

Each segment is divided into blocks, ACROSS in its section's width and as long as they are wide. A block acts as a dipole at its mean place,
with the moment of its elements; its elements feel the field, and carry equal parts of the force, that the other segments' dipoles make
there, at the block's place in the section. These are the derivatives of one energy, so that forces and torques inside the body cancel: what
they bend is the small rest of large terms.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.fields.dipole import K
from magmpm.scene import Scene

CELLS, ACROSS = 2, 2  # of the grid that gives the section; blocks across its width
TOUCHING, NEAR = 0.151, 1.35  # of cubes: magmpm.effects.magnetic_interaction has the sources


class MutualField:
    """Mutual field of the segments of a straight body. counts: number of elements of each segment; length (n,) m: of each element."""

    def __init__(self, scene: Scene, counts: NDArray[np.int64], length: Array, across: int = ACROSS) -> None:
        shape = scene.body.shape
        assert isinstance(shape, StraightBody)
        places, share, area = _section(shape, across)
        self.length, wide = length, float(np.sqrt(area / len(places)))
        layer, of, first, number = np.zeros(len(length), int), [], 0, 0
        for k, (count, size) in enumerate(zip(counts, shape.segment_lengths(), strict=True)):
            pieces = max(1, min(int(count), round(size / wide)))
            layer[first : first + count] = number + np.arange(count) * pieces // count
            of += [k] * pieces
            first, number = first + count, number + pieces
        self.layer, self.layers, self.places, self.share = layer, number, places, share
        owner = np.repeat(of, len(places))
        self.same = owner[:, None] == owner[None, :]
        self.sizes = np.bincount(layer, length)
        self.edges = np.cbrt((self.sizes[:, None] * area * share).ravel())

    def at(self, middle: Array, frames: Array, moment: Array) -> tuple[Array, Array, Array]:
        """Field (n, 3) T, force (n, 3) N/m and couple (n, 3) N per length on elements.

        middle (n, 3) m: their middles; frames (n, 3, 3), the tangent and the section's axes in columns; moment (n, 3) A m, per length, in
        the frames.
        """
        m = self._sum(np.einsum("kij,kj->ki", frames, moment))
        center = self._sum(middle) / self.sizes[:, None]
        arms = np.einsum("kij,bj->kbi", self._sum(frames.reshape(-1, 9)).reshape(-1, 3, 3)[:, :, 1:], self.places)
        arms /= self.sizes[:, None, None]
        x, moments = center[:, None] + arms, m[:, None] * self.share[:, None]
        field, force = _dipoles(x.reshape(-1, 3), moments.reshape(-1, 3), self.same, self.edges)
        field, force = (values.reshape(arms.shape) for values in (field, force))
        mean = np.einsum("kbi,b->ki", field, self.share)
        total, couple = force.sum(axis=1), np.cross(arms, force).sum(axis=1)
        return mean[self.layer], (total / self.sizes[:, None])[self.layer], (couple / self.sizes[:, None])[self.layer]

    def _sum(self, values: Array) -> Array:
        """Integral of a quantity (n, k) over the elements of each layer."""
        return np.stack([np.bincount(self.layer, self.length * column, self.layers) for column in values.T], axis=1)


def _section(shape: StraightBody, across: int) -> tuple[Array, Array, float]:
    """Places (b, 2) m of blocks in the section, from its axis, their shares (b,) of its area, and the area, m^2."""
    particles = shape.discretize(CELLS, 2).particles
    slice_of = particles.cell[:, 0] == particles.cell[0, 0]
    assert shape.line is not None  # only straight bodies are rods
    yz = particles.position[slice_of, 1:] - np.array(shape.line.base)[1:]
    volume = particles.volume[slice_of]
    width = 2 * np.abs(yz).max(axis=0)
    number = np.zeros(len(yz), int)
    for axis in range(2):
        if width[axis] == 0.0:  # one plane of particles, as in plane strain
            continue
        pieces = max(1, round(across * width[axis] / width.max()))
        number = number * pieces + np.clip(((yz[:, axis] / width[axis] + 0.5) * pieces).astype(int), 0, pieces - 1)
    _, which = np.unique(number, return_inverse=True)
    total = np.bincount(which, volume)
    places = np.stack([np.bincount(which, volume * yz[:, axis]) / total for axis in range(2)], axis=1)
    area = float(particles.volume.sum()) / shape.length
    return places, total / total.sum(), area


def _dipoles(x: Array, m: Array, same: Array, edges: Array) -> tuple[Array, Array]:
    """Field (k, 3) T at, and force (k, 3) N on, dipoles m (k, 3) A m^2 at x (k, 3) m, of cubes of these edges (k,) m, of other segments.

    The derivatives of -sum g(r) m_a.B_b(x_a) over pairs, g as in magmpm.effects.magnetic_interaction. Jackson, 3rd ed., section 5.6.
    """
    d = x[:, None, :] - x[None, :, :]
    r2 = np.einsum("abi,abi->ab", d, d)
    r2[same] = np.inf
    r, edge = np.sqrt(r2), (edges[:, None] + edges[None, :]) / 2
    t = np.clip((NEAR - r / edge) / (NEAR - 1.0), 0.0, 1.0)
    g, slope = 1.0 - TOUCHING * t * t * (3.0 - 2.0 * t), TOUCHING * 6.0 * t * (1.0 - t) / ((NEAR - 1.0) * edge)
    scale = K / r2**2.5
    nd, md, mn = np.einsum("bi,abi->ab", m, d), np.einsum("ai,abi->ab", m, d), m @ m.T
    near = np.where(same, 0.0, r2)
    field = np.einsum("ab,abi->ai", 3.0 * g * scale * nd, d) - (g * scale * near) @ m
    pair = scale * (3.0 * md * nd - mn * near)
    along = 3.0 * g * scale * (mn - 5.0 * md * nd / r2) + slope * pair / r
    force = 3.0 * ((g * scale * md) @ m + (g * scale * nd).sum(axis=1)[:, None] * m) + np.einsum("ab,abi->ai", along, d)
    return field, force
