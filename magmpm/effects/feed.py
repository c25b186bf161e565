"""feed: the base is pushed along +x at a speed through a straight guide; what has left the guide is free.

Every node inside the guide moves with this speed along +x. The guide is the cylinder around the x axis up to its exit, with a radius of
one diameter of the body. A tip that bends back next to the guide stays free. The catheter is then not clamped: the guide holds it. The push
starts at full speed; far below the speed of waves (m/s) this is no shock.

Nodes are held or free, so the guide effectively ends at the last node that it holds. Nodes up to half a cell beyond the exit are held: the
effective exit differs from the exit by up to half a cell, to either side.
"""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.base import Effect, Place, Records, SceneLike, one_record
from magmpm.effects.hooks import register
from magmpm.inputs.settings import Quantity

DTYPE = np.dtype(
    [("feed_speed", np.float64), ("feed_exit", np.float64), ("feed_radius", np.float64)]
)


class Feed(Effect):
    """The base is pushed along +x through a straight guide around the x axis; what has left the guide is free.

    Parameters
    ----------
    speed : float or str, m/s
        Speed along +x; negative pulls back.
    exit : float or str, m
        Where on the x axis the guide ends.

    Examples
    --------
    >>> from magmpm import Feed
    >>> Feed(speed="20 mm/s", exit="10 mm").speed  # m/s
    0.02
    """

    PHASE = "constraint"
    ONLY_IN_MOTION = True
    ALONG_TIME = True
    speed: Annotated[float, Quantity("speed", at_least="-10 m/s", at_most="10 m/s")] = Field(
        description="Speed along +x; negative pulls back.", examples=["20 mm/s"]
    )
    exit: Place = Field(description="Where on the x axis the guide ends.", examples=["10 mm"])

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Parameters for the kernels."""
        half = 0.5 * scene.cell
        corner = math.sqrt(2.0) * (
            0.5 * scene.thickness + half
        )  # of a straight body's nodes: with two cells across, beyond its diameter
        radius = max(
            scene.thickness, 1.01 * corner
        )  # m, of the guide; nodes before the exit are held
        return one_record(
            DTYPE, feed_speed=self.speed, feed_exit=self.exit + half, feed_radius=radius
        )


@compiled
def node(effect, data, X, u, v, free, dt):
    """v = (speed, 0, 0) inside the guide."""
    y = X[1] + u[1]
    z = X[2] + u[2]
    if X[0] + u[0] < effect.feed_exit and y * y + z * z < effect.feed_radius**2:
        v[0], v[1], v[2] = effect.feed_speed, 0.0, 0.0


register(DTYPE, node=node)
