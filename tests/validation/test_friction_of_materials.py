"""Friction that a material names, in place of what the contact names: the ground, parts, a coated tip in a lumen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.moving import block, moving_scene
from reference.parts import parts_scene
from reference.solids import box

from magmpm.dynamics.time_loop import move
from magmpm.effects.contact_law import at_rest, contact_of, own_friction
from magmpm.model import build
from magmpm.scene import Scene

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
        effects = {"gravity": DOWN, "damping": UNDAMPED, "ground": {"point": [0.0, 0.0, 0.0], "friction": ground}}
        scene = moving_scene(block((4e-3, 4e-3, 2e-3)), effects, duration=0.01)
        state = move(build(scene if own is None else named(scene, m=own)))
        moved.append((state.x, state.contacts["ground"]["force"]))
    for x, force in moved[1:]:
        np.testing.assert_array_equal(x, moved[0][0])
        np.testing.assert_array_equal(force, moved[0][1])
    assert moved[0][1][0] == pytest.approx(-0.3 * moved[0][1][2], rel=1e-6)


def test_the_smaller_of_two_materials_counts(tmp_path: Path) -> None:
    """The same bits as where self_contact names it; a part that names none has the other's."""
    meshes = {"slope": box((-2e-3, -2e-3, -2e-3), (6e-3, 4e-3, 0.0)), "slider": box((0.0, 0.0, 0.03e-3), (2e-3, 2e-3, 2.03e-3))}

    def run(friction: float, **own: float) -> np.ndarray:
        effects = {"gravity": DOWN, "damping": UNDAMPED, "ground": {"point": [0.0, 0.0, -0.1]}, "self_contact": {"friction": friction}}
        scene = parts_scene(tmp_path, meshes, effects, 1e-3, held=["slope"], duration=0.02)
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
    parts = [{"magnetization": [0.0, 0.0, 0.0]}, {"magnetization": [0.0, 0.0, 0.0], "material": "stiff"}]
    catheter = {"diameter": 2e-3, "length": 12e-3, "material": "m", "segments": parts}
    lumen = {"tube": {"radius": 3e-3, "path": [[-5e-3, 0.0, 0.0], [20e-3, 0.0, 0.0]]}, "friction": 0.4}
    model = build(named(moving_scene({"catheter": catheter}, {"walls": lumen}), stiff=0.05))
    assert model.surface is not None
    own = own_friction(model.scene)
    np.testing.assert_array_equal(own, [np.nan, 0.05])
    x = np.array([[3e-3, 0.0, -3.02e-3], [9e-3, 0.0, -3.02e-3]])
    still = at_rest(x, np.full(2, 1e-9))
    for k, friction in enumerate((0.4, 0.05)):
        dragged = still._replace(anchor=x - [1e-3, 0, 0], friction=own)
        told = contact_of(model.effects, type(still)(*(part[k : k + 1] for part in dragged)), 1e-6)
        assert told["force"][0] == pytest.approx(-friction * told["force"][2], rel=1e-3)
    tip = model.particles.segment[model.surface.particle] == 1
    assert model.surface.place[tip, 0].min() > 5.5e-3
    assert model.surface.place[~tip, 0].max() < 6.5e-3


def test_energy_of_contact_is_counted() -> None:
    """A block bounces on slippery ground: of its fall the sum of all energies gains less than 0.5 %, loses less than 2 % at any
    time, in steps of second order, and 0.5 % in the end. The ground's springs hold some of it."""
    effects = {"gravity": {}, "damping": UNDAMPED, "ground": {"point": [0.0, 0.0, -0.2e-3]}}
    scene = moving_scene(block((2e-3, 2e-3, 2e-3)), effects, duration=0.04)
    rows: list[dict[str, float]] = []
    move(build(scene), on_state=lambda state: rows.append(state.energies))
    total, ground = np.array([sum(row.values()) for row in rows]), np.array([row["ground"] for row in rows])
    fall = max(row["kinetic"] for row in rows)
    assert (total - total[0]).max() < 5e-3 * fall
    assert (total - total[0]).min() > -2e-2 * fall
    assert abs(total[-1] - total[0]) < 5e-3 * fall
    assert 0 < ground.max() < fall
