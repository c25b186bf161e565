"""The scene of a study's best design as a file that runs: the study's own scene with the design that the study found.

It is written from the scene's file, with its units and words, not from the numbers in memory. Its paths are adjusted, because a scene's
paths are relative to its own file.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from magmpm.bodies.surface_mesh import PREFIX
from magmpm.compiled.arrays import Array, Named, Plain
from magmpm.errors import InputError
from magmpm.inputs.yaml_document import read_yaml
from magmpm.results.whole_file import whole_file
from magmpm.studies.search.parameters import Parameters
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.scene import Scene
    from magmpm.studies.problem.study import Study

PATHS = frozenset({"mesh", "table", "centreline", "path"})  # keys whose text names a file
SCENE = "scene.yaml"
# m/s: the slowest free swing of a 56 mm catheter takes half a second, in which it advances by two
# diameters
SPEED = 10e-3


def moved_content(source: Path, folder: Path) -> Plain:
    """Read the content of a scene's file, with its paths as a file in another folder names them.

    Parameters
    ----------
    source : Path
        The scene's file.
    folder : Path
        The other folder.

    Returns
    -------
    dict[str, Any]
        The content.
    """
    content: Plain = _mended(dict(read_yaml(source)), source.parent, folder)
    return content


def as_yaml(content: Named) -> str:
    """Write the content of a scene as the text of a file.

    Parameters
    ----------
    content : Mapping[str, Any]
        Plain data.

    Returns
    -------
    str
        The text.
    """
    return yaml.safe_dump(
        content, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
    )


def _mended(value: Any, old: Path, new: Path, key: str | int = "") -> Any:
    """The same data, with paths that were relative to the folder `old` relative to `new`."""
    if isinstance(value, Mapping):
        return {name: _mended(item, old, new, name) for name, item in value.items()}
    if isinstance(value, list):
        return [_mended(item, old, new) for item in value]
    if key in PATHS and isinstance(value, str) and not value.startswith(PREFIX):
        return value if Path(value).is_absolute() else _from_folder(old / value, new)
    return value


def _from_folder(path: Path, folder: Path) -> str:
    """A path as a file in `folder` names it."""
    return Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix()


def write_best_scene(
    folder: Path, study: Study, space: SearchSpace, best: Parameters
) -> Path | None:
    """Write the scene of a design into a folder, whole or not at all; a file that says the same is left alone.

    Of an insertion it is the push of the design through its guide, as a motion (`magmpm report
    --motion` runs it): the catheter is longer than the study's by a plain piece that stays in the
    guide, `feed` pushes it at one speed, and the field passes from each depth's to the next's
    evenly. It begins one diameter out, without a field.

    Parameters
    ----------
    folder : Path
        Where it is written.
    study : Study
        The study.
    space : SearchSpace
        Its search space.
    best : Mapping[str, Any]
        The trial's `number`, `rms_m` and `params`.

    Returns
    -------
    Path or None
        The file; None for a study that was made in Python.
    """
    if study.scene_file is None:
        return None
    path = folder / SCENE
    content = moved_content(study.scene_file, folder)
    space.write(content, best["params"])
    if study.depths:
        _add_push(content, study, space, best["params"])
        head = (
            f"# The best design of the study {study.name}, pushed through its guide while the field"
            " passes from depth to depth.\n# `magmpm design` overwrites it when a trial is"
            f" better: copy it before you change it.\n#\n#   magmpm run {path} --render\n#   magmpm"
            f" report {folder.parent} --motion        runs it and compares it with the equilibria"
            " of the study\n\n"
        )
    else:
        content["name"] = f"{study.name} best"[:100]
        if study.keyframes:
            _add_schedule(content, study, space, best["params"])
        head = (
            f"# The best design of the study {study.name}: trial {best['number']}, rms"
            f" {1e3 * best['rms_m']:.4g} mm from the target shape.\n# `magmpm design` made it from"
            f" {_from_folder(study.scene_file, folder)}, and overwrites it when a trial is better:"
            f" copy it before you change it.\n#\n#   magmpm run {path} --render\n\n"
        )
    text = head + as_yaml(content)
    if not (path.exists() and path.read_text(encoding="utf-8") == text):
        with whole_file(path) as part:
            part.write_text(text, encoding="utf-8")
    return path


def _without(content: Named, part: str, left_out: str) -> Plain:
    """A part of a file's content without one of its keys."""
    return {key: value for key, value in content.get(part, {}).items() if key != left_out}


