"""Hard cases of statics."""

from __future__ import annotations

import numpy as np

from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.scenes import LENGTH, bending_field, rod, twisting_field

X_SPATIAL = ((1.0, 0.0, 0.0), (0.7, 0.6, 0.4), (-0.2, -0.8, 0.6))  # magnetizations that bend and twist
EULER = np.pi**2 / 4  # critical load of theta'' + load sin(theta) = 0, theta(0) = theta'(1) = 0


def _buckling(scene: Scene) -> float:
    """Relative error of the load at which deflections begin: their squares grow in proportion to the load beyond it."""
    loads, squares = np.array([1.03, 1.06]) * EULER, []
    for load in loads:
        tip = run(scene.with_field(bending_field(float(load), np.pi, 2 * LENGTH))).tip
        squares.append(float(tip[1] ** 2 + tip[2] ** 2))
    below = run(scene.with_field(bending_field(0.95 * EULER, np.pi, 2 * LENGTH))).tip
    if np.hypot(below[1], below[2]) > 1e-3 * LENGTH or min(squares) < (0.05 * LENGTH) ** 2:
        return np.inf  # bent before the critical load, or straight beyond it
    critical = loads[0] - squares[0] * (loads[1] - loads[0]) / (squares[1] - squares[0])
    return float(abs(critical / EULER - 1))


def _twist(scene: Scene) -> float:
    """Largest error of the twist angle of the tip, rad, over loads 0.5 to 8 of theta'' + load cos(theta) = 0."""
    from scipy.integrate import solve_bvp  # 0.3 s to import, for this case alone

    worst = 0.0
    for load in (0.5, 2.0, 8.0):

        def slope(s: np.ndarray, y: np.ndarray, load: float = load) -> np.ndarray:
            return np.stack([y[1], -load * np.cos(y[0])])

        s = np.linspace(0.0, 1.0, 41)
        exact = solve_bvp(slope, lambda a, b: np.array([a[0], b[1]]), s, np.stack([s, 1.0 - s]), tol=1e-8).sol(1.0)[0]
        result = run(scene.with_field(twisting_field(load)))
        end = result.particle_reference[:, 0] > 0.95 * LENGTH
        (_, y, z), (_, b, c) = result.particle_reference[end].T, result.particle_position[end].T
        found = np.arctan2(np.sum(y * c - z * b), np.sum(y * b + z * c))
        worst = max(worst, abs(float(found) - float(exact)))
    return worst


def _incompressible(scene: Scene) -> float:
    """Largest distance of tips from the rod's, over L, for K/G from 20 to 500."""
    worst = 0.0
    for ratio in (20.0, 100.0, 500.0):
        data = scene.to_si()
        for material in data["materials"].values():
            material["bulk_to_shear"] = ratio
        other = Scene.from_si(data)
        worst = max(worst, float(np.linalg.norm(run(other).tip - solve_rod(other).position[-1])) / LENGTH)
    return worst


def _from_a_loaded_neighbor(scene: Scene) -> float:
    """Largest displacement of the unloaded body, over L, if the solve starts from the grid correction of a bent neighbor."""
    back = run(scene.with_field([0.0, 0.0, 0.0]), start=run(scene))
    return float(np.abs(back.particle_position - back.particle_reference).max()) / LENGTH


CASES = (
    Case(
        "antiparallel field through buckling",
        lambda: rod(length=2 * LENGTH, field=bending_field(EULER, np.pi, 2 * LENGTH), cells=4),
        "stays straight on the unstable branch, or buckles by rounding at any load",
        "error of the critical load, relative",
        _buckling,
        0.03,
        "Euler: M B A L^2/(E I) = pi^2/4; Wang et al., JMPS 142 (2020) 104045, section 3",
    ),
    Case(
        "twist about the long axis",
        lambda: rod(directions=[(0.0, 1.0, 0.0)], field=twisting_field(2.0), cells=4),
        "has no torque without a symmetric stress, or locks",
        "error of the tip's twist, rad",
        _twist,
        0.03,
        "theta'' + (M B A L^2/(G J)) cos(theta) = 0, Saint-Venant's torsion of a disk",
    ),
    Case(
        "K/G from 20 to 500",
        lambda: rod(directions=X_SPATIAL, field=[2e-3, 10e-3, -14e-3], cells=3),
        "locks: deflections vanish as K/G grows",
        "distance of tips from the rod's, over L",
        _incompressible,
        0.025,
        "Cosserat rod; it and a solid of L/D = 10 differ by 0.05 D/L of the deflection (tests/validation/test_rod_statics.py)",
    ),
    Case(
        "no load, begun from a loaded neighbor",
        lambda: rod(field=bending_field(25.0, np.radians(150)), cells=3),
        "keeps a part of what it began from",
        "displacement left, over L",
        _from_a_loaded_neighbor,
        1e-8,
        "elastic: no load, no displacement; statics has no path, motion does (`loaded and unloaded`)",
    ),
)
