"""Hard cases of equilibria: critical loads, snapping, ten times the load, a magnet that passes; needles, thin tubes, stiff parts."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from magmpm.bodies.surface_mesh import pack_mesh
from magmpm.errors import InputError
from magmpm.fields.dipole import MU0
from magmpm.materials import poisson_ratio, young_modulus
from magmpm.model import build
from magmpm.results.measures import tip_of
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model
from magmpm.studies.hard_cases.case import Case
from magmpm.studies.hard_cases.motions import (
    CATHETER_LENGTH,
    DIAMETER,
    EULER,
    RATIO,
    REMANENCE,
    SILICONE,
    G,
    X,
    bending_field,
    block,
    changed,
    made,
    rod,
    twisting_field,
    with_modulus,
)

SPATIAL = (
    (1.0, 0.0, 0.0),
    (0.7, 0.6, 0.4),
    (-0.2, -0.8, 0.6),
)  # magnetizations that bend and twist
AGAINST = 1.3 * EULER  # load of the part of the field along the strip that snaps
# m, its length and thickness
STRIP = 20e-3
THICK = 1e-3
# m: next to the tip, where the magnet comes from and goes to
FAR_FROM_TIP = 80e-3
D = 10e-3  # m: diameter of the magnet that passes, and its distance from the tip
# mm, of the robot made of parts
BASE = 4.0
ARM = 20.0
WIDE = 4.0
HIGH = 2.0
PRECISION = np.float64  # in which particles are kept whose order is changed


def from_rod(scene: Scene) -> float:
    """Measure how far the tip is from the rod's.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    float, no unit
        The distance over the body's length.
    """
    return float(np.linalg.norm(tip_of(run(scene)) - solve_rod(scene).position[-1])) / scene.length


def _off_critical(square: Callable[[float], float], loads: Sequence[float], size: float) -> float:
    """Relative error of the load at which deflections begin, by two loads beyond: their squares grow in proportion to the load beyond it.

    square: of the deflection by a load, which is of this size; loads: over EULER.
    """
    one, two = (load * EULER for load in loads)
    squares = square(one), square(two)
    if square(0.95 * EULER) > (1e-3 * size) ** 2 or min(squares) < (0.05 * size) ** 2:
        return np.inf  # bent before the critical load, or straight beyond it
    critical = one - squares[0] * (two - one) / (squares[1] - squares[0])
    return float(abs(critical / EULER - 1))


def _buckling(scene: Scene) -> float:
    def square(load: float) -> float:
        tip = tip_of(run(scene.with_field(bending_field(load, np.pi, 2 * CATHETER_LENGTH))))
        return float(tip[1] ** 2 + tip[2] ** 2)

    return _off_critical(square, (1.03, 1.06), CATHETER_LENGTH)


def _twist_buckles(scene: Scene) -> float:
    """Relative error of the load at which a rod magnetized across it begins to turn about its axis, in a field against it."""

    def square(load: float) -> float:
        return _tip_turn(scene, run(scene.with_field([0.0, -twisting_field(load)[2], 0.0]))) ** 2

    return _off_critical(square, (1.04, 1.08), 1.0)


def _tip_turn(scene: Scene, result: Result) -> float:
    """Angle (rad) by which the last section has turned about the long axis."""
    end = result.particle_reference[:, 0] > 0.95 * scene.length
    (_, y, z), (_, b, c) = result.particle_reference[end].T, result.particle_position[end].T
    return float(np.arctan2(np.sum(y * c - z * b), np.sum(y * b + z * c)))


def _twist(scene: Scene) -> float:
    """Largest error of the twist angle of the tip, rad, over loads 0.5 to 8 of theta'' + load cos(theta) = 0."""
    from scipy.integrate import solve_bvp  # 0.3 s to import, for this case alone

    worst = 0.0
    for load in (0.5, 2.0, 8.0):

        def slope(s: np.ndarray, y: np.ndarray, load: float = load) -> np.ndarray:
            return np.stack([y[1], -load * np.cos(y[0])])

        s = np.linspace(0.0, 1.0, 41)
        exact = solve_bvp(
            slope, lambda a, b: np.array([a[0], b[1]]), s, np.stack([s, 1.0 - s]), tol=1e-8
        ).sol(1.0)[0]
        worst = max(
            worst, abs(_tip_turn(scene, run(scene.with_field(twisting_field(load)))) - float(exact))
        )
    return worst


def _incompressible(scene: Scene) -> float:
    """Largest distance of tips from the rod's, over L, for K/G from 20 to 500."""
    kinds = scene.to_si()["materials"]
    scenes = [
        changed(scene, materials={k: {**kind, "bulk_to_shear": r} for k, kind in kinds.items()})
        for r in (20.0, 100.0, 500.0)
    ]
    return max(from_rod(other) for other in scenes)


