"""Rods in a map's fields: which shapes snap while the field grows, and which fields have another stable shape.

A thousand rods take a second or two. Each begins in no field (under its weight) and follows its field as that grows. A step in which the
tip moves as far however finely it is cut is a snap. A shape that neighbors' rods settle in, away from the rod's own, is another one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.rod.cosserat import RodModel, rod_model
from magmpm.rod.derivative_kernels import relax_all
from magmpm.scene import Scene

STEPS, FINER = 16, 8  # of a field's growth; and how much finer where it is not smooth
LASTING = 0.6  # of a step's move that is left in the longest of FINER parts of it: 1/8 where smooth, 0.35 at a buckling load, 1 at a snap


@dataclass(frozen=True)
class RodTips:
    """Tips of rods in each field: tip (m, 3) m; snapped (m,): on the way to it; other (m, 3) m: tip of another stable shape, or NaN."""

    tip: Array
    snapped: NDArray[np.bool_]
    other: Array


def rod_tips(scene: Scene, fields: Array, rays: int) -> RodTips:
    """Follow the scene's rods in fields (m, 3) T; `rays` of them: each m / rays in a row, of one direction and growing strength, in equal
    steps from the first. A rod that finds no equilibrium has a tip of NaN."""
    rod = rod_model(scene.with_field([0.0, 0.0, 0.0]), 60)  # deflections to 1e-3
    apart, jump = 0.03 * float(rod.length.sum()), 0.02 * float(rod.length.sum())
    ends = fields.reshape(rays, -1, 3)
    shapes, tip, longest = _grown(rod, ends, 1)
    snaps = np.zeros(longest.shape, dtype=bool)
    doubtful = np.flatnonzero((longest > jump).any(axis=1))
    if len(doubtful):
        finer = _grown(rod, ends[doubtful], FINER)[2]
        snaps[doubtful] = (finer > LASTING * longest[doubtful]) & (finer > jump)
    snapped = np.logical_or.accumulate(snaps, axis=1).ravel()
    shapes, tip = shapes.reshape(len(fields), *shapes.shape[2:]), tip.reshape(-1, 3)
    return RodTips(tip, snapped, _others(rod, fields, shapes, tip, apart))


def _relaxed(rod: RodModel, q: Array, fields: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Tips (m, 3) m of rods q (m, n + 1, 4), changed in place, in fields (m, 3) T; and whether they are stable equilibria."""
    m, frames = q.shape[:2]
    position, found = np.empty((m, frames, 3)), np.empty(m, dtype=bool)
    around = np.ascontiguousarray(np.broadcast_to(fields[:, None, :], (m, frames, 3)))
    relax_all(
        q, rod.length, rod.twist_bend, rod.compliance, np.tile(rod.moment, (m, 1, 1)), around, np.tile(rod.weight, (m, 1, 1)),
        np.zeros((0, frames - 1)), np.zeros((0, 2, frames)), position, np.zeros((m, 0, 2, frames, 3)), found,
    )  # fmt: skip
    return position[:, -1].copy(), found & np.isfinite(position).all(axis=(1, 2))


def _grown(rod: RodModel, ends: Array, finer: int) -> tuple[Array, Array, Array]:
    """Shapes (rays, k, n + 1, 4) and tips (rays, k, 3) m at fields (rays, k, 3) T along rays, and the longest move (rays, k) m of a tip in
    a step up to each. A ray has at least STEPS steps, times `finer`."""
    rays, k = ends.shape[:2]
    parts = max(-(-STEPS // k), 1) * finer
    q = np.zeros((rays, len(rod.length) + 1, 4))
    q[:, :, 0] = 1.0
    shapes, tips, longest = np.empty((rays, k, *q.shape[1:])), np.empty((rays, k, 3)), np.zeros((rays, k))
    before, found = _relaxed(rod, q, np.zeros((rays, 3)))
    for number in range(k):
        start = ends[:, number - 1] if number else np.zeros((rays, 3))
        for share in np.arange(1, parts + 1) / parts:
            here = start + share * (ends[:, number] - start)
            tip, found = _relaxed(rod, q, here)
            for _ in range(3):
                if (left := np.flatnonzero(~found)).size:  # at a critical load: it goes on from where it has got to
                    again = q[left].copy()
                    tip[left], found[left] = _relaxed(rod, again, here[left])
                    q[left] = again
            longest[:, number] = np.fmax(longest[:, number], np.linalg.norm(tip - before, axis=1))
            before = tip
        shapes[:, number], tips[:, number] = q, np.where(found[:, None], before, np.nan)
    return shapes, tips, longest


def _others(rod: RodModel, fields: Array, shapes: Array, tip: Array, apart: float) -> Array:
    """Tips (m, 3) m of a stable shape that a rod settles in from a neighbor's shape, where it is not the rod's own; else NaN.

    What is found is passed on from neighbor to neighbor, so that a branch is followed as far as it is stable.
    """
    from scipy.spatial import cKDTree  # 0.2 s to import: not before there are rods

    m = len(fields)
    other, passed = np.full((m, 3), np.nan), shapes.copy()
    if m < 2:
        return other
    near = np.asarray(cKDTree(fields).query(fields, k=min(5 + 1, m))[1]).reshape(m, -1)[:, 1:]
    fresh: NDArray[np.bool_] = np.asarray(np.isfinite(tip).all(axis=1))
    place = tip.copy()  # of what is passed on: its tips; and whether it is new
    while fresh.any():
        now = np.zeros(m, dtype=bool)
        for of in near.T:
            # Near shapes that go over into each other smoothly lead to the same rest: only those at a larger distance are tried.
            tried = np.flatnonzero(fresh[of] & np.isnan(other[:, 0]) & (np.linalg.norm(place[of] - tip, axis=1) > apart))
            if not len(tried):
                continue
            q = passed[of[tried]].copy()
            there, found = _relaxed(rod, q, fields[tried])
            new = found & (np.linalg.norm(there - tip[tried], axis=1) > apart)
            other[tried[new]], now[tried[new]] = there[new], True
            passed[tried[new]] = q[new]
        fresh, place = now, np.where(now[:, None], other, np.nan)
    return other
