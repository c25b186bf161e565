"""Hard cases of motions: sudden loads, steps at the edge, stiff materials, a near magnet; a million steps, restarts, lost frames."""

from __future__ import annotations

import contextlib
import csv
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Plain
from magmpm.dynamics.time_loop import begin, integrate, interval, move
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.errors import InputError, SolveError
from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.model import build
from magmpm.results.file_names import CHECKPOINT, ENERGIES
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.motions import (
    DENSITY,
    DIAMETER,
    FIRST_ROOT,
    RATIO,
    REMANENCE,
    G,
    advance,
    at_rest,
    bending_field,
    changed,
    energy,
    last_cells,
    rod,
    spin,
    throw,
    with_modulus,
)

SHAKEN = 4 * 4e-3  # m, length of the body whose steps are at the edge
SHORT_LENGTH = 20e-3  # m
FREQUENCY = (
    FIRST_ROOT**2
    * math.sqrt(young_modulus(G, RATIO * G) / DENSITY)
    * DIAMETER
    / 4
    / SHORT_LENGTH**2
    / (2 * math.pi)
)  # Hz, of bending
# s: of a rod whose first bending takes 0.03 s, and is damped critically
LOADED = 0.05
SETTLED_SHARE = 0.25
SHORTER = 16e-3  # m
STUB = 8e-3  # m, of long and broken runs
FRAMES_OF_CASE = 6
REVERSED = 0.02  # s


def energy_kept(
    motion: TotalMotion, dt: float, steps: int, looks: int, start: float = 0.0
) -> float:
    """Find the largest change of the energy while a body moves.

    Parameters
    ----------
    motion : TotalMotion
        The body.
    dt : float, s
        Time step.
    steps : int
        How many.
    looks : int
        How often the energy is looked at.
    start : float, s, default 0.0
        Time at which the steps begin.

    Returns
    -------
    float, no unit
        The change since the first look over the largest kinetic energy.
    """
    begun = energy(motion, start)
    change = 0.0
    most = 0.0
    part = steps // looks
    for k in range(looks):
        advance(motion, part, dt, start + k * part * dt)
        change = max(change, abs(energy(motion, start + (k + 1) * part * dt) - begun))
        most = max(most, motion.kinetic_energy())
    return change / most


def _switched_on(scene: Scene) -> float:
    motion, dt, _ = at_rest(scene)
    return energy_kept(motion, dt, int(0.1 / dt), 100)


def _shaken(scene: Scene) -> tuple[TotalMotion, float]:
    """A free body that rotates and vibrates in all its modes, and its largest stable step."""
    motion, _, largest = at_rest(scene)
    noise = np.random.default_rng(0)

    def velocity(x: Array) -> Array:
        return np.cross([0.0, 30.0, 0.0], x) + 0.2 * noise.standard_normal(x.shape)

    throw(motion, velocity)
    return motion, largest


