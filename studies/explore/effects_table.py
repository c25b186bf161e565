"""Estimates of what each effect would do to a scene at rest, whether it is named or not; and its cost in a step."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting as effects
from magmpm.effects.acting import NO_LOADS, Effects
from magmpm.effects.base import Effect
from magmpm.effects.estimates import MEASURE, no_rest
from magmpm.errors import MagmpmError, SolveError
from magmpm.fields.sources import FieldSource
from magmpm.model import build
from magmpm.results.readable import fixed, significant
from magmpm.rod.cantilever import first_frequency, is_cantilever
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.scene.coarsest import coarsest_cells
from magmpm.simulate import choose_effects, run
from magmpm.solving.influence import Judgment, Shift, Variants, judge, reason, verdict
from magmpm.studies.explore.beyond_effects import Need, needs
from magmpm.studies.explore.effects_costs import counted

SETTLING = ("damping", "viscosity")  # of which it is reported how fast they settle the body
CONTACTS = ("ground", "walls", "self_contact")
COARSE = 2  # cells across, of the run that stands in for a rod where the body is none


@dataclass(frozen=True)
class Row:
    """One effect.

    shift_m: the farthest that any point of the body's axis moves in the scene's answer, be it an equilibrium, equilibria along time or a
    motion, with the effect against without it; None: not known. uncertainty_m: of that. rest_m, motion_m: the same at rest and on the way.
    cost_percent: of a step without any effect; None if the effect takes no part in a step or was not measured. says: what the effect tells
    of the body's rest; ignores: what rest_m and says leave out of the scene: motion, schedule (the field before its end), feed, and contact
    by its effects' keys.
    """

    effect: str
    named: bool
    shift_m: float | None
    uncertainty_m: float | None
    rest_m: float | None
    motion_m: float | None
    cost_percent: float | None
    advice: str
    why: str
    says: str
    ignores: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Influence of {self.effect}: {_mm(self.shift_m)} mm +- {_mm(self.uncertainty_m)} mm; {self.advice}: {self.why}"


@dataclass(frozen=True)
class Table:
    """All effects, in the order of their phases. length_m: the body's, m; error_m: the error that advice is for; needs: beyond effects;
    moment: at which an endless field is evaluated at rest, in words."""

    scene: str
    length_m: float
    error_m: float
    effects: list[Row]
    needs: list[Need]
    moment: str | None = None

    def __repr__(self) -> str:
        """The table as the command prints it."""
        return f"Influence of effects on {self.scene!r}\n{self.text()}"

    def summary(self) -> dict[str, Any]:
        """Plain data, SI."""
        return asdict(self)

    def text(self, *, every: bool = False) -> str:
        """The table as text; effects that the scene names are marked. every: those that do not matter have rows too, not one line."""
        lines = [f"  {'effect':21} {'at rest mm':>10} {'in motion mm':>12} {'% of L':>7} {'+- mm':>8} {'cost %':>7}  advice"]
        little = [row for row in self.effects if not every and row.advice == "irrelevant" and not self._close(row)]
        for row in self.effects:
            if row in little:
                continue
            percent = None if row.shift_m is None else 100 * row.shift_m / self.length_m
            numbers = (
                f"{_mm(row.rest_m):>10} {_mm(row.motion_m):>12} {'-' if percent is None else significant(percent):>7} "
                f"{_mm(row.uncertainty_m):>8} {'-' if row.cost_percent is None else fixed(row.cost_percent, 0):>7}"
            )
            lines.append(f"{'*' if row.named else ' '} {row.effect:21} {numbers}  {row.advice}: {row.why}")
        share = significant(100 * self.error_m / self.length_m)
        return "\n".join(
            [
                *lines,
                *([f"  of no matter here: {', '.join(row.effect for row in little)} (--all says why)"] if little else []),
                "* named in the scene; mm: how far the axis moves with the effect against without it; +-: uncertainty; advice: for an "
                f"error of {_mm(self.error_m)} mm, {share} % of the length",
                *(f"  {need.question:21} {_needed(need)}" for need in self.needs),
                *([] if self.moment is None else [f"  at rest {self.moment}"]),
            ]
        )

    def _close(self, row: Row) -> bool:
        """True if an effect may matter, since its shift is known no better."""
        return row.shift_m is not None and row.uncertainty_m is not None and row.shift_m + row.uncertainty_m > self.error_m


def _needed(need: Need) -> str:
    """A row of what the scene needs beyond effects."""
    word = {True: "needed", False: "not needed", None: "not known"}[need.needed]
    saved = f"; without it some {significant(need.seconds_saved)} s less" if need.seconds_saved else ""
    added = f", {_mm(need.error_added_m)} mm more error" if saved and need.error_added_m is not None else ""
    return f"{word}: {need.why}{saved}{added}"


def _mm(way: float | None) -> str:
    return "-" if way is None else significant(1e3 * way)


class Estimates:
    """A scene's body, by its rod where it is straight and not held at both ends, else by a coarse static run
    (magmpm.effects.base.RestEstimate)."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        free = scene.body.shape.clamp == "none"  # of which nothing is reported at rest
        self.line = scene.body.shape.line if free or is_cantilever(scene) else None  # of its rod
        self._found: dict[str, Array] = {}

    def rest(self, scene: Scene) -> Array:
        """Points (m, 3) m of the body at equilibrium."""
        still = at_rest(scene)
        key = still.hash()
        if key not in self._found:
            if self.line is not None:
                self._found[key] = np.array(self.line.base) + solve_rod(still).position
            else:
                self._found[key] = run(still.with_cells(COARSE)).particle_position
        return self._found[key]

    @cached_property
    def frequency(self) -> float | None:
        """Frequency of the clamped rod, rad/s."""
        dense = all(self.scene.materials[p.material_name].density is not None for p in self.scene.regions())
        return None if self.line is None or self.scene.body.shape.clamp == "none" or not dense else first_frequency(self.scene)

    @property
    def half(self) -> float:
        """From the points that stand for the body to its surface, m."""
        return self.scene.thickness / 2 if self.line is not None else 0.0


