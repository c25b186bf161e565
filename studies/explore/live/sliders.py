"""Sliders of a scene that can be changed while one looks; the scene with their numbers, to be solved, and as a file for `magmpm run`.

The file is the scene's own, with its units and words; only what was turned is written anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import NamedNumbers, Plain
from magmpm.errors import InputError
from magmpm.fields.schedule import places
from magmpm.inputs.vectors import angles_of
from magmpm.results.whole_file import whole_file
from magmpm.scene import Scene, load_scene
from magmpm.scene.addresses import Place, Placed, put, say, written
from magmpm.scene.addresses import changed as changed_at
from magmpm.scene.variables import of_lengths
from magmpm.solving.effects_choice import choose_effects
from magmpm.studies.problem.variables import VaryNumber
from magmpm.studies.search.best_scene import as_yaml, moved_content
from magmpm.studies.search.knobs import Bounded, Knob, knobs

SOURCES = ("dipole", "magnet", "coils")
AXES = "xyz"
INSERTED = "inserted"
Values = Mapping[str, float]


@dataclass(frozen=True)
class Control:
    """One number. value, low, high: in `unit`; group: what it stands under; id: its name in `Values`, the address of the number.

    place: in the scene; of an angle that of its direction; () of the length outside the guide.
    """

    id: str
    group: str
    label: str
    unit: str
    low: float
    high: float
    step: float
    value: float
    place: Place = ()

    def said(self, value: float) -> str:
        """Slider, number and unit, as in "field Bz: 99 999 mT"."""
        number = f"{value:.6g}" if abs(value) >= 1e9 else f"{value:,.9g}".replace(",", " ")
        return (
            f"{self.group.lower()} {self.label}: {number}"
            f" {'°' if self.unit == 'deg' else self.unit}"
        )

    def plain(self) -> Plain:
        """Plain data."""
        return asdict(self)


def controls(scene: Scene, more: Sequence[VaryNumber] = ()) -> tuple[Control, ...]:
    """All that can be turned in a scene, in the order in which they are shown; more: numbers within bounds, by their addresses, in place
    of the usual sliders of these.

    Raises InputError as `knobs` does, and for a number that the scene leaves out.
    """
    every = (
        *_field(scene),
        *_inserted(scene),
        *_sources(scene),
        *_directions(scene),
        *(_of_number(knob, scene) for knob in knobs(more, scene)),
    )
    return tuple({control.id: control for control in every}.values())


def _of_number(knob: Knob, scene: Scene) -> Control:
    """Slider of a number within bounds. Raises InputError."""
    place = knob.places[0]
    own = knob.own(scene)
    if not isinstance(knob, Bounded) or not own:
        raise InputError(
            "--vary",
            received=written(place),
            rule="must be a number that the scene has",
            remedy="write it in the scene's file",
        )
    (value,) = own.values()
    low = min(knob.low, value)
    high = max(knob.high, value)
    step = 1.0 if knob.whole else (high - low) / 400
    name = written(place)
    return Control(name, "Numbers", name, knob.unit, low, high, step, value, place)


def checked(known: Mapping[str, Control], values: Any) -> NamedNumbers:
    """Values that came from outside: names of controls with finite numbers. Their ranges are the sliders', not the scene's, but a number
    can be typed, so that anything the scene itself allows is. Raises InputError."""
    if not isinstance(values, Mapping):
        raise InputError(
            "values",
            received=type(values).__name__,
            rule="must be numbers by name",
            remedy="move a slider",
        )
    out = {}
    for name, value in values.items():
        if name not in known:
            raise InputError(
                "values",
                received=repr(name)[:80],
                rule="this scene has no such slider",
                remedy=f"use one of {', '.join(list(known)[:8])}",
            )
        # the last compares whole numbers of any size too
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < 1e300:
            place = f"{known[name].group.lower()} {known[name].label}"
            raise InputError(
                place,
                received=repr(value)[:80],
                rule="must be a finite number",
                remedy="type a number",
            )
        out[name] = float(value)
    return out


def turned(known: Mapping[str, Control], values: Values) -> NamedNumbers:
    """Those values that are not what the scene's own file says."""
    return {name: value for name, value in values.items() if value != known[name].value}


