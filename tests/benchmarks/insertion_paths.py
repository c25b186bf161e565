"""How many paths an insertion can follow: 120 generated ones, in three classes (`make bench-insertion`).

    python tests/benchmarks/insertion_paths.py OUT [--each 40] [--rods]

Classes, 40 paths each, 56 mm long, from the exit of a guide on along +x; the catheter, and the field of at most 10 mT, are those of
data/scenes/insertion.yaml, with gravity along -z:

* planar C: curvature of one sign, a half sine of 30 to 110 degrees in all, in a plane at any angle about the axis;
* planar S: two half sines of opposite sign, 20 to 50 degrees each, in a plane at any angle;
* spatial: a half sine of 30 to 110 degrees whose plane turns by 30 to 120 degrees along the way, to either side.

Every path is drawn from its seed, before anything is solved, and none is thrown away. Their radii are 16 mm, five diameters, and more.

*Solved* is fixed beforehand: mean deviation of the body, over all depths and lengths, of at most 1.5 % of the length, and exit error at
most 1 mm. Each path gets a study by gauss-newton with few trajectories, until it is solved. `--rods`
judges the rod's designs alone, without the body. Results go to OUT/insertion_paths.jsonl, a line each; paths there are not run again.

Why a path is not solved: *field*: the field is at its bound at half of the depths or more; *branch*: no design grew with the path, since
rods fell to another branch; *other*.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path as File

import numpy as np

from magmpm import load_scene, run, sensitivities
from magmpm.studies.engine.loop import run_study
from magmpm.studies.evaluate.trajectory import EXIT_WEIGHT, NEAR_TARGET, InsertionTrajectory
from magmpm.studies.problem.path import Path
from magmpm.studies.problem.study import Study
from magmpm.studies.problem.variables import Vary, VaryDirections, VaryField
from magmpm.studies.rods.rod_path import search
from magmpm.studies.search.search_space import SearchSpace

HERE = File(__file__).resolve().parent
LENGTH = 56e-3
STEPS = 1400
ROWS = 57
DEPTHS = 12
MAX_FIELD = 10e-3
CLASSES = ("planar C", "planar S", "spatial")
# of the length; m: what counts as solved
MEAN = 0.015
EXIT = 1e-3
NOT_FOUND: dict[str, object] = {"mean_m": None, "exit_m": None, "bound": 0}
BOUND = 0.985  # of the greatest field: at its bound


def path(kind: str, number: int) -> np.ndarray:
    """Rows [s, x, y, z], (ROWS, 4) m, of a path of a class."""
    from data.targets.make_vessels import curve  # the repository's root is on the path

    rng = np.random.default_rng([CLASSES.index(kind), number])
    x = (np.arange(STEPS) + 0.5) / STEPS
    if kind == "planar S":
        first, second = np.deg2rad(rng.uniform(20.0, 50.0, 2))
        size = np.pi / LENGTH * np.where(x < 0.5, first, second) * np.sin(2 * np.pi * x)
    else:
        size = np.deg2rad(rng.uniform(30.0, 110.0)) * np.pi / (2 * LENGTH) * np.sin(np.pi * x)
    turn = (
        rng.choice([-1.0, 1.0]) * np.deg2rad(rng.uniform(30.0, 120.0)) if kind == "spatial" else 0.0
    )
    angle = rng.uniform(0.0, 2 * np.pi) + turn * x
    rows = curve(size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1), LENGTH / STEPS)
    return np.asarray(rows[:: STEPS // (ROWS - 1)])


def study_of(kind: str, number: int) -> Study:
    """The study of a path."""
    scene = load_scene(HERE.parents[1] / "data" / "scenes" / "insertion.yaml").with_cells(2)
    depths = tuple((LENGTH * np.arange(1, DEPTHS + 1) / DEPTHS).tolist())
    vary = Vary(magnetization=VaryDirections(), field=VaryField(max=MAX_FIELD, at="each depth"))
    name = f"{kind.replace(' ', '_')}_{number:02d}"
    return Study(
        File(f"{name}.yaml"),
        name,
        scene,
        path(kind, number),
        vary,
        4,
        "gauss-newton",
        1,
        None,
        depths=depths,
    )


def by_rods(study: Study) -> dict[str, object]:
    """Error that the rod's best design reaches."""
    insertion = InsertionTrajectory.of(study, SearchSpace.of(study))
    assert insertion is not None
    way = insertion.rods
    found = search(way, Path(study.target), seed=1, starts=12, enough=NEAR_TARGET * LENGTH)
    if not found:
        return {"mean_m": None, "exit_m": None, "bound": 0, "designs": 0}
    best = found[0]
    ends = [stops[-1] for stops in way.stops(best.directions, best.fields)]
    gaps = [np.linalg.norm(stop.position - stop.depth.path, axis=1) for stop in ends]
    mean = float(
        np.mean(
            [
                np.trapezoid(gap, end.depth.place) / end.depth.place[-1]
                for gap, end in zip(gaps, ends, strict=True)
            ]
        )
    )
    bound = int(np.sum(np.linalg.norm(best.fields, axis=1) > BOUND * MAX_FIELD))
    return {
        "mean_m": mean,
        "exit_m": float(gaps[-1][-1]),
        "rms_m": best.value,
        "bound": bound,
        "designs": len(found),
    }