def at_rest(scene: Scene) -> Scene:
    """The scene as an equilibrium: without the effects that only act in motion, and in a field whose schedule ends."""
    data = stopped(scene)[0].to_si()
    data["effects"] = {key: value for key, value in data["effects"].items() if key not in NO_LOADS}
    solver = {key: data["solver"][key] for key in ("anti_locking", "static")}
    return Scene.from_si({**data, "solver": solver, "reference": None})


def survey(scene: Scene, *, measure: bool = True, error: float | None = None, only: str | None = None) -> Table:
    """Every available effect, or only one, in this scene. measure: count costs too, else cost_percent is None. error: m, what the answer
    may be off by; what the scene's resolution requests, or 1 % of the length, unless given.

    Raises InputError if a run of the scene could not begin, for example because the body starts in the ground or outside its lumen.
    """
    error = error or scene.allowed_error
    if scene.effects.auto:
        scene = choose_effects(scene).scene
    if scene.resolution.asked:  # costs are those on the grid that such a run tries first
        scene = scene.with_cells(coarsest_cells(scene))
    _refuse_bad_beginning(scene)
    body, runs, rows = Estimates(scene), Variants(scene, error), []
    spent = counted(scene) if measure else {}
    for key, kind in effects.every().items():
        if only not in (None, key):
            continue
        named, found = getattr(scene.effects, key) is not None, judge(scene, key, runs)
        estimated = scene.body.shape.line is not None and (scene.in_time or key in NO_LOADS)
        at_rest_m, says = _judged(scene, body, key, kind) if estimated else (None, found.why)
        if found.shift is None and at_rest_m and key not in NO_LOADS and found.why.startswith("not estimated"):
            found = _by_rest(scene, key, at_rest_m, found, error)
        moving = found.shift if scene.in_time else None
        if not scene.in_time and found.shift is not None:
            at_rest_m = found.shift
        why = f"{found.why}; {says}" if key in SETTLING and found.shift is not None else found.why
        ignores = _ignored(scene, key) if at_rest_m else ()
        rows.append(Row(key, named, found.shift, found.uncertainty, at_rest_m, moving, spent.get(key), found.advice, why, says, ignores))
    try:
        moment = stopped(scene)[1]
    except MagmpmError:  # the rows say why
        moment = None
    return Table(scene.name, scene.length, error, rows, needs(scene, runs) if only is None else [], moment)


