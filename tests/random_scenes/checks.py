"""Independent checks of an answer: what must hold of it, whatever the solver did. `refuted` returns what does not.

A static equilibrium is compared with that of its mirror image, with that of its quarter turn, with the rod, with a finer grid, with a load
ramped in another way; equilibria along time with the equilibrium at their end; a motion with its mirror image, with half the time step,
and with its own energy. Where two answers differ, both may be right: a body far from its unloaded shape often
has several stable equilibria. That counts as an explanation only if both are shown to be equilibria of one and the same discrete body.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.errors import SolveError, TimeOver
from magmpm.results.file_names import ENERGIES
from magmpm.results.measures import largest_distance, tip_of
from magmpm.results.result import Result
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.simulate import choose_effects, run
from magmpm.statics.stability import BRINK
from magmpm.studies.hard_cases.motions import changed
from random_scenes.twins import MIRROR, QUARTER, can_turn, twin

# Equilibria of the same body on the same grid: the solve stops where a step could win 1e-11 of the energy, so the error of the softest
# motion is sqrt(1e-11 / stability) of what the load has moved it; ten times that, for loads whose energy is a hundred times the body's.
SOLVED = 1e-4
CLOSER = 1e3  # times: what is an equilibrium stays where it is
# more where magnets or coils are on a table, whose error is 0.002 of the field, about another box
TABLE = 0.02
# of the length: two or three cells across against one more; errors at two cells are 1 to 2 %
# (docs/accuracy)
FINER = 0.06
# More for a strip's width over its length, above 1 / SLENDER, if finer cells agree with the answer: of a strip of L/W 5 that falls to its
# side (seed 151, 428), finite elements are 0.4 % of the length from the solid, and 7 % from the rod.
BROAD = 0.2
SLENDER = 10.0
# Contact and friction decide by single steps: there a change of the last bit grows at once. So a mirror image that is
# farther away is compared with what changes of the moduli by NOISE do.
NOISE = 1e-13
# of the largest displacement: second order, and what contact and friction choose by single steps
HALF_STEP = 0.02


SAME = np.eye(3)
LATE = "time over"


@dataclass
class Checked:
    """Checks that were done; wrong: checks that refute the answer, as text; branches: checks that found another equilibrium."""

    done: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    branches: list[str] = field(default_factory=list)


def checked(scene: Scene, result: Result, folder: Path, number: int) -> Checked:
    """The checks of a scene's answer, as many as the time allows (magmpm.scene.time_limit); the last one done is then LATE.

    folder: of the run's files; number: of the scene, which chooses among the costly checks.
    """
    found = Checked()
    _sane(result, found)
    try:
        scene = _as_solved(scene, result, found)
        if scene.solver.dynamic is not None:
            _moved(scene, result, folder, found)
        elif scene.solver.quasi_static is not None:
            _followed(scene, result, found)
        else:
            _at_rest(scene, result, number, found)
    except TimeOver:
        found.done.append(LATE)
    return found


def _as_solved(scene: Scene, result: Result, found: Checked) -> Scene:
    """The scene with the effects and the cells that were chosen; an error that was reported is compared with finer cells."""
    if scene.effects.auto:
        scene = choose_effects(scene).scene
    if not scene.resolution.requested:
        return scene
    assert result.resolution is not None
    cells = int(result.resolution["cells_across"])
    _promised(scene, result, cells, found)
    return scene.with_cells(cells)


def _promised(scene: Scene, result: Result, cells: int, found: Checked) -> None:
    """The reported error, against finer cells; where these are as far, only if the next finer ones are as well: one may be elsewhere."""
    promised = result.error_estimate
    tip = scene.resolution.of == "tip"
    assert promised is not None
    distances = []
    for more in (2, 3):
        finer = _try(scene.with_cells(cells + more))
        if finer is None or finer.jumps or result.jumps:
            return
        if tip:
            off = float(np.linalg.norm(tip_of(finer) - tip_of(result)))
        elif result.positions:
            off = float(np.linalg.norm(finer.segment_center - result.segment_center, axis=1).max())
        else:
            off = largest_distance(result, finer.centreline)
        distances.append(off)
        if distances[-1] <= 1.5 * promised:
            found.done.append("promised error")
            return
    found.done.append("promised error")
    found.wrong.append(
        f"promised error: {promised:.3g} m told, {distances[0]:.3g} and {distances[1]:.3g} m from 2"
        " and 3 more cells across"
    )


def _sane(result: Result, found: Checked) -> None:
    found.done.append("sane")
    if result.not_finite():
        found.wrong.append(f"not finite: {', '.join(result.not_finite())}")
    if not (result.converged and float(result.particle_det_F.min()) > 0.0):
        found.wrong.append(f"det F {result.particle_det_F.min():.3g}, converged {result.converged}")
    if result.stability is not None and not result.stability > -1e-3:
        found.wrong.append(f"unstable equilibrium: stability {result.stability:.3g}")


def _distance(scene: Scene, one: Result, other: Result, R: np.ndarray = SAME) -> float:
    """Largest distance, over L, of the ways that the middles of the regions have gone, and of tips if there are any: `one` as R maps it,
    from `other`.

    Ways, because whole cells make the regions of a magnetization profile: their middles are elsewhere on another grid.
    """
    ways = []
    for result in (one, other):
        of = result.particle_segment
        volume = result.particle_volume
        begun = [
            np.bincount(of, volume * x) / np.bincount(of, volume)
            for x in result.particle_reference.T
        ]
        gone = result.segment_center - np.stack(begun, axis=1)
        ways.append(gone if result.tip is None else np.vstack([gone, result.tip]))
    return float(np.linalg.norm(ways[0] @ R.T - ways[1], axis=1).max()) / scene.length


def _soft(result: Result) -> bool:
    """True if the result itself shows that a small change of the load may move it far: runs warn, and nothing is compared."""
    return result.stability is None or result.stability < BRINK


def _solved_as(scene: Scene, **static: Any) -> Scene:
    """The scene's equilibrium, at the end of its schedule, sought with these options."""
    return changed(
        scene, solver={"anti_locking": scene.to_si()["solver"]["anti_locking"], "static": static}
    )


