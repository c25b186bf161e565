"""Bodies that touch themselves at rest, against theory and against damped motions that have come to rest."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import DENSITY, moving_scene
from reference.scenes import G
from reference.solids import ball, box
from reference.stopped import interrupted_path

from magmpm import sensitivities
from magmpm.bodies.surface_mesh import Mesh, write_stl
from magmpm.dynamics.quasi_static import follow
from magmpm.results.result import Result
from magmpm.scene import Scene
from magmpm.simulate import run
from magmpm.solving.solve import at_rest

STATIC = {"solver": {"static": {}}}
STRIP = {
    "length": 20e-3,
    "width": 3e-3,
    "thickness": 0.5e-3,
    "clamp": "base",
    "plane_strain": True,
    "material": "m",
    "segments": [{"magnetization": [-1.0, 0.0, -0.36]}, {"magnetization": [1.0, 0.0, -0.36]}],
}


def folded(effects: dict[str, Any], *, by: float = 0.04, **more: Any) -> Scene:
    """A strip whose halves a field of this size (T) presses together."""
    every = {"magnetic_torque": {}, "self_contact": {}, **effects}
    field = {"uniform": [0.0, 0.0, by]}
    return moving_scene({"strip": STRIP}, every, shear=30e3, field=field, **more)


def parts(
    folder: Path, meshes: dict[str, tuple[Mesh, dict[str, Any]]], cell: float
) -> dict[str, Any]:
    """A body of these parts, each with what else it says."""
    listed = []
    for name, (mesh, more) in meshes.items():
        write_stl(mesh, folder / f"{name}.stl")
        about = {"mesh": str(folder / f"{name}.stl"), "name": name, "material": "m"}
        listed.append({**about, **more})
    return {"parts": {"unit": "m", "spacing": cell, "meshes": listed}}


def distance(one: Result, other: Result) -> float:
    """Largest distance of their particles, m."""
    way = one.particle_position - other.particle_position
    return float(np.linalg.norm(way, axis=1).max())


@pytest.mark.slow
def test_a_folded_strip_is_where_its_motion_comes_to_rest() -> None:
    """Within 1e-4 of its length; with 2 % asked. What is left of the motion after nine times of decay is e^-9 of 20 mm."""
    still = run(folded({}, **STATIC))
    moved = run(folded({"damping": {"rate": 300.0}}, duration=0.15))
    assert still.contacts["self_contact: segment 1, segment 2"]["count"] > 0
    assert distance(still, moved) < 1e-4 * STRIP["length"]
    for key in ("count", "depth"):
        told = still.contacts["self_contact"][key]
        assert told == pytest.approx(moved.contacts["self_contact"][key], rel=1e-2)


@pytest.mark.slow
def test_sensitivities_of_a_folded_strip_are_differences_of_runs() -> None:
    """By the field, to 1e-5: of 1e-6 T the tip moves by some 1e-8 m, and equilibria are found to 1e-14 m; curvature is less."""
    tight = {"solver": {"static": {"tolerance": 1e-13}}}
    told = sensitivities(folded({}, **tight), of=["field"])
    sides = [run(folded({}, by=0.04 + step, **tight)) for step in (1e-6, -1e-6)]
    assert sides[0].contacts["self_contact"]["count"] == sides[1].contacts["self_contact"]["count"]
    slope = (np.array(sides[0].tip) - np.array(sides[1].tip)) / 2e-6
    np.testing.assert_allclose(
        told.tip[:, told.names.index("field_z")], slope, atol=1e-5 * np.abs(slope).max()
    )


def test_bars_end_to_end_press_each_other_by_what_theory_says(tmp_path: Path) -> None:
    """Two bars held at their far ends, one ten times as stiff, with a gap, in a pull along them: the difference of their stretches less the
    gap, over the sum of their compliances. To 5 %: the held ends can't widen over half a thickness of six.
    """
    length = 12e-3
    wide = 2e-3
    gap = 5e-6
    pull = 600.0
    middle = length + gap
    end = middle + length
    held = {"clamp": True}
    stiff = {"material": "stiff"}
    meshes: dict[str, tuple[Mesh, dict[str, Any]]] = {
        "before": (box((-wide, 0.0, 0.0), (0.0, wide, wide)), held),
        "soft": (box((0.0, 0.0, 0.0), (length, wide, wide)), {}),
        "hard": (box((middle, 0.0, 0.0), (end, wide, wide)), stiff),
        "behind": (box((end, 0.0, 0.0), (end + wide, wide, wide)), {**stiff, **held}),
    }
    effects = {"gravity": {"acceleration": [pull, 0.0, 0.0]}, "self_contact": {}}
    found = run(moving_scene(parts(tmp_path, meshes, 1e-3), effects, **STATIC))
    young = 9 * 20 * G / 61  # 9 K G / (3 K + G)
    compliance = length / (young * wide**2)
    stretched = DENSITY * pull * length**2 / (2 * young)
    expected = (stretched * (1 - 1 / 10) - gap) / (compliance * (1 + 1 / 10))
    pair = "self_contact: soft, hard"
    assert found.contacts[pair]["force"][0] == pytest.approx(-expected, rel=0.05)
    np.testing.assert_allclose(found.contacts[pair]["force"][1:], 0.0, atol=1e-3 * expected)


def gripper(folder: Path, off: float = 0.2e-3) -> dict[str, Any]:
    """Two magnetized fingers that hang from a palm, around a ball that is held; off: m, of the ball from their middle."""
    meshes: dict[str, tuple[Mesh, dict[str, Any]]] = {
        "palm": (box((-6e-3, -2e-3, 0.0), (6e-3, 2e-3, 2e-3)), {"clamp": True}),
        "left": (
            box((-6e-3, -2e-3, -14e-3), (-4e-3, 2e-3, 0.0)),
            {"magnetization": [1.0, 0.0, 0.0]},
        ),
        "right": (
            box((4e-3, -2e-3, -14e-3), (6e-3, 2e-3, 0.0)),
            {"magnetization": [-1.0, 0.0, 0.0]},
        ),
        "ball": (ball((off, 0.0, -11e-3), 3e-3, 24), {"clamp": True}),
    }
    return parts(folder, meshes, 1e-3)


@pytest.mark.slow
def test_a_closed_gripper_is_where_its_motion_comes_to_rest(tmp_path: Path) -> None:
    """Fingers on a ball that is held, within 2 % of the gripper's length; and the forces by pair balance alike."""
    body = gripper(tmp_path)
    effects = {"magnetic_torque": {}, "self_contact": {}}
    field = {"uniform": [0.0, 0.0, 0.02]}
    still = run(moving_scene(body, effects, field=field, **STATIC))
    damped = {**effects, "damping": {"rate": 300.0}}
    moved = run(moving_scene(body, damped, field=field, duration=0.4))
    assert distance(still, moved) < 0.02 * 16e-3
    for pair in ("self_contact: left, ball", "self_contact: right, ball"):
        one, other = (each.contacts[pair]["force"] for each in (still, moved))
        np.testing.assert_allclose(one, other, atol=0.1 * float(np.linalg.norm(other)))


