"""Checks of a study file against its scene and its target, before the first trial."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, dotted, undotted
from magmpm.inputs.user_files import folder_fault
from magmpm.inputs.yaml_document import Document
from magmpm.scene import Scene
from magmpm.scene.addresses import written
from magmpm.scene.variables import variables
from magmpm.studies.problem.path import Path as Curve
from magmpm.studies.problem.sampler_names import TAKE_CHOICES
from magmpm.studies.problem.study_file import StudyFile
from magmpm.studies.problem.variables import Vary, VaryLength
from magmpm.studies.search.knobs import errors_of
from magmpm.studies.search.scene_edits import MOST_ORDERS
from magmpm.studies.search.search_space import numbers_space


def check_file_name(path: Path) -> None:
    """Check the name of a study's file, which names the folder of results: `..yaml` would name the folder of all of them.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    InputError
        For a name that can't name a folder.
    """
    found = folder_fault(path.stem)
    if found is not None:
        where = f"{path}: its name without the ending names the folder of results"
        raise InputError(
            where, received=f'"{path.stem}"', rule=found[0], remedy=f"rename the file; {found[1]}"
        )


def named_in(error: InputError, where: str) -> InputError:
    """Add to an error in a file that the study names the place that names it.

    Parameters
    ----------
    error : InputError
        The error.
    where : str
        The place.

    Returns
    -------
    InputError
        The error with the place.
    """
    return InputError(f"{error}\n  named in: {where}")


def place(document: Document, *key: str | int) -> str:
    """Find the place of a key.

    Parameters
    ----------
    document : Document
        The file's content.
    *key : str or int
        The key, part by part.

    Returns
    -------
    str
        File, line and key.
    """
    line = next(
        (document.lines[key[:n]] for n in range(len(key), 0, -1) if key[:n] in document.lines), 1
    )
    return f"{document.path}:{line}: {dotted(key)}"


def placed(error: InputError, document: Document) -> InputError:
    """Add the file, and the line of the key with which a message begins, or of what is around it.

    Parameters
    ----------
    error : InputError
        The error.
    document : Document
        The file's content.

    Returns
    -------
    InputError
        The error with its place.
    """
    named = list(undotted(str(error).partition(":")[0]))
    if named[:1] == ["goal"] and isinstance(document["goal"], dict):
        del named[1]  # one goal is no list
    around = (tuple(named[:count]) for count in range(len(named), 0, -1))
    line = next((f":{document.lines[key]}" for key in around if key in document.lines), "")
    return InputError(f"{document.path}{line}: {error}")


def check_scene(scene: Scene, file: StudyFile, document: Document) -> None:
    """Check that the scene of a study has magnets, and a field unless that is varied: a study turns magnets in a field.

    Parameters
    ----------
    scene : Scene
        The scene.
    file : StudyFile
        What the study's file says.
    document : Document
        The file, for messages.

    Raises
    ------
    InputError
        Where the study can't be made of this scene.
    """
    of = "an insertion" if file.insertion is not None else "stability"
    faults = (
        (
            scene.resolution.seconds is not None,
            "the scene of a study gives its cells or an error, not a time: trials are compared on"
            " one grid",
            "write `resolution: {cells_across: 4}` or `resolution: {error: 0.1 %}` in the scene",
        ),
        (
            scene.resolution.requested
            and (
                file.insertion is not None
                or file.schedule is not None
                or scene.solver.dynamic is not None
            ),
            "an error can be asked for where a trial is an equilibrium, or equilibria along time;"
            " the best are judged on finer grids",
            "write `resolution: {cells_across: 4}` in the scene, and run the best design with"
            " `resolution: {error: 0.1 %}`",
        ),
        (
            scene.body.shape.line is None,
            "a study compares centrelines, and a body of STL parts has none",
            "name a scene of a catheter or a strip",
        ),
        (
            file.vary.magnetization is not None and not scene.body.shape.magnetized_by_region,
            "a study varies segments, and this strip has a magnetization_profile in their place",
            "give the strip `segments`",
        ),
        (
            scene.effects.magnetic_torque is None,
            "the scene of a study must name the effect magnetic_torque: without it, magnets have "
            "no effect",
            "add `effects: {magnetic_torque: {}}` to the scene",
        ),
        (
            not scene.magnetized_regions(),
            "the scene of a study must have a magnetized segment",
            "give the segments that may be magnetized a direction, say, `magnetization: [1, 0, 0]`",
        ),
        (
            file.vary.field is None and not scene.field.acts,
            "the field of the scene must not be zero while the study does not vary it",
            "give the scene a field, or add `field: {max: 10 mT}` to `vary`",
        ),
        (
            file.schedule is not None and (scene.field.over_time is not None or not scene.static),
            "a schedule makes the field over time itself, and each of its shapes is an equilibrium",
            "leave `over_time` out of the scene's field, and `dynamic` and `quasi_static` out of"
            " its solver",
        ),
        (
            file.robust is not None and not scene.static,
            "robust differentiates equilibria, and this scene is a motion",
            "leave `dynamic` out of the scene's solver, or remove `robust`",
        ),
        (
            (file.insertion is not None or file.stability is not None) and not scene.static,
            f"{of} asks for equilibria, and this scene is a motion",
            "leave `dynamic` out of the scene's solver",
        ),
        (
            file.robust is not None
            and file.robust.direction > 0
            and not scene.body.shape.magnetized_by_region,
            "robust tilts the directions of segments, and this strip has a magnetization_profile in"
            " their place",
            "give the strip `segments`, or remove `direction` from `robust`",
        ),
        (
            file.insertion is not None and scene.body.catheter is None,
            "an insertion pushes a catheter out of its guide, and this body is a"
            f" {scene.body.kind}",
            "name a scene of a catheter",
        ),
    )
    for broken, rule, remedy in faults:
        if broken:
            at = place(document, "scene")
            raise InputError(at, received=f'"{file.scene}"', rule=rule, remedy=remedy)
    _check_depths(scene, file, document)


def _check_depths(scene: Scene, file: StudyFile, document: Document) -> None:
    """Check that the part outside the guide is at least as long as it is thick: Scene.inserted."""
    depths = file.insertion.depths if file.insertion is not None else ()
    if isinstance(depths, tuple) and depths and depths[0] < scene.thickness * (1 - 1e-9):
        rule = (
            f"a depth must be at least one diameter of the catheter, {1e3 * scene.thickness:g} mm:"
            " a shorter piece is no rod"
        )
        raise InputError(
            place(document, "insertion", "depths"),
            received=f"{1e3 * depths[0]:g} mm",
            rule=rule,
            remedy=f"begin with `{1e3 * scene.thickness:g} mm`, or leave it out",
        )


def check_target(target: Array, scene: Scene, file: StudyFile, csv: Path, named: str) -> None:
    """Check that the target belongs to a catheter of this length that starts at the origin.

    A silicone catheter bends but hardly stretches. Points at a larger distance than the length of
    catheter between them show a mistake in the table (units, columns, another catheter), which a
    search would never reveal.

    Parameters
    ----------
    target : array (m, 4), m
        Rows [s, x, y, z].
    scene : Scene
        The scene.
    file : StudyFile
        What the study's file says.
    csv : Path
        The target's file, for messages.
    named : str
        The place that names it.

    Raises
    ------
    InputError
        For a target that does not belong.
    """
    bounds = file.vary.length
    where = f"{csv} (named in {named})"
    length = (
        scene.length
        if bounds is None or bounds.total == "keep"
        else bounds.max * len(scene.regions())
    )  # at most
    rows = check_shape(target, length, where)
    if file.insertion is not None:
        _check_path(rows, scene, file, where)


def check_shape(target: Array, length: float, where: str) -> Array:
    """Check a shape that a body may be compared with.

    Parameters
    ----------
    target : array (m, 4), m
        Rows [s, x, y, z].
    length : float, m
        Of the body, at most.
    where : str
        Its place, for messages.

    Returns
    -------
    array (n, 4), m
        The rows from s = 0 on.

    Raises
    ------
    InputError
        For a shape that no such body can have.
    """
    # a target may be this much longer than the part of the catheter it belongs to
    longest_target = 1.1
    fewest_points = 2  # of a target, beyond the base
    if target[-1, 0] > length * (1 + 1e-6):
        raise InputError(
            where,
            received=f"s_mm up to {1e3 * target[-1, 0]:g}",
            rule=f"s_mm of the target must not exceed the catheter's length, {1e3 * length:g} mm",
            remedy="check that the target belongs to this catheter",
        )
    rows = target if target[0, 0] == 0 else np.vstack([np.zeros(4), target])
    if len(rows) - 1 < fewest_points:
        rule = (
            f"a shape needs at least {fewest_points} points beyond the base: a single one does not"
            " say how it bends"
        )
        raise InputError(
            where,
            received=f"{len(rows) - 1} point beyond the base",
            rule=rule,
            remedy="add points, one for each segment or more",
        )
    if np.linalg.norm(rows[0, 1:]) > 0.01 * length:
        raise InputError(
            where,
            received=f"{1e3 * rows[0, 1:]} mm at s = 0",
            rule="the target must start at the catheter's base, the origin",
            remedy="move the target",
        )
    distance = np.linalg.norm(np.diff(rows[:, 1:], axis=0), axis=1)
    along = np.diff(rows[:, 0])
    worst = int(np.argmax(distance - longest_target * along))
    if distance[worst] > longest_target * along[worst] + 0.001 * length:
        a = 1e3 * rows[worst, 0]
        b = 1e3 * rows[worst + 1, 0]
        rule = (
            "points must not be further apart than the catheter between them is long (it bends, but"
            " hardly stretches)"
        )
        raise InputError(
            where,
            received=f"points {1e3 * distance[worst]:.4g} mm apart at s_mm = {a:g} and {b:g}",
            rule=rule,
            remedy="check units, columns, and that the catheter leaves the base along +x",
        )
    if distance.sum() < 0.2 * along.sum():
        received = (
            f"points that span {1e3 * distance.sum():.4g} mm along {1e3 * along.sum():.4g} mm of"
            " catheter"
        )
        raise InputError(
            where,
            received=received,
            rule="the target's points must follow the catheter",
            remedy="check units: columns are in mm",
        )
    return rows


def _check_path(rows: Array, scene: Scene, file: StudyFile, where: str) -> None:
    """A path begins where the guide ends and as it points, bends no sharper than the catheter can, and is as long as the depths.

    The catheter's inner side is shortened by thickness / (2 radius): half of it, at a radius of its thickness, is what a solid body may
    be requested. The radius at a point of the table is that of the circle that touches both of its chords there, no farther away than the
    middle of the shorter one: that one's length over 2 tan(turn / 2).
    """
    thickness = scene.thickness
    chords = np.diff(rows[:, 1:], axis=0)
    lengths = np.linalg.norm(chords, axis=1)
    along = np.vstack(
        [[1.0, 0.0, 0.0], chords / np.maximum(lengths, 1e-12)[:, None]]
    )  # the guide, then the path
    turn = np.arccos(np.clip(np.sum(along[1:] * along[:-1], axis=1), -1.0, 1.0))
    spans = np.concatenate([[lengths[0]], np.minimum(lengths[1:], lengths[:-1])])
    radius = spans / np.maximum(2 * np.tan(np.minimum(turn, np.pi - 1e-9) / 2), 1e-12)
    worst = int(np.argmin(radius))
    if radius[worst] < thickness:
        bend = np.rad2deg(turn[worst])
        at = 1e3 * rows[worst, 0]
        received = (
            f"a bend of {bend:.3g} deg at s_mm = {at:g}, a radius of {1e3 * radius[worst]:.3g} mm"
        )
        remedy = "smooth the path, or check its units; at s_mm = 0 it must leave the guide along +x"
        raise InputError(
            where,
            received=received,
            rule="a path must not bend sharper than the catheter's diameter allows, at a radius of"
            f" {1e3 * thickness:g} mm",
            remedy=remedy,
        )
    _check_curve(rows, thickness, where)
    depths = file.insertion.depths if file.insertion is not None else 1
    if isinstance(depths, tuple) and depths[-1] > rows[-1, 0] * (1 + 1e-6):
        rule = f"the path must reach as far as the depths: the last one is {1e3 * depths[-1]:g} mm"
        raise InputError(
            where,
            received=f"a path up to s_mm = {1e3 * rows[-1, 0]:g}",
            rule=rule,
            remedy="give shorter depths, or a longer path",
        )


def _check_curve(rows: Array, thickness: float, where: str) -> None:
    """The smooth curve through the points, which is what is followed: at least a diameter long, as long as s_mm says, and not sharper."""
    as_long = 0.05  # how far s_mm may be from the length of a path's curve
    if rows[-1, 0] < thickness * (1 - 1e-9):
        raise InputError(
            where,
            received=f"a path up to s_mm = {1e3 * rows[-1, 0]:g}",
            rule=f"a path is at least one diameter of the catheter long, {1e3 * thickness:g} mm: a"
            " shorter piece is no rod",
            remedy="give a longer path, and check its units",
        )
    curve = Curve(rows)
    if (radius := curve.smallest_radius()) < thickness:
        raise InputError(
            where,
            received="points whose smooth curve, which leaves the guide along +x, has a radius of"
            f" {1e3 * radius:.3g} mm",
            rule="a path must not bend sharper than the catheter's diameter allows, at a radius of"
            f" {1e3 * thickness:g} mm",
            remedy="smooth the path, or give more points where it bends",
        )
    points = curve.at(np.linspace(0.0, rows[-1, 0], 1001))
    long = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    if abs(long / rows[-1, 0] - 1.0) > as_long:
        received = f"s_mm up to {1e3 * rows[-1, 0]:g} for a curve that is {1e3 * long:.4g} mm long"
        raise InputError(
            where,
            received=received,
            rule=f"s_mm is the length along the path, to {100 * as_long:g} %",
            remedy="count s_mm along the points, and check the units",
        )


def check_numbers(scene: Scene, vary: Vary, sampler: str | None, document: Document) -> None:
    """Check that the bounds of what varies are those of scenes that there are.

    Parameters
    ----------
    scene : Scene
        The scene.
    vary : Vary
        What the study's file says of them.
    sampler : str or None
        The sampler that it names.
    document : Document
        The file, for messages.

    Raises
    ------
    InputError
        With the number that shows it.
    """
    try:
        numbers_space(scene, vary)
    except InputError as error:
        raise placed(error, document) from None
    found = (
        _segments_fault(scene, vary)
        or _lengths_fault(scene, vary.length)
        or _diameter_fault(scene, vary)
        or _order_fault(scene, vary, sampler)
    )
    if found is None and scene.body.shape.line is not None:
        found = _corner_fault(scene, vary)
    if found is not None:
        key, received, rule, remedy = found
        raise InputError(place(document, *key), received=received, rule=rule, remedy=remedy)


def check_robust(scene: Scene, file: StudyFile, document: Document) -> None:
    """Check that the scene has the numbers that are made with errors, and that its shape has derivatives by them.

    Parameters
    ----------
    scene : Scene
        The scene.
    file : StudyFile
        What the study's file says.
    document : Document
        The file, for messages.

    Raises
    ------
    InputError
        For the first that is not so.
    """
    if file.robust is None:
        return
    try:
        for change in errors_of(file.robust, scene):
            variables(scene, [written(place) for place in change])
    except InputError as error:
        raise placed(InputError(re.sub("^of:", "robust.numbers:", str(error))), document) from None


Fault = tuple[tuple[str, ...], str, str, str]  # key, value received, rule, remedy


def _segments_fault(scene: Scene, vary: Vary) -> Fault | None:
    shape = scene.body.shape
    key = next((key for key in ("length", "order") if getattr(vary, key) is not None), None)
    if key is None or (shape.line is not None and shape.magnetized_by_region):
        return None
    rule = "parts and a strip with a magnetization_profile have no segments"
    return ("vary", key), f"a {scene.body.kind}", rule, "name a scene whose body has `segments`"


def _lengths_fault(scene: Scene, bounds: VaryLength | None) -> Fault | None:
    if bounds is None or bounds.total == "free":
        return None
    count = len(scene.regions())
    length = scene.length
    if bounds.min * count <= length * (1 + 1e-9) <= bounds.max * count * (1 + 2e-9):
        return None
    return (
        ("vary", "length"),
        f"{1e3 * bounds.min:g} to {1e3 * bounds.max:g} mm",
        f"{count} segments of this length are {1e3 * count * bounds.min:g} to"
        f" {1e3 * count * bounds.max:g} mm long, and must sum to the body's length,"
        f" {1e3 * length:g} mm",
        "change the bounds, or let the length of the body vary too: `total: free`",
    )


def _diameter_fault(scene: Scene, vary: Vary) -> Fault | None:
    bounds = vary.diameter
    catheter = scene.body.catheter
    if bounds is None:
        return None
    received = f"{1e3 * bounds.min:g} to {1e3 * bounds.max:g} mm"
    key = ("vary", "diameter")
    if catheter is None:
        return (
            key,
            received,
            f"a {scene.body.kind} has no diameter",
            "remove it, or name a scene of a catheter",
        )
    if catheter.inner_diameter >= bounds.min:
        rule = (
            "the diameter must be greater than that of the bore,"
            f" {1e3 * catheter.inner_diameter:g} mm"
        )
        return (
            (*key, "min"),
            received,
            rule,
            f"at least `min: {1.2e3 * catheter.inner_diameter:g} mm`",
        )
    return None


def _order_fault(scene: Scene, vary: Vary, sampler: str | None) -> Fault | None:
    if vary.order is None:
        return None
    magnetized = len(scene.magnetized_regions())
    count = len(scene.regions())
    key = ("vary", "order")
    if magnetized == count:
        rule = (
            f"an order needs magnetized and plain segments, and all {count} of the scene's are"
            " magnetized"
        )
        return (
            key,
            "{}",
            rule,
            "leave some segments of the scene without `magnetization`, or remove `order`",
        )
    if math.comb(count, magnetized) > MOST_ORDERS:
        rule = (
            f"there may be {MOST_ORDERS} orders, and {magnetized} of {count} places can be chosen"
            f" in {math.comb(count, magnetized)} ways"
        )
        return key, "{}", rule, "use fewer segments"
    if sampler is not None and sampler not in TAKE_CHOICES:
        rule = f"the sampler {sampler} needs a gradient or distances, and orders have none"
        return (
            key,
            "{}",
            rule,
            f"`sampler: {TAKE_CHOICES[0]}`; orders are for {', '.join(TAKE_CHOICES)}",
        )
    return None


def _corner_fault(scene: Scene, vary: Vary) -> Fault | None:
    """Bounds at which there is no scene: least and greatest values of all numbers, together and against each other."""
    space = numbers_space(scene, vary)
    numbers = space.numbers_within
    if not numbers:
        return None
    thick = np.array([number.what == "diameter" for number in numbers], dtype=float)
    for name, values in (
        ("least", 0 * thick),
        ("greatest", 0 * thick + 1),
        ("longest, thinnest", 1 - thick),
        ("shortest, thickest", thick),
    ):
        x = space.middle
        x[: len(numbers)] = values
        try:
            space.scene_at(x)
        except InputError as error:
            key = next(
                what
                for what in ("diameter", "length", "remanence", "shear_modulus", "numbers")
                if getattr(vary, what, None) is not None
            )
            said = " ".join(line.strip() for line in str(error).splitlines())
            rule = (
                f"the bounds must make valid scenes, and the one with the {name} values is refused"
                f" ({said})"
            )
            return (
                ("vary", key),
                " ".join(f"{n}: {a:g} to {b:g};" for n, (a, b) in space.bounds.items())[:80],
                rule,
                "change the bounds",
            )
    return None
