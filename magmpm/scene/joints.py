"""Where soft and stiff segments meet: errors fall there as the cells' width, slower than elsewhere (statics.error_estimate)."""

from __future__ import annotations

from itertools import pairwise

from magmpm.bodies.catheter import THIN_WALL
from magmpm.effects.base import SceneLike

NAME = "joints: "
WARNED = 6.0  # ratio of moduli from which runs on given cells say so
# Of 63 drawn bodies with such ratios, nine in ten are within this error, over the length, divided by the cells across: docs/accuracy.md.
SPREAD = 0.03


def stiffness_jump(scene: SceneLike) -> float:
    """The largest ratio of the shear or bulk moduli of neighboring regions; 1 where there are no neighbors."""
    used = [scene.materials[region.material_name] for region in scene.regions()]
    moduli = [(one.shear_modulus, one.shear_modulus * one.bulk_to_shear) for one in used]
    return max((max(a / b, b / a) for one, other in pairwise(moduli) for a, b in zip(one, other, strict=True)), default=1.0)


def joint_warnings(scene: SceneLike) -> list[str]:
    """What errors to expect of a straight body on given cells."""
    if scene.body.shape.line is None or (jump := stiffness_jump(scene)) < WARNED:
        return []
    cells = scene.resolution.cells_across
    return [
        f"{NAME}soft and stiff segments meet (moduli {jump:.3g} times apart), where errors fall only as the cells' width: with {cells} "
        f"cells across nine in ten such bodies are within {100 * SPREAD / cells:.2g} % of the length; what it is here, "
        "`resolution: {error: 1 %}` tells"
    ]


def without_joints(warnings: list[str]) -> list[str]:
    """Warnings without those of joints."""
    return [warning for warning in warnings if not warning.startswith(NAME)]


def of_known_error(warnings: list[str]) -> list[str]:
    """Warnings of a result whose own error is known: without those of what the cells may do to it."""
    return [warning for warning in without_joints(warnings) if not warning.startswith(THIN_WALL)]
