"""Neo-Hookean silicone: energy, stress and tangent; conversions between elastic constants.

W = G/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2, with F the deformation gradient, J = det F, I1 = F:F.
Shape and volume parts are separate (``shape_*`` and ``volume_*``), because the anti-locking option averages the volume part over a cell.
Source: Simo and Hughes, Computational Inelasticity, section 9.2, with the volume term of Zhao et al., JMPS 124 (2019).
"""

from typing import TypeVar

import numpy as np

from magmpm.compiled.arrays import Array, Mask
from magmpm.compiled.jit import compiled, inner
from magmpm.compiled.simd import determinant_of, inverse_cube_root, load, store

# the largest shear modulus that a scene may give: above those of steel (80 GPa), tungsten and
# carbide (300 GPa)
STIFFEST = "500 GPa"
Moduli = TypeVar("Moduli", float, Array)


def young_modulus(shear_modulus: Moduli, bulk_modulus: Moduli) -> Moduli:
    """Find Young's modulus at small strain, E = 9 K G / (3 K + G).

    Parameters
    ----------
    shear_modulus : float or array, Pa
        G.
    bulk_modulus : float or array, Pa
        K.

    Returns
    -------
    float or array, Pa
        E.

    Examples
    --------
    >>> from magmpm.materials import young_modulus
    >>> round(young_modulus(120e3, 20 * 120e3) / 120e3, 3)  # of K = 20 G
    2.951
    """
    return 9 * bulk_modulus * shear_modulus / (3 * bulk_modulus + shear_modulus)


def pressure_wave_speed(shear_modulus: Moduli, bulk_modulus: Moduli, density: Moduli) -> Moduli:
    """Find the speed of pressure waves, sqrt((K + 4/3 G) / rho).

    Parameters
    ----------
    shear_modulus : float or array, Pa
        G.
    bulk_modulus : float or array, Pa
        K.
    density : float or array, kg/m^3
        rho.

    Returns
    -------
    float or array, m/s
        The speed.
    """
    return ((bulk_modulus + 4.0 / 3.0 * shear_modulus) / density) ** 0.5


def poisson_ratio(shear_modulus: Moduli, bulk_modulus: Moduli) -> Moduli:
    """Find Poisson's ratio at small strain, (3 K - 2 G) / (2 (3 K + G)).

    Parameters
    ----------
    shear_modulus : float or array, Pa
        G.
    bulk_modulus : float or array, Pa
        K.

    Returns
    -------
    float or array, no unit
        The ratio.
    """
    return (3 * bulk_modulus - 2 * shear_modulus) / (2 * (3 * bulk_modulus + shear_modulus))


def shear_of_young(young_modulus: Moduli, poisson: Moduli) -> Moduli:
    """Find the shear modulus at small strain, G = E / (2 (1 + nu)).

    Parameters
    ----------
    young_modulus : float or array, Pa
        E.
    poisson : float or array, no unit
        nu.

    Returns
    -------
    float or array, Pa
        G.
    """
    return young_modulus / (2 * (1 + poisson))


def bulk_over_shear(poisson: Moduli) -> Moduli:
    """Find the bulk over the shear modulus at small strain, K/G = 2 (1 + nu) / (3 (1 - 2 nu)).

    Parameters
    ----------
    poisson : float or array, no unit
        nu, below 1/2.

    Returns
    -------
    float or array, no unit
        K/G.
    """
    return 2 * (1 + poisson) / (3 * (1 - 2 * poisson))


def magnetization(rotating: Mask, remanence: Array, F: Array) -> Array:
    """Find the magnetization of deformed particles.

    Parameters
    ----------
    rotating : array (n,) of bool
        Where it rotates without stretching, R Br; elsewhere it is F Br.
    remanence : array (n, 3), T
        Br in the undeformed body.
    F : array (n, 3, 3), no unit
        Deformation gradients.

    Returns
    -------
    array (n, 3), T
        The magnetization times mu0.
    """
    R = F.copy()
    left, _, right = np.linalg.svd(F[rotating])
    R[rotating] = left @ right
    return np.einsum("nij,nj->ni", R, remanence)


@compiled
def determinant(F):
    """det F of a (3, 3) array. Written out: by `determinant_of` the compiler orders the sum in another way, and last bits change."""
    return (
        F[0, 0] * (F[1, 1] * F[2, 2] - F[1, 2] * F[2, 1])
        - F[0, 1] * (F[1, 0] * F[2, 2] - F[1, 2] * F[2, 0])
        + F[0, 2] * (F[1, 0] * F[2, 1] - F[1, 1] * F[2, 0])
    )


@compiled
def cofactor(F, out):
    """out = J F^-T, the derivative of det F; both (3, 3)."""
    for i in range(3):
        j = (i + 1) % 3
        k = (i + 2) % 3
        for L in range(3):
            M = (L + 1) % 3
            N = (L + 2) % 3
            out[i, L] = F[j, M] * F[k, N] - F[j, N] * F[k, M]


@compiled
def shape_energy(F, J, G):
    """G/2 (J^(-2/3) I1 - 3), J/m^3."""
    I1 = 0.0
    for i in range(3):
        for j in range(3):
            I1 += F[i, j] * F[i, j]
    return 0.5 * G * (J ** (-2.0 / 3.0) * I1 - 3.0)