def _by_rest(scene: Scene, key: str, at_rest_m: float, found: Judgment, error: float) -> Judgment:
    """Advice where the shift in motion is not known: it follows from the shift at rest, whose uncertainty is the shift itself."""
    told = verdict(scene, key, Shift(at_rest_m, at_rest_m), error)
    return replace(told, shift=None, uncertainty=None, why=f"at rest {told.why}; in motion {found.why}")


def _refuse_bad_beginning(scene: Scene) -> None:
    """Raises InputError if an effect that the scene names can't begin, as magmpm.model.build does."""
    if any(type(effect).check is not Effect.check for effect in scene.effects.named().values()):
        bare = build(scene.model_copy(update={"effects": Effects()}))
        effects.check(replace(bare, scene=scene))


def _judged(scene: Scene, body: Estimates, key: str, kind: type[Effect]) -> tuple[float | None, str]:
    """An effect's shift, m, or None, and what to say of it."""
    why = no_rest(scene) if key not in NO_LOADS else None
    guess = f"not estimated: {why}; {MEASURE}"
    try:
        advice = kind.advice(scene, body)
    except SolveError as error:
        return None, guess if why else f"not known: {error.reason}"
    except MagmpmError as error:
        return None, f"not known: {reason(error)}"
    return (None, guess) if why and advice.shift else (advice.shift, advice.says)


def _ignored(scene: Scene, key: str) -> tuple[str, ...]:
    """List what the estimate of an effect leaves out of a scene in motion."""
    if scene.solver.dynamic is None or key == "feed":
        return ()
    over, named = scene.field.over_time, scene.effects
    found = [] if key in ("damping", "viscosity") else ["motion"]
    if found and over is not None and over.endless is None:
        found.append("schedule")
    return (*found, *(name for name in (*CONTACTS, "feed") if name != key and getattr(named, name) is not None))


ANGLES = 24  # of a turn, among which the moment is looked for


def stopped(scene: Scene) -> tuple[Scene, str | None]:
    """The scene with the endless parts of its field stopped at their strongest, and that moment in words; the scene and None if all end.

    An oscillation is stopped at its largest strength. A rotating field is stopped at the angle, among ANGLES, with the largest sum of
    |Br x B| over the segments, with B at the middle of the undeformed body. Parts that end are at their end, as in statics.
    """
    over = scene.field.over_time
    if over is None or over.endless is None:
        return scene, None
    data, words = scene.to_si(), []
    changed = data["field"]["over_time"]
    swing = over.oscillation
    if swing is not None and swing.cycles is None:
        top = np.pi / 2 if swing.mean * swing.amplitude >= 0 else -np.pi / 2
        changed["oscillation"]["cycles"] = (top - swing.phase) / (2 * np.pi) % 1.0 or 1.0
        words.append("at the largest of its swing")
    if over.rotation is not None and over.rotation.turns is None:
        angles = [1.0, *(np.arange(1, ANGLES) / ANGLES).tolist()]  # a whole turn is none
        torques = [_torque(scene, {**changed, "rotation": {**changed["rotation"], "turns": turns}}) for turns in angles]
        best = angles[int(np.argmax(np.array(torques) > (1 - 1e-9) * max(torques)))]
        changed["rotation"]["turns"] = best
        words.append(f"turned by {360 * (best % 1.0):g} deg, where its torque on the undeformed body is largest")
    return Scene.from_si(data), "the field, which has no end, is taken " + ", and ".join(words)


def _torque(scene: Scene, over_time: dict[str, object]) -> float:
    """Sum of |Br x B| over the segments, T^2, with B at the end of this schedule."""
    data = scene.field.model_dump(mode="json")
    source = FieldSource.model_validate({**data, "over_time": over_time})
    middle = np.mean(scene.box(), axis=0)
    B = replace(scene.outside_field(), source=source).at(middle)[0]
    return float(np.linalg.norm(np.cross(scene.region_remanence(), B), axis=1).sum())
