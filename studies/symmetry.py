"""Designs that need no solve: images of one that has been solved.

A straight round catheter along +x in a uniform field B and weight g has a symmetry for every Q that keeps the x-axis and every
sign s = +-1 with

    s Q B = B,    Q g = g:

to turn or mirror the deformed body by Q, and its magnets by s Q, leaves the energies of field, -B.(F Br)/mu0 per volume, of
weight and of material as they were. So the design s Q d takes the shape Q p whenever the design d takes the shape p,
and one solve tells the distances of both to the target. There is always the mirror in the plane of axis and field, if the
weight lies in it. When the field is across the axis and there is no weight, there is also the half turn about
the axis, which turns the field around, together with magnets turned around; and the half turn of the mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from magmpm.measures import rms_distance
from magmpm.scene import Scene

if TYPE_CHECKING:
    from magmpm.results import Result

Array = NDArray[np.float64]

EFFECTS = {"magnetic_torque", "gravity"}  # the symmetry of others has not been looked into
SAME = 1e-9  # relative difference of vectors that count as equal


@dataclass(frozen=True)
class Symmetry:
    """turn (3, 3): Q, its own inverse; sign: s."""

    turn: Array
    sign: int

    def magnets(self, directions: Array) -> Array:
        """Directions (k, 3) of the image's magnetisation."""
        return np.asarray(self.sign * directions @ self.turn.T)


def symmetries(scene: Scene, field: Array | None = None) -> list[Symmetry]:
    """The symmetries of a scene, but for the identity; field (3,) T in place of the scene's."""
    effects = scene.effects.model_dump(exclude_none=True)
    if not set(effects) <= EFFECTS:
        return []
    B = np.array(scene.field.uniform) if field is None else np.asarray(field)
    g = np.zeros(3) if scene.effects.gravity is None else np.array(scene.effects.gravity.acceleration)
    across = _across(B, g)
    beside = np.cross([1.0, 0.0, 0.0], across)
    found = []
    for flipped in ([beside], [across], [across, beside]):
        Q = np.eye(3) - 2 * sum(np.outer(v, v) for v in flipped)
        sign = next((s for s in (1, -1) if _same(s * Q @ B, B)), None)
        if sign is not None and _same(Q @ g, g):
            found.append(Symmetry(Q, sign))
    return found


def image_distances(result: Result, target: Array, found: list[Symmetry]) -> list[float]:
    """Root mean square distance (m) to target rows [s, x, y, z] (m, 4) m, of each image of a result."""
    # an image is as far from the target as the result is from the target's own image
    return [
        rms_distance(result, np.column_stack([target[:, 0], target[:, 1:] @ symmetry.turn.T]))
        for symmetry in found
    ]


def _across(B: Array, g: Array) -> Array:
    """Unit vector across the axis in the plane of axis and field; of axis and weight when the field is along the axis."""
    for vector in (B, g):
        across = vector * [0.0, 1.0, 1.0]
        if not _same(across, np.zeros(3), np.linalg.norm(vector)):
            return np.asarray(across / np.linalg.norm(across))
    return np.array([0.0, 1.0, 0.0])


def _same(a: Array, b: Array, size: float | np.floating | None = None) -> bool:
    scale = np.linalg.norm(b) if size is None else size
    return bool(np.linalg.norm(a - b) <= SAME * scale)
