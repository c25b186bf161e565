"""viscosity: losses in the material: a viscous stress with the elastic one (Kelvin-Voigt), and branches that relax (Maxwell).

Cauchy stress 2 eta D, with D = (L + L^T)/2 and L = dF F^-1 the velocity gradient; per undeformed area P = 2 eta J D F^-T. It is
objective (a rigid turn makes none), exerts no torque, and turns 2 eta J D:D >= 0 per undeformed volume and second into heat. A small
vibration of frequency w is damped with ratio eta w / (2 G) in shear, and by about 3 eta / (2 E) w in bending.
Source: Holzapfel, Nonlinear Solid Mechanics, section 5.7; Antman, Nonlinear Problems of Elasticity, chapter 12.

A branch of shear modulus G and time T is a neo-Hookean spring in series with a dashpot, and remembers its viscous strain Cv (det Cv = 1):

    W = G/2 (tr(C Cv^-1) - 3),    dCv/dt = (C - tr(C Cv^-1)/3 Cv) / T,    with C = J^(-2/3) F^T F

It depends on F^T F alone (frame indifferent). In small strain its modulus is G i w T / (1 + i w T). A step of dt sets
Cv = k Cv + (1 - k) C, k = exp(-dt/T), and divides by det^(1/3): exact where strain is small and C constant. Cv stays positive definite, and
W never grows by it, for any dt. For in the basis where Cv = 1, with a = k + (1 - k) c of the eigenvalues c of C, the change of ln W + 3 has
the sign of mean(x) - sum(x y)/sum(y), x = (c - 1)/a and y = c/a = 1 + k x: never positive, because y grows with x (Chebyshev).
At rest a branch is relaxed: equilibria do not know it.

A loss factor tan(delta) = G''/G' that is the same at all frequencies is that of branches a decade apart, from 1 Hz to 1 kHz, whose moduli
are fitted to it by least squares: constant within 7 %.
Source: Reese and Govindjee, Int. J. Solids Struct. 35 (1998) 3455; the step: Shutov, Landgraf, Ihlemann, CMAME 265 (2013) 213.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled, inlined
from magmpm.compiled.simd import determinant_of, inverse_cube_root
from magmpm.effects.base import Effect, Records, SceneLike, one_record
from magmpm.effects.hooks import register
from magmpm.errors import SceneError, quantity
from magmpm.inputs.settings import Quantity, Settings, fault
from magmpm.materials import STIFFEST, pressure_wave_speed

DTYPE = np.dtype([("viscosity", np.float64)])
BRANCHES = np.dtype([("branches", np.int64)])
AT_REST = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])  # xx, yy, zz, xy, xz, yz of Cv
BAND = (1.0, 1000.0)  # Hz, in which a loss factor holds
STEEPEST = 6.0  # largest sum of N'^2 / N over the three splines of a cell, times h^2


class Branch(Settings):
    """A spring in series with a dashpot (Maxwell)."""

    shear_modulus: Annotated[float, Quantity("pressure", above="0 kPa", at_most=STIFFEST)] = Field(
        description="Shear modulus G that the branch adds to quick deformations.",
        examples=["500 kPa"],
    )
    time: Annotated[float, Quantity("time", above="0 s", at_most="86400 s")] = Field(
        description="Time in which its stress falls to 1/e.", examples=["10 ms"]
    )


class Viscosity(Effect):
    """Losses in the material: a viscous stress 2 eta D with the elastic one (Kelvin-Voigt), and branches that relax (Maxwell).

    Parameters
    ----------
    viscosity : float or str, Pa s, optional
        eta; a motion of angular frequency w has damping ratio eta w / (2 G).
    branches : sequence of dict, optional
        Branches that relax, each a spring in series with a dashpot; at rest they have no
        stress.
    loss_factor : float, no unit, optional
        tan(delta), the loss modulus over the storage modulus, within 7 % the same from 1 Hz to
        1 kHz; silicones have 0.02 to 0.2. In place of `viscosity` and `branches`. A new load creeps:
        the slowest branch takes 0.16 s, and until then swings are about a middle that drifts.

    Examples
    --------
    >>> from magmpm import Viscosity
    >>> Viscosity(viscosity="5 Pa s").viscosity  # Pa s
    5.0
    """

    PHASE = "force"
    ONLY_IN_MOTION = True
    viscosity: Annotated[float, Quantity("viscosity", at_least="0 Pa s", at_most="1e6 Pa s")] = (
        Field(
            default=0.0,
            description="eta; a motion of angular frequency w has damping ratio eta w / (2 G).",
            examples=["5 Pa s"],
        )
    )
    branches: tuple[Branch, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=8,
        description=(
            "Branches that relax, each a spring in series with a dashpot; at rest they have no"
            " stress."
        ),
        examples=[[{"shear_modulus": "500 kPa", "time": "10 ms"}]],
    )

    loss_factor: (
        Annotated[float, Field(strict=True, ge=0.001, le=0.3, allow_inf_nan=False)] | None
    ) = Field(
        default=None,
        description=(
            "tan(delta), the loss modulus over the storage modulus, within 7 % the same from 1 Hz to"
            " 1 kHz; silicones have 0.02 to 0.2. In place of `viscosity` and `branches`. A new load"
            " creeps: the slowest branch takes 0.16 s, and until then swings are about a middle that"
            " drifts."
        ),
        examples=[0.1],
    )

    @model_validator(mode="after")
    def _loses(self) -> Viscosity:
        remedy = (
            "write, say, `loss_factor: 0.1`, `viscosity: 5 Pa s` or `branches: [{shear_modulus: 500"
            " kPa, time: 10 ms}]`"
        )
        named = "viscosity" in self.model_fields_set or self.branches is not None
        if self.loss_factor is None and not named:
            raise fault(
                "give `loss_factor`, or `viscosity` or `branches` or both: without them there is "
                "no loss",
                remedy,
                ("viscosity",),
            )
        # plain data of a scene has all its keys: without a loss, a viscosity of zero
        others = self.viscosity > 0.0 or self.branches is not None
        if self.loss_factor is not None and others:
            raise fault("give `loss_factor` or the others, not both", remedy, ("loss_factor",))
        return self

    def relaxing(self, scene: SceneLike) -> tuple[Branch, ...]:
        """The branches of a scene's material: those that are named, or those of the loss factor."""
        if self.loss_factor is None:
            return self.branches or ()
        modulus = max(_moduli(scene), default=0.0)
        shares, times = of_loss_factor(self.loss_factor)
        return tuple(
            Branch.model_construct(shear_modulus=share * modulus, time=time)
            for share, time in zip(shares, times, strict=True)
        )

    def check(self, model: Any) -> None:
        """Raises SceneError where materials of different stiffness would share the branches of a loss factor."""
        moduli = _moduli(model.scene)
        if self.loss_factor is not None and len(moduli) > 1:
            words = " and ".join(f"{1e-3 * modulus:g} kPa" for modulus in sorted(moduli))
            raise SceneError(
                "effects.viscosity.loss_factor",
                received=f"{self.loss_factor:g}, for materials of {words}",
                rule="all that moves must have one shear modulus, of which the branches are parts",
                remedy=(
                    "write `viscosity: {viscosity: 50 Pa s}` in its place (at a frequency f it is"
                    " G tan(delta) / (2 pi f)), or `branches` with moduli of their own"
                ),
            )

    def warnings(self, scene: SceneLike) -> list[str]:
        """Warn of a viscosity that makes steps a quarter as long as those of the body alone, or less.

        On rods of two cells steps are about 2/r, r = 12 eta / (rho h^2), and those of the body 0.63 of the time T in which a wave
        crosses a cell, T^2 = rho h^2 / M with M = K + 4 G/3. A branch of shear modulus K and time eta/K has the same viscosity; in
        storage and loss it is within G/100 of it while K (w eta/K)^2 < G/100.
        """
        if self.viscosity == 0.0 or scene.solver.dynamic is None:
            return []
        names = {region.material_name for region in scene.regions() if not region.held}
        softest = min((scene.materials[name] for name in names), key=lambda one: one.shear_modulus)
        shear = softest.shear_modulus
        bulk = softest.bulk_to_shear * shear
        crossing = scene.cell / pressure_wave_speed(shear, bulk, softest.density)
        shorter = 3.8 * self.viscosity / ((bulk + 4.0 * shear / 3.0) * crossing)
        if shorter < 4.0:
            return []
        time = self.viscosity / bulk
        below = 0.1 * math.sqrt(shear / bulk) / (2.0 * math.pi * time)
        branch = f"{{shear_modulus: {quantity(bulk, 'Pa')}, time: {quantity(time, 's')}}}"
        return [
            f"effects.viscosity: {quantity(self.viscosity, 'Pa s')} make time steps about"
            f" {shorter:.2g} times as short as those of the body alone; `branches: [{branch}]` in"
            f" its place is the same below {quantity(below, 'Hz')}, within 1 % of the shear modulus,"
            " at long steps"
        ]

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels, or () where the viscosity is zero and there is no branch."""
        named = self.relaxing(scene)
        table = np.array([(branch.shear_modulus, branch.time) for branch in named]).ravel()
        branches = one_record(BRANCHES, table, branches=len(table) // 2) if len(table) else ()
        return (
            one_record(DTYPE, viscosity=self.viscosity) if self.viscosity > 0 else ()
        ) + branches

    def stable_step(self, model: Any) -> float | None:
        """Largest stable step (s), with elastic stress at 0.8 of its own limit.

        With lumped mass, no motion strains faster than s^2 = sum_axes 6 / h^2 allows (Cauchy-Schwarz over a particle's splines), so
        viscous stress decays at rates up to r = 2 eta s^2 / rho. It is computed from velocities one step old. A step is then stable
        while (w dt)^2 / 4 + r dt / 2 <= 1 for the fastest elastic frequency w. With w dt at 0.8 of 2 this leaves r dt <= 0.72, so the
        bound is 0.9 / r before the same factor 0.8. The corrected mass (dynamics.nodal_mass) makes the fastest rate 0.39 of r at most,
        measured on rods, blocks and strips of 2 to 4 cells, 0.18 with lumped mass.
        """
        if self.viscosity == 0.0:  # branches are springs, part of the body's own bound
            return None
        steep = float(np.sum(STEEPEST / np.asarray(model.grid.spacing) ** 2))
        if model.grid.runs:  # at repeated knots splines are steeper than between equal cells
            steep = max(steep, float(model.steepness().sum(axis=1).max()))
        return 0.9 / (2.0 * self.viscosity / float(model.density.min()) * steep)


def _moduli(scene: SceneLike) -> set[float]:
    """Shear moduli (Pa) of what moves."""
    regions = [region for region in scene.regions() if not region.held]
    return {scene.materials[region.material_name].shear_modulus for region in regions}


@lru_cache(maxsize=32)
def of_loss_factor(loss_factor: float) -> tuple[Array, Array]:
    """Moduli (k,), over that at rest, and times (k,) s of branches with a loss factor that is nearly constant in BAND.

    G' = 1 + sum g x^2 / (1 + x^2) and G'' = sum g x / (1 + x^2), x = 2 pi f T: G'' / (tan G') = 1 is linear in g but for the weight 1 / G'.
    """
    from scipy.optimize import nnls  # imported only where it is used

    times = 1.0 / (2.0 * math.pi * np.geomspace(*BAND, 4))
    x = 2.0 * math.pi * np.outer(np.geomspace(*BAND, 121), times)
    storage = x**2 / (1.0 + x**2)
    loss = x / (1.0 + x**2)
    share = np.zeros(len(times))
    for _ in range(20):
        weight = 1.0 / (1.0 + storage @ share)
        share = nnls(weight[:, None] * (loss / loss_factor - storage), weight)[0]
    return share, times


@inlined
def _plus_product(start, a, b):
    """start + a . b of two vectors, in this order."""
    return start + a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def rate_stress(effect, data, rho, F, dF, P):
    """P += 2 eta J D F^-T, Pa, with D the symmetric part of L = dF F^-1. Written without loops: it serves eight particles at a time."""
    a = F[0, 0]
    b = F[0, 1]
    c = F[0, 2]
    d = F[1, 0]
    e = F[1, 1]
    f = F[1, 2]
    g = F[2, 0]
    h = F[2, 1]
    i = F[2, 2]
    cofactors = (
        (e * i - f * h, f * g - d * i, d * h - e * g),
        (c * h - b * i, a * i - c * g, b * g - a * h),
        (b * f - c * e, c * d - a * f, a * e - b * d),
    )
    x, y, z = cofactors
    scale = effect.viscosity / (a * x[0] + b * x[1] + c * x[2])  # eta / J; 2 D = L + L^T
    u = (dF[0, 0], dF[0, 1], dF[0, 2])
    v = (dF[1, 0], dF[1, 1], dF[1, 2])
    w = (dF[2, 0], dF[2, 1], dF[2, 2])
    xx = 2.0 * scale * _plus_product(0.0, u, x)
    yy = 2.0 * scale * _plus_product(0.0, v, y)
    zz = 2.0 * scale * _plus_product(0.0, w, z)
    xy = scale * _plus_product(_plus_product(0.0, u, y), v, x)
    xz = scale * _plus_product(_plus_product(0.0, u, z), w, x)
    yz = scale * _plus_product(_plus_product(0.0, v, z), w, y)
    for k in range(3):
        P[0, k] += xx * x[k] + xy * y[k] + xz * z[k]
        P[1, k] += xy * x[k] + yy * y[k] + yz * z[k]
        P[2, k] += xz * x[k] + yz * y[k] + zz * z[k]


@inlined
def _followed(keep, v, c):
    """keep v + (1 - keep) c over the cube root of its determinant, of symmetric matrices (xx, yy, zz, xy, xz, yz) of eight particles."""
    new = 1.0 - keep
    p = keep * v[0] + new * c[0]
    q = keep * v[1] + new * c[1]
    r = keep * v[2] + new * c[2]
    t = keep * v[3] + new * c[3]
    u = keep * v[4] + new * c[4]
    w = keep * v[5] + new * c[5]
    unit = inverse_cube_root(determinant_of(p, t, u, t, q, w, u, w, r))
    return unit * p, unit * q, unit * r, unit * t, unit * u, unit * w


@inlined
def relax(effect, data, dt, F, C, P):
    """Let Cv (6 k,) of eight particles follow F for dt (s), and P += G J^(-2/3) (F Cv^-1 - tr(F^T F Cv^-1)/3 F^-T) of each branch, Pa.

    F belongs to the middle of the step, and so does the stress: half of the step before it, half after it, to second order in dt.
    """
    a = F[0, 0]
    b = F[0, 1]
    c = F[0, 2]
    d = F[1, 0]
    e = F[1, 1]
    f = F[1, 2]
    g = F[2, 0]
    h = F[2, 1]
    i = F[2, 2]
    J = determinant_of(a, b, c, d, e, f, g, h, i)
    root = inverse_cube_root(J)
    s = root * root
    xx = s * (a * a + d * d + g * g)
    yy = s * (b * b + e * e + h * h)
    zz = s * (c * c + f * f + i * i)
    xy = s * (a * b + d * e + g * h)
    xz = s * (a * c + d * f + g * i)
    yz = s * (b * c + e * f + h * i)
    for k in range(effect.branches):
        at = 6 * k
        keep = math.exp(-0.5 * dt / data[2 * k + 1])
        now = (xx, yy, zz, xy, xz, yz)
        middle = _followed(
            keep, (C[at], C[at + 1], C[at + 2], C[at + 3], C[at + 4], C[at + 5]), now
        )
        C[at], C[at + 1], C[at + 2], C[at + 3], C[at + 4], C[at + 5] = _followed(keep, middle, now)
        p, q, r, t, u, v = middle
        p, q, r, t, u, v = (
            q * r - v * v,
            p * r - u * u,
            p * q - t * t,
            u * v - t * r,
            t * v - u * q,
            t * u - v * p,
        )  # of Cv^-1
        G = s * data[2 * k]
        n = (xx * p + yy * q + zz * r + 2.0 * (xy * t + xz * u + yz * v)) / (3.0 * s * J)
        P[0, 0] = P[0, 0] + G * (a * p + b * t + c * u - n * (e * i - f * h))
        P[0, 1] = P[0, 1] + G * (a * t + b * q + c * v - n * (f * g - d * i))
        P[0, 2] = P[0, 2] + G * (a * u + b * v + c * r - n * (d * h - e * g))
        P[1, 0] = P[1, 0] + G * (d * p + e * t + f * u - n * (c * h - b * i))
        P[1, 1] = P[1, 1] + G * (d * t + e * q + f * v - n * (a * i - c * g))
        P[1, 2] = P[1, 2] + G * (d * u + e * v + f * r - n * (b * g - a * h))
        P[2, 0] = P[2, 0] + G * (g * p + h * t + i * u - n * (b * f - c * e))
        P[2, 1] = P[2, 1] + G * (g * t + h * q + i * v - n * (c * d - a * f))
        P[2, 2] = P[2, 2] + G * (g * u + h * v + i * r - n * (a * e - b * d))


def stored(
    branches: tuple[Branch, ...], F: Array, memory: Array, lag: float
) -> tuple[Array, Array]:
    """Energy W (n,) J/m^3 and stress P (n, 3, 3) Pa of particles in these branches, lag (s) after what they remember.

    F (n, 3, 3); memory (n, 6 k) of Cv: as `relax` leaves it, half a step before the next F.
    """
    W = np.zeros(len(F))
    P = np.zeros_like(F)
    H = np.linalg.inv(F).transpose(0, 2, 1)
    C = F.transpose(0, 2, 1) @ F
    scale = np.linalg.det(F) ** (-2 / 3)
    for branch, Cv in zip(branches, memory.reshape(len(F), -1, 6).transpose(1, 0, 2), strict=True):
        keep = math.exp(-lag / branch.time)
        G = branch.shear_modulus * scale
        now = (
            keep * Cv[:, [[0, 3, 4], [3, 1, 5], [4, 5, 2]]] + (1 - keep) * scale[:, None, None] * C
        )
        inverse = np.linalg.inv(now) * np.cbrt(np.linalg.det(now))[:, None, None]
        trace = np.einsum("nij,nij->n", C, inverse)
        W += G * trace / 2 - 1.5 * branch.shear_modulus
        P += G[:, None, None] * (F @ inverse - trace[:, None, None] / 3 * H)
    return W, P


register(BRANCHES, relax=relax)
register(DTYPE, wide=True, rate_stress=rate_stress)