def by_bodies(study: Study, out: File) -> dict[str, object]:
    """Error that the best trial of a study reaches, after the first with which it is solved, or after all."""
    row: dict[str, object] = {}
    for trials in range(1, study.trials + 1):
        report = run_study(
            study, solve=run, differentiate=sensitivities, out=out / study.name, trials=trials
        )
        row = (
            _of_best(study, out / study.name, report.trials)
            if report.best is not None
            else NOT_FOUND
        )
        if solved(row):
            break
    return row


def _of_best(study: Study, folder: File, trials: int) -> dict[str, object]:
    """Numbers that are kept of a study's best trial."""
    kept = json.loads((folder / "best" / "design.json").read_text(encoding="utf-8"))
    curve = Path(study.target)
    means = []
    fields = []
    for depth, shape in zip(kept["insertion"], kept["shapes"], strict=True):
        axis = np.array(shape["axis_m"])
        gap = np.linalg.norm(axis - curve.at(np.linspace(0.0, depth["depth_m"], len(axis))), axis=1)
        means.append(np.trapezoid(gap) / (len(gap) - 1))
        fields.append(np.linalg.norm(depth["field_T"]))
    bound = int(np.sum(np.array(fields) > BOUND * MAX_FIELD))
    return {
        "mean_m": float(np.mean(means)),
        "exit_m": kept["exit_error_m"],
        "rms_m": kept["rms_m"],
        "bound": bound,
        "trials": trials,
    }


def solved(row: dict[str, object]) -> bool:
    """Return True if a path counts as solved."""
    mean = row["mean_m"]
    away = row["exit_m"]
    return (
        isinstance(mean, float)
        and isinstance(away, float)
        and mean <= MEAN * LENGTH
        and away <= EXIT
    )


def why(row: dict[str, object]) -> str:
    """Why a path is not solved."""
    if row["mean_m"] is None:
        return "branch"
    return "field" if isinstance(row["bound"], int) and row["bound"] >= DEPTHS // 2 else "other"


def rows_of(options: argparse.Namespace) -> Iterator[dict[str, object]]:
    """A row for each path, from the file or solved now."""
    file = options.out / "insertion_paths.jsonl"
    known = (
        [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        if file.exists()
        else []
    )
    done = {(row["class"], row["number"]): row for row in known if row["rods"] == options.rods}
    for number in range(options.each):
        for kind in CLASSES:
            if (kind, number) not in done:
                study = study_of(kind, number)
                begun = time.perf_counter()
                found = by_rods(study) if options.rods else by_bodies(study, options.out)
                row = {
                    "class": kind,
                    "number": number,
                    "rods": options.rods,
                    "seconds": time.perf_counter() - begun,
                    **found,
                }
                with file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(row) + "\n")
                done[kind, number] = row
            yield done[kind, number]


def table(rows: list[dict[str, object]]) -> str:
    """The table of what is solved."""
    lines = [
        "| class | paths | solved | mean deviation, % of length (median, mean) | exit error, mm"
        " (median) | not solved: why |"
    ]
    lines.append("| --- | --- | --- | --- | --- | --- |")
    for kind in (*CLASSES, "all"):
        some = [row for row in rows if kind in ("all", row["class"])]
        if not some:
            continue
        means = [100 * float(row["mean_m"]) / LENGTH for row in some if row["mean_m"] is not None]  # type: ignore[arg-type]
        exits = [1e3 * float(row["exit_m"]) for row in some if row["exit_m"] is not None]  # type: ignore[arg-type]
        reasons = [why(row) for row in some if not solved(row)]
        count = ", ".join(f"{reasons.count(word)} {word}" for word in sorted(set(reasons))) or "-"
        share = 100 * sum(map(solved, some)) / len(some)
        lines.append(
            f"| {kind} | {len(some)} | {share:.0f} % | {np.median(means):.2f}, {np.mean(means):.2f}"
            f" | {np.median(exits):.2f} | {count} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run what is not there yet, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=File)
    parser.add_argument("--each", type=int, default=40, help="paths of each class")
    parser.add_argument("--rods", action="store_true", help="the rod's designs alone")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for row in rows_of(options):
        rows.append(row)
        if len(rows) % len(CLASSES) == 0:
            print(
                f"{len(rows)} of {options.each * len(CLASSES)}: {sum(map(solved, rows))} solved",
                flush=True,
            )
    print(
        f"exit counts {EXIT_WEIGHT} of the body in the search; solved: mean at most {100 * MEAN:g}"
        f" %, exit at most {1e3 * EXIT:g} mm"
    )
    print(table(rows))


if __name__ == "__main__":
    main()
