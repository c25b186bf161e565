"""Reasons why a target was not reached: what holds the best design back, with the numbers that show it.

Read from the linear model of the best design (its residuals r and Jacobian J, trial.linear_model), from the other descents of the
Gauss-Newton sampler, and from the rod:

* a field or a number at its bound: at a minimum, rms changes with the bound by the Lagrange multiplier (r.J u)/rms, u pointing outward;
* curvature: a section can bend by at most the torque of all that is beyond it, sum of A Br/mu0 |B| l, and its weight times its distance,
  over E I; where the target bends more, no design follows it;
* a direction without effect: the largest change of the shape that turning it can make, per radian;
* where other starts ended.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from magmpm.compiled.arrays import Array, Plain
from magmpm.errors import SolveError
from magmpm.rod.cosserat import rod_model
from magmpm.scene import Scene
from magmpm.studies.engine.report import best_trial
from magmpm.studies.problem.study import Study
from magmpm.studies.rods.rod_designs import rod_designs
from magmpm.studies.search.parameters import FieldVector, SegmentDirection, VariedNumber
from magmpm.studies.search.samplers.blocks import Block
from magmpm.studies.search.samplers.gauss_newton import (
    LEAST_GAIN,
    RADIUS,
    model_of,
    start_of,
    value_of,
)
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial

Finding = Plain


def findings(study: Study, space: SearchSpace, trials: Sequence[FrozenTrial]) -> list[Finding]:
    """Find reasons why the best design is not better.

    Parameters
    ----------
    study : Study
        The study.
    space : SearchSpace
        Its search space.
    trials : sequence of FrozenTrial
        Finished ones.

    Returns
    -------
    list of Finding
        Dicts with `what`, the sentence `says`, and numbers in SI; none where the best design is
        near enough.
    """
    if len(study.minimize) > 1:  # a front says itself what more field brings
        return []
    best = best_trial(trials)
    good = (
        0.01 * space.scene.length if study.stop_rms is None else study.stop_rms
    )  # near enough to need no explanation
    if (
        best is None
        or value_of(best) <= good
        or "jacobian" not in best.user_attrs
        or study.depths
        or study.keyframes
    ):
        return []
    residuals, jacobian = model_of(best)
    coordinates = space.coordinates
    x = space.embedded(best.params)
    rms = float(np.linalg.norm(residuals))
    step = coordinates.step(x, residuals, jacobian, RADIUS / 4)
    kept = list[Finding]()
    if step.promised > LEAST_GAIN * rms**2:
        foreseen = float(np.sqrt(max(rms**2 - step.promised, 0.0)))
        says = (
            "the search was still getting better when its trials were used up: the next step"
            f" promises {_mm(foreseen)}"
        )
        kept.append({"what": "trials", "says": says, "rms_m": rms, "promised_rms_m": foreseen})
    kept += filter(
        None, (_bound(block, x[at], residuals @ jacobian[:, at] / rms) for block, at in space.parts)
    )
    if any(one["what"] == "field" for one in kept):
        kept += _stronger_field(study, space, good)
    kept += _curvature(study, space, best)
    basis = coordinates.tangent(x)[0]
    kept += _weak(space, jacobian @ basis, basis)
    return [*kept, *_other_starts(trials, best)]


def _mm(length: float) -> str:
    return f"rms {1e3 * length:.3g} mm"


def _bound(block: Block, x: Array, slope: Array) -> Finding | None:
    """Report a block that is at its bound and would gain beyond it; slope (size,): derivatives of the rms (m) by its coordinates."""
    at_bound = 0.999  # share of a bound that counts as being at it
    if isinstance(block, FieldVector):
        strength = float(np.linalg.norm(x))
        gain = -float(slope @ x) / max(strength, 1e-300)  # m/T
        if strength < at_bound * block.radius or gain <= 0.0:
            return None
        says = (
            f"{block.strength} is at its bound, {block.most:g} mT: to first order, each mT"
            " more would lower the rms "
            f"by {gain:.3g} mm"  # m/T is mm/mT
        )
        return {"what": "field", "says": says, "bound_T": block.radius, "rms_per_T": -gain}
    if isinstance(block, VariedNumber):
        at_end = (x[0] > at_bound and slope[0] < 0.0) or (x[0] < 1.0 - at_bound and slope[0] > 0.0)
        if not at_end:
            return None
        low, high = block.ends
        bound = high if x[0] > 0.5 else low
        per_unit = abs(float(slope[0]) / block.slope(x))
        says = (
            f"{block.name} is at its {'upper' if x[0] > 0.5 else 'lower'} bound,"
            f" {block.unit * bound:g}: to first order, going 1 beyond it would lower the rms by"
            f" {1e3 * per_unit / block.unit:.3g} mm"
        )
        return {"what": block.name, "says": says, "bound": bound, "rms_per_unit": -per_unit}
    return None


def _stronger_field(study: Study, space: SearchSpace, good: float) -> list[Finding]:
    """Report what the rod finds in stronger fields: what a field reaches, every stronger one reaches too."""
    assert space.field_max is not None
    scene = space.scene_at(space.middle)
    reached: list[tuple[float, float]] = []
    for factor in (1.0, 1.5, 2.0, 3.0):
        designs = rod_designs(
            scene,
            study.target,
            space.segments,
            factor * space.field_max,
            seed=study.seed,
            starts=16,
        )
        if designs:
            weaker = reached[-1][1] if reached else np.inf
            reached.append(
                (factor * space.field_max, min(weaker, *(design.rms for design in designs)))
            )
        if reached and reached[-1][1] <= good:
            break
    if not reached:
        return []
    text = ", ".join(f"{_mm(rms)} in {1e3 * field:g} mT" for field, rms in reached)
    return [
        {
            "what": "stronger field",
            "says": f"by the rod: {text}",
            "field_T": [f for f, _ in reached],
            "rms_m": [r for _, r in reached],
        }
    ]


def _curvature(study: Study, space: SearchSpace, best: FrozenTrial) -> list[Finding]:
    """The place where the target bends most beyond what the body can."""
    try:
        s, can = reachable_curvature(space.scene_of(best.params), space.field_max)
    except SolveError:
        return []
    ends, bends = target_bends(study.target, space.scene.length / 20)
    most = np.array([np.mean(np.interp(np.linspace(a, b, 9), s, can)) for a, b in ends])
    excess = (bends - most) * (ends[:, 1] - ends[:, 0])
    worst = int(np.argmax(excess))
    if excess[worst] < 0.02:  # rad
        return []
    a, b = 1e3 * ends[worst]
    says = (
        f"between s = {a:.3g} and {b:.3g} mm the target bends with a radius of"
        f" {1e3 / bends[worst]:.3g} mm; all segments beyond it together can bend the body to"
        f" {1e3 / most[worst]:.3g} mm there, in this field"
    )
    numbers = {
        "s_m": ends[worst].tolist(),
        "target_per_m": float(bends[worst]),
        "reachable_per_m": float(most[worst]),
    }
    return [{"what": "curvature", "says": says, **numbers}]


def reachable_curvature(scene: Scene, field_max: float | None) -> tuple[Array, Array]:
    """Find the largest curvature that torques and weight can give a body, whatever the directions.

    In the strongest field along the body's undeformed axis, or a uniform one.

    Parameters
    ----------
    scene : Scene
        The scene.
    field_max : float, T, or None
        Strength of the uniform field; None: the scene's own field.

    Returns
    -------
    s : array (n,), m
        Arc lengths.
    curvature : array (n,), 1/m
        The largest there.

    Raises
    ------
    SolveError
        Where other forces act.
    """
    others = ("magnetic_force", "magnetic_interaction", "walls", "ground", "self_contact")
    if any(getattr(scene.effects, name, None) is not None for name in others):
        raise SolveError("forces act that have no bound of their own")
    rod = rod_model(scene)
    field = np.linalg.norm(rod.field, axis=1).max() if field_max is None else field_max
    torque = np.linalg.norm(rod.moment, axis=1) * rod.length * field
    middle = np.cumsum(rod.length) - rod.length / 2
    weight = np.linalg.norm(rod.weight[:-1] - rod.weight[1:], axis=1)
    beyond = np.cumsum(torque[::-1])[::-1] - torque / 2
    lever = np.maximum(middle[None, :] - middle[:, None], 0.0) @ weight
    return middle, np.asarray((beyond + lever) / rod.twist_bend[:, 1:].min(axis=1))


def target_bends(target: Array, window: float) -> tuple[Array, Array]:
    """Find how a target bends; it leaves the origin along +x. A chord has the direction of the curve at its middle.

    Parameters
    ----------
    target : array (m, 4), m
        Rows [s, x, y, z].
    window : float, m
        Least distance of the rows that are taken.

    Returns
    -------
    ends : array (k, 2), m
        Of stretches of the target, by arc length.
    curvature : array (k,), 1/m
        Mean curvature of each.
    """
    rows = [np.zeros(4)]
    for row in target:
        if row[0] - rows[-1][0] >= window * (1 - 1e-9):
            rows.append(row)
    kept = np.array(rows)
    chords = np.diff(kept[:, 1:], axis=0)
    units = np.vstack([[1.0, 0.0, 0.0], chords / np.linalg.norm(chords, axis=1, keepdims=True)])
    at = np.concatenate([[0.0], (kept[1:, 0] + kept[:-1, 0]) / 2])
    sines = np.linalg.norm(np.cross(units[:-1], units[1:]), axis=1)
    angles = np.arctan2(sines, np.sum(units[:-1] * units[1:], axis=1))
    return np.column_stack([at[:-1], at[1:]]), angles / np.diff(at)


def _weak(space: SearchSpace, tangent: Array, basis: Array) -> list[Finding]:
    """Directions whose turning hardly moves the shape; tangent (m, q): Jacobian by steps of a radian, basis (size, q).

    Directions of a set jump from one to the next and have no derivative, so nothing can be said of them.
    """
    if space.limits is not None and space.limits.allowed is not None:
        return []
    found = []
    for name, (_, at) in zip(space.segment_names(), space.those(SegmentDirection), strict=True):
        columns = np.flatnonzero(np.any(basis[at] != 0.0, axis=0))
        moves = float(np.linalg.norm(tangent[:, columns], 2))
        if moves < 1e-3 * space.scene.length:
            says = (
                f"turning {name} by a radian moves the shape by {1e3 * moves:.2g} mm (rms) at"
                " most: it has no effect here"
            )
            found.append({"what": name, "says": says, "m_per_rad": moves})
    return found


def _other_starts(trials: Sequence[FrozenTrial], best: FrozenTrial) -> list[Finding]:
    """Report where the descents from other starts ended."""
    ends: dict[int, float] = {}
    for trial in trials:
        start = start_of(trial)
        if trial.user_attrs.get("feasible"):
            ends[start] = min(ends.get(start, np.inf), value_of(trial))
    ends.pop(start_of(best), None)
    if not ends:
        says = "no other start was tried: more trials would begin elsewhere"
        return [{"what": "other starts", "says": says, "rms_m": []}]
    values = sorted(ends.values())
    text = ", ".join(f"{1e3 * value:.3g}" for value in values[:6]) + (
        " ..." if len(values) > 6 else ""
    )
    says = f"{len(values)} other start{'s' if len(values) > 1 else ''} ended at rms {text} mm"
    return [{"what": "other starts", "says": says, "rms_m": values}]
