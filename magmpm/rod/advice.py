"""Advice on the effects of a scene: whether each moves the answer by more than the error that the scene requests.

The answer is the axis, at its equilibrium, along its equilibria in time or on its way, as the scene is solved. An effect that the scene
does not name is tried with its usual settings, where it has them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, MagmpmError, SceneError, SolveError
from magmpm.rod.shifts import RodAnswers, Shift, is_rod
from magmpm.scene import Scene

USUAL = 0.01  # of the length: the error meant where a scene requests none
APART = 2.5  # thicknesses along the axis: points nearer than that are neighbors
TOUCHES = 20  # moments at which a body is looked at for touching itself
FINE = 4  # points between two stations, where a body may touch itself
REACH = 2.5  # lengths: two shapes of a held body that does not stretch are at most 2 from each other
WITHIN = ("magnetic_interaction", "viscosity", "self_contact")  # what a body does to itself does not move its center, held or not
MUTUAL = 0.6  # of a shift by the segments' field on each other, in large blocks: its uncertainty
Word = Literal["keep", "drop", "add", "irrelevant"]


@dataclass(frozen=True)
class Judgment:
    """Advice on one effect: shift of the scene's answer, m, with its uncertainty, m (None: not known), what to do, and why, as text."""

    effect: str
    named: bool
    shift: float | None
    uncertainty: float | None
    advice: Word
    why: str


def allowed_error(scene: Scene) -> float:
    """The error that a scene requests, m; USUAL of its length where it requests none."""
    return scene.resolution.allowed(scene.length) or USUAL * scene.length


def variants(scene: Scene, key: str) -> tuple[Scene, Scene] | str:
    """The scene with an effect and without it; or why the effect can't act in it, in words."""
    kind, named = scene.effects.every()[key], getattr(scene.effects, key)
    along_time = scene.solver.quasi_static is not None and kind.ALONG_TIME
    if scene.solver.dynamic is None and kind.ONLY_IN_MOTION and not along_time:
        return "it acts in motion only"
    needed = [name for name, field in kind.model_fields.items() if field.is_required()]
    if named is None and needed:
        return f"the scene does not say its {' and '.join(needed)}"
    if key in _WHERE and named is None:
        return f"the scene does not say its {_WHERE[key]}"
    try:
        if key == "magnetic_force" and scene.effects.magnetic_torque is None:
            scene = scene.with_effects(magnetic_torque={})  # the two have one energy
        having = scene if named is not None else _naming(scene, key, kind)
        if key != "self_contact" and not getattr(having.effects, key).records(having, 1.0, np.zeros(1) if scene.in_time else None):
            return "nothing here that it could act on"
        return having, scene.model_copy(update={"effects": scene.effects.model_copy(update={key: None})})
    except InputError as error:
        return reason(error)


_LOADS = ("magnetic_torque", "magnetic_force", "magnetic_interaction", "gravity", "damping", "viscosity")
IN_RODS = frozenset((*_LOADS, "ground", "walls", "self_contact", "feed"))  # effects that rods have; not those that users add
_WHERE = {"walls": "tube or surface", "viscosity": "viscosity or branches"}  # settings of which one is needed


def _naming(scene: Scene, key: str, kind: Any) -> Scene:
    """The scene with an effect named by its usual settings. Raises InputError where it lacks what the effect needs: a density, say.

    Without the other rules of scenes, which take a millisecond and which the scene has passed.
    """
    if key == "gravity" and any(scene.materials[region.material_name].density is None for region in scene.regions()):
        raise SceneError("materials", found="a material has no density", rule="gravity needs one", remedy="add it")
    return scene.model_copy(update={"effects": scene.effects.model_copy(update={key: kind()})})


