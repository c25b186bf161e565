"""What must hold before the first trial between a study file, its scene and its target."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, NotThereYet, dotted, report
from magmpm.inputs.folder_names import folder_fault
from magmpm.inputs.yaml_document import Document
from magmpm.scene import Scene
from studies.study_file import StudyFile

STRETCH = 1.1  # a target may be this much longer than the part of the catheter it belongs to


def check_file_name(path: Path) -> None:
    """The file's name names the folder of results: `..yaml` would name the folder of all of them."""
    found = folder_fault(path.stem)
    if found is not None:
        where, received = f"{path}: its name without the ending names the folder of results", f'"{path.stem}"'
        raise InputError(report(where, received=received, rule=found[0], remedy=f"rename the file; {found[1]}"))


def named_in(error: InputError, where: str) -> InputError:
    """An error in a file that the study names, with the place that names it."""
    kind = NotThereYet if isinstance(error, NotThereYet) else InputError
    return kind(f"{error}\n  named in: {where}")


def place(document: Document, *key: str | int) -> str:
    """Where a key stands: file, line and key."""
    line = next((document.lines[key[:n]] for n in range(len(key), 0, -1) if key[:n] in document.lines), 1)
    return f"{document.path}:{line}: {dotted(key)}"


def check_scene(scene: Scene, file: StudyFile, document: Document) -> None:
    """A study turns magnets in a field, so the scene must have magnets, and a field unless that is varied."""
    if scene.body.shape.line is None:
        rule = "a study compares centrelines, and a body of STL parts has none"
        remedy = "name a scene of a catheter or a strip"
    elif file.vary.magnetization is not None and not scene.body.shape.magnetized_by_region:
        rule = "a study varies segments, and this strip has a magnetization_profile in their place"
        remedy = "give the strip `segments`"
    elif scene.effects.magnetic_torque is None:
        rule = "the scene of a study must name the effect magnetic_torque: without it, magnets do nothing"
        remedy = "add `effects: {magnetic_torque: {}}` to the scene"
    elif not scene.magnetized_regions():
        rule = "the scene of a study must have a magnetized segment"
        remedy = "give the segments that may be magnetized a direction, say, `magnetization: [1, 0, 0]`"
    elif file.vary.field is None and not scene.field.acts:
        rule = "the field of the scene must not be zero while the study does not vary it"
        remedy = "give the scene a field, or add `field: {max: 10 mT}` to `vary`"
    else:
        return
    raise InputError(report(place(document, "scene"), received=f'"{file.scene}"', rule=rule, remedy=remedy))


def check_target(target: Array, scene: Scene, file: StudyFile, csv: Path, named: str) -> None:
    """The target must belong to a catheter of this length that starts at the origin.

    A silicone catheter bends but hardly stretches. Points farther apart than the length of catheter between them show a mistake in
    the table (units, columns, another catheter), which a search would never reveal.
    """
    length, where = scene.length, f"{csv} (named in {named})"
    if target[-1, 0] > length * (1 + 1e-6):
        received = f"s_mm up to {1e3 * target[-1, 0]:g}"
        rule = f"s_mm of the target must not exceed the catheter's length, {1e3 * length:g} mm"
        remedy = "check that the target belongs to this catheter"
        raise InputError(report(where, received=received, rule=rule, remedy=remedy))
    rows = target if target[0, 0] == 0 else np.vstack([np.zeros(4), target])
    if np.linalg.norm(rows[0, 1:]) > 0.01 * length:
        received = f"{1e3 * rows[0, 1:]} mm at s = 0"
        rule = "the target must start at the catheter's base, the origin"
        raise InputError(report(where, received=received, rule=rule, remedy="move the target"))
    apart = np.linalg.norm(np.diff(rows[:, 1:], axis=0), axis=1)
    along = np.diff(rows[:, 0])
    worst = int(np.argmax(apart - STRETCH * along))
    if apart[worst] > STRETCH * along[worst] + 0.001 * length:
        a, b = 1e3 * rows[worst, 0], 1e3 * rows[worst + 1, 0]
        received = f"points {1e3 * apart[worst]:.4g} mm apart at s_mm = {a:g} and {b:g}"
        rule = "points must not be further apart than the catheter between them is long (it bends, but hardly stretches)"
        remedy = "check units, columns, and that the catheter leaves the base along +x"
        raise InputError(report(where, received=received, rule=rule, remedy=remedy))
    if apart.sum() < 0.2 * along.sum():
        received = f"points that span {1e3 * apart.sum():.4g} mm along {1e3 * along.sum():.4g} mm of catheter"
        rule = "the target's points must follow the catheter"
        raise InputError(report(where, received=received, rule=rule, remedy="check units: columns are in mm"))
