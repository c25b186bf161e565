"""`make bench-robust`: the scatter that `robust` expects of a design, against designs made with sampled errors, each solved in full.

    python tests/benchmarks/robust.py [SAMPLES]

Five designs, from 3 mm off their target to exactly on it, where the rms is least linear. Errors are 5 deg, 5 % and 5 %, drawn with a fixed
seed. A sampled standard deviation of N solves is itself known to 1/sqrt(2 N) of its value: 4 % at 300.
"""

import math
import sys
import time

import machine
import numpy as np

from magmpm import run, sensitivities
from magmpm.scene import Scene, load_scene
from magmpm.scene.addresses import Place, changed, value_at, written
from magmpm.studies.evaluate.trial import Scatter, deviations
from magmpm.studies.problem.shape_distance import gap_derivatives, gaps, root_mean_square
from magmpm.studies.problem.study_file import Robust
from magmpm.studies.search.knobs import errors_of

ERRORS = Robust(direction=math.radians(5), remanence=0.05, shear_modulus=0.05)


def designs() -> list[tuple[str, Scene, np.ndarray]]:
    """Name, scene and target rows [s, x, y, z], m."""
    scene = load_scene(machine.ROOT / "data/scenes/five_segments.yaml")
    rng = np.random.default_rng(4)
    found = []
    for k, name in enumerate(("random", "near", "on target", "all alike", "gravity")):
        directions = (
            rng.normal(size=(5, 3)) if name != "all alike" else np.tile([1.0, 0.2, 0.1], (5, 1))
        )
        made = scene.with_magnetizations(directions)
        if name == "gravity":
            made = made.with_effects(gravity={})
        target = run(made).centreline[8::8]
        away = {"random": 3e-3, "near": 5e-4, "on target": 0.0, "all alike": 2e-3, "gravity": 1e-3}[
            name
        ]
        share = (target[:, :1] / target[-1, 0]) ** 2
        found.append(
            (
                name,
                made,
                target
                + away * np.hstack([0 * share, share * np.random.default_rng(k).normal(size=3)]),
            )
        )
    return found


def made_with_errors(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with errors drawn: directions tilted along great circles, materials multiplied."""
    total: dict[Place, float] = {}
    for change in errors_of(ERRORS, scene):
        drawn = rng.normal()
        for place, size in change.items():
            total[place] = total.get(place, 0.0) + drawn * size
    directions = np.array([region.magnetization for region in scene.regions()])
    for k, region in enumerate(scene.regions()):
        at = ("body", *region.at, "magnetization")
        across = np.array([total.pop((*at, i)) for i in range(3)])
        angle = np.linalg.norm(across)
        directions[k] = math.cos(angle) * directions[k] + math.sin(angle) / angle * across
    made = changed(scene, {at: value_at(scene, at) + size for at, size in total.items()})
    return made.with_magnetizations(directions)


def main(samples: str = "300") -> int:
    """Print the table, and write runs/bench/robust.json."""
    rows = []
    print(
        f"{'design':<12}{'rms':>8}{'':>12}{'scatter':>9}{'mean rms':>10}{'sigma':>8}{'mean + 2 sigma':>16}"
        "   (mm)"
    )
    for name, scene, target in designs():
        begun = time.perf_counter()
        of = dict.fromkeys(written(at) for one in errors_of(ERRORS, scene) for at in one)
        found = sensitivities(scene, of=list(of))
        sizes = deviations(scene, found.variables, ERRORS)
        expected = Scatter(
            gaps(found.result.centreline, target), gap_derivatives(found, target) @ sizes
        )
        seconds = time.perf_counter() - begun
        rng = np.random.default_rng([7, len(rows)])
        shapes = [
            gaps(run(made_with_errors(scene, rng)).centreline, target) for _ in range(int(samples))
        ]
        values = np.array([root_mean_square(g) for g in shapes])
        apart = np.array([np.mean(np.sum((g - expected.gaps) ** 2, axis=1)) for g in shapes])
        sampled = np.array(
            [
                math.sqrt(apart.mean()),
                values.mean(),
                values.std(ddof=1),
                values.mean() + 2 * values.std(ddof=1),
            ]
        )
        first_order = np.array([expected.scatter, *expected.moments(), expected.measure])
        off = first_order / sampled - 1
        nominal = 1e3 * root_mean_square(expected.gaps)
        print(
            f"{name:<12}{nominal:>8.3f}{'first order':>12}"
            + _row(1e3 * first_order)
            + f"   {seconds:.2f} s"
        )
        print(f"{'':<20}{samples + ' solves':>12}" + _row(1e3 * sampled))
        print(f"{'':<20}{'apart':>12}" + _row(100 * off, "+", 1) + " %", flush=True)
        row = {
            "design": name,
            "rms_m": nominal / 1e3,
            "first_order_m": first_order.tolist(),
            "sampled_m": sampled.tolist(),
        }
        rows.append({**row, "apart": off.tolist()})
    machine.save("robust", rows)
    return 0


def _row(values: np.ndarray, sign: str = "-", digits: int = 3) -> str:
    return "".join(
        f"{value:>{sign}{width}.{digits}f}"
        for value, width in zip(values, (9, 10, 8, 16), strict=True)
    )


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
