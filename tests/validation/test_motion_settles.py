"""A damped motion comes to rest at the equilibrium that statics finds by Newton's method."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.in_motion import moving
from reference.moving import moving_scene
from reference.scenes import field_for_load, rod_scene
from reference.solids import box

from magmpm.bodies.surface_mesh import write_stl
from magmpm.dynamics.time_loop import SimulationState, move
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.simulate import run

LENGTH = 40e-3
DIAMETER = 4e-3


def test_settled_motion_is_statics() -> None:
    """The tip rises by half of L: every particle within 0.2 % of L, and the same elastic energy to 1e-3.

    Damping of twice the first frequency leaves exp(-30 t) of the motion: 1e-4 after 0.3 s."""
    field = field_for_load(2.0, np.pi / 2, length=LENGTH, diameter=DIAMETER)
    still = run(rod_scene(field=field))
    scene = moving(rod_scene(field=field), {"damping": {"rate": 60.0}}, duration=0.3)
    moved = move(build(scene))
    assert still.tip[2] > 0.4 * LENGTH
    far = np.linalg.norm(moved.x - still.particle_position, axis=1)
    assert far.max() < 0.2e-2 * LENGTH
    energy = moved.energies["elastic"] + moved.energies["magnetic_torque"]
    rest = moved.motion.model.particles
    unloaded = -float(np.array(field) @ (moved.motion.model.remanence.T @ rest.volume)) / (
        4e-7 * np.pi
    )
    assert energy - unloaded == pytest.approx(still.energy, rel=1e-3)


JOINTED = 5e-5  # of the length, as was asked; measured: 1.6e-6, what is left of the motion
CLAMPED = 1e-6  # of the length; measured: 3e-7


def test_a_strip_clamped_at_both_ends_settles_where_statics_has_it() -> None:
    """Magnetized outward from its center, it bows in a transverse field; its far end stays in place."""
    halves = [{"magnetization": [sign, 0.0, 0.0]} for sign in (1.0, -1.0)]
    strip = {
        "length": 20e-3,
        "width": 4e-3,
        "thickness": 2e-3,
        "material": "m",
        "clamp": "both",
        "segments": halves,
    }
    _settles({"strip": strip}, length=20e-3, field=20e-3)


def test_a_jointed_catheter_settles_where_statics_has_it() -> None:
    """Its middle third is ten times as stiff: knots are repeated at its ends, in motion as in statics."""
    segments = [
        {"magnetization": [1.0, 0.0, 0.0], "material": name} for name in ("m", "stiff", "m")
    ]
    catheter = {"length": 20e-3, "diameter": 4e-3, "material": "m", "segments": segments}
    _settles({"catheter": catheter}, length=20e-3, field=20e-3, bound=JOINTED)


def test_a_beam_on_a_held_base_settles_where_statics_has_it(tmp_path: Path) -> None:
    """Exactly the face of the base is at rest; the held part does not move at all."""
    write_stl(box((-4.0, -4.0, -4.0), (0.0, 4.0, 4.0)), tmp_path / "base.stl")
    write_stl(box((0.0, -2.0, -2.0), (20.0, 2.0, 2.0)), tmp_path / "beam.stl")
    meshes = [
        {"mesh": str(tmp_path / "base.stl"), "material": "m", "clamp": True},
        {"mesh": str(tmp_path / "beam.stl"), "material": "m", "magnetization": [1.0, 0.0, 0.0]},
    ]
    moved = _settles(
        {"parts": {"unit": "mm", "spacing": 2e-3, "meshes": meshes}}, length=20e-3, field=10e-3
    )
    held = moved.motion.model.held
    assert np.array_equal(moved.x[held], moved.motion.model.particles.position[held])
    assert np.array_equal(moved.F[held], np.tile(np.eye(3), (held.sum(), 1, 1)))


def _settles(
    body: dict[str, Any], length: float, field: float, bound: float = CLAMPED
) -> SimulationState:
    effects = {"magnetic_torque": {}, "damping": {"rate": 200.0}}
    scene = moving_scene(body, effects, duration=0.12, field={"uniform": [0.0, 0.0, field]})
    data = scene.to_si()
    still = run(
        Scene.from_si({**data, "solver": {"static": {}}, "effects": {"magnetic_torque": {}}})
    )
    moved = move(build(scene))
    far = np.linalg.norm(moved.x - still.particle_position, axis=1).max()
    risen = np.abs(still.particle_position - moved.motion.model.particles.position).max()
    assert risen > 0.05 * length
    assert far < bound * length
    return moved
