"""`make bench`: times and memory of the main tasks, each beside its bound and goal.

    python tests/benchmarks/bench.py [--quick] [NAME ...]

--quick: as few repetitions as there can be, to see that every figure can still be measured. A figure that fails is a row that says so, and
the exit status is 1.

Medians with warm kernels unless the name says otherwise; compile time is separate. Writes runs/bench/bench.json: a map from name to
{value, unit, bound, aim, commit, load}, and `machine`: host, processor, threads, commit, load, and the rates of a matrix product
and of a copy on the same cores. Rates of motion come with `per_gflop`: particle-steps per 10^9 floating-point operations of that product,
which differ less between machines than seconds. Nothing here asserts, because the machine may be busy with other things.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import asked
import critical_loads
import derivatives
import effect_cost
import frames
import machine
import motion_rates
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
SCENE = ROOT / "data/scenes/five_segments.yaml"
STUDY = ROOT / "data/studies/s_shape.yaml"
OUT = ROOT / "runs/bench"
TRIALS, REPEATS = 60, 15  # of the longest study; of a solve
NEIGHBOR = 0.05  # rotation of each magnetization for the warm start: 3 degrees


@dataclass(frozen=True)
class Figure:
    """One figure to measure, a number or a map of numbers. bound: the most, or with `least` the least; aim: a better value to reach."""

    measure: Callable[[], float | dict[str, float]]
    unit: str
    bound: float | None
    aim: float | None = None
    least: bool = False


def median_seconds(work: Callable[[], object], repeats: int) -> float:
    """Median time of `work`, after one run that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        begun = time.perf_counter()
        work()
        times.append(time.perf_counter() - begun)
    return statistics.median(times)


def static_cold() -> float:
    """From the scene alone: particles, grid, rod, Newton, measures."""
    from magmpm.scene import load_scene
    from magmpm.simulate import run

    scene = load_scene(SCENE)
    return median_seconds(lambda: run(scene), REPEATS)


def static_warm() -> float:
    """The same, started from the result of a design whose magnetizations differ by 3 degrees."""
    from magmpm.scene import load_scene
    from magmpm.simulate import run

    scene = load_scene(SCENE)
    directions = np.array([segment.magnetization for segment in scene.body.catheter.segments])
    rng = np.random.default_rng(0)
    before = run(scene.with_magnetizations(directions + NEIGHBOR * rng.standard_normal(directions.shape)))
    return median_seconds(lambda: run(scene, start=before), REPEATS)


def static_8_cells() -> float:
    """The five-segment scene at 8 cells across, cold."""
    from magmpm.scene import load_scene
    from magmpm.simulate import run

    scene = load_scene(SCENE).with_cells(8)
    return median_seconds(lambda: run(scene), min(3, REPEATS))


def command(*arguments: str, **environment: str) -> tuple[str, float]:
    """Output and seconds of a magmpm command in a separate process. Raises CalledProcessError."""
    begun = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "magmpm.cli", *arguments],
        cwd=ROOT, env={**os.environ, **environment}, check=True, capture_output=True, text=True,
    )  # fmt: skip
    return done.stdout, time.perf_counter() - begun


def first_compile() -> float:
    """Compilation with an empty cache, in a separate process."""
    with tempfile.TemporaryDirectory() as folder:
        out, _ = command("run", str(SCENE), "--json", "--out", folder, NUMBA_CACHE_DIR=f"{folder}/cache")
    return float(json.loads(out)["seconds"]["compile"])


def start_to_solve() -> float:
    """From the start of the command to the start of the first solve, with the kernels in the disk cache."""
    with tempfile.TemporaryDirectory() as folder:
        command("run", str(SCENE), "--json", "--out", folder)
        times = []
        for _ in range(min(5, REPEATS)):
            out, whole = command("run", str(SCENE), "--json", "--out", folder)
            times.append(whole - json.loads(out)["seconds"]["solve"])
    return statistics.median(times)


