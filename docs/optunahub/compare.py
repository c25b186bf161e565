"""`make bench-least-squares`: the Gauss-Newton sampler against Optuna's on five public problems; the table of docs/optunahub/problems.md.

    python docs/optunahub/compare.py [SEEDS [SAMPLER ...]]     # gauss-newton tpe gp cmaes random; gp needs torch

Problems: More, Garbow and Hillstrom, ACM TOMS 7 (1981) 17 (MGH), numbers 1, 8, 13; NIST Statistical Reference Datasets, MGH09 (Kowalik
and Osborne) and Misra1a. Boxes are ours, and hold the least.
"""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import optuna

from magmpm.studies.search.samplers.gauss_newton import GaussNewtonSampler, Number

ROOT = Path(__file__).resolve().parents[2]
TRIALS = 100
NEAR = 1.01
ZERO = 1e-6
Array = Any
# fmt: off
BARD = np.array([0.14, 0.18, 0.22, 0.25, 0.29, 0.32, 0.35, 0.39, 0.37, 0.58, 0.73, 0.96, 1.34, 2.10, 4.39])
MGH09 = np.array([[0.1957, 4.0], [0.1947, 2.0], [0.1735, 1.0], [0.1600, 0.5], [0.0844, 0.25], [0.0627, 0.167], [0.0456, 0.125],
                  [0.0342, 0.1], [0.0323, 0.0833], [0.0235, 0.0714], [0.0246, 0.0625]]).T
MISRA = np.array([[10.07, 77.6], [14.73, 114.9], [17.94, 141.1], [23.93, 190.8], [29.61, 239.9], [35.18, 289.0], [40.02, 332.8],
                  [44.82, 378.4], [50.76, 434.8], [55.05, 477.3], [61.01, 536.8], [66.40, 593.1], [75.47, 689.1], [81.78, 760.0]]).T
# fmt: on


def rosenbrock(x: Array) -> tuple[Array, Array]:
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), np.array(
        [[-20 * x[0], 10.0], [-1.0, 0.0]]
    )


def powell(x: Array) -> tuple[Array, Array]:
    a = x[1] - 2 * x[2]
    b = x[0] - x[3]
    r5 = np.sqrt(5)
    r10 = np.sqrt(10)
    residuals = np.array([x[0] + 10 * x[1], r5 * (x[2] - x[3]), a**2, r10 * b**2])
    slopes = [
        [1, 10, 0, 0],
        [0, 0, r5, -r5],
        [0, 2 * a, -4 * a, 0],
        [2 * r10 * b, 0, 0, -2 * r10 * b],
    ]
    return residuals, np.array(slopes, dtype=float)


def bard(x: Array) -> tuple[Array, Array]:
    u = np.arange(1.0, 16.0)
    v = 16 - u
    w = np.minimum(u, 16 - u)
    below = v * x[1] + w * x[2]
    return BARD - x[0] - u / below, np.column_stack(
        [-np.ones(15), u * v / below**2, u * w / below**2]
    )


def mgh09(x: Array) -> tuple[Array, Array]:
    y, u = MGH09
    above = u**2 + u * x[1]
    below = u**2 + u * x[2] + x[3]
    slopes = np.column_stack(
        [above / below, x[0] * u / below, -x[0] * above * u / below**2, -x[0] * above / below**2]
    )
    return x[0] * above / below - y, slopes


def misra1a(x: Array) -> tuple[Array, Array]:
    y, t = MISRA
    left = np.exp(-x[1] * t)
    return x[0] * (1 - left) - y, np.column_stack([1 - left, x[0] * t * left])


PROBLEMS: dict[
    str, tuple[Callable[[Array], tuple[Array, Array]], list[tuple[float, float]], float]
] = {
    "Rosenbrock (MGH 1)": (rosenbrock, [(-5, 10)] * 2, 0.0),
    "Bard (MGH 8)": (bard, [(0, 1), (0.1, 5), (0.1, 5)], 8.21487e-3),
    "Powell, singular (MGH 13)": (powell, [(-5, 5)] * 4, 0.0),
    "Kowalik, Osborne (NIST MGH09)": (mgh09, [(0, 1)] * 4, 3.0750560385e-4),
    "Misra1a (NIST)": (misra1a, [(50, 500), (1e-5, 5e-3)], 1.2455138894e-1),
}


