"""Rules that concern several parts of a scene together, and warnings of settings that its author may not have meant."""

import difflib
from collections.abc import Set
from typing import Any, Protocol

import numpy as np

from magmpm.bodies.catheter import THIN_WALL
from magmpm.bodies.mesh_quadrature import TOUCHING_DISTANCE
from magmpm.effects.base import SceneLike
from magmpm.effects.contact_law import most_friction
from magmpm.effects.magnetization import rotating
from magmpm.errors import dotted, quantity
from magmpm.fields import schedule
from magmpm.inputs.settings import Key, fault
from magmpm.scene import moves

NO_ENERGY = (  # rule and remedy, where a static scene names one of them
    (
        "in a field that varies in space, equilibrium needs both magnetic_torque and "
        "magnetic_force: neither alone has an energy"
    ),
    (
        "add `magnetic_force: {}` or `magnetic_torque: {}`, or ask for motion with solver.dynamic,"
        " where either may act alone"
    ),
)


class WholeScene(SceneLike, Protocol):
    """Interface of a scene (magmpm.scene.Scene) for the rules, beyond that for effects."""

    reference: Any  # centreline, rows [s, x, y, z] in m; or None

    @property
    def move(self) -> moves.Moves | None: ...

    @property
    def static(self) -> bool: ...

    def path_times(self) -> list[float]: ...

    @property
    def model_fields_set(self) -> Set[str]: ...


def check(scene: WholeScene, *, written: bool) -> None:
    """Raises PydanticCustomError (see `fault`) for the first rule that is broken.

    written: whether the scene is a file's, which must hold together; scenes made in Python may be incomplete, to be changed further.
    """
    _materials_are_there(scene)
    _densities_are_given(scene)
    _tip_is_named(scene)
    _reference_fits(scene)
    scene.body.shape.check_resolution(scene.resolution.cells_across)
    if written and scene.static and scene.body.shape.clamp == "none":
        raise fault(
            "equilibrium needs a body that is held somewhere",
            "clamp it, or simulate its motion: `solver: {dynamic: {duration: 0.5 s}}`",
            ("body", scene.body.kind, scene.body.shape.clamp_key),
        )
    _motion_has_its_solver(scene)
    _path_has_an_end(scene)
    _feed_can_push(scene)
    _stream_is_steady(scene)
    moves.check(scene)
    _segments_turn_alone(scene)
    _field_suits_the_solver(scene)
    if written:
        _something_changes(scene)
        if (missing := without_energy(scene)) is not None:
            raise fault(*NO_ENERGY, ("effects", missing))
        for effect in ("magnetic_torque", "magnetic_force"):
            if getattr(scene.effects, effect) is not None:
                _field_acts(scene, effect)


def _materials_are_there(scene: WholeScene) -> None:
    """Every material that the body names."""
    for at, name in _materials_named(scene):
        if name not in scene.materials:
            near = difflib.get_close_matches(name, scene.materials, n=1)
            remedy = (
                f'did you mean "{near[0]}"?' if near else "correct the name, or add the material"
            )
            raise fault(
                f"must be a name from `materials`: {', '.join(scene.materials)}", remedy, at
            )


def _materials_named(scene: WholeScene) -> list[tuple[Key, str]]:
    """Keys where the body names materials, and the names."""
    named: list[tuple[Key, str]] = []
    if (material := getattr(scene.body.shape, "material", None)) is not None:
        named.append((("body", scene.body.kind, "material"), material))
    for region in scene.regions():
        if region.material_name != material:
            named.append((("body", *region.at, "material"), region.material_name))
    return named


def _densities_are_given(scene: WholeScene) -> None:
    """Gravity and motion need the mass of what they act on, and so does contact, whose stiffness is that of motion."""
    touches = any(
        effect.PHASE == "contact" and not effect.ONLY_IN_MOTION
        for effect in scene.effects.named().values()
    )
    what = (
        "gravity" if scene.effects.gravity is not None else "contact" if scene.static else "motion"
    )
    if what == "contact" and not touches:
        return
    for name in dict.fromkeys(region.material_name for region in scene.regions()):
        if scene.materials[name].density is None:
            raise fault(
                f"{what} needs the density of each material",
                "add, say, `density: 1100 kg/m^3`",
                ("materials", name, "density"),
            )


