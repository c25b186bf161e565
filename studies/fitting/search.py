"""fit(measured, scene) -> Fit: the constants of a scene that explain measurements best, with intervals; or a refusal.

Maximum likelihood for independent normal errors of equal size in each coordinate: least squares, and intervals by the likelihood ratio.
With errors of known size sigma, a constant's 95 % interval holds the values whose best sum of squares is above the least by at most
1.96^2 sigma^2. With unknown size, sigma^2 is estimated from the residuals, and Student's t with the degrees of freedom takes the place of
1.96. Where the sum of squares is a parabola to 10 % at both ends this is the usual t interval ("linear"); else the ends are sought on the
profile ("profile"). Sources: Bates and Watts, Nonlinear Regression Analysis (1988), sections 1.2, 2.5 and 6.1; Seber and Wild, Nonlinear
Regression (1989), section 5.4.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from magmpm.compiled.arrays import Array, NamedNumbers
from magmpm.errors import InputError, MagmpmError, SolveError
from magmpm.scene import Scene
from magmpm.scene.coarsest import coarsest_cells
from magmpm.simulate import run
from magmpm.studies.fitting.constants import Constant, constants_of, with_known
from magmpm.studies.fitting.identify import Refused, check_identifiable, refuse_twins
from magmpm.studies.fitting.misfit import (
    Suspect,
    doubted,
    odd_readings,
    suspects_of,
    unequal_tables,
)
from magmpm.studies.fitting.prediction import Label, Prediction
from magmpm.studies.fitting.solve import (
    Interval,
    LeastSquares,
    Model,
    interval_of,
    least_squares,
    quantile_of,
)
from magmpm.studies.fitting.table import Measurements

__all__ = ["Fit", "Fitted", "Refused", "doubtful_fields", "fit"]

LEAST_READING_ERROR = (
    1e-6  # of the length: what the solve itself leaves; readings are not taken as more exact
)


@dataclass(frozen=True)
class Fitted:
    """One constant that a fit has found, in SI.

    Attributes
    ----------
    constant : Constant
        Which it is, with its unit.
    value : float, the constant's unit
        The best one.
    error : float, the constant's unit
        Its standard error.
    low : float, the constant's unit, or None
        Lower end of its interval at the level requested; None: open.
    high : float, the constant's unit, or None
        Upper end of it.
    method : str
        How the interval was found: linear or profile; widened or withheld where something else
        explains the residuals (misfit.py).
    grid_shift : float, the constant's unit, or None
        By how much a finer grid would move the value; None: not known.
    """

    constant: Constant
    value: float
    error: float
    low: float | None
    high: float | None
    method: str
    grid_shift: float | None = None


@dataclass(frozen=True)
class Fit:
    """Result of a fit of k constants to n numbers that were measured.

    Attributes
    ----------
    scene : Scene
        With the constants as they were before.
    measured : Measurements
        The tables.
    constants : tuple of Fitted
        What was found of each constant.
    level : float, no unit
        Of the intervals: 0.95 is 95 %.
    sigma_m : float, m
        Standard deviation of measured lengths, of the first table.
    sigma_rad : float, rad, or None
        Of measured angles; None where there are none.
    noise : str
        Where the standard deviations are from: given; residuals; or given, enlarged.
    residuals : array (n,), m or rad
        Simulated minus measured.
    labels : tuple of Label
        What each residual is of.
    degrees : int
        Of freedom: numbers measured, less constants, plus those known beforehand.
    correlation : array (k, k), no unit
        Of the constants.
    x : array (k,), no unit
        The constants as the search counts them (Constant.value gives them in SI).
    warnings : tuple of str
        What a user should know, a sentence each.
    solves : int
        Number of simulations.
    seconds : float, s
        Wall time.
    ratios : tuple of float, no unit
        Standard deviation of each table's lengths over that of the first table.
    suspects : tuple of Suspect or None
        What was taken as exact and might explain residuals (misfit.py), likeliest first; None:
        not tested.
    moves : Mapping[str, Mapping[str, float]]
        By the kind of a suspect and the name of a constant, the fraction by which that changes
        for a fraction of the diameter, 1 mT or 1 rad (suspects_of).
    """

    scene: Scene
    measured: Measurements
    constants: tuple[Fitted, ...]
    level: float
    sigma_m: float
    sigma_rad: float | None
    noise: str
    residuals: Array
    labels: tuple[Label, ...]
    degrees: int
    correlation: Array
    x: Array
    warnings: tuple[str, ...]
    solves: int
    seconds: float
    ratios: tuple[float, ...] = (1.0,)
    suspects: tuple[Suspect, ...] | None = None
    moves: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        found = ", ".join(f"{one.constant.name} = {one.value:.4g}" for one in self.constants)
        return (
            f"Fit({self.scene.name!r}: {found} in SI, rms {1e3 * self.rms_m:.3g} mm over"
            f" {len(self.residuals)} numbers)"
        )

    def sigma_of(self, label: Label) -> float:
        """Find the standard deviation of a residual.

        Parameters
        ----------
        label : Label
            Its label.

        Returns
        -------
        float, m or rad
            That of its table's lengths, or of angles.
        """
        return (self.sigma_rad or 1.0) if label.angle else self.sigma_m * self.ratios[label.table]

    @property
    def rms_m(self) -> float:
        """Root mean square of the residuals that are lengths, m."""
        return _rms(self.residuals, self.labels)

    @property
    def rms_rad(self) -> float:
        """Root mean square of the residuals that are angles, rad."""
        return _rms(self.residuals, self.labels, angles=True)


def _rms(residuals: Array, labels: Sequence[Label], angles: bool = False) -> float:
    counted = np.array(
        [r for r, label in zip(residuals, labels, strict=True) if label.angle == angles]
    )
    return float(np.sqrt(np.mean(counted**2))) if len(counted) else 0.0


@dataclass(frozen=True)
class _Noise:
    """Standard deviations of lengths (m; times the ratio of their table) and angles (rad); given: whether those of lengths were."""

    length: float
    angle: float
    given: bool
    ratios: tuple[float, ...] = (1.0,)

    def of(self, labels: Sequence[Label]) -> Array:
        return np.array(
            [
                self.angle if label.angle else self.length * self.ratios[label.table]
                for label in labels
            ]
        )


def fit(
    measured: Measurements,
    scene: Scene,
    *,
    vary: Sequence[str] | None = None,
    noise: float | Sequence[float] | None = None,
    angle_noise: float | None = None,
    known: Mapping[str, float] | None = None,
    level: float = 0.95,
    thorough: bool = True,
    on_progress: Callable[[str], None] | None = None,
) -> Fit:
    """Find the constants of a scene that explain measurements best.

    Parameters
    ----------
    measured : Measurements
        The measurements.
    scene : Scene
        The scene; the fit begins with its values.
    vary : sequence of str, optional
        Kinds or names of constants (studies.fitting.constants); shear moduli, remanences, and a
        motion's losses unless given.
    noise : float or sequence of float, m, optional
        Standard deviation of each measured coordinate, one for all or one for each table;
        estimated from the residuals, one for all, unless given.
    angle_noise : float, rad, optional
        Standard deviation of each measured angle. It must be given where lengths are measured
        as well; of angles alone it is estimated unless given.
    known : Mapping[str, float], no unit, optional
        Relative standard deviations of constants that are known beforehand, by name or kind:
        the scene's values count as measured that well.
    level : float, no unit, default 0.95
        Of the intervals.
    thorough : bool, default True
        Of equilibria: descend from further starts, and find what a finer grid would change and
        what the scene may lack.
    on_progress : callable, optional
        Told in words what is being done.

    Returns
    -------
    Fit
        The constants with their intervals.

    Raises
    ------
    Refused
        Where the measurements can't distinguish constants.
    InputError
        For what does not fit together.
    SolveError
        Where no equilibrium is found.
    """
    begun = time.perf_counter()
    scene = _on_one_grid(scene)
    constants = with_known(constants_of(scene, vary), dict(known or {}))
    first, ratios = _of_tables(measured, noise)
    _check_counts(measured, constants, first, angle_noise)
    prediction = Prediction(scene, measured, constants)
    search = _Search(
        prediction, constants, first, angle_noise, scene.length, on_progress or (lambda text: None)
    )
    search.ratios = ratios
    best, sigmas, others = search.best(thorough and not scene.in_time)
    prediction.at(best.x, slopes=False)  # its labels have what is simulated at the best
    labels = tuple(prediction.labels)
    degrees = len(labels) - len(constants) + sum(c.known is not None for c in constants)
    sigmas, quantile, source, warnings = _scatter(
        best, sigmas, degrees, level, labels, LEAST_READING_ERROR * scene.length
    )
    model = search.whitened(sigmas)
    best = search.weighed(best, sigmas)
    raw = best.residuals[: len(labels)] * sigmas.of(labels)
    check_identifiable(
        scene,
        measured,
        constants,
        best.slopes,
        quantile,
        sigmas.length,
        _rms(raw, labels),
        differences=scene.in_time,
    )
    refuse_twins(
        constants, best, [replace(m, residuals=model(m.x, False)[0]) for m in others], quantile
    )
    covariance: Array = np.linalg.inv(best.slopes.T @ best.slopes).astype(np.float64)
    intervals = [
        interval_of(model, best, covariance, k, quantile, search.say) for k in range(len(constants))
    ]
    shift = None
    suspects = None
    moves: dict[str, NamedNumbers] = {}
    if thorough and not scene.in_time:
        shift = search.on_finer_grid(best, sigmas, covariance)
        suspects, moves = suspects_of(
            prediction, best, 1.0 / sigmas.of(labels), degrees, source == "given"
        )
        for one in doubted(suspects):
            intervals = one.widened(intervals, level)
            warnings = [*warnings, one.warning()]
    found = tuple(
        _fitted(c, k, best, covariance, intervals[k], shift) for k, c in enumerate(constants)
    )
    deviations = np.sqrt(np.diag(covariance))
    warnings += (
        _of_values(found)
        + odd_readings(raw / sigmas.of(labels), labels, measured)
        + _of_grid(found)
    )
    warnings += unequal_tables(raw / sigmas.of(labels), labels, measured)
    if not best.converged:
        warnings.append(
            f"the search stopped after {best.steps} steps before it had settled; start nearer, in"
            " the scene's file"
        )
    return Fit(
        scene,
        measured,
        found,
        level,
        sigmas.length,
        sigmas.angle if measured.has_angles else None,
        source,
        raw,
        labels,
        degrees,
        covariance / np.outer(deviations, deviations),
        best.x,
        tuple(warnings),
        prediction.solves,
        time.perf_counter() - begun,
        ratios,
        suspects,
        moves,
    )


def _of_tables(
    measured: Measurements, noise: float | Sequence[float] | None
) -> tuple[float | None, tuple[float, ...]]:
    """The first table's standard deviation of lengths (m), and by what each one's is larger. InputError for another number of them."""
    count = len(measured.each)
    if noise is None or isinstance(noise, float | int):
        return noise, (1.0,) * count
    if len(noise) not in (1, count):
        raise InputError(
            "--noise",
            received=f"{len(noise)} of them",
            rule=f"one for all tables, or one for each, {count}",
            remedy='say, --noise "0.2 mm, 0.5 mm"',
        )
    return noise[0], tuple(
        each / noise[0] for each in (noise if len(noise) == count else [noise[0]] * count)
    )


def _on_one_grid(scene: Scene) -> Scene:
    """The scene on the cells that its resolution requests. Raises InputError where effects are still to be chosen."""
    if scene.effects.auto:
        raise InputError(
            "effects",
            received="auto",
            rule="a fit compares runs with the same effects",
            remedy="name those that `magmpm run` reports as chosen",
        )
    if not scene.resolution.requested:
        return scene
    resolution = run(scene).resolution
    assert resolution is not None
    return scene.with_cells(int(resolution["cells_across"]))


def _check_counts(
    measured: Measurements,
    constants: Sequence[Constant],
    noise: float | None,
    angle_noise: float | None,
) -> None:
    """Raises InputError where there are fewer numbers than constants, or too few to tell the noise."""
    if measured.has_angles and angle_noise is None and not measured.angles_alone:
        raise InputError(
            "--angle-noise",
            received="nothing",
            rule="angles and lengths are weighed by their errors",
            remedy='give the error of an angle: --angle-noise "1 deg"',
        )
    unknown = sum(constant.known is None for constant in constants)
    if measured.numbers < unknown:
        names = ", ".join(constant.name for constant in constants)
        raise Refused(
            measured.named,
            received=f"{measured.numbers}",
            rule=f"{unknown} constants ({names}) need {unknown} measured numbers or more",
            remedy="measure more, or --vary fewer",
        )
    if measured.numbers == unknown and (angle_noise if measured.angles_alone else noise) is None:
        raise InputError(
            measured.named,
            received=f"{measured.numbers} number{'s' * (measured.numbers != 1)}",
            rule="with as many readings as constants the errors of measurement can't be estimated",
            remedy='give it: --noise "0.2 mm"',
        )


class _Search:
    """Descents to the least sum of squares."""

    def __init__(
        self,
        prediction: Prediction,
        constants: tuple[Constant, ...],
        noise: float | None,
        angle: float | None,
        length: float,
        say: Callable[[str], None],
    ) -> None:
        self.prediction = prediction
        self.constants = constants
        self.length = length
        self.noise = noise
        self.angle = angle or 1.0
        self.given = (angle if prediction.measured.angles_alone else noise) is not None
        self._say = say
        self.ratios: tuple[float, ...] = (1.0,) * len(prediction.measured.each)

    def say(self) -> None:
        self._say(f"{self.prediction.solves} solves")

    def whitened(
        self, sigmas: _Noise, on: Prediction | None = None
    ) -> Callable[[Array, bool], tuple[Array, Array]]:
        """Residuals in standard errors, and those of what is known beforehand after them; on: the prediction, if on another grid."""
        beforehand = [(k, c.known) for k, c in enumerate(self.constants) if c.known is not None]
        prediction = on or self.prediction

        def model(x: Array, slopes: bool) -> tuple[Array, Array]:
            before = prediction.solves
            residuals, jacobian = prediction.at(x, slopes=slopes)
            if prediction is not self.prediction:
                self.prediction.solves += prediction.solves - before
            self.say()
            weight = 1.0 / sigmas.of(prediction.labels)
            extra = np.zeros((len(beforehand), jacobian.shape[1]))
            for row, (k, deviation) in enumerate(beforehand):
                if slopes:
                    extra[row, k] = 1.0 / deviation
            known = np.array([x[k] / deviation for k, deviation in beforehand])
            return np.concatenate([residuals * weight, known]), np.concatenate(
                [jacobian * weight[:, None], extra]
            )

        return model

    def weighed(self, best: LeastSquares, sigmas: _Noise) -> LeastSquares:
        """A minimum in other standard errors."""
        n = len(self.prediction.labels)
        weight = np.ones(len(best.residuals))
        weight[:n] = self._used.of(self.prediction.labels) / sigmas.of(self.prediction.labels)
        return replace(
            best, residuals=best.residuals * weight, slopes=best.slopes * weight[:, None]
        )

    def best(self, thorough: bool) -> tuple[LeastSquares, _Noise, list[LeastSquares]]:
        """The least minimum, the standard deviations that it was weighed by, and the other minima."""
        sigmas = _Noise(
            max(self.noise or 1e-3 * self.length, LEAST_READING_ERROR * self.length),
            self.angle,
            self.given,
            self.ratios,
        )
        found = self._descents(sigmas, thorough)
        mixed = self.prediction.measured.has_angles or any(
            c.known is not None for c in self.constants
        )
        for _ in range(4 if mixed and not sigmas.given else 0):
            new, change = self._estimated(found[0], sigmas)
            if abs(np.log(change)) < 0.02:
                break
            sigmas = new
            again = least_squares(
                self.whitened(sigmas), found[0].x, scale=1.0, secant=self.prediction.scene.in_time
            )
            found = [again, *found[1:]]
        self._used = sigmas
        return found[0], sigmas, found[1:]

    def _descents(self, sigmas: _Noise, thorough: bool) -> list[LeastSquares]:
        """Minima that differ by more than the noise, the least first: of the coarsest grid, and from each of these of the scene's own."""
        stiff = np.array([float(c.kind == "shear_modulus") for c in self.constants])
        if not stiff.any():
            stiff = np.array([-float(c.kind == "remanence") for c in self.constants])
        # further descents begin at a fourth and four times the scene's moduli
        further = (np.log(4.0), -np.log(4.0)) if thorough and stiff.any() else ()
        starts = [shift * stiff for shift in (0.0, *further)]
        scene = self.prediction.scene
        if not scene.in_time and (cells := coarsest_cells(scene)) < scene.resolution.cells_across:
            coarse = Prediction(scene.with_cells(cells), self.prediction.measured, self.constants)
            with suppress(SolveError):  # the scene's own grid may hold what that one can't
                starts = [
                    minimum.x
                    for minimum in self._minima(self.whitened(sigmas, coarse), starts, sigmas)
                ]
        return self._minima(self.whitened(sigmas), starts, sigmas)

    def _minima(self, model: Model, starts: Sequence[Array], sigmas: _Noise) -> list[LeastSquares]:
        """Minima that descents from the starts reach. Raises an InputError at the first start, and where none is found its first error."""
        found = list[LeastSquares]()
        failure = None

        def known(x: Array) -> bool:
            return any(one.converged and not self._differ(x, one) for one in found)

        for k, start in enumerate(starts):
            try:
                scale = 1.0 if sigmas.given else None
                moves = self.prediction.scene.in_time
                # a motion costs seconds; a step of 0.03 standard errors moves no answer
                small = 0.03 if moves else 1e-3
                found.append(
                    least_squares(model, start, scale=scale, small=small, known=known, secant=moves)
                )
            except MagmpmError as error:
                failure = failure or error
                if k == 0 and isinstance(error, InputError):
                    raise
        if failure is not None and not found:
            raise failure
        found.sort(key=lambda minimum: minimum.cost)
        return [
            m for k, m in enumerate(found) if all(self._differ(m.x, other) for other in found[:k])
        ]

    def _differ(self, x: Array, other: LeastSquares) -> bool:
        """True if x and a minimum differ, and the data can see it: by more than one standard deviation (refuse_twins wants six)."""
        noise = (
            1.0
            if self.given
            else float(np.sqrt(other.cost / max(len(other.residuals) - len(self.constants), 1)))
        )
        change = x - other.x
        return bool(np.max(np.abs(change)) > 1e-3 and np.linalg.norm(other.slopes @ change) > noise)

    def _estimated(self, best: LeastSquares, sigmas: _Noise) -> tuple[_Noise, float]:
        """Standard deviations of lengths, or of angles alone, from their residuals and leverages; the factor by which they change."""
        alone = self.prediction.measured.angles_alone
        counted = np.array([alone or not label.angle for label in self.prediction.labels])
        n = len(counted)
        basis = np.linalg.qr(best.slopes)[0]
        left = float(np.sum(counted) - np.sum(basis[:n][counted] ** 2))
        change = float(np.sqrt(np.sum(best.residuals[:n][counted] ** 2) / max(left, 0.5)))
        if alone:
            return replace(sigmas, angle=max(sigmas.angle * change, LEAST_READING_ERROR)), max(
                change, LEAST_READING_ERROR
            )
        new = replace(sigmas, length=max(sigmas.length * change, LEAST_READING_ERROR * self.length))
        return new, new.length / sigmas.length

    def on_finer_grid(self, best: LeastSquares, sigmas: _Noise, covariance: Array) -> Array:
        """Change (k,) of the constants on a grid with two more cells across: one Gauss-Newton step."""
        cells = self.prediction.scene.resolution.cells_across + 2
        finer = Prediction(
            self.prediction.scene.with_cells(cells), self.prediction.measured, self.constants
        )
        there, _ = finer.at(best.x, slopes=False)
        self.prediction.solves += finer.solves
        weight = 1.0 / sigmas.of(self.prediction.labels)
        n = len(weight)
        moved = there * weight - best.residuals[:n]
        return np.asarray(-covariance @ (best.slopes[:n].T @ moved))


