"""Distance of a body's axis from a target shape, and how it changes with the sensitivities.

Points are compared at equal arc length of the undeformed body. A body that is shorter than its target (its length may be varied) has no
points at the target's last stations: there its tip is compared, so that a design does not come nearer by being short.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from magmpm.bodies.curves import on_rows
from magmpm.compiled.arrays import Array, Mask

if TYPE_CHECKING:
    from magmpm.statics.linearized import Sensitivities


def gaps(axis: Array, target: Array) -> Array:
    """Find the vectors from a target's points to the axis at the same arc lengths.

    Parameters
    ----------
    axis : array (k, 4), m
        Rows [s, x, y, z] of the body's axis.
    target : array (m, 4), m
        Rows [s, x, y, z].

    Returns
    -------
    array (m, 3), m
        A vector for each row. Where the body is shorter than the target its tip is compared.
    """
    found = on_rows(axis[:, 0], axis[:, 1:], _stations(axis, target)[0])[0]
    return np.asarray(found - target[:, 1:])


def _stations(axis: Array, target: Array) -> tuple[Array, Mask]:
    """Arc lengths (m,) m of the axis that are compared with the target, and at which the tip stands in. A table's rounding is no excess."""
    length = axis[-1, 0]
    beyond = target[:, 0] > length * (1 + 1e-6)
    return np.where(beyond, length, target[:, 0]), beyond


def root_mean_square(gaps: Array) -> float:
    """Find the root mean square of distances.

    Parameters
    ----------
    gaps : array (m, 3), m
        The vectors.

    Returns
    -------
    float, m
        Root of the mean of their squared lengths.
    """
    return float(np.sqrt(np.mean(np.sum(gaps**2, axis=1))))


def gap_derivatives(sensitivities: Sensitivities, target: Array) -> Array:
    """Find the derivatives of `gaps`.

    Parameters
    ----------
    sensitivities : Sensitivities
        Those of the body, for k variables.
    target : array (m, 4), m
        Rows [s, x, y, z].

    Returns
    -------
    array (m, 3, k), m per unit
        Of each vector for each variable.
    """
    stations, beyond = _stations(sensitivities.result.centreline, target)
    found = sensitivities.at(stations)
    found[beyond] = sensitivities.centreline[-1]
    return np.asarray(found)
