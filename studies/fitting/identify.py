"""Identifiability: what measurements can't distinguish, by the singular values of their slopes, and which measurement would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.errors import InputError, MagmpmError, report
from magmpm.scene import Scene
from magmpm.studies.fitting.constants import Constant
from magmpm.studies.fitting.prediction import Prediction
from magmpm.studies.fitting.solve import LeastSquares
from magmpm.studies.fitting.table import Measurements, Readings

# of the largest singular value: below, a direction moves nothing; slopes are exact to some 1e-8
LEAST_SINGULAR_VALUE = 1e-6
WIDEST_INTERVAL = (
    1.0  # in x: half a confidence interval longer than a factor of e (or a radian) tells nothing
)


class Refused(InputError):
    """Measurements that can't distinguish the constants.

    Parameters
    ----------
    place : str
        What is wrong.
    rule : str
        What must hold.
    remedy : str
        What to do.
    received : str, optional
        What was received.
    together : sequence of str, default ()
        Names of the constants of which only a combination is known.
    known : sequence of str, default ()
        What the data do say.
    advice : sequence of str, default ()
        Measurements that would tell.
    """

    def __init__(
        self,
        place: str,
        *,
        rule: str,
        remedy: str,
        received: str | None = None,
        together: Sequence[str] = (),
        known: Sequence[str] = (),
        advice: Sequence[str] = (),
    ) -> None:
        super().__init__(report(place, received=received, rule=rule, remedy=remedy))
        self.together = tuple(together)
        self.known = tuple(known)
        self.advice = tuple(advice)


def check_identifiable(
    scene: Scene,
    measured: Measurements,
    constants: Sequence[Constant],
    slopes: Array,
    quantile: float,
    noise: float,
    rms: float,
    *,
    differences: bool,
) -> None:
    """Refuse measurements where a combination of constants moves no measured number by more than its error.

    Parameters
    ----------
    scene : Scene
        The scene.
    measured : Measurements
        The measurements.
    constants : sequence of Constant
        The k constants.
    slopes : array (n, k)
        Of the residuals, in standard errors per x.
    quantile : float
        Half an interval, in standard errors.
    noise : float, m
        Standard deviation of a length.
    rms : float, m
        Of the residuals that are lengths.
    differences : bool
        Whether the slopes are differences of runs, and so less exact.

    Raises
    ------
    Refused
        Names the combination, and measurements that would tell.
    """
    _, values, right = np.linalg.svd(slopes, full_matrices=True)
    values = np.concatenate([values, np.zeros(len(right) - len(values))])
    least = (1e-3 if differences else LEAST_SINGULAR_VALUE) * values[0]
    lost = [
        k for k, value in enumerate(values) if value <= least or quantile / value > WIDEST_INTERVAL
    ]
    if not lost:
        return
    structural = all(values[k] <= least for k in lost)
    involved = [c for k, c in enumerate(constants) if any(abs(right[row, k]) > 0.3 for row in lost)]
    names = [c.name for c in involved]
    kept = [k for k in range(len(values)) if k not in lost]
    said = [_combination(constants, right[k], quantile / values[k]) for k in kept]
    advice = measurements_that_tell(scene, measured, constants, slopes, quantile, noise)
    one = len(names) == 1
    *others, last = [_plain(c) for c in involved]
    each = f"{', '.join(others)} and {last}" if others else last
    words = {"curve": "points", "several": "readings"}.get(measured.kind, measured.kind)
    rule = f"these {words} do not {'determine ' + each if one else 'separate ' + each}: "
    if structural:
        rule += (
            f"{'it' if one else 'they'} can change{'' if one else ' together'} without moving any"
            " measured number"
        )
    else:
        rule += (
            f"{'it' if one else 'they'} can change{'' if one else ' together'} {_far(involved)}"
            " within the errors of measurement"
        )
    if said:
        rule += f"; what they determine: {'; '.join(said)}"
    if rms > 0.02 * scene.length:  # no noise of a measurement
        rule += (
            f"; the scene is {1e3 * rms:.3g} mm (rms) from what was measured, so check first "
            "whether it names everything that acted in the experiment"
        )
    fewer = _fewer(constants, slopes, quantile, len(kept))
    loads = [c.name for c in involved if c.kind in ("remanence", "density")]
    remedy = f"--vary {fewer} and take the others from the scene" if fewer else "other data"
    if len(names) > 1 and any(c.relative for c in involved):
        remedy += (
            f"; or --known {(loads or [c.name for c in involved if c.relative])[0]}=2%, if it is"
            " known that well"
        )
    if advice:
        remedy += f"; or measure in addition: {'; or '.join(advice)}"
    raise Refused(
        measured.named, rule=rule, remedy=remedy, together=names, known=said, advice=advice
    )


def _plain(constant: Constant) -> str:
    """A constant in words: the soft tube's shear modulus."""
    variable = constant.variable
    words = constant.kind.replace("_", " ")
    if variable.material is not None:
        return f"the {variable.material}'s {words}"
    return f"the {words}" if constant.name == constant.kind else constant.name.replace("_", " ")


