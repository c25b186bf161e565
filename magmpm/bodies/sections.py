"""Cross-sections of straight bodies, as a rod feels them: stiffnesses and compliances of a material's section.

Axis 1 runs along the body, 2 and 3 (y, z undeformed) lie in the section.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array

OUT_OF_PLANE = 1e3  # in plane strain, what can't happen is this many times as stiff as bending


@dataclass(frozen=True)
class Section:
    """area m^2; twist_bend (k, 3) N m^2: torsion, bending about axes 2 and 3; compliance (k, 3) 1/N: of stretch and the two shears.

    k materials, by shear modulus G, Young's modulus E and Poisson's ratio nu.
    """

    area: float
    twist_bend: Array
    compliance: Array


def ring(outer: float, inner: float, G: Array, E: Array, nu: Array) -> Section:
    """A round tube of outer and inner radius (m), of materials of moduli G and E (k,) Pa and Poisson's ratio nu (k,).

    Shear: Cowper, J. Appl. Mech. 33 (1966) 335-340.
    """
    r1, r0, m = outer, inner, inner / outer
    area, inertia = np.pi * (r1**2 - r0**2), np.pi / 4 * (r1**4 - r0**4)
    shear = 6 * (1 + nu) * (1 + m**2) ** 2 / ((7 + 6 * nu) * (1 + m**2) ** 2 + (20 + 12 * nu) * m**2)
    twist_bend = np.stack([2 * G * inertia, E * inertia, E * inertia], axis=1)
    compliance = np.stack([1 / (E * area), 1 / (shear * G * area), 1 / (shear * G * area)], axis=1)
    return Section(float(area), twist_bend, compliance)


def rectangle(width: float, thickness: float, G: Array, E: Array, nu: Array, plane_strain: bool) -> Section:
    """A rectangle, width along axis 2 and thickness along 3 (m).

    Torsion: Timoshenko and Goodier, Theory of Elasticity, section 109; shear: Cowper (1966). In plane strain E/(1 - nu^2) takes
    E's place, and twist and bending in the plane of the sheet are next to impossible.
    """
    area = width * thickness
    shear = 10 * (1 + nu) / (12 + 11 * nu)
    if plane_strain:
        E = E / (1 - nu**2)
        bend = E * area * thickness**2 / 12
        twist_bend = np.stack([OUT_OF_PLANE * bend, bend, OUT_OF_PLANE * bend], axis=1)
    else:
        second_moments = area * thickness**2 / 12, area * width**2 / 12
        twist_bend = np.stack([G * torsion_constant(width, thickness), E * second_moments[0], E * second_moments[1]], axis=1)
    compliance = np.stack([1 / (E * area), 1 / (shear * G * area), 1 / (shear * G * area)], axis=1)
    return Section(area, twist_bend, compliance)


def torsion_constant(width: float, thickness: float) -> float:
    """Torsion constant J of a rectangle, m^4: twist rate = torque / (G J)."""
    b, t = max(width, thickness), min(width, thickness)
    odd = 2 * np.arange(8) + 1.0
    series = np.sum(np.tanh(odd * np.pi * b / (2 * t)) / odd**5)
    return float(b * t**3 / 3 * (1 - 192 * t / (np.pi**5 * b) * series))
