"""Bodies that touch each other in motion, against mechanics: collisions, rest, rolling, sliding, wedges, folds; the same bits."""

from pathlib import Path

import numpy as np
import pytest
from reference.in_motion import advance
from reference.moving import block, moving_scene
from reference.parts import momenta, of_part, parts_scene, throw_part
from reference.solids import ball, box, turned

from magmpm.bodies.surface_mesh import Mesh
from magmpm.compiled.thread_count import Threads
from magmpm.dynamics import energies
from magmpm.dynamics.checkpoint import Checkpoint
from magmpm.dynamics.time_loop import SimulationState, begin, interval, move
from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.effects.contact_law import at_rest, contact_of, own_friction
from magmpm.kernels.body_contact import DEPTH, MEMORY
from magmpm.model import build
from magmpm.scene import Scene

EARTH = 9.81
# m
CUBE = 3e-3
CELL = 1.5e-3
FINE = 0.5e-3
# No damping to speak of, and a ground far below: bodies that touch under their weight are moved by one set of kernels.
NOTHING = {"damping": {"rate": 1e-6}, "ground": {"point": [0.0, 0.0, -0.1]}}


def shifted(mesh: Mesh, by: tuple[float, float, float]) -> Mesh:
    return Mesh(mesh.vertices + np.array(by), mesh.faces)


def two_blocks(folder: Path, **contact: float) -> Scene:
    """Two cubes with a small gap between faces that do not lie square on each other."""
    other = turned(box((0.0, 0.0, 0.0), (CUBE, CUBE, CUBE)), (1.0, 0.0, 0.0), 0.2)
    meshes = {
        "a": box((0.0, 0.0, 0.0), (CUBE, CUBE, CUBE)),
        "b": shifted(other, (CUBE + 0.1e-3, 0.3e-3, 0.4e-3)),
    }
    return parts_scene(folder, meshes, {"self_contact": contact}, CELL)


def depths(motion: TotalMotion) -> np.ndarray:
    """Depth (pairs,) m of each pair of a motion."""
    return np.asarray(motion.contact.meeting.memory[:-1].reshape(-1, MEMORY)[:, DEPTH])


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_collision_keeps_momentum_and_energy(tmp_path: Path, friction: float) -> None:
    """At 2 m/s: both momenta to rounding; no energy is gained, and without friction 0.5 % is lost at most; 0.15 cells deep at most."""
    begun = begin(build(two_blocks(tmp_path, friction=friction)))
    motion = begun.motion
    model = begun.motion.model
    throw_part(motion, 0, (2.0, 0.3, 0.0))
    before = momenta(motion)
    kinetic = motion.kinetic_energy()
    deepest = 0.0
    for _ in range(60):
        motion.advance(1, begun.dt, model.effects)
        deepest = max(deepest, float(depths(motion).max(initial=0.0)))
    assert 0 < deepest < 0.15 * model.scene.cell
    np.testing.assert_allclose(momenta(motion), before, rtol=0, atol=1e-12 * np.abs(before).max())
    _, _, F = motion.particles()
    change = (motion.kinetic_energy() + energies.elastic_energy(model, F)) / kinetic - 1
    assert (-0.005 if friction == 0 else -0.2) < change < 0.005
    assert of_part(model, 1, motion.particles()[1])[0] > 1.0


def test_what_touches_at_the_start_rests(tmp_path: Path) -> None:
    """Without loads: a peg in a slot, clear of it by a thousandth of a cell, and a cube on its edge. Nothing is pushed, and nothing moves.

    By its table alone the slot's solid was 0.04 cells off in its corners: the peg jumped out at 0.07 m/s.
    """
    clear = 1e-6
    meshes = {
        "below": box((0.0, -4e-3, 0.0), (6e-3, 4e-3, 2e-3)),
        "near": box((0.0, -4e-3, 2e-3), (6e-3, -1.5e-3, 5e-3)),
        "far": box((0.0, 1.5e-3, 2e-3), (6e-3, 4e-3, 5e-3)),
        "peg": box((1e-3, clear - 1.5e-3, 2e-3 + clear), (5e-3, 1.5e-3 - clear, 6e-3)),
        "on edge": box((6e-3, -4e-3, 5e-3), (8e-3, 4e-3, 7e-3)),
    }
    begun = begin(build(parts_scene(tmp_path, meshes, {"self_contact": {}}, 1e-3)))
    assert int(begun.motion.model.component.max()) == 2
    contact = begun.motion.body_contacts()["self_contact"]
    assert (contact["count"], contact["energy"]) == (0, 0.0)
    now = interval(begun, 0.5e-3)
    assert now.kinetic == 0.0
    np.testing.assert_array_equal(now.F, np.tile(np.eye(3), (len(now.F), 1, 1)))


