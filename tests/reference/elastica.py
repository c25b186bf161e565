"""Exact solutions for rods that neither stretch nor shear, from quadratures and boundary-value problems, independent of the rod model.

Lengths over L, angles in radians, s = 0 clamped.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import quad, solve_bvp, solve_ivp
from scipy.optimize import brentq


@dataclass(frozen=True)
class Elastica:
    """Tip of the hard-magnetic elastica: deflection and axial position over L, angle in rad; curvature (times L) at the clamp."""

    load: float
    field_angle: float
    deflection: float
    axial: float
    angle: float
    clamp_curvature: float

    def curve(self, s: np.ndarray) -> np.ndarray:
        """(m, 3): axial position, deflection, angle at s over L."""

        def slope(_: float, y: np.ndarray) -> list[float]:
            return [np.cos(y[2]), np.sin(y[2]), y[3], -self.load * np.sin(self.field_angle - y[2])]

        solved = solve_ivp(
            slope,
            (0, 1),
            [0, 0, 0, self.clamp_curvature],
            method="DOP853",
            rtol=1e-12,
            atol=1e-13,
            t_eval=s,
        )
        return solved.y[:3].T


def elastica(load: float, field_angle: float) -> Elastica:
    """theta'' + load sin(phi - theta) = 0, theta(0) = 0, theta'(1) = 0, on the branch 0 < theta < phi.

    Multiplied by theta' it integrates once: theta'^2 = 2 load (cos(phi - theta_1) - cos(phi - theta)), theta_1 the
    tip's angle. So length and positions are integrals over theta, and theta_1 follows from length 1. The
    substitution theta = theta_1 - t^2 removes the singularity.
    Source: the pendulum; Wang et al., JMPS 142 (2020) 104045, section 3. At phi = pi there is a solution for loads above pi^2/4.
    """

    def integral(weight: str, tip: float) -> float:
        def integrand(t: float) -> float:
            theta = tip - t * t
            # cos(a) - cos(b) as a product, and divided by t^2, so that t -> 0 is not 0/0
            half = t * t / 2
            root = 2 * np.sin(field_angle - tip + half) * np.sinc(half / np.pi) / 2
            value = {"length": 1.0, "axial": np.cos(theta), "deflection": np.sin(theta)}[weight]
            return float(2 * value / np.sqrt(2 * load * root))

        return quad(integrand, 0, np.sqrt(tip), epsabs=1e-11, epsrel=1e-11)[0]

    tip = brentq(lambda a: integral("length", a) - 1, 1e-6, field_angle - 1e-4, xtol=1e-14)
    curvature = np.sqrt(2 * load * (np.cos(field_angle - tip) - np.cos(field_angle)))
    return Elastica(
        load,
        field_angle,
        integral("deflection", tip),
        integral("axial", tip),
        tip,
        float(curvature),
    )


def heavy_elastica(weight: float, s: np.ndarray) -> np.ndarray:
    """Horizontally clamped rod, bent by its own weight: (m, 3) axial position, downward deflection, angle.

    theta'' = -weight (1 - s) cos(theta), weight = rho g A L^3/(E I). Source: Timoshenko and Gere; Wang, Int. J. Mech. Sci. 28 (1986) 549.
    """

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[0], a[2], a[3], b[1]])

    mesh = np.linspace(0, 1, 41)
    guess = np.zeros((4, len(mesh)))
    for part in (
        np.linspace(0.2, 1, 5) * weight
    ):  # continuation in the load, to stay on the branch that starts from zero

        def slope(s: np.ndarray, y: np.ndarray, part: float = part) -> np.ndarray:
            return np.stack([y[1], -part * (1 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

        solved = solve_bvp(slope, ends, mesh, guess, tol=1e-10, max_nodes=20000)
        if not solved.success:
            raise RuntimeError(solved.message)
        mesh = solved.x
        guess = solved.y
    return solved.sol(s)[[2, 3, 0]].T
