"""feed: the base is pushed along +x at a speed through a straight guide; what has left the guide is free.

Every node whose place is inside the guide moves with the speed along +x and does not turn; the guide is the cylinder around the x axis,
one diameter of the body wide to each side, up to its exit. A tip that bends back beside the guide stays free. The catheter is not
clamped then: the guide holds it. The push begins at once: at speeds far below a wave's (m/s) that is no shock to speak of.

Nodes are held or free, so the guide acts as one that ends at the last node it holds. Held is what is less than half a cell beyond the
exit: the body is held straight to within half a cell of it, too far as often as not far enough.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.jit import compiled
from magmpm.effects.estimates import Advice, Body
from magmpm.effects.hooks import NO_DATA, register
from magmpm.scene import Scene

PHASE = "constraint"
DTYPE = np.dtype([("feed_speed", np.float64), ("feed_exit", np.float64), ("feed_radius", np.float64)])


def parameters(*, speed: float, exit: float, radius: float) -> tuple[NDArray[Any], ...]:
    """What kernels take. speed m/s along +x; exit: nodes before it on the x axis are held, m; radius of the guide, m."""
    record = np.zeros(1, DTYPE)
    record["feed_speed"], record["feed_exit"], record["feed_radius"] = speed, exit, radius
    return record, NO_DATA


def of_scene(scene: Scene, strength: float, times: NDArray[np.float64] | None) -> tuple[NDArray[Any], ...]:
    """What kernels take."""
    settings = scene.effects.feed
    if settings is None:
        return ()
    half = 0.5 * scene.cell
    corner = math.sqrt(2.0) * (0.5 * scene.thickness + half)  # of the nodes of a straight body: at two cells farther off than its diameter
    return parameters(speed=settings.speed, exit=settings.exit + half, radius=max(scene.thickness, 1.01 * corner))


def advice(scene: Scene, body: Body) -> Advice:
    """How far it pushes."""
    named = scene.effects.feed
    if named is None or scene.solver.dynamic is None:
        return Advice(None, "pushes the base through a guide at the speed it is given")
    way = named.speed * scene.solver.dynamic.duration
    return Advice(abs(way), f"pushes the base on by {1e3 * way:.3g} mm")


@compiled
def node(effect, data, X, u, v, dt):  # type: ignore[no-untyped-def]
    """v = (speed, 0, 0) inside the guide."""
    y, z = X[1] + u[1], X[2] + u[2]
    if X[0] + u[0] < effect.feed_exit and y * y + z * z < effect.feed_radius**2:
        v[0], v[1], v[2] = effect.feed_speed, 0.0, 0.0


register(DTYPE, node=node)