def _far(constants: Sequence[Constant]) -> str:
    """Describe the change of constants that noise hides (WIDEST_INTERVAL)."""
    ways = {
        "by a factor of 2.7": any(c.relative for c in constants),
        "by 57 degrees": any(c.kind == "magnetization" for c in constants),
        "by 1 mT": any(c.kind == "field" for c in constants),
    }
    return " or ".join(way for way, some in ways.items() if some) + " and more"


def _fewer(constants: Sequence[Constant], slopes: Array, quantile: float, count: int) -> str:
    """Names of at most `count` constants that the data tell if the others are taken as known."""
    kept: list[int] = []
    # remanence, density and fields can be measured by themselves: the others are kept first
    own = [
        k for k, c in enumerate(constants) if c.kind in ("shear_modulus", "damping", "viscosity")
    ]
    for left in (own, [k for k in range(len(constants)) if k not in own]):
        while left and len(kept) < count:
            basis = np.linalg.qr(slopes[:, kept])[0]
            unexplained = np.linalg.norm(
                slopes - basis @ (basis.T @ slopes), axis=0
            )  # by what the kept ones do not explain
            best = max(left, key=lambda k: unexplained[k])
            if unexplained[best] * WIDEST_INTERVAL < quantile:
                break
            kept.append(best)
            left.remove(best)
    return ",".join(constants[k].name for k in sorted(kept))


def _combination(constants: Sequence[Constant], direction: Array, width: float) -> str:
    """A direction of x that the data do tell, as a product of powers, with its relative interval."""
    size = np.max(np.abs(direction))
    parts = [
        (c.name, float(v / size))
        for c, v in zip(constants, direction, strict=True)
        if abs(v) > 0.05 * size
    ]
    if parts[0][1] < 0:
        parts = [(name, -power) for name, power in parts]
    if all(c.relative for c in constants if any(name == c.name for name, _ in parts)):
        words = " * ".join(
            name if abs(power - 1) < 0.02 else f"{name}^{power:.2g}" for name, power in parts
        )
        return f"{words}, to {100 * width / size:.2g} %"
    words = " ".join(f"{power:+.2g} {name}" for name, power in parts)
    return f"{words}, to {width / size:.2g}"


@dataclass(frozen=True)
class _Candidate:
    """A further measurement: in words, and its slopes (m, k) in standard errors per x."""

    words: str
    slopes: Array


def measurements_that_tell(
    scene: Scene,
    measured: Measurements,
    constants: Sequence[Constant],
    slopes: Array,
    quantile: float,
    noise: float,
) -> list[str]:
    """Find measurements that would distinguish the constants together with those there are.

    Parameters
    ----------
    scene : Scene
        The scene.
    measured : Measurements
        The measurements there are.
    constants : sequence of Constant
        The k constants.
    slopes : array (n, k)
        Of the residuals, in standard errors per x.
    quantile : float
        Half an interval, in standard errors.
    noise : float, m
        Standard deviation of a length.

    Returns
    -------
    list of str
        In words, best first, with the intervals that they would give.
    """
    noise = max(noise, 1e-3 * scene.length)
    candidates = [*_shapes(scene, measured, constants, noise), *_numbers(constants)]
    rated = []
    for candidate in candidates:
        both = np.concatenate([slopes, candidate.slopes])
        values = np.linalg.svd(both, compute_uv=False)
        if len(values) < len(constants) or values[-1] <= LEAST_SINGULAR_VALUE * 10 * values[0]:
            continue
        widths = 1.96 * np.sqrt(np.diag(np.linalg.inv(both.T @ both)))
        if widths.max() < WIDEST_INTERVAL / 2:
            rated.append((float(widths.max()), candidate.words, widths))
    rated.sort(key=lambda one: one[0])
    return [f"{words} ({_widths(constants, widths)})" for _, words, widths in rated[:4]]


