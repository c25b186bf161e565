"""Suspects that a fit takes as exact: a stray field, the direction of a region, the diameter. Would an error of one explain the residuals?

To first order: residuals r and slopes J at the minimum, slopes S of what was not varied, less what the constants can do in its place,
A = S - J J^+ S. Freed, it lowers the sum of squares by the squared projection of r on A, which for normal errors has an F distribution
(chi-square where the noise is given); probabilities are times the number of suspects. Below DOUBTED, intervals are widened to hold the
answers with the suspects freed (as if known to WIDEST_INTERVAL / 2, fitted anew) as well, and withheld where the data then determine no
constant.
Source: Seber and Lee, Linear Regression Analysis (2003), section 4.3.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.errors import InputError
from magmpm.scene import Scene
from magmpm.studies.fitting.constants import GEOMETRY, Constant, constants_of, diameter_of
from magmpm.studies.fitting.identify import LEAST_SINGULAR_VALUE, WIDEST_INTERVAL
from magmpm.studies.fitting.prediction import Label, Prediction
from magmpm.studies.fitting.solve import Interval, LeastSquares, least_squares, quantile_of
from magmpm.studies.fitting.table import Measurements

# probability below which a suspect widens the intervals: of true models one in twenty is doubted in
# vain
DOUBTED = 0.05


@dataclass(frozen=True)
class Suspect:
    """Something taken as exact, of q numbers, with the answer in which it is freed.

    Attributes
    ----------
    name : str
        In words.
    constants : tuple of Constant
        Of the fit, then its own.
    probability : float
        That chance explains as much.
    x : array (k + q,), no unit
        Numbers of the fit's constants and of its own, with it freed where it is doubted.
    errors : array (k,), no unit
        Standard errors of the fit's.
    degrees : float
        Of freedom; inf where the noise is given.
    spread : float, no unit
        Variance of the residuals that are left.
    """

    name: str
    constants: tuple[Constant, ...]
    probability: float
    x: Array
    errors: Array
    degrees: float
    spread: float

    def warning(self) -> str:
        """Warn of it.

        Returns
        -------
        str
            One sentence.
        """
        both = zip(self.constants, self.x.tolist(), strict=True)
        parts = [
            f"{one.name} {one.shown[0] * one.value(number):.3g} {one.shown[1]}"
            for one, number in both
        ]
        own = len(self.constants) - (len(self.x) - len(self.errors))
        return (
            f"{self.name} ({', '.join(parts[own:])}) explains the residuals better than chance "
            f"(F-test, p = {self.probability:.1g}), with {', '.join(parts[:own])}: the scene "
            "lacks this or something similar; the intervals cover both fits"
        )

    def widened(self, intervals: Sequence[Interval], level: float) -> list[Interval]:
        """Widen intervals so that they hold those of the answer in which it is freed.

        Parameters
        ----------
        intervals : sequence of Interval
            Of the k constants.
        level : float, no unit
            Of the intervals.

        Returns
        -------
        list of Interval
            The wider ones.
        """
        found = []
        halves = quantile_of(level, self.degrees) * self.errors
        for one, x, half in zip(intervals, self.x.tolist(), halves.tolist(), strict=False):
            low = None if one.low is None else min(one.low, x - half)
            high = None if one.high is None else max(one.high, x + half)
            known = half <= WIDEST_INTERVAL and one.method != "withheld"
            found.append(
                Interval(low, high, "widened") if known else Interval(None, None, "withheld")
            )
        return found


def suspects_of(
    prediction: Prediction, best: LeastSquares, weights: Array, degrees: int, known_noise: bool
) -> tuple[tuple[Suspect, ...], dict[str, NamedNumbers]]:
    """Find what may not be exact, and how it would move the constants.

    Parameters
    ----------
    prediction : Prediction
        Of the residuals.
    best : LeastSquares
        The minimum, in standard errors.
    weights : array (n,)
        Inverses of the standard errors of what was measured.
    degrees : int
        Of freedom.
    known_noise : bool
        Whether the noise is given.

    Returns
    -------
    suspects : tuple of Suspect
        Likeliest first.
    moves : dict[str, dict[str, float]]
        By kind of suspect and name of constant, the fraction by which that moves for a fraction
        of the diameter, 1 mT or 1 rad: the most, in any direction of these and of any segment.
    """
    constants = prediction.constants
    k = len(prediction.constants)
    groups = list(_groups(prediction.scene, constants))
    freed = tuple(constant for _, group in groups for constant in group)
    slopes = best.slopes.copy()
    if freed:
        wide = replace(prediction, constants=(*constants, *freed), solves=0)
        slopes = np.zeros(
            (len(best.residuals), k + len(freed))
        )  # what is known beforehand stands in the last rows
        slopes[: len(weights), k:] = (
            wide.at(np.concatenate([best.x, np.zeros(len(freed))]))[1][:, k:] * weights[:, None]
        )
        slopes[:, :k] = best.slopes
        prediction.solves += wide.solves
    moved = -np.linalg.lstsq(best.slopes, slopes, rcond=None)[0]
    left = slopes + best.slopes @ moved
    found = []
    moves = dict[str, NamedNumbers]()
    for name, group in groups:
        at = [k + freed.index(constant) for constant in group]
        sizes = (moved[:, at[0]] if len(at) == 1 else np.linalg.norm(moved[:, at], axis=1)).tolist()
        most = moves.setdefault(group[0].kind, {})
        most |= {
            c.name: max(most.get(c.name, 0.0), size, key=abs)
            for c, size in zip(constants, sizes, strict=False)
            if c.relative
        }
        basis, sizes, _ = np.linalg.svd(left[:, at], full_matrices=False)
        basis = basis[:, sizes > LEAST_SINGULAR_VALUE * np.linalg.norm(slopes[:, at])]
        explained = float(np.sum((basis.T @ best.residuals) ** 2))
        count = basis.shape[1]
        if count == 0 or degrees <= count:
            continue
        remaining = np.inf if known_noise else degrees - count
        spread = 1.0 if known_noise else max((best.cost - explained) / remaining, 1e-300)
        about = np.append(best.x, np.zeros(len(at))), np.full(k, np.nan), remaining, spread
        found.append(
            Suspect(
                name, (*constants, *group), _chance(count, remaining, explained, spread), *about
            )
        )
    found = sorted(
        (replace(one, probability=min(1.0, len(found) * one.probability)) for one in found),
        key=attrgetter("probability"),
    )
    for _ in found:  # one that explains less than it seemed to leaves others in doubt
        chosen = [
            (
                _settled(one, prediction, best, weights, len(found))
                if np.isnan(one.errors).all()
                else one
            )
            for one in doubted(found)
        ]
        found = sorted((*chosen, *found[len(chosen) :]), key=attrgetter("probability"))
    return tuple(found), moves


def _chance(count: int, degrees: float, explained: float, spread: float) -> float:
    """Probability that chance explains so much of a sum of squares by so many numbers."""
    from scipy.special import chdtrc, fdtrc  # what scipy.stats calls, without its half second

    return float(
        chdtrc(count, explained)
        if np.isinf(degrees)
        else fdtrc(count, degrees, explained / count / spread)
    )


def doubted(suspects: Sequence[Suspect]) -> list[Suspect]:
    """Find the suspects that explain the residuals better than chance does, without those to which the likeliest is by as much to be
    preferred.

    Parameters
    ----------
    suspects : sequence of Suspect
        Likeliest first.

    Returns
    -------
    list of Suspect
        Those that are doubted, likeliest first.
    """
    return [
        one
        for one in suspects
        if one.probability < DOUBTED and DOUBTED * one.probability <= suspects[0].probability
    ]


def _settled(
    one: Suspect, prediction: Prediction, best: LeastSquares, weights: Array, tried: int
) -> Suspect:
    """The suspect with the answer to which a descent leads, and its probability there: some degrees are no longer of first order."""
    k = len(one.errors)
    extra = len(one.x) - len(one.errors)
    wide = replace(prediction, constants=one.constants, solves=0)
    loose = np.sqrt(one.spread) / (WIDEST_INTERVAL / 2) * np.eye(len(one.x))[k:]
    below = np.vstack(
        [np.pad(best.slopes[len(weights) :], ((0, 0), (0, extra))), loose]
    )  # what is known beforehand

    def model(x: Array, slopes: bool) -> tuple[Array, Array]:
        residuals, jacobian = wide.at(x, slopes=slopes)
        return np.append(residuals * weights, below @ x), np.vstack(
            [jacobian * weights[:, None], below]
        )

    there = least_squares(model, one.x, scale=math.sqrt(one.spread))
    prediction.solves += wide.solves
    cost = there.cost - float(np.sum((loose @ there.x) ** 2))
    spread = 1.0 if np.isinf(one.degrees) else cost / one.degrees
    errors = np.sqrt(spread * np.diag(np.linalg.inv(there.slopes.T @ there.slopes))[:k])
    probability = min(1.0, tried * _chance(extra, one.degrees, max(best.cost - cost, 0.0), spread))
    return replace(one, x=there.x, errors=errors, spread=spread, probability=probability)


def _groups(
    scene: Scene, constants: Sequence[Constant]
) -> Iterator[tuple[str, tuple[Constant, ...]]]:
    """Quantities that are not varied, each with the constants that free it."""
    known = {constant.name for constant in constants}
    for kind, name in (
        ("field", "a stray field"),
        ("magnetization", "the direction of {}"),
        (GEOMETRY, "another diameter"),
    ):
        try:
            made = [
                c
                for c in (diameter_of(scene) if kind == GEOMETRY else constants_of(scene, [kind]))
                if c.name not in known
            ]
        except InputError:
            continue
        for region in dict.fromkeys(constant.variable.region for constant in made):
            group = tuple(constant for constant in made if constant.variable.region == region)
            yield name.format("" if region is None else scene.regions()[region].name), group


def odd_readings(sizes: Array, labels: Sequence[Label], measured: Measurements) -> list[str]:
    """Warn of residuals beyond what the noise explains.

    Parameters
    ----------
    sizes : array (n,), no unit
        Residuals in standard errors.
    labels : sequence of Label
        What each is of.
    measured : Measurements
        The measurements.

    Returns
    -------
    list of str
        One sentence, or none.
    """
    files = [f"{one.path.name}, " if measured.tables else "" for one in measured.each]
    odd = [
        f"{files[label.table]}line {label.line}, {label.what} ({size:+.1f})"
        for size, label in zip(sizes, labels, strict=True)
        if abs(size) > 3.5
    ]
    if not odd:
        return []
    more = f" and {len(odd) - 5} more" if len(odd) > 5 else ""
    return [
        f"outliers, in standard errors: {'; '.join(odd[:5])}{more}: check these readings, and "
        "what else could have acted"
    ]


def unequal_tables(sizes: Array, labels: Sequence[Label], measured: Measurements) -> list[str]:
    """Warn where one table's lengths are off by twice another's, in standard errors: then their weights are wrong.

    Of ten numbers each, that happens by chance to 4 % of pairs.

    Parameters
    ----------
    sizes : array (n,), no unit
        Residuals in standard errors.
    labels : sequence of Label
        What each is of.
    measured : Measurements
        The measurements.

    Returns
    -------
    list of str
        One sentence, or none.
    """
    parts = [
        np.array(
            [
                size
                for size, label in zip(sizes, labels, strict=True)
                if label.table == k and not label.angle
            ]
        )
        for k in range(len(measured.each))
    ]
    rms = [float(np.sqrt(np.mean(part**2))) if len(part) >= 10 else math.nan for part in parts]
    known = [value for value in rms if math.isfinite(value)]
    if len(known) < 2 or max(known) < 2.0 * max(min(known), 1e-12):
        return []
    large, small = (measured.each[rms.index(end(known))].path.name for end in (max, min))
    return [
        f"in standard errors the residuals of {large} are {max(known) / max(min(known), 1e-12):.2g}"
        f' times as large as those of {small}: give each table its noise, say, --noise "0.2 mm,'
        ' 0.5 mm"'
    ]
