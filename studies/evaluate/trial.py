"""One trial: a design's scene is solved and compared with the target, for what samplers read, and with errors of manufacture.

Whatever goes wrong fails the trial, not the study.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from magmpm.compiled.arrays import Array, Named, NamedNumbers, Plain
from magmpm.errors import SolveError
from magmpm.results.result import Result
from magmpm.results.whole_file import naming
from magmpm.scene import Scene
from magmpm.scene.addresses import written
from magmpm.statics.linearized import Sensitivities
from magmpm.studies.problem.shape_distance import gap_derivatives, gaps, root_mean_square
from magmpm.studies.problem.study import Study
from magmpm.studies.rods.exchanges import improved
from magmpm.studies.rods.rod_designs import rod_starts
from magmpm.studies.search.knobs import errors_of
from magmpm.studies.search.parameters import Parameters
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.rod.cosserat import RodShape
    from magmpm.scene.variables import Variable
    from magmpm.studies.problem.study_file import Robust

SIGMAS = 2.0  # of the rms, above its mean, in the measure
Found = TypeVar("Found")
Solve = Callable[
    ..., Result
]  # from a scene to its equilibrium: magmpm.run(scene, start=a rod's shape near which it is)
Differentiate = Callable[
    ..., Sensitivities
]  # ... and its derivatives: magmpm.sensitivities(scene, of, start=...)
Note = Callable[[str], object]  # is told in words what is being done


def silent(text: str) -> None:
    """Say nothing: the Note of who wants none.

    Parameters
    ----------
    text : str
        What would be said.
    """


@dataclass(frozen=True)
class Scatter:
    """Effect of manufacturing errors on a design, to first order: the scatter of its shape, and the mean and spread of its rms.

    Errors are independent and normal. Each magnetized segment's direction d is tilted by two
    angles, one along each of two perpendicular axes across d, both of the standard deviation
    `direction` (so the tilt itself, whatever way, has the root mean square of sqrt(2) times that).
    Each material's remanence, and each material's shear modulus, are multiplied by 1 + an error of
    their own; segments of one material share it. Numbers by their addresses have errors of their
    own, or of several one.

    The gaps g (m, 3) between shape and target then are g0 + J e, with e of the covariance S
    (diagonal). With M = J S^(1/2) and z of independent standard normal numbers,

        rms^2 = |g0 + M z|^2 / m,                    E[rms^2] = (|g0|^2 + tr M M^T) / m   exactly.

    The rms is no linear function of z where g0 is small: there its mean is not the rms of the mean.
    So both moments are those of the root itself. With the singular values s_i of M, c_i = u_i.g0
    the part of g0 along each of their left vectors, and r^2 the rest of |g0|^2, the Laplace
    transform of m rms^2 is

        phi(t) = exp(-t r^2) prod_i (1 + 2 t s_i^2)^(-1/2) exp(-t c_i^2 / (1 + 2 t s_i^2)),

    and the mean of the root follows from it by E[sqrt(q)] = 1/(2 sqrt(pi)) integral from 0 to
    infinity of (1 - phi(t)) t^(-3/2) dt. The measure of a study is mean + 2 sigma.

    Attributes
    ----------
    gaps : array (m, 3), m
        Of the nominal design, from target to shape.
    spread : array (m, 3, k), m
        Their change by one standard deviation of each error.

    References
    ----------
    Mathai and Provost, Quadratic Forms in Random Variables (1992), chapter 3 (phi); Cressie and
    Borkent, J. Stat. Plan. Inference 13 (1986) 337 (fractional moments).
    """

    gaps: Array
    spread: Array

    @property
    def scatter(self) -> float:
        """Root mean square distance (m), over all stations and made designs, between the shape made and the shape meant."""
        return float(np.sqrt(np.sum(self.spread**2) / len(self.gaps)))

    def moments(self) -> tuple[float, float]:
        """Find mean and standard deviation of the rms of made designs.

        Returns
        -------
        tuple of float, m
            Both.
        """
        m = len(self.gaps)
        g = self.gaps.reshape(-1)
        left, s, _ = np.linalg.svd(self.spread.reshape(g.size, -1), full_matrices=False)
        along = left.T @ g
        rest = max(float(g @ g - along @ along), 0.0)
        total = float(g @ g + s @ s)  # E[m rms^2]
        if total == 0.0:
            return 0.0, 0.0
        relative = (
            float(2 * np.sum(s**4) + 4 * np.sum((s * along) ** 2)) / total**2
        )  # variance of rms^2 over its mean squared
        if relative < 1e-7:  # the first terms of the root's expansion
            return float(np.sqrt(total / m) * (1 - relative / 8)), float(
                np.sqrt(relative / 4 * total / m)
            )
        # log t: the trapezoid rule errs by exp(-2 pi^2 / step), the ends of the range by exp(-reach / 2)
        step = 0.4
        reach = 70.0
        u = np.arange(-reach, reach + step / 2, step)
        t = np.exp(u)[:, None] / total
        wider = 2.0 * t * s**2
        log_phi = -t[:, 0] * rest - np.sum(
            0.5 * np.log1p(wider) + t * along**2 / (1.0 + wider), axis=1
        )
        mean = (
            step * float(np.sum(-np.expm1(log_phi) * np.exp(-u / 2))) / (2.0 * np.sqrt(np.pi))
        )  # of sqrt(m rms^2 / total)
        mean = min(mean, 1.0)
        return float(mean * np.sqrt(total / m)), float(np.sqrt((1.0 - mean**2) * total / m))

    @property
    def measure(self) -> float:
        """Mean plus SIGMAS standard deviations of the rms, m."""
        mean, sigma = self.moments()
        return mean + SIGMAS * sigma

    def attributes(self) -> Plain:
        """Collect the attributes that a trial stores of it.

        Returns
        -------
        dict[str, Any]
            Values by name, in m.
        """
        mean, sigma = self.moments()
        return {
            "measure_m": mean + SIGMAS * sigma,
            "mean_rms_m": mean,
            "sigma_rms_m": sigma,
            "scatter_m": self.scatter,
        }


def deviations(scene: Scene, variables: Sequence[Variable], errors: Robust) -> Array:
    """Find what the errors of manufacture change a scene's variables by.

    Parameters
    ----------
    scene : Scene
        The scene.
    variables : sequence of Variable
        The k variables, those at the places of `errors_of` among them.
    errors : Robust
        Those of manufacture.

    Returns
    -------
    array (k, e), each variable's unit
        By one standard deviation of each of e independent errors.
    """
    changes = errors_of(errors, scene)
    rows = {variable.place: row for row, variable in enumerate(variables)}
    found = np.zeros((len(variables), len(changes)))
    for column, change in enumerate(changes):
        for place, size in change.items():
            found[rows[place], column] = size
    return found


@dataclass(frozen=True)
class Trial:
    """A finished trial, as callbacks see it.

    Attributes
    ----------
    number : int
        Of the trial.
    rms_m : float, m
        What the trial counts as (Outcome.value): the penalty if the solve failed.
    tip_error_m : float, m, or None
        Distance of the tips; None if the solve failed.
    best_rms_m : float, m, or None
        Least so far, this trial included.
    improved : bool
        Whether this trial is the best so far.
    reason : str or None
        Why the solve failed.
    target : array (m, 4), m
        Rows [s, x, y, z].
    finished : int
        How many trials are done.
    wanted : int
        How many there are to be.
    seconds : float, s
        All of this trial.
    seconds_left : float, s
        A guess, until the last trial.
    shapes : tuple of Mapping[str, Any]
        Of an insertion or a schedule what pictures need of each depth or time.
    """

    number: int
    rms_m: float
    tip_error_m: float | None
    best_rms_m: float | None
    improved: bool
    reason: str | None
    target: Array
    finished: int = 0
    wanted: int = 0
    seconds: float = 0.0
    seconds_left: float = 0.0
    shapes: tuple[Named, ...] = ()  # of an insertion: what pictures need of each depth


@dataclass(frozen=True)
class Outcome:
    """Outcome of solving a design: a result and its distances, or the penalty and the reason.

    A design that is refused keeps its result and distances, with the reason.

    Attributes
    ----------
    result : Result or None
        The last equilibrium, or None.
    rms : float, m
        Distance from the target, or the penalty.
    tip_error : float, m, or None
        Distance of the tips.
    reason : str or None
        Why it failed or was refused.
    seconds : float, s
        Of the solves.
    model : Mapping[str, Any]
        Attributes of a solve with derivatives.
    stability : float, no unit, or None
        Of the result (Result.stability).
    refused : bool
        Solved, but less stable than the study's margin.
    known : dict[str, Any]
        Attributes to save of the trial.
    files : list of Path
        Its pictures.
    drawing : float, s
        How long drawing took.
    """

    result: Result | None
    rms: float
    tip_error: float | None
    reason: str | None
    seconds: float
    model: Named = field(default_factory=dict)  # attributes of a solve with derivatives
    stability: float | None = None  # of the result (Result.stability)
    refused: bool = False  # solved, but less stable than the study's margin
    known: Plain = field(default_factory=dict)  # attributes to save of the trial
    files: list[Path] = field(default_factory=list)  # its pictures
    drawing: float = 0.0  # s

    @property
    def accepted(self) -> bool:
        """True if this design may be the best."""
        return self.result is not None and not self.refused

    @property
    def value(self) -> float:
        """Value of the trial, m: the rms, or the measure of a design with errors (Scatter)."""
        return float(self.model.get("measure_m", self.rms))


def penalty(scene: Scene) -> float:
    """Find the value of a failed solve: the catheter's length.

    It is finite, so that samplers learn from it, and farther from the target than most designs: a
    straight catheter is nearer.

    Parameters
    ----------
    scene : Scene
        The scene.

    Returns
    -------
    float, m
        The value.
    """
    return scene.length


def attempted(work: Callable[[], Found], scene: Scene, log: Path) -> Found | str:
    """Do some work, and say why it failed if it did; unexpected errors are logged with their traceback. Interrupts pass through.

    Parameters
    ----------
    work : callable
        The work.
    scene : Scene
        Its scene, for the log.
    log : Path
        The log's file.

    Returns
    -------
    Found or str
        What the work returns, or the reason why it failed.
    """
    try:
        return work()
    except SolveError as error:
        return error.reason
    except Exception as error:  # a study runs for hours: no design may end it
        with naming(log), log.open("a", encoding="utf-8") as stream:
            stream.write(f"scene {scene.hash()}\n{traceback.format_exc()}\n")
        return f"{type(error).__name__}: {error}"


@dataclass(frozen=True)
class Evaluation:
    """The equilibria that a study requires of each design, and how far they are from its target: here one.

    Attributes
    ----------
    study : Study
        The study.
    space : SearchSpace
        Its search space.
    """

    study: Study
    space: SearchSpace

    @property
    def places(self) -> tuple[str, ...]:
        """Names of the equilibria in messages: at 12 mm, at 0.5 s; none where there is one."""
        return ("",)

    def target(self, number: int) -> Array:
        """Find what an equilibrium is compared with.

        Parameters
        ----------
        number : int
            Of the equilibrium.

        Returns
        -------
        array (m, 4), m
            Rows [s, x, y, z].
        """
        return self.study.target

    def field_number(self, number: int) -> int:
        """Find which of the design's fields an equilibrium has.

        Parameters
        ----------
        number : int
            Of the equilibrium.

        Returns
        -------
        int
            Number of the field.
        """
        return number if self.space.fields > 1 else -1

    def scenes(self, params: Parameters) -> list[Scene]:
        """Make the scene of each equilibrium of a design.

        Parameters
        ----------
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        list of Scene
            The scenes.
        """
        return [self.space.scene_of(params, self.field_number(k)) for k in range(len(self.places))]

    def starts(self, params: Parameters) -> Sequence[RodShape | None]:
        """Find the rod near which each equilibrium is.

        Parameters
        ----------
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        sequence of RodShape or None
            A rod for each; None where it is on the branch that grows from no load.

        Raises
        ------
        SolveError
            Where a rod finds no equilibrium.
        """
        return [None] * len(self.places)

    def rod_starts(self, note: Note = silent) -> list[NamedNumbers]:
        """Find the rod's best designs.

        Parameters
        ----------
        note : Note, default silent
            Told in words what is being done, where it takes long.

        Returns
        -------
        list of dict[str, float]
            Parameters, best first.
        """
        note("designs of rods")
        sets = (
            self.study.limits is not None and self.study.limits.directions is not None
        )  # each start is then improved, for a second
        by_bound = "largest_field" in self.study.minimize and not sets
        starts = rod_starts(self.space, self.study.target, self.study.seed, by_bound=by_bound)
        return improved(self.space, self.study.target, starts)

    def gaps(self, result: Result, number: int) -> Array:
        """Find the vectors from the target to the shape of an equilibrium.

        Parameters
        ----------
        result : Result
            The equilibrium.
        number : int
            Of the equilibrium.

        Returns
        -------
        array (m, 3), m
            The vectors.
        """
        return gaps(result.centreline, self.target(number))

    def slopes(self, found: Sensitivities, number: int) -> Array:
        """Find the derivatives of an equilibrium's gaps.

        Parameters
        ----------
        found : Sensitivities
            The equilibrium with its derivatives by k variables.
        number : int
            Of the equilibrium.

        Returns
        -------
        array (m, 3, k), m per unit
            Of each gap for each variable.
        """
        return gap_derivatives(found, self.target(number))

    def measures(self, results: Sequence[Result], params: Parameters) -> Plain:
        """Measure a design.

        Parameters
        ----------
        results : sequence of Result
            Its equilibria.
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        dict[str, Any]
            Measures by name: rms_m, which is its value, and more.
        """
        return {"rms_m": root_mean_square(self.gaps(results[0], 0))}

    def penalty(self, params: Parameters) -> float:
        """Find the value of a design that is not solved.

        Parameters
        ----------
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        float, m
            The value.
        """
        return penalty(self.scenes(params)[-1])

    def last_result(self, solve: Solve, params: Parameters) -> Result:
        """Solve the last equilibrium of a design.

        Parameters
        ----------
        solve : callable
            From a scene to its Result.
        params : Mapping[str, Any]
            The design.

        Returns
        -------
        Result
            The equilibrium.

        Raises
        ------
        SolveError
            Where there is none.
        """
        return solve(self.scenes(params)[-1], **_near(self.starts(params)[-1]))

    def differentiated(self, scene: Scene) -> list[str]:
        """Find the variables by which a solve is differentiated: for what gauss-newton reads, and for errors of manufacture.

        Parameters
        ----------
        scene : Scene
            The scene.

        Returns
        -------
        list of str
            Kinds and addresses.
        """
        errors = self.study.robust
        of = self.space.sensitivities if self.study.sampler == "gauss-newton" else []
        made = errors_of(errors, scene) if errors else ()
        return list(dict.fromkeys([*of, *(written(place) for one in made for place in one)]))

    def evaluate(
        self,
        solve: Solve,
        differentiate: Differentiate | None,
        params: Parameters,
        log: Path,
    ) -> Outcome:
        """Solve all equilibria of a design, and compare them with the target.

        A solve that fails in any way, or ends in numbers that are not finite, gives the penalty
        with a reason; interrupts pass through. A design that is less stable than the study's margin
        is refused.

        Parameters
        ----------
        solve : callable
            From a scene to its Result.
        differentiate : callable or None
            From a scene to its Sensitivities, where derivatives are read; else None.
        params : Mapping[str, Any]
            The design.
        log : Path
            File for unexpected errors.

        Returns
        -------
        Outcome
            The outcome.
        """
        begun = time.perf_counter()

        def failed(reason: str) -> Outcome:
            return Outcome(None, self.penalty(params), None, reason, time.perf_counter() - begun)

        try:
            starts = self.starts(params)
        except SolveError as error:
            return failed(error.reason)
        several = self.places != ("",)
        results = list[Result]()
        derived = list[Any]()

        def solved(scene: Scene, start: RodShape | None, number: int) -> tuple[Result, Any]:
            if differentiate is None:
                result = solve(scene, **_near(start))
                derived = None
            else:
                found = differentiate(scene, self.differentiated(scene), **_near(start))
                result = found.result
                derived = self._derived(found, scene, params, number)
            self.gaps(result, number)  # what can't be compared fails here
            return result, derived

        for k, (scene, start) in enumerate(zip(self.scenes(params), starts, strict=True)):
            found = attempted(partial(solved, scene, start, k), scene, log)
            if not isinstance(found, str) and not found[0].converged:
                found = "the solve did not converge"
            if isinstance(found, str):
                return failed(f"{self.places[k]}: {found}" if several else found)
            results.append(found[0])
            derived.append(found[1])
        seconds = time.perf_counter() - begun
        measures = self.measures(results, params)
        if not np.isfinite(measures["rms_m"]):
            return failed(
                f"the {'results hold' if several else 'result holds'} numbers that are not finite"
            )
        known: list[Any] = [getattr(result, "stability", None) for result in results]
        stability = None if None in known else float(min(known))
        margin = self.study.margin
        reason = None
        if margin is not None and stability is None:
            return failed(
                f"the stability of the result{'s' * several} is not known, and the study has a"
                " margin"
            )
        if margin is not None and stability is not None and stability < margin:
            least = (
                f"the stability {self.places[int(np.argmin(known))]}, {stability:.3g},"
                if several
                else f"stability {stability:.3g}"
            )
            reason = f"{least} is below the margin, {margin:g}"
        tip = float(np.linalg.norm(self.gaps(results[-1], len(results) - 1)[-1]))
        model = {**measures, **self._model(results, [one for one in derived if one is not None])}
        return Outcome(
            results[-1],
            measures["rms_m"],
            tip,
            reason,
            seconds,
            model,
            stability,
            reason is not None,
        )

    def _derived(self, found: Sensitivities, scene: Scene, params: Parameters, number: int) -> Any:
        """Attributes that gauss-newton reads, and those of the scatter by errors of manufacture.

        residuals: the gaps at the target's rows, component by component, over the root of m: their sum of squares is rms^2. jacobian: their
        derivatives by the embedded coordinates of the design (parameters.py).
        """
        gap = self.gaps(found.result, number)
        slopes = self.slopes(found, number)
        model = Plain()
        errors = self.study.robust
        if self.study.sampler == "gauss-newton":
            share = 1.0 / np.sqrt(len(gap))
            chain = self.space.chain(found.variables, self.space.embedded(params))
            model = stored(share * gap.reshape(-1), share * slopes.reshape(gap.size, -1) @ chain)
        return (
            model
            if errors is None
            else model
            | Scatter(gap, slopes @ deviations(scene, found.variables, errors)).attributes()
        )

    def _model(self, results: Sequence[Result], derived: list[Any]) -> Plain:
        """The attributes that samplers read."""
        gap = self.gaps(results[0], 0)
        return {
            "residuals": _rounded((gap / np.sqrt(len(gap))).reshape(-1)),
            **(derived[0] if derived else {}),
        }


def _near(start: RodShape | None) -> dict[str, RodShape]:
    """The option of a solve that begins near a rod's shape."""
    return {} if start is None else {"start": start}


