"""Influence of each effect on a scene's answer, whether the scene names it or not, and its cost in a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np

from magmpm.compiled.arrays import Array, Plain
from magmpm.effects import acting as effects
from magmpm.effects.acting import Effects
from magmpm.effects.base import Effect
from magmpm.errors import MagmpmError, fixed, significant
from magmpm.model import build
from magmpm.rod.cantilever import first_frequency, is_cantilever, without_motion
from magmpm.rod.cosserat import solve_rod
from magmpm.scene import Scene
from magmpm.scene.coarsest import coarsest_cells
from magmpm.simulate import choose_effects
from magmpm.solving.influence import EffectRow, Variants, advise, has_densities, in_mm
from magmpm.studies.explore.effects_costs import costs


@dataclass(frozen=True)
class Need:
    """One question. needed: None where it is not known; seconds_saved: by doing without (0: nothing to save), error_added_m: m, by that."""

    question: str
    needed: bool | None
    seconds_saved: float | None
    error_added_m: float | None
    why: str


def needs(scene: Scene, runs: Variants) -> list[Need]:
    """Answers to whether a scene needs three dimensions and dynamics, in seconds saved and error added.

    Seconds are told from those of the runs on coarse grids (Grids.takes), to a factor of two or three; errors by how far these are apart.
    """
    rod = scene.body.shape.line is not None and (not scene.static or is_cantilever(scene))
    no_rod = "" if rod else "the body is no rod"
    three = _need("three dimensions", scene, runs, no_rod, _three_dimensions)
    if scene.solver.dynamic is None:
        return [three, Need("dynamics", False, 0.0, 0.0, "the scene asks for equilibria")]
    held = " and ".join(
        key
        for key in ("walls", "ground", "self_contact")
        if getattr(scene.effects, key) is not None
    )
    if scene.body.shape.line is None or scene.body.shape.clamp == "none":
        held = held or "such a body"
    refused = f"{held}: equilibria may miss how it gets there" if held else ""
    return [three, _need("dynamics", scene, runs, refused, _dynamics)]


def _need(
    question: str,
    scene: Scene,
    runs: Variants,
    refused: str,
    off: Callable[[Scene, Variants], tuple[float, float, str]],
) -> Need:
    """The answer to a question, by how far the scene is off without (m), what it would still take (s), and words; refused: why not."""
    if refused:
        return Need(question, True, 0.0, None, refused)
    if runs.duration < scene.duration:
        return Need(question, None, None, None, "not estimated: a whole run takes too long")
    try:
        far, left, why = off(scene, runs)
    except MagmpmError as failure:
        return Need(question, None, None, None, f"not estimated: {failure}")
    if not far < runs.error:
        return Need(question, True, 0.0, far, why)
    return Need(question, False, max(_seconds(scene, runs) - left, 0.0), far, why)


def _seconds(scene: Scene, runs: Variants) -> float:
    """About what the whole run takes on the scene's cells, s, at the pace of the coarse runs, which have fewer moments of a path."""
    moments = len(scene.path_times()) / len(runs.frames(scene).times) if scene.path_times() else 1.0
    return moments * runs.takes(scene.resolution.cells_across, proof=False)


def _three_dimensions(scene: Scene, runs: Variants) -> tuple[float, float, str]:
    """A rod would do where what it is off by is less than the error: measured at rest, else guessed from how far the body bends."""
    measured = not scene.in_time
    shapes = np.array(runs.frames(scene, int(measured)).points)
    off = _off(scene, runs, shapes[0]) if measured else _guessed(scene, shapes)
    how = "is at most" if measured else "may be"
    why = (
        f"a rod would do for the shape of the axis, and {how}"
        if off < runs.error
        else f"a rod {how}"
    )
    flat = "; the axis stays in a plane" if _out_of_plane(shapes) < runs.error else ""
    slender = f"(L/D {scene.length / scene.thickness:.3g})"
    return off, 0.0, f"{why} off by {1e3 * off:.2g} mm{flat} {slender}"


