"""Map of a body's tip over many uniform fields, and of the fields where its position is not certain: `magmpm map`.

The fields lie along rays to all sides, or on a grid of two components. Paths join neighbors: each solve learns from those before
(statics.neighbors). The equilibria are those that `magmpm run` finds: the rod follows the branch that grows from no load. Paths know
nothing of each other: it does not matter which process takes one.

Rods say which shapes snap while the field grows, and which fields have another stable shape: a thousand take a second or two. Each begins
in no field (under its weight) and follows its field as that grows. A step in which the tip moves as far however finely it is cut is a snap.
A shape that neighbors' rods settle in, away from the rod's own, is another one.
"""

from __future__ import annotations

import csv
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array, Mask, Plain
from magmpm.compiled.process import DIED, PARTIAL, RAISED, answers, started, with_threads
from magmpm.errors import InputError, MagmpmError
from magmpm.inputs.vectors import Vector
from magmpm.results.whole_file import whole_file, write_json
from magmpm.rod.cosserat import RodModel, rod_model
from magmpm.rod.family import RodFamily
from magmpm.scene import Scene
from magmpm.solving.precompile import prepare_kernels
from magmpm.statics.axis import tip
from magmpm.statics.equilibrium import Following, solve_static
from magmpm.statics.layout import model_at_rest
from magmpm.statics.neighbors import Neighbors
from magmpm.statics.stability import BRINK

# as many processes can share the work; longer paths learn more. Their number is fixed, so that a
# map is the same on any machine
PATHS = 8
AXES = "xyz"
Path_ = Sequence[tuple[int, Sequence[float]]]  # indices and fields, T
MARKS = {  # from the worst to the best
    "failed": "no shape at rest was found",
    "unstable": f"stability at most {BRINK:g}: on the edge of another shape",
    "snapped": "the shape jumps on the way up to this field",
    "two shapes": "another stable shape exists: the loading history decides",
    "sure": "one stable shape",
}
HEAD = (
    "Bx_mT",
    "By_mT",
    "Bz_mT",
    "x_mm",
    "y_mm",
    "z_mm",
    "stability",
    "mark",
    "other_x_mm",
    "other_y_mm",
    "other_z_mm",
    "why",
)


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
    strengths = min(8, count) if strengths is None else strengths
    if not 1 <= strengths <= count:
        raise InputError(
            "--strengths",
            received=str(strengths),
            rule=f"must be 1 to the {count} fields",
            remedy="--strengths 8",
        )
    k = max(round(count / strengths), 1)
    z = 1.0 - (2.0 * np.arange(k) + 1.0) / k
    turn = math.pi * (3.0 - math.sqrt(5.0)) * np.arange(k)
    flat = np.sqrt(1.0 - z * z)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    steps = largest * np.arange(1, strengths + 1) / strengths
    values = (directions[:, None, :] * steps[None, :, None]).reshape(-1, 3)
    bands = [
        sorted(band.tolist(), key=lambda j: turn[j] % (2.0 * math.pi))
        for band in np.array_split(np.arange(k), min(PATHS, k))
    ]
    paths = tuple(
        tuple(j * strengths + step for j in band for step in range(strengths)) for band in bands
    )
    return Fields(values, paths, "rays", (0, 2), (k, strengths))


def in_plane(count: int, largest: float, axes: str) -> Fields:
    """About `count` fields, a square grid of two components from -`largest` to `largest` (T), in rows that run to and fro.

    axes: two letters, such as "xz". Raises InputError.
    """
    _check(count, largest)
    if len(axes) != 2 or len(set(axes)) != 2 or not set(axes) <= set(AXES):
        raise InputError(
            "--plane", received=repr(axes), rule="must be two of x, y and z", remedy="--plane xz"
        )
    first, second = (AXES.index(axis) for axis in axes)
    n = max(round(math.sqrt(count)), 2)
    marks = np.linspace(-largest, largest, n)
    values = np.zeros((n, n, 3))
    values[:, :, first], values[:, :, second] = marks[None, :], marks[:, None]
    rows = [tuple(range(row * n, (row + 1) * n))[:: -1 if row % 2 else 1] for row in range(n)]
    paths = tuple(
        tuple(k for row in band.tolist() for k in rows[row])
        for band in np.array_split(np.arange(n), min(PATHS, n))
    )
    return Fields(values.reshape(-1, 3), paths, "plane", (first, second), (n, n))


