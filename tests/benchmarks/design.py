"""`make bench-design`: solves and seconds that each sampler needs to 2, 0.5 and 0.1 mm, on 24 targets that were fixed beforehand.

    python tests/benchmarks/design.py [--quick] [SAMPLER ...]        # tpe, gp, cmaes and gauss-newton unless named

The targets are in data/targets/bench (its SOURCES.md says what they are): twelve reachable ones, which finite elements made, and twelve
free splines. Each study varies the five directions of data/scenes/five_segments.yaml, from seed 1, without pictures, until 0.1 mm or
35 trials (gauss-newton 20). Solves are counted from 1. Seconds are those of the trials so far by the storage's clock: asking, solving,
storing. The best design of each study is solved again at 6 cells across. A sampler with `+rod` begins with the rod's designs.

--quick: three targets of each kind and 10 trials. Finished studies are kept in runs/bench/design, by a hash of all that decides them and of
the sources, so the command can be interrupted and continued. Writes runs/bench/design.json.
"""

import argparse
import hashlib
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import machine
import numpy as np

from magmpm.inputs.csv_tables import read_centreline
from magmpm.results.whole_file import write_json
from magmpm.simulate import run, sensitivities
from magmpm.studies.engine.loop import run_study
from magmpm.studies.problem.shape_distance import gaps, root_mean_square
from magmpm.studies.search.definition import Study, load_study
from magmpm.studies.search.search_space import SearchSpace

ROOT = machine.ROOT
TARGETS = ROOT / "data/targets/bench"
OUT = ROOT / "runs/bench"
SAMPLERS = ("tpe", "gp", "cmaes", "gauss-newton")
GOALS = (2.0, 0.5, 0.1)  # mm
MOST = {"gauss-newton": 20}
TRIALS = 35
QUICK_TRIALS = 10
QUICK_TARGETS = 3
FINER = 6  # cells across, at which the best design is judged again


def sources() -> str:
    """A hash of the code that decides a study."""
    found = hashlib.sha256()
    for path in sorted([*(ROOT / "studies").rglob("*.py"), *(ROOT / "magmpm").rglob("*.py")]):
        found.update(path.read_bytes())
    return found.hexdigest()


def study_of(target: Path, sampler: str, trials: int) -> Study:
    """The study of one target by one sampler, which may end in +rod."""
    base = load_study(ROOT / "data/studies/s_shape.yaml")
    name, _, start = sampler.partition("+")
    shape = {"name": target.stem, "target": read_centreline(target), "stop_rms": GOALS[-1] * 1e-3}
    return replace(base.changed(sampler=name), **shape, start=start or None, trials=trials, seed=1)


def solved(study: Study) -> dict[str, Any]:
    """Results of a study: rms (mm) and seconds of every trial from its beginning, and the best design's rms at FINER cells, mm."""
    import optuna

    with tempfile.TemporaryDirectory() as folder:
        report = run_study(study, solve=run, differentiate=sensitivities, out=folder)
        kept = optuna.load_study(
            study_name=study.name, storage=f"sqlite:///{folder}/study.db"
        ).get_trials(deepcopy=False)
        begun = min(t.datetime_start for t in kept if t.datetime_start is not None)
        seconds = [
            (t.datetime_complete - begun).total_seconds()
            for t in kept
            if t.datetime_complete is not None
        ]
    found: dict[str, Any] = {
        "rms_mm": [1e3 * rms for rms in report.rms_m],
        "seconds": seconds,
        "best_mm": None,
        "finer_mm": None,
    }
    if report.best is not None:
        scene = SearchSpace.of(study).scene_of(report.best["params"]).with_cells(FINER)
        found["best_mm"] = 1e3 * report.best["rms_m"]
        found["finer_mm"] = 1e3 * root_mean_square(gaps(run(scene).centreline, study.target))
    return found


