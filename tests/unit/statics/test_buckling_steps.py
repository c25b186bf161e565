"""Newton's method where a body is about to buckle."""

from __future__ import annotations

import numpy as np
from reference.scenes import field_for_load, rod_scene

from magmpm.model import build
from magmpm.statics import newton
from magmpm.statics.energy import Energy
from magmpm.statics.layout import static_model
from magmpm.statics.rod_start import straight


def test_a_shifted_step_goes_on_along_the_mode_that_buckles() -> None:
    """A straight rod in a field against it, at twice its critical load, pi^2/4: the state found is bent, and lower in energy by more than a
    hundredth of M B V (mode and step are no equilibrium). Below the critical load there is no lower state, and the point stays."""
    length = 32e-3
    for load, buckles in ((2 * np.pi**2 / 4, True), (0.5 * np.pi**2 / 4, False)):
        against = field_for_load(load, np.pi, length=length, diameter=4e-3)
        model = static_model(build(rod_scene(length=length, field=against, cells=2)))
        energy = Energy(model)
        point = energy.at(straight(model))
        residual, shift = newton.factored(energy, point, newton.FIRST_SHIFT)
        assert shift > 0.0
        found = newton._along_mode(energy, point, residual, 1)
        assert (point.energy - found.energy > 0.01 * abs(energy.rest_energy())) == buckles
        assert (np.abs(found.displacement).max() > 0.05 * length) == buckles