def _from_a_loaded_neighbor(scene: Scene) -> float:
    """Largest displacement of the unloaded body, over L, if the solve starts from the grid correction of a bent neighbor."""
    back = run(scene.with_field([0.0, 0.0, 0.0]), start=run(scene))
    return float(np.abs(back.particle_position - back.particle_reference).max()) / CATHETER_LENGTH


def _flux(load: float) -> float:
    """Flux density (T) of a load M B A L^2/(E' I) on the strip, E' = E/(1 - nu^2), A/I = 12/t^2."""
    nu = poisson_ratio(G, RATIO * G)
    E = young_modulus(G, RATIO * G) / (1 - nu**2)
    return float(load * E * THICK**2 * MU0 / (12 * REMANENCE * STRIP**2))


def _snapping() -> Scene:
    """A strip in plane strain in a field against it, whose small transverse part goes over to the other side and comes back."""
    against = _flux(AGAINST)
    across = _flux(0.35 * EULER)
    frames = [
        {"time": float(t), "uniform": [-against, 0.0, across * s]}
        for t, s in ((0, 1), (1, -1), (2, 1))
    ]
    strip = {
        "length": STRIP,
        "width": 5e-3,
        "thickness": THICK,
        "material": "silicone",
        "plane_strain": True,
    }
    return made(
        {"strip": {**strip, "segments": [{"magnetization": [1.0, 0.0, 0.0]}]}},
        {"silicone": SILICONE},
        cells=3,
        field={"over_time": {"keyframes": frames}},
        effects={"magnetic_torque": {}},
        solver={"quasi_static": {"steps": 40}},
    )


def _snap_load(against: float) -> float:
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
    exact = abs(_snap_load(AGAINST))
    most = 0.35 * EULER
    there, back = (jump["time"] for jump in result.jumps)
    found = [most * (1 - 2 * there), most * (2 * (back - 1) - 1)]
    if not (found[0] < 0 < found[1]):
        return np.inf
    return float(max(abs(abs(b) / exact - 1) for b in found))


def _two_ways(scene: Scene) -> float:
    """Distance of tips over L, of the solve from the rod's shape and of a load that grows in 20 steps."""
    one = run(scene)
    two = run(changed(scene, solver={"static": {"field_steps": 20, "max_steps": 200}}))
    return (
        float(np.linalg.norm(tip_of(one) - tip_of(two))) / scene.length
        if min(one.min_det_F, two.min_det_F) > 0
        else np.inf
    )


def _past_a_bifurcation(scene: Scene) -> float:
    """Distance over L of the tip's place, as distance from the axis and height, after a ramp to twice the critical load, from statics."""
    ramp = {**scene.to_si()["field"], "over_time": {"ramp": {"duration": 1.0}}}
    followed = run(changed(scene, field=ramp, solver={"quasi_static": {"steps": 20}}))
    ramped = run(changed(scene, solver={"static": {"field_steps": 10}}))
    tips = [tip_of(one) for one in (followed, ramped, run(scene))]
    places = [np.array([x, np.hypot(y, z)]) for x, y, z in tips]
    if places[2][1] < 0.3 * scene.length:
        return np.inf
    return float(max(np.linalg.norm(places[k] - places[2]) for k in (0, 1))) / scene.length


def _passing() -> Scene:
    """A magnet, a sphere of neodymium, that goes past the tip, from 80 mm at one side to 80 mm at the other, one diameter beyond it."""
    moment = 1.3 * np.pi * D**3 / 6 / MU0
    source = {
        "position": [CATHETER_LENGTH + 1.5 * D, 0.0, 0.0],
        "moment": [-moment, 0.0, 0.0],
        "diameter": D,
    }
    frames = [
        {"time": float(k), "move": [0.0, 0.0, y]}
        for k, y in ((0, -FAR_FROM_TIP), (1, FAR_FROM_TIP))
    ]
    field = {"dipole": [source], "over_time": {"keyframes": frames}}
    return changed(
        rod(effects={"magnetic_torque": {}, "magnetic_force": {}}),
        field=field,
        solver={"quasi_static": {"steps": 32}},
    )


def _passed(scene: Scene) -> float:
    """Distance of the last shape from the mirror image of the first, or of the shape where the magnet has just passed from that of statics,
    whichever is more, over L; infinite if the tip has hardly moved in between."""
    past = 10e-3  # m: where the magnet has just passed
    tips = np.array([step["tip"] for step in run(scene).steps])
    if np.ptp(tips[:, 2]) < 0.05 * CATHETER_LENGTH:
        return np.inf
    [source] = scene.to_si()["field"]["dipole"]
    source = {**source, "position": [source["position"][0], 0.0, past]}
    still = run(changed(scene, field={"dipole": [source]}, solver={"static": {}}))
    just = round((0.5 + past / FAR_FROM_TIP / 2) * (len(tips) - 1))
    mirrored = np.linalg.norm(tips[-1] - tips[0] * [1.0, 1.0, -1.0])
    return float(max(mirrored, np.linalg.norm(tips[just] - still.tip))) / CATHETER_LENGTH


