"""Sensitivities and stability for `make bench`: what they cost beside the solve, and how exact the derivatives are."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests/unit/statics")]

SCENE = ROOT / "data/scenes/five_segments.yaml"
KINDS = ["magnetization", "field", "remanence", "shear_modulus", "density"]  # 16 variables of this scene
REPEATS = 15
NOTHING = 1e-15  # m per unit: a derivative below it is rounding


def _seconds(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def jacobian_over_solve_percent() -> float:
    """Derivatives of axis and tip by 16 variables, over the run that they follow; medians of both taken in turn."""
    from magmpm import run, sensitivities
    from magmpm.scene import load_scene

    scene = load_scene(SCENE)

    def derivatives() -> None:
        found = sensitivities(scene, KINDS)
        found.tip, found.centreline  # noqa: B018  (made when they are read)

    derivatives()
    times = np.array([[_seconds(lambda: run(scene)), _seconds(derivatives)] for _ in range(REPEATS)])
    solve, both = np.median(times, axis=0)
    return float(100 * (both / solve - 1))


def stability_over_solve_percent() -> float:
    """The smallest eigenvalue over the solve without it; the unloaded body's is kept from the solve before, as in a study."""
    from magmpm.model import build
    from magmpm.scene import load_scene
    from magmpm.solving.precompile import prepare_kernels
    from magmpm.statics.equilibrium import one_blas_thread, solve_static
    from magmpm.statics.layout import static_model
    from magmpm.statics.stability import stability

    scene = load_scene(SCENE)
    prepare_kernels(scene)
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        found = solve_static(static_model(build(scene)))
        whole = time.perf_counter() - begun
        assert found.energy is not None
        begun = time.perf_counter()
        with one_blas_thread():
            stability(found.energy, found.point)
        alone = time.perf_counter() - begun
        times.append([alone, whole - alone])
    alone, rest = np.median(times, axis=0)
    return float(100 * alone / rest)


def derivative_error() -> dict[str, float]:
    """Largest difference to extrapolated central differences of refined solves, over a variable's largest entry, by scene and kind.

    The scenes of the tests, solved to the tolerance that users have unless they name one.
    """
    from reference.differences import differences
    from test_sensitivities import CASES, scene_of

    from magmpm import sensitivities
    from magmpm.scene import Scene

    worst: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in CASES:
            data = scene_of(name, Path(folder)).to_si()
            data["solver"] = {"static": {}}
            scene = Scene.from_si(data)
            found = sensitivities(scene)
            for k, variable in enumerate(found.variables):
                rows, tip = differences(scene, variable)
                made = found.centreline[..., k] if len(rows) else found.tip[:, k]
                expected = rows if len(rows) else tip
                size = np.abs(expected).max()
                if size > NOTHING:
                    worst[name] = max(worst.get(name, 0.0), float(np.abs(made - expected).max() / size))
    return worst
