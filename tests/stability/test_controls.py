"""Controls of the hard cases: each case again, with the remedy switched off that it is about. It must then fail.

A case that a weak code would pass as well tells nothing. A switch replaces a function or a constant of the solver for as long as the
control runs, or changes the scene, where the remedy has a key there. `make stability CONTROLS=1` runs them.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from magmpm.bodies.catheter import Catheter
from magmpm.compiled.arrays import Array
from magmpm.dynamics import time_loop
from magmpm.errors import SolveError
from magmpm.results.motion_tables import GrowingTable
from magmpm.scene import Scene
from magmpm.statics import branch, equilibrium, newton
from magmpm.statics.energy import Energy, Point
from magmpm.statics.rod_start import straight
from magmpm.studies.hard_cases import CASES, Case, equilibria, motions


@dataclass(frozen=True)
class Control:
    """A remedy that is switched off: what it is, a context that does it, and a change of the scene; either may be nothing."""

    remedy: str
    off: Callable[[], AbstractContextManager[None]] = nullcontext
    scene: Callable[[Scene], Scene] = lambda scene: scene

    def measured(self, case: Case) -> float:
        """The measure of a case without the remedy. What a crippled solver raises counts as infinite, but no InputError."""
        try:
            with self.off():
                return float(case.measure(self.scene(case.scene())))
        except (SolveError, ArithmeticError, ValueError, IndexError):
            return np.inf


@contextmanager
def put(owner: Any, name: str, value: Any) -> Iterator[None]:
    """owner.name is `value` in this context."""
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


def _refuse(*_: Any, **__: Any) -> Any:
    raise SolveError("switched off")


def _full_step(energy: Any, point: Any, direction: Any, *_: Any) -> Any:
    return energy.at(point.grid + direction)


def _at_once(model: Any, _: int, on_step: Any, warnings: list[str]) -> Any:
    energy = Energy(model)
    options = model.scene.solver.static
    begin = straight(model)
    found = newton.minimize(
        energy, begin, tolerance=options.tolerance, max_steps=options.max_steps, on_step=on_step
    )
    return equilibrium.Equilibrium(
        found.point, found.steps, np.zeros_like(begin), warnings, energy=energy
    )


def _stay(energy: Energy, point: Point, residual: Array, attempt: int) -> Point:
    """No search along the mode in which a body buckles."""
    return point


@contextmanager
def _no_way_from_the_rod() -> Iterator[None]:
    """Statics begins with the straight body and the whole load, and takes full Newton steps."""
    at_once = put(equilibrium, "_ramp", _at_once)
    with (
        put(equilibrium, "solve_rod", _refuse),
        at_once,
        put(newton, "_search", _full_step),
        put(newton, "_along_mode", _stay),
    ):
        yield


@contextmanager
def _stops_short() -> Iterator[None]:
    """A solve keeps a thousandth of what it began from."""
    solved = equilibrium.minimize

    def short(energy: Energy, begin: Array, **options: Any) -> newton.Minimum:
        found = solved(energy, begin, **options)
        return replace(found, point=energy.at(0.999 * found.point.grid + 0.001 * begin))

    with put(equilibrium, "minimize", short):
        yield


@contextmanager
def _stays_where_it_is() -> Iterator[None]:
    """Newton's method never leaves a stationary point that is no minimum, and no rod has buckled before."""
    with (
        put(equilibrium, "solve_rod", _refuse),
        put(newton, "_leave", lambda energy, residual, attempt: 0.0 * residual),
    ):
        yield


@contextmanager
def _equal_particles() -> Iterator[None]:
    """Each particle stands for the same volume, as on a lattice, however little of a cell the body fills."""
    made = Catheter.discretize

    def alike(self: Catheter, *given: Any, **named: Any) -> Any:
        found = made(self, *given, **named)
        volume = found.particles.volume
        return replace(
            found, particles=replace(found.particles, volume=np.full_like(volume, volume.mean()))
        )

    with put(Catheter, "discretize", alike):
        yield


@contextmanager
def _no_reason() -> Iterator[None]:
    with put(time_loop, "_stopped", lambda state, trouble: SolveError("step -1: failed")):
        yield


def _as_it_was(self: branch.EquilibriumPath, target: float) -> branch.Reached:
    begin = self.loads.carried(self.now.point.grid, self.now.time, target)
    return branch.Reached(
        target, branch.point_of(self.loads.at(target), begin), self.now.lowest, 0, self.now.step
    )


def _scene(change: Callable[[dict[str, Any]], None]) -> Callable[[Scene], Scene]:
    def changed(scene: Scene) -> Scene:
        data = scene.to_si()
        change(data)
        return Scene.from_si(data)

    return changed


def _no_effect(name: str) -> Callable[[Scene], Scene]:
    return _scene(lambda data: data["effects"].update({name: None}))


def _given_step(scene: Scene) -> Scene:
    _, step, _ = motions.at_rest(scene)
    data = scene.to_si()
    data["solver"]["dynamic"]["time_step"] = step
    return Scene.from_si(data)


