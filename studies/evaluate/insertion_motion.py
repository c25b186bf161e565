"""The push of a design through its guide, as a motion: the dynamic scene of an insertion (`magmpm report --motion` runs it).

The scene is OUT/best/scene.yaml. Its catheter is longer than the study's by a plain piece that stays in the guide; `feed` pushes it at one
speed, and the field passes from each depth's to the next's evenly. It begins one diameter out, without a field.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, report
from magmpm.inputs.yaml_document import read_yaml
from magmpm.studies.search.best_scene import SCENE
from magmpm.studies.search.file_paths import mended

if TYPE_CHECKING:
    from magmpm.scene import Scene
    from magmpm.studies.problem.study import Study
    from magmpm.studies.search.search_space import SearchSpace

SPEED = 10e-3  # m/s: the slowest free swing of a 56 mm catheter takes half a second, in which it advances by two diameters
DAMPING = 30.0  # 1/s
CELLS = 2  # across: a motion of seconds costs minutes
HELD = 2.0  # diameters of plain catheter that are in the guide at the end
FRAME = 20e-3  # s


def times(depths: Array, diameter: float) -> Array:
    """Times when each depth is reached, s."""
    return (np.asarray(depths) - min(diameter, depths[0])) / SPEED


def write_push(folder: Path, study: Study, space: SearchSpace, params: Mapping[str, Any]) -> Path | None:
    """Writes the motion of a design; returns the file, None for a study made in Python."""
    if study.scene_file is None:
        return None
    path = folder / SCENE
    content = _content(study, space, params, folder)
    head = (
        f"# The best design of the study {study.name}, pushed through its guide while the field passes from depth to depth.\n"
        f"# `magmpm design` writes it anew when a trial is better: copy it before you change it.\n#\n#   magmpm run {path} --render\n"
        f"#   magmpm report {folder.parent} --motion        runs it and compares it with the equilibria of the study\n\n"
    )
    text = head + yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
    return path


def _content(study: Study, space: SearchSpace, params: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    assert study.scene_file is not None
    content: dict[str, Any] = mended(dict(read_yaml(study.scene_file)), study.scene_file.parent, folder)
    whole = space.scene_of(params)
    shape = whole.body.catheter
    assert shape is not None
    catheter = content["body"]["catheter"]
    segments = [dict(segment) for segment in catheter["segments"]]
    for segment, length, direction in zip(segments, shape.segment_lengths(), space.directions(params), strict=True):
        segment.update(length=f"{1e3 * length:.12g} mm", magnetization=direction.tolist())
    held, depths = HELD * shape.diameter, np.array(study.depths)
    total = study.scene.length + held
    out = min(shape.diameter, float(depths[0]))
    catheter.update(length=f"{1e3 * total:.12g} mm", segments=[{"length": f"{1e3 * held:.12g} mm"}, *segments])
    catheter.pop("clamp", None)
    count = len(depths)
    fields = np.array([space.field(params, k if space.fields > 1 else -1) for k in range(count)])
    reached = times(depths, shape.diameter)
    keyframes = [{"time": "0 s", "uniform": ["0 mT", "0 mT", "0 mT"]}] if reached[0] > 0 else []
    keyframes += [
        {"time": f"{time:.9g} s", "uniform": [f"{1e3 * x:.12g} mT" for x in field]} for time, field in zip(reached, fields, strict=True)
    ]
    effects = {key: value for key, value in content.get("effects", {}).items() if key != "feed"}
    effects |= _moved_walls(whole, total - out)
    effects |= {"feed": {"speed": f"{1e3 * SPEED:g} mm/s", "exit": f"{1e3 * (total - out):.12g} mm"}}
    effects.setdefault("damping", {"rate": f"{DAMPING:g} 1/s"})
    content.update(
        name=f"{study.name} push"[:100],
        field={**content.get("field", {}), "uniform": ["0 mT", "0 mT", "0 mT"], "over_time": {"keyframes": keyframes}}, effects=effects,
        solver={"dynamic": {"duration": f"{reached[-1]:.9g} s", "output_every": f"{1e3 * FRAME:g} ms"}}, resolution={"cells_across": CELLS},
    )  # fmt: skip
    content.pop("reference", None)
    return content


def _moved_walls(scene: Scene, exit_at: float) -> dict[str, Any]:
    """A tube of `walls` where the push has its guide's exit; the scene has it around its own, or around the origin.

    Raises InputError for walls of a surface, which can't be moved.
    """
    walls = scene.effects.walls
    if walls is None:
        return {}
    if walls.tube is None:
        rule = "the push of an insertion moves its walls to the guide's exit, and a surface stays where its file has it"
        raise InputError(report("effects.walls.surface", rule=rule, remedy="give the walls as a `tube`, or do not name them"))
    shift = np.array([exit_at - (0.0 if scene.effects.feed is None else scene.effects.feed.exit), 0.0, 0.0])
    path = [[f"{1e3 * x:.9g} mm" for x in np.asarray(point) + shift] for point in walls.tube.path]
    return {"walls": {"tube": {"radius": f"{1e3 * walls.tube.radius:.9g} mm", "path": path}, "friction": walls.friction}}
