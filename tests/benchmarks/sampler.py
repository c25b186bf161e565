"""`make bench-sampler`: number of trials to reach 2 mm on both targets, for seeds 1 to 5.

    python tests/benchmarks/sampler.py [SAMPLER] [SEEDS]

SAMPLER+rod begins with the rod's designs (`start: rod`).
Every trial is a full solve at the resolution of the study, without pictures; each study starts in a new folder.
"""

import sys
import tempfile
from dataclasses import replace
from typing import Any

import machine

from magmpm.simulate import run, sensitivities
from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study

STUDIES = ("c_shape", "s_shape")


def rows_of(sampler: str, name: str, seeds: int) -> list[dict[str, Any]]:
    """The trials (from 1) that first come within 2 mm of a study's target, and the best of at most 35; printed as they come."""
    rows = []
    study = load_study(machine.ROOT / f"data/studies/{name}.yaml")
    chosen, _, start = sampler.partition("+")
    for seed in range(1, seeds + 1):
        with tempfile.TemporaryDirectory() as folder:
            asked = replace(study, seed=seed, start=start or None, stop_rms=2e-3)
            report = run_study(
                asked, solve=run, differentiate=sensitivities, out=folder, sampler=chosen
            )
        first = report.first_trial_below_stop
        best = None if report.best is None else 1e3 * report.best["rms_m"]
        rows.append(
            {
                "study": name,
                "seed": seed,
                "reached_in": None if first is None else first + 1,
                "best_mm": best,
            }
        )
        reached = "not within 35" if first is None else f"trial {first + 1}"
        print(f"{name:<10} seed {seed}: {reached:<14} best {best:.2f} mm", flush=True)
    return rows


def main(sampler: str = "tpe", seeds: str = "5") -> int:
    """Print the table, and write runs/bench/sampler_NAME.json."""
    rows = []
    print(f"{sampler}: trial (from 1) that first comes within 2 mm rms; best of at most 35 trials")
    for name in STUDIES:
        rows += (own := rows_of(sampler, name, int(seeds)))
        print(f"{name:<10} {sum(row['reached_in'] is not None for row in own)} of {seeds}")
    machine.save(f"sampler_{sampler}", rows)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
