"""The map: where the tip is in each field, and a mark where it is not sure to be there."""

from __future__ import annotations

import csv
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, report
from magmpm.results.whole_file import whole_file, write_json
from magmpm.scene import Scene
from magmpm.solving.precompile import prepare_kernels
from magmpm.studies.explore.tip_map.fields import Fields
from magmpm.studies.explore.tip_map.processes import solved
from magmpm.studies.explore.tip_map.rods import rod_tips

BRINK = 0.02  # of the unloaded body's least stiffness, as `magmpm run` warns: a shape below is as good as unstable
LEFT = 0.1  # of the length, between the tips of solve and rod: they are two shapes
MARKS = {  # from the worst to the best
    "failed": "no shape at rest was found",
    "unstable": f"stability at most {BRINK:g}: on the edge of another shape",
    "snapped": "the shape jumps on the way up to this field",
    "two shapes": "another stable shape exists: history decides",
    "sure": "one stable shape",
}
HEAD = ("Bx_mT", "By_mT", "Bz_mT", "x_mm", "y_mm", "z_mm", "stability", "mark", "other_x_mm", "other_y_mm", "other_z_mm", "why")


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

    def summary(self) -> dict[str, Any]:
        """Plain data, SI, for --json."""
        none = np.isnan(self.tip).any(axis=1)
        return {
            "fields": len(self.tip),
            "kind": self.fields.kind,
            "largest_field": float(np.linalg.norm(self.fields.values, axis=1).max()),
            "counts": self.counts(),
            "reach": None if none.all() else [np.nanmin(self.tip, axis=0).tolist(), np.nanmax(self.tip, axis=0).tolist()],
            "cells_across": self.scene.resolution.cells_across,
            "seconds": self.seconds,
            "newton_steps": self.newton_steps,
        }

    def rows(self) -> list[list[Any]]:
        """The table, a row a field, as HEAD names its columns."""
        def cells(values: Array, factor: float) -> list[str]:
            return ["" if np.isnan(v) else f"{factor * v + 0.0:.6g}" for v in values]

        return [
            [*cells(b, 1e3), *cells(tip, 1e3), *cells(np.array([s]), 1.0), mark, *cells(other, 1e3), why]
            for b, tip, s, mark, other, why in zip(
                self.fields.values, self.tip, self.stability, self.mark.tolist(), self.other, self.why, strict=True
            )
        ]

    def save(self, folder: Path) -> list[Path]:
        """map.csv and map.json in a folder."""
        folder.mkdir(parents=True, exist_ok=True)
        table, numbers = folder / "map.csv", folder / "map.json"
        with whole_file(table) as part, part.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(HEAD)
            writer.writerows(self.rows())

        def plain(values: Array) -> list[Any]:
            return [None if np.isnan(v).any() else v.tolist() for v in values]

        arrays = {"field_T": self.fields.values.tolist(), "tip_m": plain(self.tip), "stability": plain(self.stability),
                  "mark": self.mark.tolist(), "other_m": plain(self.other), "why": self.why}  # fmt: skip
        write_json(numbers, {**self.summary(), "marks": MARKS, "scene": self.scene.to_si(), "scene_hash": self.scene.hash(), **arrays})
        return [table, numbers]


def map_tips(scene: Scene, fields: Fields, on_progress: Callable[[int, int], None] | None = None) -> TipMap:
    """The map of a scene at rest in uniform fields, which take the place of its own. Raises InputError for scenes that have none."""
    check(scene)
    prepare_kernels(scene)
    begun = time.perf_counter()
    count = len(fields.values)
    tip, stability, why, steps = np.full((count, 3), np.nan), np.full(count, np.nan), [""] * count, 0
    paths = [[(k, fields.values[k].tolist()) for k in path] for path in fields.paths]
    for done, found in enumerate(solved(scene, paths, os.cpu_count() or 1)):
        if found.tip is not None:
            tip[found.index] = found.tip
        stability[found.index], why[found.index], steps = found.stability, found.failure, steps + found.steps
        if on_progress is not None:
            on_progress(done + 1, count)
    rods = rod_tips(scene, fields.values, fields.rays)
    away = np.linalg.norm(rods.tip - tip, axis=1) > LEFT * scene.length
    other = np.where(away[:, None] & np.isnan(rods.other), rods.tip, rods.other)
    mark = np.full(count, "sure", dtype="<U10")
    mark[~np.isnan(other).any(axis=1)] = "two shapes"
    mark[rods.snapped] = "snapped"
    mark[stability <= BRINK] = "unstable"
    mark[np.isnan(tip).any(axis=1)] = "failed"
    return TipMap(scene, fields, tip, stability, mark, other, why, time.perf_counter() - begun, steps)


def check(scene: Scene) -> None:
    """Raises InputError for a scene without a map."""
    if scene.in_time:
        rule, remedy = "a map is one of shapes at rest", "write `solver: {static: {}}`"
        raise InputError(report("solver", received="a motion", rule=rule, remedy=remedy))
    shape = scene.body.shape
    if not isinstance(shape, StraightBody) or shape.clamp != "base":
        rule, remedy = "a map follows rods: a catheter or strip that is held at its base alone", "map a scene with such a body"
        raise InputError(report(f"body.{scene.body.kind}", rule=rule, remedy=remedy))
    if scene.field.varies or scene.field.over_time is not None:
        rule = "a map is one of uniform fields, which take the place of the scene's own"
        remedy = "leave out dipoles, magnets, coils, maps and schedules; `magmpm view` moves magnets by hand"
        raise InputError(report("field", received="a field that varies in space or time", rule=rule, remedy=remedy))
    if scene.effects.magnetic_torque is None or not scene.magnetized_regions():
        rule, remedy = "the field must act on the body", "name `magnetic_torque: {}`, and magnetize a segment"
        raise InputError(report("effects.magnetic_torque", received="nothing that a field turns", rule=rule, remedy=remedy))
