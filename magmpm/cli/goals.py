"""`magmpm design` of a study with a `goal`, and `magmpm sweep`."""

from __future__ import annotations

import argparse
import csv
import json
import os
import shlex
import sys
import tempfile
from pathlib import Path
from typing import Any

from magmpm.cli.answers import Progress, end_as_by_ctrl_c
from magmpm.cli.draw import draw_run
from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError
from magmpm.inputs.yaml_document import read_value
from magmpm.results.file_names import ENERGIES_PLOT, MOMENTS, MOVIE, PICTURE


def design_for_goal(options: argparse.Namespace) -> int:
    """Run or resume the search for a goal."""
    from magmpm.studies.engine.storage_url import given_url
    from magmpm.studies.goals.goal_study import load_goal
    from magmpm.studies.goals.report import text
    from magmpm.studies.goals.search import search

    study = load_goal(options.study)
    of_shapes = ("sampler", "trial", "artifacts", "time_limit")
    given = [
        f"--{name.replace('_', '-')}" for name in of_shapes if getattr(options, name) is not None
    ]
    if given:
        raise InputError(
            ", ".join(given),
            received="a study with a goal",
            rule="the study file names the sampler, trials store numbers only, and none is stopped",
            remedy="omit the option",
        )
    out = options.out or Path("runs") / study.name
    end_as_by_ctrl_c()
    with Progress(study.name) as progress:
        report = search(
            study,
            out,
            trials=options.trials,
            workers=options.workers,
            storage=given_url(options.storage, os.environ),
            on_trial=progress.note,
        )
    files: list[str] = []
    if not options.no_pictures and report.ended == "done":
        files = draw_goal(out, out)
    said = [text(report), *(f"  saved            {path}" for path in files)]
    said.append(
        f"  more             magmpm report {shlex.quote(str(out))}, or magmpm dashboard of "
        "the same folder"
    )
    print(json.dumps({**report.summary(), "files": files}) if options.json else "\n".join(said))
    if report.ended == "interrupted":
        return 1
    return 0 if report.best is not None else 3


def saved_goal(folder: Path) -> Plain | None:
    """Report of a search for a goal that a folder holds, None where it holds none. Raises InputError where it can't be read."""
    from magmpm.studies.goals.report import REPORT, GoalReport

    path = folder / REPORT
    if not path.exists():
        return None
    try:
        return GoalReport(**json.loads(path.read_text(encoding="utf-8"))).summary()
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: can't be read as a search's report ({error})",
            rule="must be as `magmpm design` wrote it",
            remedy="run `magmpm design` again: it resumes, and rewrites the report",
        ) from None


def draw_goal(folder: Path, out: Path, kind: str = "png", style: str | None = None) -> list[str]:
    """Draw what a search for a goal found into `out`: its progress, the front of several goals, and its best run. Returns the files."""
    from magmpm.results.run_folder import holds_run
    from magmpm.studies.goals.report import FRONT, PROGRESS
    from magmpm.viz import goal_plots

    report = saved_goal(folder)
    assert report is not None
    files = [str(goal_plots.progress(report, (out / PROGRESS).with_suffix(f".{kind}")))]
    if report["pareto"]:
        files.append(str(goal_plots.front(report, (out / FRONT).with_suffix(f".{kind}"))))
    if holds_run(folder / "best"):
        files += draw_run(folder / "best", out, kind=kind, style=style)
    return files


def page_of_goal(folder: Path, report: Plain) -> str:
    """The page of a search for a goal, with its pictures."""
    from magmpm.studies.goals.report import FRONT, PROGRESS
    from magmpm.viz.sheet import goal_page

    captions = {
        PICTURE: "The best design: at the end, where it moves.",
        PROGRESS: "Value of each trial, and the best so far.",
        FRONT: "The first two goals of each trial.",
        MOVIE: "The best design in motion.",
        MOMENTS: "The best design: the first moment, the last, and the one most unlike both.",
        ENERGIES_PLOT: "Energies and contact forces of the best design over time.",
    }
    with tempfile.TemporaryDirectory(prefix="magmpm-report-") as drawn:
        files = {Path(file).name: Path(file) for file in draw_goal(folder, Path(drawn))}
        pictures = [(files[name], words) for name, words in captions.items() if name in files]
        return goal_page(report, _facts(folder, report), pictures)