def test_each_finger_of_a_gripper_has_its_own_force(tmp_path: Path) -> None:
    """A symmetric gripper presses a ball from both sides alike, to the 3 % by which a ball of facets is none, though its palm joins the
    fingers. What the parts feel adds up to the forces on the nodes."""
    effects = {"magnetic_torque": {}, "self_contact": {}}
    field = {"uniform": [0.0, 0.0, 0.02]}
    scene = moving_scene(gripper(tmp_path, off=0.0), effects, field=field, **STATIC)
    _, solved = at_rest(scene, None, None)
    pairs = solved.energy.model.pairs
    touched = pairs.touched(solved.point.grid)
    told = {name: one["force"] for name, one in touched.report().items()}
    assert set(told) == {"self_contact", "self_contact: left, ball", "self_contact: right, ball"}
    left = told["self_contact: left, ball"]
    right = told["self_contact: right, ball"]
    assert left[0] < 0 < right[0]
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=0.03 * float(np.linalg.norm(right)))
    count = int(np.prod(pairs.displaced(solved.point.grid).shape)) // 3
    nodes = touched.force(count)
    np.testing.assert_allclose(left + right, nodes.sum(axis=0), atol=1e-12 * np.abs(nodes).sum())


def dragged(folder: Path, steps: int) -> Scene:
    """A bar on a held floor, pressed by its weight and dragged by its end, which is moved."""
    meshes: dict[str, tuple[Mesh, dict[str, Any]]] = {
        "floor": (box((-3e-3, -2e-3, -2e-3), (5e-3, 4e-3, 0.0)), {"clamp": True}),
        "bar": (box((0.0, 0.0, 5e-6), (8e-3, 2e-3, 2e-3)), {}),
        "end": (box((8e-3, 0.0, 5e-6), (10e-3, 2e-3, 2e-3)), {"clamp": True}),
    }
    pulled = {"along": [1.0, 0.0, 0.0], "distance": 0.1e-3}
    return moving_scene(
        parts(folder, meshes, 0.99e-3),
        {"gravity": {"acceleration": [0.0, 0.0, -40.0]}, "self_contact": {"friction": 0.3}},
        move={"end": {**pulled, "over_time": {"ramp": {"duration": 1.0}}}},
        solver={"quasi_static": {"steps": steps, "duration": 1.0}},
    )


