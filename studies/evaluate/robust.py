"""Effect of manufacturing errors on a design, to first order: the scatter of its shape, and the mean and spread of its rms.

Errors are independent and normal. Each magnetized segment's direction d is tilted by two angles, one along each of two perpendicular
axes across d, both of the standard deviation `direction` (so the tilt itself, whatever way, has the root mean square of sqrt(2) times
that). Each material's remanence, and each material's shear modulus, are multiplied by 1 + an error of their own; segments of one
material share it.

The gaps g (m, 3) between shape and target then are g0 + J e, with e of the covariance S (diagonal). With M = J S^(1/2) and z of independent
standard normal numbers,

    rms^2 = |g0 + M z|^2 / m,                    E[rms^2] = (|g0|^2 + tr M M^T) / m   exactly.

The rms is no linear function of z where g0 is small: there its mean is not the rms of the mean. So both moments are those of the root
itself. With the singular values s_i of M, c_i = u_i.g0 the part of g0 along each of their left vectors, and r^2 the rest of |g0|^2, the
Laplace transform of m rms^2 is

    phi(t) = exp(-t r^2) prod_i (1 + 2 t s_i^2)^(-1/2) exp(-t c_i^2 / (1 + 2 t s_i^2)),

and the mean of the root follows from it by E[sqrt(q)] = 1/(2 sqrt(pi)) integral from 0 to infinity of (1 - phi(t)) t^(-3/2) dt. Sources:
Mathai and Provost, Quadratic Forms in Random Variables (1992), chapter 3 (phi); Cressie and Borkent, J. Stat. Plan. Inference 13 (1986)
337 (fractional moments). The measure of a study is mean + 2 sigma.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.scene import Scene

if TYPE_CHECKING:
    from magmpm.scene.variables import Variable
    from magmpm.studies.problem.study_file import Robust

SIGMAS = 2.0  # of the rms, above its mean, in the measure
STEP, REACH = 0.4, 70.0  # of the integral over log t: the trapezoid rule errs by exp(-2 pi^2 / STEP), the ends by exp(-REACH / 2)


@dataclass(frozen=True)
class Scatter:
    """A design with errors. gaps (m, 3) m: nominal, from target to shape; spread (m, 3, k) m: by one standard deviation of each error."""

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