def beyond(outcome: Outcome, margin: float | None) -> float:
    """Find by how much a trial breaks what its study demands: to be solved, and to be stable.

    Parameters
    ----------
    outcome : Outcome
        Of the trial.
    margin : float, no unit, or None
        The least stability that the study allows.

    Returns
    -------
    float
        At most 0 where it keeps it; 1 where it was not solved.
    """
    if margin is None:
        return float(outcome.result is None)
    return 1.0 if outcome.stability is None else margin - outcome.stability


def attributes(outcome: Outcome, scene: Scene, directions: Array, uniform: Array) -> Plain:
    """Collect the attributes that are stored of a trial in addition to its parameters and value.

    Parameters
    ----------
    outcome : Outcome
        Of the trial.
    scene : Scene
        Its scene.
    directions : array (k, 3), no unit
        Magnetization of each segment.
    uniform : array (3,), T
        The uniform field.

    Returns
    -------
    dict[str, Any]
        Plain data in SI.
    """
    result = outcome.result
    kept: Plain = {
        "feasible": outcome.accepted,
        "scene_hash": scene.hash(),
        "magnetization": np.round(directions, 9).tolist(),
        "field_T": np.round(uniform, 12).tolist(),
        "versions": {**versions(), **({} if result is None else result.versions)},
    }
    if result is None:
        return {**kept, "reason": outcome.reason}
    if outcome.refused:
        kept |= {"refused": True, "reason": outcome.reason}
    return {
        **kept,
        "stability": outcome.stability,
        "rms_m": outcome.rms,
        "tip_error_m": outcome.tip_error,
        "min_det_F": float(result.min_det_F),
        "max_det_F": float(result.max_det_F),
        "newton_steps": int(result.iterations),
        **outcome.model,
    }


