"""One trial: a design's scene is solved and compared with the target, for what samplers read, and with errors of manufacture.

Whatever goes wrong fails the trial, not the study.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.results.result import Result
from magmpm.results.whole_file import naming
from magmpm.scene import Scene
from magmpm.statics.linearized import Sensitivities
from magmpm.studies.problem.shape_distance import gap_derivatives, gaps, root_mean_square
from magmpm.studies.problem.study import Study
from magmpm.studies.search.search_space import SearchSpace

if TYPE_CHECKING:
    from magmpm.scene.variables import Variable
    from magmpm.studies.problem.study_file import Robust

SIGMAS = 2.0  # of the rms, above its mean, in the measure
STEP, REACH = 0.4, 70.0  # of the integral over log t: the trapezoid rule errs by exp(-2 pi^2 / STEP), the ends by exp(-REACH / 2)
Found = TypeVar("Found")
Solve = Callable[..., Result]  # from a scene to its equilibrium: magmpm.run(scene, start=a rod's shape near which it is)
Differentiate = Callable[..., Sensitivities]  # ... and its derivatives: magmpm.sensitivities(scene, of, start=...)


@dataclass(frozen=True)
class Scatter:
    """Effect of manufacturing errors on a design, to first order: the scatter of its shape, and the mean and spread of its rms.

    Errors are independent and normal. Each magnetized segment's direction d is tilted by two angles, one along each of two perpendicular
    axes across d, both of the standard deviation `direction` (so the tilt itself, whatever way, has the root mean square of sqrt(2) times
    that). Each material's remanence, and each material's shear modulus, are multiplied by 1 + an error of their own; segments of one
    material share it.

    The gaps g (m, 3) between shape and target then are g0 + J e, with e of the covariance S (diagonal). With M = J S^(1/2) and z of
    independent standard normal numbers,

        rms^2 = |g0 + M z|^2 / m,                    E[rms^2] = (|g0|^2 + tr M M^T) / m   exactly.

    The rms is no linear function of z where g0 is small: there its mean is not the rms of the mean. So both moments are those of the root
    itself. With the singular values s_i of M, c_i = u_i.g0 the part of g0 along each of their left vectors, and r^2 the rest of |g0|^2, the
    Laplace transform of m rms^2 is

        phi(t) = exp(-t r^2) prod_i (1 + 2 t s_i^2)^(-1/2) exp(-t c_i^2 / (1 + 2 t s_i^2)),

    and the mean of the root follows from it by E[sqrt(q)] = 1/(2 sqrt(pi)) integral from 0 to infinity of (1 - phi(t)) t^(-3/2) dt.
    Sources: Mathai and Provost, Quadratic Forms in Random Variables (1992), chapter 3 (phi); Cressie and Borkent, J. Stat. Plan.
    Inference 13 (1986) 337 (fractional moments). The measure of a study is mean + 2 sigma.
    gaps (m, 3) m: nominal, from target to shape; spread (m, 3, k) m: by one standard deviation of each error.
    """

    gaps: Array
    spread: Array

    @property
    def scatter(self) -> float:
        """Root mean square distance (m), over all stations and made designs, between the shape made and the shape meant."""
        return float(np.sqrt(np.sum(self.spread**2) / len(self.gaps)))

    def moments(self) -> tuple[float, float]:
        """Mean and standard deviation (m) of the rms of made designs."""
        m, g = len(self.gaps), self.gaps.reshape(-1)
        left, s, _ = np.linalg.svd(self.spread.reshape(g.size, -1), full_matrices=False)
        along = left.T @ g
        rest = max(float(g @ g - along @ along), 0.0)
        total = float(g @ g + s @ s)  # E[m rms^2]
        if total == 0.0:
            return 0.0, 0.0
        relative = float(2 * np.sum(s**4) + 4 * np.sum((s * along) ** 2)) / total**2  # variance of rms^2 over its mean squared
        if relative < 1e-7:  # the first terms of the root's expansion
            return float(np.sqrt(total / m) * (1 - relative / 8)), float(np.sqrt(relative / 4 * total / m))
        u = np.arange(-REACH, REACH + STEP / 2, STEP)
        t = np.exp(u)[:, None] / total
        wider = 2.0 * t * s**2
        log_phi = -t[:, 0] * rest - np.sum(0.5 * np.log1p(wider) + t * along**2 / (1.0 + wider), axis=1)
        mean = STEP * float(np.sum(-np.expm1(log_phi) * np.exp(-u / 2))) / (2.0 * np.sqrt(np.pi))  # of sqrt(m rms^2 / total)
        mean = min(mean, 1.0)
        return float(mean * np.sqrt(total / m)), float(np.sqrt((1.0 - mean**2) * total / m))

    @property
    def measure(self) -> float:
        """Mean plus SIGMAS standard deviations of the rms, m."""
        mean, sigma = self.moments()
        return mean + SIGMAS * sigma

    def attributes(self) -> dict[str, Any]:
        """Attributes that a trial stores of it, m."""
        mean, sigma = self.moments()
        return {"measure_m": mean + SIGMAS * sigma, "mean_rms_m": mean, "sigma_rms_m": sigma, "scatter_m": self.scatter}


def kinds(errors: Robust) -> list[str]:
    """Kinds of variables to request of `magmpm.sensitivities`."""
    named = {"magnetization": errors.direction, "remanence": errors.remanence, "shear_modulus": errors.shear_modulus}
    return [kind for kind, size in named.items() if size > 0]


def deviations(scene: Scene, variables: Sequence[Variable], errors: Robust) -> Array:
    """The standard deviation (k,) of each variable of a scene's sensitivities, in its unit; 0 for those that have no error."""

    def of(variable: Variable) -> float:
        if variable.kind == "magnetization":
            return errors.direction
        if variable.kind in ("remanence", "shear_modulus"):
            return float(getattr(errors, variable.kind) * getattr(scene.materials[variable.material or ""], variable.kind))
        return 0.0

    return np.array([of(variable) for variable in variables])


