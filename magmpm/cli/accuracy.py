"""`magmpm accuracy`: what accuracy costs in time."""

from __future__ import annotations

import argparse

from magmpm.cli.answers import print_summary, results_folder
from magmpm.cli.design import refuse_study
from magmpm.cli.progress import Progress
from magmpm.errors import InputError, SolveError
from magmpm.inputs.yaml_document import of_file
from magmpm.results.folder_lock import folder_lock
from magmpm.results.run_folder import RunFolder
from magmpm.scene import load_scene


def command(options: argparse.Namespace) -> int:
    """Solve a scene over a ladder of cell sizes; table, files and picture. Returns the exit status: 3 where fewer than two sizes had an
    answer."""
    scene = load_scene(options.scene)
    from magmpm.simulate import run  # what solves, after the file is read
    from magmpm.studies.explore.accuracy import LADDER, climb, save

    cells = _cells(options.cells) or LADDER
    folder = options.out or results_folder(scene.name)
    with folder_lock(folder):
        refuse_study(folder)
        kept = RunFolder(folder, scene, options.scene)
        kept.claim(options.overwrite)
        with Progress(f"accuracy of {scene.name}") as progress, of_file(options.scene):
            ladder = climb(scene, run, cells, progress.at, motion=options.motion)
        from magmpm.viz.plots import (
            accuracy,  # matplotlib takes 0.4 s to import: after the work that may fail
        )

        files = [*save(ladder, folder)]
        if len(ladder.rungs) > 1:  # one alone has no error to be drawn
            files.append(accuracy(ladder.summary()["rungs"], folder / f"accuracy.{options.format}", title=scene.name))
        kept.sign_accuracy()
    summary = {**ladder.summary(), "files": [str(path) for path in files]}
    print_summary(options, summary, "\n".join([ladder.table(), *(f"saved {path}" for path in files)]))
    return 0 if len(ladder.rungs) > 1 else SolveError.exit_status


def _cells(text: str | None) -> list[int]:
    try:
        return [int(part) for part in text.split(",")] if text else []
    except ValueError:
        raise InputError(f"--cells: got {text!r}; must be whole numbers with commas between, such as 2,3,4,6") from None