def _tip_is_named(scene: WholeScene) -> None:
    """An error of the tip needs one."""
    parts = scene.body.parts
    if parts is not None and parts.tip is None and scene.resolution.of == "tip":
        raise fault(
            "an error at the tip is requested, and parts have no tip unless the scene names it",
            "name a part or a point, say `tip: arm` in body.parts, or remove `of`",
            ("resolution", "of"),
        )


def _reference_fits(scene: WholeScene) -> None:
    """A reference is no longer than its body."""
    if scene.reference is not None and scene.reference.centreline[-1][0] > scene.length * (
        1 + 1e-6
    ):
        kind = scene.body.kind
        raise fault(
            f"s_mm of the reference must not exceed the {kind}'s length, {1e3 * scene.length:g} mm",
            f"check that the table belongs to this {kind}",
            ("reference", "centreline"),
        )


def _motion_has_its_solver(scene: WholeScene) -> None:
    """Effects that act on a moving body only need the dynamic solver."""
    if not scene.static:
        return
    along_time = scene.solver.quasi_static is not None
    for name in ("feed", "magnetic_interaction"):
        if scene.effects.self_contact is not None and getattr(scene.effects, name) is not None:
            raise fault(
                f"equilibria with self_contact can't be combined with {name}",
                "remove one of the two, or simulate the motion: `solver: {dynamic: {duration: "
                "0.5 s}}`",
                ("effects", "self_contact"),
            )
    for name, effect in scene.effects.named().items():
        if effect.ONLY_IN_MOTION and not (along_time and effect.ALONG_TIME):
            ways = "`solver: {dynamic: {duration: 0.5 s}}`"
            raise fault(
                f"{name} acts in motion only, and this scene is solved for"
                f" {'equilibria along time' if along_time else 'its equilibrium'}",
                "write"
                f" {ways}{' or `solver: {quasi_static: {steps: 40}}`' if effect.ALONG_TIME else ''},"
                f" or do not name {name}",
                ("effects", name),
            )


def _feed_can_push(scene: WholeScene) -> None:
    """The guide must hold some of a catheter, and go on holding it."""
    feed = scene.effects.feed
    catheter = scene.body.catheter
    if feed is None:
        return
    if catheter is None:
        raise fault(
            f"feed pushes a catheter, and this body is a {scene.body.kind}",
            "do not name feed",
            ("effects", "feed"),
        )
    least = catheter.diameter
    if not feed.exit >= least:
        raise fault(
            f"the guide must hold at least one diameter of the catheter, {1e3 * least:g} mm from "
            "the base at x = 0",
            f"write an exit of {1e3 * least:g} mm or more",
            ("effects", "feed", "exit"),
        )
    left = feed.exit - feed.speed * scene.duration
    if not left >= least:
        raise fault(
            f"the base must stay in the guide by one diameter, {1e3 * least:g} mm; {1e3 * left:g}"
            f" mm are left after {scene.duration:g} s",
            "push more slowly, for a shorter time, or from a guide whose exit is farther",
            ("effects", "feed", "speed"),
        )


def _stream_is_steady(scene: WholeScene) -> None:
    """A flow through a lumen needs one; at rest a stream bends one equilibrium, on a grid that is given."""
    fluid = scene.effects.fluid
    if fluid is None or not fluid.flows:
        return
    key = "velocity" if fluid.mean_speed is None else "mean_speed"
    walls = scene.effects.walls
    if fluid.mean_speed is not None and (walls is None or walls.tube is None):
        raise fault(
            "a flow with `mean_speed` needs the tube that it flows through",
            "name `walls: {tube: {radius: 5 mm, path: vessel.csv}}`, or write `velocity`",
            ("effects", "fluid", key),
        )
    if scene.solver.quasi_static is not None:
        raise fault(
            (
                "drag is not available in equilibria along time; a stream acts on single "
                "equilibria and in motion"
            ),
            (
                "write `solver: {static: {}}` or `solver: {dynamic: {duration: 0.5 s}}`, "
                "or remove the stream"
            ),
            ("effects", "fluid", key),
        )
    if scene.static and scene.resolution.requested:
        raise fault(
            "the error of a shape in a stream is not estimated",
            "write, say, `resolution: {cells_across: 4}`, and compare with finer cells",
            ("effects", "fluid", key),
        )


