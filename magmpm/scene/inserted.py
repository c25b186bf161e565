"""The part of a catheter that a guide has let out: what `Scene.inserted` returns.

The catheter is straight and held inside the guide. So what has left the guide is a shorter catheter, clamped at the guide's exit, and each
depth of an insertion is an ordinary scene of statics. Its grid begins exactly at the exit, and its cells are counted from the tip.
"""

from __future__ import annotations

import math
from typing import Any

from magmpm.bodies.segments import SHORTEST
from magmpm.effects.acting import NO_LOADS
from magmpm.effects.base import SceneLike
from magmpm.errors import InputError, report

LEAST = 1.0  # diameters: the shortest length a catheter may have (segments.StraightBody), where no rod is left to speak of


def inserted_data(scene: SceneLike, data: dict[str, Any], length: float) -> dict[str, Any]:
    """SI data of the scene (as `to_si` gives it) made into those of its last `length` m: see Scene.inserted. Raises InputError."""
    catheter = scene.body.catheter
    if catheter is None:
        raise _refused(f"body.{scene.body.kind}", "only a catheter leaves a guide bit by bit", "use a catheter")
    if scene.effects.feed is not None and scene.field.varies:
        rule = "the exit of the guide becomes the origin, and magnets, coils, dipoles and maps do not move with it"
        raise _refused("effects.feed", rule, "give their places from the exit on, and do not name feed")
    if scene.solver.dynamic is None and (met := [key for key in ("ground", "walls") if getattr(scene.effects, key) is not None]):
        rule, remedy = "an inserted length is solved without obstacles", "follow the insertion: name feed, with solver.quasi_static"
        raise _refused(f"effects.{met[0]}", rule, remedy)
    least, most = LEAST * catheter.diameter, catheter.length
    length = float(length)
    if not least * (1 - 1e-9) <= length <= most * (1 + 1e-9):
        rule = f"between one diameter and the whole length of the catheter can be outside the guide, {1e3 * least:g} to {1e3 * most:g} mm"
        raise _refused("inserted length", rule, "a shorter piece is no rod: begin there", f"{1e3 * length:g} mm")
    length = min(max(length, least), most)
    kept = _cut(data["body"]["catheter"]["segments"], catheter.segment_lengths(), length, SHORTEST * catheter.diameter)
    catheter_data = {**data["body"]["catheter"], "length": math.fsum(s["length"] for s in kept), "segments": kept, "clamp": "base"}
    effects = {key: value for key, value in data["effects"].items() if key not in (*NO_LOADS, "feed")}
    solver = {key: value for key, value in data["solver"].items() if key in ("anti_locking", "static")}
    return {
        **{key: value for key, value in data.items() if key != "reference"},
        "body": {"catheter": catheter_data},
        "resolution": {**data["resolution"], "from_tip": True},
        "effects": effects,
        "solver": solver,
    }


def _cut(segments: list[dict[str, Any]], lengths: list[float], length: float, shortest: float) -> list[dict[str, Any]]:
    """The segments of the last `length` m, base first; a first piece below `shortest` m is given to the segment after it."""
    kept: list[dict[str, Any]] = []
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


def _refused(place: str, rule: str, remedy: str, received: str | None = None) -> InputError:
    return InputError(report(place, received=received, rule=rule, remedy=remedy))