def impact(scene: Scene, time: float) -> tuple[float, float]:
    """Depth in cells, and change of the energy, of a component 1 that falls on 0 at 2 m/s."""
    model = build(scene)
    begun = begin(model)
    deepest = 0.0
    motion = begun.motion
    throw_part(motion, 1, (0.0, 0.0, -2.0))
    before = motion.kinetic_energy()
    for _ in range(round(time / begun.dt)):
        advance(motion, 1, begun.dt)
        deepest = max(deepest, float(depths(motion).max(initial=0.0)))
    after = motion.kinetic_energy() + energies.elastic_energy(model, motion.particles()[2])
    return deepest / scene.cell, after / before - 1


def test_an_impact_of_a_ball(tmp_path: Path) -> None:
    """On a sheet at 2 m/s: 0.15 cells deep at most, and 0.5 % of the energy gained."""
    sheet = {
        "a": box((-4e-3, -4e-3, -1e-3), (4e-3, 4e-3, 0.0)),
        "b": ball((0.1e-3, 0.07e-3, 1.52e-3), 1.5e-3, 24),
    }
    depth, change = impact(parts_scene(tmp_path, sheet, {"self_contact": {}}, FINE), 3e-3)
    assert depth < 0.15
    assert -0.02 < change < 0.005


def test_edges_do_not_pass_through_each_other(tmp_path: Path) -> None:
    """Two edges that cross, at 2 m/s: half a cell deep at most; no energy is gained."""
    a = 2e-3
    low = turned(box((-a, -a / 2, -a / 2), (a, a / 2, a / 2)), (1.0, 0.0, 0.0), np.pi / 4)
    high = turned(box((-a / 2, -a, -a / 2), (a / 2, a, a / 2)), (0.0, 1.0, 0.0), np.pi / 4)
    rise = a / np.sqrt(2) + 0.02e-3
    meshes = {"a": shifted(low, (0.07e-3, 0.11e-3, -rise)), "b": shifted(high, (0.0, 0.0, rise))}
    depth, change = impact(parts_scene(tmp_path, meshes, {"self_contact": {}}, FINE), 3e-3)
    assert depth < 0.5
    assert -0.02 < change < 0.005


@pytest.mark.parametrize("sliver", [5e-6, 2e-4])
def test_a_sliver_of_a_cell_does_not_feed_a_collision(tmp_path: Path, sliver: float) -> None:
    """A face just beyond a plane of the grid, whose outer nodes are light: at 2 m/s 0.5 % of the energy is gained at most (19 % once)."""
    edge = 2e-3
    start = 3e-3 * (1 - sliver / 3)
    meshes = {
        "a": box((0.0, 0.0, 0.0), (edge, edge, edge)),
        "b": box((start, 0.3e-3, 0.2e-3), (start + edge, 2.3e-3, 2.2e-3)),
    }
    begun = begin(build(parts_scene(tmp_path, meshes, {"self_contact": {}}, 1e-3)))
    motion = begun.motion
    throw_part(motion, 0, (2.0, 0.3, 0.0))
    kinetic = motion.kinetic_energy()
    interval(begun, 2e-3)
    change = (
        motion.kinetic_energy() + energies.elastic_energy(motion.model, motion.particles()[2])
    ) / kinetic - 1
    assert -0.01 < change < 0.005
    assert of_part(motion.model, 1, motion.particles()[1])[0] > 1.0


