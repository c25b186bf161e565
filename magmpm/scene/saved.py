"""A scene as a file that `load_scene` reads back as an equal one."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import yaml

from magmpm.errors import InputError, report
from magmpm.inputs.csv_tables import write_centreline
from magmpm.inputs.settings import read_yaml, validate


def save(scene: Any, path: Path) -> Path:
    """Write a Scene with units, and its reference as a table beside it. Returns the path.

    Both are read back first. Raises InputError where the scene would be another one, because it holds tables that files name by their
    paths; nothing is written then.
    """
    content = scene.model_dump(mode="json", exclude_none=True, context={"units": True})
    if scene.in_time:
        del content["solver"]["static"]  # there by default
    reference = scene.reference_centreline()
    if reference is not None:
        content["reference"] = {"centreline": f"{path.stem}_reference.csv"}
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        trial = Path(folder) / path.name
        trial.write_text(yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=140, allow_unicode=True), encoding="utf-8")
        if reference is not None:
            write_centreline(trial.with_name(content["reference"]["centreline"]), reference)
        try:
            same = validate(type(scene), read_yaml(trial)) == scene
        except InputError:
            same = False
        if not same:
            rule = "tables and meshes that were read from files can't be written into a scene's file, which names them by their paths"
            remedy = "change a copy of the file that the scene was loaded from"
            raise InputError(report(f"{path}: can't be written", received=scene.name, rule=rule, remedy=remedy))
        for file in Path(folder).iterdir():
            file.replace(path.with_name(file.name))
    return path
