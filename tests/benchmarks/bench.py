"""`make bench`: figures of the pages, times of the main tasks, each beside its bound and goal.

    python tests/benchmarks/bench.py [--quick] [NAME ...]

--quick: as few repetitions as there can be, to see that every figure can still be measured. Any that fails: a row, exit status 1.

Medians with warm kernels unless the name says otherwise; compile time is separate. Writes runs/bench/bench.json: a map from name to
{value, unit, bound, aim, commit, load}, and `machine`: host, processor, threads, commit, load, and the rates of a matrix product
and of a copy on the same cores. Rates of motion come with `per_gflop`: particle-steps per 10^9 floating-point operations of that product,
which differ less between machines than seconds. Nothing here asserts, because the machine may be busy with other things.
"""

import json
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import machine
import motion_rates
import numpy as np
from machine import ROOT, median_seconds

from magmpm import Scene, load_scene, run, sensitivities
from magmpm.compiled.thread_count import one_blas_thread
from magmpm.model import build
from magmpm.runs import error as grid_error
from magmpm.solving.precompile import prepare_kernels
from magmpm.statics.equilibrium import solve_static
from magmpm.statics.layout import static_model
from magmpm.statics.resolution import first_cells
from magmpm.statics.stability import stability

sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests/unit/statics")]
from reference.buckling import column  # noqa: E402
from reference.differences import differences  # noqa: E402

SCENE = ROOT / "data/scenes/five_segments.yaml"
# of a study; of a solve
TRIALS = 35
REPEATS = 15
ERRORS = (0.01, 0.001, 0.0002)  # of the length
MULTIPLES: tuple[float, ...] = (
    2.5,
    5.0,
    10.0,
)  # of the seconds that the coarsest grid and the proof of its error take on this machine
KINDS = [
    "magnetization",
    "field",
    "remanence",
    "shear_modulus",
    "density",
]  # 16 variables of this scene
NOTHING = 1e-15  # m per unit: a derivative below it is rounding


@dataclass(frozen=True)
class Figure:
    """One figure to measure, a number or a map of numbers. bound: the most, or with `least` the least; aim: a better value to reach."""

    measure: Callable[[], float | dict[str, float]]
    unit: str
    bound: float | None
    aim: float | None = None
    least: bool = False


def static_cold() -> float:
    """From the scene alone: particles, grid, rod, Newton, measures."""
    scene = load_scene(SCENE)
    return median_seconds(lambda: run(scene), REPEATS)


def trial() -> float:
    """A trial of the S-shape study by tpe, from the request for a design to its value on disk, with its picture: median."""
    design = [
        "design",
        "data/studies/s_shape.yaml",
        "--sampler",
        "tpe",
        "--trials",
        str(TRIALS),
        "--json",
    ]
    with tempfile.TemporaryDirectory() as folder:
        out = subprocess.check_output(
            [sys.executable, "-m", "magmpm.cli", *design, "--out", folder], cwd=ROOT
        )
    return float(json.loads(out)["seconds_per_trial"])


def asked(data: dict[str, Any] | None = None, **resolution: object) -> Scene:
    """A scene, five segments unless given, with this resolution."""
    return Scene.from_si({**(data or load_scene(SCENE).to_si()), "resolution": resolution})


def timed(scene: Scene) -> float:
    """The median seconds of warm runs, without compiling."""
    return median_seconds(lambda: run(scene), 5)


def error_seconds() -> dict[str, float]:
    """Seconds in all, proof included, for each asked error."""
    return {f"{100 * error:g} %": timed(asked(error=error)) for error in ERRORS}


def estimate_percent() -> dict[str, float]:
    """Time of the error's proof over that of the plain solve on the chosen cells."""
    found = {}
    for error in ERRORS:
        resolution: Any = run(asked(error=error)).resolution
        plain = timed(asked(cells_across=resolution["cells_across"]))
        found[f"{100 * error:g} %"] = 100.0 * (timed(asked(error=error)) - plain) / plain
    return found


