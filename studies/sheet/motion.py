"""The best design of an insertion or a schedule as a motion, against the equilibria that it was found by.

The scene is OUT/best/scene.yaml. Runs are kept in OUT/motion/TRIAL, so that the next report reads them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, report
from magmpm.model import build
from magmpm.results.measures import axis_of_particles
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run
from magmpm.studies.engine.records import BEST
from magmpm.studies.problem.study import Study
from magmpm.studies.search.best_scene import SCENE, times


def in_time(folder: Path, design: Mapping[str, Any], study: Study | None) -> list[dict[str, float]]:
    """Run the best design along time; one row each depth or time, SI. Raises InputError, SolveError."""
    scene, out = load_scene(folder / BEST / SCENE), folder / "motion" / f"trial_{design['number']:04d}"
    if "insertion" in design:
        return _pushed(_motion(scene, out), design)
    if study is None:
        rule = "the schedule's shapes are those of its study file, which is gone or has changed"
        raise InputError(report("--motion", rule=rule, remedy="leave it out"))
    paths = {"quasi_static_m": scene, "motion_m": in_motion(scene, study)}
    ways = {name: _distances(study, path, _motion(path, out / name.removesuffix("_m"))) for name, path in paths.items()}
    return [
        {"time_s": frame.time, "design_m": row["rms_m"], **{name: way[k] for name, way in ways.items()}}
        for k, (frame, row) in enumerate(zip(study.keyframes, design["schedule"], strict=True))
    ]


def _motion(scene: Scene, out: Path) -> Motion:
    run(scene, folder=out, resume=True)
    return Motion.load(out)


def _distances(study: Study, scene: Scene, motion: Motion) -> list[float]:
    """The rms distance (m) from each of the study's shapes at its time."""
    model, found = build(scene), []
    for frame in study.keyframes:
        axis = axis_of_particles(model, np.asarray(motion.position(motion.nearest(frame.time)), dtype=float))
        gaps = _at(frame.target[:, 0], axis[:, 0], axis[:, 1:]) - frame.target[:, 1:]
        found.append(float(np.sqrt(np.mean(np.sum(gaps**2, axis=1)))))
    return found


def in_motion(scene: Scene, study: Study) -> Scene:
    """The scene as a motion, with a frame at each of the study's times."""
    end = study.keyframes[-1].time + study.hold
    moments = [Fraction(t).limit_denominator(100_000) for t in (*(frame.time for frame in study.keyframes), end)]
    common = math.lcm(*(t.denominator for t in moments))
    every = max(float(Fraction(math.gcd(*(int(t * common) for t in moments)), common)) / 10, end / 1000)
    data = scene.to_si()
    data["solver"] = {"anti_locking": data["solver"]["anti_locking"], "dynamic": {"duration": end, "output_every": every}}
    return Scene.from_si(data)


def _pushed(motion: Motion, design: Mapping[str, Any]) -> list[dict[str, float]]:
    """Distances (m) of the pushed body from the equilibrium of each depth, and the force of its walls (N)."""
    scene = motion.scene
    assert scene is not None  # the file says what was run
    exit_at = scene["effects"]["feed"]["exit"]
    length, diameter = scene["body"]["catheter"]["length"], scene["body"]["catheter"]["diameter"]
    depths = np.array([each["depth_m"] for each in design["insertion"]])
    reference = np.asarray(motion.reference, dtype=float)
    rows = []
    for depth, when, shape in zip(depths, times(depths, diameter), design["shapes"], strict=True):
        s, axis = _outside(reference, np.asarray(motion.position(motion.nearest(when)), dtype=float), length - depth)
        known = np.array(shape["axis_m"])
        away = np.linalg.norm(axis - _at(s, np.linspace(0.0, depth, len(known)), known) - np.array([exit_at, 0.0, 0.0]), axis=1)
        size = {"largest_m": float(away.max()), "rms_m": float(np.sqrt(np.mean(away**2))), "tip_m": float(away[-1])}
        rows.append({"depth_m": float(depth), **size, "contact_N": _contact(motion, when)})
    return rows


def _at(s: Array, known: Array, points: Array) -> Array:
    """Points (n, 3) m of a curve at arc lengths s (n,) m."""
    return np.stack([np.interp(s, known, column) for column in points.T], axis=1)


def _outside(reference: Array, position: Array, inside: float) -> tuple[Array, Array]:
    """Arc lengths (k,) m from the exit on, and the mean places (k, 3) m of the particles of each layer outside the guide."""
    layer, of = np.unique(np.round(reference[:, 0], 9), return_inverse=True)
    count = np.bincount(of)
    mean = np.stack([np.bincount(of, column) / count for column in position.T], axis=1)
    outside = layer > inside
    return layer[outside] - inside, mean[outside]


def _contact(motion: Motion, when: float) -> float:
    """The size of the force of walls on the body at a time, N; 0 where no walls are named."""
    contact = motion.contacts.get("walls")
    if contact is None or not len(contact["t"]):
        return 0.0
    k = int(np.argmin(np.abs(np.asarray(contact["t"]) - when)))
    return float(np.linalg.norm([contact[name][k] for name in ("Fx", "Fy", "Fz")]))