@dataclass(frozen=True)
class Trial:
    """A finished trial, as callbacks see it. SI.

    rms_m is what the trial counts as (Outcome.value), the penalty when the solve failed for `reason`; tip_error_m is None then;
    best_rms_m: least so far, this trial included; finished of wanted trials are done; seconds: all of this trial; seconds_left: guessed,
    until the last trial.
    """

    number: int
    rms_m: float
    tip_error_m: float | None
    best_rms_m: float | None
    improved: bool
    reason: str | None
    target: NDArray[np.float64]
    finished: int = 0
    wanted: int = 0
    seconds: float = 0.0
    seconds_left: float = 0.0
    shapes: tuple[Mapping[str, Any], ...] = ()  # of an insertion: what pictures need of each depth


@dataclass(frozen=True)
class Outcome:
    """Outcome of solving a design: a result and its distances (m), or the penalty and the reason.

    A design that is refused keeps its result and distances, with the reason.
    """

    result: Result | None
    rms: float
    tip_error: float | None
    reason: str | None
    seconds: float
    model: Mapping[str, Any] = field(default_factory=dict)  # attributes of a solve with derivatives
    stability: float | None = None  # of the result (Result.stability)
    refused: bool = False  # solved, but less stable than the study's margin
    known: dict[str, Any] = field(default_factory=dict)  # attributes to save of the trial
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
    """Value of a failed solve, m: the catheter's length.

    Finite, so that samplers learn from it, and farther from the target than most designs: a straight catheter is nearer.
    """
    return scene.length


def attempted(work: Callable[[], Found], scene: Scene, log: Path) -> Found | str:
    """Outcome of `work`, or the reason why it failed; unexpected errors are logged with their traceback. Interrupts pass through."""
    try:
        return work()
    except SolveError as error:
        return error.reason
    except Exception as error:  # a study runs for hours: no design may end it
        with naming(log), log.open("a", encoding="utf-8") as stream:
            stream.write(f"scene {scene.hash()}\n{traceback.format_exc()}\n")
        return f"{type(error).__name__}: {error}"


def evaluate(
    solve: Callable[[Scene], Result | tuple[Result, Mapping[str, Any]]], scene: Scene, target: NDArray[np.float64], log: Path,
    margin: float | None = None,
) -> Outcome:  # fmt: skip
    """Solves a scene and compares it with target rows [s, x, y, z], (m, 4) m.

    solve: gives the Result, and what else is to be stored of the trial, if anything. margin: least stability; one that is less
    is refused.

    A solve that fails in any way, or ends in numbers that are not finite, gives the penalty with a reason.
    """
    begun = time.perf_counter()

    def failed(reason: str) -> Outcome:
        return Outcome(None, penalty(scene), None, reason, time.perf_counter() - begun)

    def solved() -> tuple[Result, Mapping[str, Any], float, Array]:
        found = solve(scene)
        result, model = found if isinstance(found, tuple) else (found, {})
        return result, model, time.perf_counter() - begun, gaps(result, target)

    found = attempted(solved, scene, log)
    if isinstance(found, str):
        return failed(found)
    result, model, seconds, apart = found
    rms, tip = root_mean_square(apart), float(np.linalg.norm(apart[-1]))
    if not (np.isfinite(rms) and np.isfinite(tip)):
        return failed("the result holds numbers that are not finite")
    if not result.converged:
        return failed("the solve did not converge")
    model = {"residuals": _rounded((apart / np.sqrt(len(apart))).reshape(-1)), **model}
    stability = getattr(result, "stability", None)
    if margin is not None and stability is None:
        return failed("the stability of the result is not known, and the study has a margin")
    if margin is not None and stability is not None and stability < margin:
        reason = f"stability {stability:.3g} is below the margin, {margin:g}"
        return Outcome(result, rms, tip, reason, seconds, model, stability, refused=True)
    return Outcome(result, rms, tip, None, seconds, model, stability)


