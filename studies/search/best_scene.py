"""The scene of a study's best design as a file that runs: the study's own scene with the design that the study found.

It is written from the scene's file, with its units and words, not from the numbers in memory. Its paths are adjusted, because a scene's
paths are relative to its own file.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from magmpm.inputs.yaml_document import read_yaml
from magmpm.studies.search.file_paths import from_folder, mended
from magmpm.studies.search.scene_edits import Edits
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.studies.search.definition import Study

SCENE = "scene.yaml"
STEPS = 10  # equilibria from one shape of a schedule to the next


def write_best_scene(folder: Path, study: Study, space: SearchSpace, best: Mapping[str, Any]) -> Path | None:
    """Write the scene of a design into a folder. Returns the file, or None for a study that was made in Python.

    best: {number, rms_m, params} of the trial. The file is written whole or not at all, and left alone if it says the same.
    """
    if study.scene_file is None:
        return None
    path = folder / SCENE
    text = _head(study, best, path) + yaml.safe_dump(
        _content(study, study.scene_file, space, best["params"], folder), sort_keys=False, default_flow_style=None, width=120,
        allow_unicode=True,
    )  # fmt: skip
    if path.exists() and path.read_text(encoding="utf-8") == text:
        return path
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
    return path


def _head(study: Study, best: Mapping[str, Any], path: Path) -> str:
    """Comment lines: what the file is, where it comes from, and how to run it."""
    assert study.scene_file is not None
    made_of = from_folder(study.scene_file, path.parent)
    return (
        f"# The best design of the study {study.name}: trial {best['number']}, rms {1e3 * best['rms_m']:.4g} mm from the target shape.\n"
        f"# `magmpm design` made it of {made_of}, and writes it anew when a trial is better: copy it before you change it.\n"
        "#\n"
        f"#   magmpm run {path} --render\n\n"
    )


def _content(study: Study, source: Path, space: SearchSpace, found: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The scene's file as data, with the design in it and paths relative to `folder`."""
    content: dict[str, Any] = mended(dict(read_yaml(source)), source.parent, folder)
    content["name"] = f"{study.name} best"[:100]
    space.edit(Edits(study.scene, content), space.embedded(found), found.get("order"))
    if study.keyframes:
        _add_schedule(content, study, space, found)
    return content


def _add_schedule(content: dict[str, Any], study: Study, space: SearchSpace, found: Mapping[str, Any]) -> None:
    """The fields of all times as keyframes, from no field at 0 s, and equilibria along them."""
    zero = ["0 mT"] * 3
    frames: list[dict[str, Any]] = [{"time": "0 s", "uniform": zero}]
    for k, frame in enumerate(study.keyframes):
        uniform = [f"{1e3 * component:.15g} mT" for component in space.field(found, k).tolist()]
        frames.append({"time": f"{frame.time:.15g} s", "uniform": uniform})
    times = [0.0, *(frame.time for frame in study.keyframes)]
    if study.hold > 0:
        times.append(times[-1] + study.hold)
        frames.append({"uniform": list(frames[-1]["uniform"]), "time": f"{times[-1]:.15g} s"})
    field = {key: value for key, value in content.get("field", {}).items() if key != "uniform"}
    content["field"] = {**field, "over_time": {"keyframes": frames}}
    at = [a + (b - a) * i / STEPS for a, b in itertools.pairwise(times) for i in range(STEPS)]
    solver = {key: value for key, value in content.get("solver", {}).items() if key != "static"}
    content["solver"] = {**solver, "quasi_static": {"at": [f"{time:.12g} s" for time in (*at, times[-1])]}}
