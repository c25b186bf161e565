"""The scene that compiles a scene's kernels: coarse, faint, with all its effects."""

from __future__ import annotations

from reference.scenes import rod_scene

from magmpm.scene import Scene
from magmpm.scene.coarsest import FAINT, coarsest, coarsest_cells
from magmpm.simulate import run


def test_it_is_coarse_and_faint_and_has_every_effect() -> None:
    scene = rod_scene().with_cells(6).with_effects(gravity={"acceleration": [0.0, 0.0, -9.81]})
    small = coarsest(scene)
    assert small.resolution.cells_across == 2
    assert list(small.effects.named()) == list(scene.effects.named())
    assert small.effects.gravity.acceleration == (0.0, 0.0, -9.81 * FAINT)
    for name, material in scene.materials.items():
        assert small.materials[name].remanence == (material.remanence or 0.0) * FAINT


def test_it_has_the_cells_that_the_scene_needs() -> None:
    """A strip whose magnetization turns once needs 3 cells across: it was refused on 2, by a message about a number nobody wrote."""
    profile = {"harmonic": {"periods": 1.0, "phase": 0.0, "plane": "xz", "turn": "ccw"}}
    strip = {"length": 6e-3, "width": 2e-3, "thickness": 2e-3, "material": "m", "clamp": "base", "magnetization_profile": profile}
    materials = {"m": {"shear_modulus": 3e5, "bulk_to_shear": 20.0, "remanence": 0.1}}
    data = {"name": "turning", "materials": materials, "body": {"strip": strip}, "resolution": {"cells_across": 3}}
    scene = Scene.from_si({**data, "field": {"uniform": [0.0, 0.0, 0.01]}, "effects": {"magnetic_torque": {}}, "solver": {"static": {}}})
    assert coarsest(scene).resolution.cells_across == 3
    asked = Scene.from_si({**scene.to_si(), "resolution": {"error": 0.01}})
    assert coarsest_cells(asked) == 3
    result = run(asked)
    assert next(one["cells_across"] for one in result.resolution["tried"]) == 3
