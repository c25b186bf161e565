"""damping: the surroundings resist in proportion to mass and velocity. Every node's velocity decays by exp(-rate dt) a step.

A motion of angular frequency w decays by exp(-rate t / 2); rate = 2 w is critical and settles soonest: about 60 /s for a silicone catheter
of 40 x 4 mm. The decay is exact for any step, so it requires no smaller step, and it never adds energy.

The forces of a step push while the decay goes on, so v(t + dt) = v exp(-x) + a dt (1 - exp(-x)) / x with x = rate dt. This is exact for a
force that does not change in the step, and symmetric about its middle, so motions are of second order in dt. A force that pushes before the
decay, a dt exp(-x), would be x / 2 too weak: 8 % for a short body that settles soonest. Source: Hochbruck, Ostermann, Acta Num. 19 (2010).
"""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.base import Effect, Records, SceneLike, one_record
from magmpm.effects.hooks import register
from magmpm.inputs.settings import Quantity

DTYPE = np.dtype([("damping_rate", np.float64)])
# of the exponent: more leaves nothing of a velocity either, and would be too large a number for a
# push
MOST_EXPONENT = 500.0


class Damping(Effect):
    """The surroundings resist in proportion to mass and velocity.

    Parameters
    ----------
    rate : float or str, 1/s
        Velocities decay by exp(-rate t); twice a motion's angular frequency settles it soonest.

    Examples
    --------
    >>> from magmpm import Damping
    >>> Damping(rate="60 1/s").rate  # 1/s
    60.0
    """

    PHASE = "damping"
    ONLY_IN_MOTION = True
    rate: Annotated[float, Quantity("rate", at_least="0 1/s", at_most="1e6 1/s")] = Field(
        description=(
            "Velocities decay by exp(-rate t); twice a motion's angular frequency settles it"
            " soonest."
        ),
        examples=["60 1/s"],
    )

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels, or () where the rate is zero."""
        return one_record(DTYPE, damping_rate=self.rate) if self.rate > 0 else ()


@compiled
def node(effect, data, X, u, v, free, dt):
    """v *= exp(-rate dt)."""
    left = math.exp(-min(effect.damping_rate * dt, MOST_EXPONENT))
    for i in range(3):
        v[i] *= left


@compiled
def push(effect, data, dt):
    """(exp(x) - 1) / x with x = rate dt; after the decay (1 - exp(-x)) / x of the push is left."""
    x = effect.damping_rate * dt
    return math.expm1(min(x, MOST_EXPONENT)) / x if x > 0.0 else 1.0


def left(named: Records, dt: float) -> float:
    """Part of a velocity that damping leaves after dt (s); named: records and data of effects, in turn."""
    rates = [
        records["damping_rate"][0] for records in named[::2] if records.dtype.names == DTYPE.names
    ]
    return math.exp(-min(sum(rates) * dt, MOST_EXPONENT))


register(DTYPE, node=node, push=push)