def study(trials: int) -> tuple[dict[str, object], float]:
    """JSON and peak memory (MB), including the render worker, of the S-shape study with this number of trials."""
    import psutil
    import yaml

    definition = yaml.safe_load(STUDY.read_text())
    definition.pop("stop", None)  # all the trials, for a steady median
    definition["sampler"] = "tpe"  # as the published study
    definition["scene"] = str((STUDY.parent / definition["scene"]).resolve())
    definition["match"]["centreline"] = str((STUDY.parent / definition["match"]["centreline"]).resolve())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.yaml"
        path.write_text(yaml.safe_dump(definition))
        process = subprocess.Popen(
            [sys.executable, "-m", "magmpm.cli", "design", str(path), "--trials", str(trials), "--json", "--out", folder],
            cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        peak, watched = 0.0, psutil.Process(process.pid)
        while process.poll() is None:
            try:
                family = [watched, *watched.children(recursive=True)]
                peak = max(peak, sum(p.memory_info().rss for p in family) / 1e6)
            except psutil.Error:
                pass  # a child process ended during the reading
            time.sleep(0.05)
        assert process.stdout is not None
        out = process.stdout.read()
    if process.returncode:
        raise RuntimeError(f"magmpm design ended with status {process.returncode}")
    return json.loads(out), peak


def trial() -> float:
    """A trial of the S-shape study, from the request for a design to its value on disk, with its picture: median over 35."""
    summary, _ = study(min(35, TRIALS))
    return float(summary["seconds_per_trial"])  # type: ignore[arg-type]


def study_memory() -> float:
    """Peak memory of a study of 60 trials, summed over its processes."""
    return study(TRIALS)[1]


FIGURES = {
    "static_cold_s": Figure(static_cold, "s", 0.35, 0.12),
    "static_warm_s": Figure(static_warm, "s", 0.15, 0.06),
    "static_8_cells_s": Figure(static_8_cells, "s", 3.0, 1.0),
    "critical_load_error_percent": Figure(critical_loads.critical_loads, "%", 3.0, 1.0),
    "quasi_static_step_s": Figure(critical_loads.step_seconds, "s", 0.15, 0.05),
    "jacobian_over_solve_percent": Figure(derivatives.jacobian_over_solve_percent, "%", 25.0, 10.0),
    "derivative_error": Figure(derivatives.derivative_error, "", 1e-5, 1e-7),
    "stability_over_solve_percent": Figure(derivatives.stability_over_solve_percent, "%", None, 10.0),
    "asked_error_s": Figure(asked.error_seconds, "s", None),
    "estimate_over_solve_percent": Figure(asked.estimate_percent, "%", 30.0, 15.0),
    "kept_seconds": Figure(asked.kept_seconds, "", 1.2),
    "trial_s": Figure(trial, "s", 1.0, 0.5),
    "first_compile_s": Figure(first_compile, "s", 30.0),
    "start_to_solve_s": Figure(start_to_solve, "s", 2.0),
    "study_memory_mb": Figure(study_memory, "MB", 600.0),
    "particle_steps_per_s": Figure(motion_rates.all_threads, "1/s", 24e6, 45e6, least=True),
    "rates_by_threads": Figure(motion_rates.rates_by_threads, "1/s", None),
    "parallel_efficiency_2": Figure(motion_rates.efficiency, "", 0.85, least=True),
    "million_particles_rate": Figure(motion_rates.million, "", 0.8, least=True),
    "motion_run_over_steps": Figure(frames.run_over_steps, "", 1.3),
    "motion_1_ms_100_frames_s": Figure(frames.short_run, "s", 0.5),
    "frame_ms": Figure(frames.frame_ms, "ms", 5.0),
    "bytes_per_particle": Figure(motion_rates.bytes_per_particle, "B", 1100.0),
    "memory": Figure(motion_rates.memory, "B", None),
    "no_effect_cost_percent": Figure(motion_rates.mechanism_percent, "%", 2.0),
    "effect_cost_percent": Figure(motion_rates.effect_costs, "%", None),
}


def _line(label: str, value: float, figure: Figure) -> str:
    bound, aim = ("-" if number is None else f"{number:g}" for number in (figure.bound, figure.aim))
    return f"{label:<48} {value:9.4g} {bound:>9} {aim:>9} {figure.unit}{' (at least)' if figure.least else ''}"


def shorten() -> None:
    """Measure everything once, with less of it."""
    global TRIALS, REPEATS
    TRIALS, REPEATS = 2, 1
    motion_rates.SECONDS, motion_rates.REPEATS, motion_rates.PAIRS, motion_rates.SETTLING = 0.02, 1, 1, 20
    effect_cost.REPEATS = 2


def main(names: list[str], out: Path = OUT) -> int:
    """Measure the named figures, or all; out: folder of what is found."""
    if "--quick" in names:
        names.remove("--quick")
        shorten()
    unknown = [name for name in names if name not in FIGURES]
    if unknown:
        print(f"unknown figures: {', '.join(unknown)}; known are {', '.join(FIGURES)}", file=sys.stderr)
        return 2
    out.mkdir(parents=True, exist_ok=True)
    path = out / "bench.json"
    found = json.loads(path.read_text()) if names and path.exists() else {}
    failed: list[str] = []
    found["machine"] = host = machine.described()
    print(f"{host['cpu']}, {host['cores']} cores, {host['threads']} threads, commit {host['commit']}, load {host['load']:g}")
    print(f"dgemm {host['dgemm_flop_per_s'] / 1e9:.4g} Gflop/s, copy {host['copy_bytes_per_s'] / 1e9:.4g} GB/s")
    print(f"{'figure':<48} {'value':>9} {'bound':>9} {'aim':>9}")
    for name, figure in FIGURES.items():
        if names and name not in names:
            continue
        try:
            value = figure.measure()
        except Exception as error:  # the other figures are measured all the same
            traceback.print_exc()
            failed.append(name)
            print(f"{name:<48} FAILED: {str(error).splitlines()[0] if str(error) else repr(error)}", flush=True)
            continue
        found[name] = {"value": value, "unit": figure.unit, "bound": figure.bound, "aim": figure.aim}
        found[name] |= {"commit": host["commit"], "load": machine.load()}
        if figure.unit == "1/s" and not isinstance(value, dict):
            found[name]["per_gflop"] = 1e9 * value / host["dgemm_flop_per_s"]
        for label, number in value.items() if isinstance(value, dict) else [("", value)]:
            print(_line(f"{name} {label}".strip(), number, figure), flush=True)
        if "per_gflop" in found[name]:
            print(f"{'  particle-steps per Gflop of dgemm':<48} {found[name]['per_gflop']:9.4g}")
        path.write_text(json.dumps(found, indent=1) + "\n")
    print(f"saved {path}" + (f"; failed: {', '.join(failed)}" if failed else ""))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
