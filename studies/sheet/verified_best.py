"""The best design again: solved with its derivatives, which give tolerances, and on a finer grid, near the study's equilibrium.

An insertion's or a schedule's equilibrium need not be on the branch that grows from no load, so each is sought where the study found it:
near the shape of its rod (evaluate.trajectory). If the answer is another equilibrium all the same, that is said in place of its numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.compiled.arrays import Array, Named, NamedNumbers, Plain
from magmpm.errors import InputError, MagmpmError
from magmpm.model import build
from magmpm.results.measures import axis_of_particles
from magmpm.results.trajectory import Motion
from magmpm.runs import distance
from magmpm.scene import Scene, load_scene, memory
from magmpm.simulate import run
from magmpm.statics.error_estimate import factor
from magmpm.statics.grids import operations
from magmpm.statics.resolution import left_in_tube, proofs
from magmpm.studies.engine.records import BEST
from magmpm.studies.evaluate.evaluator import evaluation_of
from magmpm.studies.problem.shape_distance import root_mean_square
from magmpm.studies.problem.study import Study
from magmpm.studies.search.best_scene import SCENE, times
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.results.result import Result
    from magmpm.rod.cosserat import RodShape
    from magmpm.statics.linearized import Sensitivities

SHARE_OF_LENGTH = 0.01  # of the length: how far the tip may move
LARGEST = {
    "deg": 30.0,
    "%": 30.0,
    "mm": float("inf"),
}  # beyond which the first order says no more than that
SAME_EQUILIBRIUM = 0.05  # of the length: at a larger distance, two answers are two equilibria


def tolerances(scene: Scene, found: Sensitivities, hidden: int = 0) -> list[Plain]:
    """A row for each number of a design: `what`, `of`, its `unit` (deg, % or mm) and `tip_m_per_unit`, how far the tip moves for one unit.

    A direction may be wrong by a turn about any axis across it: what counts is the turn that moves the tip most, the largest singular value
    of the tip's derivatives (3, 2) by two perpendicular turns. All else counts by the length of the tip's derivative.
    scene: that of `found`; hidden: how many segments of the whole body, from its base, it does not have.
    """
    tip = np.asarray(found.tip, dtype=float)
    columns: dict[tuple[str, Any], list[int]] = {}
    for k, variable in enumerate(found.variables):
        whose = variable.region if variable.region is not None else variable.material
        columns.setdefault((variable.kind, whose), []).append(k)
    rows = []
    for (kind, whose), places in columns.items():
        region = found.variables[places[0]].region
        segment = None if region is None else region + hidden + 1
        whole = "field" if kind == "field" else "body"
        of = f"segment {segment}" if segment else str(whose or whole)
        for what, unit, moved in _ways(kind, whose, tip[:, places], scene):
            row = {"what": what, "of": of, "unit": unit}
            if moved > 0.0:  # without weight the density does nothing
                rows.append({**row, "tip_m_per_unit": float(moved), "segment": segment})
    return rows


def _ways(kind: str, whose: Any, columns: Array, scene: Scene) -> Iterator[tuple[str, str, Any]]:
    """Ways in which variables may be wrong, each with its unit and how far (m) that moves the tip: columns (3, n), its derivatives."""
    degree = np.deg2rad(1.0)
    moved = float(np.linalg.norm(columns))
    if kind == "magnetization":
        yield "direction", "deg", degree * np.linalg.norm(columns, ord=2)
    elif kind in ("length", "diameter"):
        yield kind, "mm", 1e-3 * moved
    elif kind != "field":
        yield kind.replace("_", " "), "%", 0.01 * getattr(scene.materials[whose], kind) * moved
    else:
        field = np.array(scene.field.uniform, dtype=float)
        strength = float(np.linalg.norm(field))
        if columns.shape[1] == 3 and strength > 0.0:
            across = np.eye(3) - np.outer(field, field) / strength**2  # the field as it turns
            turned = np.linalg.norm(columns @ across, ord=2)
            yield "strength", "%", 0.01 * np.linalg.norm(columns @ field)
            yield "direction", "deg", degree * strength * turned


def allowed(row: Plain, way: float) -> float | None:
    """The error, in the row's unit, that alone moves the tip by `way` (m); None where it is beyond LARGEST."""
    if row["tip_m_per_unit"] * LARGEST[row["unit"]] <= way:
        return None
    return float(way / row["tip_m_per_unit"])


