"""Warnings: settings of a scene that its author may not have meant."""

from __future__ import annotations

from magmpm.bodies.catheter import THIN_WALL
from magmpm.effects.base import SceneLike


def warnings(scene: SceneLike) -> list[str]:
    """Warn of settings that the author may not have meant: one sentence each."""
    found: list[str] = []
    magnetized = scene.magnetized_regions()
    torque, force = scene.effects.magnetic_torque, scene.effects.magnetic_force
    if torque is None and force is None and scene.field.acts and magnetized:
        found.append("effects: magnetic_torque is not named, so the field does nothing")
    elif torque is None and force is not None and scene.field.varies:
        found.append("effects: magnetic_torque is not named, so the field pulls the segments but does not turn them")
    elif force is None and scene.field.varies and magnetized:
        found.append("effects: magnetic_force is not named, so the field turns the segments but does not pull them")
    if force is not None and not scene.field.varies:
        found.append("effects: magnetic_force does nothing, for the field is the same everywhere")
    if not any(effect is not None for _, effect in scene.effects):
        found.append("effects: none is named, so nothing moves")
    shape, dynamic, gravity = scene.body.shape, scene.solver.dynamic, scene.effects.gravity
    one_grid = scene.effects.self_contact is None and (dynamic is None or dynamic.formulation != "updated")
    own = shape.warnings(scene.resolution.cells_across, one_grid=one_grid)
    fitted = dynamic is None and scene.body.catheter is not None and scene.body.catheter.round_cells
    found += of_known_error(own) if fitted else own
    if shape.clamp == "none" and scene.effects.feed is not None:
        found.append("body.catheter.clamp: none frees nothing here: the guide of feed holds the base and pushes it, clamped or not")
    if shape.in_plane_strain and scene.field.uniform[1] and torque is not None:
        found.append("field: its y component does nothing to a strip in plane strain")
    if shape.in_plane_strain and gravity is not None and gravity.acceleration[1]:
        found.append("effects.gravity: the y component of its acceleration does nothing to a strip in plane strain")
    used = {region.material_name for region in scene.regions()}
    found += [f"materials: {name} is not used" for name in scene.materials if name not in used]
    return found


def of_known_error(warnings: list[str]) -> list[str]:
    """Warnings of a result whose error is known: without those of what its cells may do to it."""
    return [warning for warning in warnings if not warning.startswith(THIN_WALL)]
