"""A schedule that a study has found, run as equilibria along time and as a motion, against the shapes it was found for.

    python -m magmpm.studies.schedule_check STUDY [OUT]       # OUT: the study's folder, runs/NAME unless given

Equilibria along time begin each from the one before (solver.quasi_static), where the study's began from no load; the motion
(solver.dynamic) has inertia, and the losses that the scene names. Both begin at rest without a field. The runs are in OUT/schedule,
with their frames; OUT/schedule/check.json has the table that is printed: the rms distance from each shape at its time, m.
"""

from __future__ import annotations

import json
import math
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, MagmpmError, report
from magmpm.model import build
from magmpm.results.measures import axis_of_particles
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run
from magmpm.studies.best_scene import SCENE
from magmpm.studies.definition import load_study
from magmpm.studies.records import BEST, DESIGN, read_design
from magmpm.studies.study import Study

FINEST = 1000  # frames of a motion: times that need more are met by the nearest frame


def distances(study: Study, scene: Scene, folder: Path) -> list[float]:
    """Runs a scene in time. The rms distance (m) from each of the study's shapes at its time."""
    run(scene, folder=folder)
    motion, model = Motion.load(folder), build(scene)
    found = []
    for frame in study.keyframes:
        axis = axis_of_particles(model, np.asarray(motion.position(motion.nearest(frame.time)), dtype=float))
        found.append(_rms(axis, frame.target))
    return found


def _rms(axis: Array, target: Array) -> float:
    """Root mean square distance (m) of an axis, rows [s, x, y, z], from target rows."""
    points = np.stack([np.interp(target[:, 0], axis[:, 0], column) for column in axis[:, 1:].T], axis=1)
    return float(np.sqrt(np.mean(np.sum((points - target[:, 1:]) ** 2, axis=1))))


def in_motion(scene: Scene, study: Study) -> Scene:
    """The scene as a motion, with a frame at each of the study's times."""
    end = study.keyframes[-1].time + study.hold
    times = [Fraction(t).limit_denominator(100_000) for t in (*(frame.time for frame in study.keyframes), end)]
    common = math.lcm(*(t.denominator for t in times))
    every = max(float(Fraction(math.gcd(*(int(t * common) for t in times)), common)) / 10, end / FINEST)
    data = scene.to_si()
    data["solver"] = {"anti_locking": data["solver"]["anti_locking"], "dynamic": {"duration": end, "output_every": every}}
    return Scene.from_si(data)


def check(study_file: Path, out: Path | None = None) -> dict[str, Any]:
    """Runs a study's best schedule both ways, and writes OUT/schedule/check.json. Raises InputError, SolveError."""
    study = load_study(study_file)
    if not study.keyframes:
        rule = "only a study with a `schedule` has one to check"
        raise InputError(report(str(study_file), received="a study without a schedule", rule=rule, remedy="name another study"))
    out = out or Path("runs") / study.name
    if not (out / BEST / SCENE).exists():
        rule = "the study must have a best design"
        raise InputError(report(str(out / BEST / SCENE), received="no such file", rule=rule, remedy=f"magmpm design {study_file}"))
    scene, design = load_scene(out / BEST / SCENE), read_design(out / BEST)
    if "schedule" not in design:
        raise InputError(report(str(out / BEST / DESIGN), rule="must be that of a schedule", remedy=f"magmpm design {study_file}"))
    table = {
        "time_s": [frame.time for frame in study.keyframes],
        "design_m": [row["rms_m"] for row in design["schedule"]],
        "quasi_static_m": distances(study, scene, out / "schedule/quasi_static"),
        "motion_m": distances(study, in_motion(scene, study), out / "schedule/motion"),
    }
    (out / "schedule/check.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    return table


def main(arguments: list[str]) -> int:
    """Prints the table. Returns the exit status."""
    if not 1 <= len(arguments) <= 2:
        print(__doc__, file=sys.stderr)
        return 2
    try:
        table = check(*map(Path, arguments))
    except MagmpmError as error:
        print(error, file=sys.stderr)
        return error.exit_status
    print("time, s   rms from the shape, mm: design   equilibria along time   motion")
    for row in zip(*table.values(), strict=True):
        print(f"{row[0]:<10g}{1e3 * row[1]:>31.3f}{1e3 * row[2]:>24.3f}{1e3 * row[3]:>9.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
