"""`magmpm fit`: material constants from measurements."""

import argparse
import json
import math
import sys
from pathlib import Path
from typing import Any

from magmpm.cli.answers import folder_of_results, print_summary
from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError

REPORT = "fit.json"
TABLE = "residuals.csv"
HELD_OUT = "held_out.csv"
SCENE = "fitted_scene.yaml"


def command(options: argparse.Namespace) -> int:
    """Fit constants of a scene to tables of measurements; table, files and picture. Returns the exit status."""
    from magmpm.cli.answers import Progress
    from magmpm.inputs.yaml_document import of_file
    from magmpm.scene import load_scene

    sizes = _numbers(options)
    scene = load_scene(options.scene)
    from magmpm.studies.fitting import (
        Refused,
        doubtful_fields,
        fit,
        predict_held_out,
        read_split,
        summary,
        text,
    )

    measured, left = read_split(options.measured, scene, options.hold_out)
    held = None
    for doubt in doubtful_fields(measured, scene):
        print(f"magmpm: warning: {doubt}", file=sys.stderr, flush=True)
    with folder_of_results(options, f"{scene.name} fit") as folder:
        try:
            with Progress(f"fit of {scene.name}") as progress, of_file(options.scene):
                found = fit(
                    measured,
                    scene,
                    vary=_list(options.vary),
                    **sizes,
                    thorough=not options.quick,
                    on_progress=progress.note,
                )
                held = None if left is None else predict_held_out(found, left)
        except Refused as refusal:
            if options.json:
                answer = {
                    "refused": str(refusal),
                    "together": refusal.together,
                    "known": refusal.known,
                    "measure": refusal.advice,
                }
                print(json.dumps(answer))
            raise
        for warning in found.warnings:
            print(f"magmpm: warning: {warning}", file=sys.stderr)
        numbers = {**summary(found), **({} if held is None else {"held_out": held.summary()})}
        files = _saved(folder, found, held, numbers, Path(options.scene), options.format)
    numbers.update(folder=str(folder), files=[str(path) for path in files])
    said = [
        text(found),
        *([] if held is None else [held.text()]),
        *(f"  saved            {path}" for path in files),
    ]
    print_summary(options, numbers, "\n".join(said))
    return 0


def _saved(
    folder: Path, found: Any, held: Any, numbers: Plain, source: Path, kind: str
) -> list[Path]:
    """The report, the residuals, those of what was held out, the fitted scene and the picture."""
    from magmpm.results.whole_file import whole_file, write_json
    from magmpm.studies.fitting import fitted_scene, residuals_table, shown
    from magmpm.viz.fit_plot import fitted

    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / REPORT, numbers, indent=1)
    contents = {TABLE: residuals_table(found), SCENE: fitted_scene(found, source, folder)}
    if held is not None:
        contents[HELD_OUT] = residuals_table(held.found, held.half)
    for name, content in contents.items():
        with whole_file(folder / name) as part:
            part.write_text(content, encoding="utf-8")
    picture = fitted(shown(found, held), folder / f"fit.{kind}", title=found.scene.name)
    return [*(folder / name for name in (REPORT, *contents)), picture]


def _list(texts: list[str] | None) -> list[str] | None:
    """Parts, with commas between, of an option that may be repeated."""
    if texts is None:
        return None
    return [part.strip() for part in ",".join(texts).split(",") if part.strip()]


def _numbers(options: argparse.Namespace) -> Plain:
    """Noise, what is known, and the level, from what was typed. Raises InputError."""
    if not 50 <= options.level < 100:
        raise InputError(
            "--level",
            received=f"{options.level:g}",
            rule="must be at least 50 and below 100 (%)",
            remedy="omit it for 95",
        )
    known = {}
    for pair in _list(options.known) or []:
        name, _, share = pair.partition("=")
        known[name.strip()] = _quantity("--known", share, "percentage")
    return {
        "noise": (
            None
            if options.noise is None
            else [_quantity("--noise", one, "length") for one in _list([options.noise]) or [""]]
        ),
        "angle_noise": _quantity("--angle-noise", options.angle_noise, "angle"),
        "known": known,
        "level": options.level / 100,
    }


def _quantity(option: str, text: str | None, kind: str) -> Any:
    """A positive quantity in SI, None where it is not given. Raises InputError."""
    from magmpm.inputs.quantities import KINDS, in_si

    if text is None:
        return None
    value = in_si(text, kind, option)
    if not 0 < value < math.inf:
        raise InputError(
            option,
            received=repr(text),
            rule="must be greater than 0",
            remedy=f'write, say, "{KINDS[kind].example}"',
        )
    return value