def _try(scene: Scene) -> Result | None:
    try:
        return run(scene)
    except TimeOver:  # which tells nothing of the answer
        raise
    except SolveError:
        return None


def _compare(
    scene: Scene, name: str, one: Result, variant: Scene, found: Checked, R: np.ndarray = SAME
) -> bool:
    """Two solves of one discrete problem, the other that of the scene `variant`; whether it finds an answer. They may end at two
    equilibria, near each other or far away: then each stays where it is as it is sought more closely.
    """
    other = _try(variant)
    if other is None:
        return False
    found.done.append(name)
    off = _distance(scene, one, other, R)
    bound = _tolerance(scene, one)
    if off <= bound or (_soft(one) and _soft(other)):
        return True
    text = (
        f"{name}: {off:.3g} L apart, bound {bound:.3g}; energies {one.energy:.9g},"
        f" {other.energy:.9g} J"
    )
    if _stays(scene, one, bound) and _stays(variant, other, bound):
        found.branches.append(
            f"{text}; come to in another way, or more closely, each is where it was: two equilibria"
        )
    else:
        found.wrong.append(text)
    return True


def _stays(scene: Scene, result: Result, bound: float) -> bool:
    """True if the scene, solved more closely, gives the result again, in shape and energy."""
    closer = _try(_closer(scene))
    if closer is None or _distance(scene, result, closer) > bound:
        return False
    return abs(closer.energy - result.energy) <= max(1e-6, bound) * abs(closer.energy)


def _closer(scene: Scene) -> Scene:
    """The scene, its equilibrium solved more closely; or at the end of a path, come to by twice the steps."""
    data = scene.to_si()
    if scene.solver.quasi_static is not None:
        data["solver"]["quasi_static"] = {
            "duration": scene.duration,
            "steps": 2 * (len(scene.path_times()) - 1),
        }
    else:
        data["solver"]["static"]["tolerance"] = max(
            data["solver"]["static"]["tolerance"] / CLOSER, 1e-14
        )
    return Scene.from_si(data)


def _tolerance(scene: Scene, result: Result) -> float:
    table = TABLE if scene.field.magnet or scene.field.coils else 0.0
    return (SOLVED * max(1.0, _displaced(scene, result)) + table) / math.sqrt(
        max(result.stability or 0.0, BRINK)
    )


