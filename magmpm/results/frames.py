"""Frames of runs, and the distance between those of two runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array
from magmpm.model import build
from magmpm.results.measures import of_particles
from magmpm.results.result import Result
from magmpm.scene import Scene

if TYPE_CHECKING:
    from magmpm.results.trajectory import Motion

STATIONS = 41  # along a body, where axes are compared


@dataclass
class Frames:
    """Frames of a run to compare: time (s), points (m, 3) m and tip (3,) m of each; and the times (s) of jumps of a path."""

    times: list[float] = field(default_factory=list)
    points: list[Array] = field(default_factory=list)
    tips: list[Array] = field(default_factory=list)
    jumps: list[float] = field(default_factory=list)

    def see(self, time: float, axis: Array, tip: Array, centers: Array) -> None:
        """Add a frame (solving.solve.OnFrame)."""
        along = np.linspace(0.0, axis[-1, 0], STATIONS) if len(axis) else None
        self.times.append(time)
        self.points.append(centers.copy() if along is None else on_rows(axis[:, 0], axis[:, 1:], along)[0])
        self.tips.append(np.array(tip))

    def distances(self, other: Frames, of: str = "centreline", skip: list[tuple[float, float]] | None = None) -> dict[float, float]:
        """The largest distance (m) in each frame that both have, by its time (s); spans of time (s) to `skip` are left out."""
        mine, theirs = (one.tips if of == "tip" else one.points for one in (self, other))
        return {
            t: float(np.linalg.norm(np.atleast_2d(a - b), axis=1).max())
            for t, a, b in zip(self.times, mine, [theirs[other.times.index(t)] if t in other.times else None for t in self.times])
            if b is not None and not any(first <= t <= last for first, last in skip or ())
        }  # fmt: skip


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
    the true jump is not farther from theirs than they are from each other, about (statics.error_estimate)."""
    pairs = [(min(a, b), max(a, b)) for a, b in zip(one.jumps, other.jumps)]
    return [(2 * first - last, 2 * last - first) for first, last in pairs]
