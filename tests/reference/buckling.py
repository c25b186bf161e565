"""The field in which a clamped rod that is magnetized against it buckles: Euler's load of the Cosserat rod."""

from dataclasses import dataclass

import numpy as np

from magmpm.fields.dipole import MU0
from magmpm.materials import poisson_ratio, young_modulus
from magmpm.scene import Scene


@dataclass(frozen=True)
class Column:
    """A uniform clamped rod. SI: length m, bending N m^2, shear k GA and tension EA N, moment A Br/mu0 per length A m."""

    length: float
    bending: float
    shear: float
    tension: float
    moment: float

    @property
    def critical_field(self) -> float:
        """Field (T).

        The field B turns each tangent by the couple P sin(angle) per length, P = moment B: EI angle'' + P angle = 0, angle(0) = 0 and
        angle'(L) = 0, so P = pi^2 EI/(4 L^2). The force P in each section also shears and shortens the rod, which puts
        P (1 + P/(k GA) - P/(EA)) in the place of P: the potential of magmpm.rod.cosserat to second order in the angle.
        """
        euler = np.pi**2 * self.bending / (4 * self.length**2)
        more = 1 / self.shear - 1 / self.tension
        force = (np.sqrt(1 + 4 * more * euler) - 1) / (2 * more)
        return float(force / self.moment)


def column(scene: Scene) -> Column:
    """Column of the scene of a catheter or plane-strain strip with one segment."""
    shape = scene.body.shape
    material = scene.region_material(0)
    G = material.shear_modulus
    K = material.shear_modulus * material.bulk_to_shear
    E = float(young_modulus(G, K))
    nu = float(poisson_ratio(G, K))
    if scene.body.catheter is not None:
        area = np.pi * shape.thickness**2 / 4
        second = np.pi * shape.thickness**4 / 64
        k = 6 * (1 + nu) / (7 + 6 * nu)  # Cowper, J. Appl. Mech. 33 (1966) 335
    else:
        width = scene.body.strip.width
        area = width * shape.thickness
        second = width * shape.thickness**3 / 12
        E = E / (1 - nu**2)
        k = 5 / 6
    return Column(shape.length, E * second, k * G * area, E * area, area * material.remanence / MU0)