def kept_seconds() -> dict[str, float]:
    """Seconds taken over seconds asked for, which this machine can keep: at rest, along a ramp, and in motion until it settles."""
    data: dict[str, Any] = load_scene(SCENE).to_si()
    ramp = {**data["field"], "over_time": {"ramp": {"duration": 1.0}}}
    damped = {**data["effects"], "damping": {"rate": 60.0}}
    kinds: dict[str, dict[str, Any]] = {
        "rest": data,
        "ramp": {**data, "field": ramp, "solver": {"quasi_static": {"steps": 5}}},
        "motion": {**data, "effects": damped, "solver": {"dynamic": {"duration": 0.3}}},
    }
    found = {}
    for kind, scene in kinds.items():
        least = median_seconds(
            partial(grid_error, asked(scene, cells_across=first_cells(Scene.from_si(scene)))), 1
        )
        for multiple in MULTIPLES:
            taken = median_seconds(partial(run, asked(scene, seconds=multiple * least)), 1)
            found[f"{kind}, {multiple * least:.2g} s"] = taken / (multiple * least)
    return found


def _errors_percent(data: dict, field: float, times: list[float]) -> float:
    """Error (%) of the load at which a scene's straight branch ends, in a field that grows from zero to `field` (T) along x."""
    data["field"] = {"uniform": [field, 0.0, 0.0], "over_time": {"ramp": {"duration": 1.0}}}
    data["solver"] = {"quasi_static": {"at": times}}
    scene = Scene.from_si(data)
    found = run(scene).jumps[0]
    theory = column(scene).critical_field
    return 100 * abs(found["field"] / theory - 1)


def critical_loads() -> dict[str, float]:
    """Critical loads of Zhao's beam in plane strain, and of a catheter of twenty diameters magnetized against the field."""
    beam = load_scene(ROOT / "data/scenes/zhao_plane_strain.yaml").to_si()
    catheter = load_scene(ROOT / "data/scenes/buckling_catheter.yaml").to_si()
    return {
        "Zhao's beam": _errors_percent(beam, -15e-3, [0.0, 0.2, 0.3, 0.35]),
        "antiparallel catheter": _errors_percent(catheter, 4e-3, [0.0, 0.2, 0.3, 0.32]),
    }


def jacobian_over_solve_percent() -> float:
    """Derivatives of axis and tip by 16 variables, over the run that they follow; medians of both taken in turn."""
    scene = load_scene(SCENE)

    def derivatives() -> None:
        found = sensitivities(scene, KINDS)
        found.tip, found.centreline  # noqa: B018  (made when they are read)

    derivatives()
    times = np.array(
        [
            [machine.seconds(lambda: run(scene)), machine.seconds(derivatives)]
            for _ in range(REPEATS)
        ]
    )
    solve, both = np.median(times, axis=0)
    return float(100 * (both / solve - 1))


def stability_over_solve_percent() -> float:
    """The smallest eigenvalue over the solve without it; the unloaded body's is kept from the solve before, as in a study."""
    scene = load_scene(SCENE)
    prepare_kernels(scene)
    times = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        found = solve_static(static_model(build(scene)))
        whole = time.perf_counter() - begun
        with one_blas_thread():
            alone = machine.seconds(partial(stability, found.energy, found.point))
        times.append([alone, whole - alone])
    alone, rest = np.median(times, axis=0)
    return float(100 * alone / rest)


def derivative_error() -> dict[str, float]:
    """Largest difference to extrapolated central differences of refined solves, over a variable's largest entry, by scene and kind.

    The scenes of the tests, solved to the tolerance that users have unless they name one."""
    from test_sensitivities import CASES, scene_of

    worst: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in CASES:
            data = scene_of(name, Path(folder)).to_si()
            data["solver"] = {"static": {}}
            scene = Scene.from_si(data)
            found = sensitivities(scene)
            for k, variable in enumerate(found.variables):
                rows, tip = differences(
                    scene, variable, 1 / 30 if found.result.contacts else 1.0
                )  # so that no other point touches
                made = (found.centreline if len(rows) else np.asarray(found.tip))[..., k]
                expected = rows if len(rows) else tip
                size = np.abs(expected).max()
                if size > NOTHING:
                    worst[name] = max(
                        worst.get(name, 0.0), float(np.abs(made - expected).max() / size)
                    )
    return worst