def test_a_bar_that_is_dragged_over_a_part_feels_friction_times_its_push(tmp_path: Path) -> None:
    """Every point slides, so the floor pulls back by 0.3 of what it bears, to the 1e-3 to which friction is sought."""
    told = run(dragged(tmp_path, 2)).contacts
    assert told is not None
    force = told["self_contact: floor, bar"]["force"]
    assert force[0] == pytest.approx(-0.3 * force[2], rel=1e-3)
    assert abs(force[1]) < 1e-3 * force[0]


@pytest.mark.slow
def test_a_path_with_friction_among_parts_goes_on_from_a_checkpoint(tmp_path: Path) -> None:
    """Bit for bit, as what is held, and by what stretch, is stored."""
    path = dragged(tmp_path, 3)
    follow(path, folder=tmp_path / "whole")
    interrupted_path(path, tmp_path / "cut", 2)
    follow(path, folder=tmp_path / "cut", resume=True)
    for name in ("contacts.csv", "steps.csv"):
        whole = (tmp_path / "whole" / name).read_bytes()
        assert (tmp_path / "cut" / name).read_bytes() == whole


@pytest.mark.slow
def test_a_gripper_closes_with_friction_as_in_a_slow_motion(tmp_path: Path) -> None:
    """Its pull on the ball, after a path of four equilibria and after 0.6 s, differs by less than 3 %, as the motion still drags a little.
    Without friction it is a third of that."""
    body = gripper(tmp_path)
    effects = {"magnetic_torque": {}, "self_contact": {"friction": 0.4}}

    def pull(duration: float, **more: Any) -> np.ndarray:
        field = {"uniform": [0.0, 0.0, 0.02], "over_time": {"ramp": {"duration": duration}}}
        told = run(moving_scene(body, duration=duration, field=field, **more)).contacts
        assert told is not None
        fingers = [told[f"self_contact: {finger}, ball"]["force"] for finger in ("left", "right")]
        return np.sum(fingers, axis=0)

    still = pull(1.0, effects=effects, solver={"quasi_static": {"steps": 4, "duration": 1.0}})
    moved = pull(0.6, effects={**effects, "damping": {"rate": 100.0}})
    np.testing.assert_allclose(still, moved, rtol=0, atol=0.03 * np.linalg.norm(moved))
