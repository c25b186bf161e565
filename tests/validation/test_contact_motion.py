"""Contact in motion against rigid-body mechanics: sliding, sticking, stopping, resting; a catheter in a tube and in a guide."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.in_motion import advance
from reference.moving import DENSITY, block, follow, moving_scene
from reference.parts import of_part, parts_scene, throw_part
from reference.scenes import G
from reference.solids import ball, box

from magmpm.bodies import signed_distance as distance
from magmpm.bodies.curves import curve
from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.dynamics import energies
from magmpm.dynamics.time_loop import begin, interval
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.model import Model, build
from magmpm.scene import load_scene
from magmpm.simulate import run

EARTH = 9.81
FRICTION = 0.3
SIZE = (6e-3, 6e-3, 3e-3)  # m, a block of 4 x 4 x 2 cells


def sloped(
    angle: float,
    friction: float = FRICTION,
    size: Sequence[float] = SIZE,
    g: float = EARTH,
    cells: int = 2,
    stiffness: float = 1.0,
    shear: float = G,
    **more: Any,
) -> Model:
    """The block on a slope: gravity g (m/s^2) rotated by the angle (rad); stiffness of its contact; more: other effects."""
    pull = {"acceleration": [g * np.sin(angle), 0.0, -g * np.cos(angle)]}
    ground = {"point": [0, 0, 0], "friction": friction, "stiffness": stiffness}
    return build(
        moving_scene(
            block(size), {"gravity": pull, "ground": ground, **more}, cells=cells, shear=shear
        )
    )


# Way (mm) after 0.3 s of the bottom of a block in plane strain, 8 x 4 mm, 120 kPa, friction 0.45, by finite elements with Coulomb's law
# solved exactly at each node and instant, 16 elements through the height: tangent over friction, viscosity (Pa s), time (s) over which
# the weight comes.
EXACT = {
    (0.89, 5.0, 0.0): 0.00267,
    (0.955, 5.0, 0.0): 1.458,
    (1.02, 5.0, 0.0): 5.147,
    (1.02, 5.0, 0.1): 3.438,
    (0.99, 5.0, 0.1): 0.0001,
    (0.99, 20.0, 0.0): 0.0099,
    (1.02, 20.0, 0.0): 3.871,
}
QUICK = {((1.02, 5.0, 0.0), 4), ((0.99, 5.0, 0.1), 4)}


@pytest.mark.parametrize(
    ("ratio", "viscosity", "ramp", "cells"),
    [
        pytest.param(*case, cells, marks=[] if (case, cells) in QUICK else pytest.mark.slow)
        for case in EXACT
        for cells in (4, 8)
        if cells == 8 or (case, cells) in QUICK
    ],
)
def test_a_block_goes_as_far_as_by_coulombs_law(
    ratio: float, viscosity: float, ramp: float, cells: int
) -> None:
    """Within 15 %, and ways below 0.02 mm within 0.01 mm. Bounce and shear of the body take turns in loosening its grip: a rigid block
    would stay below a ratio of 1, and go 3.61 mm at 1.02 and once."""
    exact = EXACT[ratio, viscosity, ramp]
    slope = np.arctan(0.45 * ratio)
    strip = block((8e-3, 4e-3, 4e-3), plane_strain=True)
    pull = {"acceleration": [EARTH * np.sin(slope), 0.0, -EARTH * np.cos(slope)]}
    effects = {
        "gravity": pull,
        "ground": {"point": [0.0, 0.0, 0.0], "friction": 0.45},
        "viscosity": {"viscosity": viscosity},
    }
    begun = begin(build(moving_scene(strip, effects, cells=cells, shear=120e3)))
    steps = round(0.3 / begun.dt)
    dt = 0.3 / steps
    growing = round(ramp / dt)
    grown = (np.arange(growing) + 0.5) / max(growing, 1)
    pull_by(begun.motion, dt, grown[:, None] * pull["acceleration"])
    left = steps - growing
    assert begun.motion.advance(left, dt, begun.motion.model.effects) == (left, False)
    assert 1e3 * way_of_the_bottom(begun.motion) == pytest.approx(
        exact, abs=0.01 if exact < 0.02 else 0.15 * exact
    )


def pull_by(motion: TotalMotion, dt: float, acceleration: np.ndarray) -> None:
    """Take a step of dt (s) under each acceleration (n, 3) m/s^2 in place of gravity's."""
    loads = list(motion.model.effects)
    at = next(k for k, part in enumerate(loads) if "gravity" in (part.dtype.names or ()))
    steps = len(acceleration)
    if steps:
        loads[at] = np.repeat(loads[at], steps)
        loads[at]["gravity"] = acceleration
        assert motion.advance(steps, dt, tuple(loads)) == (steps, False)


