"""State of the total formulation: displacement and velocity of the nodes of a grid in the undeformed body."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.basis import Array
from magmpm.dynamics.packing import pack
from magmpm.dynamics.threads import Threads
from magmpm.model import Model
from magmpm.transfer import total as kernels


class TotalMotion:
    """Displacement u and velocity v (3 nodes,) of a model's nodes, moved by `advance`; particles follow from them."""

    formulation = "total"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.packed = pack(model)
        nodes = len(self.packed.node_mass)
        self.u, self.v, self.force = np.zeros(3 * nodes), np.zeros(3 * nodes), np.zeros(3 * nodes)
        self.low_det = np.ones(len(self.packed.slab_first) - 1)
        self.threads = Threads(len(model.density))
        self._last: tuple[float, tuple[Any, ...]] = (0.0, ())  # step and effects of the last advance

    def advance(self, steps: int, dt: float, effects: tuple[Any, ...]) -> tuple[int, bool]:
        """Take `steps` steps of dt (s). Returns steps taken, and whether it stopped because some det F is 0 or less, or no number."""
        taken, _ = self.threads.run(lambda: (self._advance(steps, dt, effects, self.u, self.v, self.force), False))
        now = (a[min(taken, len(a) - 1) :][:1] if k % 2 == 0 else a for k, a in enumerate(effects))
        self._last = (dt, tuple(now))
        return taken, taken < steps

    def _advance(
        self, steps: int, dt: float, effects: tuple[Any, ...], u: Array, v: Array, force: Array
    ) -> int:
        p = self.packed
        return int(
            kernels.advance(
                steps, dt, p.slab_first, p.cell_group, p.cell_node, p.cell_shear, p.cell_bulk, *p.along, p.splines, p.volume, p.modes,
                p.mode_count, p.magnet, p.density, p.reference, effects, p.active, p.inverse_mass, p.node_place, u, v, force,
                self.low_det,
            )
        )  # fmt: skip

    def velocity(self) -> Array:
        """Of the nodes (3 nodes,) m/s, at the time of their displacements.

        Symplectic Euler's v is that of half a step before: with u it gives energies that swing by (omega dt / 2) of a motion's own.
        """
        dt, effects = self._last
        v = self.v.copy()
        if dt > 0.0:
            self._advance(1, dt / 2, effects, self.u.copy(), v, np.zeros_like(v))
        return v

    def set_off(self, dt: float, effects: tuple[Any, ...]) -> None:
        """Take the velocities that a motion has now back by half a step of dt (s), where its steps expect them.

        Without it loads that act from the first step on would be felt for half a step too long: an error in proportion to dt, not dt^2.
        """
        kick = np.zeros_like(self.v)
        self._advance(1, dt / 2, effects, self.u.copy(), kick, np.zeros_like(self.v))
        self.v -= kick
        self._last = (dt, tuple(a[:1] if k % 2 == 0 else a for k, a in enumerate(effects)))

    def acceleration(self, u: Array) -> Array:
        """Of the nodes (3 nodes,) m/s^2 at displacements u (3 nodes,) m, by the body's own stress alone."""
        v = np.zeros_like(u)
        self._advance(1, 1.0, (), u.copy(), v, np.zeros_like(u))  # a step of one second from rest: v is the acceleration
        return v

    def nodal(self, field: Array) -> tuple[Array, Array]:
        """Value (n, 3) and gradient (n, 3, 3) 1/m of a nodal field (3 nodes,) at the particles, in the model's order."""
        p, n = self.packed, len(self.model.density)
        values, gradients = np.zeros((n, 3)), np.zeros((n, 3, 3))
        kernels.at_particles(field, p.cell_group, p.cell_node, *p.along, p.splines, p.particle, values, gradients)
        return values, gradients

    def particles(self) -> tuple[Array, Array, Array]:
        """x, v (n, 3) and F (n, 3, 3), in the model's order."""
        u, gradient = self.nodal(self.u)
        return self.model.particles.position + u, self.nodal(self.velocity())[0], np.eye(3) + gradient

    def kinetic_energy(self) -> float:
        """Of the nodes' velocities, J."""
        return 0.5 * float(np.sum(self.packed.node_mass[:, None] * self.velocity().reshape(-1, 3) ** 2))

    @property
    def unknowns(self) -> int:
        """Components of nodes that can move."""
        return int(np.count_nonzero(self.packed.inverse_mass))

    def state(self) -> dict[str, Array]:
        """What `restore` needs."""
        return {"u": self.u.copy(), "v": self.v.copy()}

    def restore(self, state: dict[str, Array]) -> None:
        """Go back to a state."""
        self.u[:], self.v[:] = state["u"], state["v"]
        self.force[:] = 0.0
        self._last = (0.0, ())

    def sort(self) -> None:
        """Nothing to sort: the particles stay in their cells."""