def cached(study: Study, code: str) -> dict[str, Any]:
    """`solved`, or what is kept of the same study by the same code."""
    key = json.dumps([study.definition(), study.trials, code], sort_keys=True)
    path = (
        OUT
        / "design"
        / f"{study.name}_{study.sampler}_{hashlib.sha256(key.encode()).hexdigest()[:16]}.json"
    )
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, solved(study))
    return dict(json.loads(path.read_text()))


def reached(found: dict[str, Any], goal: float) -> tuple[float, float]:
    """Solves and seconds until a trial came within `goal` mm; infinity for both if none did."""
    first = next((k for k, rms in enumerate(found["rms_mm"]) if rms <= goal), None)
    return (float("inf"), float("inf")) if first is None else (first + 1.0, found["seconds"][first])


def summary(studies: list[dict[str, Any]]) -> dict[str, Any]:
    """For each goal the share reached, and median and 90th percentile of solves and seconds; infinite for studies that did not reach it."""
    rows: dict[str, Any] = {}
    for goal in GOALS:
        pairs = np.array([reached(found, goal) for found in studies])
        solves, seconds = (
            np.quantile(column, [0.5, 0.9], method="higher").tolist() for column in pairs.T
        )
        rows[f"{goal:g} mm"] = {
            "share": float(np.isfinite(pairs[:, 0]).mean()),
            "solves": [None if np.isinf(x) else x for x in solves],
            "seconds": [None if np.isinf(x) else round(x, 2) for x in seconds],
        }
    judged = [found for found in studies if found["finer_mm"] is not None]
    rows["best_mm"] = float(np.median([found["best_mm"] for found in judged])) if judged else None
    rows["finer_mm"] = float(np.median([found["finer_mm"] for found in judged])) if judged else None
    return rows


def table(results: dict[str, dict[str, Any]]) -> str:
    """The results as a table of Markdown."""
    head = (
        "| sampler | targets | "
        + " | ".join(f"solves to {g:g} mm | share | s" for g in GOALS)
        + " | best rms | at 6 cells |"
    )
    lines = [head, "| --- " * (head.count("|") - 1) + "|"]
    for name, kinds in results.items():
        for kind, rows in kinds.items():
            cells = []
            for goal in GOALS:
                row = rows[f"{goal:g} mm"]
                solves = ", ".join("-" if x is None else f"{x:g}" for x in row["solves"])
                seconds = "-" if row["seconds"][0] is None else f"{row['seconds'][0]:.1f}"
                cells += [solves, f"{100 * row['share']:.0f} %", seconds]
            ends = [
                "-" if rows[key] is None else f"{rows[key]:.2f} mm"
                for key in ("best_mm", "finer_mm")
            ]
            lines.append(f"| {name} | {kind} | " + " | ".join([*cells, *ends]) + " |")
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "samplers",
        nargs="*",
        default=[],
        metavar="SAMPLER",
        help=f"of {', '.join(SAMPLERS)}, each also with +rod",
    )
    parser.add_argument(
        "--quick", action="store_true", help="three targets of each kind, 10 trials"
    )
    options = parser.parse_args()
    code = sources()
    results = {}
    details = {}
    for name in options.samplers or SAMPLERS:
        trials = QUICK_TRIALS if options.quick else MOST.get(name.partition("+")[0], TRIALS)
        results[name] = {}
        for kind in ("reachable", "free"):
            files = sorted(TARGETS.glob(f"{kind}_*.csv"))[
                :: 12 // QUICK_TARGETS if options.quick else 1
            ]
            studies = []
            for file in files:
                studies.append(cached(study_of(file, name, trials), code))
                details[f"{name} {file.stem}"] = studies[-1]
                print(
                    f"{name:<14} {file.stem:<14} best"
                    f" {studies[-1]['best_mm'] or float('nan'):.3f} mm",
                    file=sys.stderr,
                    flush=True,
                )
            results[name][kind] = summary(studies)
    print("solves: median, 90th percentile; s: median seconds; - where fewer came that near")
    print(table(results))
    machine.save(
        "design",
        {
            "machine": machine.described(),
            "quick": options.quick,
            "results": results,
            "studies": details,
        },
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