def way_of_the_bottom(motion: TotalMotion) -> float:
    """Mean way (m) along x of the points that were at z = 0."""
    before = motion.packed.surface.place.reshape(-1, 3)
    moved = motion.touching_points().x - before
    return float(moved[before[:, 2] < 1e-9, 0].mean())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("length", "height", "friction", "exact"),
    [(8e-3, 4e-3, 0.45, 0.994), (4e-3, 4e-3, 0.3, 0.998), (9e-3, 3e-3, 0.8, 0.938)],
)
def test_a_block_on_a_slow_tilt_slips_where_finite_elements_do(
    length: float, height: float, friction: float, exact: float
) -> None:
    """The tangent grows from 0.8 to 1.08 of the friction in 0.5 s; loss factor 0.1. Finite elements as in EXACT, 8 through the height, slip
    at 0.994, 0.998 and 0.938 of it: with friction 0.8 the body flutters before it slides.

    Within 1 %: 16 elements slip at 0.993, 0.995 and 0.928. Way grows as the cube of the time since the onset, which a straight line
    through its cube roots gives, from 5 um to 0.3 mm.
    """
    strip = block((length, height, height), plane_strain=True)
    effects = {
        "gravity": {},
        "ground": {"point": [0.0, 0.0, 0.0], "friction": friction},
        "viscosity": {"loss_factor": 0.1},
    }
    begun = begin(build(moving_scene(strip, effects, cells=4, shear=120e3)))
    parts = 500
    steps = round(0.7 / begun.dt / parts) * parts
    time = (np.arange(steps) + 0.5) * 0.7 / steps
    ratio = 0.8 + 0.28 * np.maximum(time - 0.2, 0.0) / 0.5
    slope = np.arctan(friction * ratio)
    weight = EARTH * np.minimum(time / 0.1, 1.0)
    pull = np.stack([weight * np.sin(slope), 0.0 * slope, -weight * np.cos(slope)], axis=1)
    ways = []
    for part in np.split(pull, parts):
        pull_by(begun.motion, 0.7 / steps, part)
        ways.append(way_of_the_bottom(begun.motion))
    way = np.array(ways) - ways[parts // 4]
    then = ratio.reshape(parts, -1)[:, -1]
    on = (way > 5e-6) & (way < 0.3e-3)
    slope_of_root, root_at_zero = np.polyfit(then[on], np.cbrt(way[on]), 1)
    assert -root_at_zero / slope_of_root == pytest.approx(exact, rel=0.01)


@pytest.mark.slow
def test_a_block_that_is_shaken_walks_by_the_phase_of_its_weight() -> None:
    """Its push swings along the ground, its weight up and down: at a phase of 0 it walks as by Coulomb's law, -1.76 mm/s, within 10 %; at
    90 degrees slips forward and back are equal, and it goes less than 8 % of that. By the same finite elements, 1 Pa s."""

    def drift(phase: float) -> float:
        effects = {
            "gravity": {},
            "ground": {"point": [0.0, 0.0, 0.0], "friction": 0.4},
            "viscosity": {"viscosity": 1.0},
        }
        strip = block((8e-3, 4e-3, 4e-3), plane_strain=True)
        model = build(moving_scene(strip, effects, cells=4, shear=120e3))
        begun = begin(model)
        per = round(0.02 / begun.dt)  # steps in a period
        dt = 0.02 / per
        mass = model.density * model.particles.volume
        places = []
        for period in range(20):
            time = 0.02 * period + (np.arange(per) + 0.5) * dt
            grown = np.minimum(time / 0.05, 1.0)
            swing = 2 * np.pi * time / 0.02
            along = 0.9 * 0.4 * EARTH * grown * np.sin(swing)
            down = -EARTH * (1 + 0.6 * grown * np.sin(swing + phase))
            pull_by(begun.motion, dt, np.stack([along, 0.0 * along, down], axis=1))
            places.append(float(mass @ begun.motion.particles()[0][:, 0] / mass.sum()))
        return 1e3 * (places[-1] - places[4]) / 0.3

    assert drift(0.0) == pytest.approx(-1.76, rel=0.1)
    assert abs(drift(np.pi / 2)) < 0.08 * 1.76


def mean(model: Model, values: np.ndarray) -> np.ndarray:
    """Mean over the mass of the body."""
    mass = model.density * model.particles.volume
    return mass @ values / mass.sum()


def test_a_block_slides_down_a_slope() -> None:
    """At 45 degrees it accelerates by g (sin - mu cos), to 0.3 %, including the first moments, in which it settles on the ground."""
    model = sloped(np.pi / 4)
    (then,) = follow(model, [0.04])
    way = mean(model, then.x - model.particles.position)
    a = EARTH * np.sqrt(0.5) * (1 - FRICTION)
    np.testing.assert_allclose(way, [a * 0.04**2 / 2, 0, 0], rtol=0, atol=0.003 * a * 0.04**2 / 2)


def test_a_block_sticks_on_a_gentle_slope() -> None:
    """Inside the friction cone, tan = 0.25 < mu, with losses in its material, it settles within 2 um, and then does not creep.

    Friction that at most stops a particle within a step creeps by (M / m) g sin dt, 10 um in these 0.03 s.
    """
    model = sloped(np.arctan(0.25), viscosity={"viscosity": 5.0})
    early, late = (
        mean(model, moment.x - model.particles.position)[0]
        for moment in follow(model, [0.03, 0.06])
    )
    assert 0 < early < 3e-6
    assert abs(late - early) < 2e-7


def test_a_stuck_block_does_not_depend_on_the_time_step() -> None:
    """A thousand times heavier, with damping, it moves by 0.57 mm, more than it leans with friction 10: it slips while the weight acts at
    once. Half the step changes that by less than 2 %; three and four cells are within 5 % of five. (Two cells: 16 % less.)

    Friction that at most stops a particle within a step lets it creep by 3.7 mm, and by 2.1 mm at half the step.
    """

    def moved(friction: float, halves: int, cells: int = 3) -> float:
        model = sloped(
            np.arctan(0.25), friction, g=1000 * EARTH, cells=cells, damping={"rate": 1000.0}
        )
        motion = begin(model).motion
        dt = begin(model).dt / halves
        motion.advance(round(0.02 / dt), dt, model.effects)
        return float(mean(model, motion.particles()[0] - model.particles.position)[0])

    ends = [moved(FRICTION, halves) for halves in (1, 2)]
    assert abs(ends[1] - ends[0]) < 0.02 * abs(ends[0])
    assert moved(10.0, 1) < ends[0]
    assert [ends[0], moved(FRICTION, 1, cells=4)] == pytest.approx(
        [moved(FRICTION, 1, cells=5)] * 2, rel=0.05
    )


def test_a_sliding_block_stops_where_friction_has_taken_its_energy() -> None:
    """With initial speed v on level ground it stops after v^2 / (2 mu g), to 1 %, and does not move back. Its material loses energy."""
    model = sloped(0.0, viscosity={"viscosity": 5.0})
    motion = begin(model).motion
    motion.v.reshape(-1, 3)[:, 0] = 0.1 * (
        motion.packed.nodes.inverse_mass.reshape(-1, 3)[:, 0] > 0
    )
    stopped, later = (
        mean(model, m.x - model.particles.position)[0]
        for m in follow(model, [0.036, 0.045], motion)
    )
    assert stopped == pytest.approx(0.1**2 / (2 * FRICTION * EARTH), rel=0.01)
    assert later == pytest.approx(stopped, rel=1e-3)


def test_a_dropped_block_comes_to_rest_with_its_weight_on_the_ground() -> None:
    """With damping, slippery: the contact force is the weight, borne by all points of the lower face, evenly but for edges (a quarter)."""
    ground = {"point": [0.0, 0.0, 0.0]}
    effects = {"gravity": {}, "damping": {"rate": 400.0}, "ground": ground}
    model = build(moving_scene(block(SIZE, position=[0.0, 0.0, SIZE[2] / 2 + 0.1e-3]), effects))
    (rest,) = follow(model, [0.06])
    weight = EARTH * float((model.density * model.particles.volume).sum())
    told = rest.contacts["ground"]
    np.testing.assert_allclose(told["force"], [0, 0, weight], rtol=0, atol=5e-3 * weight)
    low = model.surface.place[:, 2] == model.surface.place[:, 2].min()
    assert told["count"] == low.sum()
    law = model.effects[-2][0]
    depth = weight / (law["ground_stiffness"] * model.surface.mass[low].sum())
    assert depth < told["depth"] < 1.35 * depth
    assert mean(model, rest.x)[2] == pytest.approx(SIZE[2] / 2, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    "safety",
    [
        0.4,
        pytest.param(
            0.8,
            marks=pytest.mark.xfail(
                strict=True,
                reason="-1.2 to 1.3 %: a push begins in full where a point is found inside",
            ),
        ),
    ],
)
def test_a_flat_face_that_lands_keeps_its_energy(safety: float) -> None:
    """A cube of 4 mm and 4 cells: after it has left the ground it vibrates and flies with 0.5 % more to 1 % less than it had, wherever in a
    step it landed; 0.15 cells deep at most."""
    edge = 4e-3
    for speed, gap in ((0.5, 0.1e-3), (0.5, 0.37e-3), (2.0, 0.1e-3), (2.0, 0.23e-3)):
        cube = block((edge, edge, edge), position=[0.0, 0.0, edge / 2 + gap])
        effects = {"ground": {"point": [0.0, 0.0, 0.0]}}
        steps = {"solver": {"dynamic": {"duration": 1.0, "safety": safety}}}
        model = build(moving_scene(cube, effects, cells=4, shear=1e5, **steps))
        begun = begin(model)
        motion = begun.motion
        motion.v.reshape(-1, 3)[:, 2] = -speed * (motion.packed.nodes.inverse_mass[::3] > 0)
        before = motion.kinetic_energy()
        deepest = 0.0
        wave = np.sqrt(1e5 * (20 + 4 / 3) / DENSITY)  # m/s
        for _ in range(round((2 * gap / speed + 7 * edge / wave) / begun.dt / 5)):
            advance(motion, 5, begun.dt)
            at = model.scene.effects.ground.report(model, motion.touching_points())
            deepest = max(deepest, at["depth"])
        assert 0.0 < deepest < 0.15 * model.scene.cell
        assert at["count"] == 0
        after = []
        for _ in range(20):
            advance(motion, 3, begun.dt)
            F = motion.particles()[2]
            after.append(motion.kinetic_energy() + energies.elastic_energy(model, F))
        assert -0.01 < np.mean(after) / before - 1 < 0.005


def test_a_motion_that_lands_flat_keeps_its_energy() -> None:
    """The same cube, as the loop over time moves it: it looks at the sum of all energies. Steps all alike have up to 1.2 % more.

    At most 0.5 % more, which is what the watch allows, and 1 % less.
    """
    edge = 4e-3
    speed = 2.0
    wave = np.sqrt(1e5 * (20 + 4 / 3) / DENSITY)  # m/s
    for part in range(6):
        gap = 0.1e-3 + 0.08e-3 * part  # a step goes 0.04 mm
        cube = block((edge, edge, edge), position=[0.0, 0.0, edge / 2 + gap])
        model = build(
            moving_scene(cube, {"ground": {"point": [0.0, 0.0, 0.0]}}, cells=4, shear=1e5)
        )
        begun = begin(model)
        motion = begun.motion
        motion.v.reshape(-1, 3)[:, 2] = -speed * (motion.packed.nodes.inverse_mass[::3] > 0)
        before = motion.kinetic_energy()
        interval(begun, 0.5 * gap / speed)
        interval(begun, 2 * gap / speed + 7 * edge / wave)
        at = model.scene.effects.ground.report(model, motion.touching_points())
        assert at["count"] == 0
        after = []
        for _ in range(20):
            interval(begun, begun.time + 3 * begun.dt)
            F = motion.particles()[2]
            after.append(motion.kinetic_energy() + energies.elastic_energy(model, F))
        assert -0.01 < np.mean(after) / before - 1 < 0.005


def with_ball(folder: Path, mesh: Mesh, effects: dict[str, Any], **more: Any) -> Model:
    write_stl(mesh, folder / "ball.stl")
    parts = {"unit": "mm", "meshes": [{"mesh": str(folder / "ball.stl"), "material": "m"}]}
    return build(moving_scene({"parts": parts}, effects, **more))


def test_a_ball_rests_with_its_centre_at_its_radius(tmp_path: Path) -> None:
    """From an STL mesh, with no particle on its surface: height to the depth from which contact is stiff, 2 % of a cell, and the weight."""
    effects = {
        "gravity": {},
        "damping": {"rate": 300.0},
        "ground": {"point": [0.0, 0.0, 0.0], "friction": FRICTION},
    }
    model = with_ball(tmp_path, ball((0.0, 0.0, 1.0), 1.0), effects)
    (rest,) = follow(model, [0.03])
    weight = EARTH * float((model.density * model.particles.volume).sum())
    np.testing.assert_allclose(
        rest.contacts["ground"]["force"], [0, 0, weight], rtol=0, atol=0.02 * weight
    )
    assert mean(model, rest.x) == pytest.approx([0, 0, 1e-3], abs=0.02e-3)


def test_a_ball_rolls_down_a_slope(tmp_path: Path) -> None:
    """A soft ball on 11.5 degrees with friction 0.5 covers 5/7 g sin t^2 / 2 on 3 cells, within 3 %; by its particles, 0.2 %."""
    angle = np.deg2rad(11.5)
    time = 0.05
    pull = [EARTH * np.sin(angle), 0.0, -EARTH * np.cos(angle)]
    effects = {
        "gravity": {"acceleration": pull},
        "ground": {"point": [0.0, 0.0, -1.5e-3], "friction": 0.5},
    }
    model = with_ball(tmp_path, ball((0.0, 0.0, 0.0), 1.5, 40), effects, cells=3)
    (then,) = follow(model, [time])
    way = mean(model, then.x - model.particles.position)[0]
    assert way == pytest.approx(5 / 7 * EARTH * np.sin(angle) * time**2 / 2, rel=0.03)


@pytest.mark.parametrize("on", ["ground", "part"])
def test_a_ball_slides_until_it_rolls(tmp_path: Path, on: str) -> None:
    """Thrown flat without spin it ends at 5/7 of its speed, after 2 v / (7 mu g), whatever the friction: within 2 % on 3 cells.

    Its weight comes at once, so it trembles; the speed is the mean over as long as it slid.
    """
    radius = 1.5e-3
    speed = 0.1
    effects: dict[str, Any] = {"gravity": {}, "viscosity": {"viscosity": 1.0}}
    meshes = {"ball": ball((0.0, 0.0, radius + 1e-5), radius, 24)}
    if on == "ground":
        effects["ground"] = {"point": [0.0, 0.0, 0.0], "friction": FRICTION}
    else:
        effects["self_contact"] = {"friction": FRICTION}
        meshes["floor"] = box((-4e-3, -3e-3, -2e-3), (8e-3, 3e-3, 0.0))
    model = build(parts_scene(tmp_path, meshes, effects, 1e-3, held=["floor"]))
    begun = begin(model)
    throw_part(begun.motion, int(model.component[~model.held][0]), (speed, 0.0, 0.0))
    slid = 2 * speed / (7 * FRICTION * EARTH)
    advance(begun.motion, round(1.5 * slid / begun.dt), begun.dt)
    before = of_part(model, 0, begun.motion.particles()[0])[0]
    steps = round(slid / begun.dt)
    advance(begun.motion, steps, begun.dt)
    way = of_part(model, 0, begun.motion.particles()[0])[0] - before
    assert way / (steps * begun.dt) == pytest.approx(5 / 7 * speed, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("cell", "stiffness"), [(1e-3, 4.0), (0.5e-3, 1.0)])
def test_a_ball_is_pressed_as_elasticity_says(
    tmp_path: Path, cell: float, stiffness: float
) -> None:
    """A ball of 6 mm under its own weight, in which the circle of contact is a = 0.2 R: the middle comes down by (1 - 0.57 a/R) a^2/R,
    where the weight is 4 E* a^3 / (3 R) (Hertz; the factor by Legendre polynomials; axisymmetric finite elements say the same to 0.3 %).

    Within 8 %, as the spring of a contact has a depth of its own; with 6 cells and the usual stiffness it is 14 %.
    """
    radius = 3e-3
    wide = 0.2 * radius
    shear = 120e3
    nu = (3 * 20 - 2) / (2 * (3 * 20 + 1))  # K = 20 G
    plane = 2 * shear / (1 - nu)  # E / (1 - nu^2)
    pull = plane * wide**3 / (np.pi * DENSITY * radius**4)
    effects = {
        "gravity": {"acceleration": [0.0, 0.0, -pull]},
        "damping": {"rate": 400.0},
        "ground": {"point": [0.0, 0.0, 0.0], "stiffness": stiffness},
    }
    meshes = {"ball": ball((0.0, 0.0, radius), radius, 60)}
    model = build(parts_scene(tmp_path, meshes, effects, cell, shear=shear))
    begun = begin(model)
    advance(begun.motion, round(0.04 / begun.dt), begun.dt)
    middle = np.linalg.norm(model.particles.position - [0.0, 0.0, radius], axis=1) < 0.35 * radius
    moved = (begun.motion.particles()[0] - model.particles.position)[middle, 2]
    down = -np.average(moved, weights=model.particles.volume[middle])
    assert down == pytest.approx((1 - 0.57 * wide / radius) * wide**2 / radius, rel=0.08)


CATHETER = {
    "catheter": {
        "length": 12e-3,
        "diameter": 2e-3,
        "material": "m",
        "segments": [{"magnetization": [0.0, 0.0, 0.0]}],
    }
}


def test_a_catheter_lies_in_a_bent_tube() -> None:
    """It sinks to the wall, stays inside, and the wall carries its weight: the reported force agrees to 2 %."""
    path = [[-5e-3, 0.0, -0.5e-3], [6e-3, 0.0, 0.0], [17e-3, 0.0, -0.5e-3]]
    walls = {"tube": {"radius": 1.5e-3, "path": path}, "friction": 0.5}
    free = {"catheter": {**CATHETER["catheter"], "clamp": "none"}}
    model = build(moving_scene(free, {"gravity": {}, "damping": {"rate": 200.0}, "walls": walls}))
    weight = EARTH * float((model.density * model.particles.volume).sum())
    axis = curve(np.array(path), 1e-5)
    for moment in follow(model, [0.01, 0.02, 0.1]):
        assert distance.to_path(moment.x, axis).max() < 1.5e-3
    told = moment.contacts["walls"]
    np.testing.assert_allclose(told["force"], [0, 0, weight], rtol=0, atol=0.02 * weight)
    assert told["depth"] < 0.02 * model.scene.cell


def test_feed_pushes_by_speed_times_time_and_keeps_the_guide_straight() -> None:
    """In the guide every particle moves along it by speed times time, to 1e-6 m; outside the guide the tip falls under its weight."""
    effects = {"gravity": {}, "feed": {"speed": 0.02, "exit": 6e-3}}
    model = build(moving_scene(CATHETER, effects, duration=0.02))
    assert not model.clamped_face
    (then,) = follow(model, [0.02])
    X = model.particles.position
    held = then.x[:, 0] < 6e-3 - 2 * model.grid.spacing[0]
    assert held.sum() > 100
    moved = then.x - X
    np.testing.assert_allclose(
        moved[held], np.tile([0.02 * 0.02, 0, 0], (held.sum(), 1)), rtol=0, atol=1e-6
    )
    assert moved[X[:, 0] > 11e-3, 2].mean() < -20e-6


def test_the_guide_ends_within_half_a_cell_of_its_exit() -> None:
    """A catheter that hangs from a guide at rest bends under its weight like a cantilever of the free length: w L^4 / 8 E I.

    Averaged over three positions of the exit in a cell, the length is correct to a fifth of a cell (it was half a cell too long).
    """
    whole_length = CATHETER["catheter"]["length"]
    cell = 1e-3
    off = []
    clamped = moving_scene(CATHETER, {"gravity": {}}, solver={"static": {}})
    places = build(clamped).particles.position
    end = places[:, 0] > whole_length - 1e-3
    whole = -(run(clamped).particle_position - places)[end, 2].mean()
    for beyond in np.arange(3) * cell / 3:
        effects = {
            "gravity": {},
            "damping": {"rate": 600.0},
            "feed": {"speed": 0.0, "exit": 6e-3 + beyond},
        }
        model = build(moving_scene(CATHETER, effects))
        then = list(follow(model, [0.04, 0.05]))
        fall = [-(moment.x - model.particles.position)[end, 2].mean() for moment in then]
        assert fall[1] == pytest.approx(fall[0], rel=2e-3), "at rest"
        off.append(whole_length * (fall[1] / whole) ** 0.25 - (whole_length - 6e-3 - beyond))
    assert np.abs(off).max() < 0.65 * cell
    assert abs(np.mean(off)) < cell / 5


def test_feed_holds_a_base_that_is_not_clamped_and_says_so() -> None:
    """With feed, `clamp: none` gives the same model and the same motion as `clamp: base`, plus a warning."""
    effects = {"gravity": {}, "feed": {"speed": 0.02, "exit": 6e-3}}
    free = {"catheter": {**CATHETER["catheter"], "clamp": "none"}}
    clamped, loose = (moving_scene(body, effects, duration=0.02) for body in (CATHETER, free))
    assert not any(
        "clamp" in text
        for text in clamped.warnings() + moving_scene(free, {"gravity": {}}).warnings()
    )
    assert [text for text in loose.warnings() if "clamp" in text] == [
        "body.catheter.clamp: none has no effect here: the guide of feed holds and pushes the base,"
        " clamped or not"
    ]
    (one,), (two,) = (follow(build(scene), [0.2e-3]) for scene in (clamped, loose))
    assert one.x.tobytes() == two.x.tobytes()


@pytest.mark.slow
def test_the_shipped_vessel_turns_the_catheter_that_is_fed_into_it() -> None:
    """The base is pushed by speed times time; the wall keeps the catheter inside, pushes it back and sideways, and deflects its tip."""
    scene = load_scene(Path(__file__).parents[2] / "data/scenes/fed_into_vessel.yaml")
    model = build(scene)
    axis = curve(np.array(scene.effects.walls.tube.path), 1e-4)
    for moment in follow(model, [0.1, 0.2]):
        assert distance.to_path(moment.x, axis).max() < 2.5e-3
    base = model.particles.position[:, 0] < 2e-3
    tip = model.particles.position[:, 0] > 39e-3
    assert (moment.x - model.particles.position)[base].mean(axis=0) == pytest.approx(
        [12e-3, 0, 0], abs=1e-6
    )
    assert moment.x[tip, 2].mean() > 2e-3
    assert moment.contacts["walls"]["force"][0] < 0 < moment.contacts["walls"]["force"][2]
    assert moment.contacts["walls"]["depth"] < 0.02 * scene.cell
