"""The magnetized segments' field on each other along a rod, for estimates of `effects.magnetic_interaction`.

The blocks of that effect, found once in the undeformed body on a coarse grid, move and turn with the rod's sections. They act as dipoles;
field and force are averaged over the sections.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.fields.dipole import MU0, K
from magmpm.scene import Scene

CELLS, ACROSS = 2, 1  # of the grid; blocks across: on the axis, where no force has a lever arm


class MutualField:
    """What the segments of a straight body do to each other. Raises AttributeError where the scene does not name magnetic_interaction."""

    def __init__(self, scene: Scene) -> None:
        shape, effect = scene.body.shape, scene.effects.magnetic_interaction
        assert effect is not None
        made = shape.discretize(CELLS, 2)
        particles: Any = made.particles
        remanence = scene.region_remanence()[particles.segment]
        block = effect.model_copy(update={"blocks_across": ACROSS}).marks(particles, remanence)
        on = np.flatnonzero(block >= 0)
        number = block[on].astype(int)
        self.volume = np.bincount(number, particles.volume[on])
        places = [np.bincount(number, particles.volume[on] * particles.position[on, i]) / self.volume for i in range(3)]
        assert shape.line is not None  # only straight bodies are rods
        self.place = np.stack(places, axis=1) - np.array(shape.line.base)
        self.of = np.zeros(len(self.volume), int)
        self.of[number] = particles.segment[on]
        self.moment = self.volume[:, None] * scene.region_remanence()[self.of] / MU0
        self.same = self.of[:, None] == self.of[None, :]
        self.ends = np.concatenate([[0.0], np.cumsum(shape.segment_lengths())])  # type: ignore[attr-defined]

    def at(self, s: Array, position: Array, frames: Array) -> tuple[Array, Array]:
        """Field (m, 3) T at the stations s (m,) m of the undeformed rod, and force per length (m, 3) N/m; position (m, 3) m, frames
        (m, 3, 3) with the tangent and the section's axes as columns."""
        along = self.place[:, 0]
        R = np.stack([np.interp(along, s, frames[:, i, j]) for i in range(3) for j in range(3)], axis=1).reshape(-1, 3, 3)
        x = np.stack([np.interp(along, s, position[:, i]) for i in range(3)], axis=1)
        x = x + R[:, :, 1] * self.place[:, 1:2] + R[:, :, 2] * self.place[:, 2:3]
        m = np.einsum("kij,kj->ki", R, self.moment)
        field, force = _dipoles(x, m, self.same)
        out, pull = np.zeros_like(position), np.zeros_like(position)
        for k in np.unique(self.of):
            own = np.flatnonzero(self.of == k)
            inside = np.flatnonzero((s >= self.ends[k] - 1e-12) & (s <= self.ends[k + 1] + 1e-12))
            layers, which = np.unique(np.round(along[own], 9), return_inverse=True)
            count = np.bincount(which)
            thick = (self.ends[k + 1] - self.ends[k]) / len(layers)
            for i in range(3):
                out[inside, i] = np.interp(s[inside], layers, np.bincount(which, field[own, i]) / count)
                pull[inside, i] = np.interp(s[inside], layers, np.bincount(which, force[own, i]) / thick)
        return out, pull


def _dipoles(x: Array, m: Array, same: Array) -> tuple[Array, Array]:
    """Field (k, 3) T at, and force (k, 3) N on, dipoles m (k, 3) A m^2 at x (k, 3) m of other segments. Jackson, 3rd ed., section 5.6."""
    d = x[:, None, :] - x[None, :, :]
    r2 = np.einsum("abi,abi->ab", d, d)
    r2[same] = np.inf
    scale = K / r2**2.5
    nd, md, mn = np.einsum("bi,abi->ab", m, d), np.einsum("ai,abi->ab", m, d), m @ m.T
    near = np.where(same, 0.0, r2)
    field = np.einsum("ab,abi->ai", 3.0 * scale * nd, d) - (scale * near) @ m
    along = mn - 5.0 * md * nd / r2
    force = 3.0 * ((scale * md) @ m + (scale * nd).sum(axis=1)[:, None] * m + np.einsum("ab,abi->ai", scale * along, d))
    return field, force
