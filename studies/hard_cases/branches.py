"""Hard cases of loads beyond critical ones: snapping, twisting, ten times the load, a magnet that passes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from magmpm.fields.dipole import MU0
from magmpm.materials import poisson_ratio, young_modulus
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.scenes import (
    DENSITY,
    LENGTH,
    RATIO,
    REMANENCE,
    G,
    bending_field,
    rod,
    twisting_field,
)

AGAINST = 1.3  # of the critical load: the part of the field along the strip
EULER = np.pi**2 / 4
THICK = 1e-3  # m, of the strip that snaps
STRIP = 20e-3  # m, its length
FAR, PAST = 80e-3, 10e-3  # m: next to the tip, where the magnet comes from and goes to; where it has just passed
D = 10e-3  # m: diameter of the magnet that passes, and its distance from the tip
SPATIAL = ((1.0, 0.0, 0.0), (0.7, 0.6, 0.4), (-0.2, -0.8, 0.6))


def _flux(load: float) -> float:
    """Flux density (T) of a load M B A L^2/(E' I) on the strip, E' = E/(1 - nu^2), A/I = 12/t^2."""
    nu = poisson_ratio(G, RATIO * G)
    E = young_modulus(G, RATIO * G) / (1 - nu**2)
    return float(load * E * THICK**2 * MU0 / (12 * REMANENCE * STRIP**2))


def _snapping() -> Scene:
    """A strip in plane strain in a field against it, whose small transverse part goes over to the other side and comes back."""
    against, across = _flux(AGAINST * EULER), _flux(0.35 * EULER)
    frames = [{"time": float(t), "uniform": [-against, 0.0, across * s]} for t, s in ((0, 1), (1, -1), (2, 1))]
    silicone = {"shear_modulus": G, "bulk_to_shear": RATIO, "density": DENSITY, "remanence": REMANENCE}
    strip = {"length": STRIP, "width": 5e-3, "thickness": THICK, "material": "silicone", "plane_strain": True}
    return Scene.from_si(
        {
            "name": "hard case",
            "materials": {"silicone": silicone},
            "body": {"strip": {**strip, "segments": [{"magnetization": [1.0, 0.0, 0.0]}]}},
            "field": {"over_time": {"keyframes": frames}},
            "effects": {"magnetic_torque": {}},
            "solver": {"quasi_static": {"steps": 40}},
            "resolution": {"cells_across": 3},
        }
    )


def snap_load(against: float) -> float:
    """Transverse load M Bz A L^2/(E I) at which the upper branch of theta'' - against sin(theta)(-1) + b cos(theta) = 0 ends.

    theta(0) = 0, theta'(1) = 0. Along the branch the tip's angle falls; b(angle) is found by shooting, and is least where it ends.
    """
    from scipy.integrate import solve_ivp
    from scipy.optimize import brentq, minimize_scalar

    def end(b: float, angle: float) -> float:
        def slope(_: float, y: Sequence[float]) -> list[float]:
            return [y[1], -against * np.sin(y[0]) - b * np.cos(y[0])]

        return float(solve_ivp(slope, (1.0, 0.0), [angle, 0.0], rtol=1e-9, atol=1e-11).y[0, -1])

    def load(angle: float) -> float:
        return float(brentq(end, -2.0, 3.0, args=(angle,), xtol=1e-10))

    found = minimize_scalar(load, bounds=(0.2, 1.6), method="bounded", options={"xatol": 1e-5})
    return float(found.fun)


def _snapped(scene: Scene) -> float:
    """Largest error of the two loads at which it snaps, relative to the exact one; infinite unless it snaps twice, to each side."""
    result = run(scene)
    if len(result.jumps) != 2 or {jump["kind"] for jump in result.jumps} != {"limit point"}:
        return np.inf
    exact, most = abs(snap_load(AGAINST * EULER)), 0.35 * EULER
    there, back = (jump["time"] for jump in result.jumps)
    found = [most * (1 - 2 * there), most * (2 * (back - 1) - 1)]
    if not (found[0] < 0 < found[1]):
        return np.inf
    return float(max(abs(abs(b) / exact - 1) for b in found))


def tip_turn(scene: Scene, result: Any) -> float:
    """Angle (rad) by which the last section has turned about the long axis."""
    end = result.particle_reference[:, 0] > 0.95 * scene.length
    (_, y, z), (_, b, c) = result.particle_reference[end].T, result.particle_position[end].T
    return float(np.arctan2(np.sum(y * c - z * b), np.sum(y * b + z * c)))


def _twist_buckles(scene: Scene) -> float:
    """Relative error of the load at which a rod magnetized across it begins to turn about its axis, in a field against it."""
    loads, squares = np.array([1.04, 1.08]) * EULER, []
    for load in loads:
        squares.append(tip_turn(scene, run(scene.with_field([0.0, -twisting_field(float(load))[2], 0.0]))) ** 2)
    below = tip_turn(scene, run(scene.with_field([0.0, -twisting_field(0.95 * EULER)[2], 0.0])))
    if abs(below) > 1e-3 or min(squares) < 0.05**2:
        return np.inf
    critical = loads[0] - squares[0] * (loads[1] - loads[0]) / (squares[1] - squares[0])
    return float(abs(critical / EULER - 1))


def _two_ways(scene: Scene) -> float:
    """Distance of tips over L, of the solve from the rod's shape and of a load that grows in 20 steps."""
    data = scene.to_si()
    data["solver"] = {"static": {"field_steps": 20, "max_steps": 200}}
    one, two = run(scene), run(Scene.from_si(data))
    return float(np.linalg.norm(one.tip - two.tip)) / scene.length if min(one.min_det_F, two.min_det_F) > 0 else np.inf


def _past_a_bifurcation(scene: Scene) -> float:
    """Distance over L of the tip's place, as distance from the axis and height, after a ramp to twice the critical load, from statics."""
    data = scene.to_si()
    ramp = {"ramp": {"duration": 1.0}}
    followed = run(Scene.from_si({**data, "field": {**data["field"], "over_time": ramp}, "solver": {"quasi_static": {"steps": 20}}}))
    ramped = run(Scene.from_si({**data, "solver": {"static": {"field_steps": 10}}}))
    still = run(scene)
    places = [np.array([r.tip[0], np.hypot(r.tip[1], r.tip[2])]) for r in (followed, ramped, still)]
    if places[2][1] < 0.3 * scene.length:
        return np.inf
    return float(max(np.linalg.norm(places[k] - places[2]) for k in (0, 1))) / scene.length


def _passing() -> Scene:
    """A magnet, a sphere of neodymium, that goes past the tip, from 80 mm at one side to 80 mm at the other, one diameter beyond it."""
    moment = 1.3 * np.pi * D**3 / 6 / MU0
    source = {"position": [LENGTH + 1.5 * D, 0.0, 0.0], "moment": [-moment, 0.0, 0.0], "diameter": D}
    frames = [{"time": float(k), "move": [0.0, 0.0, y]} for k, y in ((0, -FAR), (1, FAR))]
    data = rod(effects={"magnetic_torque": {}, "magnetic_force": {}}).to_si()
    field = {"dipole": [source], "over_time": {"keyframes": frames}}
    return Scene.from_si({**data, "field": field, "solver": {"quasi_static": {"steps": 32}}})


def _passed(scene: Scene) -> float:
    """Distance of the last shape from the mirror image of the first, or of the shape where the magnet has just passed from that of statics,
    whichever is more, over L; infinite if the tip has hardly moved in between."""
    result = run(scene)
    tips = np.array([step["tip"] for step in result.steps])
    if np.ptp(tips[:, 2]) < 0.05 * LENGTH:
        return np.inf
    data = scene.to_si()
    [source] = data["field"]["dipole"]
    source = {**source, "position": [source["position"][0], 0.0, PAST]}
    still = run(Scene.from_si({**data, "field": {"dipole": [source]}, "solver": {"static": {}}}))
    just = round((0.5 + PAST / FAR / 2) * (len(tips) - 1))
    mirrored = np.linalg.norm(tips[-1] - tips[0] * [1.0, 1.0, -1.0])
    return float(max(mirrored, np.linalg.norm(tips[just] - still.tip))) / LENGTH


CASES = (
    Case(
        "snap-through, both branches",
        _snapping,
        "stays on a branch that has ended, or snaps early and on one side only",
        "error of the two loads at which it snaps, relative",
        _snapped,
        0.05,
        "limit points of theta'' + a sin(theta) + b cos(theta) = 0 by shooting; 3 cells across, load known within 1/1000 of its way",
        slow=True,
    ),
    Case(
        "twist past its critical load",
        lambda: rod(directions=[(0.0, 1.0, 0.0)], field=twisting_field(1.0), cells=3),
        "stays untwisted on the unstable branch, or tumbles to any angle",
        "error of the critical load of twist, relative",
        _twist_buckles,
        0.03,
        "M B A L^2/(G J) = pi^2/4, a third of what bends it: Saint-Venant's torsion of a disk",
    ),
    Case(
        "ten times the design load",
        lambda: rod(directions=SPATIAL, field=[20e-3, 100e-3, -140e-3], cells=3),
        "diverges, or ends with particles inside out",
        "distance of tips of two ways to solve it, over L",
        _two_ways,
        1e-4,
        "one equilibrium: tolerance 1e-11 of the energy, so sqrt(1e-11) of the displacement, thirty times that",
    ),
    Case(
        "ramp past a bifurcation",
        lambda: rod(field=bending_field(2 * EULER, np.pi), cells=2),
        "stays straight on the unstable branch",
        "distance of the ramped tips from that of statics, over L",
        _past_a_bifurcation,
        1e-3,
        "one buckled shape, turned about the axis as it may: 1e-4 L along a neutral direction, ten times that",
        slow=True,
    ),
    Case(
        "magnet passed at one diameter",
        _passing,
        "sticks to the magnet, or remembers on which side it was",
        "last shape from the mirrored first one, or one on the way from that of statics, over L",
        _passed,
        1e-4,
        "the way of the magnet is its own mirror image; tolerance 1e-11 of the energy",
        slow=True,
    ),
)