def off(owner: Any, name: str, value: Any) -> Callable[[], AbstractContextManager[None]]:
    """A switch: owner.name is `value`."""
    return lambda: put(owner, name, value)


TWICE = Control("a step below the bound: here twice the bound", off(motions, "FACTOR", 2.5))
LOSSES = Control("losses in the material", scene=_no_effect("viscosity"))
LOCKS = Control(
    "anti-locking (F-bar)", scene=_scene(lambda data: data["solver"].update(anti_locking="none"))
)
TOUCHING = Control("self-contact", scene=_no_effect("self_contact"))
FROM_STRAIGHT = Control("start from the rod, load ramp and line search", _no_way_from_the_rod)

CONTROLS = {  # by the beginning of a case's name
    "antiparallel field through buckling": Control(
        "leaving equilibria that are not minima", _stays_where_it_is
    ),
    "twist about the long axis": Control(
        "the torque as a stress that is not symmetric", scene=_no_effect("magnetic_torque")
    ),
    "K/G from 20 to 500": LOCKS,
    "no load, begun from a loaded neighbor": Control(
        "steps to the minimum: here a thousandth of the way is left", _stops_short
    ),
    "loaded and unloaded": Control(
        "damping that lets the body settle", scene=_no_effect("damping")
    ),
    "field switched on at once": TWICE,
    "time step 0.9 of the bound": TWICE,
    "time step 1.2 of the bound": Control("the reason of a stop, with step and bound", _no_reason),
    "K/G = 500 in motion": LOCKS,  # of the motion: statics, with which it is compared, keeps it
    "stiffness contrast 1:100": Control(
        "damping that lets the body settle", scene=_no_effect("damping")
    ),
    "field rotating at the first bending frequency": TWICE,
    "a magnet brought close": Control(
        "damping that lets the body settle", scene=_no_effect("damping")
    ),
    "8 offsets": Control("particles by exact quadrature of cut cells", _equal_particles),
    "64 offsets": Control("particles by exact quadrature of cut cells", _equal_particles),
    "rotation by 360 degrees": TWICE,
    "det F down to 0.2": Control("a step that adapts to large strain", scene=_given_step),
    "a block sticks on a steep slope": LOSSES,
    "a block hits the ground": Control("the ground", scene=_no_effect("ground")),
    **dict.fromkeys(
        (
            "blocks collide",
            "a corner hits",
            "edges cross",
            "a block hits a sheet",
            "stack of five",
            "folding onto",
        ),
        TOUCHING,
    ),
    "folded, held and let open": Control(
        "damping that lets the body settle", scene=_no_effect("damping")
    ),
    "snap-through": Control(
        "the fall from the end of a branch", off(branch.EquilibriumPath, "_fall", _refuse)
    ),
    "twist past its critical load": Control(
        "leaving equilibria that are not minima", _stays_where_it_is
    ),
    "ten times the design load": FROM_STRAIGHT,
    "parts of two cells": LOCKS,
    "stiff inclusion": FROM_STRAIGHT,
    "needle, L/D 200": FROM_STRAIGHT,
    "thin tube bent until it kinks": Control(
        "the limit of thin tubes (Brazier)", off(Catheter, "kink_radius", lambda self, poisson: 0.0)
    ),
    "thin tube": LOCKS,
    "stress without ringing": LOCKS,
    "magnet passed at one diameter": Control(
        "equilibrium iterations at each moment", off(branch.EquilibriumPath, "_attempt", _as_it_was)
    ),
    "field reversed at once": TWICE,
    "drift in 10^6 steps": TWICE,
    "restart at every checkpoint": Control(
        "velocities in checkpoints", lambda: put(motions.TotalMotion, "restore", _without_velocity)
    ),
    "frames lost": Control(
        "tables cut back to the checkpoint", off(GrowingTable, "cut", lambda self, last: None)
    ),
    "permuted particles": Control(
        "particles in double precision: here in single", off(equilibria, "PRECISION", np.float32)
    ),
    "ramp past a bifurcation": Control(
        "leaving equilibria that are not minima", _stays_where_it_is
    ),
}


def _without_velocity(self: Any, state: dict[str, Any]) -> None:
    self.u[:], self.v[:] = state["u"], 0.0
    self.force[:], self.stiffness[:] = 0.0, np.nan
    self.lag = float(state.get("lag", 0.0))
    self._last = ()


def control_of(name: str) -> Control:
    """The control of the case of this name."""
    return next(control for beginning, control in CONTROLS.items() if name.startswith(beginning))


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_control_fails(case: Case) -> None:
    """With the remedy switched off that it is about, a case fails: otherwise it would tell nothing. The switch is back afterwards."""
    control = control_of(case.name)
    measure = control.measured(case)
    assert not measure <= case.bound, (
        f"{control.remedy}: {measure:.3g}, at most {case.bound:.3g} all the same"
    )