def constraints(outcome: Outcome, margin: float | None) -> dict[str, float]:
    """Optuna's constraints of a trial, satisfied at 0 and below; the same ones for every trial of a study, however it ended."""
    if margin is None:
        return {}
    return {"stability": 1.0 if outcome.stability is None else margin - outcome.stability}


def attributes(outcome: Outcome, scene: Scene, directions: NDArray[np.float64], uniform: NDArray[np.float64]) -> dict[str, Any]:
    """Attributes stored of a trial in addition to its parameters and value: user attributes, plain data in SI.

    directions (k, 3): magnetization of each segment; uniform field (3,) T.
    """
    result = outcome.result
    kept: dict[str, Any] = {
        "feasible": outcome.accepted,
        "scene_hash": scene.hash(),
        "magnetization": np.round(directions, 9).tolist(),
        "field_T": np.round(uniform, 12).tolist(),
        "versions": dict(versions() if result is None else {**versions(), **result.versions}),
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


def versions() -> Mapping[str, str]:
    """Versions of what chose the trials; the result names those of what solved it."""
    from importlib.metadata import version

    return {name: version(name) for name in ("magmpm", "optuna")}


def needs_derivatives(study: Study) -> bool:
    """True if the trials of a study are solved with derivatives."""
    return study.sampler == "gauss-newton" or study.robust is not None


def linear_model(found: Sensitivities, target: Array, space: SearchSpace, params: Mapping[str, Any]) -> dict[str, Any]:
    """The user attributes of a solved trial that Gauss-Newton reads; target rows [s, x, y, z], (m, 4) m.

    residuals: the gaps at the target's rows, component by component, over the root of m: their sum of squares is rms^2. jacobian: their
    derivatives by the embedded coordinates of the design (parameters.py).
    """
    share = 1.0 / np.sqrt(len(target))
    gap = gaps(found.result, target)
    slopes = gap_derivatives(found, target).reshape(gap.size, -1)
    chain = space.chain(found.variables, space.embedded(params), params.get("order"))
    return stored(share * gap.reshape(-1), share * slopes @ chain)


def solve_with_derivatives(
    differentiate: Differentiate, scene: Scene, study: Study, space: SearchSpace, params: Mapping[str, Any]
) -> tuple[Result, dict[str, Any]]:
    """The equilibrium of a trial, and what is stored of its derivatives: the linear model for gauss-newton, the scatter for `robust`."""
    follows, errors = study.sampler == "gauss-newton", study.robust
    of = [*(space.sensitivities if follows else ()), *(kinds(errors) if errors is not None else ())]
    found = differentiate(scene, list(dict.fromkeys(of)))
    model = linear_model(found, study.target, space, params) if follows else {}
    if errors is not None:
        spread = gap_derivatives(found, study.target) * deviations(scene, found.variables, errors)
        model |= Scatter(gaps(found.result, study.target), spread).attributes()
    return found.result, model


def stored(residuals: Array, jacobian: Array) -> dict[str, Any]:
    """The attributes of residuals (m,) and their Jacobian (m, k), as JSON with 9 digits: a step of the sampler needs no more.

    Optuna keeps an attribute in a column of the type TEXT, which holds anything in SQLite and PostgreSQL, but 65 535 bytes in MySQL. Where
    a Jacobian is longer, its QR factorization is stored in place of both: r = Q r', J = Q J' have the same sums of squares for every step.
    """
    if jacobian.size > 3600 and len(residuals) > jacobian.shape[1] + 1:  # numbers of at most 18 characters
        triangle: Array = np.asarray(np.linalg.qr(np.column_stack([jacobian, residuals]), mode="r"))
        residuals, jacobian = triangle[:, -1], triangle[:, :-1]
    return {"residuals": _rounded(residuals), "jacobian": [_rounded(row) for row in jacobian]}


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.9g}") for value in values.tolist()]
