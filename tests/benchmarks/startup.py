"""`make bench-startup`: seconds until `magmpm --help` answers, and until each command could begin its work.

    python tests/benchmarks/startup.py

A command is given a file that is not there, or nothing to do: it has then imported what it needs and says so. Least of REPEATS runs, in
seconds of wall clock and of processor time; other work on the machine adds to the first, and some to the second.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
REPEATS = 5
COMMANDS = {  # what makes each begin, and the most it may take, s
    "--help": ([], 0.3),
    "run": (["no.yaml"], 1.0),
    "design": (["no.yaml"], 1.0),
    "accuracy": (["no.yaml"], 1.0),
    "effects": (["no.yaml"], 1.0),
    "render": (["no"], 1.0),
    "dashboard": (["no"], 1.0),
    "view": (["no.yaml"], 1.0),
    "report": (["no"], 1.0),
    "fit": (["no.csv", "no.yaml"], 1.0),
    "doctor": (["--help"], 1.0),
    "import": (["no.yaml", "-o", "no-scene.yaml"], 1.0),
    "prepare": (["no.yaml"], 1.0),
    "stability": (["--case", "no such case"], 1.0),
}


def begun(arguments: list[str], folder: str) -> tuple[float, float]:
    """Least seconds of wall clock and of processor time of a command."""
    best = (float("inf"), float("inf"))
    for _ in range(REPEATS):
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        subprocess.run([sys.executable, "-m", "magmpm.cli", *arguments], capture_output=True, check=False, cwd=folder)
        wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        best = min(best[0], wall), min(best[1], used)
    return best


def main() -> int:
    """Print the table, and write runs/bench/startup.json."""
    rows = []
    print(f"{'command':<12}{'wall (s)':>10}{'processor (s)':>15}{'bound (s)':>11}")
    with tempfile.TemporaryDirectory() as folder:
        for name, (arguments, bound) in COMMANDS.items():
            wall, used = begun([name, *arguments], folder)
            rows.append({"command": name, "wall_s": wall, "processor_s": used, "bound_s": bound})
            print(f"{name:<12}{wall:>10.2f}{used:>15.2f}{bound:>11.1f}", flush=True)
    out = ROOT / "runs/bench/startup.json"
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