def _segments_turn_alone(scene: WholeScene) -> None:
    """Segments act on each other as dipoles that stretch with the material, in a body of a finite width."""
    if scene.effects.magnetic_interaction is None:
        return
    if scene.body.shape.in_plane_strain:
        raise fault(
            "segments act on each other as dipoles, and in plane strain they have no end along y",
            "remove plane_strain, or do not name magnetic_interaction",
            ("effects", "magnetic_interaction"),
        )
    for k in np.flatnonzero(rotating(scene)):
        raise fault(
            "magnetic_interaction supports only magnetization that stretches with the material",
            "remove magnetization_law, or do not name magnetic_interaction",
            ("materials", scene.regions()[k].material_name, "magnetization_law"),
        )


def _field_suits_the_solver(scene: WholeScene) -> None:
    """Equilibrium has one field, the one at the end of the schedule, and is a minimum of one energy."""
    if not scene.static or scene.solver.quasi_static is not None:
        return
    over = scene.field.over_time
    if over is not None and over.endless is not None:
        count = {"rotation": "turns", "oscillation": "cycles"}[over.endless]
        raise fault(
            "a static solve takes the field at the end of its schedule, and this has no end",
            f"add `{count}` to say when it stops, or ask for motion with solver.dynamic",
            ("field", "over_time", over.endless),
        )


def _path_has_an_end(scene: WholeScene) -> None:
    """Equilibria along time need to know until when, where neither the solver nor the field's schedule says it."""
    options = scene.solver.quasi_static
    over = scene.field.over_time
    if options is None or options.steps is None or options.duration is not None:
        return
    why = None
    moved = [move.over_time for move in (scene.move or {}).values() if move.over_time is not None]
    if over is not None and over.endless is not None:
        why = f"the field's {over.endless} has no end"
    elif endless := [one.endless for one in moved if one.endless is not None]:
        why = f"the {endless[0]} in `move` has no end"
    elif over is None and scene.effects.feed is not None:
        why = "feed has no end, and the field does not change"
    elif not scene.path_times()[-1] > 0.0:
        raise fault(
            *_nothing_changes("the field has no schedule, and nothing is fed or moved"),
            ("solver", "quasi_static"),
        )
    if why is not None:
        raise fault(
            f"the steps are equal parts of a time that the scene must give: {why}",
            "add `duration`, say `quasi_static: {steps: 40, duration: 0.5 s}`, or list the times:"
            " `at`",
            ("solver", "quasi_static", "steps"),
        )


def _something_changes(scene: WholeScene) -> None:
    """Require that the load changes along a path of equilibria. Of files alone."""
    feed = scene.effects.feed
    if scene.solver.quasi_static is None or (feed is not None and feed.speed != 0.0):
        return
    times = np.array(scene.path_times())
    if any(np.ptp(move.share(times)) > 0.0 for move in (scene.move or {}).values()):
        return
    places = schedule.places(scene.field, times)
    if len(places) == 1 or (places == places[0]).all():
        why = (
            "the field is the same at all of its times"
            if scene.field.over_time is not None
            else "the field has no schedule"
        )
        raise fault(*_nothing_changes(f"{why}, and nothing is fed"), ("solver", "quasi_static"))
    if not scene.effects.in_a_field and not scene.effects.auto:
        raise fault(
            *_nothing_changes("no effect of the field is named, and nothing is fed"),
            ("solver", "quasi_static"),
        )


def _nothing_changes(why: str) -> tuple[str, str]:
    return (
        f"nothing changes along this path of equilibria: {why}",
        (
            "let the field change, say `over_time: {ramp: {duration: 0.1 s}}`, name `feed`, or ask"
            " for one equilibrium: `solver: {static: {}}`"
        ),
    )


def without_energy(scene: WholeScene) -> str | None:
    """Torque or force, whichever an equilibrium in a field that varies in space lacks; None where all is well."""
    torque = scene.effects.magnetic_torque
    force = scene.effects.magnetic_force
    if not scene.static or not scene.field.varies or (torque is None) == (force is None):
        return None
    return "magnetic_torque" if torque is None else "magnetic_force"


