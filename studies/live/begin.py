"""A scene made ready to be solved again and again: its effects are named, and its cells counted."""

from __future__ import annotations

from magmpm.errors import InputError, report
from magmpm.scene import Scene
from magmpm.statics.effects_choice import choose_effects

USUAL = 4  # cells across, where the scene asks for an error instead


def ready(scene: Scene, cells: int | None = None) -> Scene:
    """The scene with `effects: auto` chosen, and in `cells` cells across, or its own; USUAL where it asks for an error or a time.

    Raises InputError where nothing holds its body, or the cells don't fit it.
    """
    if scene.body.shape.clamp == "none":
        rule, remedy = "only a body that is held somewhere has a rest", "name a clamp, or view a motion: `solver: {dynamic: ...}`"
        raise InputError(report(f"body.{scene.body.kind}.clamp", received="none", rule=rule, remedy=remedy))
    if scene.effects.auto:
        scene = choose_effects(scene).scene
    if cells is not None and not 2 <= cells <= 16:
        raise InputError(report("--cells", received=str(cells), rule="must be from 2 to 16", remedy="--cells 4"))
    if cells is not None or scene.resolution.asked:
        scene = scene.with_cells(cells or USUAL)
    return scene
