"""Effects that a scene calls for: chosen for `effects: auto` by pairs of runs (solving.influence), and missed ones of motions reported."""

from dataclasses import dataclass, replace

from magmpm.compiled.arrays import Plain
from magmpm.errors import MagmpmError, SolveError
from magmpm.rod.cantilever import is_cantilever, weight_in_motion
from magmpm.scene import Scene
from magmpm.solving.influence import EffectRow, Variants, advise, variants
from magmpm.statics.unnamed_loads import SURE, missed

TRIED_LAST = (
    "self_contact",
)  # not among the effects in whose presence the others are tried: it acts in motion alone


@dataclass(frozen=True)
class EffectsChoice:
    """The scene with the chosen effects named; reasons: of each effect `effect`, `chosen`, `shift_m`, `uncertainty_m`, `why`."""

    scene: Scene
    reasons: list[Plain]


def choose_effects(scene: Scene) -> EffectsChoice:
    """The effects that move the answer of a scene with `effects: auto` by more than the error it requests, and what was found of each.

    Each is tried against a scene with all that can act; what is left out has to be settings, such as a wall's, that only a user can give.
    So is all that is left out, together: small shifts may add up. Where nothing can be estimated, of a motion that takes long, everything
    that can act without settings of its own is chosen, except self_contact.
    """
    bare = scene.with_effects(auto=None)
    possible = []
    found = {}
    for key in bare.effects.every():
        both = variants(bare, key)
        if isinstance(both, str):
            found[key] = EffectRow(key, False, 0.0, 0.0, "irrelevant", both)
        else:
            possible.append(key)
    every: Plain = {key: {} for key in possible if key not in TRIED_LAST}
    full, advised = _advised(bare, every, possible)
    found.update(advised)
    chosen = [key for key in possible if found[key].advice in ("keep", "add")]
    chosen += _together(full, [key for key in possible if key not in chosen], found)
    if (
        "magnetic_force" in chosen
        and "magnetic_torque" not in chosen
        and "magnetic_torque" in possible
    ):
        chosen.append("magnetic_torque")  # the two have one energy
    one_energy = (
        scene.static
        and full.field.varies
        and "magnetic_torque" in chosen
        and "magnetic_force" in possible
    )
    if one_energy and "magnetic_force" not in chosen:
        chosen.append("magnetic_force")
    reasons = [
        {
            "effect": key,
            "chosen": key in chosen,
            "shift_m": one.shift_m,
            "uncertainty_m": one.uncertainty_m,
            "why": one.why,
        }
        for key in bare.effects.every()
        for one in [found[key]]
    ]
    return EffectsChoice(bare.with_effects(**{key: {} for key in chosen}), reasons)


def _together(full: Scene, left: list[str], found: dict[str, EffectRow]) -> list[str]:
    """Effects to choose after all, of those left out one by one, where all of them together move the answer by more than it may.

    From the one with the largest shift on, until the rest moves it by less. What is found of them is noted.
    """
    left = sorted(
        (key for key in left if getattr(full.effects, key) is not None),
        key=lambda key: -(found[key].shift_m or 0.0),
    )
    if len(left) < 2:
        return []
    runs = Variants(full)
    chosen = []
    while left:
        without = full.model_copy(
            update={"effects": full.effects.model_copy(update=dict.fromkeys(left))}
        )
        try:
            moved = runs.shift(full, without).value
        except MagmpmError:  # where they act there is a rest and without them none, say: then nothing tells that they matter
            break
        if moved <= full.allowed_error:
            break
        key = left.pop(0)
        share = f"{100 * moved / full.length:.2g} % of its length"
        found[key] = replace(
            found[key], why=f"{found[key].why}; but with what else was left out, by {share}"
        )
        chosen.append(key)
    return chosen


def _advised(bare: Scene, every: Plain, possible: list[str]) -> tuple[Scene, dict[str, EffectRow]]:
    """The scene with every possible effect, and the advice on them in it."""
    full = bare.with_effects(**every)
    runs = Variants(full)
    try:
        runs.frames(full)
    except SolveError:  # of what can be left out of the others' trial, the segments on each other are the hardest to find a rest with
        if "magnetic_interaction" in every:
            fewer = {key: value for key, value in every.items() if key != "magnetic_interaction"}
            rest, advised = _advised(
                bare, fewer, [key for key in possible if key != "magnetic_interaction"]
            )
            return rest, {
                **advised,
                "magnetic_interaction": advise(rest, "magnetic_interaction", Variants(rest)),
            }
    return full, {key: advise(full, key, runs) for key in possible}


def missed_effects(scene: Scene) -> list[str]:
    """A warning where a motion does not name the weight of its body, which would move it by more than the error it requests.

    By its rod at rest, where nothing else holds the body than its clamp; equilibria say so themselves (statics.unnamed_loads).
    """
    named = scene.effects
    supported = any(getattr(named, key) is not None for key in ("ground", "walls", "feed"))
    if (
        scene.advice == "off"
        or named.auto
        or named.gravity is not None
        or scene.static
        or supported
        or not is_cantilever(scene)
    ):
        return []
    try:
        return (
            [missed(scene, "gravity")]
            if weight_in_motion(scene) > SURE * scene.allowed_error
            else []
        )
    except MagmpmError:
        return []
