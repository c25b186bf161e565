"""Motion of what holds a body: the nodes that follow it have its velocity in each step, whatever the forces on them.

Velocities are those that bring the nodes to where they are due at the end of a step, so that they never drift. The forces that hold them do
work on the body, which nothing counts: the energy balance is not checked while they move.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.dynamics.steps import Records
from magmpm.effects.hooks import NO_DATA, register
from magmpm.errors import SceneError
from magmpm.model import Model

DTYPE = np.dtype([("rate", np.float64, 3), ("low", np.float64, 3), ("high", np.float64, 3)])


class MovedEnds:
    """Records for kernels of what holds a model's body and moves; place (nodes, 3) m and mass (nodes,) kg of all nodes.

    Raises SceneError where other nodes stand among those that follow.
    """

    def __init__(self, model: Model, place: Array, mass: Array) -> None:
        self._moves, self._boxes, half = model.scene.move or {}, {}, 0.25 * model.grid.spacing
        for name, nodes in model.driven_in_motion:
            follows = nodes & (mass > 0)
            low, high = place[follows].min(axis=0) - half, place[follows].max(axis=0) + half
            if ((mass > 0) & ((place > low) & (place < high)).all(axis=1) & ~follows).any():
                raise SceneError(
                    f"move.{name}",
                    found="other parts stand within the box around what is moved",
                    rule="in motion that box must be free of them",
                    remedy="divide the part into several, or move it in statics or along equilibria (solver.quasi_static)",
                )
            self._boxes[name] = low, high

    def records(self, times: Array, dt: float) -> Records:
        """Records and data, in turn, for steps of dt (s) that begin at times (k,) s; none where nothing moves."""
        out: list[Any] = []
        for name, (low, high) in self._boxes.items():
            record, move = np.zeros(len(times), DTYPE), self._moves[name]
            record["rate"] = (move.displacement(times + dt) - move.displacement(times)) / dt
            record["low"], record["high"] = low, high
            out += [record, NO_DATA]
        return tuple(out)


@compiled
def node(effect, data, X, u, v, dt):  # type: ignore[no-untyped-def]
    """v = rate of the nodes in the box."""
    inside = True
    for i in range(3):
        inside = inside and effect.low[i] < X[i] and X[i] < effect.high[i]
    if inside:
        for i in range(3):
            v[i] = effect.rate[i]


register(DTYPE, node=node)