def _needle() -> Scene:
    data = rod(length=200e-3, field=bending_field(5.0, length=200e-3), cells=2).to_si()
    data["body"]["catheter"]["diameter"] = 1e-3
    data["field"]["uniform"] = [b / 16 for b in data["field"]["uniform"]]  # A/I grows as 1/D^2
    return Scene.from_si(data)


def _tube(ratio: float, wall: float = 0.04e-3, field: float = 2e-3) -> Scene:
    data = rod(field=[0.0, 0.0, field], ratio=ratio, cells=2).to_si()
    data["body"]["catheter"]["inner_diameter"] = DIAMETER - 2 * wall
    return Scene.from_si(data)


def _parts() -> Scene:
    """A held block, and an arm of 2 mm that it holds."""
    sizes = ((0.0, BASE), (BASE, BASE + ARM))
    meshes = [
        pack_mesh(block((a, -WIDE / 2, -HIGH / 2), (b, WIDE / 2, HIGH / 2))) for a, b in sizes
    ]
    parts = [
        {"mesh": meshes[0], "name": "base", "material": "silicone", "clamp": True},
        {
            "mesh": meshes[1],
            "name": "arm",
            "material": "silicone",
            "magnetization": [1.0, 0.0, 0.0],
        },
    ]
    return made(
        {"parts": {"unit": "mm", "meshes": parts}},
        {"silicone": {**SILICONE, "bulk_to_shear": 200.0}},
        field={"uniform": [0.0, 0.0, 4e-3]},
        effects={"magnetic_torque": {}},
    )


def _against_strip(scene: Scene) -> float:
    """Distance of the arm's middle from that of a strip of its size, over its length; infinite unless parts of one cell are refused."""
    parts = scene.to_si()["body"]["parts"]
    try:
        changed(scene, body={"parts": {**parts, "spacing": 1e-3 * HIGH}})
        return np.inf
    except InputError as error:
        if "spacing" not in str(error):
            return np.inf
    strip = {
        "length": 1e-3 * ARM,
        "width": 1e-3 * WIDE,
        "thickness": 1e-3 * HIGH,
        "material": "silicone",
    }
    segments = [{"magnetization": [1.0, 0.0, 0.0]}]
    alone = run(
        changed(scene, body={"strip": {**strip, "segments": segments}}, solver={"static": {}})
    )
    middle = run(scene).segment_center[1] - [1e-3 * BASE, 0.0, 0.0]
    return float(np.linalg.norm(middle - alone.segment_center[0])) / (1e-3 * ARM)


