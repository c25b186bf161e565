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
from magmpm.results.measures import centreline_at
from magmpm.results.result import Result
from magmpm.scene import Scene
from studies.search_space import SearchSpace, VariableLike

DIGITS = 9
MOST_NUMBERS = 3600  # in a Jacobian: of at most 18 characters each


class Sensitive(Protocol):
    """What is read of magmpm.Sensitivities."""

    @property
    def result(self) -> Result: ...

    @property
    def variables(self) -> Sequence[VariableLike]: ...

    def at(self, arc_lengths: Array) -> Array: ...


class Differentiate(Protocol):
    """From a scene and the kinds of variables to its equilibrium and derivatives: magmpm.sensitivities."""

    def __call__(self, scene: Scene, of: Sequence[str]) -> Sensitive: ...


def linear_model(found: Sensitive, target: Array, space: SearchSpace, params: Mapping[str, Any]) -> dict[str, Any]:
    """The user attributes `residuals` (m) and `jacobian` (m rows) of a solved trial with target rows [s, x, y, z], (k, 4) m."""
    share = 1.0 / np.sqrt(len(target))
    gap = centreline_at(found.result, target[:, 0]) - target[:, 1:]
    slopes = found.at(target[:, 0]).reshape(gap.size, -1)
    chain = space.chain(found.variables, space.embedded(params), params.get("order"))
    return stored(share * gap.reshape(-1), share * slopes @ chain)


def stored(residuals: Array, jacobian: Array) -> dict[str, Any]:
    """The attributes of residuals (m,) and their Jacobian (m, k), rounded, and shortened where they are long."""
    if jacobian.size > MOST_NUMBERS and len(residuals) > jacobian.shape[1] + 1:
        triangle: Array = np.asarray(np.linalg.qr(np.column_stack([jacobian, residuals]), mode="r"))
        residuals, jacobian = triangle[:, -1], triangle[:, :-1]
    return {"residuals": _rounded(residuals), "jacobian": [_rounded(row) for row in jacobian]}


def _rounded(values: Array) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values.tolist()]
