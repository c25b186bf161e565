"""One trial: a design's scene is solved and compared with the target. Whatever goes wrong fails the trial, not the study."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.errors import SolveError
from magmpm.results.result import Result
from magmpm.results.sensitivities import Sensitivities
from magmpm.results.whole_file import naming
from magmpm.scene import Scene
from magmpm.studies.evaluate.robust import Scatter, deviations, kinds
from magmpm.studies.problem.shape_distance import gap_derivatives, gaps, root_mean_square
from magmpm.studies.problem.study import Study
from magmpm.studies.search.search_space import SearchSpace

Found = TypeVar("Found")
Solve = Callable[..., Result]  # from a scene to its equilibrium: magmpm.run(scene, start=a rod's shape near which it is)
Differentiate = Callable[..., Sensitivities]  # ... and its derivatives: magmpm.sensitivities(scene, of, start=...)


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
        """Value of the trial, m: the rms, or the measure of a design with errors (robust.py)."""
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