def _ringing(scene: Scene) -> float:
    """Pressure that alternates from cell to cell along the outermost row of cells, over G, as root mean square away from the clamp."""
    result = run(scene)
    model = build(scene)
    cell = model.particles.cell
    volume = model.particles.volume
    row = (cell[:, 1:] == cell[:, 1:].max(axis=0) // 2).all(axis=1)
    row &= cell[:, 0] > cell[:, 0].max() // 4
    along = cell[row, 0]
    count = np.bincount(along, volume[row])
    mean = (
        np.bincount(along, volume[row] * (result.particle_det_F[row] - 1))
        / np.where(count > 0, count, 1)
    )[along.min() : along.max()]
    pressure = scene.materials["silicone"].bulk_to_shear * mean  # of G
    alternating = pressure[1:-1] - 0.5 * (pressure[:-2] + pressure[2:])
    return float(np.sqrt(np.mean(alternating**2)))


def _permuted(scene: Scene) -> float:
    """Distance of tips over L, where the particles within each cell stand in another order."""
    made = scene.body.shape.discretize(
        scene.resolution.cells_across, scene.resolution.particles_per_cell
    )
    p = made.particles
    noise = np.random.default_rng(1)
    first = p.cell_first
    order = np.concatenate([a + noise.permutation(b - a) for a, b in itertools.pairwise(first)])
    position = p.position[order].astype(PRECISION).astype(np.float64)
    mixed = replace(
        p, position=position, volume=p.volume[order], segment=p.segment[order], cell=p.cell[order]
    )
    last = p.position[:, 0] > 0.98 * scene.length
    tips = []
    for particles in (p, mixed):
        found = solve_static(static_model(build(scene, replace(made, particles=particles))))
        moved = found.point.position if particles is p else found.point.position[np.argsort(order)]
        tips.append(moved[last].mean(axis=0))
    return float(np.linalg.norm(tips[1] - tips[0])) / scene.length


CASES = (
    Case(
        "antiparallel field through buckling",
        lambda: rod(
            length=2 * CATHETER_LENGTH,
            field=bending_field(EULER, np.pi, 2 * CATHETER_LENGTH),
            cells=4,
        ),
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
        lambda: rod(directions=SPATIAL, field=[2e-3, 10e-3, -14e-3], cells=3),
        "locks: deflections vanish as K/G grows",
        "distance of tips from the rod's, over L",
        _incompressible,
        0.025,
        "Cosserat rod; it and a solid of L/D = 10 differ by 0.05 D/L of the deflection"
        " (tests/validation/test_rod_statics.py)",
    ),
    Case(
        "no load, begun from a loaded neighbor",
        lambda: rod(field=bending_field(25.0, np.radians(150)), cells=3),
        "keeps a part of what it began from",
        "displacement left, over L",
        _from_a_loaded_neighbor,
        1e-8,
        "elastic: no load, no displacement; statics has no path, motion does (`loaded and"
        " unloaded`)",
    ),
    Case(
        "snap-through, both branches",
        _snapping,
        "stays on a branch that has ended, or snaps early and on one side only",
        "error of the two loads at which it snaps, relative",
        _snapped,
        0.05,
        "limit points of theta'' + a sin(theta) + b cos(theta) = 0 by shooting; 3 cells across,"
        " load known within 1/1000 of its way",
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
        "one equilibrium: tolerance 1e-11 of the energy, so sqrt(1e-11) of the displacement, thirty"
        " times that",
    ),
    Case(
        "ramp past a bifurcation",
        lambda: rod(field=bending_field(2 * EULER, np.pi), cells=2),
        "stays straight on the unstable branch",
        "distance of the ramped tips from that of statics, over L",
        _past_a_bifurcation,
        1e-3,
        "one buckled shape, turned about the axis as it may: 1e-4 L along a neutral direction, ten"
        " times that",
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
    Case(
        "parts of two cells",
        _parts,
        "locks or tears where parts are as thin as a cell or two",
        "middle of a thin part from that of a strip, over L; parts of one cell are refused",
        _against_strip,
        0.002,
        "the same body as a strip on the same cells; a tenth of the error of two cells across, 1 to"
        " 2 % of L",
    ),
    Case(
        "stiff inclusion",
        lambda: with_modulus(
            rod(directions=(X, (0.0, 0.0, 1.0), X), field=[0.0, 0.0, 20e-3], cells=3),
            [1],
            1000 * G,
        ),
        "takes hundreds of steps, or stops where the stiff part turns",
        "tip from the rod's, over L",
        from_rod,
        0.03,
        "Cosserat rod; stiff neighbors restrain soft ends, 1 to 2 % of L (tests/stability)",
    ),
    Case(
        "needle, L/D 200",
        _needle,
        "is too stiff, or stops: bending is 1e-9 as stiff as the stiffest mode",
        "tip from the rod's, over L",
        from_rod,
        0.003,
        "Cosserat rod; at two cells across F-bar bends 0.6 % too easily, 0.2 % of L here"
        " (tests/stability)",
    ),
    *(
        Case(
            f"thin tube, K/G = {ratio:g}",
            partial(_tube, ratio),
            "locks: the wall is a fiftieth of a cell",
            "tip from the rod's, over L",
            from_rod,
            0.002,
            "Cosserat rod, bent far less than for kinking (Brazier); tubes at K/G 20 are within 0.2"
            " % of L (tests/stability)",
        )
        for ratio in (100.0, 500.0)
    ),
    Case(
        "thin tube bent until it kinks",
        lambda: _tube(20.0, 0.1e-3, 7e-3),
        "gives the shape of a tube that stays round: at two cells across, or as a rod, nothing"
        " flattens",
        "1 where the result does not tell that the tube kinks",
        lambda scene: float("kinks" not in "".join(run(scene).warnings)),
        0.5,
        "bent to half of Brazier's radius; finer grids soften (1.6 % of L at 6 cells near the"
        " limit), and find no equilibrium there",
    ),
    Case(
        "stress without ringing",
        lambda: rod(field=bending_field(2.0), ratio=500.0, cells=4),
        "has pressures that alternate from cell to cell, a checkerboard",
        "alternating pressure along the body, over G",
        _ringing,
        5e-5,
        "pressure of a bent rod is smooth along it, and 0.1 G at most: a two-thousandth of that; a"
        " grid that locks has 9e-5",
    ),
    Case(
        "permuted particles",
        lambda: rod(
            directions=((1.0, 0.0, 0.0), (0.0, 0.6, 0.8)),
            field=bending_field(4.0),
            length=CATHETER_LENGTH,
            cells=3,
        ),
        "depends on the order of sums, or on a number's last bit",
        "distance of tips, over L",
        _permuted,
        1e-8,
        "the same sums in another order: rounding of 1e-16, times the condition of bending, 1e7",
    ),
)