def _add_schedule(content: Plain, study: Study, space: SearchSpace, found: Named) -> None:
    """The fields of all times as keyframes, from no field at 0 s, and equilibria along them."""
    zero = ["0 mT"] * 3
    frames: list[Plain] = [{"time": "0 s", "uniform": zero}]
    for k, frame in enumerate(study.keyframes):
        uniform = [f"{1e3 * component:.15g} mT" for component in space.field(found, k).tolist()]
        frames.append({"time": f"{frame.time:.15g} s", "uniform": uniform})
    times = [0.0, *(frame.time for frame in study.keyframes)]
    if study.hold > 0:
        times.append(times[-1] + study.hold)
        frames.append({"uniform": list(frames[-1]["uniform"]), "time": f"{times[-1]:.15g} s"})
    field = _without(content, "field", "uniform")
    content["field"] = {**field, "over_time": {"keyframes": frames}}
    at = [a + (b - a) * i / 10 for a, b in itertools.pairwise(times) for i in range(10)]
    content["solver"] = {
        **_without(content, "solver", "static"),
        "quasi_static": {"at": [f"{time:.12g} s" for time in (*at, times[-1])]},
    }


def times(depths: Array, diameter: float) -> Array:
    """Find when each depth of an insertion is reached.

    Parameters
    ----------
    depths : array (n,), m
        Inserted lengths.
    diameter : float, m
        Of the catheter, which begins that far out.

    Returns
    -------
    array (n,), s
        A time for each depth.
    """
    return (np.asarray(depths) - min(diameter, depths[0])) / SPEED


def _add_push(content: Plain, study: Study, space: SearchSpace, params: Parameters) -> None:
    """The motion of a design."""
    whole = space.scene_of(params)
    shape = whole.body.catheter
    assert shape is not None
    catheter = content["body"]["catheter"]
    segments = [dict(segment) for segment in catheter["segments"]]
    for segment, length, direction in zip(
        segments, shape.segment_lengths(), space.directions(params), strict=True
    ):
        segment.update(length=f"{1e3 * length:.12g} mm", magnetization=direction.tolist())
    held = 2.0 * shape.diameter
    depths = np.array(study.depths)
    total = study.scene.length + held
    out = min(shape.diameter, float(depths[0]))
    catheter.update(
        length=f"{1e3 * total:.12g} mm", segments=[{"length": f"{1e3 * held:.12g} mm"}, *segments]
    )
    catheter.pop("clamp", None)
    fields = np.array(
        [space.field(params, k if space.fields > 1 else -1) for k in range(len(depths))]
    )
    reached = times(depths, shape.diameter)
    keyframes = [{"time": "0 s", "uniform": ["0 mT", "0 mT", "0 mT"]}] if reached[0] > 0 else []
    keyframes += [
        {"time": f"{time:.9g} s", "uniform": [f"{1e3 * x:.12g} mT" for x in field]}
        for time, field in zip(reached, fields, strict=True)
    ]
    effects = _without(content, "effects", "feed") | _moved_walls(whole, total - out)
    effects |= {
        "feed": {"speed": f"{1e3 * SPEED:g} mm/s", "exit": f"{1e3 * (total - out):.12g} mm"}
    }
    effects.setdefault("damping", {"rate": "30 1/s"})
    content.update(
        name=f"{study.name} push"[:100],
        field={
            **content.get("field", {}),
            "uniform": ["0 mT", "0 mT", "0 mT"],
            "over_time": {"keyframes": keyframes},
        },
        effects=effects,
        solver={"dynamic": {"duration": f"{reached[-1]:.9g} s", "output_every": "20 ms"}},
        resolution={"cells_across": 2},  # minutes
    )
    content.pop("reference", None)


def _moved_walls(scene: Scene, exit_at: float) -> Plain:
    """A tube of `walls` where the push has its guide's exit; the scene has it around its own, or around the origin.

    Raises InputError for walls of a surface, which can't be moved.
    """
    walls = scene.effects.walls
    if walls is None:
        return {}
    if walls.tube is None:
        rule = (
            "the push of an insertion moves its walls to the guide's exit, and a surface stays"
            " where its file has it"
        )
        raise InputError(
            "effects.walls.surface",
            rule=rule,
            remedy="give the walls as a `tube`, or do not name them",
        )
    shift = np.array(
        [exit_at - (0.0 if scene.effects.feed is None else scene.effects.feed.exit), 0.0, 0.0]
    )
    path = [[f"{1e3 * x:.9g} mm" for x in np.asarray(point) + shift] for point in walls.tube.path]
    return {
        "walls": {
            "tube": {"radius": f"{1e3 * walls.tube.radius:.9g} mm", "path": path},
            "friction": walls.friction,
        }
    }