def _scatter(
    best: LeastSquares,
    sigmas: _Noise,
    degrees: int,
    level: float,
    labels: Sequence[Label],
    least: float,
) -> tuple[_Noise, float, str, list[str]]:
    """Standard deviations to go by, of lengths `least` (m) at the least, the quantile for intervals, where they are from, and what is to be
    said."""
    from scipy.special import chdtrc  # what scipy.stats calls, without its half second

    if not sigmas.given:
        factor = float(np.sqrt(best.cost / max(degrees, 1)))
        if all(label.angle for label in labels):
            sigmas = replace(sigmas, angle=max(sigmas.angle * factor, LEAST_READING_ERROR))
        elif not any(label.angle for label in labels):
            sigmas = replace(sigmas, length=max(sigmas.length * factor, least))
        return sigmas, quantile_of(level, degrees), "residuals", []
    if degrees > 0 and chdtrc(degrees, best.cost) < 0.01:
        factor = float(np.sqrt(best.cost / degrees))
        says = (
            f"the residuals are {factor:.2g} times as large as the noise given explains"
            f" (probability {chdtrc(degrees, best.cost):.1g}): the scene lacks something that the"
            " measurement has, or the noise is larger; the intervals go by the residuals"
        )
        wider = replace(sigmas, length=sigmas.length * factor, angle=sigmas.angle * factor)
        return wider, quantile_of(level, degrees), "given, enlarged", [says]
    return sigmas, quantile_of(level, np.inf), "given", []


