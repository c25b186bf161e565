"""A scene with the numbers of its sliders: as a Scene to be solved, and as a file that `magmpm run` takes.

The file is the scene's own, with its units and words; only what was turned is written anew.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from magmpm.errors import InputError, report
from magmpm.inputs.yaml_document import read_yaml
from magmpm.results.whole_file import whole_file
from magmpm.scene import Scene, load_scene
from magmpm.solving.effects_choice import choose_effects
from magmpm.studies.explore.live.sliders import AXES, SOURCES, Control, Values, angles, turned
from magmpm.studies.search.best_scene import mended

Data = dict[str, Any]


def changed(scene: Scene, known: Mapping[str, Control], values: Values) -> Scene:
    """The scene with these values. Raises InputError for what no scene has, with the sliders that are refused alone, or all turned ones."""
    new = turned(known, values)
    if not new:
        return scene
    try:
        return _changed(scene, new)
    except InputError as error:
        alone = [name for name in new if _refused(scene, {name: new[name]})]
        raise InputError(f"{', '.join(known[name].said(new[name]) for name in alone or new)}\n  {error}") from error


def _refused(scene: Scene, new: Values) -> bool:
    try:
        _changed(scene, new)
    except InputError:
        return True
    return False


def _changed(scene: Scene, new: Values) -> Scene:
    data = scene.to_si()
    _put_field(data.setdefault("field", {}), scene, new, _in_si)
    _put_directions(data["body"], scene, new, _unit_vector)
    out = Scene.from_si(data)
    return out.inserted(1e-3 * new["inserted"]) if "inserted" in new else out


def saved(scene: Scene, source: Path, shown: Scene, known: Mapping[str, Control], values: Values, path: Path) -> Scene:
    """Write the scene as it is shown to a file; the scene that the file gives when it is read.

    scene: what the sliders began with; source: its file; shown: what they made of it. Raises InputError, OSError.
    """
    new = turned(known, values)
    content: Data = mended(dict(read_yaml(source)), source.resolve().parent, path.resolve().parent)
    content["name"] = f"{scene.name} viewed"[:100]
    content.pop("reference", None) if "inserted" in new else None
    if scene.effects != load_scene(source).effects:  # `auto`: those that were chosen are what is shown
        content["effects"] = {key: {} for key in scene.effects.named()}
    content["resolution"] = _resolution(scene)
    if any(name.startswith(("field.", *SOURCES)) for name in new):
        content["field"] = dict(content.get("field") or {})
        _put_field(content["field"], scene, new, _with_unit)
    _put_directions(content["body"], scene, new, _two_angles)
    if "inserted" in new:
        _put_inserted(content, shown)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as part:
        part.write_text(_head(source, path) + yaml.safe_dump(
            content, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True), encoding="utf-8")
    return load_scene(path)


def _head(source: Path, path: Path) -> str:
    return (f"# {source.name} as `magmpm view` showed it.\n#\n#   magmpm run {path} --render\n\n")


def _resolution(scene: Scene) -> Data:
    found = scene.resolution.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
    return {**found, "cells_across": scene.resolution.cells_across}


def _in_si(value: float, unit: str) -> Any:
    return {"mT": 1e-3, "mm": 1e-3}[unit] * value


def _with_unit(value: float, unit: str) -> Any:
    return f"{value:.15g} {unit}"


def _put_field(field: Data, scene: Scene, new: Values, write: Any) -> None:
    """The uniform part and the places of sources, into the data of a field."""
    if any(f"field.{axis}" in new for axis in AXES):
        own = field.get("uniform", scene.field.uniform if write is _in_si else ["0 mT"] * 3)
        field["uniform"] = [write(new[f"field.{a}"], "mT") if f"field.{a}" in new else old for a, old in zip(AXES, own, strict=True)]
    for kind in SOURCES:
        for k in range(len(getattr(scene.field, kind) or ())):
            names = [f"{kind}.{k}.{axis}" for axis in AXES]
            if any(name in new for name in names):
                own = field[kind] if isinstance(field[kind], Mapping) else field[kind][k]
                place = [write(new[name], "mm") if name in new else old for name, old in zip(names, own["position"], strict=True)]
                own["position"] = place


def _unit_vector(azimuth: float, elevation: float) -> Any:
    a, e = math.radians(azimuth), math.radians(elevation)
    return [math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)]


def _two_angles(azimuth: float, elevation: float) -> Any:
    return {"azimuth": f"{azimuth:.15g} deg", "elevation": f"{elevation:.15g} deg"}


def _put_directions(body: Data, scene: Scene, new: Values, write: Any) -> None:
    """The directions of regions, of which one angle or both were turned, into the data of a body."""
    for k, region in enumerate(scene.regions()):
        names = f"direction.{k}.azimuth", f"direction.{k}.elevation"
        if not any(name in new for name in names):
            continue
        found: Any = body
        for key in region.at:
            found = found[key]
        azimuth, elevation = angles(region.magnetization)
        found["magnetization"] = write(new.get(names[0], round(azimuth, 9)), new.get(names[1], round(elevation, 9)))


def _put_inserted(content: Data, shown: Scene) -> None:
    """Put the part outside the guide in place of the whole catheter; it is clamped at the exit."""
    catheter = shown.body.catheter
    assert catheter is not None  # only catheters are inserted
    lengths = catheter.segment_lengths()
    own = content["body"]["catheter"]["segments"][-len(lengths) :]
    segments = [{**dict(old), "length": f"{1e3 * length:.15g} mm"} for old, length in zip(own, lengths, strict=True)]
    content["body"]["catheter"].update(length=f"{1e3 * catheter.length:.15g} mm", segments=segments, clamp="base")
    content["resolution"]["from_tip"] = True
    kept = shown.effects.named()
    content["effects"] = {key: value for key, value in content["effects"].items() if key in kept}
    content["solver"] = {key: value for key, value in (content.get("solver") or {}).items() if key in ("anti_locking", "static")}


USUAL = 4  # cells across, where the scene requests an error instead


def ready(scene: Scene, cells: int | None = None) -> Scene:
    """The scene with `effects: auto` chosen, and in `cells` cells across, or its own; USUAL where it requests an error or a time.

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
