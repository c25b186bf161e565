"""`make bench-sweep`: seconds of a sweep of equilibria by two processes, over those of as many runs one after another."""

from __future__ import annotations

import json
import math
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

SCENE = Path(__file__).parents[2] / "data/scenes/five_segments.yaml"
ONE = """
import sys, magmpm
from magmpm.scene.addresses import changed
scene = magmpm.load_scene(sys.argv[1])
for k in range(1, 1 + int(sys.argv[2])):
    tip = magmpm.run(changed(scene, {("field", "uniform", 2): 4e-5 * k}), progress=False).tip
print(tip.tolist())
"""
TWO = """
import sys, magmpm
values = [4e-5 * k for k in range(1, 1 + int(sys.argv[2]))]
table = magmpm.sweep(sys.argv[1], {"field.uniform[2]": values}, workers=2)
print([table.rows[-1][f"tip_{x}_m"] for x in "xyz"])
"""


def seconds(code: str, **more: str) -> tuple[float, float, str]:
    """Of a script in a fresh process, those of the processor (with its processes), and what it printed. more: environment variables."""
    began = time.perf_counter()
    before = processor()
    done = subprocess.run(
        env={**os.environ, **more},
        args=[sys.executable, "-c", code, str(SCENE), *sys.argv[1:]],
        capture_output=True,
        text=True,
        check=True,
    )
    return time.perf_counter() - began, processor() - before, done.stdout.strip()


def processor() -> float:
    """Seconds of processor time of all processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Print each time, its ratios and the last tip: one after another on all threads, and on one.

    Where others use the machine too, processor times are nearer to what it would take alone: half of a sweep's, and those on one thread.
    """
    alone = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    found = [(seconds(ONE), seconds(ONE, **alone), seconds(TWO)) for _ in range(3)]
    times = [[round(one[0], 2) for one in row] for row in found]
    ratios = {
        name: sorted(row[2] / row[k] for row in times)[1]
        for k, name in enumerate(("over all threads", "over one thread"))
    }
    rounded = {name: round(ratio, 3) for name, ratio in ratios.items()}
    used = [[round(one[1], 2) for one in row] for row in found]
    tips = [json.loads(one[2]) for row in found for one in row]
    apart = max(math.dist(tip, tips[0]) for tip in tips)
    assert apart < 1e-6 * 40e-3, apart  # m: rows begin from their neighbors, runs from their rods
    print(json.dumps({"seconds": times, "processor": used, **rounded, "apart_m": apart}))


if __name__ == "__main__":
    main()