FIGURES = {
    "static_cold_s": Figure(static_cold, "s", 0.35, 0.12),
    "critical_load_error_percent": Figure(critical_loads, "%", 3.0, 1.0),
    "jacobian_over_solve_percent": Figure(jacobian_over_solve_percent, "%", 25.0, 10.0),
    "derivative_error": Figure(derivative_error, "", 1e-5, 1e-7),
    "stability_over_solve_percent": Figure(stability_over_solve_percent, "%", None, 10.0),
    "asked_error_s": Figure(error_seconds, "s", None),
    "estimate_over_solve_percent": Figure(estimate_percent, "%", 30.0, 15.0),
    "kept_seconds": Figure(kept_seconds, "", 1.2),
    "trial_s": Figure(trial, "s", 1.0, 0.5),
    "particle_steps_per_s": Figure(motion_rates.all_threads, "1/s", 24e6, 45e6, least=True),
    "no_effect_cost_percent": Figure(motion_rates.mechanism_percent, "%", 2.0),
    "effect_cost_percent": Figure(motion_rates.effect_costs, "%", None),
}


def _line(label: str, value: float, figure: Figure) -> str:
    bound, aim = ("-" if number is None else f"{number:g}" for number in (figure.bound, figure.aim))
    return (
        f"{label:<48} {value:9.4g} {bound:>9} {aim:>9}"
        f" {figure.unit}{' (at least)' if figure.least else ''}"
    )


def shorten() -> None:
    """Measure everything once, with less of it."""
    global TRIALS, REPEATS, MULTIPLES
    TRIALS = 2
    REPEATS = 1
    MULTIPLES = MULTIPLES[:1]
    motion_rates.SECONDS = 0.02
    motion_rates.REPEATS = 1
    motion_rates.PAIRS = 1
    motion_rates.SETTLING = 20
    motion_rates.PAIRED = 2


def main(names: list[str], out: Path = ROOT / "runs/bench") -> int:
    """Measure the named figures, or all; out: folder of what is found."""
    if "--quick" in names:
        names.remove("--quick")
        shorten()
    unknown = [name for name in names if name not in FIGURES]
    if unknown:
        print(
            f"unknown figures: {', '.join(unknown)}; known are {', '.join(FIGURES)}",
            file=sys.stderr,
        )
        return 2
    out.mkdir(parents=True, exist_ok=True)
    path = out / "bench.json"
    found = json.loads(path.read_text()) if names and path.exists() else {}
    failed: list[str] = []
    found["machine"] = host = machine.described()
    print(
        f"{host['cpu']}, {host['cores']} cores, {host['threads']} threads, commit {host['commit']},"
        f" load {host['load']:g}"
    )
    print(
        f"dgemm {host['dgemm_flop_per_s'] / 1e9:.4g} Gflop/s, copy"
        f" {host['copy_bytes_per_s'] / 1e9:.4g} GB/s"
    )
    print(f"{'figure':<48} {'value':>9} {'bound':>9} {'aim':>9}")
    for name, figure in FIGURES.items():
        if names and name not in names:
            continue
        try:
            value = figure.measure()
        except Exception as failure:  # the other figures are measured all the same
            traceback.print_exc()
            failed.append(name)
            print(
                f"{name:<48} FAILED: {' '.join(str(failure).split()) or repr(failure)}", flush=True
            )
            continue
        found[name] = {
            "value": value,
            "unit": figure.unit,
            "bound": figure.bound,
            "aim": figure.aim,
        }
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
