"""The machine of a measurement and its speed, to compare figures of two machines or of two times; timing, and files of figures.

Two rates limit all code here: matrix products, which dominate static solves, and memory copies.
"""

import json
import os
import platform
import statistics
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
SIDE = 1536  # size of the matrices: 7 Gflop per product
COPIED = 200_000_000  # bytes, far more than the size of any cache
REPEATS = 7


def described() -> dict[str, Any]:
    """Host, processor, threads, versions, commit, load, and the two rates."""
    import numba

    return {
        "host": platform.node(),
        "cpu": _cpu(),
        "cores": (
            len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
        ),
        "threads": numba.get_num_threads(),
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "numba": numba.__version__,
        },
        "commit": _commit(),
        "load": load(),
        "dgemm_flop_per_s": dgemm(),
        "copy_bytes_per_s": copy(),
    }


def load() -> float:
    """Number of processes that were ready to run during the last minute."""
    return round(os.getloadavg()[0], 2)


def dgemm() -> float:
    """Floating-point operations per second of a matrix product, all threads, double precision; median."""
    rng = np.random.default_rng(0)
    a = rng.standard_normal((SIDE, SIDE))
    b = rng.standard_normal((SIDE, SIDE))
    out = np.empty((SIDE, SIDE))
    return 2.0 * SIDE**3 / median_seconds(lambda: np.matmul(a, b, out=out))


def copy() -> float:
    """Bytes per second that one thread copies, each counted once; median."""
    source = np.ones(COPIED // 8)
    target = np.empty_like(source)
    return COPIED / median_seconds(lambda: np.copyto(target, source))


def seconds(work: Callable[[], object]) -> float:
    """Time of `work`."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def median_seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median time of `work`, after one run that is not counted."""
    work()
    return statistics.median(seconds(work) for _ in range(repeats))


def save(name: str, found: object) -> None:
    """Write runs/bench/NAME.json."""
    path = ROOT / f"runs/bench/{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")),
        platform.processor(),
    )


def _commit() -> str:
    """The commit that is checked out, with + if files differ from it."""

    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        return git("rev-parse", "--short", "HEAD") + (
            "+" if git("status", "--porcelain", "--untracked-files=no") else ""
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
