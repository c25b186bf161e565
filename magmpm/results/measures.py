"""Measures of a deformed body: the axis through its particles, the middle of its regions, its distance from a target shape;
and the frames of runs, with the distance between those of two.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from magmpm.bodies.curves import STATIONS, on_rows
from magmpm.compiled.arrays import Array
from magmpm.errors import InputError
from magmpm.materials import magnetization
from magmpm.model import Model, build
from magmpm.results.result import Result
from magmpm.scene import Scene

if TYPE_CHECKING:
    from magmpm.results.trajectory import Motion

NO_TIP = "a body of parts has no tip unless the scene names one"
NAME_ONE = "name a part or a point, say `tip: arm` in body.parts"


def region_magnetization(model: Model, F: Array) -> Array:
    """Mean magnetization (k, 3) T of each region, F Br or R Br, for F (n, 3, 3)."""
    return region_means(model, magnetization(model.rotating, model.remanence[:, :3], F))


def region_means(model: Model, values: Array) -> Array:
    """Mean over each region's volume, (k, m), of values (n, m) at the particles."""
    particles = model.particles
    count = len(model.scene.regions())
    share = np.zeros((count, len(values)))
    share[particles.segment, np.arange(len(values))] = particles.volume
    share /= share.sum(axis=1, keepdims=True)
    return share @ values


def axis_of_particles(model: Model, position: Array) -> Array:
    """Rows [s, x, y, z] (2 cells + 1, 4) m of a straight body's axis from its particles alone; none for a body without an axis.

    position (n, 3) m: deformed. The means of the sections are fitted by the splines along the axis, by least squares: for a
    displacement that these splines hold this is the mean of the section exactly, whatever moved the particles.
    """
    if model.line is None:
        return np.zeros((0, 4))
    x, of = np.unique(model.particles.position[:, 0], return_inverse=True)
    volume = np.bincount(of, model.particles.volume)
    mean = np.stack(
        [np.bincount(of, model.particles.volume * p) / volume for p in position.T], axis=1
    )
    root = np.sqrt(volume)[:, None]
    s = model.grid.stations
    splines = model.grid.matrix_along(x - model.line.base[0])
    coefficients = np.linalg.lstsq(root * splines, root * mean, rcond=None)[0]
    return np.column_stack([s, model.grid.matrix_along(s) @ coefficients])


def centreline_at(result: Result, s: Array) -> Array:
    """Positions (m, 3) m of the deformed axis at arc lengths s (m,) m, 0 to the length.

    Exact: between the rows of a cell the axis is a parabola. Raises ValueError for s outside the body.
    """
    return on_rows(result.centreline[:, 0], result.centreline[:, 1:], s)[0]


def largest_distance(result: Result, target: Array) -> float:
    """Largest distance (m) between the axis and target rows [s, x, y, z] (m, 4) m, at the same arc lengths."""
    return float(np.linalg.norm(centreline_at(result, target[:, 0]) - target[:, 1:], axis=1).max())


def tip_of(result: Result) -> Array:
    """The tip (3,) m of a body that has one. Raises InputError for parts that name none."""
    if result.tip is None:
        raise InputError("tip", received="nothing", rule=NO_TIP, remedy=NAME_ONE)
    return result.tip


def named_tip(model: Model, x: Array) -> Array | None:
    """Position (3,) m of the tip that a body of parts names, with its particles at x (n, 3) m; None where it names none."""
    return None if model.tip_weights is None else model.tip_weights @ x


def of_particles(model: Model, x: Array) -> tuple[Array, Array | None, Array]:
    """Axis rows, tip and centers of regions of a body in motion, as Frames.see takes them. x (n, 3) m: its particles."""
    axis = axis_of_particles(model, x)
    return axis, axis[-1, 1:] if len(axis) else named_tip(model, x), region_means(model, x)


@dataclass
class Frames:
    """Frames of a run to compare: time (s), points (m, 3) m and tip (3,) m of each; and the times (s) of jumps of a path.

    Points: of the axis; of parts their centers, and the tip if one is named (None otherwise).
    """

    times: list[float] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    tips: list[Array | None] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)

    def see(self, time: float, axis: Array, tip: Array | None, centers: Array) -> None:
        """Add a frame (solving.solve.OnFrame)."""
        self.times.append(time)
        self.tips.append(None if tip is None else np.array(tip))
        if len(axis):
            along = np.linspace(0.0, axis[-1, 0], STATIONS)
            self.points.append(on_rows(axis[:, 0], axis[:, 1:], along)[0])
        else:
            self.points.append(centers.copy() if tip is None else np.vstack([centers, tip]))

    def ends(self) -> list[Array]:
        """The tips (3,) m. Raises InputError where the body has none."""
        found = [tip for tip in self.tips if tip is not None]
        if len(found) < len(self.tips):
            raise InputError("tip", received="nothing", rule=NO_TIP, remedy=NAME_ONE)
        return found

    def minus(self, other: Frames) -> Frames:
        """The way from another run's points and tip to these, m, in each frame that both have; times agree but for rounding."""
        found = Frames()
        for k, t in enumerate(self.times):
            at = [j for j, u in enumerate(other.times) if math.isclose(t, u, rel_tol=1e-9)]
            if not at:
                continue
            mine = self.tips[k]
            theirs = other.tips[at[0]]
            found.times.append(t)
            found.points.append(self.points[k] - other.points[at[0]])
            found.tips.append(None if mine is None or theirs is None else mine - theirs)
        return found

    def sizes(
        self, of: str = "centreline", skip: Sequence[tuple[float, float]] = ()
    ) -> dict[float, float]:
        """The farthest (m) that a point is from the origin in each frame, by its time (s); spans of time (s) to `skip` are left out.

        of: tip, for that of tips. Raises InputError where the body has none.
        """
        vectors = self.ends() if of == "tip" else self.points
        return {
            t: float(np.linalg.norm(np.atleast_2d(each), axis=1).max())
            for t, each in zip(self.times, vectors, strict=True)
            if not any(first <= t <= last for first, last in skip)
        }

    def distances(
        self, other: Frames, of: str = "centreline", skip: Sequence[tuple[float, float]] = ()
    ) -> dict[float, float]:
        """The largest distance (m) in each frame that both have, as `sizes` of `minus`."""
        return self.minus(other).sizes(of, skip)


def frames_of(run: Result | Motion) -> Frames:
    """The frames of a saved motion or path; of a Result its end alone."""
    frames = Frames()
    if isinstance(run, Result):
        frames.see(run.time, run.centreline, run.tip, run.segment_center)
        return frames
    scene = Scene.from_si(run.scene or {})
    model = build(scene, time=0.0 if scene.static else None)
    for k, t in enumerate(run.times):
        frames.see(float(t), *of_particles(model, np.asarray(run.position(k), dtype=float)))
    return frames


def near_jumps(one: Frames, other: Frames) -> list[tuple[float, float]]:
    """Spans of time (s) in which two grids of a path may be on different branches: from jump to jump, and as long before and after, since
    the true jump is not farther from theirs than they are from each other, about (statics.error_estimate).
    """
    pairs = [(min(a, b), max(a, b)) for a, b in zip(one.jumps, other.jumps)]
    return [(2 * first - last, 2 * last - first) for first, last in pairs]
