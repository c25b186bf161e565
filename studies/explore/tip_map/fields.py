"""The fields of a map: along rays to all sides, or a grid of two components. Paths join neighbors: each solve learns from those before."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, report

STRENGTHS = 8  # along a ray, unless requested otherwise
MOST = 100_000
PATHS = 8  # as many processes can share the work; longer paths learn more. Their number is fixed, so that a map is the same on any machine
AXES = "xyz"


@dataclass(frozen=True)
class Fields:
    """values (m, 3) T; paths: lists of their indices, each near those before; kind: "rays" or "plane"; axes: of a plane's components;
    shape: directions and strengths, or steps along both axes."""

    values: Array
    paths: tuple[tuple[int, ...], ...]
    kind: str
    axes: tuple[int, int]
    shape: tuple[int, int]

    @property
    def rays(self) -> int:
        """Number of rays, each with as many fields in a row; fields of a plane have one each."""
        return self.shape[0] if self.kind == "rays" else len(self.values)


def on_rays(count: int, largest: float, strengths: int | None = None) -> Fields:
    """About `count` fields up to `largest` (T): directions evenly over the sphere, each with equal steps of strength from the first one on.

    The directions are Fibonacci's lattice. Source: Gonzalez, Mathematical Geosciences 42 (2010) 49-64. Raises InputError.
    """
    _check(count, largest)
    strengths = min(STRENGTHS, count) if strengths is None else strengths
    if not 1 <= strengths <= count:
        raise InputError(report("--strengths", received=str(strengths), rule=f"must be 1 to the {count} fields", remedy="--strengths 8"))
    k = max(round(count / strengths), 1)
    z = 1.0 - (2.0 * np.arange(k) + 1.0) / k
    turn = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(k)
    flat = np.sqrt(1.0 - z * z)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    steps = largest * np.arange(1, strengths + 1) / strengths
    values = (directions[:, None, :] * steps[None, :, None]).reshape(-1, 3)
    bands = [sorted(band.tolist(), key=lambda j: turn[j] % (2.0 * math.pi)) for band in np.array_split(np.arange(k), min(PATHS, k))]
    paths = tuple(tuple(j * strengths + step for j in band for step in range(strengths)) for band in bands)
    return Fields(values, paths, "rays", (0, 2), (k, strengths))


def in_plane(count: int, largest: float, axes: str) -> Fields:
    """About `count` fields, a square grid of two components from -`largest` to `largest` (T), in rows that run to and fro.

    axes: two letters, such as "xz". Raises InputError.
    """
    _check(count, largest)
    if len(axes) != 2 or len(set(axes)) != 2 or not set(axes) <= set(AXES):
        raise InputError(report("--plane", received=repr(axes), rule="must be two of x, y and z", remedy="--plane xz"))
    first, second = (AXES.index(axis) for axis in axes)
    n = max(round(math.sqrt(count)), 2)
    marks = np.linspace(-largest, largest, n)
    values = np.zeros((n, n, 3))
    values[:, :, first], values[:, :, second] = marks[None, :], marks[:, None]
    rows = [tuple(range(row * n, (row + 1) * n))[:: -1 if row % 2 else 1] for row in range(n)]
    paths = tuple(tuple(k for row in band.tolist() for k in rows[row]) for band in np.array_split(np.arange(n), min(PATHS, n)))
    return Fields(values.reshape(-1, 3), paths, "plane", (first, second), (n, n))


def _check(count: int, largest: float) -> None:
    if not 1 <= count <= MOST:
        raise InputError(report("--fields", received=str(count), rule=f"must be 1 to {MOST}", remedy="--fields 1000"))
    if not 0.0 < largest <= 20.0:
        raise InputError(report("--max", received=f"{1e3 * largest:g} mT", rule="must be above 0 and at most 20 T", remedy="--max 20mT"))