def together(rows: Sequence[Plain], direction: float = 5.0, materials: float = 5.0) -> float:
    """Standard deviation (m, in space) of the tip for independent errors of manufacture, to first order: an upper bound.

    direction: standard deviation, deg, of each segment's turn along each of two axes; materials: of remanence and shear modulus, %.
    Each direction counts both axes with the derivative of the worse one.
    """
    parts = [
        np.sqrt(2.0) * direction * row["tip_m_per_unit"]
        for row in rows
        if row["what"] == "direction" and row["segment"] is not None
    ]
    parts += [
        materials * row["tip_m_per_unit"]
        for row in rows
        if row["what"] in ("remanence", "shear modulus")
    ]
    return float(np.linalg.norm(parts)) if parts else 0.0


@dataclass(frozen=True)
class LastEquilibrium:
    """The last equilibrium of a best design: its scene, the rod near which it is (None: on the branch that grows from no load), and
    how many segments of the whole body, from its base, it does not have."""

    scene: Scene
    start: RodShape | None
    hidden: int
    gaps: (
        Callable[[Result], Array] | None
    )  # from the target, (m, 3) m; None where the study is not at hand


def last_equilibrium(result: Result, design: Named, study: Study | None) -> LastEquilibrium:
    """Find out how to solve for the equilibrium of a saved result again. Raises SolveError where the rod does not get there.

    design: what is stored of it (params, magnetization of each segment of the whole body).
    """
    scene = Scene.from_si(result.scene)
    hidden = max(len(design.get("magnetization") or ()) - len(scene.regions()), 0)
    if study is None:
        return LastEquilibrium(scene, None, hidden, None)
    evaluation = evaluation_of(study, SearchSpace.of(study))
    last = len(evaluation.places) - 1
    start = evaluation.starts(design["params"])[-1]
    return LastEquilibrium(scene, start, hidden, lambda found: evaluation.gaps(found, last))


def verified(
    result: Result,
    last: LastEquilibrium,
    run: Callable[..., Result],
    differentiate: Callable[..., Any],
) -> Plain:
    """Verify a best design by solving it again: `tolerances` (rows) and `finer`, or in their place why not (texts)."""
    found: Plain = {}
    for name, ask in (
        ("tolerances", lambda: _tolerances(result, last, differentiate)),
        ("finer", lambda: finer(result, last, run)),
    ):
        try:
            found[name] = ask()
        except MagmpmError as error:
            found[name] = f"not known: {getattr(error, 'reason', error)}"
    return found


def _tolerances(
    result: Result, last: LastEquilibrium, differentiate: Callable[..., Any]
) -> list[Plain] | str:
    found = differentiate(last.scene, start=last.start)
    if distance(result, found.result) > SAME_EQUILIBRIUM * last.scene.length:
        return (
            "not known: solved again, the design has another equilibrium than the one that the"
            " study found"
        )
    return tolerances(last.scene, found, last.hidden)


def finer(result: Result, last: LastEquilibrium, run: Callable[..., Result]) -> Plain | str:
    """The best design on the grid that tells its error (magmpm.statics.error_estimate), SI; a text where that is not known.

    cells, finer_cells; moved_m and tip_moved_m: the largest distance of the axes and of the tips; error_estimate_m: the bound that follows
    for the study's grid; rms_m, finer_rms_m: of this equilibrium from the target on either grid, None where the target is not at hand.
    """
    cells = last.scene.resolution.cells_across
    proof = proofs(last.scene).get(cells)
    if proof is None:
        return f"not known: no finer grid tells the error of {cells} cells across"
    fine = last.scene.with_cells(proof)
    if operations(fine)[1] > 0.25 * memory.machine():
        return f"not known: {proof} cells across take more than a quarter of this machine's memory"
    found = run(fine, start=last.start)
    moved = distance(result, found)
    if moved > SAME_EQUILIBRIUM * last.scene.length:
        return (
            f"not known: on {proof} cells across the design has another equilibrium,"
            f" {1e3 * moved:.3g} mm away"
        )
    rms = [
        None if last.gaps is None else float(root_mean_square(last.gaps(one)))
        for one in (result, found)
    ]
    tip = float(np.linalg.norm(np.asarray(result.tip) - found.tip))
    known = {
        "cells": cells,
        "finer_cells": proof,
        "moved_m": moved,
        "tip_moved_m": tip,
        "error_estimate_m": factor(cells, proof, left_in_tube(last.scene, cells, proof)) * moved,
    }
    return {**known, "rms_m": rms[0], "finer_rms_m": rms[1]}