def test_the_same_bits_on_any_number_of_threads_and_after_a_restart(tmp_path: Path) -> None:
    """A sliding collision, stopped in its midst: 60 steps on two threads; on one; and 30, then 30 from the stored state."""
    model = build(two_blocks(tmp_path, friction=0.5))

    def thrown() -> TotalMotion:
        motion = begin(model).motion
        throw_part(motion, 0, (2.0, 0.5, 0.0))
        return motion

    dt = begin(model).dt
    motions = [thrown() for _ in range(3)]
    motions[1].threads = Threads(1)
    for motion in motions[:2]:
        for _ in range(2):
            motion.advance(30, dt, model.effects)
    motions[2].advance(30, dt, model.effects)
    later = thrown()
    Checkpoint("", 0.0, 0.0, "", 0, 0, {}, motions[2].state()).must_fit(later.state(), "")
    later.restore({name: np.array(value) for name, value in motions[2].state().items()})
    later.advance(30, dt, model.effects)
    assert depths(motions[0]).any()
    for other in (motions[1], later):
        np.testing.assert_array_equal(other.u, motions[0].u)
        np.testing.assert_array_equal(other.v, motions[0].v)


def test_what_lies_on_another_presses_on_it_with_its_weight(tmp_path: Path) -> None:
    """A cube at rest on a cube on the ground: force, normal and point in the report, to 2 %; less than 0.02 cells deep."""
    meshes = {
        "below": box((0.0, 0.0, 0.0), (CUBE, CUBE, CUBE)),
        "above": box((0.0, 0.0, CUBE + 0.05e-3), (CUBE, CUBE, 2 * CUBE + 0.05e-3)),
    }
    effects = {
        "gravity": {},
        "damping": {"rate": 500.0},
        "ground": {"point": [0.0, 0.0, 0.0]},
        "self_contact": {},
    }
    state = move(build(parts_scene(tmp_path, meshes, effects, CELL, duration=0.05)))
    model = state.motion.model
    contacts = state.contacts
    weight = EARTH * model.density * model.particles.volume
    pressed = contacts["self_contact: below, above"]
    np.testing.assert_allclose(
        pressed["force"],
        [0, 0, -weight[model.particles.segment == 1].sum()],
        atol=0.02 * weight.sum(),
    )
    np.testing.assert_allclose(
        contacts["ground"]["force"], [0, 0, weight.sum()], atol=0.02 * weight.sum()
    )
    np.testing.assert_allclose(pressed["normal"], [0, 0, -1], atol=1e-2)
    np.testing.assert_allclose(pressed["point"], [CUBE / 2, CUBE / 2, CUBE], atol=0.02e-3)
    assert 0 < pressed["depth"] < 0.02 * model.scene.cell
    assert pressed["slip"] < 1e-3


@pytest.mark.parametrize(("friction", "tangent", "share"), [(0.3, 1.0, 0.7), (0.5, 0.3, 0.0)])
def test_a_block_slides_or_sticks_on_a_slope_of_another_part(
    tmp_path: Path, friction: float, tangent: float, share: float
) -> None:
    """At 45 degrees it accelerates by g (sin - mu cos), to 2 % with its fall; inside the cone it stops within 0.1 cell of where it fell."""
    angle = np.arctan(tangent)
    time = 0.04
    thick = 3e-3
    meshes = {
        "slope": box((-6e-3, -6e-3, -3e-3), (18e-3, 6e-3, 0.0)),
        "block": box((0.0, -3e-3, 0.03e-3), (6e-3, 3e-3, thick + 0.03e-3)),
    }
    pull = [EARTH * np.sin(angle), 0.0, -EARTH * np.cos(angle)]
    effects = {**NOTHING, "gravity": {"acceleration": pull}, "self_contact": {"friction": friction}}
    if not share:
        effects["damping"] = {"rate": 300.0}
    state = move(
        build(parts_scene(tmp_path, meshes, effects, 1.5e-3, held=["slope"], duration=time))
    )
    model = state.motion.model
    way = of_part(model, 1, state.x - model.particles.position)[0]
    assert way == pytest.approx(
        share * EARTH * np.sin(angle) * time**2 / 2, abs=0.1 * 1.5e-3 if share == 0 else 0.02 * 5e-3
    )