def nice(value: float) -> float:
    """The round number (1, 2 or 5 times a power of ten) nearest above a positive value."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(f for f in (1.0, 2.0, 5.0, 10.0) if f * power >= value * (1 - 1e-9)) * power


def shown(value: float) -> float:
    """A number without the rounding of its unit's conversion."""
    return float(f"{value:.12g}")


def _field(scene: Scene) -> Iterator[Control]:
    """The uniform field, where it turns the body, and the schedule's end is what `uniform` says."""
    field = scene.field
    effects = scene.effects
    if effects.magnetic_torque is None and effects.magnetic_force is None:
        return
    if field.over_time is not None and not _uniform_counts(scene):
        return
    largest = nice(1e3 * max(20e-3, 2 * float(np.linalg.norm(field.uniform))))
    group = "Uniform field" if field.varies else "Field"
    for k, value in enumerate(field.uniform):
        place = ("field", "uniform", k)
        now = shown(1e3 * value)
        name = f"B{AXES[k]}"
        step = largest / 400
        yield Control(written(place), group, name, "mT", -largest, largest, step, now, place)


def _uniform_counts(scene: Scene) -> bool:
    """True if the key `uniform` decides the field at the end of the schedule: keyframes may have their own."""
    plain = scene.with_field([0.0, 0.0, 0.0])
    other = scene.with_field([1e-3, 1e-3, 1e-3])
    return bool(np.any(places(plain.field)["uniform"] != places(other.field)["uniform"]))


def _inserted(scene: Scene) -> Iterator[Control]:
    """Slider for the length of a catheter outside its guide."""
    catheter = scene.body.catheter
    if catheter is None or catheter.clamp != "base" or scene.effects.feed is not None:
        return
    low = 1e3 * catheter.diameter
    high = 1e3 * catheter.length
    if high > 1.5 * low:
        yield Control(
            INSERTED,
            "Length outside the guide",
            "length",
            "mm",
            shown(low),
            shown(high),
            10.0 ** math.floor(math.log10(high / 300)),
            shown(high),
        )


def _sources(scene: Scene) -> Iterator[Control]:
    """Sliders for the positions of magnets, dipoles and coils."""
    way = 1e3 * max(50e-3, scene.length)
    for kind in SOURCES:
        for k, source in enumerate(getattr(scene.field, kind) or ()):
            name = f"{kind.removesuffix('s').capitalize()} {k + 1}"
            for i, value in enumerate(source.position):
                place = ("field", kind, k, "position", i)
                at = shown(1e3 * value)
                bounds = (at - way, at + way, way / 400)
                yield Control(written(place), name, AXES[i], "mm", *bounds, at, place)


def _directions(scene: Scene) -> Iterator[Control]:
    """Two angles of each magnetized region's direction."""
    if not scene.body.shape.magnetized_by_region:
        return
    regions = scene.regions()
    for k in scene.magnetized_regions():
        azimuth, elevation = (round(angle, 9) for angle in angles_of(regions[k].magnetization))
        group = regions[k].name[:1].upper() + regions[k].name[1:]
        place = ("body", *regions[k].at, "magnetization")
        for name, most, value in (("azimuth", 180.0, azimuth), ("elevation", 90.0, elevation)):
            at = written((*place, name))
            yield Control(at, group, name, "deg", -most, most, 1.0, value, place)


def changed(scene: Scene, known: Mapping[str, Control], values: Values) -> Scene:
    """The scene with these values. Raises InputError for what no scene has, with the sliders that are refused alone, or all turned ones."""
    new = turned(known, values)
    if not new:
        return scene
    try:
        return _changed(scene, known, new)
    except InputError as error:
        alone = [name for name in new if _refused(scene, known, {name: new[name]})]
        raise InputError(
            f"{', '.join(known[name].said(new[name]) for name in alone or new)}\n  {error}"
        ) from error