def _off(scene: Scene, runs: Variants, axis: Array) -> float:
    """Distance (m) of the rod from the finer of two equilibria, with the distance of these."""
    rod = solve_rod(scene).at(np.linspace(0.0, scene.length, len(axis)))
    grids = max(runs.frames(scene).distances(runs.frames(scene, 1)).values())
    return grids + float(np.linalg.norm(axis - axis[0] - rod + rod[0], axis=1).max())


def _guessed(scene: Scene, shapes: Array) -> float:
    """Estimate the rod's error, m, from its deflection and the share of the length that the clamp stiffens (docs/effects.md)."""
    strip = scene.body.strip
    across = scene.thickness if strip is None else max(strip.width, strip.thickness)
    return (0.005 + 0.3 * across / scene.length) * _moved(shapes)


def _dynamics(scene: Scene, runs: Variants) -> tuple[float, float, str]:
    """Compare a motion with equilibria along time. Returns their distance (m), the seconds that the path takes, and the advice."""
    moving = runs.frames(scene)
    data = scene.to_si()
    times = moving.times[:: len(moving.times) // 5]
    data["solver"]["dynamic"], data["solver"]["quasi_static"] = None, {"at": times}
    for key, kind in scene.effects.every().items():
        data["effects"][key] = (
            None if kind.ONLY_IN_MOTION and not kind.ALONG_TIME else data["effects"][key]
        )
    still = Scene.from_si(data)
    resting = Variants(still)
    off = max(moving.distances(resting.frames(still)).values())
    if off < runs.error:
        why = "equilibria along time (solver.quasi_static) would do"
        return off, _seconds(still, resting), why
    return off, 0.0, "the body swings, or lags behind its equilibria"


def _moved(shapes: Array) -> float:
    """The farthest (m) any point of the axis is from where it would be straight."""
    straight = np.linspace(0.0, 1.0, shapes.shape[1])[None, :, None] * np.array([1.0, 0.0, 0.0])
    length = np.linalg.norm(np.diff(shapes[0], axis=0), axis=1).sum()
    return float(np.linalg.norm(shapes - shapes[:, :1] - length * straight, axis=2).max())


def _out_of_plane(shapes: Array) -> float:
    """The farthest (m) the axis leaves the plane through its base and x that fits it best."""
    yz = (shapes - shapes[:, :1])[..., 1:].reshape(-1, 2)
    normal = np.linalg.svd(yz, full_matrices=False)[2][-1]
    return float(np.abs(yz @ normal).max())


@dataclass(frozen=True)
class EffectsTable:
    """All effects, in the order of their phases. length_m: the body's, m; error_m: the error that advice is for; needs: beyond effects."""

    scene: str
    length_m: float
    error_m: float
    effects: list[EffectRow]
    needs: list[Need]

    def __repr__(self) -> str:
        """The table as the command prints it."""
        return f"Influence of effects on {self.scene!r}\n{self.text()}"

    def summary(self) -> Plain:
        """Plain data, SI."""
        return asdict(self)

    def text(self, *, every: bool = False) -> str:
        """The table as text; effects that the scene names are marked. every: those that do not matter have rows too, not one line."""
        lines = [
            f"  {'effect':21} {'moves mm':>8} {'% of L':>7} {'+- mm':>8} {'cost %':>7}  advice"
        ]
        little = [
            row
            for row in self.effects
            if not every and row.advice == "irrelevant" and not self._close(row)
        ]
        for row in self.effects:
            if row in little:
                continue
            percent = None if row.shift_m is None else 100 * row.shift_m / self.length_m
            numbers = (
                f"{in_mm(row.shift_m):>8} {'-' if percent is None else significant(percent):>7}"
                f" {in_mm(row.uncertainty_m):>8}"
                f" {'-' if row.cost_percent is None else fixed(row.cost_percent, 0):>7}"
            )
            lines.append(
                f"{'*' if row.named else ' '} {row.effect:21} {numbers}  {row.advice}: {row.why}"
            )
        if little:
            names = ", ".join(row.effect for row in little)
            lines.append(f"  negligible here: {names} (--all gives the reasons)")
        share = significant(100 * self.error_m / self.length_m)
        lines.append(
            "* named in the scene; mm: how far the axis moves with the effect against without it;"
            f" +-: uncertainty; advice: for an error of {in_mm(self.error_m)} mm, {share} % of the"
            " length"
        )
        lines += [f"  {need.question:21} {_needed(need)}" for need in self.needs]
        return "\n".join(lines)

    def _close(self, row: EffectRow) -> bool:
        """True if an effect may matter, since its shift is known no better."""
        return (
            row.shift_m is not None
            and row.uncertainty_m is not None
            and row.shift_m + row.uncertainty_m > self.error_m
        )


def _needed(need: Need) -> str:
    """A row of what the scene needs beyond effects."""
    word = {True: "needed", False: "not needed", None: "not known"}[need.needed]
    if not need.seconds_saved:
        return f"{word}: {need.why}"
    return (
        f"{word}: {need.why}; without it some {significant(need.seconds_saved)} s less,"
        f" {in_mm(need.error_added_m)} mm more error"
    )


def survey(
    scene: Scene, *, measure: bool = True, error: float | None = None, only: str | None = None
) -> EffectsTable:
    """Every available effect, or only one, in this scene. measure: time the costs too, else cost_percent is None. error: m, what the answer
    may be off by; what the scene's resolution requests, or 1 % of the length, unless given.

    Raises InputError if a run of the scene could not begin, for example because the body starts in the ground or outside its lumen.
    """
    error = error or scene.allowed_error
    if scene.effects.auto:
        scene = choose_effects(scene).scene
    if scene.resolution.requested:  # costs are those on the grid that such a run tries first
        scene = scene.with_cells(coarsest_cells(scene))
    if any(
        type(effect).check is not Effect.check for effect in scene.effects.named().values()
    ):  # that can't begin, as by model.build
        bare = build(scene.model_copy(update={"effects": Effects()}))
        effects.check(replace(bare, scene=scene))
    spent = costs(scene) if measure else {}
    runs = Variants(scene, error)
    rows = []
    still = Variants(without_motion(scene), error)
    held = scene.body.shape.clamp != "none" and scene.effects.feed is None
    for key in effects.Effects.every():
        if only in (None, key):
            found = advise(scene, key, runs)
            unknown = found.shift_m is None and found.advice == "irrelevant"
            if held and not scene.static and unknown:
                rest = advise(still.scene, key, still)
                if (
                    rest.advice == "add"
                ):  # the shift in motion is not known, but at rest it is more than the error
                    found = replace(
                        found, advice="add", why=f"at rest {rest.why}; in motion {found.why}"
                    )
            settles = (
                key in ("damping", "viscosity") and is_cantilever(scene) and has_densities(scene)
            )
            why = found.why + (_settling(scene, key) if settles else "")
            rows.append(replace(found, cost_percent=spent.get(key), why=why))
    return EffectsTable(
        scene.name, scene.length, error, rows, needs(scene, runs) if only is None else []
    )


def _settling(scene: Scene, key: str) -> str:
    """Report how fast an effect settles the first bending of a cantilever."""
    frequency = first_frequency(scene)
    named = getattr(scene.effects, key)
    if key == "damping":
        best = 2 * frequency
        of_best = (
            "" if named is None else f", {named.rate:.3g} 1/s is {named.rate / best:.2g} of that"
        )
        return f"; {best:.3g} 1/s settles its first bending soonest{of_best}"
    critical = (
        2
        * min(scene.materials[region.material_name].shear_modulus for region in scene.regions())
        / frequency
    )
    if named is None:
        return f"; {critical:.3g} Pa s damps its first bending critically"
    return f"; damps its first bending by {100 * named.viscosity / critical:.2g} % of critical"
