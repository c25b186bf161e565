"""`magmpm effects`: what each effect does to a scene, and costs."""

from __future__ import annotations

import argparse

from magmpm.cli.answers import print_summary
from magmpm.cli.progress import Progress
from magmpm.inputs.yaml_document import of_file
from magmpm.scene import load_scene


def command(options: argparse.Namespace) -> int:
    """Print the table of effects. Returns the exit status."""
    scene = load_scene(options.scene)
    from magmpm.studies.explore.effects_table import survey  # and what solves, after the file is read

    with Progress(f"effects of {scene.name}"), of_file(options.scene):
        table = survey(scene, measure=not options.quick)
    print_summary(options, table.summary(), table.text(every=options.all))
    return 0