def stays(part: float, steps: int, looks: int) -> Callable[[Scene], float]:
    """Make the measure of the change of energy and spin in a number of steps.

    Parameters
    ----------
    part : float, no unit
        The step over the largest stable one.
    steps : int
        How many.
    looks : int
        How often the energy is looked at.

    Returns
    -------
    callable
        From a scene to the measure, no unit.
    """

    def measure(scene: Scene) -> float:
        """Change of the energy, over the energy at first; at least that of the spin."""
        motion, bound = _shaken(scene)
        advance(motion, 64, part * bound)
        begun = energy(motion)
        turning = spin(motion)
        most = 0.0
        for _ in range(looks):
            advance(motion, steps // looks, part * bound)
            most = max(most, abs(energy(motion) / begun - 1))
        return max(most, float(np.linalg.norm(spin(motion) - turning) / np.linalg.norm(turning)))

    return measure


def _detected(part: float) -> Callable[[Scene], float]:
    def measure(scene: Scene) -> float:
        """Steps until a motion is stopped; infinite if it never is, or if the message does not name the key to change."""
        moved = begin(build(scene))
        bound = moved.stable.largest
        moved.control.step = part * bound  # what a scene may not ask for
        try:
            integrate(moved)
        except SolveError as error:
            state = error.state
            named = all(
                word in error.reason for word in ("step", "t =", "time_step", f"{bound:.3g}")
            )
            kept = state is not None and bool(np.isfinite(state.x).all())
            return float(error.reason.split()[1].rstrip(",")) if named and kept else math.inf
        return math.inf

    return measure


def _settled(scene: Scene, least: float = 0.0) -> float:
    """Distance of the settled tip from that of statics, over L; infinite if it has moved by less than `least` of L."""
    effects = {**scene.to_si()["effects"], "damping": None, "viscosity": None}
    still = run(changed(scene, solver={"static": {}}, effects=effects))
    model = build(scene)
    moved = move(model)
    share = last_cells(model)
    if np.linalg.norm(share @ (moved.x - model.particles.position)) < least * scene.length:
        return math.inf
    return float(np.linalg.norm(share @ (moved.x - still.particle_position))) / scene.length


def _rotating() -> Scene:
    turning = {"rotation": {"axis": [0.0, 1.0, 0.0], "frequency": FREQUENCY}}
    field = bending_field(1.0, 0.0, SHORT_LENGTH)
    return changed(
        rod(length=SHORT_LENGTH, field=field, dynamic={}),
        field={"uniform": field, "over_time": turning},
    )


def _resonance(scene: Scene) -> float:
    """Largest gap between a body's energy and the work the field has done on it, -integral of m . dB, over its largest kinetic energy."""
    motion, dt, _ = at_rest(scene)
    model = motion.model
    turning = scene.external_field()
    place = np.zeros((1, 3))

    def moment() -> np.ndarray:
        _, _, F = motion.particles()
        found: np.ndarray = (
            model.particles.volume @ np.einsum("nij,nj->ni", F, model.remanence[:, :3]) / MU0
        )
        return found

    begun = energy(motion, 0.0)
    m = moment()
    B = turning.at(place, 0.0)[0]
    work = 0.0
    worst = 0.0
    most = 0.0
    highest = 0.0
    height = last_cells(model)
    for k in range(int(4 / FREQUENCY / dt / 4)):
        advance(motion, 4, dt, 4 * k * dt)
        time = 4 * (k + 1) * dt
        after = moment()
        now = turning.at(place, time)[0]
        work -= 0.5 * float((m + after) @ (now - B))
        m = after
        B = now
        worst = max(worst, abs(energy(motion, time) - begun - work))
        most = max(most, motion.kinetic_energy())
        highest = max(highest, abs(float(height @ motion.particles()[0][:, 2])))
    return worst / most if highest > 0.2 * SHORT_LENGTH else math.inf


def _cycle() -> Scene:
    """A rod that a field bends to a tip deflection of 0.7 of its length, and releases as slowly."""
    strength = [
        {"time": 0.0, "strength": 0.0},
        {"time": LOADED, "strength": 1.0},
        {"time": 2 * LOADED, "strength": 0.0},
    ]
    field = bending_field(6.0, length=SHORTER)
    scene = rod(
        length=SHORTER,
        field=field,
        effects={"damping": {"rate": 370.0}},
        dynamic={"duration": SETTLED_SHARE},
    )
    return changed(scene, field={"uniform": field, "over_time": {"keyframes": strength}})


def _left_over(scene: Scene) -> float:
    """Largest remaining displacement, over L, when the unloaded body has come to rest; infinite if it was not bent far before."""
    model = build(scene)
    moved = begin(model)
    rest = model.particles.position
    bent = np.abs(interval(moved, LOADED).x - rest).max()
    left = float(np.abs(interval(moved, SETTLED_SHARE).x - rest).max())
    return left / SHORTER if bent > 0.7 * SHORTER else math.inf


def _approaching() -> Scene:
    """The dipole of a 20 mm cube of neodymium, 8 A m^2, that approaches the tip from 80 mm above it to 40 mm."""
    effects = {"magnetic_torque": {}, "magnetic_force": {}, "damping": {"rate": 240.0}}
    source = {"position": [30e-3, 0.0, 80e-3], "moment": [0.0, 0.0, 8.0], "diameter": 20e-3}
    frames = [{"time": 0.0, "move": [0.0, 0.0, 0.0]}, {"time": 0.05, "move": [0.0, 0.0, -40e-3]}]
    scene = rod(
        length=SHORT_LENGTH, effects=effects, dynamic={"duration": 0.2, "output_every": 0.05}
    )
    return changed(scene, field={"dipole": [source], "over_time": {"keyframes": frames}})


class _Interrupted(Exception):
    """A run that is ended from outside."""


def _reversed(scene: Scene) -> float:
    """Change of all energies after the reversal, over the largest kinetic energy."""
    motion, dt, _ = at_rest(scene)
    steps = int(np.ceil(REVERSED / dt))
    advance(motion, steps, dt)
    return energy_kept(motion, dt, 2 * steps, 40, steps * dt)


def _moving() -> Scene:
    moving = {"duration": 0.012, "output_every": 0.012 / FRAMES_OF_CASE}
    return rod(
        length=STUB,
        field=bending_field(1.0, length=STUB),
        effects={"damping": {"rate": 100.0}},
        dynamic=moving,
    )


def _table(folder: Path) -> list[Plain]:
    with (folder / ENERGIES).open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _pieces(scene: Scene, folder: Path, broken: bool = False) -> Any:
    """The motion, ended after every frame and begun again from its checkpoint; broken: half a row was written after it."""
    every = scene.duration / FRAMES_OF_CASE
    for k in range(1, FRAMES_OF_CASE + 1):

        def stop(_: int, time: float, until: float = k * every) -> None:
            if time > until * (1 + 1e-9) and until < scene.duration:
                raise _Interrupted

        with contextlib.suppress(_Interrupted):
            result = run(
                scene, folder=folder, resume=(folder / CHECKPOINT).exists(), on_progress=stop
            )
        if broken and k < FRAMES_OF_CASE:
            with (folder / ENERGIES).open("a", encoding="utf-8") as stream:
                stream.write(
                    f"{(k + 0.5) * every!r},1.0"
                )  # a row that the end of the process cut off
    return result


def _restarted(scene: Scene) -> float:
    """Largest difference of positions, over L, of a motion that is begun again at every checkpoint, from one that is not interrupted."""
    with tempfile.TemporaryDirectory() as folder:
        whole = run(scene)
        parts = _pieces(scene, Path(folder))
    return float(np.abs(whole.particle_position - parts.particle_position).max()) / scene.length


def _frames_lost(scene: Scene) -> float:
    """Frames of energies.csv that are missing, too many, or other than those of a run that nothing has broken."""
    with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as other:
        run(scene, folder=one)
        try:
            _pieces(scene, Path(other), broken=True)
        except InputError:  # the run can't go on
            return np.inf
        whole = _table(Path(one))
        parts = _table(Path(other))
    return float(
        abs(len(whole) - len(parts)) + sum(a != b for a, b in zip(whole, parts, strict=False))
    )


def _field_reversed() -> Scene:
    scene = rod(field=bending_field(2.0), dynamic={})
    frames = [
        {"time": t, "strength": s}
        for t, s in ((0.0, 1.0), (REVERSED - 1e-9, 1.0), (REVERSED, -1.0))
    ]
    return changed(
        scene, field={"uniform": list(scene.field.uniform), "over_time": {"keyframes": frames}}
    )


CASES = (
    Case(
        "field switched on at once",
        lambda: rod(field=bending_field(10.0), dynamic={}),
        "blows up on the first swing, or loses it",
        "change of all energies over 0.1 s, over the largest kinetic",
        _switched_on,
        0.01,
        "nothing does work: a constant field has a potential",
    ),
    Case(
        "time step 0.9 of the bound",
        lambda: rod(length=SHAKEN, clamp="none", dynamic={}),
        "gains energy slowly, or loses it, or its spin",
        "change in 10^5 steps of energy or of spin, over those at first",
        stays(0.9, 100_000, 50),
        0.1,
        "symplectic Euler below 2/omega: the energy of a mode swings, and does not grow",
    ),
    Case(
        "time step 1.2 of the bound",
        lambda: rod(
            length=SHAKEN,
            field=bending_field(2.0, length=SHAKEN),
            dynamic={"duration": 2.0, "output_every": 0.01, "time_step": 1e-6},
        ),
        "ends with values that are not finite, or with wrong ones",
        "steps until it is stopped, with its reason and last good state",
        _detected(1.2),
        40.0,
        "the fastest mode grows 3.5-fold a step, by x + sqrt(x^2 - 1), x = 2 1.2^2 - 1: from"
        " rounding to 1 in 30",
    ),
    Case(
        "K/G = 500 in motion",
        lambda: rod(
            field=bending_field(2.0),
            effects={"damping": {"rate": 60.0}},
            dynamic={"duration": 0.35},
            ratio=500.0,
        ),
        "locks, or needs a step for which it was not asked",
        "settled tip from statics, over L",
        _settled,
        0.002,
        "statics by Newton's method on the same particles",
    ),
    Case(
        "stiffness contrast 1:100",
        lambda: with_modulus(
            rod(
                directions=[(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)] * 2,
                field=[0.0, 0.0, 0.1e-3],
                effects={"damping": {"rate": 12.0}},
                dynamic={"duration": 2.0, "output_every": 0.1},
            ),
            [1, 3],
            G / 100,
        ),
        "takes the soft neighbor's step, or tears at the joint",
        "settled tip from statics, over L",
        _settled,
        0.002,
        "statics by Newton's method on the same particles",
        slow=True,
    ),
    Case(
        "loaded and unloaded",
        _cycle,
        "remembers the path it came",
        "displacement left, over L, after a tip deflection of 0.7 L",
        _left_over,
        1e-8,
        "elastic: no load, no displacement; what is left of the motion falls by exp(-185 t)",
    ),
    Case(
        "field rotating at the first bending frequency",
        _rotating,
        "gains energy that no one gave it, until it breaks",
        "energy that is not the field's work, over the largest kinetic",
        _resonance,
        0.01,
        "dE/dt = -m . dB/dt",
    ),
    Case(
        "a magnet brought close",
        _approaching,
        "is pulled off by a gradient that its torque knows nothing of, or loses balance as the"
        " field grows tenfold",
        "settled tip from statics, over L",
        lambda scene: _settled(scene, 0.05),
        0.005,
        f"statics by Newton's method in the magnet's last place; remanence {REMANENCE:g} T",
        slow=True,
    ),
)
LONG = (
    Case(
        "field reversed at once",
        _field_reversed,
        "blows up, or gains energy as the load changes its sign within a step",
        "change of all energies after it, over the largest kinetic",
        _reversed,
        0.01,
        "nothing does work after the reversal: a constant field has a potential",
    ),
    Case(
        "drift in 10^6 steps",
        lambda: rod(length=STUB, clamp="none", dynamic={}),
        "gains or loses energy or spin, a little in each step",
        "change of energy or spin, over those at first",
        stays(0.8, 1_000_000, 20),
        0.1,
        "symplectic Euler: the energy of a mode swings within dt w / 2, and does not grow",
        slow=True,
    ),
    Case(
        "restart at every checkpoint",
        _moving,
        "goes on from another state than it saved",
        "difference from a run that is not interrupted, over L",
        _restarted,
        0.0,
        "checkpoints hold all bits",
    ),
    Case(
        "frames lost",
        _moving,
        "writes frames twice, or goes on after half a row",
        "frames missing, too many or other",
        _frames_lost,
        0.0,
        "tables are cut back to the checkpoint",
    ),
)