def in_time(folder: Path, design: Named, study: Study | None) -> list[NamedNumbers]:
    """Run the best design along time; one row each depth or time, SI. Raises InputError, SolveError."""
    scene = load_scene(folder / BEST / SCENE)
    out = folder / "motion" / f"trial_{design['number']:04d}"
    if "insertion" in design:
        return _pushed(_motion(scene, out), design)
    if study is None:
        raise InputError(
            "--motion",
            rule="the schedule's shapes are in its study file, which is gone or has changed",
            remedy="leave it out",
        )
    paths = {"quasi_static_m": scene, "motion_m": in_motion(scene, study)}
    ways = {
        name: _distances(study, path, _motion(path, out / name.removesuffix("_m")))
        for name, path in paths.items()
    }
    return [
        {
            "time_s": frame.time,
            "design_m": row["rms_m"],
            **{name: way[k] for name, way in ways.items()},
        }
        for k, (frame, row) in enumerate(zip(study.keyframes, design["schedule"], strict=True))
    ]


def _motion(scene: Scene, out: Path) -> Motion:
    run(scene, folder=out, resume=True)
    return Motion.load(out)


def _distances(study: Study, scene: Scene, motion: Motion) -> list[float]:
    """The rms distance (m) from each of the study's shapes at its time."""
    model = build(scene)
    found = []
    for frame in study.keyframes:
        axis = axis_of_particles(
            model, np.asarray(motion.position(motion.nearest(frame.time)), dtype=float)
        )
        found.append(
            root_mean_square(
                linear(frame.target[:, 0], axis[:, 0], axis[:, 1:]) - frame.target[:, 1:]
            )
        )
    return found


def in_motion(scene: Scene, study: Study) -> Scene:
    """The scene as a motion, with a frame at each of the study's times."""
    end = study.keyframes[-1].time + study.hold
    moments = [
        Fraction(t).limit_denominator(100_000)
        for t in (*(frame.time for frame in study.keyframes), end)
    ]
    common = math.lcm(*(t.denominator for t in moments))
    every = max(
        float(Fraction(math.gcd(*(int(t * common) for t in moments)), common)) / 10, end / 1000
    )
    data = scene.to_si()
    data["solver"] = {
        "anti_locking": data["solver"]["anti_locking"],
        "dynamic": {"duration": end, "output_every": every},
    }
    return Scene.from_si(data)


def _pushed(motion: Motion, design: Named) -> list[NamedNumbers]:
    """Distances (m) of the pushed body from the equilibrium of each depth, and the force of its walls (N)."""
    scene = motion.scene
    assert scene is not None  # the file says what was run
    exit_at = scene["effects"]["feed"]["exit"]
    length = scene["body"]["catheter"]["length"]
    diameter = scene["body"]["catheter"]["diameter"]
    depths = np.array([each["depth_m"] for each in design["insertion"]])
    reference = np.asarray(motion.reference, dtype=float)
    rows = []
    for depth, when, shape in zip(depths, times(depths, diameter), design["shapes"], strict=True):
        s, axis = _outside(
            reference,
            np.asarray(motion.position(motion.nearest(when)), dtype=float),
            length - depth,
        )
        known = np.array(shape["axis_m"])
        away = np.linalg.norm(
            axis
            - linear(s, np.linspace(0.0, depth, len(known)), known)
            - np.array([exit_at, 0.0, 0.0]),
            axis=1,
        )
        size = {
            "largest_m": float(away.max()),
            "rms_m": float(np.sqrt(np.mean(away**2))),
            "tip_m": float(away[-1]),
        }
        rows.append({"depth_m": float(depth), **size, "contact_N": _contact(motion, when)})
    return rows


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