def doubtful_fields(measured: Measurements, scene: Scene) -> list[str]:
    """Warn, before anything is solved, of fields of the table so far from the scene's own that a unit may be wrong.

    Parameters
    ----------
    measured : Measurements
        The measurements.
    scene : Scene
        The scene.

    Returns
    -------
    list of str
        One sentence, or none.
    """
    own = max(map(abs, scene.field.uniform))
    largest = max(
        (abs(part) for state in measured.states for part in state.field or ()), default=0.0
    )
    if not (own > 0.0 and largest > 0.0) or 1 / 100 < largest / own < 100:
        return []
    return [
        f"the table's fields reach {1e3 * largest:.4g} mT, the scene's own is {1e3 * own:.3g} mT:"
        " check the units of its columns"
    ]


def _of_values(found: Sequence[Fitted]) -> list[str]:
    """Constants that are so far from the scene's that a unit may be wrong. Angles are not."""
    says = []
    for one in found:
        ratio = one.value / given if (given := one.constant.value(0.0)) else 1.0
        if not 1 / 10 < ratio < 10:
            says.append(
                f"{one.constant.name} is {ratio:.2g} times the scene's: check the units of the"
                " table's columns, and the scene's"
            )
    return says


def _fitted(
    constant: Constant,
    k: int,
    best: LeastSquares,
    covariance: Array,
    interval: Interval,
    shift: Array | None,
) -> Fitted:
    x = float(best.x[k])
    low, high = (
        None if end is None else constant.value(end) for end in (interval.low, interval.high)
    )
    moved = None if shift is None else constant.value(x + float(shift[k])) - constant.value(x)
    return Fitted(
        constant,
        constant.value(x),
        abs(constant.slope(x)) * float(np.sqrt(covariance[k, k])),
        low,
        high,
        interval.method,
        moved,
    )


def _of_grid(found: Sequence[Fitted]) -> list[str]:
    """A warning where the grid moves a constant by more than a quarter of its interval."""
    coarse = []
    for one in found:
        width = None if one.low is None or one.high is None else one.high - one.low
        if (
            one.grid_shift is not None
            and width is not None
            and abs(one.grid_shift) > max(width / 4, 1e-3 * abs(one.value))
        ):
            coarse.append(one.constant.name)
    if not coarse:
        return []
    return [
        f"on a finer grid {', '.join(coarse)} would move by more than a quarter of the interval:"
        " use more cells_across in the scene"
    ]
