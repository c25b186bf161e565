"""The scene that compiles a scene's kernels: coarse, faint, with all its effects."""

from __future__ import annotations

from reference.scenes import rod_scene

from magmpm.scene.coarsest import FAINT, coarsest


def test_it_is_coarse_and_faint_and_has_every_effect() -> None:
    scene = rod_scene().with_cells(6).with_effects(gravity={"acceleration": [0.0, 0.0, -9.81]})
    small = coarsest(scene)
    assert small.resolution.cells_across == 2
    assert list(small.effects.named()) == list(scene.effects.named())
    assert small.effects.gravity is not None
    assert small.effects.gravity.acceleration == (0.0, 0.0, -9.81 * FAINT)
    for name, material in scene.materials.items():
        assert small.materials[name].remanence == (material.remanence or 0.0) * FAINT
