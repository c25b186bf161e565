"""Which effects a scene calls for: chosen for `effects: auto`, and missed ones reported. Estimates are the rod's (magmpm.rod.advice)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from magmpm.errors import MagmpmError, SceneError, SolveError
from magmpm.rod.advice import Judgment, allowed_error, judge, unknown, variants, worth_naming
from magmpm.rod.shifts import RodAnswers, is_rod
from magmpm.scene import Scene

TRIED_LAST = ("self_contact",)  # not among the effects in whose presence the others are tried: it acts in motion alone


@dataclass(frozen=True)
class Choice:
    """The scene with the chosen effects named; told: of each effect `effect`, `chosen`, `shift_m`, `uncertainty_m`, `why`."""

    scene: Scene
    told: list[dict[str, Any]]


def choose_effects(scene: Scene) -> Choice:
    """The effects that move the answer of a scene with `effects: auto` by more than the error it requests, and what was found of each.

    Each is tried against a scene with all that can act; what is left out has to be settings, such as a wall's, that only a user can give.
    So is all that is left out, together: small shifts may add up. Where the body is no rod there is no estimate, and everything that can
    act without settings of its own is chosen, except self_contact.
    """
    bare = scene.with_effects(auto=None)
    possible, found = [], {}
    for key in bare.effects.every():
        both = variants(bare, key)
        if isinstance(both, str):
            found[key] = Judgment(key, False, 0.0, 0.0, "irrelevant", both)
        else:
            possible.append(key)
    every: dict[str, Any] = {key: {} for key in possible if key not in TRIED_LAST}
    full, judged = _judged(bare, every, possible)
    found.update(judged)
    chosen = [key for key in possible if found[key].advice in ("keep", "add")]
    chosen += _together(full, [key for key in possible if key not in chosen], found, allowed_error(bare))
    if "magnetic_force" in chosen and "magnetic_torque" not in chosen and "magnetic_torque" in possible:
        chosen.append("magnetic_torque")  # the two have one energy
    one_energy = scene.static and full.field.varies and "magnetic_torque" in chosen and "magnetic_force" in possible
    if one_energy and "magnetic_force" not in chosen:
        chosen.append("magnetic_force")
    told = [
        {"effect": key, "chosen": key in chosen, "shift_m": one.shift, "uncertainty_m": one.uncertainty, "why": one.why}
        for key, one in sorted(found.items(), key=lambda item: list(bare.effects.every()).index(item[0]))
    ]
    return Choice(bare.with_effects(**{key: {} for key in chosen}), told)


def _together(full: Scene, left: list[str], found: dict[str, Judgment], error: float) -> list[str]:
    """Effects to choose after all, of those left out one by one, where all of them together move the answer by more than it may.

    From the one with the largest shift on, until the rest moves it by less. What is found of them is noted.
    """
    left = sorted((key for key in left if getattr(full.effects, key) is not None), key=lambda key: -(found[key].shift or 0.0))
    if len(left) < 2 or not is_rod(full):
        return []
    answers, chosen = RodAnswers(full), []
    while left:
        without = full.model_copy(update={"effects": full.effects.model_copy(update=dict.fromkeys(left))})
        try:
            moved = answers.shift(full, without).value
        except MagmpmError:  # where they act there is a rest and without them none, say: then nothing tells that they matter
            break
        if moved <= error:
            break
        key, share = left.pop(0), f"{100 * moved / full.length:.2g} % of its length"
        found[key] = replace(found[key], why=f"{found[key].why}; but with what else was left out, by {share}")
        chosen.append(key)
    return chosen


def _judged(bare: Scene, every: dict[str, Any], possible: list[str]) -> tuple[Scene, dict[str, Judgment]]:
    """The scene with every possible effect, and the judgments of them in it."""
    full = bare.with_effects(**every)
    if not is_rod(full):
        why = "a body of this kind has no rod to estimate by"
        return full, {key: unknown(key, key not in TRIED_LAST, why) for key in possible}
    answers, error = RodAnswers(full), allowed_error(bare)
    try:
        answers.shapes(full)
    except SolveError:  # of what can be left out of the others' trial, the segments on each other are the hardest to find a rest with
        if "magnetic_interaction" not in every:
            raise
        fewer = {key: value for key, value in every.items() if key != "magnetic_interaction"}
        rest, judged = _judged(bare, fewer, [key for key in possible if key != "magnetic_interaction"])
        return rest, {**judged, "magnetic_interaction": judge(rest, "magnetic_interaction", RodAnswers(rest), error)}
    return full, {key: judge(full, key, answers, error) for key in possible}


def missed_effects(scene: Scene) -> list[str]:
    """Warnings, one for each effect that the scene does not name and that would move its answer by more than the error it requests."""
    if scene.advice == "off" or scene.effects.auto:
        return []
    try:
        found = worth_naming(scene)
    except (MagmpmError, SceneError):
        return []
    return [
        f"effects: {one.effect} is not named, and {one.why}; name it, or write `advice: off` to hear no more of it (`magmpm effects` "
        "says it of every effect)"
        for one in found
    ]