@compiled
def volume_energy(J, K):
    """K/2 (J - 1)^2, J/m^3."""
    return 0.5 * K * (J - 1.0) ** 2


@compiled
def volume_pressure(J, K):
    """d(volume energy)/dJ = K (J - 1), Pa."""
    return K * (J - 1.0)


@compiled
def stress(F, cof, J, G, p, P):
    """Write P (3, 3) = G J^(-2/3) (F - I1/3 F^-T) + p J F^-T, first Piola-Kirchhoff, Pa: shape part by G, volume part by p = dU/dJ."""
    g = G * J ** (-2.0 / 3.0)
    I1 = 0.0
    for i in range(3):
        for j in range(3):
            I1 += F[i, j] * F[i, j]
    c = p - g * I1 / (3.0 * J)
    for i in range(3):
        for j in range(3):
            P[i, j] = g * F[i, j] + c * cof[i, j]


@compiled
def tangent(F, cof, J, G, p, stiffness, A):
    """Write dP/dF to A (9, 9), Pa; row 3 i + J, column 3 k + L. stiffness: d^2U/dJ^2, or 0 where the volume part is averaged elsewhere.

    With H = F^-T and g = G J^(-2/3):
    A_iJkL = g [d_ik d_JL - 2/3 (F_iJ H_kL + H_iJ F_kL) + 2/9 I1 H_iJ H_kL] + (g I1/3 - p J) H_iL H_kJ + (p J + stiffness J^2) H_iJ H_kL
    """
    g = G * J ** (-2.0 / 3.0)
    inv = 1.0 / J
    I1 = 0.0
    for i in range(3):
        for j in range(3):
            I1 += F[i, j] * F[i, j]
    a = (2.0 / 9.0 * g * I1 + p * J) * inv * inv + stiffness
    b = (g * I1 / 3.0 - p * J) * inv * inv
    c = -2.0 / 3.0 * g * inv
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    A[3 * i + j, 3 * k + m] = (
                        a * cof[i, j] * cof[k, m]
                        + b * cof[i, m] * cof[k, j]
                        + c * (F[i, j] * cof[k, m] + cof[i, j] * F[k, m])
                    )
            A[3 * i + j, 3 * i + j] += g


# The same for a group of eight particles, one lane each. A matrix of a group is a flat array (9 8,), row by row, each entry eight lanes.


@inner
def _entries(F, at):
    """Entries of F of a group, row by row, as lanes."""
    return (
        load(F, at),
        load(F, at + 8),
        load(F, at + 16),
        load(F, at + 24),
        load(F, at + 32),
        load(F, at + 40),
        load(F, at + 48),
        load(F, at + 56),
        load(F, at + 64),
    )


@inner
def group_determinant(F, at):
    """det F of a group, F (9 8,) from index `at`."""
    a, b, c, d, e, f, g, h, i = _entries(F, at)
    return determinant_of(a, b, c, d, e, f, g, h, i)


@inner
def neo_hookean(F, at, J, shear, pressure, P):
    """`stress` P (9 8,) of a group, F from index `at` on. Returns what `stiffest` needs: G J^(-2/3), I1 = |F|^2 and I2 = |cof F|^2."""
    a, b, c, d, e, f, g, h, i = _entries(F, at)
    root = inverse_cube_root(J)
    scale = shear * root * root
    I1 = a * a + b * b + c * c + d * d + e * e + f * f + g * g + h * h + i * i
    k = pressure - scale * I1 / (3.0 * J)
    A = e * i - f * h
    B = f * g - d * i
    C = d * h - e * g
    D = c * h - b * i
    E = a * i - c * g
    Q = b * g - a * h
    R = b * f - c * e
    S = c * d - a * f
    T = a * e - b * d
    store(P, 0, scale * a + k * A)
    store(P, 8, scale * b + k * B)
    store(P, 16, scale * c + k * C)
    store(P, 24, scale * d + k * D)
    store(P, 32, scale * e + k * E)
    store(P, 40, scale * f + k * Q)
    store(P, 48, scale * g + k * R)
    store(P, 56, scale * h + k * S)
    store(P, 64, scale * i + k * T)
    return scale, I1, A * A + B * B + C * C + D * D + E * E + Q * Q + R * R + S * S + T * T


@inner
def stiffest(J, scale, I1, I2, pressure, bulk):
    """Estimate of the largest eigenvalue, Pa, of the tangent dP/dF of a group. The largest stable step depends on it.

    The tangent (`tangent`) is g 1 + a H(x)H + b swap(H, H) - 2/3 g (F(x)H + H(x)F) with g = G J^(-2/3), H = F^-T,
    a = 2/9 g I1 + p J + K J^2 and b = g I1/3 - p J. The first three are bounded term by term, |H(x)H| = |swap| = |H|^2 = I2/J^2. The
    last is left out, because it is negative where the others are large. At rest this gives 3 K + 6 G, where the true value is 3 K.
    """
    r = 1.0 / J
    shape = scale * I1 * (1.0 / 3.0)
    turned = pressure * J
    along = shape * (2.0 / 3.0) + turned + bulk * J * J
    return scale + (0.5 * (along + abs(along)) + abs(shape - turned)) * I2 * r * r
