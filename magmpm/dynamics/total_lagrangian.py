"""State of the total formulation: displacement and velocity of the nodes of a grid in the undeformed body."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.thread_count import Threads
from magmpm.dynamics.particle_groups import pack
from magmpm.dynamics.steps import Look, at_step
from magmpm.kernels import total_lagrangian_step as kernels
from magmpm.kernels.watch import BROKEN, WHY, new_slabs, unlimited
from magmpm.model import Model


class TotalMotion:
    """Displacement u and velocity v (3 nodes,) of a model's nodes, moved by `advance`; particles follow from them."""

    formulation = "total"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.packed = pack(model)
        nodes = len(self.packed.node_mass)
        self.u, self.v, self.force = np.zeros(3 * nodes), np.zeros(3 * nodes), np.zeros(3 * nodes)
        self.slabs = new_slabs(len(self.packed.cells.slab_first) - 1)
        self.stiffness = np.full(self.packed.particle.size, np.nan)
        self.watch = unlimited()
        self.threads = Threads(len(model.density))
        self.lag = 0.0  # s that velocities are behind the displacements: half a step of the last advance
        self._last: tuple[Any, ...] = ()  # effects at the time of the displacements

    def advance(self, steps: int, dt: float, effects: tuple[Any, ...]) -> tuple[int, bool]:
        """Take `steps` steps of dt (s). Returns steps taken, and whether it stopped because some det F is 0 or less, or no number."""
        taken, _ = self.threads.run(
            lambda: (self._advance(steps, dt, effects, self.u, self.v, self.force, self.stiffness, self.watch), False)
        )
        self._last = at_step(effects, taken)
        self.lag = dt / 2 if taken else self.lag
        return taken, bool(self.watch[WHY] == BROKEN)

    def _advance(
        self, steps: int, dt: float, effects: tuple[Any, ...], u: Array, v: Array, force: Array,
        stiffness: Array | None = None, watch: Array | None = None,
    ) -> int:  # fmt: skip
        p = self.packed
        stiffness = np.full_like(self.stiffness, np.nan) if stiffness is None else stiffness
        watch = unlimited() if watch is None else watch
        state = kernels.State(u, v, force, stiffness)
        return int(kernels.advance(steps, dt, p.cells, p.particles, p.nodes, state, effects, watch, self.slabs))

    def velocity(self) -> Array:
        """Of the nodes (3 nodes,) m/s, at the time of their displacements.

        Symplectic Euler's v is that of half a step before: with u it gives energies that swing by (omega dt / 2) of a motion's own.
        """
        return self._caught_up(None, None)

    def _caught_up(self, stiffness: Array | None, watch: Array | None) -> Array:
        v = self.v.copy()
        self._advance(1, self.lag, self._last, self.u.copy(), v, np.zeros_like(v), stiffness, watch)
        return v

    def look(self) -> Look:
        """The motion as it is now, which the watch looks at as well."""
        with self.threads.alone():
            return self._look(self._caught_up(self.stiffness, self.watch))

    def _look(self, v: Array) -> Look:
        p, n = self.packed, len(self.model.density)
        position, velocity, deformation = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3, 3))
        rest = self.model.particles.position
        kernels.at_particles(p.cells, p.particles, p.particle, self.u, v, rest, position, velocity, deformation)
        kinetic = 0.5 * float(np.repeat(p.node_mass, 3) @ v**2)
        return Look(position, velocity, deformation, kinetic)

    def kept(self) -> dict[str, Any]:
        """What `rewind` needs, in the same process: cheaper than `state`."""
        return {name: np.copy(getattr(self, name)) for name in ("u", "v", "stiffness")} | {"lag": self.lag, "_last": self._last}

    def rewind(self, kept: dict[str, Any]) -> None:
        """Go back to what was kept."""
        for name, value in kept.items():
            setattr(self, name, np.copy(value) if isinstance(value, np.ndarray) else value)

    def set_off(self, dt: float, effects: tuple[Any, ...]) -> None:
        """Take the velocities to half a step of dt (s) before the displacements, where steps of dt expect them.

        Without it loads that act from the first step on, or from where steps change, would be felt for too long: an error in
        proportion to dt, not dt^2.
        """
        back = dt / 2 - self.lag
        if abs(back) <= 1e-9 * dt:
            return
        kick = np.zeros_like(self.v)
        self._advance(1, abs(back), effects, self.u.copy(), kick, np.zeros_like(self.v))
        self.v -= np.sign(back) * kick
        self.lag, self._last = dt / 2, at_step(effects, 0)

    def acceleration(self, u: Array) -> Array:
        """Of the nodes (3 nodes,) m/s^2 at displacements u (3 nodes,) m, by the body's own stress alone."""
        v = np.zeros_like(u)
        self._advance(1, 1.0, (), u.copy(), v, np.zeros_like(u))  # a step of one second from rest: v is the acceleration
        return v

    def particles(self) -> tuple[Array, Array, Array]:
        """x, v (n, 3) and F (n, 3, 3), in the model's order."""
        now = self._look(self.velocity())
        return now.x, now.v, now.F

    def kinetic_energy(self) -> float:
        """Of the nodes' velocities, J."""
        return self._look(self.velocity()).kinetic

    @property
    def unknowns(self) -> int:
        """Components of nodes that can move."""
        return int(np.count_nonzero(self.packed.nodes.inverse_mass))

    def state(self) -> dict[str, Array]:
        """What `restore` needs."""
        return {"u": self.u.copy(), "v": self.v.copy(), "lag": np.array(self.lag)}

    def restore(self, state: dict[str, Array]) -> None:
        """Go back to a state."""
        self.u[:], self.v[:] = state["u"], state["v"]
        self.force[:], self.stiffness[:] = 0.0, np.nan
        self.lag, self._last = float(state.get("lag", 0.0)), ()

    def sort(self) -> None:
        """Nothing to sort: the particles stay in their cells."""
