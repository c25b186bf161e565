"""State of a motion, total Lagrangian: displacement and velocity of the nodes of a grid in the undeformed body."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.simd import WIDTH
from magmpm.compiled.thread_count import Threads
from magmpm.dynamics.body_contact import body_contact
from magmpm.dynamics.moved_ends import MovedEnds
from magmpm.dynamics.particle_groups import pack
from magmpm.dynamics.steps import Kinematics, at_step
from magmpm.effects import acting
from magmpm.effects.base import Contact, Touching
from magmpm.effects.contact_law import at_rest
from magmpm.effects.hooks import those_with
from magmpm.kernels import total_lagrangian_step
from magmpm.kernels.body_contact import Meeting
from magmpm.kernels.surface_contact import ANCHOR
from magmpm.kernels.watch import BROKEN, WHY, new_slabs, unlimited
from magmpm.model import Model


class TotalMotion:
    """Displacement u m and velocity v m/s (3 nodes,) of a model's nodes, moved by `advance`. Particles follow the nodes."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.packed = pack(model)
        self.ends = MovedEnds(model, self.packed.node_place, self.packed.mass.lumped)
        nodes = len(self.packed.mass.lumped)
        self.u, self.v, self.force = np.zeros(3 * nodes), np.zeros(3 * nodes), np.zeros(3 * nodes)
        self.slabs = new_slabs(len(self.packed.cells.slab_first) - 1)
        self.stiffness = np.full(self.packed.particle.size, np.nan)
        on = self.packed.surface
        self.anchor = np.zeros(ANCHOR * len(on.mass) + len(on.first_node))
        self.memory = np.repeat(np.tile(acting.remembered(model.scene), len(self.packed.particle)), WIDTH)
        self.contact = body_contact(model, self.packed)
        if self.contact is not None:
            self.contact.list(self.u)
        self.watch = unlimited()
        self.threads = Threads(len(model.density))
        self.lag = 0.0  # s by which velocities lag behind displacements: half a step of the last advance
        self._last: tuple[Any, ...] = ()  # effects at the time of the displacements

    def advance(self, steps: int, dt: float, effects: tuple[Any, ...]) -> tuple[int, bool]:
        """Take up to `steps` steps of dt (s). Returns the steps taken, and whether it stopped because some det F is 0, negative or NaN."""
        meeting = () if self.contact is None else self.contact.meeting
        arrays = self.u, self.v, self.force, self.anchor, self.stiffness, self.watch, self.memory, meeting
        taken, _ = self.threads.run(lambda: (self._advance(steps, dt, effects, *arrays), False))
        if self.contact is not None and self.contact.outdated:
            self.contact.list(self.u)
        self._last = at_step(effects, taken)
        self.lag = dt / 2 if taken else self.lag
        return taken, bool(self.watch[WHY] == BROKEN)

    def _advance(
        self, steps: int, dt: float, effects: tuple[Any, ...], u: Array, v: Array, force: Array, anchor: Array,
        stiffness: Array | None = None, watch: Array | None = None, memory: Array | None = None,
        meeting: Meeting | tuple[()] | None = None, instant: float = 0.0,
    ) -> int:  # fmt: skip
        """Take steps with these arrays. memory, meeting: unless given, copies of the motion's; instant: Pa, added to the shear modulus."""
        p, memory = self.packed, self.memory.copy() if memory is None else memory
        if meeting is None:
            meeting = () if self.contact is None else self.contact.copy()
        stiffness = np.full_like(self.stiffness, np.nan) if stiffness is None else stiffness
        watch = unlimited() if watch is None else watch
        state = total_lagrangian_step.State(u, v, force, stiffness, anchor, memory)
        cells = p.cells._replace(shear=p.cells.shear + instant) if instant else p.cells
        body = cells, p.particles, p.nodes, p.mass.correction, p.surface, meeting
        return int(total_lagrangian_step.advance(steps, dt, *body, state, (effects, those_with("node", effects)), watch, self.slabs))

    def velocity(self) -> Array:
        """Velocity of the nodes (3 nodes,) m/s, at the time of their displacements.

        The v of symplectic Euler belongs to half a step earlier. Together with u it would give energies that oscillate, by a share
        omega dt / 2 of the energy of the motion.
        """
        return self._caught_up(None, None)

    def _caught_up(self, stiffness: Array | None, watch: Array | None) -> Array:
        v = self.v.copy()
        self._advance(1, self.lag, self._last, self.u.copy(), v, np.zeros_like(v), self.anchor.copy(), stiffness, watch)
        return v

    def kinematics(self) -> Kinematics:
        """The present kinematics. The watch checks the present state as well."""
        with self.threads.alone():
            return self._kinematics(self._caught_up(self.stiffness, self.watch))

    def _kinematics(self, v: Array) -> Kinematics:
        p, n = self.packed, len(self.model.density)
        position, velocity, deformation = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3, 3))
        rest = self.model.particles.position
        total_lagrangian_step.at_particles(p.cells, p.particles, p.particle, self.u, v, rest, position, velocity, deformation)
        kinetic = 0.5 * float(v @ p.mass.momentum(v.reshape(-1, 3)).ravel())
        return Kinematics(position, velocity, deformation, kinetic)

    def kept(self) -> dict[str, Any]:
        """State that `rewind` needs within the same process. Cheaper than `state`."""
        kept = {name: np.copy(getattr(self, name)) for name in ("u", "v", "stiffness", "anchor", "memory")}
        return kept | {"lag": self.lag, "_last": self._last} | ({} if self.contact is None else {"contact": self.contact.state()})

    def rewind(self, kept: dict[str, Any]) -> None:
        """Go back to the state that `kept` returned."""
        for name, value in kept.items():
            if name == "contact" and self.contact is not None:
                self.contact.restore(value)
                continue
            setattr(self, name, np.copy(value) if isinstance(value, np.ndarray) else value)

    def set_off(self, dt: float, effects: tuple[Any, ...]) -> None:
        """Shift the velocities to half a step of dt (s) before the displacements, as steps of dt expect them.

        Without this shift, loads that act from the first step on, or from a change of step on, would act for too long, and what resists
        velocities as well: an error proportional to dt, not dt^2.
        """
        back = dt / 2 - self.lag
        if abs(back) <= 1e-9 * dt:
            return
        later = self.v.copy()
        self._advance(1, abs(back), effects, self.u.copy(), later, np.zeros_like(self.v), self.anchor.copy())
        self.v -= np.sign(back) * (later - self.v)
        self.lag, self._last = dt / 2, at_step(effects, 0)

    def acceleration(self, u: Array) -> Array:
        """Acceleration of the nodes (3 nodes,) m/s^2 at displacements u (3 nodes,) m, from the elastic stress alone.

        Branches that relax count as if they did not: as shear modulus.
        """
        v, instant = np.zeros_like(u), acting.instant_modulus(self.model.scene)
        self._advance(1, 1.0, (), u.copy(), v, np.zeros_like(u), self.anchor, meeting=(), instant=instant)  # a second from rest: v is that
        return v

    def particles(self) -> tuple[Array, Array, Array]:
        """x m, v m/s (n, 3) and F (n, 3, 3), in the model's order."""
        now = self._kinematics(self.velocity())
        return now.x, now.v, now.F

    def kinetic_energy(self) -> float:
        """Kinetic energy of the nodes, J."""
        return self._kinematics(self.velocity()).kinetic

    @property
    def unknowns(self) -> int:
        """Number of components of nodes that can move."""
        return int(np.count_nonzero(self.packed.nodes.inverse_mass))

    def state(self) -> dict[str, Array]:
        """State that `restore` needs."""
        kept = {"u": self.u.copy(), "v": self.v.copy(), "lag": np.array(self.lag)}
        kept |= {"memory": self.memory.copy()} if self.memory.size else {}
        kept |= {"anchor": self.anchor.copy()} if self.anchor.size else {}
        return kept if self.contact is None else kept | self.contact.state()

    def remembered(self) -> Array:
        """Memory (n, k) of the particles in the model's order (effects.viscosity); k is 0 where there is none."""
        real, columns = self.packed.particle >= 0, self.memory.size // self.packed.particle.size
        out = np.empty((len(self.model.density), columns))
        out[self.packed.particle[real]] = self.memory.reshape(-1, columns, WIDTH).transpose(0, 2, 1)[real]
        return out

    def restore(self, state: dict[str, Array]) -> None:
        """Go back to a `state`."""
        self.u[:], self.v[:], self.memory[:] = state["u"], state["v"], state.get("memory", self.memory)
        self.force[:], self.stiffness[:] = 0.0, np.nan
        self.lag, self._last = float(state.get("lag", 0.0)), ()
        if self.contact is not None:
            self.contact.restore(state)
        if self.anchor.size:
            self.anchor[:] = state.get("anchor", 0.0)

    def touching_points(self) -> Touching:
        """The points of the surface, in the order of `packed`, at the time of their displacements."""
        on, cells = self.packed.surface, self.packed.cells
        if not len(on.mass):
            return at_rest(np.zeros((0, 3)))
        weights, node = on.weights.reshape(-1, 3, 3), np.repeat(on.first_node, np.diff(on.first_point))
        x, v = on.place.reshape(-1, 3).copy(), np.zeros((len(on.mass), 3))
        moved, speed = self.u.reshape(-1, 3), self.velocity().reshape(-1, 3)
        for a, b, c in product(range(3), repeat=3):
            at, share = node + a * cells.along_x + b * cells.along_y + c, weights[:, 0, a] * weights[:, 1, b] * weights[:, 2, c]
            x, v = x + share[:, None] * moved[at], v + share[:, None] * speed[at]
        anchor = self.anchor[: ANCHOR * len(x)].reshape(-1, ANCHOR)
        return Touching(x, v, on.mass, np.where(anchor[:, 3:] > 0, anchor[:, :3], x), on.friction)

    def body_contacts(self) -> dict[str, Contact]:
        """Contact of the body with itself, by pairs of components; empty where the scene does not name it."""
        if self.contact is None:
            return {}
        meeting, v = self.contact.copy(), self.v.copy()
        self._advance(1, self.lag, self._last, self.u.copy(), v, np.zeros_like(v), self.anchor.copy(), meeting=meeting)
        return self.contact.report(meeting.memory, self.u, v)