def _displaced(scene: Scene, result: Result) -> float:
    """Largest displacement by the load, over L."""
    return (
        float(np.linalg.norm(result.particle_position - result.particle_reference, axis=1).max())
        / scene.length
    )


def _twins(scene: Scene, result: Result, found: Checked) -> None:
    for name, R in (("mirror image", MIRROR), ("quarter turn", QUARTER)):
        if R is QUARTER and not can_turn(scene):
            continue
        if not _compare(scene, name, result, twin(scene, R), found, R):
            _stopped(scene, name, found)


def _stopped(scene: Scene, name: str, found: Checked) -> None:
    """A twin that finds no answer: a fault of symmetry, unless the scene itself finds none at changes of its last bits."""
    found.done.append(name)
    lost = sum(_try(noisy) is None for noisy in _noisy(scene))
    text = f"{name}: stopped; so do {lost} of 3 scenes with moduli changed by {NOISE:g}"
    (found.branches if lost else found.wrong).append(text)


def _at_rest(scene: Scene, result: Result, number: int, found: Checked) -> None:
    if _soft(result):  # nothing else is compared with it
        found.done.append("more closely")
        if not _stays(scene, result, bound := _tolerance(scene, result)):
            found.wrong.append(
                f"solved {CLOSER:g} times as closely, it is farther away than {bound:.3g} L"
            )
    _twins(scene, result, found)
    _rod(scene, result, found)
    if number % 3 == 0:
        _compare(scene, "ramped", result, _solved_as(scene, field_steps=6, max_steps=200), found)
    elif number % 3 == 1 and scene.resolution.cells_across < 4:
        _finer(scene, result, found)


def _doubted(result: Result) -> bool:
    """True if a warning casts doubt on the answer; that a part has no magnetization is no doubt."""
    return any("not magnetized" not in text for text in result.warnings)


def _finer(scene: Scene, result: Result, found: Checked) -> None:
    """One more cell across; where the finer answer is far away, it must be near an equilibrium of the coarse grid, found in another way."""
    other = _try(scene.with_cells(scene.resolution.cells_across + 1))
    if other is None or _soft(result) or _soft(other) or _doubted(result) or _doubted(other):
        return
    found.done.append("finer grid")
    off = _distance(scene, result, other)
    if off <= FINER:
        return
    for steps in (8, 30):
        ramped = _try(_solved_as(scene, field_steps=steps, max_steps=200))
        if (
            ramped is not None
            and _distance(scene, ramped, other) <= FINER
            and _stays(scene, result, _tolerance(scene, result))
        ):
            found.branches.append(
                f"finer grid: {off:.3g} L apart; a ramp of {steps} steps finds its branch on this"
                " grid"
            )
            return
    found.wrong.append(f"finer grid: {off:.3g} L apart, bound {FINER}")


def _rod(scene: Scene, result: Result, found: Checked) -> None:
    """A slender body is near the rod where the rod holds: no strain beyond the model's limits, no wall below a cell (both warn)."""
    if (
        scene.body.shape.line is None
        or scene.length < SLENDER * scene.thickness
        or _doubted(result)
        or _soft(result)
    ):
        return
    if scene.body.shape.clamp != "base" or scene.effects.magnetic_interaction is not None:
        return
    stiff = [scene.region_material(k).shear_modulus for k in range(len(scene.regions()))]
    strip = scene.body.strip
    wide = (
        strip is not None and strip.bends_as_plate and not strip.plane_strain
    )  # between beam and plate
    if max(stiff) > 20 * min(stiff) or wide:
        return
    try:
        rod = solve_rod(scene)
    except SolveError:
        return
    found.done.append("rod")
    tip = rod.position[-1] + np.array(scene.body.shape.line.base)
    off = float(np.linalg.norm(tip - result.tip)) / scene.length
    # two cells across 2 %, rod and solid 0.05 D/L, stiff neighbors 2 %; without anti-locking 4.1 % for 1.4 % (docs/stability, controls)
    known = 0.06 + (0.03 if scene.solver.anti_locking == "none" else 0.0)
    # the cells' stiffness is off by 2 % at two, and in proportion to their area: it moves a soft body by that fraction over its stability
    cells = (
        0.02
        * (2 / scene.resolution.cells_across) ** 2
        * _displaced(scene, result)
        / max(result.stability or 0.0, BRINK)
    )
    if off <= (bound := known + cells):
        return
    far = f"rod: tips {off:.3g} L apart, bound {bound:.3g}"
    finer = _try(scene.with_cells(scene.resolution.cells_across + 2))
    left = np.inf if finer is None else float(np.linalg.norm(tip - finer.tip)) / scene.length
    broad = (
        0.0
        if strip is None or strip.plane_strain
        else max(strip.width / scene.length - 1 / SLENDER, 0.0)
    )
    if (
        finer is not None
        and left <= known + BROAD * broad
        and _distance(scene, result, finer) <= FINER / 2
    ):
        found.branches.append(f"{far}; two more cells are {left:.3g} L from it")
    else:
        found.wrong.append(far)


