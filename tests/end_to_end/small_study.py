"""A small study that is really solved (2 cells across, torque alone), for tests of what is made of a study's folder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from reference.commands import scene_text

import magmpm
from magmpm.inputs.csv_tables import write_centreline
from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import load_study

SEGMENTS = "{magnetization: [1, 0, 0]}, {}, {magnetization: [0, 0, 1]}"
FIELD = "{uniform: [0 mT, 4 mT, 8 mT]}"
STUDY = """\
scene: scene.yaml
vary: {magnetization: {}}
match: {centreline: target.csv}
trials: 2
sampler: random
seed: 3
"""


def study_file(folder: Path) -> Path:
    return folder / "short.yaml"


def finished(
    folder: Path,
    *,
    trials: int,
    material: str = "silicone",
    solve: Callable[..., Any] = magmpm.run,
    more: str = "",
) -> Path:
    """Run the study, with more lines in its file, without pictures; the folder of its results."""
    quoted = "'" + material.replace("'", "''") + "'"
    scene = scene_text(
        "short catheter", length="24 mm", segments=SEGMENTS, material=quoted, field=FIELD
    )
    (folder / "scene.yaml").write_text(scene.replace("100 mT", "138 mT"))
    study_file(folder).write_text(STUDY + more)
    s = np.linspace(0.0, 0.024, 13)
    write_centreline(
        folder / "target.csv",
        np.column_stack([s, 0.03 * np.sin(s / 0.03), 0 * s, 0.03 * (1 - np.cos(s / 0.03))]),
    )
    out = folder / "out"
    run_study(
        load_study(study_file(folder)),
        solve=solve,
        differentiate=magmpm.sensitivities,
        out=out,
        trials=trials,
    )
    (out / "convergence.png").write_bytes(b"\x89PNG\r\n\x1a\n")  # a picture, so that none is drawn
    return out