@cache
def versions() -> Mapping[str, str]:
    """Find the versions of what chose the trials; the result names those of what solved them.

    Returns
    -------
    Mapping[str, str]
        Versions by name.
    """
    from importlib.metadata import version

    return {name: version(name) for name in ("magmpm", "optuna")}


def needs_derivatives(study: Study) -> bool:
    """Tell whether the trials of a study are solved with derivatives.

    Parameters
    ----------
    study : Study
        The study.

    Returns
    -------
    bool
        True if they are.
    """
    return study.sampler == "gauss-newton" or study.robust is not None


def stored(residuals: Array, jacobian: Array) -> Plain:
    """Write residuals and their Jacobian as attributes: JSON with 9 digits, as a step of the sampler needs no more.

    Optuna keeps an attribute in a column of the type TEXT, which holds anything in SQLite and
    PostgreSQL, but 65 535 bytes in MySQL. Where a Jacobian is longer, its QR factorization is
    stored in place of both: r = Q r', J = Q J' have the same sums of squares for every step.

    Parameters
    ----------
    residuals : array (m,)
        The residuals.
    jacobian : array (m, k)
        Their derivatives.

    Returns
    -------
    dict[str, Any]
        The attributes.
    """
    if (
        jacobian.size > 3600 and len(residuals) > jacobian.shape[1] + 1
    ):  # numbers of at most 18 characters
        triangle: Array = np.asarray(np.linalg.qr(np.column_stack([jacobian, residuals]), mode="r"))
        residuals = triangle[:, -1]
        jacobian = triangle[:, :-1]
    return {"residuals": _rounded(residuals), "jacobian": [_rounded(row) for row in jacobian]}


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.9g}") for value in values.tolist()]
