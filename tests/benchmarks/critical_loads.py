"""Equilibria along time for `make bench`: critical loads against theory, and what a step costs."""

from __future__ import annotations

import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests"))

STEPS = 40


def _errors_percent(data: dict, field: float, times: list[float]) -> float:
    """Error (%) of the load at which a scene's straight branch ends, in a field that grows from zero to `field` (T) along x."""
    from reference.buckling import column

    from magmpm.scene import Scene
    from magmpm.simulate import run

    data["field"] = {"uniform": [field, 0.0, 0.0], "over_time": {"ramp": {"duration": 1.0}}}
    data["solver"] = {"quasi_static": {"at": times}}
    scene = Scene.from_si(data)
    found, theory = run(scene).jumps[0], column(scene).critical_field
    return 100 * abs(found["field"] / theory - 1)


def critical_loads() -> dict[str, float]:
    """Critical loads of Zhao's beam in plane strain, and of a catheter of twenty diameters magnetized against the field."""
    from magmpm.scene import load_scene

    beam = load_scene(ROOT / "data/scenes/zhao_plane_strain.yaml").to_si()
    catheter = load_scene(ROOT / "data/scenes/buckling_catheter.yaml").to_si()
    return {
        "Zhao's beam": _errors_percent(beam, -15e-3, [0.0, 0.2, 0.3, 0.35]),
        "antiparallel catheter": _errors_percent(catheter, 4e-3, [0.0, 0.2, 0.3, 0.32]),
    }


def step_seconds() -> float:
    """Time of a step on five_segments.yaml, whose field grows to its strength in 40 steps: the whole run over them, no files."""
    from magmpm.dynamics.quasi_static import follow
    from magmpm.scene import Scene, load_scene
    from magmpm.solving.precompile import prepare_kernels

    data = load_scene(ROOT / "data/scenes/five_segments.yaml").to_si()
    data["field"]["over_time"] = {"ramp": {"duration": 1.0}}
    data["solver"] = {"quasi_static": {"steps": STEPS}}
    scene = Scene.from_si(data)
    prepare_kernels(scene)
    begun = time.perf_counter()
    follow(scene)
    return (time.perf_counter() - begun) / STEPS