def _refused(scene: Scene, known: Mapping[str, Control], new: Values) -> bool:
    try:
        _changed(scene, known, new)
    except InputError:
        return True
    return False


def _changed(scene: Scene, known: Mapping[str, Control], new: Values) -> Scene:
    out = changed_at(scene, _at_places(known, new))
    return out.inserted(1e-3 * new[INSERTED]) if INSERTED in new else out


def _at_places(known: Mapping[str, Control], new: Values) -> Placed:
    """Values that turned sliders write into the scene or its file, with units: numbers, and directions by both of their angles."""
    found: Placed = {}
    for name, value in new.items():
        place = known[name].place
        if name == written(place):
            whole = isinstance(known[name].value, int) and value.is_integer()
            number = int(value) if whole else value
            found[place] = f"{value:.15g} {known[name].unit}" if known[name].unit else number
            continue
        both = [control for control in known.values() if control.place == place]
        found[place] = {c.label: f"{new.get(c.id, c.value):.15g} deg" for c in both}
    found.pop((), None)  # the length outside the guide
    return found


def saved(
    scene: Scene,
    source: Path,
    shown: Scene,
    known: Mapping[str, Control],
    values: Values,
    path: Path,
) -> Scene:
    """Write the scene as it is shown to a file; the scene that the file gives when it is read.

    scene: what the sliders began with; source: its file; shown: what they made of it. Raises InputError, OSError.
    """
    new = turned(known, values)
    content = moved_content(source.resolve(), path.parent)
    content["name"] = f"{scene.name} viewed"[:100]
    if INSERTED in new:
        content.pop("reference", None)
    if (
        scene.effects != load_scene(source).effects
    ):  # `auto`: those that were chosen are what is shown
        content["effects"] = {key: {} for key in scene.effects.named()}
    known_resolution = scene.resolution.model_dump(
        mode="json", exclude_none=True, exclude_defaults=True
    )
    content["resolution"] = {**known_resolution, "cells_across": scene.resolution.cells_across}
    put(content, _at_places(known, new), scene)
    if INSERTED in new:
        _put_inserted(content, shown)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        head = f"# {source.name} as `magmpm view` showed it.\n#\n#   magmpm run {path} --render\n\n"
        part.write_text(head + as_yaml(content), encoding="utf-8")
    return load_scene(path)


def _put_inserted(content: Plain, shown: Scene) -> None:
    """Put the part outside the guide in place of the whole catheter; it is clamped at the exit."""
    catheter = shown.body.catheter
    assert catheter is not None  # only catheters are inserted
    own = content["body"]["catheter"]
    own["segments"] = own["segments"][-len(shown.regions()) :]
    own["clamp"] = "base"
    say(content, shown, of_lengths(shown, catheter.segment_lengths()))
    content["resolution"]["from_tip"] = True
    kept = shown.effects.named()
    content["effects"] = {key: value for key, value in content["effects"].items() if key in kept}
    content["solver"] = {
        key: value
        for key, value in (content.get("solver") or {}).items()
        if key in ("anti_locking", "static")
    }


def ready(scene: Scene, cells: int | None = None) -> Scene:
    """The scene with `effects: auto` chosen, and in `cells` cells across, or its own; 4 where it requests an error or a time.

    Raises InputError where nothing holds its body, or the cells don't fit it.
    """
    if scene.body.shape.clamp == "none":
        raise InputError(
            f"body.{scene.body.kind}.clamp",
            received="none",
            rule="only a body that is held somewhere has a rest",
            remedy="name a clamp, or view a motion: `solver: {dynamic: ...}`",
        )
    if scene.effects.auto:
        scene = choose_effects(scene).scene
    if cells is not None and not 2 <= cells <= 16:
        raise InputError(
            "--cells", received=str(cells), rule="must be from 2 to 16", remedy="--cells 4"
        )
    if cells is not None or scene.resolution.requested:
        scene = scene.with_cells(cells or 4)
    return scene