def _followed(scene: Scene, result: Result, found: Checked) -> None:
    """Equilibria along time: the mirror image, and the equilibrium at the end, which the last of them must be unless there are several."""
    _twins(scene, result, found)
    if (
        scene.field.over_time is None
        or scene.field.over_time.endless is not None
        or scene.effects.feed is not None
    ):
        return
    _compare(scene, "statics at the end", result, _solved_as(scene), found)


def _moved(scene: Scene, result: Result, folder: Path, found: Checked) -> None:
    largest = _displaced(scene, result)
    _energy(scene, folder, found)
    other = _try(twin(scene, MIRROR))
    if other is None:
        _stopped(scene, "mirror image", found)
    else:
        found.done.append("mirror image")
        off = _distance(scene, result, other, MIRROR)
        table = TABLE if scene.field.magnet or scene.field.coils else 0.0
        if off > (bound := 1e-6 + table):  # rounding grows as a motion goes on
            grown = max(
                (
                    _distance(scene, result, noisy)
                    for noisy in map(_try, _noisy(scene))
                    if noisy is not None
                ),
                default=math.inf,
            )
            where = found.wrong if off > max(bound, 5.0 * grown) else found.branches
            where.append(
                f"mirror image: {off:.3g} L apart, bound {bound:.3g}; changes of {NOISE:g} of the"
                f" moduli grow to {grown:.3g} L"
            )
    options = scene.to_si()["solver"]["dynamic"]
    bound = HALF_STEP * largest + 1e-5
    if scene.effects.ground or scene.effects.walls or scene.effects.self_contact:
        bound += 1e-3  # at which step a point touches
    if scene.effects.feed:
        bound = 5 * HALF_STEP * largest + 1e-3  # each node that leaves a guide is a shock
    other = _try(
        changed(scene, solver={**scene.to_si()["solver"], "dynamic": {**options, "safety": 0.4}})
    )
    if other is not None:
        found.done.append("half the step")
        if (off := _distance(scene, result, other)) > bound:
            finer = _try(scene.with_cells(scene.resolution.cells_across + 1))
            coarse = (
                0.0 if finer is None else _distance(scene, result, finer)
            )  # a step that moves it less is as good as its grid
            text = (
                f"half the step: {off:.3g} L apart, bound {bound:.3g}; largest displacement"
                f" {largest:.3g} L; grid: {coarse:.3g} L"
            )
            (found.branches if off < coarse else found.wrong).append(text)


def _noisy(scene: Scene) -> list[Scene]:
    """The scene with moduli that differ from its own in the last bits."""
    found = []
    for change in (NOISE, -NOISE, 3 * NOISE):
        data = scene.to_si()
        for material in data["materials"].values():
            material["shear_modulus"] *= 1 + change
        found.append(Scene.from_si(data))
    return found


def _energy(scene: Scene, folder: Path, found: Checked) -> None:
    """Check that, where no load does work in time, the sum of all energies never exceeds that at first."""
    if (
        scene.field.over_time is not None
        or scene.effects.feed is not None
        or scene.effects.magnetic_interaction is not None
    ):
        return
    if scene.field.varies and scene.effects.magnetic_force is None:
        return
    with (folder / ENERGIES).open(encoding="utf-8", newline="") as stream:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(stream)]
    found.done.append("energy")
    most = max(row["kinetic"] + row["elastic"] for row in rows)
    gained = max(row["total"] for row in rows) - rows[0]["total"]
    if gained > 0.05 * most:  # as the watchdog allows
        found.wrong.append(
            f"energy: {gained:.3g} J gained, kinetic and elastic are {most:.3g} J at most"
        )
