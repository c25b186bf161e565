"""viscosity: losses in the material (Kelvin-Voigt): a viscous stress with the elastic one.

Cauchy stress 2 eta D, with D = (L + L^T)/2 and L = dF F^-1 the velocity gradient; per undeformed area P = 2 eta J D F^-T. It is
objective (a rigid turn makes none), exerts no torque, and turns 2 eta J D:D >= 0 per undeformed volume and second into heat. A small
vibration of frequency w is damped with ratio eta w / (2 G) in shear, and by about 3 eta / (2 E) w in bending.
Source: Holzapfel, Nonlinear Solid Mechanics, section 5.7; Antman, Nonlinear Problems of Elasticity, chapter 12.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.base import Advice, Effect, Records, RestEstimate, SceneLike, one_record
from magmpm.effects.hooks import register
from magmpm.inputs.settings import Quantity

DTYPE = np.dtype([("viscosity", np.float64)])
STEEPEST = 6.0  # largest sum of N'^2 / N over the three splines of a cell, times h^2


def parameters(viscosity: float) -> Records:
    """Parameters for the kernels. viscosity eta, Pa s."""
    return one_record(DTYPE, viscosity=viscosity)


class Viscosity(Effect):
    """Losses in the material: a viscous stress 2 eta D with the elastic one (Kelvin-Voigt)."""

    PHASE = "force"
    ONLY_IN_MOTION = True
    viscosity: Annotated[float, Quantity("viscosity", at_least="0 Pa s", at_most="1e6 Pa s")] = Field(
        description="eta; a motion of angular frequency w has damping ratio eta w / (2 G).",
        examples=["5 Pa s"],
    )

    def records(self, scene: SceneLike, strength: float = 1.0, times: Array | None = None) -> Records:
        """Parameters for the kernels, or () where the viscosity is zero."""
        return parameters(self.viscosity) if self.viscosity > 0 else ()

    def stable_step(self, model: Any) -> float:
        """Largest stable step (s), with elastic stress at 0.8 of its own limit.

        With lumped mass, no motion strains faster than s^2 = sum_axes 6 / h^2 allows (Cauchy-Schwarz over a particle's splines), so
        viscous stress decays at rates up to r = 2 eta s^2 / rho. It is computed from velocities one step old. A step is then stable
        while (w dt)^2 / 4 + r dt / 2 <= 1 for the fastest elastic frequency w. With w dt at 0.8 of 2 this leaves r dt <= 0.72, so the
        bound is 0.9 / r before the same factor 0.8. The corrected mass (dynamics.nodal_mass) makes the fastest rate 0.39 of r at most,
        measured on rods, blocks and strips of 2 to 4 cells, 0.18 with lumped mass.
        """
        steep = float(np.sum(STEEPEST / np.asarray(model.grid.spacing) ** 2))
        if model.grid.runs:  # at repeated knots splines are steeper than between equal cells
            steep = max(steep, float(model.steepness().sum(axis=1).max()))
        return 0.9 / (2.0 * self.viscosity / float(model.density.min()) * steep)

    @classmethod
    def advice(cls, scene: SceneLike, body: RestEstimate) -> Advice:
        """The damping ratio of the first bending."""
        if body.frequency is None:
            return Advice(0.0, "moves no equilibrium; losses in the material")
        named = scene.effects.viscosity
        softest = min(scene.materials[region.material_name].shear_modulus for region in scene.regions())
        critical = 2 * softest / body.frequency
        if named is None:
            return Advice(0.0, f"moves no equilibrium; {critical:.3g} Pa s damps its first bending critically")
        ratio = named.viscosity / critical
        return Advice(0.0, f"moves no equilibrium; damps its first bending by {100 * ratio:.2g} % of critical")


@compiled
def rate_stress(effect, data, rho, F, dF, P):
    """P += 2 eta J D F^-T, Pa, with D the symmetric part of L = dF F^-1. Written without loops: it serves eight particles at a time."""
    a, b, c, d, e, f, g, h, i = F[0, 0], F[0, 1], F[0, 2], F[1, 0], F[1, 1], F[1, 2], F[2, 0], F[2, 1], F[2, 2]
    cofactors = (
        (e * i - f * h, f * g - d * i, d * h - e * g),
        (c * h - b * i, a * i - c * g, b * g - a * h),
        (b * f - c * e, c * d - a * f, a * e - b * d),
    )
    x, y, z = cofactors
    scale = effect.viscosity / (a * x[0] + b * x[1] + c * x[2])  # eta / J; 2 D = L + L^T
    xx = 2.0 * scale * (dF[0, 0] * x[0] + dF[0, 1] * x[1] + dF[0, 2] * x[2])
    yy = 2.0 * scale * (dF[1, 0] * y[0] + dF[1, 1] * y[1] + dF[1, 2] * y[2])
    zz = 2.0 * scale * (dF[2, 0] * z[0] + dF[2, 1] * z[1] + dF[2, 2] * z[2])
    xy = scale * (dF[0, 0] * y[0] + dF[0, 1] * y[1] + dF[0, 2] * y[2] + dF[1, 0] * x[0] + dF[1, 1] * x[1] + dF[1, 2] * x[2])
    xz = scale * (dF[0, 0] * z[0] + dF[0, 1] * z[1] + dF[0, 2] * z[2] + dF[2, 0] * x[0] + dF[2, 1] * x[1] + dF[2, 2] * x[2])
    yz = scale * (dF[1, 0] * z[0] + dF[1, 1] * z[1] + dF[1, 2] * z[2] + dF[2, 0] * y[0] + dF[2, 1] * y[1] + dF[2, 2] * y[2])
    for k in range(3):
        P[0, k] += xx * x[k] + xy * y[k] + xz * z[k]
        P[1, k] += xy * x[k] + yy * y[k] + yz * z[k]
        P[2, k] += xz * x[k] + yz * y[k] + zz * z[k]


register(DTYPE, wide=("rate_stress",), rate_stress=rate_stress)
