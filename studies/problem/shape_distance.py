"""Distance of a body's axis from a target shape, and how it changes with the sensitivities.

Points are compared at equal arc length of the undeformed body. A body that is shorter than its target (its length may be varied) has no
points at the target's last stations: there its tip is compared, so that a design does not come nearer by being short.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array
from magmpm.results.measures import centreline_at
from magmpm.results.result import Result

if TYPE_CHECKING:
    from magmpm.statics.linearized import Sensitivities


def gaps(result: Result, target: Array) -> Array:
    """Vectors (m, 3) m from the target's points to the axis; target (m, 4) m: rows [s, x, y, z]."""
    return np.asarray(centreline_at(result, _stations(result, target)[0]) - target[:, 1:])


def _stations(result: Result, target: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Arc lengths (m,) m of the axis that are compared with the target, and at which the tip stands in. A table's rounding is no excess."""
    length = result.centreline[-1, 0]
    beyond = target[:, 0] > length * (1 + 1e-6)
    return np.where(beyond, length, target[:, 0]), beyond


def root_mean_square(gaps: Array) -> float:
    """Root mean square length (m) of gaps (m, 3) m."""
    return float(np.sqrt(np.mean(np.sum(gaps**2, axis=1))))


def gap_derivatives(sensitivities: Sensitivities, target: Array) -> Array:
    """Derivatives (m, 3, k) of `gaps` of the sensitivities' result, m per unit of each variable."""
    stations, beyond = _stations(sensitivities.result, target)
    found = sensitivities.at(stations)
    found[beyond] = sensitivities.centreline[-1]
    return np.asarray(found)
