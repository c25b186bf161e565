"""Beyond effects: whether a scene needs three dimensions, dynamics and its particles; in seconds saved and error added.

Seconds are of a run on two cores of about 2.7 GHz, to a factor of two, from the measured rates of docs/design.md; errors are the rod's
(magmpm.rod.shifts), so there are none where the body is no rod.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import MagmpmError
from magmpm.results.measures import on_rows
from magmpm.rod.shifts import STATIONS, RodAnswers, flat_stiffening, is_rod
from magmpm.scene import Scene
from magmpm.scene.coarsest import coarsest_cells
from magmpm.simulate import run

RATE = 15e6  # particle-steps a second, whole runs of motion
STABLE = 0.72  # of the time of a pressure wave through a cell: a step
SOLVE, ORDER, WIDE = 0.1, 3.6, 1.7  # s at 4 cells across and L/D 10; powers of the cells, and of a strip's width
ROD = 0.005  # s, of a rod at rest
PROOF = 4.0  # times a solve on the coarsest grid: what its error takes in all
MEASURED = 1.0  # s: where an equilibrium and its error take longer, the rod is not compared with it
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


def needs(scene: Scene, answers: RodAnswers, error: float) -> list[Need]:
    """The answers for a scene whose answer may be off by an error, m."""
    cost = seconds(scene)
    return [_three_dimensions(scene, answers, error, cost), _dynamics(scene, answers, error, cost), _particles(scene, cost)]


def seconds(scene: Scene) -> float:
    """About what a run takes, s."""
    cells = scene.resolution.cells_across
    if scene.solver.dynamic is None:
        return _solve(scene, cells) * max(1, len(scene.path_times()))
    used = [scene.materials[region.material_name] for region in scene.regions()]
    wave = max(math.sqrt(m.shear_modulus * (m.bulk_to_shear + 4 / 3) / (m.density or math.inf)) for m in used)
    low, high = scene.box()
    particles = float(np.prod((np.array(high) - low) / scene.cell)) * scene.resolution.particles_per_cell**3
    steps = scene.duration * wave / (STABLE * scene.cell) if wave > 0 else 0.0
    return particles * steps / RATE


def _three_dimensions(scene: Scene, answers: RodAnswers, error: float, cost: float) -> Need:
    """A rod would do where what it is off by is less than the error."""
    question = "three dimensions"
    if not is_rod(scene):
        return Need(question, True, 0.0, None, "the body is no rod")
    try:
        shapes = answers.shapes(scene)
        measured = _measured(scene, shapes, error)
        off = _guessed(scene, shapes) if measured is None else measured
        off += float(np.linalg.norm(shapes - answers.shapes(scene, 1), axis=2).max())
    except MagmpmError as trouble:
        return Need(question, None, None, None, f"not estimated: {trouble}")
    how = "may be" if measured is None else "is at most"
    why = f"a rod would do for the shape of the axis, and {how}" if off < error else f"a rod {how}"
    flat = "; the axis stays in a plane" if _out_of_plane(shapes) < error else ""
    slender = scene.length / scene.thickness
    why = f"{why} off by {1e3 * off:.2g} mm{flat} (L/D {slender:.3g})"
    return Need(question, not off < error, max(cost - ROD, 0.0) if off < error else 0.0, off, why)


def _measured(scene: Scene, shapes: Array, error: float) -> float | None:
    """Distance (m) of the rod from an equilibrium whose own error is known, with that error; None where this would take too long."""
    cells = coarsest_cells(scene)
    if scene.in_time or PROOF * _solve(scene, cells) > MEASURED:
        return None
    data = scene.to_si()
    data["resolution"] = {"error": f"{error / 2!r} m"}
    try:
        result = run(Scene.from_si(data))
    except MagmpmError:  # no grid within reach tells it
        return None
    assert result.error_estimate is not None
    rows = result.centreline
    axis = on_rows(rows[:, 0], rows[:, 1:], np.linspace(0.0, rows[-1, 0], STATIONS))[0]
    return float(np.linalg.norm(axis - axis[0] - (shapes[0] - shapes[0, 0]), axis=1).max()) + result.error_estimate


def _guessed(scene: Scene, shapes: Array) -> float:
    """Guess of the rod's error, m, from its deflection."""
    strip = scene.body.strip
    across = scene.thickness if strip is None else max(strip.width, strip.thickness)
    return (ALWAYS + CLAMPED * across / scene.length + 2.0 * flat_stiffening(scene)) * _moved(shapes)


def _dynamics(scene: Scene, answers: RodAnswers, error: float, cost: float) -> Need:
    """Equilibria along time would do where the field changes slowly for the body's first period, and the body does not swing."""
    question = "dynamics"
    if scene.solver.dynamic is None:
        return Need(question, False, 0.0, 0.0, "the scene asks for equilibria")
    held = [key for key in ("walls", "ground", "self_contact") if getattr(scene.effects, key) is not None]
    if held or not is_rod(scene) or scene.body.shape.clamp != "base":
        return Need(question, True, 0.0, None, f"{' and '.join(held) or 'such a body'}: rods do not tell what equilibria would miss")
    data = scene.to_si()
    data["solver"]["dynamic"], data["solver"]["quasi_static"] = None, {"at": np.linspace(0.0, scene.duration, 9).tolist()}
    for key, kind in scene.effects.every().items():
        data["effects"][key] = None if kind.ONLY_IN_MOTION and not kind.ALONG_TIME else data["effects"][key]
    try:
        still = Scene.from_si(data)
        moving, at_rest = answers.shapes(scene), RodAnswers(still).shapes(still)
    except MagmpmError as trouble:
        return Need(question, None, None, None, f"not estimated: {trouble}")
    stations = np.linspace(0, len(moving) - 1, len(at_rest)).round().astype(int)
    off = float(np.linalg.norm(moving[stations] - at_rest, axis=2).max())
    why = "equilibria along time (solver.quasi_static) would do" if off < error else "the body swings, or lags behind its equilibria"
    saved = max(cost - 9 * _solve(scene, scene.resolution.cells_across), 0.0) if off < error else 0.0
    return Need(question, not off < error, saved, off, why)


def _solve(scene: Scene, cells: int) -> float:
    """About what an equilibrium of the scene's body takes with so many cells across, s; of a strip, with its width."""
    strip = scene.body.strip
    wide = 1.0 if strip is None or strip.plane_strain else max(1.0, (strip.width / strip.thickness) ** WIDE)
    return SOLVE * (cells / 4) ** ORDER * scene.length / (10 * scene.thickness) * wide


def _particles(scene: Scene, cost: float) -> Need:
    """Two a direction integrate what a cell's splines can tell; more are exact too, and cost."""
    each = scene.resolution.particles_per_cell
    if each == 2:
        return Need("particles per cell", True, 0.0, None, "2 a direction are the fewest that carry a cell's second moments")
    saved = cost * (1 - (2 / each) ** 3) if scene.solver.dynamic is not None else 0.3 * cost * (1 - (2 / each) ** 3)
    return Need("particles per cell", False, saved, 0.0, f"2 a direction are exact for a section's second moments as {each} are")


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
