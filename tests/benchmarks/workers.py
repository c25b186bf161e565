"""Trials a second with one and with two workers: `make bench-workers`.

Each number of workers runs data/studies/s_shape.yaml past its `stop`, without and with pictures, on a warm cache; the time counts from the
end of trial WARM to the last, so that starts of processes do not. One worker is the default: this process solves, with all threads.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from pathlib import Path

import optuna

from magmpm.cli.design import TrialPicture
from magmpm.precompile import fill_cache
from magmpm.simulate import run, sensitivities
from studies.definition import load_study
from studies.engine import kernel_uses, run_study
from viz.worker import Renderer

ROOT = Path(__file__).parents[2]
TRIALS, WARM = 60, 10


def rate(workers: int | None, pictures: bool) -> float:
    """Trials a second."""
    study = load_study(ROOT / "data/studies/s_shape.yaml")
    fill_cache(study.scene, uses=kernel_uses(study))
    with tempfile.TemporaryDirectory() as folder, Renderer() as renderer:
        picture = TrialPicture(study, False, renderer) if pictures else None
        run_study(study, solve=run, differentiate=sensitivities, picture=picture, out=folder, trials=TRIALS, workers=workers)
        kept = optuna.load_study(study_name=study.name, storage=f"sqlite:///{folder}/study.db")
        ends = sorted(trial.datetime_complete for trial in kept.trials if trial.datetime_complete is not None)
        return (len(ends) - WARM) / (ends[-1] - ends[WARM - 1]).total_seconds()


def main() -> int:
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    found = {}
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before")
    for pictures in (False, True):
        one, two = rate(None, pictures), rate(2, pictures)
        found["with pictures" if pictures else "without pictures"] = {"one": one, "two": two, "ratio": two / one}
        what = "with pictures" if pictures else "without pictures"
        print(f"{what}: one {one:.2f}, two {two:.2f} trials a second; {two / one:.2f} times", flush=True)
    Path("runs/bench").mkdir(parents=True, exist_ok=True)
    Path("runs/bench/workers.json").write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
