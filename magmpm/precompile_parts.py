"""The kernels of a scene in parts that can be compiled apart, each by doing a little of what a run does.

Longest first. In statics the tangent, the residual and the energy depend on the effects, in motion the steps and what is measured of a
frame; the rest is the same for every combination.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable

import numpy as np

from magmpm.compiled.cache import kept_all
from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.results.strain import strain_of
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.statics.axis_order import arranged
from magmpm.statics.block_cholesky import factor, new_panels, solve
from magmpm.statics.energy import Energy, Point
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model
from magmpm.statics.rod_start import straight


def parts_of(small: Scene) -> list[str]:
    """Names of a scene's parts, longest first."""
    if small.solver.dynamic is None:
        return list(_STATIC)
    return list(_TOTAL if formulation_of(small) == "total" else _UPDATED)


def formulation_of(scene: Scene) -> str:
    """Of a scene that moves."""
    from magmpm.dynamics.time_loop import formulation  # only for motion: statics needs none of it in memory

    return formulation(scene)


def solve_small(small: Scene) -> None:
    """Solve a coarse scene: it calls every kernel; its answer is not used, and may well not exist."""
    with contextlib.suppress(SolveError):
        if small.solver.dynamic is not None:
            from magmpm.dynamics.time_loop import move

            move(build(small))
        else:
            solve_static(static_model(build(small)))


def serve() -> None:
    """Compile parts that are named on stdin, a line each, until it ends; `done` on stdout after each, or `not kept`."""
    for line in sys.stdin:
        part, small = json.loads(line)
        scene = Scene.from_si(json.loads(small))
        work = {"whole": solve_small, **_STATIC, **_TOTAL, **_UPDATED}[part]
        with contextlib.suppress(SolveError):
            work(scene)
        print("done" if kept_all() else "not kept", flush=True)


def _tangent(small: Scene) -> None:
    energy = Energy(arranged(static_model(build(small)))[0])
    model, n = energy.model, len(energy.model.shear)
    rest = np.tile(energy.rest_gradient, (n, 1, 1))
    energy.tangent(Point(straight(model), np.zeros((n, 3)), model.particles.position, rest, 0.0, 1.0, 1.0))


def _energy(small: Scene) -> None:
    energy = Energy(arranged(static_model(build(small)))[0])
    energy.residual(energy.at(straight(energy.model)))


def _rod(small: Scene) -> None:
    if small.body.shape.clamp == "base":
        solve_rod(small)


def _factorization(small: Scene) -> None:
    panels = new_panels(4, 3)
    panels[:4] = np.eye(3, 9)
    factor(panels, 2)
    solve(panels, 2, np.ones((4, 3)))


def _total_steps(small: Scene) -> None:
    from magmpm.dynamics.total_lagrangian import TotalMotion

    model = build(small)
    TotalMotion(model).advance(1, 1e-12, model.effects)


def _total_rest(small: Scene) -> None:
    from magmpm.dynamics.stable_step import body_step
    from magmpm.dynamics.total_lagrangian import TotalMotion

    body_step(TotalMotion(build(small)))


def _updated_steps(small: Scene) -> None:
    from magmpm.dynamics.apic import UpdatedMotion

    model = build(small)
    UpdatedMotion(model).advance(1, 1e-12, model.effects)


def _updated_rest(small: Scene) -> None:
    from magmpm.dynamics.apic import UpdatedMotion

    motion = UpdatedMotion(build(small))
    motion.sort()
    motion._relax()


def _measured(small: Scene) -> None:
    from magmpm.dynamics import energies, watchdog
    from magmpm.results.frame_arrays import FrameArrays

    model = build(small)
    x, F = model.particles.position, np.tile(np.eye(3), (len(model.density), 1, 1))
    _, P = energies.elastic(model, F, True)
    energies.add_effects_stress(model, x, F, model.effects, P)
    energies.effect_energies(model, x, F, 0.0)
    watchdog.look(model, x, np.zeros_like(x))
    strain_of(model, x, F)
    FrameArrays(x, model.magnet[:, :3]).of(x, x, F, P)


_STATIC: dict[str, Callable[[Scene], None]] = {
    "tangent": _tangent, "rod": _rod, "energy": _energy, "factorization": _factorization,
}  # fmt: skip
_TOTAL: dict[str, Callable[[Scene], None]] = {"total steps": _total_steps, "total rest": _total_rest, "measured": _measured}
_UPDATED: dict[str, Callable[[Scene], None]] = {"updated steps": _updated_steps, "updated rest": _updated_rest, "measured": _measured}