def test_a_slippery_block_slides_over_a_free_one_at_its_speed(tmp_path: Path) -> None:
    """To 0.1 % over its length, as points of the lower one pass under its edges; it is two that hold together. By tables it lost 6 %."""
    meshes = {
        "below": box((0.0, -6e-3, 0.0), (24e-3, 6e-3, 3e-3)),
        "above": box((6e-3, -3e-3, 3.006e-3), (9e-3, 3e-3, 6.006e-3)),
    }
    meshes["front"] = box((9e-3, -3e-3, 3.006e-3), (12e-3, 3e-3, 6.006e-3))
    effects = {
        "gravity": {},
        "ground": {"point": [0.0, 0.0, 0.0], "friction": 0.4},
        "self_contact": {},
    }
    damped, model = (
        build(parts_scene(tmp_path, meshes, {**effects, "damping": {"rate": rate}}, 1.5e-3))
        for rate in (300.0, 1e-6)
    )
    motion = begin(damped).motion
    dt = begin(damped).dt
    advance(motion, round(0.03 / dt), dt)
    throw_part(motion, 1, (0.3, 0.0, 0.0))
    motion.model = model
    advance(motion, round(0.02 / dt), dt)
    assert of_part(model, 1, motion.particles()[1])[0] == pytest.approx(0.3, rel=1e-3)


def prism(profile: list[tuple[float, float]], half: float) -> Mesh:
    """A prism along y, from -half to half (m), over four corners (x, z) m."""
    corners = np.array([(x, y, z) for y in (-half, half) for x, z in profile])
    quads = [(0, 1, 2, 3), (7, 6, 5, 4), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
    return Mesh(
        corners, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])
    )


@pytest.mark.slow
def test_a_block_is_pushed_up_a_wedge(tmp_path: Path) -> None:
    """Force over load is (tan a + mu) / (1 - mu tan a), to 0.1 % (NAFEMS, Benchmark tests for contact and sliding, CGS-4: 0.412371).

    The block loses a tenth in its vibration. One that loses nothing hops, and shears faster at 0.1 m/s than it slides: points turn round,
    and mean friction is 2 % less, by Coulomb's law itself (0.1 % less at 0.3 m/s).
    """
    slope = 0.1
    mu = 0.3
    lift = 0.02e-3
    expected = (slope + mu) / (1 - mu * slope)
    wedge = prism(
        [(-6e-3, -3e-3), (12e-3, -3e-3), (12e-3, slope * 12e-3), (-6e-3, -slope * 6e-3)], 3e-3
    )
    block = prism(
        [(0.0, lift), (4e-3, 4e-3 * slope + lift), (4e-3, 3e-3 + lift), (0.0, 3e-3 + lift)], 2e-3
    )
    pull = {"acceleration": [5 * EARTH * expected, 0.0, -5 * EARTH]}
    loss = {"viscosity": {"loss_factor": 0.1}}
    effects = {**NOTHING, **loss, "gravity": pull, "self_contact": {"friction": mu}}
    model = build(
        parts_scene(tmp_path, {"wedge": wedge, "block": block}, effects, 1.3e-3, held=["wedge"])
    )
    motion = begin(model).motion
    dt = begin(model).dt
    forces = []
    throw_part(motion, int(model.component[~model.held][0]), (0.1, 0.0, 0.01))
    for _ in range(
        600
    ):  # friction follows the push, which trembles, with a delay: their ratio is that of their means
        advance(motion, round(1e-4 / dt), dt)
        touching = motion.body_contacts().get("self_contact: wedge, block")
        forces.append(np.abs(touching["force"]) if touching else np.zeros(3))
    mean = np.mean(forces[300:], axis=0)
    assert mean[0] / mean[2] == pytest.approx(expected, rel=1e-3)


def test_a_ball_just_above_a_held_plate_is_not_joined_to_it(tmp_path: Path) -> None:
    """A gap of 5 um, a thousandth of a cell, and boxes that overlap: the ball moves aside."""
    meshes = {
        "plate": box((-4e-3, -4e-3, -3e-3), (4e-3, 4e-3, 0.0)),
        "ball": ball((0.0, 0.0, 1.505e-3), 1.5e-3, 24),
    }
    effects = {"gravity": {"acceleration": [5.0, 0.0, 0.0]}, "damping": {"rate": 1e-6}}
    scene = parts_scene(tmp_path, meshes, effects, FINE, held=["plate"], duration=0.01)
    state = move(build(scene))
    assert of_part(state.motion.model, 1, state.x - state.motion.model.particles.position)[
        0
    ] == pytest.approx(0.25e-3, rel=0.02)


