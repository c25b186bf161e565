"""Cost of a requested error, and how well a requested time is kept: five-segment catheter, its field switched on, and its motion."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from magmpm import Result, Scene, load_scene, run

SCENE = Path(__file__).resolve().parents[2] / "data/scenes/five_segments.yaml"
ERRORS = (0.01, 0.001, 0.0002)  # of the length
SECONDS = (0.5, 1.0, 2.0, 5.0)  # s
REPEATS = 5


def asked(**resolution: object) -> Scene:
    """The five-segment scene with this resolution."""
    return Scene.from_si({**load_scene(SCENE).to_si(), "resolution": resolution})


def timed(scene: Scene, repeats: int = REPEATS) -> tuple[Result, float]:
    """The result and the median seconds of warm runs, without compiling."""
    times = []
    result = run(scene)
    for _ in range(repeats):
        begun = perf_counter()
        result = run(scene)
        times.append(perf_counter() - begun)
    return result, median(times)


def error_seconds() -> dict[str, float]:
    """Seconds in all, proof included, for each asked error."""
    return {f"{100 * error:g} %": timed(asked(error=error))[1] for error in ERRORS}


def estimate_percent() -> dict[str, float]:
    """Time of the error's proof over that of the plain solve on the chosen cells."""
    found = {}
    for error in ERRORS:
        result, seconds = timed(asked(error=error))
        assert result.resolution is not None
        plain = timed(asked(cells_across=result.resolution["cells_across"]))[1]
        found[f"{100 * error:g} %"] = 100.0 * (seconds - plain) / plain
    return found


def kept_seconds() -> dict[str, float]:
    """Seconds taken over seconds asked for: at rest, along a ramp, and in motion until it settles."""
    data: dict[str, Any] = load_scene(SCENE).to_si()
    ramp = {**data["field"], "over_time": {"ramp": {"duration": 1.0}}}
    damped = {**data["effects"], "damping": {"rate": 60.0}}
    kinds: dict[str, Callable[[float], Scene]] = {
        "rest": lambda limit: asked(seconds=limit),
        "ramp": lambda limit: Scene.from_si(
            {**data, "field": ramp, "solver": {"quasi_static": {"steps": 5}}, "resolution": {"seconds": 2 * limit}}
        ),
        "motion": lambda limit: Scene.from_si(
            {**data, "effects": damped, "solver": {"dynamic": {"duration": 0.3}}, "resolution": {"seconds": 4 * limit}}
        ),
    }
    found = {}
    for kind, scene_of in kinds.items():
        for limit in SECONDS:
            scene = scene_of(limit)
            _, seconds = timed(scene, 1)
            found[f"{kind}, {scene.resolution.seconds:g} s"] = seconds / (scene.resolution.seconds or 1.0)
    return found
