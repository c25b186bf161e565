"""Scenes made of a scene, for `Scene.inserted`, and a scene as a file, for `Scene.save`.

A catheter that is pushed out of a guide is straight and held inside it. So what has left the guide is a shorter catheter, clamped at the
guide's exit, and each depth of an insertion is a scene of statics, with a grid that begins at the exit and cells counted from the tip.
"""

import math
import tempfile
from pathlib import Path
from typing import Any

import yaml

from magmpm.bodies.segments import SHORTEST_SEGMENT
from magmpm.compiled.arrays import Plain
from magmpm.effects.acting import NO_LOADS
from magmpm.effects.base import SceneLike
from magmpm.errors import InputError
from magmpm.inputs.csv_tables import write_centreline
from magmpm.inputs.settings import validate
from magmpm.inputs.yaml_document import read_yaml


def inserted_data(scene: SceneLike, data: Plain, length: float) -> Plain:
    """SI data of the scene (as `to_si` gives it) made into those of its last `length` m: see Scene.inserted. Raises InputError."""
    catheter = scene.body.catheter
    if catheter is None:
        raise InputError(
            f"body.{scene.body.kind}",
            rule="only a catheter can be pushed out of a guide",
            remedy="use a catheter",
        )
    if scene.effects.feed is not None and scene.field.varies:
        rule = (
            "the exit of the guide becomes the origin, and magnets, coils, dipoles and maps do not"
            " move with it"
        )
        raise InputError(
            "effects.feed",
            rule=rule,
            remedy="give their places from the exit on, and do not name feed",
        )
    if scene.solver.dynamic is None and (
        met := [key for key in ("ground", "walls") if getattr(scene.effects, key) is not None]
    ):
        raise InputError(
            f"effects.{met[0]}",
            rule="an inserted length is solved without obstacles",
            remedy="follow the insertion: name feed, with solver.quasi_static",
        )
    least = catheter.diameter
    most = catheter.length
    length = float(length)
    if not least * (1 - 1e-9) <= length <= most * (1 + 1e-9):
        rule = (
            "between one diameter and the whole length of the catheter can be outside the guide,"
            f" {1e3 * least:g} to {1e3 * most:g} mm"
        )
        raise InputError(
            "inserted length",
            received=f"{1e3 * length:g} mm",
            rule=rule,
            remedy="start there: a shorter piece is not a rod",
        )
    length = min(max(length, least), most)
    kept = _cut(
        data["body"]["catheter"]["segments"],
        catheter.segment_lengths(),
        length,
        SHORTEST_SEGMENT * catheter.diameter,
    )
    catheter_data = {
        **data["body"]["catheter"],
        "length": math.fsum(s["length"] for s in kept),
        "segments": kept,
        "clamp": "base",
    }
    effects = {
        key: value for key, value in data["effects"].items() if key not in (*NO_LOADS, "feed")
    }
    solver = {
        key: value for key, value in data["solver"].items() if key in ("anti_locking", "static")
    }
    return {
        **{key: value for key, value in data.items() if key != "reference"},
        "body": {"catheter": catheter_data},
        "resolution": {**data["resolution"], "from_tip": True},
        "effects": effects,
        "solver": solver,
    }


def _cut(
    segments: list[Plain], lengths: list[float], length: float, shortest: float
) -> list[Plain]:
    """The segments of the last `length` m, base first; a first piece below `shortest` m is given to the segment after it."""
    kept: list[Plain] = []
    left = length
    for segment, own in zip(reversed(segments), reversed(lengths), strict=True):
        piece = min(own, left)
        if kept and piece < shortest:
            kept[-1]["length"] += piece
        else:
            kept.append({**segment, "length": piece})
        left -= piece
        if left <= 1e-12 * length:
            break
    return kept[::-1]


def save(scene: Any, path: Path) -> Path:
    """Write a Scene with units, and its reference as a table beside it. Returns the path.

    Both are read back first. Raises InputError, and writes nothing, where it would be another one, as one with tables that files name.
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
        trial.write_text(
            yaml.safe_dump(
                content, sort_keys=False, default_flow_style=None, width=140, allow_unicode=True
            ),
            encoding="utf-8",
        )
        if reference is not None:
            write_centreline(trial.with_name(content["reference"]["centreline"]), reference)
        try:
            same = validate(type(scene), read_yaml(trial)) == scene
        except InputError:
            same = False
        if not same:
            rule = (
                "tables and meshes that were read from files can't be written into a scene's file,"
                " which names them by their paths"
            )
            raise InputError(
                f"{path}: can't be written",
                received=scene.name,
                rule=rule,
                remedy="change a copy of the file that the scene was loaded from",
            )
        for file in Path(folder).iterdir():
            file.replace(path.with_name(file.name))
    return path