def _field_acts(scene: WholeScene, effect: str) -> None:
    """A file that requests an external field's torque or force must have something to turn and something to turn it.

    Only required of files: a study or a test may well set the field or all magnetizations to zero.
    """
    if "field" not in scene.model_fields_set:
        raise fault(
            f"{effect} needs a field",
            f"add, say, `field: {{uniform: [0 mT, 6 mT, 8 mT]}}`, or do not name {effect}",
            ("field",),
        )
    if not scene.magnetized_regions():
        raise fault(
            f"{effect} needs a segment with a magnetization whose material has a remanence",
            "give a segment, say, `magnetization: [1, 0, 0]`, and its material `remanence: 138 mT`",
            ("effects", effect),
        )


def warnings(scene: SceneLike) -> list[str]:
    """Warn of settings that the author may not have meant: one sentence each."""
    found: list[str] = []
    magnetized = scene.magnetized_regions()
    shape = scene.body.shape
    dynamic = scene.solver.dynamic
    gravity = scene.effects.gravity
    torque = scene.effects.magnetic_torque
    force = scene.effects.magnetic_force
    if torque is None and force is None and scene.field.acts and magnetized:
        found.append("effects: magnetic_torque is not named, so the field has no effect")
    elif torque is None and force is not None and scene.field.varies:
        found.append(
            "effects: magnetic_torque is not named, so the field pulls the segments but does not"
            " turn them"
        )
    elif force is None and scene.field.varies and magnetized:
        found.append(
            "effects: magnetic_force is not named, so the field turns the segments but does not"
            " pull them"
        )
    acting = (torque, force, scene.effects.magnetic_interaction)
    if shape.magnetized_by_region and any(effect is not None for effect in acting):
        found += _left_unmagnetized(scene)
    if force is not None and not scene.field.varies:
        found.append("effects: magnetic_force has no effect: the field is the same everywhere")
    if not any(effect is not None for _, effect in scene.effects):
        found.append("effects: none is named, so nothing moves")
    frictionless = scene.solver.quasi_static is None or scene.effects.feed is not None
    for key in ("self_contact", "ground", "walls") if dynamic is None and frictionless else ():
        effect = getattr(scene.effects, key)
        if effect is not None and most_friction(scene, effect.friction) > 0.0:
            found.append(
                f"effects.{key}: equilibria ignore friction: the body slides until the normal "
                f"forces of {key} alone hold it"
            )
    one_grid = dynamic is None and scene.effects.self_contact is None
    own = shape.warnings(scene.resolution.cells_across, one_grid=one_grid)
    fitted = dynamic is None and scene.body.catheter is not None and scene.body.catheter.round_cells
    found += of_known_error(own) if fitted else own
    if (
        scene.body.parts is not None
        and scene.effects.self_contact is not None
        and scene.body.parts.in_one_piece
    ):
        gap = f"{1e3 * TOUCHING_DISTANCE * shape.length:.2g} mm"
        found.append(
            "effects.self_contact: all parts touch and stay joined where their faces meet; parts "
            f"that should slide need a gap of more than {gap}"
        )
    if shape.clamp == "none" and scene.effects.feed is not None:
        found.append(
            "body.catheter.clamp: none has no effect here: the guide of feed holds and pushes "
            "the base, clamped or not"
        )
    if shape.in_plane_strain and scene.field.uniform[1] and torque is not None:
        found.append("field: its y component has no effect on a strip in plane strain")
    if shape.in_plane_strain and gravity is not None and gravity.acceleration[1]:
        found.append(
            "effects.gravity: the y component of its acceleration has no effect on a strip in "
            "plane strain"
        )
    used = {region.material_name for region in scene.regions()}
    found += [f"materials: {name} is not used" for name in scene.materials if name not in used]
    return found


def _left_unmagnetized(scene: SceneLike) -> list[str]:
    """Segments and parts that can move and have no direction, of a material with a remanence: a sentence for each material."""
    bare: dict[str, list[str]] = {}
    for region in scene.regions():
        if (
            not region.held
            and not any(region.magnetization)
            and scene.materials[region.material_name].remanence > 0.0
        ):
            bare.setdefault(region.material_name, []).append(dotted(("body", *region.at)))
    return [
        f"{', '.join(keys)}: not magnetized, though {name} has a remanence of"
        f" {quantity(scene.materials[name].remanence, 'T')}; give a direction, say"
        " `magnetization: [1, 0, 0]`, or a material without remanence"
        for name, keys in bare.items()
    ]


def of_known_error(warnings: list[str]) -> list[str]:
    """Warnings of a result whose error is known: without those of what its cells may do to it."""
    return [warning for warning in warnings if not warning.startswith(THIN_WALL)]
