"""Beyond effects: whether a scene needs three dimensions and dynamics; in seconds saved and error added.

Seconds are of a run on two cores of about 2.7 GHz, to a factor of two, from the measured rates of docs/design.md; errors are told from
runs on coarse grids (magmpm.solving.influence).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import MagmpmError
from magmpm.rod.cantilever import is_cantilever
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.solving.influence import Variants, motion_seconds

SOLVE, ORDER, WIDE = 0.1, 3.6, 1.7  # s at 4 cells across and L/D 10; powers of the cells, and of a strip's width
TOO_LONG = "not estimated: a whole run takes too long"
STILL = 5  # equilibria and one, that a motion is compared with
ROD = 0.005  # s, of a rod at rest
# What a rod is off by, over its deflection: with slenderness, as the clamp's share of the length (docs/effects.md, "How sure").
ALWAYS, CLAMPED = 0.005, 0.3


@dataclass(frozen=True)
class Need:
    """One question. needed: None where it is not known; seconds_saved: by doing without (0: nothing to save), error_added_m: m, by that."""

    question: str
    needed: bool | None
    seconds_saved: float | None
    error_added_m: float | None
    why: str


def needs(scene: Scene, runs: Variants) -> list[Need]:
    """The answers for a scene, from runs of it."""
    cost = seconds(scene)
    return [_three_dimensions(scene, runs, cost), _dynamics(scene, runs, cost)]


def seconds(scene: Scene) -> float:
    """About what a run takes, s."""
    if scene.solver.dynamic is not None:
        return motion_seconds(scene)
    return _solve(scene, scene.resolution.cells_across) * max(1, len(scene.path_times()))


def _three_dimensions(scene: Scene, runs: Variants, cost: float) -> Need:
    """A rod would do where what it is off by is less than the error: measured at rest, else guessed from how far the body bends."""
    question, measured = "three dimensions", not scene.in_time
    if scene.body.shape.line is None or (scene.static and not is_cantilever(scene)):
        return Need(question, True, 0.0, None, "the body is no rod")
    if runs.duration < scene.duration:
        return Need(question, None, None, None, TOO_LONG)
    try:
        shapes = np.array(runs.frames(scene, int(measured)).points)
        off = _off(scene, runs, shapes[0]) if measured else _guessed(scene, shapes)
    except MagmpmError as trouble:
        return Need(question, None, None, None, f"not estimated: {trouble}")
    how = "is at most" if measured else "may be"
    why = f"a rod would do for the shape of the axis, and {how}" if off < runs.error else f"a rod {how}"
    flat = "; the axis stays in a plane" if _out_of_plane(shapes) < runs.error else ""
    slender = scene.length / scene.thickness
    why = f"{why} off by {1e3 * off:.2g} mm{flat} (L/D {slender:.3g})"
    return Need(question, not off < runs.error, max(cost - ROD, 0.0) if off < runs.error else 0.0, off, why)


def _off(scene: Scene, runs: Variants, axis: Array) -> float:
    """Distance (m) of the rod from the finer of two equilibria, with the distance of these."""
    rod = solve_rod(scene).at(np.linspace(0.0, scene.length, len(axis)))
    grids = max(runs.frames(scene).distances(runs.frames(scene, 1)).values())
    return grids + float(np.linalg.norm(axis - axis[0] - rod + rod[0], axis=1).max())


def _guessed(scene: Scene, shapes: Array) -> float:
    """Guess of the rod's error, m, from its deflection."""
    strip = scene.body.strip
    across = scene.thickness if strip is None else max(strip.width, strip.thickness)
    return (ALWAYS + CLAMPED * across / scene.length) * _moved(shapes)


def _dynamics(scene: Scene, runs: Variants, cost: float) -> Need:
    """Equilibria along time would do where the field changes slowly for the body's first period, and the body does not swing."""
    question = "dynamics"
    if scene.solver.dynamic is None:
        return Need(question, False, 0.0, 0.0, "the scene asks for equilibria")
    held = [key for key in ("walls", "ground", "self_contact") if getattr(scene.effects, key) is not None]
    if held or scene.body.shape.line is None or scene.body.shape.clamp == "none":
        return Need(question, True, 0.0, None, f"{' and '.join(held) or 'such a body'}: equilibria may miss how it gets there")
    if runs.duration < scene.duration:
        return Need(question, None, None, None, TOO_LONG)
    try:
        moving, data = runs.frames(scene), scene.to_si()
        times = moving.times[:: len(moving.times) // STILL]
        data["solver"]["dynamic"], data["solver"]["quasi_static"] = None, {"at": times}
        for key, kind in scene.effects.every().items():
            data["effects"][key] = None if kind.ONLY_IN_MOTION and not kind.ALONG_TIME else data["effects"][key]
        still = Scene.from_si(data)
        off = max(moving.distances(Variants(still).frames(still)).values())
    except MagmpmError as trouble:
        return Need(question, None, None, None, f"not estimated: {trouble}")
    why = "equilibria along time (solver.quasi_static) would do" if off < runs.error else "the body swings, or lags behind its equilibria"
    saved = max(cost - 9 * _solve(scene, scene.resolution.cells_across), 0.0) if off < runs.error else 0.0
    return Need(question, not off < runs.error, saved, off, why)


def _solve(scene: Scene, cells: int) -> float:
    """About what an equilibrium of the scene's body takes with so many cells across, s; of a strip, with its width."""
    strip = scene.body.strip
    wide = 1.0 if strip is None or strip.plane_strain else max(1.0, (strip.width / strip.thickness) ** WIDE)
    return SOLVE * (cells / 4) ** ORDER * scene.length / (10 * scene.thickness) * wide


def _moved(shapes: Array) -> float:
    """The farthest (m) any point of the axis is from where it would be straight."""
    straight = np.linspace(0.0, 1.0, shapes.shape[1])[None, :, None] * np.array([1.0, 0.0, 0.0])
    length = np.linalg.norm(np.diff(shapes[0], axis=0), axis=1).sum()
    return float(np.linalg.norm(shapes - shapes[:, :1] - length * straight, axis=2).max())


def _out_of_plane(shapes: Array) -> float:
    """The farthest (m) the axis leaves the plane through its base and x that fits it best."""
    yz = (shapes - shapes[:, :1])[..., 1:].reshape(-1, 2)
    normal = np.linalg.svd(yz, full_matrices=False)[2][-1]
    return float(np.abs(yz @ normal).max())