def _check(count: int, largest: float) -> None:
    most = 100_000
    if not 1 <= count <= most:
        raise InputError(
            "--fields",
            received=str(count),
            rule=f"must be 1 to {most}",
            remedy="--fields 1000",
        )
    if not 0.0 < largest <= 20.0:
        raise InputError(
            "--max",
            received=f"{1e3 * largest:g} mT",
            rule="must be above 0 and at most 20 T",
            remedy="--max 20mT",
        )


@dataclass(frozen=True)
class Tip:
    """Tip in one field: its index; tip (3,) m, stability and Newton steps; or why there is none."""

    index: int
    tip: Vector | None
    stability: float
    steps: int
    failure: str = ""


def solved(scene: Scene, paths: Sequence[Path_], processes: int) -> Iterator[Tip]:
    """The tips of all fields of all paths, in the order in which they are found. Of a process that ends, the field that it was at has no
    answer, and another one takes up the rest of its path."""
    left = deque(list(path) for path in paths)
    env = with_threads(max((os.cpu_count() or 1) // processes, 1))
    with started(min(processes, len(paths)), _begin, scene, env=env) as pool:
        for path, kind, found in answers(left, pool):
            if kind == RAISED:
                raise found
            if kind == PARTIAL:
                yield found
                path.pop(0)
            elif kind == DIED and path:
                index, _ = path.pop(0)
                yield Tip(index, None, np.nan, 0, f"the process that solved it {found}")
                if path:
                    left.append(path)


def _begin(pipe: Any, scene: Scene) -> Callable[[Path_], None]:
    """Begin a process: it follows a path, and sends each tip."""

    def follow(path: Path_) -> None:
        for found in _along(scene, path):
            pipe.send((PARTIAL, found))

    return follow


def _along(scene: Scene, path: Path_) -> Iterator[Tip]:
    """The tips along a path, each found from the ones before."""
    neighbors = Neighbors()
    following = Following(neighbors.expected)
    for index, uniform in path:
        try:
            loaded = model_at_rest(scene.with_field(uniform))
            found = solve_static(loaded, following=following)
        except (MagmpmError, ArithmeticError) as error:
            yield Tip(index, None, np.nan, 0, getattr(error, "reason", str(error)))
            continue
        neighbors.learn(found.correction)
        at = tip(loaded, found.point.grid)
        yield Tip(
            index,
            tuple(at.tolist()),
            float(found.stability if found.stability is not None else np.nan),
            found.steps,
        )


@dataclass(frozen=True)
class RodTips:
    """Tips of rods in each field: tip (m, 3) m; snapped (m,): on the way to it; other (m, 3) m: tip of another stable shape, or NaN."""

    tip: Array
    snapped: Mask
    other: Array


def rod_tips(scene: Scene, fields: Array, rays: int) -> RodTips:
    """Follow the scene's rods in fields (m, 3) T; `rays` of them: each m / rays in a row, of one direction and growing strength, in equal
    steps from the first. A rod that finds no equilibrium has a tip of NaN."""
    finer_steps = 8  # times, where the tip's way is not smooth
    # of a step's move that is left in the longest of its finer parts: 1/8 where smooth, 0.35 at a
    # buckling load, 1 at a snap
    lasting = 0.6
    rod = rod_model(scene.with_field([0.0, 0.0, 0.0]), 60)  # deflections to 1e-3
    distance = 0.03 * float(rod.length.sum())
    jump = 0.02 * float(rod.length.sum())
    ends = fields.reshape(rays, -1, 3)
    shapes, tip, longest = _grown(rod, ends, 1)
    snaps = np.zeros(longest.shape, dtype=bool)
    doubtful = np.flatnonzero((longest > jump).any(axis=1))
    if len(doubtful):
        finer = _grown(rod, ends[doubtful], finer_steps)[2]
        snaps[doubtful] = (finer > lasting * longest[doubtful]) & (finer > jump)
    snapped = np.logical_or.accumulate(snaps, axis=1).ravel()
    shapes = shapes.reshape(len(fields), *shapes.shape[2:])
    tip = tip.reshape(-1, 3)
    return RodTips(tip, snapped, _others(rod, fields, shapes, tip, distance))


def _relaxed(rod: RodModel, q: Array, fields: Array) -> tuple[Array, Mask]:
    """Tips (m, 3) m of rods q (m, n + 1, 4), changed in place, in fields (m, 3) T; and whether they are stable equilibria."""
    family = RodFamily(rod, np.zeros((0, len(rod.length))))  # none of its moments varies
    position, _, found = family.relaxed(q, np.zeros((len(q), 0, 3)), fields, sloped=False)
    return position[:, -1].copy(), found.astype(bool) & np.isfinite(position).all(axis=(1, 2))


def _grown(rod: RodModel, ends: Array, finer: int) -> tuple[Array, Array, Array]:
    """Shapes (rays, k, n + 1, 4) and tips (rays, k, 3) m at fields (rays, k, 3) T along rays, and the longest move (rays, k) m of a tip in
    a step up to each. A ray has at least 16 steps, times `finer`."""
    rays, k = ends.shape[:2]
    parts = max(-(-16 // k), 1) * finer
    q = np.zeros((rays, len(rod.length) + 1, 4))
    q[:, :, 0] = 1.0
    shapes = np.empty((rays, k, *q.shape[1:]))
    tips = np.empty((rays, k, 3))
    longest = np.zeros((rays, k))
    before, found = _relaxed(rod, q, np.zeros((rays, 3)))
    for number in range(k):
        start = ends[:, number - 1] if number else np.zeros((rays, 3))
        for share in np.arange(1, parts + 1) / parts:
            here = start + share * (ends[:, number] - start)
            tip, found = _relaxed(rod, q, here)
            for _ in range(3):
                if (
                    left := np.flatnonzero(~found)
                ).size:  # at a critical load: it goes on from where it has got to
                    retried = q[left].copy()
                    tip[left], found[left] = _relaxed(rod, retried, here[left])
                    q[left] = retried
            longest[:, number] = np.fmax(longest[:, number], np.linalg.norm(tip - before, axis=1))
            before = tip
        shapes[:, number], tips[:, number] = q, np.where(found[:, None], before, np.nan)
    return shapes, tips, longest


def _others(rod: RodModel, fields: Array, shapes: Array, tip: Array, distance: float) -> Array:
    """Tips (m, 3) m of a stable shape that a rod settles in from a neighbor's shape, where it is not the rod's own; else NaN.

    What is found is passed on from neighbor to neighbor, so that a branch is followed as far as it is stable.
    """
    from scipy.spatial import cKDTree  # 0.2 s to import: not before there are rods

    m = len(fields)
    other = np.full((m, 3), np.nan)
    passed = shapes.copy()
    if m < 2:
        return other
    near = np.asarray(cKDTree(fields).query(fields, k=min(5 + 1, m))[1]).reshape(m, -1)[:, 1:]
    fresh: Mask = np.asarray(np.isfinite(tip).all(axis=1))
    place = tip.copy()  # of what is passed on: its tips; and whether it is new
    while fresh.any():
        now = np.zeros(m, dtype=bool)
        for of in near.T:
            # Near shapes that go over into each other smoothly lead to the same rest: only those at a larger distance are tried.
            tried = np.flatnonzero(
                fresh[of]
                & np.isnan(other[:, 0])
                & (np.linalg.norm(place[of] - tip, axis=1) > distance)
            )
            if not len(tried):
                continue
            q = passed[of[tried]].copy()
            there, found = _relaxed(rod, q, fields[tried])
            new = found & (np.linalg.norm(there - tip[tried], axis=1) > distance)
            other[tried[new]], now[tried[new]] = there[new], True
            passed[tried[new]] = q[new]
        fresh = now
        place = np.where(now[:, None], other, np.nan)
    return other


@dataclass(frozen=True)
class TipMap:
    """tip (m, 3) m and stability (m,) of each field, NaN where there is none; mark (m,): of MARKS; other (m, 3) m: the rod's tip in another
    stable shape, or NaN; why (m,): of failures; seconds."""

    scene: Scene
    fields: Fields
    tip: Array
    stability: Array
    mark: NDArray[np.str_]
    other: Array
    why: list[str]
    seconds: float
    newton_steps: int = 0
    files: list[str] = field(default_factory=list)

    def counts(self) -> dict[str, int]:
        """Number of fields with each mark."""
        return {mark: int(np.count_nonzero(self.mark == mark)) for mark in MARKS}

    def summary(self) -> Plain:
        """Plain data, SI, for --json."""
        none = np.isnan(self.tip).any(axis=1)
        return {
            "number": "field.uniform",  # its address
            "fields": len(self.tip),
            "kind": self.fields.kind,
            "largest_field": float(np.linalg.norm(self.fields.values, axis=1).max()),
            "counts": self.counts(),
            "reach": (
                None
                if none.all()
                else [np.nanmin(self.tip, axis=0).tolist(), np.nanmax(self.tip, axis=0).tolist()]
            ),
            "cells_across": self.scene.resolution.cells_across,
            "seconds": self.seconds,
            "newton_steps": self.newton_steps,
        }

    def rows(self) -> list[list[Any]]:
        """The table, a row a field, as HEAD names its columns."""

        def cells(values: Array, factor: float) -> list[str]:
            return ["" if np.isnan(v) else f"{factor * v + 0.0:.6g}" for v in values]

        return [
            [
                *cells(b, 1e3),
                *cells(tip, 1e3),
                *cells(np.array([s]), 1.0),
                mark,
                *cells(other, 1e3),
                why,
            ]
            for b, tip, s, mark, other, why in zip(
                self.fields.values,
                self.tip,
                self.stability,
                self.mark.tolist(),
                self.other,
                self.why,
                strict=True,
            )
        ]

    def save(self, folder: Path) -> list[Path]:
        """map.csv and map.json in a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        table = folder / "map.csv"
        numbers = folder / "map.json"
        with whole_file(table) as part, part.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(HEAD)
            writer.writerows(self.rows())

        def plain(values: Array) -> list[Any]:
            return [None if np.isnan(v).any() else v.tolist() for v in values]

        arrays = {
            "field_T": self.fields.values.tolist(),
            "tip_m": plain(self.tip),
            "stability": plain(self.stability),
            "mark": self.mark.tolist(),
            "other_m": plain(self.other),
            "why": self.why,
        }
        write_json(
            numbers,
            {
                **self.summary(),
                "marks": MARKS,
                "scene": self.scene.to_si(),
                "scene_hash": self.scene.hash(),
                **arrays,
            },
        )
        return [table, numbers]


def map_tips(
    scene: Scene, fields: Fields, on_progress: Callable[[int, int], None] | None = None
) -> TipMap:
    """The map of a scene at rest in uniform fields, which take the place of its own. Raises InputError for scenes that have none."""
    check(scene)
    prepare_kernels(scene)
    begun = time.perf_counter()
    count = len(fields.values)
    tip = np.full((count, 3), np.nan)
    stability = np.full(count, np.nan)
    why = [""] * count
    steps = 0
    paths = [[(k, fields.values[k].tolist()) for k in path] for path in fields.paths]
    for done, found in enumerate(solved(scene, paths, os.cpu_count() or 1)):
        if found.tip is not None:
            tip[found.index] = found.tip
        stability[found.index], why[found.index], steps = (
            found.stability,
            found.failure,
            steps + found.steps,
        )
        if on_progress is not None:
            on_progress(done + 1, count)
    rods = rod_tips(scene, fields.values, fields.rays)
    away = np.linalg.norm(rods.tip - tip, axis=1) > 0.1 * scene.length  # they are two shapes
    other = np.where(away[:, None] & np.isnan(rods.other), rods.tip, rods.other)
    mark = np.full(count, "sure", dtype="<U10")
    mark[~np.isnan(other).any(axis=1)] = "two shapes"
    mark[rods.snapped] = "snapped"
    mark[stability <= BRINK] = "unstable"
    mark[np.isnan(tip).any(axis=1)] = "failed"
    return TipMap(
        scene, fields, tip, stability, mark, other, why, time.perf_counter() - begun, steps
    )


def check(scene: Scene) -> None:
    """Raises InputError for a scene without a map."""
    if scene.in_time:
        raise InputError(
            "solver",
            received="a motion",
            rule="a map is one of shapes at rest",
            remedy="write `solver: {static: {}}`",
        )
    shape = scene.body.shape
    if not isinstance(shape, StraightBody) or shape.clamp != "base":
        raise InputError(
            f"body.{scene.body.kind}",
            rule="a map follows rods: a catheter or strip that is held at its base alone",
            remedy="map a scene with such a body",
        )
    if scene.field.varies or scene.field.over_time is not None:
        remedy = (
            "leave out dipoles, magnets, coils, maps and schedules; `magmpm view` moves magnets by"
            " hand"
        )
        raise InputError(
            "field",
            received="a field that varies in space or time",
            rule="a map is one of uniform fields, which take the place of the scene's own",
            remedy=remedy,
        )
    if scene.effects.magnetic_torque is None or not scene.magnetized_regions():
        raise InputError(
            "effects.magnetic_torque",
            received="nothing that a field turns",
            rule="the field must act on the body",
            remedy="name `magnetic_torque: {}`, and magnetize a segment",
        )
