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
    """Rods that have the same lengths, stiffnesses and weight, of n elements.

    Attributes
    ----------
    rod : RodModel
        What they share. Its moments count where no region is varied, and its field where none
        is given.
    sizes : array (k, n), A m
        Moment per length of the k varied regions in each element; zero outside the region.
    """

    rod: RodModel
    sizes: Array

    @classmethod
    def of(cls, rod: RodModel, lengths: Sequence[float], regions: Sequence[int]) -> RodFamily:
        """Make the rods of which some regions vary.

        Parameters
        ----------
        rod : RodModel
            What they share.
        lengths : sequence of float, m
            Of all regions, base to tip.
        regions : sequence of int
            Indices of those that are varied.

        Returns
        -------
        RodFamily
            The rods.
        """
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
        """Find the moments per length of several designs.

        Parameters
        ----------
        directions : array (rods, k, 3), no unit
            Unit vectors of the varied regions.

        Returns
        -------
        array (rods, n, 3), A m
            Of each element.
        """
        varied = np.any(self.sizes != 0.0, axis=0).reshape(-1, 1)
        return np.where(varied, np.einsum("in,sij->snj", self.sizes, directions), self.rod.moment)

    def straight(self, rods: int) -> Array:
        """Make the frames of straight rods.

        Parameters
        ----------
        rods : int
            How many.

        Returns
        -------
        array (rods, n + 1, 4), no unit
            Quaternions.
        """
        return np.tile(self.rod.straight(), (rods, 1, 1))

    def stability(self, quaternions: Array, directions: Array, field: Array) -> float:
        """Find the smallest eigenvalue of one rod over that of the unloaded rod.

        Parameters
        ----------
        quaternions : array (n + 1, 4), no unit
            Its frames, in equilibrium.
        directions : array (k, 3), no unit
            Unit vectors of the varied regions.
        field : array (3,), T
            Added to the rod's own.

        Returns
        -------
        float, no unit
            1 at rest, 0 at a critical load.
        """
        rod = self.rod
        none = np.zeros_like(rod.field)
        unloaded = rod.loaded(moment=np.zeros_like(rod.moment), field=none, weight=none)
        loaded = rod.loaded(moment=self.moments(directions[None])[0], field=rod.field + field)
        return float(softest(quaternions, loaded) / softest(rod.straight(), unloaded))

    def shape(self, quaternions: Array, directions: Array, field: Array) -> RodShape:
        """Make the shape of one rod in equilibrium, from which the body's solve begins.

        Parameters
        ----------
        quaternions : array (n + 1, 4), no unit
            Its frames.
        directions : array (k, 3), no unit
            Unit vectors of the varied regions.
        field : array (3,), T
            Added to the rod's own.

        Returns
        -------
        RodShape
            The shape.
        """
        q = quaternions.copy()
        moment = np.ascontiguousarray(self.moments(directions[None])[0])
        rod = replace(self.rod, moment=moment, field=self.rod.field + field)
        return rod.shape(q, *rod.relax(q)[1:])

    def pull(self, quaternions: Array, directions: Array, gradient: Array) -> Array:
        """Find the pull on the elements of several rods in a field that varies in space.

        Parameters
        ----------
        quaternions : array (rods, n + 1, 4), no unit
            Their frames.
        directions : array (rods, k, 3), no unit
            Unit vectors of the varied regions.
        gradient : array (rods, n + 1, 3, 3), T/m
            dB_i/dx_j at the frames.

        Returns
        -------
        array (rods, n, 3), N
            On each element.
        """
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
        sloped: bool = True,
    ) -> tuple[Array, Array, Array]:
        """Find equilibria of several rods near given frames.

        Parameters
        ----------
        quaternions : array (rods, n + 1, 4), no unit
            Their frames, changed in place.
        directions : array (rods, k, 3), no unit
            Unit vectors of the varied regions.
        field : array (rods, 3), T, optional
            Uniform, added to the rods' own.
        pull : array (rods, n, 3), N, or float
            On the elements, of a field that varies.
        share : float, no unit
            Of all loads.
        sloped : bool
            Whether slopes are wanted: they take one more factorization, and a solve for each column.

        Returns
        -------
        positions : array (rods, n + 1, 3), m
            Of the frames.
        slopes : array (rods, n + 1, 3, c), m per unit
            Of the positions: 3 k by the components of the directions, and 3 more by the field
            (per T) where one is given. Not defined where no stable equilibrium was found.
        found : array (rods,) of bool
            Whether it is a stable equilibrium.
        """
        rods = len(quaternions)
        frames = len(self.rod.length) + 1
        added = np.zeros((rods, 1, 3)) if field is None else field[:, None, :]
        groups = 0 if field is None else 1
        shares = np.zeros((groups, 2, frames))
        shares[:, 0] = share
        position = np.empty((rods, frames, 3))
        found = np.empty(rods, dtype=bool)
        slopes = np.zeros((rods, sloped * 3 * (len(self.sizes) + groups), 2, frames, 3))
        weight = np.tile(share * self.rod.weight, (rods, 1, 1))
        weight[:, :-1] += (
            share
            * np.cumsum(np.broadcast_to(pull, (rods, frames - 1, 3))[:, ::-1], axis=1)[:, ::-1]
        )
        loaded = self.rod.loaded(
            moment=np.ascontiguousarray(self.moments(directions)),
            field=np.ascontiguousarray(share * (self.rod.field + added)),
            weight=weight,
        )
        relax_all(quaternions, loaded, (self.sizes, shares), position, slopes, found)
        return position, slopes[:, :, 1].transpose(0, 2, 3, 1), found


def _rotated(quaternions: Array, vectors: Array) -> Array:
    """Vectors (..., 3) turned by unit quaternions (..., 4), scalar first."""
    w = quaternions[..., :1]
    u = quaternions[..., 1:]
    return np.asarray(vectors + 2 * np.cross(u, np.cross(u, vectors) + w * vectors))