def sampler(name: str, numbers: list[Number], seed: int) -> optuna.samplers.BaseSampler:
    """A sampler with its defaults."""
    if name == "gauss-newton":
        return GaussNewtonSampler(numbers, seed)
    kinds = {
        "tpe": optuna.samplers.TPESampler,
        "gp": optuna.samplers.GPSampler,
        "cmaes": optuna.samplers.CmaEsSampler,
    }
    return kinds.get(name, optuna.samplers.RandomSampler)(seed=seed)


def path(name: str, problem: str, seed: int) -> Array:
    """The best sum of squares after each trial."""
    model, box, _ = PROBLEMS[problem]
    numbers = [Number(f"x{k}", float(low), float(high)) for k, (low, high) in enumerate(box)]
    width = np.array([high - low for low, high in box], dtype=float)

    def objective(trial: optuna.Trial) -> float:
        residuals, jacobian = model(
            np.array([trial.suggest_float(one.name, one.low, one.high) for one in numbers])
        )
        if name == "gauss-newton":
            trial.set_user_attr("residuals", residuals.tolist())
            trial.set_user_attr("jacobian", (jacobian * width).tolist())
        return float(np.linalg.norm(residuals))

    study = optuna.create_study(sampler=sampler(name, numbers, seed))
    study.optimize(objective, n_trials=TRIALS)
    return np.minimum.accumulate([float(t.value or 0.0) ** 2 for t in study.trials])


def cell(paths: list[Array], least: float) -> str:
    """Median of the trials that it took, and of the end."""
    enough = NEAR * least if least else ZERO
    took = sorted(
        int(np.argmax(one <= enough)) + 1 if one[-1] <= enough else TRIALS + 1 for one in paths
    )[len(paths) // 2]
    end = float(np.median([one[-1] for one in paths]))
    ratio = f"{end / least:.4g}" if least else f"{end:.1e}"
    return f"{took if took <= TRIALS else '-'} ({ratio})"


def main(seeds: str = "5", *names: str) -> int:
    """Measure, and write runs/bench/least_squares.json and the table."""
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    found_at = ROOT / "runs/bench/least_squares.json"
    known: dict[str, dict[str, str]] = json.loads(found_at.read_text()) if found_at.exists() else {}
    for name in names or ("gauss-newton", "tpe", "gp", "cmaes", "random"):
        if name == "gp" and importlib.util.find_spec("torch") is None:
            print("gp: torch is not installed; its column stays as it is", file=sys.stderr)
            continue
        for problem, (_, _, least) in PROBLEMS.items():
            known.setdefault(name, {})[problem] = cell(
                [path(name, problem, seed) for seed in range(1, int(seeds) + 1)], least
            )
            print(name, problem, known[name][problem], file=sys.stderr, flush=True)
        found_at.parent.mkdir(parents=True, exist_ok=True)
        found_at.write_text(json.dumps(known, indent=1))
    order = [name for name in ("gauss-newton", "tpe", "gp", "cmaes", "random") if name in known]
    rows = [f"| problem | {' | '.join(order)} |", "| --- " * (len(order) + 1) + "|"]
    rows += [
        f"| {problem} | " + " | ".join(known[name][problem] for name in order) + " |"
        for problem in PROBLEMS
    ]
    page = ROOT / "docs/optunahub/problems.md"
    place = r"(<!-- table: problems -->\n).*?(<!-- end -->)"
    page.write_text(
        re.sub(
            place,
            lambda at: at[1] + "\n".join(rows) + "\n" + at[2],
            page.read_text(),
            flags=re.DOTALL,
        )
    )
    print("\n".join(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
