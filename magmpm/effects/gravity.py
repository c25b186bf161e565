"""gravity: weight. W = -rho g . x, so the force per undeformed volume is rho g, constant, with no tangent."""

from typing import Annotated

import numpy as np
from pydantic import Field

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.base import Effect, Records, SceneLike, one_record
from magmpm.effects.hooks import register
from magmpm.inputs.settings import Quantity
from magmpm.inputs.vectors import three

DTYPE = np.dtype([("gravity", np.float64, (3,))])
_Component = Annotated[float, Quantity("acceleration", at_least="-1e4 m/s^2", at_most="1e4 m/s^2")]


class Gravity(Effect):
    """Weight.

    Parameters
    ----------
    acceleration : sequence (3,) of float or str, m/s^2, optional
        9.81 m/s^2 along -z unless given: [x, y, z].

    Examples
    --------
    >>> from magmpm import Gravity
    >>> Gravity().acceleration  # m/s^2
    (0.0, 0.0, -9.81)
    """

    PHASE = "force"
    acceleration: Annotated[
        tuple[_Component, _Component, _Component], three("[0 m/s^2, 0 m/s^2, -9.81 m/s^2]")
    ] = Field(
        default=(0.0, 0.0, -9.81),
        description="9.81 m/s^2 along -z unless given: [x, y, z].",
        examples=[["0 m/s^2", "0 m/s^2", "-9.81 m/s^2"]],
    )

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels, or () where there is no weight."""
        acceleration = strength * np.array(self.acceleration)
        return one_record(DTYPE, gravity=acceleration) if acceleration.any() else ()


@compiled
def energy(effect, data, magnet, rho, x, F):
    """-rho g . x, J/m^3: zero at the origin."""
    g = effect.gravity
    return -rho * (g[0] * x[0] + g[1] * x[1] + g[2] * x[2])


@compiled
def force(effect, data, magnet, rho, x, F, f):
    """f += rho g, N/m^3."""
    for i in range(3):
        f[i] += rho * effect.gravity[i]


register(DTYPE, wide=True, energy=energy, force=force)
