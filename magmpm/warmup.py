"""Kernels ready before the clock starts: compiled once, in a process of their own, and then loaded from the disk cache.

Why another process: code that was compiled in this one and the same code loaded from the cache can differ in the last bit, because
functions that several kernels use are then linked from other places. A study that compiled its kernels and one that is resumed
would not be the same bit for bit. So everyone loads.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import llvmlite.binding
import numba
import numpy as np
from numpy.typing import NDArray

from magmpm import effects
from magmpm.environment import PACKAGE
from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.scene import Scene
from magmpm.statics.equilibrium import solve_static

_ready: set[str] = set()


def prepare_kernels(scene: Scene) -> float:
    """Seconds it takes to compile, or load, the kernels for this scene's combination of effects; 0 once done in this process."""
    small = _small(scene)
    dynamic = scene.solver.dynamic
    about = [scene.solver.static.anti_locking, scene.body.kind, dynamic is not None and _formulation(scene)]
    kinds = json.dumps([*about, *(str(record.dtype.names) for record in effects.collect(scene, times=_times(scene))[::2])])
    if kinds in _ready:
        return 0.0
    begun = time.perf_counter()
    marker = Path(os.environ["NUMBA_CACHE_DIR"]) / f"ready-{_stamp(kinds)}"
    if not marker.exists() and _compiled_elsewhere(small):
        with contextlib.suppress(OSError):  # a cache that can't be marked is only filled again
            marker.touch()
    solve_small(small)
    _ready.add(kinds)
    return time.perf_counter() - begun


def _stamp(kinds: str) -> str:
    """Names a set of kernels as Numba's disk cache tells them apart: two of these are the same only if none needs compiling again.

    Place and times of the sources are among them: another clone of the same sources has to compile them again.
    """
    host = [llvmlite.binding.get_host_cpu_name(), str(llvmlite.binding.get_host_cpu_features())]
    times = [str(path.stat().st_mtime_ns) for path in sorted(PACKAGE.rglob("*.py"))]
    known = [kinds, str(PACKAGE), sys.version, numba.__version__, llvmlite.__version__, *host, *times]
    return hashlib.sha256(json.dumps(known).encode()).hexdigest()[:16]


def _formulation(scene: Scene) -> str:
    from magmpm.dynamics.run import formulation  # only for motion: statics needs none of it in memory

    return formulation(scene)


def _times(scene: Scene) -> NDArray[np.float64] | None:
    """Times of which effects are asked: as a motion asks, or as statics does."""
    return None if scene.solver.dynamic is None else np.zeros(1)


def _small(scene: Scene) -> Scene:
    """The scene on the coarsest grid."""
    data = {**scene.to_si(), "name": "compilation", "reference": None}
    if data["body"]["parts"] is not None:
        data["body"]["parts"]["spacing"] = None
    if scene.solver.dynamic is not None:
        short = {"duration": 1e-9, "output_every": None, "time_step": None, "max_memory": None}
        data["solver"]["dynamic"] = {**data["solver"]["dynamic"], **short}
    return Scene.from_si({**data, "resolution": {**data["resolution"], "cells_across": 2, "particles_per_cell": 2}})


def solve_small(small: Scene) -> None:
    """Solve the coarse twin: it calls every kernel; its answer is not used, and may well not exist."""
    with contextlib.suppress(SolveError):
        if small.solver.dynamic is not None:
            from magmpm.dynamics.run import move

            move(build(small))
        else:
            solve_static(build(small))


def _compiled_elsewhere(small: Scene) -> bool:
    """Fill the disk cache from a process of its own; False where that can't be had (the kernels are then compiled here)."""
    code = (
        "import json, sys; from magmpm.scene import Scene; from magmpm.warmup import solve_small; "
        "solve_small(Scene.from_si(json.load(sys.stdin)))"
    )
    path = os.pathsep.join([str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=json.dumps(small.to_si()), text=True, capture_output=True, env={**os.environ, "PYTHONPATH": path}, check=False,
    )  # fmt: skip
    return done.returncode == 0
