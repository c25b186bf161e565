"""State of a motion, total Lagrangian: displacement and velocity of the nodes of a grid in the undeformed body.

Nodes that follow what holds the body and moves have its velocity in each step, whatever the forces on them: the one that brings them to
where they are due at the end of the step, and never drift. What holds them does work that nothing counts: the balance is not checked.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from magmpm.bodies.grid import each_node
from magmpm.compiled.arrays import Array, Mask, Plain
from magmpm.compiled.jit import compiled
from magmpm.compiled.simd import WIDTH
from magmpm.compiled.thread_count import Threads
from magmpm.dynamics.body_contact import body_contact
from magmpm.dynamics.own_loads import OwnLoads
from magmpm.dynamics.particle_groups import pack
from magmpm.effects import acting
from magmpm.effects.base import Contact, Records, Touching
from magmpm.effects.calls import Function, in_motion
from magmpm.effects.contact_force import MOST_PUSH
from magmpm.effects.contact_law import at_rest
from magmpm.effects.hooks import NO_DATA, each_record, register
from magmpm.errors import SceneError
from magmpm.kernels import total_lagrangian_step
from magmpm.kernels.body_contact import Meeting
from magmpm.kernels.flutter import flutter_warnings
from magmpm.kernels.surface_contact import PATCH
from magmpm.kernels.total_lagrangian_step import ParticleMotion, State
from magmpm.kernels.watch import BROKEN, GOING, WHY, Slabs, new_slabs, unlimited
from magmpm.model import Model

DTYPE = np.dtype([("rate", np.float64, 3), ("low", np.float64, 3), ("high", np.float64, 3)])


class MovedEnds:
    """Records of what holds a body and moves; place (nodes, 3) m and mass (nodes,) kg of all nodes; free (nodes,): those that forces move.

    Raises SceneError where nodes that something else holds stand among those that follow.
    """

    def __init__(self, model: Model, place: Array, mass: Array, free: Mask) -> None:
        self._moves = model.scene.move or {}
        self._boxes = {}
        half = 0.25 * model.grid.spacing
        for name, nodes in model.driven_in_motion:
            follows = nodes & (mass > 0)
            low = place[follows].min(axis=0) - half
            high = place[follows].max(axis=0) + half
            if ((mass > 0) & ~free & ((place > low) & (place < high)).all(axis=1) & ~follows).any():
                raise SceneError(
                    f"move.{name}",
                    found="other held parts lie inside the box around the moved part",
                    rule="in a motion that box must contain no other held part",
                    remedy=(
                        "split the part into several, or move it in statics or along equilibria "
                        "(solver.quasi_static)"
                    ),
                )
            self._boxes[name] = low, high

    def records(self, times: Array, dt: float) -> Records:
        """Records and data, in turn, for steps of dt (s) that begin at times (k,) s; none where nothing moves."""
        out: list[Any] = []
        for name, (low, high) in self._boxes.items():
            record = np.zeros(len(times), DTYPE)
            move = self._moves[name]
            record["rate"] = (move.displacement(times + dt) - move.displacement(times)) / dt
            record["low"], record["high"] = low, high
            out += [record, NO_DATA]
        return tuple(out)


@compiled
def node(effect, data, X, u, v, free, dt):  # type: ignore[no-untyped-def]
    """v = rate of the nodes in the box that are not free."""
    inside = not free
    for i in range(3):
        inside = inside and effect.low[i] < X[i] and X[i] < effect.high[i]
    if inside:
        for i in range(3):
            v[i] = effect.rate[i]


register(DTYPE, node=node)
MOVED = Function("node", __name__, tuple(DTYPE.names or ()))  # for magmpm.solving.precompile


class Kinematics(NamedTuple):
    """Kinematics of a motion at one time: x m, v m/s (n, 3) and F (n, 3, 3) of its particles, in the model's order; kinetic energy, J."""

    x: Array
    v: Array
    F: Array
    kinetic: float


def from_step(named: Records, step: int) -> Records:
    """The records from a given step on. An effect that is constant in time has one record for all steps."""
    return each_record(lambda records: records[step:] if len(records) > 1 else records, named)


def at_step(named: Records, step: int) -> Records:
    """The records of one step, or the last ones if there are fewer."""
    return each_record(lambda records: records[min(step, len(records) - 1) :][:1], named)


def take(motion: TotalMotion, named: Records, steps: int, dt: float) -> tuple[int, bool]:
    """Take up to `steps` steps of dt (s). Returns the number taken, fewer if the motion's watch ended them, and whether it broke.

    Loads of the body on itself, in the tables of `named`, are those of its present shape at the end.
    """
    taken = 0
    broken = False
    own = motion.own
    while taken < steps:
        now = from_step(named, taken)
        together = steps - taken if own is None else min(own.renew(now, motion), steps - taken)
        gone, broken = motion.advance(together, dt, now)
        taken += gone
        if own is not None:
            own.passed(gone)
        if (
            motion.watch[WHY] != GOING
        ):  # otherwise pairs of a body that touches itself were listed again
            break
    if own is not None and not broken:
        own.compute(named, motion)
    return taken, broken


