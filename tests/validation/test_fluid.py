"""A fluid around a body: it falls as fast as the law of its drag says, swims as resistive-force theory says, and bends in a stream.

The laws are written here once more, from their sources (effects.fluid), for bodies that move as one.
"""

import math
from typing import Any

import numpy as np
import pytest
from reference.moving import moving_scene
from scipy.optimize import brentq

from magmpm.dynamics.time_loop import begin, interval
from magmpm.model import build
from magmpm.scene import Scene

WATER = {"density": 1000.0, "viscosity": 1e-3}
SYRUP = {"density": 1300.0, "viscosity": 2.0}
ROD = {"length": 20e-3, "diameter": 2e-3}
PLATE = {"length": 12e-3, "width": 6e-3, "thickness": 1e-3}
RHO = 1500.0  # kg/m^3
EARTH = 9.81  # m/s^2


def joined(slow: float, fast: float) -> float:
    """Churchill and Usagi's join of two laws, with the exponent 3/2."""
    return (slow**1.5 + fast**1.5) ** (2 / 3)


def slender(length: float, diameter: float, mu: float) -> tuple[float, float]:
    """Slow drag of a rod across and along, N s/m (Tirado and Garcia de la Torre 1979)."""
    p = length / diameter
    across = 4 * math.pi * mu * length / (math.log(p) + 0.839 + 0.185 / p + 0.233 / p**2)
    along = 2 * math.pi * mu * length / (math.log(p) - 0.207 + 0.980 / p - 0.133 / p**2)
    return across, along


def rod_drag(u: float, fluid: dict[str, float], *, across: bool) -> float:
    """Drag (N) of a rod that moves across or along its axis."""
    length, d = ROD["length"], ROD["diameter"]
    rho, mu = fluid["density"], fluid["viscosity"]
    slow = slender(length, d, mu)
    if across:  # Taylor 1952: C = 1.1 + 4 Re^(-1/2)
        coefficient = 1.1 + 4.0 * math.sqrt(mu / (rho * u * d))
        return joined(slow[0], rho / 2 * coefficient * length * d * u) * u
    skin = 1.328 * math.sqrt(mu / (rho * u * length))  # Blasius
    side = joined(slow[1], rho / 2 * skin * math.pi * d * length * u) * u
    return side + 2 * 0.42 * rho / 2 * math.pi * d**2 / 4 * u**2  # and two ends


def plate_drag(u: float, fluid: dict[str, float], *, across: bool) -> float:
    """Drag (N) of a plate that moves along its normal, or along its length."""
    length, b, h = PLATE.values()
    rho, mu = fluid["density"], fluid["viscosity"]
    slow = slender(length, (b + h) / 2, mu)
    if across:  # Hoerner 1965
        coefficient = 1.10 + 0.02 * (length / b + b / length)
        return joined(slow[0], rho / 2 * coefficient * length * b * u) * u
    skin = 2 * 1.328 * math.sqrt(mu / (rho * u * length))  # on both sides
    side = joined(slow[1], rho / 2 * skin * length * b * u) * u
    return side + 2 * 0.42 * rho / 2 * b * h * u**2


def falling(body: dict[str, Any], fluid: dict[str, float], along: int, **more: Any) -> Scene:
    """A free body that falls along an axis of its own."""
    pull = [0.0, 0.0, 0.0]
    pull[along] = -EARTH
    effects = {"gravity": {"acceleration": pull}, "fluid": fluid}
    material = {"shear_modulus": 30e3, "bulk_to_shear": 10.0, "density": RHO}
    return moving_scene(body, effects, materials={"m": material}, **more)


BODIES = {
    "rod": ({"catheter": ROD | {"material": "m", "clamp": "none", "segments": [{}]}}, rod_drag),
    "plate": ({"strip": PLATE | {"material": "m", "clamp": "none", "segments": [{}]}}, plate_drag),
}
VOLUME = {
    "rod": math.pi / 4 * ROD["diameter"] ** 2 * ROD["length"],
    "plate": math.prod(PLATE.values()),
}


@pytest.mark.parametrize("fluid", [WATER, SYRUP], ids=["water", "syrup"])
@pytest.mark.parametrize("along", [2, 0], ids=["across", "along"])
@pytest.mark.parametrize("name", BODIES)
def test_a_body_falls_as_fast_as_the_law_says(
    name: str, along: int, fluid: dict[str, float]
) -> None:
    body, drag = BODIES[name]
    weight = (RHO - fluid["density"]) * EARTH * VOLUME[name]
    law = brentq(lambda u: drag(u, fluid, across=along == 2) - weight, 1e-7, 10.0)
    # from the law's own speed: what is left of a start from rest is then nothing
    scene = falling(body, fluid, along)
    state = begin(build(scene))
    state.motion.v.reshape(-1, 3)[:, along] = -law
    interval(state, 20e-3)
    v = state.motion.particles()[1]
    speed = np.average(v, axis=0, weights=state.motion.model.particles.volume)
    assert -speed[along] == pytest.approx(law, rel=3e-3)