def test_a_ball_rolls_down_another_part(tmp_path: Path) -> None:
    """5/7 g sin t^2 / 2 on 3 cells, to 5 %."""
    angle = np.deg2rad(11.5)
    time = 0.05
    radius = 1.5e-3
    meshes = {
        "slope": box((-2e-3, -2e-3, -2e-3), (6e-3, 2e-3, 0.0)),
        "ball": ball((0.0, 0.0, radius + 0.03e-3), radius, 24),
    }
    pull = [EARTH * np.sin(angle), 0.0, -EARTH * np.cos(angle)]
    effects = {**NOTHING, "gravity": {"acceleration": pull}, "self_contact": {"friction": 0.5}}
    state = move(build(parts_scene(tmp_path, meshes, effects, 1e-3, held=["slope"], duration=time)))
    model = state.motion.model
    way = of_part(model, 1, state.x - model.particles.position)[0]
    assert way == pytest.approx(5 / 7 * EARTH * np.sin(angle) * time**2 / 2, rel=0.05)


def test_halves_of_a_folding_sheet_meet_and_part_again() -> None:
    """Pressed together by a field they touch, less than 0.1 cell deep, and open again without it."""
    strip = {
        "length": 12e-3,
        "width": 3e-3,
        "thickness": 0.5e-3,
        "clamp": "none",
        "plane_strain": True,
        "material": "m",
        "segments": [{"magnetization": [-1.0, 0.0, -0.36]}, {"magnetization": [1.0, 0.0, -0.36]}],
    }
    moments = [
        {"time": time, "strength": strength}
        for time, strength in ((0.0, 0.0), (0.02, 1.0), (0.06, 1.0), (0.07, 0.0))
    ]
    scene = moving_scene(
        {"strip": strip},
        {"magnetic_torque": {}, "damping": {"rate": 300.0}, "self_contact": {}},
        shear=30e3,
        duration=0.14,
        field={"uniform": [0.0, 0.0, 0.04], "over_time": {"keyframes": moments}},
    )
    seen: list[tuple[float, int, float]] = []

    def see(state: SimulationState) -> None:
        contact = state.contacts["self_contact"]
        seen.append((state.time, contact["count"], contact["depth"]))

    state = move(build(scene), on_state=see)
    touched = [count for time, count, _ in seen if 0.03 < time < 0.06]
    assert min(touched) > 0
    assert max(depth for _, _, depth in seen) < 0.1 * scene.cell
    assert seen[-1][1] == 0
    assert state.x[:, 2].max() - state.x[:, 2].min() < 3e-3


@pytest.mark.slow
def test_legs_of_a_compressed_strip_touch() -> None:
    """Its clamped ends come within two thicknesses of each other: the legs of the arch meet in the middle, at most 0.15 cells deep."""
    body = {
        "length": 12e-3,
        "width": 3e-3,
        "thickness": 0.5e-3,
        "clamp": "both",
        "plane_strain": True,
        "material": "m",
        "segments": [{"magnetization": [0.0, 0.0, 0.0]}],
    }
    move_tip = {
        "tip": {"along": [-1, 0, 0], "distance": 11e-3, "over_time": {"ramp": {"duration": 0.025}}}
    }
    effects = {"gravity": {}, "damping": {"rate": 300.0}, "self_contact": {}}
    scene = moving_scene({"strip": body}, effects, shear=100e3, duration=0.035, move=move_tip)
    depth: list[float] = []
    state = move(
        build(scene), on_state=lambda state: depth.append(state.contacts["self_contact"]["depth"])
    )
    assert 0 < max(depth) < 0.15 * scene.cell
    assert state.contacts["self_contact: segment 1, itself"]["point"][0] == pytest.approx(
        0.5e-3, abs=0.05e-3
    )


