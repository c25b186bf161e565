"""Hard cases of fields that change while the body moves."""

from __future__ import annotations

import math

import numpy as np

from magmpm.dynamics.time_loop import begin, interval, move
from magmpm.fields.dipole import MU0
from magmpm.materials import young_modulus
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.motions import advance, at_rest, energy, last_cells
from magmpm.studies.hard_cases.scenes import DENSITY, DIAMETER, RATIO, REMANENCE, G, bending_field, rod

SHORT = 20e-3  # m
FIRST = 1.8751040687  # first root of cos(z) cosh(z) = -1
FREQUENCY = FIRST**2 * math.sqrt(young_modulus(G, RATIO * G) / DENSITY) * DIAMETER / 4 / SHORT**2 / (2 * math.pi)  # Hz, of bending
LOOK = 4  # steps
LOADED, UNLOADED, SETTLED = 0.05, 0.1, 0.25  # s: of a rod whose first bending takes 0.03 s, and is damped critically
SHORTER = 16e-3  # m


def _rotating() -> Scene:
    turning = {"rotation": {"axis": [0.0, 1.0, 0.0], "frequency": FREQUENCY}}
    scene = rod(length=SHORT, field=bending_field(1.0, 0.0, SHORT), dynamic={})
    data = scene.to_si()
    return Scene.from_si({**data, "field": {"uniform": list(scene.field.uniform), "over_time": turning}})


def _resonance(scene: Scene) -> float:
    """Largest gap between a body's energy and the work the field has done on it, -integral of m . dB, over its largest kinetic energy."""
    motion, dt, _ = at_rest(scene)
    model, turning = motion.model, scene.outside_field()
    place = np.zeros((1, 3))

    def moment() -> np.ndarray:
        _, _, F = motion.particles()
        found: np.ndarray = model.particles.volume @ np.einsum("nij,nj->ni", F, model.remanence[:, :3]) / MU0
        return found

    begun, m, B = energy(motion, 0.0), moment(), turning.at(place, 0.0)[0]
    work, worst, most, highest = 0.0, 0.0, 0.0, 0.0
    height = last_cells(model)
    for k in range(int(4 / FREQUENCY / dt / LOOK)):
        advance(motion, LOOK, dt, LOOK * k * dt)
        time = LOOK * (k + 1) * dt
        after, now = moment(), turning.at(place, time)[0]
        work -= 0.5 * float((m + after) @ (now - B))
        m, B = after, now
        worst = max(worst, abs(energy(motion, time) - begun - work))
        most = max(most, motion.kinetic_energy())
        highest = max(highest, abs(float(height @ motion.particles()[0][:, 2])))
    return worst / most if highest > 0.2 * SHORT else math.inf


def _cycle() -> Scene:
    """A rod that a field bends to a tip deflection of 0.7 of its length, and releases as slowly."""
    strength = [{"time": 0.0, "strength": 0.0}, {"time": LOADED, "strength": 1.0}, {"time": UNLOADED, "strength": 0.0}]
    field = bending_field(6.0, length=SHORTER)
    data = rod(length=SHORTER, field=field, effects={"damping": {"rate": 370.0}}, dynamic={"duration": SETTLED}).to_si()
    return Scene.from_si({**data, "field": {"uniform": field, "over_time": {"keyframes": strength}}})


def _left_over(scene: Scene) -> float:
    """Largest remaining displacement, over L, when the unloaded body has come to rest; infinite if it was not bent far before."""
    model = build(scene)
    moved, rest = begin(model), model.particles.position
    bent = np.abs(interval(moved, LOADED).x - rest).max()
    left = float(np.abs(interval(moved, SETTLED).x - rest).max())
    return left / SHORTER if bent > 0.7 * SHORTER else math.inf


def _approaching() -> Scene:
    """The dipole of a 20 mm cube of neodymium, 8 A m^2, that approaches the tip from 80 mm above it to 40 mm."""
    scene = rod(
        length=SHORT,
        effects={"magnetic_torque": {}, "magnetic_force": {}, "damping": {"rate": 240.0}},
        dynamic={"duration": 0.2, "output_every": 0.05},
    )
    data = scene.to_si()
    source = {"position": [30e-3, 0.0, 80e-3], "moment": [0.0, 0.0, 8.0], "diameter": 20e-3}
    frames = [{"time": 0.0, "move": [0.0, 0.0, 0.0]}, {"time": 0.05, "move": [0.0, 0.0, -40e-3]}]
    return Scene.from_si({**data, "field": {"dipole": [source], "over_time": {"keyframes": frames}}})


def _near_magnet(scene: Scene) -> float:
    """Distance of the settled tip from that of statics, over L; infinite if it has hardly moved."""
    data = scene.to_si()
    still = run(Scene.from_si({**data, "solver": {"static": {}}, "effects": {**data["effects"], "damping": None}}))
    model = build(scene)
    moved = move(model)
    share = last_cells(model)
    if np.linalg.norm(share @ (moved.x - model.particles.position)) < 0.05 * SHORT:
        return math.inf
    return float(np.linalg.norm(share @ (moved.x - still.particle_position))) / SHORT


CASES = (
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
        "is pulled off by a gradient that its torque knows nothing of, or loses balance as the field grows tenfold",
        "settled tip from statics, over L",
        _near_magnet,
        0.005,
        f"statics by Newton's method in the magnet's last place; remanence {REMANENCE:g} T",
        slow=True,
    ),
)
