"""Commands that print a table: `magmpm accuracy`, `effects`, `map` and `stability`. What solves is imported after the file is read."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.cli.answers import Progress, folder_of_results, print_summary
from magmpm.errors import InputError, SolveError, count
from magmpm.inputs.quantities import in_si
from magmpm.inputs.yaml_document import of_file
from magmpm.results.run_folder import RunFolder
from magmpm.scene import load_scene

if TYPE_CHECKING:
    from magmpm.studies.explore.tip_map import TipMap


def accuracy(options: argparse.Namespace) -> int:
    """Solve a scene over a ladder of cell sizes; table, files and picture. Returns the exit status: 3 if fewer than two were answered."""
    scene = load_scene(options.scene)
    from magmpm.simulate import run
    from magmpm.studies.explore.accuracy import LADDER, climb, save

    cells = _cells(options.cells) or LADDER
    with folder_of_results(options, scene.name) as folder:
        kept = RunFolder(folder, scene, options.scene)
        kept.claim(options.overwrite)
        with Progress(f"accuracy of {scene.name}") as progress, of_file(options.scene):
            ladder = climb(scene, run, cells, progress.at, motion=options.motion)
        from magmpm.viz import (
            plots,
        )  # matplotlib takes 0.4 s to import: after the work that may fail

        files = [*save(ladder, folder)]
        if len(ladder.rungs) > 1:  # one alone has no error to be drawn
            files.append(
                plots.accuracy(
                    ladder.summary()["rungs"],
                    folder / f"accuracy.{options.format}",
                    title=scene.name,
                    order_finest=ladder.order_finest,
                    order_reference=ladder.order_reference,
                )
            )
        kept.sign_accuracy()
    summary = {**ladder.summary(), "files": [str(path) for path in files]}
    print_summary(
        options, summary, "\n".join([ladder.table(), *(f"saved {path}" for path in files)])
    )
    return 0 if len(ladder.rungs) > 1 else SolveError.exit_status


def _cells(text: str | None) -> list[int]:
    try:
        return [int(part) for part in text.split(",")] if text else []
    except ValueError:
        raise InputError(
            f"--cells: got {text!r}; must be whole numbers separated by commas, such as 2,3,4,6"
        ) from None


def effects(options: argparse.Namespace) -> int:
    """Print the table of effects. Returns the exit status."""
    scene = load_scene(options.scene)
    from magmpm.studies.explore.effects_table import survey

    with Progress(f"effects of {scene.name}"), of_file(options.scene):
        table = survey(scene, measure=not options.quick)
    print_summary(options, table.summary(), table.text(every=options.all))
    return 0


def tip_map(options: argparse.Namespace) -> int:
    """Map where a body's tip goes over many fields: table, JSON and a picture. Returns the exit status. Raises InputError."""
    scene = load_scene(options.scene)
    largest = in_si("20 mT" if options.max is None else options.max, "flux density", "--max")
    from magmpm.studies.explore.live import ready
    from magmpm.studies.explore.tip_map import in_plane, map_tips, on_rays
    from magmpm.viz.tip_map import MappedTips, draw

    fields = (
        in_plane(options.fields, largest, options.plane)
        if options.plane
        else on_rays(options.fields, largest, options.strengths)
    )
    if options.plane and options.strengths is not None:
        raise InputError("--strengths: applies to directions over the sphere; omit it with --plane")
    with folder_of_results(options, scene.name) as folder:
        with Progress(f"map of {scene.name}") as progress, of_file(options.scene):
            found = map_tips(ready(scene, options.cells), fields, progress.at)
        files = found.save(folder)
        picture = draw(
            folder / f"map.{options.format}",
            scene.name,
            MappedTips(
                fields.values,
                found.tip,
                found.mark,
                fields.kind,
                fields.axes,
                fields.shape,
                scene.length,
            ),
        )
    files.append(picture)
    print_summary(
        options,
        {**found.summary(), "files": [str(path) for path in files]},
        _map_text(found, files),
    )
    return 0


def _map_text(found: TipMap, files: list[Path]) -> str:
    from magmpm.studies.explore.tip_map import MARKS

    rows = [
        f"  {number:6d}  {mark:11} {MARKS[mark]}"
        for mark, number in found.counts().items()
        if number
    ]
    head = (
        f"{found.scene.name}: the tip in {count(len(found.tip), 'field')} (field.uniform), in"
        f" {found.seconds:.1f} s"
    )
    return "\n".join([head, *reversed(rows), *(f"saved {path}" for path in files)])


def stability(options: argparse.Namespace) -> int:
    """Run the chosen hard cases, and print their table. Returns the exit status: 3 if one fails."""
    from magmpm.studies.hard_cases import CASES, run_cases, table

    named = [
        case for case in CASES if options.case is None or options.case.lower() in case.name.lower()
    ]
    chosen = [case for case in named if not (options.quick and case.slow)]
    if not chosen:
        raise InputError(
            f"--case: received {options.case!r}; must be part of a name:"
            f" {', '.join(case.name for case in CASES)}"
        )
    with Progress("hard cases") as progress:
        outcomes = run_cases(chosen, on_done=progress.at)
    failed = [outcome.case.name for outcome in outcomes if not outcome.passed]
    summary = {"cases": [outcome.summary() for outcome in outcomes], "failed": failed}
    print_summary(options, summary, table(outcomes))
    if failed:
        print(
            f"magmpm: {len(failed)} of {len(outcomes)} hard cases failed: {', '.join(failed)}",
            file=sys.stderr,
        )
    return 3 if failed else 0