@pytest.mark.parametrize("speed", [2.0, 30.0])
def test_forces_do_not_depend_on_when_pairs_were_listed(tmp_path: Path, speed: float) -> None:
    """A slow and a very fast collision, with pairs listed when they must be and before every step: the same places to rounding, and the
    same pairs touch. No point is ever farther from where it was listed than the bound on its way says.
    """
    begun = []
    model = build(two_blocks(tmp_path, friction=0.5))
    for _ in range(2):
        begun.append(begin(model).motion)
        throw_part(begun[-1], 0, (speed, 0.3 * speed, 0.0))
    dt = begin(model).dt * min(1.0, 4.0 / speed)
    touched = 0
    lists = 0
    last = begun[0].contact._then
    for _ in range(int(1e-3 / speed / dt) + 10):
        for motion in begun:
            contact = motion.contact
            if motion is begun[1]:
                contact._then[:] = np.inf
                contact.list(motion.u)
            before = motion.u.reshape(-1, 3).copy()
            way = contact.meeting.memory[-1]
            motion.advance(1, dt, model.effects)
            moved = contact.splines @ (motion.u.reshape(-1, 3) - before)
            assert np.linalg.norm(moved, axis=1).max() <= (contact.meeting.memory[-1] - way) * (
                1 + 1e-9
            )
        lists = lists + (begun[0].contact._then is not last)
        last = begun[0].contact._then
        often, seldom = (depths(motion)[depths(motion) > 0] for motion in begun)
        np.testing.assert_allclose(often, seldom, rtol=1e-6)
        touched += len(often)
    assert touched > 100
    assert 0 < lists < 20
    np.testing.assert_allclose(
        begun[0].particles()[0], begun[1].particles()[0], rtol=0, atol=1e-9 * CELL
    )


# Friction that a material names, in place of what the contact names: the ground, parts, a coated tip in a lumen


DOWN = {"acceleration": [6.0, 0.0, -6.0]}
UNDAMPED = {"rate": 1e-6}  # 1/s: nothing, but the kernels of other tests


def named(scene: Scene, **friction: float) -> Scene:
    """The scene with materials that name a friction of their own."""
    data = scene.to_si()
    for name, value in friction.items():
        data["materials"][name]["friction"] = value
    return Scene.from_si(data)


def test_a_material_stands_for_what_the_ground_names() -> None:
    """The same bits as on a ground that names it."""
    moved = []
    for ground, own in ((0.3, None), (0.0, 0.3), (0.7, 0.3)):
        effects = {
            "gravity": DOWN,
            "damping": UNDAMPED,
            "ground": {"point": [0.0, 0.0, 0.0], "friction": ground},
        }
        scene = moving_scene(block((4e-3, 4e-3, 2e-3)), effects, duration=0.01)
        state = move(build(scene if own is None else named(scene, m=own)))
        moved.append((state.x, state.contacts["ground"]["force"]))
    for x, force in moved[1:]:
        np.testing.assert_array_equal(x, moved[0][0])
        np.testing.assert_array_equal(force, moved[0][1])
    assert moved[0][1][0] == pytest.approx(-0.3 * moved[0][1][2], rel=0.05), (
        "to what a delay of friction leaves at one moment"
    )


def test_the_smaller_of_two_materials_counts(tmp_path: Path) -> None:
    """The same bits as where self_contact names it; a part that names none has the other's."""
    meshes = {
        "slope": box((-2e-3, -2e-3, -2e-3), (6e-3, 4e-3, 0.0)),
        "slider": box((0.0, 0.0, 0.005e-3), (2e-3, 2e-3, 2.005e-3)),
    }

    def run(friction: float, **own: float) -> np.ndarray:
        effects = {
            "gravity": DOWN,
            "damping": UNDAMPED,
            "ground": {"point": [0.0, 0.0, -0.1]},
            "self_contact": {"friction": friction},
        }
        scene = parts_scene(tmp_path, meshes, effects, 1e-3, held=["slope"], duration=0.006)
        data = scene.to_si()
        data["materials"]["slippery"] = dict(data["materials"]["m"])
        data["body"]["parts"]["meshes"][1]["material"] = "slippery"
        state = move(build(named(Scene.from_si(data), **own)))
        return np.asarray(state.x)

    found = run(0.3)
    assert np.abs(found - run(0.5)).max() > 1e-5
    for own in ({"m": 0.3, "slippery": 0.8}, {"m": 0.8, "slippery": 0.3}, {"slippery": 0.3}):
        np.testing.assert_array_equal(run(0.5, **own), found)


