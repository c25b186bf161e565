"""`magmpm map`: where a body's tip goes over many fields: table, JSON and a picture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.cli.answers import print_summary, results_folder
from magmpm.cli.design import refuse_study
from magmpm.cli.progress import Progress
from magmpm.errors import InputError, report
from magmpm.inputs.quantities import KINDS, BadQuantity, parse_quantity
from magmpm.inputs.yaml_document import of_file
from magmpm.results.folder_lock import folder_lock
from magmpm.scene import load_scene

if TYPE_CHECKING:
    from magmpm.studies.explore.tip_map import TipMap

USUAL = 20e-3  # T


def command(options: argparse.Namespace) -> int:
    """Map a scene, save the table and draw it. Returns the exit status. Raises InputError."""
    scene = load_scene(options.scene)
    largest = _largest(options.max)
    from magmpm.studies.explore.live import ready  # what solves and draws, after the file is read
    from magmpm.studies.explore.tip_map import MARKS, in_plane, map_tips, on_rays
    from magmpm.viz.tip_map import draw

    fields = in_plane(options.fields, largest, options.plane) if options.plane else on_rays(options.fields, largest, options.strengths)
    if options.plane and options.strengths is not None:
        raise InputError("--strengths: belongs to directions over the sphere; leave it out with --plane")
    folder: Path = options.out or results_folder(scene.name)
    with folder_lock(folder):
        refuse_study(folder)
        with Progress(f"map of {scene.name}") as progress, of_file(options.scene):
            found = map_tips(ready(scene, options.cells), fields, progress.at)
        files = found.save(folder)
        picture = draw(
            folder / f"map.{options.format}", fields=fields.values, tips=found.tip, marks=found.mark, kind=fields.kind, axes=fields.axes,
            shape=fields.shape, length=scene.length, name=scene.name, words=MARKS,
        )  # fmt: skip
    files.append(picture)
    print_summary(options, {**found.summary(), "files": [str(path) for path in files]}, _text(found, files))
    return 0


def _largest(text: str | None) -> float:
    """The greatest strength, T. Raises InputError."""
    if text is None:
        return USUAL
    try:
        return parse_quantity(text, KINDS["flux density"])
    except BadQuantity as error:
        raise InputError(report("--max", received=repr(text), rule=error.rule, remedy=error.remedy)) from None


def _text(found: TipMap, files: list[Path]) -> str:
    from magmpm.studies.explore.tip_map import MARKS

    rows = [f"  {count:6d}  {mark:11} {MARKS[mark]}" for mark, count in found.counts().items() if count]
    head = f"{found.scene.name}: the tip in {len(found.tip)} field{'s' * (len(found.tip) != 1)}, in {found.seconds:.1f} s"
    return "\n".join([head, *reversed(rows), *(f"saved {path}" for path in files)])