def judge(scene: Scene, key: str, answers: RodAnswers, error: float) -> Judgment:
    """Evaluate one effect, whether the scene names it or not, and say what to do; error: m, that the answer may have."""
    named = getattr(scene.effects, key) is not None
    both = variants(scene, key)
    if isinstance(both, str):
        return Judgment(key, named, 0.0, 0.0, "drop" if named else "irrelevant", both)
    if meets(scene):
        return unknown(key, named, "rods at rest do not know what they touch")
    if key not in IN_RODS:
        return unknown(key, named, "rods do not have this effect")
    try:
        moved = _touches(answers, both) if key == "self_contact" else answers.shift(*both)
        if key == "magnetic_interaction":
            moved = replace(moved, uncertainty=max(moved.uncertainty, MUTUAL * moved.value))
    except SolveError as trouble:
        return unknown(key, named, trouble.reason)
    except MagmpmError as trouble:
        return unknown(key, named, reason(trouble))
    held = scene.body.shape.clamp != "none" or key in WITHIN
    if held and not moved.value < REACH * scene.length:
        return unknown(key, named, "the rod's answer flies apart")
    return verdict(scene, key, moved, error)


def verdict(scene: Scene, key: str, moved: Shift, error: float) -> Judgment:
    """The judgment of a shift."""
    named, matters = getattr(scene.effects, key) is not None, moved.value > error
    word: Word = ("keep" if matters else "drop") if named else ("add" if matters else "irrelevant")
    near = " (close: within what the estimate is uncertain by)" if abs(moved.value - error) < moved.uncertainty else ""
    why = f"it moves the answer by {_percent(moved.value, scene)}, {'more' if matters else 'less'} than {_percent(error, scene)}{near}"
    return Judgment(key, named, moved.value, moved.uncertainty, word, why)


def unknown(key: str, named: bool, why: str) -> Judgment:
    """Advice where no estimate can be had: a named effect stays."""
    return Judgment(key, named, None, None, "keep" if named else "irrelevant", f"not estimated: {why}")


def meets(scene: Scene) -> bool:
    """True if a scene at rest names obstacles, which rods at rest do not know."""
    return scene.solver.dynamic is None and any(getattr(scene.effects, key) is not None for key in ("ground", "walls"))


def worth_naming(scene: Scene) -> list[Judgment]:
    """The effects that a scene does not name and that would move its answer by more than the error it requests, found quickly.

    Only those of which that is certain: by more than the estimate may be off.
    """
    if not is_rod(scene) or meets(scene):
        return []
    answers, error = RodAnswers(scene, quick=True), allowed_error(scene)
    found = [judge(scene, key, answers, error) for key in scene.effects.every() if getattr(scene.effects, key) is None]
    return [one for one in found if one.shift is not None and one.uncertainty is not None and one.shift - one.uncertainty > error]


def _touches(answers: RodAnswers, both: tuple[Scene, Scene]) -> Shift:
    """Depth (m) to which the body would go through itself without contact; 0 where it does not."""
    thickness = both[1].thickness
    shapes = answers.shapes(both[1], answers.coarser)
    looked = shapes[:: max(1, len(shapes) // TOUCHES)]
    depth = max(0.0, *(thickness - nearest(shape, thickness) for shape in looked))
    return Shift(depth, 0.1 * thickness if depth > 0 else 0.0)


def nearest(axis: Array, thickness: float) -> float:
    """Smallest distance (m) between points of an axis (m, 3) m that are no neighbors along it; inf where there are none."""
    at = np.linspace(0.0, len(axis) - 1.0, FINE * (len(axis) - 1) // 2 + 1)
    points = np.stack([np.interp(at, np.arange(len(axis)), axis[:, i]) for i in range(3)], axis=1)
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    square = (points**2).sum(axis=1)
    apart = square[:, None] + square[None, :] - 2.0 * points @ points.T
    apart[np.abs(s[:, None] - s[None, :]) < APART * thickness] = np.inf
    return float(np.sqrt(max(apart.min(), 0.0)))


def reason(error: MagmpmError) -> str:
    """The reason in one line of whole words: what was found, or else the rule that was broken; received values may be cut."""
    if isinstance(error, SceneError) and error.found is not None:
        return f"{error.key}: {error.found}"
    lines = str(error).splitlines()
    return next((line.strip().removeprefix("rule: ") for line in lines if line.startswith("  rule: ")), lines[0])


def _percent(way: float, scene: Scene) -> str:
    """A length as a fraction of the body's: "1.2 % of its length"."""
    share: Any = 100 * way / scene.length
    return f"{share:.0f} % of its length" if share >= 99.5 else f"{share:.2g} % of its length"
