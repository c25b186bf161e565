"""`make bench-startup`: seconds until `magmpm --help` answers, and until each command could begin its work.

    python tests/benchmarks/startup.py

A command is given a file that is not there, or nothing to do: it has then imported what reading its file needs, and says so. Rows "with
its file" go further: the file is there, and a mistake in what was typed, looked for after it was read, ends the command. It has then also
imported what solves. Least of REPEATS runs, in seconds of wall clock and of processor time; other work on the machine adds to the first,
and some to the second. Python keeps the bytecode of what it imports, as it does for users; the last column is the wall clock where it does
not (PYTHONDONTWRITEBYTECODE), and compiles all sources again with every command.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import machine

ROOT = machine.ROOT
STUDY = str(ROOT / "data/studies/s_shape.yaml")
SCENE = str(ROOT / "data/scenes/axial_transverse.yaml")
REPEATS = 5
BOUND = 1.0  # s, for all but --help
NOTHING = {  # what makes each command begin, with a file that is not there
    "--help": [],
    **{
        key: ["no.yaml"]
        for key in ("run", "design", "accuracy", "effects", "view", "map", "prepare")
    },
    **{key: ["no"] for key in ("render", "dashboard", "report")},
    "fit": ["no.csv", "no.yaml"],
    "doctor": ["--help"],
    "import": ["no.yaml", "-o", "no-scene.yaml"],
    "stability": ["--case", "no such case"],
}
READ = {  # with a file that is there
    "design": [STUDY, "--workers", "0", "--out", "no"],
    "accuracy": [SCENE, "--cells", "many", "--out", "no"],
    "map": [SCENE, "--plane", "xx", "--out", "no"],
    "fit": ["tips.csv", SCENE, "--vary", "nothing", "--out", "no"],
}


def begun(arguments: list[str], folder: str, env: Mapping[str, str]) -> tuple[float, float]:
    """Least seconds of wall clock and of processor time of a command."""
    best = (float("inf"), float("inf"))
    for _ in range(REPEATS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "magmpm.cli", *arguments],
            capture_output=True,
            check=False,
            cwd=folder,
            env=env,
        )
        wall = time.perf_counter() - start
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        best = min(best[0], wall), min(best[1], used)
    return best


def main() -> int:
    """Print the table, and write runs/bench/startup.json."""
    rows = []
    print(
        f"{'command':<24}{'wall (s)':>10}{'processor (s)':>15}{'bound (s)':>11}{'no bytecode (s)':>17}"
    )
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "tips.csv").write_text(
            "field_z_mT,tip_x_mm,tip_z_mm\n5,20,5\n", encoding="utf-8"
        )
        kept = {**os.environ, "PYTHONPYCACHEPREFIX": str(Path(folder, "bytecode"))}
        kept.pop("PYTHONDONTWRITEBYTECODE", None)
        bare = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
        asked = [(name, [name, *rest]) for name, rest in NOTHING.items()]
        asked += [(f"{name}, with its file", [name, *rest]) for name, rest in READ.items()]
        for name, arguments in asked:
            wall, used = begun(arguments, folder, kept)
            without = begun(arguments, folder, bare)[0]
            bound = 0.3 if name == "--help" else BOUND
            rows.append(
                {
                    "command": name,
                    "wall_s": wall,
                    "processor_s": used,
                    "bound_s": bound,
                    "no_bytecode_s": without,
                }
            )
            print(f"{name:<24}{wall:>10.2f}{used:>15.2f}{bound:>11.1f}{without:>17.2f}", flush=True)
    machine.save("startup", rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
