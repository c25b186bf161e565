"""A field that rotates or oscillates without end, stopped at one moment, so that equilibria in it can be estimated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magmpm.fields.sources import FieldSource
from magmpm.scene import Scene

ANGLES = 24  # of a turn, among which the moment is looked for


def stopped(scene: Scene) -> tuple[Scene, str | None]:
    """The scene with the endless parts of its field stopped at their strongest, and that moment in words; the scene and None if all end.

    An oscillation is stopped at its largest strength. A rotating field is stopped at the angle, among ANGLES, with the largest sum of
    |Br x B| over the segments, with B at the middle of the undeformed body. Parts that end are at their end, as in statics.
    """
    over = scene.field.over_time
    if over is None or over.endless is None:
        return scene, None
    data, words = scene.to_si(), []
    changed = data["field"]["over_time"]
    swing = over.oscillation
    if swing is not None and swing.cycles is None:
        top = np.pi / 2 if swing.mean * swing.amplitude >= 0 else -np.pi / 2
        changed["oscillation"]["cycles"] = (top - swing.phase) / (2 * np.pi) % 1.0 or 1.0
        words.append("at the largest of its swing")
    if over.rotation is not None and over.rotation.turns is None:
        angles = [1.0, *(np.arange(1, ANGLES) / ANGLES).tolist()]  # a whole turn is none
        torques = [_torque(scene, {**changed, "rotation": {**changed["rotation"], "turns": turns}}) for turns in angles]
        best = angles[int(np.argmax(np.array(torques) > (1 - 1e-9) * max(torques)))]
        changed["rotation"]["turns"] = best
        words.append(f"turned by {360 * (best % 1.0):g} deg, where its torque on the undeformed body is largest")
    return Scene.from_si(data), "the field, which has no end, is taken " + ", and ".join(words)


def _torque(scene: Scene, over_time: dict[str, object]) -> float:
    """Sum of |Br x B| over the segments, T^2, with B at the end of this schedule."""
    data = scene.field.model_dump(mode="json")
    source = FieldSource.model_validate({**data, "over_time": over_time})
    middle = np.mean(scene.box(), axis=0)
    B = replace(scene.outside_field(), source=source).at(middle)[0]
    return float(np.linalg.norm(np.cross(scene.region_remanence(), B), axis=1).sum())