class TotalMotion:
    """Displacement u m and velocity v m/s (3 nodes,) of a model's nodes, moved by `advance`. Particles follow the nodes."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.packed = pack(model)
        self.ends = MovedEnds(
            model,
            self.packed.node_place,
            self.packed.mass.lumped,
            self.packed.nodes.inverse_mass[::3] > 0,
        )
        nodes = len(self.packed.mass.lumped)
        self.u = np.zeros(3 * nodes)
        self.v = np.zeros(3 * nodes)
        self.force = np.zeros(3 * nodes)
        self.slabs = new_slabs(len(self.packed.cells.slab_first) - 1)
        self.stiffness = np.full(self.packed.particle.size, np.nan)
        on = self.packed.surface
        self.touching = np.zeros(PATCH * len(on.first_node) + 1)
        self.memory = np.repeat(
            np.tile(acting.remembered(model.scene), len(self.packed.particle)), WIDTH
        )
        self.own = OwnLoads(model) if acting.feels_itself(model.scene) else None
        self.contact = body_contact(model, self.packed)
        if self.contact is not None:
            self.contact.list(self.u)
        self.watch = unlimited()
        self.flutter = self.slabs.flutter
        self.threads = Threads(len(model.density))
        self.lag = (
            0.0  # s by which velocities lag behind displacements: half a step of the last advance
        )
        self._last: tuple[Any, ...] = ()  # effects at the time of the displacements

    def advance(self, steps: int, dt: float, effects: tuple[Any, ...]) -> tuple[int, bool]:
        """Take up to `steps` steps of dt (s). Returns the steps taken, and whether it stopped because some det F is 0, negative or NaN."""
        body, state = self._now()
        taken, _ = self.threads.run(
            lambda: (self._advance(steps, dt, effects, body, state, self.watch, self.slabs), False)
        )
        if self.contact is not None and self.contact.outdated:
            self.contact.list(self.u)
        self._last = at_step(effects, taken)
        self.lag = dt / 2 if taken else self.lag
        return taken, bool(self.watch[WHY] == BROKEN)

    def tasks(self, effects: tuple[Any, ...]) -> dict[str, list[tuple[Any, Any]]]:
        """Functions that `advance` calls in parallel, with arguments, in parts to be compiled beside each other."""
        body, state = self._now()
        return total_lagrangian_step.tasks(body, state, in_motion(effects), self.slabs)

    def _now(self) -> tuple[tuple[Any, ...], State]:
        """The body in motion and its state, as the compiled step takes them."""
        meeting = () if self.contact is None else self.contact.meeting
        state = State(self.u, self.v, self.force, self.stiffness, self.touching, self.memory)
        return self._body(meeting), state

    def _advance(
        self,
        steps: int,
        dt: float,
        effects: tuple[Any, ...],
        body: tuple[Any, ...],
        state: State,
        watch: Array,
        slabs: Slabs,
    ) -> int:
        """Take up to `steps` steps, and return their number."""
        calls = in_motion(effects)
        return int(total_lagrangian_step.advance(steps, dt, *body, state, calls, watch, slabs))

    def _body(self, meeting: Meeting | tuple[()], instant: float = 0.0) -> tuple[Any, ...]:
        """The body in motion, as the compiled step takes it; instant: Pa more shear modulus."""
        p = self.packed
        cells = p.cells._replace(shear=p.cells.shear + instant) if instant else p.cells
        return cells, p.particles, p.nodes, p.mass.correction, p.surface, meeting

    def _tried(
        self,
        dt: float,
        effects: tuple[Any, ...],
        u: Array,
        v: Array,
        *,
        body: tuple[Any, ...] | None = None,
        kept: tuple[Array, Array] | None = None,
    ) -> Array:
        """Velocity (3 nodes,) m/s after a step of dt (s) from u m and v, which changes nothing of the motion but `kept`: stiffness and
        watch."""
        if body is None:
            body = self._body(() if self.contact is None else self.contact.copy())
        stiffness, watch = kept or (np.full_like(self.stiffness, np.nan), unlimited())
        touching = self.touching.copy()
        force = np.zeros_like(u)
        state = State(u.copy(), v.copy(), force, stiffness, touching, self.memory.copy())
        slabs = self.slabs._replace(flutter=self.flutter.copy())
        self._advance(1, dt, effects, body, state, watch, slabs)
        return state.v

    def warnings(self) -> list[str]:
        """Tell what the user must know of the motion so far."""
        return flutter_warnings(self.flutter)

    def velocity(self) -> Array:
        """Velocity of the nodes (3 nodes,) m/s, at the time of their displacements.

        The v of symplectic Euler is half a step earlier. With u, energies would oscillate by omega dt / 2 of that of the motion.
        """
        return self._tried(self.lag, self._last, self.u, self.v)

    def kinematics(self) -> Kinematics:
        """The present kinematics. The watch checks the present state as well."""
        with self.threads.alone():
            kept = (self.stiffness, self.watch)
            return self._kinematics(self._tried(self.lag, self._last, self.u, self.v, kept=kept))

    def _kinematics(self, v: Array) -> Kinematics:
        kinetic = 0.5 * float(v @ self.packed.mass.momentum(v.reshape(-1, 3)).ravel())
        return Kinematics(*self._at_particles(self.u, v), kinetic)

    def shape(self, u: Array) -> tuple[Array, Array]:
        """Position (n, 3) m and F (n, 3, 3) of the particles, in the model's order, at displacements u (3 nodes,) m of the nodes."""
        now = self._at_particles(u, u)
        return now.x, now.F

    def _at_particles(self, u: Array, v: Array) -> ParticleMotion:
        p = self.packed
        rest = self.model.particles.position
        out = ParticleMotion(np.empty_like(rest), np.empty_like(rest), np.empty((len(rest), 3, 3)))
        total_lagrangian_step.at_particles(p.cells, p.particles, p.particle, u, v, rest, out)
        return out

    def kept(self) -> Plain:
        """State that `rewind` needs within the same process."""
        own = None if self.own is None else self.own.kept()
        return {**self.state(), "stiffness": self.stiffness.copy(), "last": self._last, "own": own}

    def rewind(self, kept: Plain) -> None:
        """Go back to the state that `kept` returned."""
        self.restore(kept)
        self.stiffness[:], self._last = kept["stiffness"], kept["last"]
        if self.own is not None:
            self.own.rewind(kept["own"])

    def set_off(self, dt: float, effects: tuple[Any, ...]) -> None:
        """Shift the velocities to half a step of dt (s) before the displacements, as steps of dt expect them.

        Without this shift, loads that act from the start, or from a change of step, act too long: an error proportional to dt, not dt^2.
        """
        back = dt / 2 - self.lag
        if abs(back) <= 1e-9 * dt:
            return
        if self.own is not None:
            self.own.compute(effects, self)
        later = self._tried(abs(back), effects, self.u, self.v)
        self.v -= np.sign(back) * (later - self.v)
        self.lag = dt / 2
        self._last = at_step(effects, 0)

    def acceleration(self, u: Array) -> Array:
        """Acceleration of the nodes (3 nodes,) m/s^2 at displacements u (3 nodes,) m, from the elastic stress alone.

        Branches that relax count as if they did not: as shear modulus.
        """
        apart = () if self.contact is None else self.contact.apart()
        body = self._body(apart, acting.instant_modulus(self.model.scene))
        return self._tried(1.0, (), u, np.zeros_like(u), body=body)  # a second from rest: v is that

    def slowed(self, v: Array, effects: Records) -> Array:
        """Acceleration of the nodes (3 nodes,) m/s^2 at the present displacements and velocities v (3 nodes,) m/s, with effects."""
        apart = () if self.contact is None else self.contact.apart()
        return self._tried(1.0, effects, self.u, v, body=self._body(apart)) - v

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
        if len(self.packed.surface.first_node):
            kept |= {"touching": self.touching.copy(), "flutter": self.flutter.copy()}
        return kept if self.contact is None else kept | self.contact.state()

    def remembered(self) -> Array:
        """Memory (n, k) of the particles in the model's order (effects.viscosity); k is 0 where there is none."""
        real = self.packed.particle >= 0
        columns = self.memory.size // self.packed.particle.size
        out = np.empty((len(self.model.density), columns))
        out[self.packed.particle[real]] = self.memory.reshape(-1, columns, WIDTH).transpose(
            0, 2, 1
        )[real]
        return out

    def restore(self, state: dict[str, Array]) -> None:
        """Go back to a `state`."""
        self.u[:], self.v[:], self.memory[:] = (
            state["u"],
            state["v"],
            state.get("memory", self.memory),
        )
        self.force[:], self.stiffness[:] = 0.0, np.nan
        self.lag = float(state.get("lag", 0.0))
        self._last = ()
        if self.contact is not None:
            self.contact.restore(state)
        if len(self.packed.surface.first_node):
            self.touching[:] = state.get("touching", 0.0)
            self.flutter[:] = state.get("flutter", 0.0)

    def touching_points(self) -> Touching:
        """The points of the surface, in the order of `packed`, at the time of their displacements."""
        found = self.model.surface
        if found is None:
            return at_rest(np.zeros((0, 3)))
        on = self.packed.surface
        order = self.packed.point
        x = found.place[order]
        moved = self.u.reshape(-1, 3)
        places = found.first[order], self.model.nodes_in_motion, found.weights[order]
        for node, share in each_node(*places):
            x = x + share[:, None] * moved[node]
        kept = np.repeat(self.touching[:-1].reshape(-1, PATCH), np.diff(on.first_point), axis=0)
        return Touching(x, on.mass, on.friction, kept[:, :3].copy(), kept[:, MOST_PUSH].copy())

    def body_contacts(self) -> dict[str, Contact]:
        """Contact of the body with itself, by pairs of components; empty where the scene does not name it."""
        if self.contact is None:
            return {}
        meeting = self.contact.copy()
        v = self._tried(self.lag, self._last, self.u, self.v, body=self._body(meeting))
        return self.contact.report(meeting.memory, self.u, v)
