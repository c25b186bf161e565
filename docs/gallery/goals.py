"""Runs the designs of the gallery (studies of data/goals), and updates their pages and pictures.

    python docs/gallery/goals.py [NAME ...]

Results go to runs/gallery/NAME; a study that has all its trials is not run again. Its progress and its best design's moments go to
docs/images/gallery, and the movie beside them where it is smaller than 1 MiB. On docs/gallery/NAME.md the text between the marks of
build.py is replaced.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from build import BEGIN, END, replaced

from magmpm.cli import main as magmpm
from magmpm.errors import in_words, significant, unitless
from magmpm.inputs.settings import validate
from magmpm.results.result import Result
from magmpm.scene import Scene, load_scene
from magmpm.studies.goals import evaluate
from magmpm.studies.goals.goal_file import SLSQP
from magmpm.studies.goals.goal_study import load_goal
from magmpm.studies.goals.measures import Measure

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs/images/gallery"
STUDIES = {
    "designed_walker": "walking_strip",
    "designed_gripper": "gripper_field",
    "designed_swimmer": "swimming_sheet",
    "designed_vessel": "catheter_in_vessel",
    "designed_tweezers": "tweezers",
}
MOVIE_BYTES = 1024 * 1024


def main(names: Sequence[str], root: Path = ROOT) -> int:
    """The command. Returns the exit status."""
    for name in names or STUDIES:
        out = root / "runs/gallery" / name
        study = root / f"data/goals/{STUDIES[name]}.yaml"
        status = magmpm(["design", str(study), "--workers", "2", "--out", str(out)])
        if status:
            return status
        moments = out / "moments.png"  # of motions
        drawn = moments if moments.exists() else out / "picture.png"
        shutil.copy(drawn, IMAGES / f"{name}.png")
        shutil.copy(out / "progress.png", IMAGES / f"{name}_progress.png")
        movie = out / "movie.mp4"
        if movie.exists() and movie.stat().st_size < MOVIE_BYTES:
            shutil.copy(movie, IMAGES / f"{name}.mp4")
        page = root / f"docs/gallery/{name}.md"
        report = json.loads((out / "goal.json").read_text())
        table = measured(report)
        if load_scene(out / "best.yaml").static:
            table += in_motion(study, out, report)
        replaced(page, f"{BEGIN}\n{table}{END}")
    return 0


def in_motion(study: Path, out: Path, report: dict[str, Any], rate: float = 25.0) -> str:
    """Rows of the measures of the best equilibrium, and of a damped motion in which its field grows, which ends in it.

    rate: of damping, 1/s, about twice the lowest frequency of the catheter (2 Hz, 14 rad/s): it is at rest within a second.
    """
    data = load_scene(out / "best.yaml").to_si()
    data["effects"]["damping"] = {"rate": rate}
    data["field"]["over_time"] = {"ramp": {"duration": 0.2}}
    data["solver"] = {"dynamic": {"duration": 1.5, "output_every": 0.05}}
    found = load_goal(study)
    measures = dict(found.measures)
    tip = Result.load(out / "best").tip
    if tip is not None:
        distance = {"between": ["tip", tip.tolist()]}
        measures["tip"] = validate(Measure, {"distance": distance})
    job = evaluate.Job(Scene.from_si(data), out / "motion", measures, study.parent)
    moved = evaluate.tried(job)["values"]
    labels = {limit["at"]: limit["label"] for limit in report["limits"]}
    for k, goal in enumerate(found.file.goals):
        labels[f"goal[{k}].{goal.key}"] = goal.measure.label
    rest = report["best"]["measures"]
    rows = [
        f"| {unitless(label)} at rest, and where a motion ends "
        f"| {in_words(label, rest[at])}, {in_words(label, moved[at])} |\n"
        for at, label in labels.items()
    ]
    if tip is not None:
        said = in_words("distance (m)", moved["tip"])
        rows.append(f"| from the tip at rest to where a motion ends | {said} |\n")
    return "".join(rows)


def measured(report: dict[str, Any]) -> str:
    """The table of a search's report."""
    best = report["best"]
    goal = report["goals"][0]
    at_once = "one" if report["sampler"] == SLSQP else "two"
    rows = [
        ("trials", f"{report['trials']}, the best is number {best['number']}"),
        ("a trial", f"{significant(report['seconds_per_trial'], 2)} s, {at_once} at a time"),
        (unitless(goal), in_words(goal, best["values"][0])),
    ]
    first = report["values"][0]
    if first is not None:
        rows.append(("the scene as it is", in_words(goal, first[0])))
    finer = report["finer"]
    if finer is not None and "values" in finer:
        said = in_words(goal, finer["values"][0])
        rows.append((f"the best on {finer['cells_across']} cells across", said))
        rows += [
            (
                f"{unitless(limit['label'])} there",
                in_words(limit["label"], finer["measures"][limit["at"]]),
            )
            for limit in report["limits"]
        ]
    if report["scatter"] is not None:
        near = [in_words(goal, one[0]) for one in report["scatter"]["values"] if one is not None]
        share = f"{report['scatter']['nearness']:g}"
        rows.append((f"designs within {share} of each range of the best", ", ".join(near)))
    for name, value in best["params"].items():
        rows.append(
            (f"`{name}`", f"{significant(report['begun'][name], 4)} -> {significant(value, 4)}")
        )
    lines = ["| measured | |", "| --- | --- |", *(f"| {name} | {said} |" for name, said in rows)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
