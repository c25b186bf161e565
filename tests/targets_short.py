"""`make targets-short`: every target of the Makefile in its shortest form; a row each, and exit status 1 where one fails.

python tests/targets_short.py [TARGET ...]. Programs that are not here are named: such a target is "not run", which is no failure. What each
target says goes to runs/targets/TARGET.log.
"""

import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SECONDS = 1800.0  # that a target may take
SHORT = {  # what `make TARGET` is given
    "help": "",
    "setup": "",
    "schema": "",
    "lint": "",
    "lint-benchmarks": "",
    "design": "",
    "docs": "",
    "test-docs": "",
    "test-wheel": "",
    "test-workers": "",
    "test-browser": "",
    "test-gp": "",
    "test-minimum": "",
    "validate": "",
    "bench-startup": "",
    "bench-view": "",
    "release": "",
    "bench": "QUICK=1",
    "bench-robust": "SAMPLES=2",
    "bench-sampler": "SAMPLER=gauss-newton SEEDS=1",
    "bench-fit": "FITS=2",
    "bench-design": "QUICK=1 SAMPLERS=gauss-newton",
    "bench-bounds": "TARGETS=1",
    "bench-insertion": "QUICK=1 EACH=1",
    "bench-advice": "SCENES='0 1'",
    "measured": "CASES=zhao",
    "bench-accuracy": "SCENES=1",
    "bench-convergence": "SCENES=1",
    "claims": "QUICK=1 CLAIMS=asked",
    "bench-robots": "ROBOTS=1 QUICK=1",
    "gallery": "SCENES=folding_strip",
    "examples": "EXAMPLES=first_shape",
    "stability": "QUICK=1",
    "faults": "KILLS=3",
    "fuzz": "INPUTS=100",
    "fuzz-coverage": "RUNS=200",
    "bench-workers": "TRIALS=30",
    "bench-sweep": "RUNS=4",
    "tour": "PAGES=first_scene.md",
    "optunahub": "",
    "bench-least-squares": "SEEDS=1 SAMPLERS=gauss-newton",
}
ELSEWHERE = {
    "test": "its tests are among those of test-long",
    "test-long": "pytest itself, run beside this",
    "pytest": "what test and test-long run",
    "clean": "removes the environment that this runs in",
    "targets-short": "this",
}
NEEDS = {
    "test-browser": "chromium",
    "bench-view": "chromium",
    "test-workers": "initdb",
    "test-gp": "torch",
}
FROM = {
    "chromium": "apt-get install chromium",
    "initdb": "apt-get install postgresql",
    "torch": "2 GB: make test-gp",
}


def targets() -> set[str]:
    """Targets that the Makefile declares phony: all that a user may ask for."""
    lines = re.findall(
        r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    return {name for line in lines for name in line.split()}


def lacks(need: str | None) -> bool:
    """Return True if a program or library that a target needs is not here."""
    if need == "torch":
        return not (ROOT / ".venv-gp/.ready").exists()
    if need == "initdb":
        return shutil.which(need) is None and not list(
            Path("/usr/lib/postgresql").glob("*/bin/initdb")
        )
    return need == "chromium" and not any(
        map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))
    )


def run(name: str, logs: Path) -> str:
    """Outcome of a target in its short form."""
    if lacks(need := NEEDS.get(name)):
        return f"not run: needs {need} ({FROM[str(need)]})"
    with (logs / f"{name}.log").open("w") as log:
        try:
            done = subprocess.run(
                f"make {name} {SHORT[name]}",
                shell=True,
                cwd=ROOT,
                stdout=log,
                stderr=log,
                timeout=SECONDS,
            )
        except subprocess.TimeoutExpired:
            return f"FAILED: not done after {SECONDS:g} s"
    return "done" if done.returncode == 0 else f"FAILED: status {done.returncode}, see {log.name}"


def main(names: list[str]) -> int:
    """Run the named targets, or all. Returns the exit status."""
    (logs := ROOT / "runs/targets").mkdir(parents=True, exist_ok=True)
    failed = 0
    for name in names or SHORT:
        begun = time.monotonic()
        outcome = run(name, logs)
        failed += outcome.startswith("FAILED")
        print(
            f"{name:<20}{SHORT[name]:<32}{time.monotonic() - begun:6.0f} s  {outcome}", flush=True
        )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