def _widths(constants: Sequence[Constant], widths: Array) -> str:
    parts = []
    for constant, width in zip(constants, widths, strict=True):
        if constant.relative:
            parts.append(f"{constant.name} to {100 * width:.2g} %")
        else:
            size = (
                f"{np.degrees(width):.2g} deg"
                if constant.kind == "magnetization"
                else f"{width:.2g} mT"
            )
            parts.append(f"{constant.name} to {size}")
    return ", ".join(parts[:4]) + (" ..." if len(parts) > 4 else "")


def _shapes(
    scene: Scene, measured: Measurements, constants: Sequence[Constant], noise: float
) -> list[_Candidate]:
    """Tips of the body under other loads, with their slopes from the simulation."""
    if scene.in_time:
        return []
    found = []
    size = 1e3 * noise
    dense = all(material.density is not None for material in scene.materials.values())
    if dense and scene.effects.gravity is None:
        words = (
            f"the tip under its own weight without field, held level, to {size:.2g} mm (name"
            " gravity in the scene)"
        )
        found.append((words, scene.with_effects(gravity={}).with_field([0.0, 0.0, 0.0])))
    elif dense:
        found.append(
            (
                f"the tip under its own weight without field, to {size:.2g} mm",
                scene.with_field([0.0, 0.0, 0.0]),
            )
        )
    strongest = (
        max(
            (float(np.linalg.norm(s.field or scene.field.uniform)) for s in measured.states),
            default=0.0,
        )
        or 5e-3
    )
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        words = f"the tip in a field of {1e3 * strongest:.3g} mT along {axis}, to {size:.2g} mm"
        found.append((words, scene.with_field(strongest * direction)))
    nan = np.full(1, np.nan)
    reading = Readings(None, None, np.array([0]), nan, np.zeros((1, 3)), nan)
    candidates = []
    for words, other in found:
        try:
            table = Measurements(measured.path, "tips", (reading,), (), (0, 1, 2))
            _, jacobian = Prediction(other, table, tuple(constants)).at(np.zeros(len(constants)))
        except MagmpmError:
            continue
        candidates.append(_Candidate(words, jacobian / noise))
    return candidates


def _numbers(constants: Sequence[Constant]) -> list[_Candidate]:
    """Numbers that depend on the constants by a power: a body's moment, its bending by a known weight, its natural frequency."""
    found = []
    for words, exact, powers in (
        ("the body's magnetic moment, by a magnetometer to 2 %", 0.02, {"remanence": 1.0}),
        (
            "the sag of the tip under a known weight hung on it, to 2 %",
            0.02,
            {"shear_modulus": -1.0},
        ),
        (
            "the natural frequency of its bending, to 2 %",
            0.02,
            {"shear_modulus": 0.5, "density": -0.5},
        ),
        ("its mass, to 1 %", 0.01, {"density": 1.0}),
    ):
        row = np.array([powers.get(c.kind, 0.0) for c in constants]) / exact
        same_kind = max([sum(c.kind == kind for c in constants) for kind in powers], default=0)
        if row.any() and same_kind <= 1:
            found.append(_Candidate(words, row[None]))
    return found


def refuse_twins(
    constants: Sequence[Constant],
    best: LeastSquares,
    others: Sequence[LeastSquares],
    quantile: float,
) -> None:
    """Refuse measurements that another minimum explains about as well: its constants would be in the confidence region.

    Parameters
    ----------
    constants : sequence of Constant
        The constants.
    best : LeastSquares
        The best minimum, in standard errors.
    others : sequence of LeastSquares
        Other minima, in standard errors.
    quantile : float
        Half an interval, in standard errors.

    Raises
    ------
    Refused
        Names the constants of the other minimum.
    """
    for other in others:
        far = (
            float(np.max(np.abs(other.x - best.x))) > 0.05
            and float(np.linalg.norm(best.slopes @ (other.x - best.x))) > 3 * quantile
        )
        if far and other.converged and other.cost < best.cost + quantile**2:
            remedy = (
                "measure further coordinates, or at another field (a weaker one bends less, and has"
                " one answer)"
            )
            raise Refused(
                "the measurements",
                rule="two sets of constants explain the data equally well:"
                f" {_in_words(constants, best.x)} or {_in_words(constants, other.x)}",
                remedy=remedy,
                together=[c.name for c in constants],
                advice=["a weaker field"],
            )


def _in_words(constants: Sequence[Constant], x: Array) -> str:
    return ", ".join(
        f"{c.name} = {c.value(float(number)):.4g} {c.unit}"
        for c, number in zip(constants, x, strict=True)
    )