def _facts(folder: Path, report: Plain) -> Plain:
    """Facts of a search's best design that its report has not: how to go on, the scene's file, and its directions of magnetization."""
    from magmpm.scene import load_scene

    scene = folder / "best.yaml"
    directions = []
    if scene.exists():
        loaded = load_scene(scene)
        regions = loaded.regions()
        directions = [
            (regions[k].name, list(regions[k].magnetization)) for k in loaded.magnetized_regions()
        ]
    study = shlex.quote(report["study_file"])
    return {
        "command": f"magmpm design {study} --out {shlex.quote(str(folder))}",
        "scene": scene.read_text(encoding="utf-8") if scene.exists() else "",
        "directions": directions,
    }


def sweep(options: argparse.Namespace) -> int:
    """Run a scene over values of its numbers."""
    from magmpm.studies.goals.sweep import sweep as swept

    given = options.set or []
    values = dict(address_and_values(text, "--set") for text in given)
    if not values or len(values) < len(given):
        raise InputError(
            "--set",
            received="; ".join(given) or "nothing",
            rule="a sweep sets numbers of the scene to some values, each of them once",
            remedy="write, say, --set 'field.uniform[2]=2 mT,4 mT'",
        )
    end_as_by_ctrl_c()
    try:
        with Progress("sweep") as progress:
            table = swept(
                options.scene,
                values,
                measure=[_measure(one) for one in options.measure or ("tip",)],
                workers=options.workers,
                folder=options.out,
                on_row=lambda row: progress.note(_words(row)),
                units=True,
            )
    except KeyboardInterrupt:
        kept = "its rows are lost: --out DIR would have kept them"
        if options.out is not None:
            kept = f"{options.out} has the finished rows; the same command continues"
        print(f"magmpm: sweep interrupted; {kept}", file=sys.stderr)
        return 1
    if options.out is not None:
        _keep(table.rows, list(values), options.out)
    if options.json:
        print(json.dumps({"rows": table.rows}))
        return 0
    columns = list(dict.fromkeys(key for row in table.rows for key in row))
    print("\t".join(columns))
    for row in table.rows:
        print("\t".join(_shown(row.get(column, "")) for column in columns))
    return 0


def _keep(rows: list[Plain], varied: list[str], out: Path) -> None:
    """Write the rows as sweep.csv, and of one or two varied numbers a plot, sweep.png."""
    from magmpm.results.whole_file import whole_file
    from magmpm.viz.goal_plots import sweep as plot

    columns = list(dict.fromkeys(key for row in rows for key in row))
    with whole_file(out / "sweep.csv") as part, part.open("w", newline="", encoding="utf-8") as to:
        writer = csv.DictWriter(to, columns)
        writer.writeheader()
        writer.writerows(rows)
    if rows:
        plot(rows, varied, out / "sweep.png", *_axis([row[varied[0]] for row in rows]))


def _axis(values: list[Any]) -> tuple[list[float], str | None]:
    """Values as numbers, with their unit ("" without one). Values that are no numbers of one unit become 0, 1, 2 ..., with None."""
    from magmpm.inputs.quantities import divided

    parts = [found for value in values if (found := divided(value)) is not None]
    units = {unit for _, unit in parts}
    if len(parts) == len(values) and len(units) == 1:
        return [number for number, _ in parts], units.pop()
    texts = list(dict.fromkeys(map(str, values)))
    return [float(texts.index(str(value))) for value in values], None


def address_and_values(text: str, option: str, count: int | None = None) -> tuple[str, list[Any]]:
    """An address and its values, as many as `count` says, from ADDRESS=V1,V2 of an option. Raises InputError."""
    address, _, listed = text.partition("=")
    try:
        values = read_value(f"[{listed}]")
    except ValueError:
        values = []
    if not address.strip() or not values or len(values) != (count or len(values)):
        raise InputError(
            option,
            received=repr(text),
            rule="must be ADDRESS=V1,V2",
            remedy=f"write, say, {option} 'field.uniform[2]=2 mT,4 mT'",
        )
    return address.strip(), values


def _measure(text: str) -> Any:
    """A measure: its name, or its settings as YAML. Raises InputError."""
    try:
        return read_value(text)
    except ValueError:
        raise InputError(
            "--measure",
            received=repr(text),
            rule="must be a name, or settings in brackets that close",
            remedy="write, say, --measure '{travel: {of: tip}}'",
        ) from None


def _words(row: Plain) -> str:
    return ", ".join(f"{key} {_shown(value)}" for key, value in row.items())


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
