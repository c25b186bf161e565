"""`make bench-sweep`: seconds of a sweep of equilibria (200 unless given), by two processes over one after another, each in a process of its own."""

from __future__ import annotations

import json
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
values = [f"{0.04 * k} mT" for k in range(1, 1 + int(sys.argv[2]))]
table = magmpm.sweep(sys.argv[1], {"field.uniform[2]": values}, workers=2)
print([table.rows[-1][f"tip_{x}_m"] for x in "xyz"])
"""


def seconds(code: str) -> tuple[float, str]:
    """Of a script in a fresh process, and what it printed."""
    began = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code, str(SCENE), *sys.argv[1:]],
        capture_output=True,
        text=True,
        check=True,
    )
    return time.perf_counter() - began, done.stdout.strip()


def main() -> None:
    """Print each time, its ratio and both last tips."""
    found = [(seconds(ONE), seconds(TWO)) for _ in range(3)]
    ratios = sorted(two[0] / one[0] for one, two in found)
    print(
        json.dumps(
            {
                "serial_s": [round(one[0], 2) for one, _ in found],
                "two_workers_s": [round(two[0], 2) for _, two in found],
                "ratio": round(ratios[1], 3),
                "tips": [found[0][0][1], found[0][1][1]],
            }
        )
    )


if __name__ == "__main__":
    main()
