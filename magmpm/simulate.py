"""run(scene) -> Result: one simulation, as the scene says."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from magmpm import measures
from magmpm.basis import Array
from magmpm.errors import SolveError
from magmpm.model import Model, build
from magmpm.results import Result
from magmpm.scene import Scene
from magmpm.statics.equilibrium import Equilibrium, solve_static
from magmpm.warmup import prepare_kernels

Progress = Callable[[int, float], None]


def run(scene: Scene, *, start: Result | None = None, on_progress: Progress | None = None) -> Result:
    """Simulate a scene.

    start: result of a neighbouring design on the same grid, to begin from; on_progress(step, decrement) is told of each Newton step.
    Raises SolveError where no equilibrium is found; its state is the last good Result (converged False), or None.
    """
    begun = time.perf_counter()
    model = build(scene)
    compiled = prepare_kernels(scene)
    setup = time.perf_counter() - begun - compiled
    begun = time.perf_counter()
    try:
        found = solve_static(model, correction=_neighbour(model, start), on_step=on_progress)
    except SolveError as error:
        seconds = {"setup": setup, "compile": compiled, "solve": time.perf_counter() - begun}
        state = _result(model, error.state, seconds) if isinstance(error.state, Equilibrium) else None
        raise SolveError(error.reason, state) from None
    return _result(model, found, {"setup": setup, "compile": compiled, "solve": time.perf_counter() - begun})


def _neighbour(model: Model, start: Result | None) -> Array | None:
    """What the neighbour's solve added to its rod's shape: nearly the same for this design."""
    if start is None:
        return None
    if start.grid_correction.shape != (model.layout.planes, model.layout.m):
        raise ValueError("start: the neighbouring result must be on the same grid")
    return start.grid_correction


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in ("magmpm", "numpy", "scipy", "numba"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _result(model: Model, found: Equilibrium, seconds: dict[str, float]) -> Result:
    scene, point, particles = model.scene, found.point, model.particles
    position = point.position
    rest = np.array(scene.field.uniform) if scene.effects.magnetic_torque is not None else np.zeros(3)
    return Result(
        name=scene.name,
        scene=scene.to_si(),
        scene_hash=scene.hash(),
        particle_reference=particles.position,
        particle_position=position,
        particle_volume=particles.volume,
        particle_segment=particles.segment,
        particle_det_F=np.linalg.det(point.F),
        segment_center=measures.piece_means(model, position),
        segment_remanence=measures.piece_means(model, np.einsum("nij,nj->ni", point.F, model.magnet)),
        grid_correction=found.correction,
        centreline=measures.centreline(model, point.grid),
        tip=measures.tip(model, point.grid, position),
        field=rest,
        converged=found.converged,
        iterations=found.steps,
        particles=len(position),
        dof=model.dof,
        min_det_F=point.min_det_F,
        max_det_F=point.max_det_F,
        energy=point.energy,
        section=model.section,
        seconds=seconds,
        warnings=scene.warnings() + found.warnings,
        versions=_versions(),
    )
