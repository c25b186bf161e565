"""`magmpm design` of a study with a `goal`, and `magmpm sweep`."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from magmpm.cli.answers import Progress
from magmpm.errors import InputError


def design_for_goal(options: argparse.Namespace) -> int:
    """Run or resume the search for a goal."""
    from magmpm.studies.engine.storage_url import given_url
    from magmpm.studies.goals.search import load_goal, search, text

    study = load_goal(options.study)
    if options.sampler is not None or options.trial is not None or options.artifacts is not None:
        raise InputError(
            "--sampler, --trial, --artifacts",
            received="a study with a goal",
            rule="its sampler stands in the file, and its trials keep numbers alone",
            remedy="leave the option out",
        )
    out = options.out or Path("runs") / study.name
    with Progress(study.name) as progress:
        report = search(
            study,
            out,
            trials=options.trials,
            workers=options.workers or 1,
            storage=given_url(options.storage, os.environ),
            on_trial=progress.note,
        )
    print(json.dumps(report.summary()) if options.json else text(report))
    return 1 if report.ended == "interrupted" else 0


def sweep(options: argparse.Namespace) -> int:
    """Run a scene over values of its numbers."""
    from magmpm.studies.goals.sweep import sweep as swept

    values = dict(_values(one) for one in options.set or ())
    if not values:
        raise InputError(
            "--set",
            received="nothing",
            rule="a sweep sets a number of the scene to some values",
            remedy="write, say, --set 'field.uniform[2]=2 mT,4 mT'",
        )
    with Progress("sweep") as progress:
        table = swept(
            options.scene,
            values,
            measure=[_measure(one) for one in options.measure or ("tip",)],
            workers=options.workers,
            folder=options.out,
            on_row=lambda row: progress.note(_words(row)),
        )
    if options.json:
        print(json.dumps({"rows": table.rows}))
        return 0
    columns = list(dict.fromkeys(key for row in table.rows for key in row))
    print("\t".join(columns))
    for row in table.rows:
        print("\t".join(_shown(row.get(column, "")) for column in columns))
    return 0


def _values(text: str) -> tuple[str, list[Any]]:
    """An address and its values, from ADDRESS=V1,V2. Raises InputError."""
    import yaml

    address, sign, listed = text.partition("=")
    try:
        values = [yaml.safe_load(one) for one in _divided(listed)] if sign and listed else []
    except yaml.YAMLError:
        values = []
    if not address.strip() or not values:
        raise InputError(
            "--set",
            received=repr(text),
            rule="must be ADDRESS=V1,V2",
            remedy="write, say, --set 'field.uniform[2]=2 mT,4 mT'",
        )
    return address.strip(), values


def _divided(text: str) -> list[str]:
    """Text between commas that stand in no brackets."""
    parts, depth = [""], 0
    for sign in text:
        depth += (sign in "[{") - (sign in "]}")
        if sign == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += sign
    return parts


def _measure(text: str) -> Any:
    """A measure: its name, or its settings as YAML."""
    import yaml

    return yaml.safe_load(text) if text.lstrip().startswith("{") else text


def _words(row: dict[str, Any]) -> str:
    return ", ".join(f"{key} {_shown(value)}" for key, value in row.items())


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
