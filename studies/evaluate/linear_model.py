"""A design's distances from its target and their derivatives, as trials store them and the Gauss-Newton sampler reads them.

residuals: the gaps x(s_k) - x_k at the target's m rows, component by component, over the root of m: their sum of squares is rms^2, in m^2.
jacobian: their derivatives by the embedded coordinates of the design (blocks.py).

Both are stored as JSON, with 9 digits: a step of the sampler needs no more, and its next trial corrects what they lack. Optuna keeps
a trial's attribute in a column of the type TEXT, which holds anything in SQLite and PostgreSQL, but 65 535 bytes in MySQL. Where a
Jacobian is longer, its QR factorization is stored in place of both: r = Q r', J = Q J' with orthonormal columns of Q have the same sums
of squares for every step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.results.result import Result
from magmpm.rod.cosserat import RodShape
from magmpm.scene import Scene
from magmpm.studies.evaluate.robust import Scatter, deviations, kinds
from magmpm.studies.problem.shape_distance import gap_derivatives, gaps
from magmpm.studies.problem.study import Study
from magmpm.studies.search.search_space import SearchSpace, VariableLike

DIGITS = 9
MOST_NUMBERS = 3600  # in a Jacobian: of at most 18 characters each


class Sensitive(Protocol):
    """Interface of magmpm.Sensitivities as far as it is read."""

    @property
    def result(self) -> Result: ...

    @property
    def variables(self) -> Sequence[VariableLike]: ...

    @property
    def centreline(self) -> Array: ...

    def at(self, arc_lengths: Array) -> Array: ...


class Differentiate(Protocol):
    """From a scene and the kinds of variables to its equilibrium and derivatives: magmpm.sensitivities."""

    def __call__(self, scene: Scene, of: Sequence[str], *, start: RodShape | None = None) -> Sensitive: ...


def needs_derivatives(study: Study) -> bool:
    """True if the trials of a study are solved with derivatives."""
    return study.sampler == "gauss-newton" or study.robust is not None


def linear_model(found: Sensitive, target: Array, space: SearchSpace, params: Mapping[str, Any]) -> dict[str, Any]:
    """The user attributes `residuals` (m) and `jacobian` (m rows) of a solved trial with target rows [s, x, y, z], (k, 4) m."""
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
    """The attributes of residuals (m,) and their Jacobian (m, k), rounded, and shortened where they are long."""
    if jacobian.size > MOST_NUMBERS and len(residuals) > jacobian.shape[1] + 1:
        triangle: Array = np.asarray(np.linalg.qr(np.column_stack([jacobian, residuals]), mode="r"))
        residuals, jacobian = triangle[:, -1], triangle[:, :-1]
    return {"residuals": _rounded(residuals), "jacobian": [_rounded(row) for row in jacobian]}


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values.tolist()]
