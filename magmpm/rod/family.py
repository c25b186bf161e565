"""Many rods at once that differ in the directions of their moments and in the uniform field: shapes and their derivatives.

All start from a straight rod or from each other's shapes; a column of derivatives costs one substitution (rod.derivative_kernels).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import RodModel, RodShape
from magmpm.rod.derivative_kernels import relax_all, softest


@dataclass(frozen=True)
class RodFamily:
    """Rods that have the same lengths, stiffnesses and weight.

    rod: what they share; its moments count where no region is varied, and its field where none is given. sizes (k, n) A m: moment per
    length of the k varied regions in each element, zero outside the region.
    """

    rod: RodModel
    sizes: Array

    @classmethod
    def of(cls, rod: RodModel, lengths: Sequence[float], regions: Sequence[int]) -> RodFamily:
        """A rod whose regions with these indices are varied; lengths (m) of all regions, base to tip."""
        middle = np.cumsum(rod.length) - rod.length / 2
        of = np.searchsorted(np.cumsum(lengths), middle)
        strength = np.linalg.norm(rod.moment, axis=1)
        return cls(
            rod,
            np.array([np.where(of == i, strength, 0.0) for i in regions]).reshape(
                len(regions), len(of)
            ),
        )

    def moments(self, directions: Array) -> Array:
        """Moments per length (rods, n, 3) A m for directions (rods, k, 3)."""
        varied = np.any(self.sizes != 0.0, axis=0).reshape(-1, 1)
        return np.where(varied, np.einsum("in,sij->snj", self.sizes, directions), self.rod.moment)

    def straight(self, rods: int) -> Array:
        """Quaternions (rods, n + 1, 4) of straight rods."""
        return np.tile(self.rod.straight(), (rods, 1, 1))

    def stability(self, quaternions: Array, directions: Array, field: Array) -> float:
        """Smallest eigenvalue of one rod (n + 1, 4) over the unloaded rod's: 1 at rest, 0 at a critical load. field (3,) T: added."""
        rod = self.rod
        none = np.zeros_like(self.rod.field)
        at_rest = softest(
            rod.straight(), rod.length, rod.twist_bend, rod.compliance, 0.0 * rod.moment, none, none
        )
        moment = self.moments(directions[None])[0]
        return float(
            softest(
                quaternions,
                rod.length,
                rod.twist_bend,
                rod.compliance,
                moment,
                rod.field + field,
                rod.weight,
            )
            / at_rest
        )

    def shape(self, quaternions: Array, directions: Array, field: Array) -> RodShape:
        """One rod (n + 1, 4) in equilibrium with directions (k, 3) and an added field (3,) T: what the body's solve begins from."""
        q = quaternions.copy()
        moment = np.ascontiguousarray(self.moments(directions[None])[0])
        rod = replace(self.rod, moment=moment, field=self.rod.field + field)
        return rod.shape(q, *rod.relax(q)[1:])

    def pull(self, quaternions: Array, directions: Array, gradient: Array) -> Array:
        """Pull (rods, n, 3) N on the elements of rods in these shapes, with gradients dB_i/dx_j (n + 1, 3, 3) T/m at the frames."""
        moments = self.moments(directions)
        turned = (
            _rotated(quaternions[:, side], moments) for side in (slice(None, -1), slice(1, None))
        )
        parts = [
            np.einsum("kji,skj->ski", at, m)
            for at, m in zip((gradient[:-1], gradient[1:]), turned, strict=True)
        ]
        return np.asarray((parts[0] + parts[1]) * self.rod.length[:, None] / 2)

    def relaxed(
        self,
        quaternions: Array,
        directions: Array,
        field: Array | None = None,
        *,
        pull: Array | float = 0.0,
        share: float = 1.0,
    ) -> tuple[Array, Array, Array]:
        """Equilibria from quaternions (rods, n + 1, 4), which are changed in place.

        directions (rods, k, 3) unit vectors; field (rods, 3) T: uniform, added to the rod's own; pull (rods, n, 3) N: on
        the elements, of a field that varies; share: of all loads. Returns
        positions (rods, n + 1, 3) m; their slopes (rods, n + 1, 3, c), 3 k by the components of the directions, and 3 more by the field
        (per T) where one is given; found (rods,): whether it is a stable equilibrium. Slopes of others are not defined.
        """
        rods = len(quaternions)
        frames = len(self.rod.length) + 1
        added = np.zeros((rods, 1, 3)) if field is None else field[:, None, :]
        groups = 0 if field is None else 1
        shares = np.zeros((groups, 2, frames))
        shares[:, 0] = share
        position = np.empty((rods, frames, 3))
        found = np.empty(rods, dtype=bool)
        slopes = np.zeros((rods, 3 * (len(self.sizes) + groups), 2, frames, 3))
        weight = np.tile(share * self.rod.weight, (rods, 1, 1))
        weight[:, :-1] += (
            share
            * np.cumsum(np.broadcast_to(pull, (rods, frames - 1, 3))[:, ::-1], axis=1)[:, ::-1]
        )
        rod = self.rod
        relax_all(
            quaternions,
            rod.length,
            rod.twist_bend,
            rod.compliance,
            np.ascontiguousarray(self.moments(directions)),
            np.ascontiguousarray(share * (rod.field + added)),
            weight,
            self.sizes,
            shares,
            position,
            slopes,
            found,
        )
        return position, slopes[:, :, 1].transpose(0, 2, 3, 1), found


def _rotated(quaternions: Array, vectors: Array) -> Array:
    """Vectors (..., 3) turned by unit quaternions (..., 4), scalar first."""
    w = quaternions[..., :1]
    u = quaternions[..., 1:]
    return np.asarray(vectors + 2 * np.cross(u, np.cross(u, vectors) + w * vectors))