def test_a_coated_tip_slides_where_the_rest_grips() -> None:
    """In a lumen each point of the surface has the grip of its own material."""
    parts = [
        {"magnetization": [0.0, 0.0, 0.0]},
        {"magnetization": [0.0, 0.0, 0.0], "material": "stiff"},
    ]
    catheter = {"diameter": 2e-3, "length": 12e-3, "material": "m", "segments": parts}
    lumen = {
        "tube": {"radius": 3e-3, "path": [[-5e-3, 0.0, 0.0], [20e-3, 0.0, 0.0]]},
        "friction": 0.4,
    }
    model = build(named(moving_scene({"catheter": catheter}, {"walls": lumen}), stiff=0.05))
    own = own_friction(model.scene)
    np.testing.assert_array_equal(own, [np.nan, 0.05])
    x = np.array([[3e-3, 0.0, -3.02e-3], [9e-3, 0.0, -3.02e-3]])
    still = at_rest(x, np.full(2, 1e-9))
    push = contact_of(model.effects, at_rest(x[:1], np.full(1, 1e-9)))["force"][2]
    for k, friction in enumerate((0.4, 0.05)):
        dragged = still._replace(
            friction=own, pull=np.tile([-push, 0, 0], (2, 1)), most=np.full(2, push)
        )
        told = contact_of(model.effects, type(still)(*(part[k : k + 1] for part in dragged)))
        assert told["force"][0] == pytest.approx(-friction * told["force"][2], rel=1e-3)
    tip = model.particles.segment[model.surface.particle] == 1
    assert model.surface.place[tip, 0].min() > 5.5e-3
    assert model.surface.place[~tip, 0].max() < 6.5e-3


def test_energy_of_contact_is_counted() -> None:
    """A block bounces on slippery ground: of its fall the sum of all energies gains less than 0.5 % and loses less than 2 % at any time,
    in steps of second order: at half the step a quarter of it. The ground's springs hold some of it."""
    effects = {"gravity": {}, "damping": UNDAMPED, "ground": {"point": [0.0, 0.0, -0.2e-3]}}
    scene = moving_scene(block((2e-3, 2e-3, 2e-3)), effects, duration=0.04)
    begun = begin(build(scene))
    data = scene.to_si()
    for share, lost in ((1.0, 2e-2), (0.5, 5e-3)):
        data["solver"]["dynamic"]["time_step"] = share * begun.dt
        rows: list[dict[str, float]] = []
        move(build(Scene.from_si(data)), on_state=lambda state, to=rows: to.append(state.energies))
        total = np.array([sum(row.values()) for row in rows])
        ground = np.array([row["ground"] for row in rows])
        fall = max(row["kinetic"] for row in rows)
        assert (total - total[0]).max() < 0.25 * lost * fall
        assert (total - total[0]).min() > -lost * fall
        assert 0 < ground.max() < fall


def test_a_ball_passes_through_a_soft_tube(tmp_path: Path) -> None:
    """A slippery ball, wider than the bore by a fifteenth, at 1 m/s: the tube slows it down on its way in and gives the speed back on its
    way out, but for what shakes both (5 %); momentum stays."""
    around = np.arange(24) * np.pi / 12
    circle = np.column_stack([np.cos(around), np.sin(around)])
    vertices = np.concatenate(
        [np.insert(r * circle, 0, x, axis=1) for r in (3e-3, 1.5e-3) for x in (0.0, 6e-3)]
    )
    quads = []  # outer, inner, and the two ends
    for k in range(24):
        n = (k + 1) % 24
        quads += [(k, 24 + k, 24 + n, n), (48 + k, 48 + n, 72 + n, 72 + k)]
        quads += [(k, n, 48 + n, 48 + k), (24 + k, 72 + k, 72 + n, 24 + n)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, c, b), (a, d, c))])
    meshes = {"tube": Mesh(vertices, faces), "ball": ball((-2e-3, 0.0, 0.0), 1.6e-3, 16)}
    model = build(parts_scene(tmp_path, meshes, {"self_contact": {}}, 0.6e-3))
    begun = begin(model)
    motion = begun.motion
    assert motion.contact.names == ["tube", "ball"]
    throw_part(motion, 1, (1.0, 0.0, 0.0))
    before = momenta(motion)
    slowest = 1.0
    for _ in range(12):
        advance(motion, round(1e-3 / begun.dt), begun.dt)
        x, v, _ = motion.particles()
        slowest = min(slowest, float(of_part(model, 1, v)[0]))
    assert of_part(model, 1, x)[0] > 8e-3, "it is out of the tube"
    assert slowest < 0.85
    assert of_part(model, 1, v)[0] > 0.95
    np.testing.assert_allclose(momenta(motion)[:3], before[:3], rtol=0, atol=1e-9 * before[0])
