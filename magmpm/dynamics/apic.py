"""State of the updated formulation: particles sorted by slabs of the moving box, in blocks of eight."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.simd import WIDTH
from magmpm.compiled.thread_count import Threads
from magmpm.dynamics.drift_correction import INTERVAL, DriftCorrection
from magmpm.dynamics.moving_grid import Box
from magmpm.dynamics.particle_groups import slab_edges
from magmpm.dynamics.steps import Kinematics, at_step
from magmpm.dynamics.tearing import Tearing
from magmpm.effects import damping
from magmpm.effects.base import Touching
from magmpm.effects.hooks import has_hook
from magmpm.errors import SolveError
from magmpm.kernels import apic_step, multi_grid_contact
from magmpm.kernels.watch import BROKEN, WHY, new_slabs, unlimited
from magmpm.model import Model

SLAB = 4  # cells: after a drift of up to one cell since the last sort, particles still touch no other slab of their color
MARGIN = 2  # cells around the body
NODES_MOST = 60_000_000  # 4 GB of grid
CHANGED = ("x", "v", "C", "L", "F", "stiffness", "anchor")  # by a step


class UpdatedMotion:
    """Positions, velocities, their affine parts and deformation gradients of a model's particles, moved by `advance`.

    Rows are sorted and padded. `particle` (n8,): index of the row's particle in the model, -1 for padding, which has no mass.
    """

    formulation = "updated"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.keeps_gradient = has_hook("rate_stress", model.effects)
        self.touches = has_hook("contact", model.effects)
        self.drift_correction: DriftCorrection | None = DriftCorrection(model)  # None: F is never corrected
        self.since = 0  # steps since F was last relaxed
        self.component = model.scene.body.shape.components(model.particles)  # one grid each
        self.neighbors = Tearing(model, self.component)
        self.curve = multi_grid_contact.distances()
        self.lag, self._last = 0.0, model.effects  # s by which velocities lag behind positions; effects at the time of the positions
        self.watch = unlimited()
        n = len(model.density)
        self.threads = Threads(n)
        self.place(model.particles.position, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3)))

    def place(self, x: Array, v: Array, F: Array, C: Array, L: Array | None = None, anchor: Array | None = None) -> None:
        """Set and sort the particles, given in the model's order: x m, v m/s (n, 3), F, APIC's C and L = dv/dx 1/s (n, 3, 3).

        L matters only where an effect's stress depends on it. The default is C, which equals L if the velocity is linear in space.
        anchor (n, 3) m: where friction holds the particles (effects.contact_force); the default is where they are.
        """
        model = self.model
        order, source = self._fit(x)
        self.x, self.v = _blocks(x, source), _blocks(v, source)
        self.C, self.F = _blocks(C.reshape(-1, 9), source), _blocks(F.reshape(-1, 9), source)
        self.L = _blocks((C if L is None else L).reshape(-1, 9), source) if self.keeps_gradient else np.zeros(0)
        self.anchor = _blocks(x if anchor is None else anchor, source) if self.touches else np.zeros(0)
        self.volume = np.where(order >= 0, model.particles.volume[source], 0.0)
        self.shear, self.bulk, self.density = model.shear[source], model.bulk[source], model.density[source]
        self.remanence = _blocks(model.remanence, source)
        self.stiffness = np.full(len(order), np.nan)
        self.particle = order

    def sort(self) -> None:
        """Sort the particles and fit the box to them. Gives the same bits as `place` with their present state."""
        row = self.rows()
        order, source = self._fit(self._places())
        rows = row[source]
        columns = {"x": 3, "v": 3, "C": 9, "F": 9, "remanence": self.model.remanence.shape[1]}
        columns |= dict.fromkeys(("shear", "bulk", "density", "stiffness"), 1)
        columns |= ({"L": 9} if self.keeps_gradient else {}) | ({"anchor": 3} if self.touches else {})
        for name, width in columns.items():
            moved = np.empty(width * len(rows))
            apic_step.rearrange(rows, width, getattr(self, name), moved)
            setattr(self, name, moved)
        self.volume = np.where(order >= 0, self.model.particles.volume[source], 0.0)
        self.particle = order

    def _fit(self, x: Array) -> tuple[Index, Index]:
        """Fit the grid's box and the slabs to positions (n, 3) m, and clear the grid.

        Returns the particles in sorted order (n8,), padded with -1, and the particle from which each row takes its values.
        Raises SolveError where a position is not finite, or the box would be too large.
        """
        model, h = self.model, self.model.grid.spacing
        cell = np.floor((x - model.grid.origin) / h)
        if not np.all(np.isfinite(x)) or np.abs(cell).max() > 1e7:
            raise SolveError("the position of a particle is not finite, or the particle has left every box")
        cell = cell.astype(np.int64)
        low, high = cell.min(axis=0) - MARGIN, cell.max(axis=0) + MARGIN + 1
        if model.clamped_face:
            low[0], high[0] = min(low[0], -MARGIN), max(high[0], MARGIN + 2)
        self.shape = (high - low + 2).astype(np.int64)
        grids = int(self.component.max()) + 1
        if np.prod(self.shape) * grids > NODES_MOST:
            raise SolveError(
                f"the box around the particles has {' x '.join(map(str, self.shape))} nodes for each of {grids} components; "
                "a particle has flown off, or there are too many components"
            )
        free = np.flatnonzero(~model.held)  # held particles have no rows: their nodes are at rest, so they neither move nor move others
        nodes = int(np.prod(self.shape))
        order, self.slab_first, component = self._sorted((cell - low)[free], self.component[free])
        self.lift = (nodes * component).astype(np.float64)
        order = np.where(order >= 0, free[order], -1)
        if self.drift_correction is not None:
            self.touching = self.drift_correction.touching(cell - low, self.shape)
        real = order >= 0
        source = np.where(real, order, order[np.maximum.accumulate(np.where(real, np.arange(len(order)), 0))])
        self.grid, self.weight, self.shared = Box(model, self.component, low, self.shape).grid(cell - low)
        self.slabs, self.moved = new_slabs(len(self.slab_first) - 1), np.zeros(len(self.slab_first) - 1)
        self.drift = 0.0
        return order, source

    def _sorted(self, cell: Index, component: Index) -> tuple[Index, Index, Index]:
        """Particles by slab, component and cell, in whole blocks (-1: padding); first block of each slab; component of each block."""
        axis = int(np.argmax(self.shape))
        along = cell[:, axis] - cell[:, axis].min()
        edges = slab_edges(int(along.max()) + 1, SLAB)
        slab = np.searchsorted(edges, along, side="right") - 1
        grids = int(self.component.max()) + 1
        group = slab * grids + component
        key = ((group * self.shape[0] + cell[:, 0]) * self.shape[1] + cell[:, 1]) * self.shape[2] + cell[:, 2]
        order = np.argsort(key, kind="stable")
        counts = np.bincount(group, minlength=grids * (len(edges) - 1))
        blocks = -(-counts // WIDTH)
        first = np.concatenate([[0], np.cumsum(blocks)])
        padded = np.full(first[-1] * WIDTH, -1, np.int64)
        row = np.arange(len(order)) - np.repeat(np.cumsum(counts) - counts, counts) + np.repeat(first[:-1] * WIDTH, counts)
        padded[row] = order
        return padded, first[::grids].astype(np.int64), np.repeat(np.arange(len(counts)) % grids, blocks)

    def advance(self, steps: int, dt: float, effects: tuple[Any, ...]) -> tuple[int, bool]:
        """Take up to `steps` steps of dt (s), fewer where a sort is due. Returns the steps taken, and whether the motion broke."""
        return self.threads.run(lambda: self._advance(steps, dt, effects))

    def _advance(self, steps: int, dt: float, effects: tuple[Any, ...]) -> tuple[int, bool]:
        if not self.keeps_gradient and has_hook("rate_stress", effects):
            raise ValueError("effects with a rate stress need a motion made for a model with such an effect")
        if self.drift > apic_step.DRIFT:
            self.sort()
        taken, self.drift = self._steps(steps, dt, effects, self.x, self.v, self.C, self.L, self.F, self.anchor)
        self.lag, self._last = dt / 2 if taken else self.lag, at_step(effects, taken)
        broken = bool(self.watch[WHY] == BROKEN)
        self.since += taken
        if not broken and self.since >= INTERVAL:
            self._relax()
        return taken, broken

    def _steps(self, steps: int, dt: float, effects: tuple[Any, ...], *changed: Array) -> tuple[int, float]:
        x, v, C, L, F, anchor = changed
        state = apic_step.State(x, v, C, L, F, self.stiffness, anchor)
        particles = apic_step.Particles(self.slab_first, self.lift, self.volume, self.shear, self.bulk, self.density, self.remanence)
        low, high = self.shared
        contact = multi_grid_contact.Contact(bool((low < high).all()), low, high, self.weight, self.curve)
        taken, drift = apic_step.advance(
            steps, dt, self.grid, contact, particles, state, effects, self.watch, self.slabs, self.moved, self.drift
        )
        return int(taken), float(drift)

    def _later(self, dt: float, effects: tuple[Any, ...]) -> tuple[Array, Array]:
        """v and C after dt (s) of forces and damping at the present positions; without a transfer, which would smooth them.

        The watch checks the present state.
        """
        v, C = np.zeros_like(self.v), np.zeros_like(self.C)
        self._steps(1, dt, effects, self.x.copy(), v, C, self.L.copy(), self.F.copy(), self.anchor.copy())
        left = damping.left(effects, dt)
        return left * self.v + v, left * self.C + C

    def kinematics(self) -> Kinematics:
        """The present kinematics. The watch checks the present state as well.

        Velocities lag half a step behind positions, as in the total formulation. Here they are brought up to the time of the positions.
        """
        if self.drift > apic_step.DRIFT:
            self.sort()
        with self.threads.alone():
            return self._kinematics(*self._later(self.lag, self._last))

    def _kinematics(self, v: Array, C: Array) -> Kinematics:
        F = self._in_order(self.F, 9).reshape(-1, 3, 3)
        F[self.model.held] = np.eye(3)
        return Kinematics(self._places(), self._in_order(v, 3), F, self._kinetic(v, C))

    def set_off(self, dt: float, effects: tuple[Any, ...]) -> None:
        """Shift the velocities to half a step of dt (s) before the positions, as steps of dt expect them (see TotalMotion)."""
        back = dt / 2 - self.lag
        if abs(back) <= 1e-9 * dt:
            return
        if self.drift > apic_step.DRIFT:
            self.sort()
        v, C = self._later(abs(back), effects)
        self.v -= np.sign(back) * (v - self.v)
        self.C -= np.sign(back) * (C - self.C)
        self.lag, self._last = dt / 2, at_step(effects, 0)

    def kept(self) -> dict[str, Any]:
        """State that `rewind` needs within the same process. Cheaper than `state`."""
        field = None if self.drift_correction is None else self.drift_correction.field.copy()
        changed = {name: getattr(self, name).copy() for name in CHANGED}
        return {**vars(self), **changed, "field": field}

    def rewind(self, kept: dict[str, Any]) -> None:
        """Go back to the state that `kept` returned."""
        field = kept["field"]
        for name, value in kept.items():
            if name != "field":
                setattr(self, name, value.copy() if name in CHANGED else value)
        self.grid.momentum[:] = 0.0
        if self.drift_correction is not None:
            self.drift_correction.field[:] = field

    def _relax(self) -> None:
        """Move positions and F toward the fit (dynamics.drift_correction).

        New positions at old velocities would change the angular momentum of a free body. A rotation of the whole body restores it.
        """
        if self.drift_correction is None:
            return
        before = self.x.copy()
        self.stiffness[:] = np.nan  # F changes here, but not by the motion
        self.drift += self.drift_correction.relax(self.x, self.F, self.rows(), self.touching, self.since)
        self._fill_up(self.x, 3)
        self._fill_up(self.F, 9)
        self.since = 0
        if self.touches:
            self.anchor += self.x - before
        if not self.model.free:
            return
        mass = self.density * self.volume
        x, v, moved = (self._rowwise(blocks) for blocks in (self.x, self.v, self.x - before))
        lost = -mass @ np.cross(moved, v)
        arm = x - mass @ x / mass.sum()
        affine = np.diag(self.model.grid.spacing**2 / 4)  # APIC: C of a particle turns like a block with this second moment
        second = arm.T @ (mass[:, None] * arm) + mass.sum() * affine
        turn = np.linalg.solve(np.trace(second) * np.eye(3) - second, lost)
        self.v += _flat(np.cross(turn, arm))
        C = self.C.reshape(-1, 9, WIDTH)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            C[:, 3 * j + i] += turn[k]
            C[:, 3 * i + j] -= turn[k]

    def _fill_up(self, blocks: Array, width: int) -> None:
        """Give rows without a particle what the particle before them has (`_fit`), in place: the watch looks at all lanes of a block."""
        real = self.particle >= 0
        empty, full = np.flatnonzero(~real), np.maximum.accumulate(np.where(real, np.arange(len(real)), 0))
        values = blocks.reshape(-1, width, WIDTH)
        values[empty // WIDTH, :, empty % WIDTH] = values[full[empty] // WIDTH, :, full[empty] % WIDTH]

    def rows(self) -> Index:
        """Row (n,) of each of the model's particles; 0 for held ones, which have no row."""
        row = np.zeros(len(self.model.density), np.int64)
        real = self.particle >= 0
        row[self.particle[real]] = np.flatnonzero(real)
        return row

    def particles(self) -> tuple[Array, Array, Array]:
        """x m, v m/s (n, 3) and F (n, 3, 3), in the model's order."""
        F = self._in_order(self.F, 9).reshape(-1, 3, 3)
        F[self.model.held] = np.eye(3)
        return self._places(), self._in_order(self.v, 3), F

    def _places(self) -> Array:
        x = self._in_order(self.x, 3)
        x[self.model.held] = self.model.particles.position[self.model.held]
        return x

    def anchors(self) -> Array:
        """Friction anchors of the particles (n, 3) m, in the model's order (effects.contact_force); without contact, their positions."""
        x = self._in_order(self.anchor if self.touches else self.x, 3)
        x[self.model.held] = self.model.particles.position[self.model.held]
        return x

    def touching_points(self) -> Touching:
        """The particles as what touches obstacles, in the model's order."""
        x, v, _ = self.particles()
        return Touching(x, v, self.model.density * self.model.particles.volume, self.anchors())

    def affine(self) -> Array:
        """APIC's C (n, 3, 3) 1/s, in the model's order: dv/dx averaged over a cell."""
        return self._in_order(self.C, 9).reshape(-1, 3, 3)

    def _in_order(self, blocks: Array, width: int) -> Array:
        """Values (n, width) in the model's order, from the kernel's blocks."""
        rows = self._rowwise(blocks, width)
        real = self.particle >= 0
        out = np.zeros((len(self.model.density), width))
        out[self.particle[real]] = rows[real]
        return out

    @staticmethod
    def _rowwise(blocks: Array, width: int = 3) -> Array:
        """Values (n8, width) row by row, with padding, from the kernel's blocks."""
        return blocks.reshape(-1, width, WIDTH).transpose(0, 2, 1).reshape(-1, width)

    def kinetic_energy(self) -> float:
        """Kinetic energy of the particles' velocities and of their affine parts, J."""
        return self._kinetic(self.v, self.C)

    def _kinetic(self, v: Array, C: Array) -> float:
        """Kinetic energy, J, of velocities and their affine parts in blocks.

        The mass that a particle gives to the nodes has the second moment m h^2 / 4 along each axis (kernels.apic_step). So it also moves
        where the particle turns or changes shape.
        """
        mass = (self.density * self.volume).reshape(-1, 1, WIDTH)
        affine = np.tile(self.model.grid.spacing**2 / 4, 3)[:, None] * C.reshape(-1, 9, WIDTH) ** 2
        return 0.5 * float(np.sum(mass * v.reshape(-1, 3, WIDTH) ** 2) + np.sum(mass * affine))

    def lost_in_a_transfer(self) -> float:
        """Kinetic energy, J, that one transfer to the grid and back takes from the velocities: a step of no time, without forces."""
        if self.drift > apic_step.DRIFT:
            self.sort()
        v, C = self.v.copy(), self.C.copy()
        with self.threads.alone():
            self._steps(1, 0.0, self._last, self.x.copy(), v, C, self.L.copy(), self.F.copy(), self.anchor.copy())
            return self.kinetic_energy() - self._kinetic(v, C)

    @property
    def unknowns(self) -> int:
        """Number of components of the particles' positions."""
        return 3 * len(self.model.density)

    def state(self) -> dict[str, Array]:
        """State that `restore` needs. If taken right after a sort, a restored motion gives the same bits as one that never stopped."""
        x, v, F = self.particles()
        kept: dict[str, Array] = {"lag": np.array(self.lag)}
        if self.keeps_gradient:
            kept["L"] = self._in_order(self.L, 9).reshape(-1, 3, 3)
        if self.touches:
            kept["anchor"] = self.anchors()
        if self.drift_correction is not None:
            kept |= {"fit": self.drift_correction.field.copy(), "since": np.array(self.since)}
        return {"x": x, "v": v, "F": F, "C": self.affine(), **kept}

    def restore(self, state: dict[str, Array]) -> None:
        """Go back to a `state`."""
        self.place(state["x"], state["v"], state["F"], state["C"], state.get("L"), state.get("anchor"))
        self.lag = float(state.get("lag", 0.0))
        if self.drift_correction is not None:
            self.drift_correction.field[:], self.since = state["fit"], int(state["since"])


def _blocks(rows: Array, source: Index) -> Array:
    """Values (n, k) of particles, in the order of source, as flat blocks of eight: (n8 / 8, k, 8)."""
    return _flat(rows[source])


def _flat(rows: Array) -> Array:
    """Rows (n8, k) as the kernel's flat blocks."""
    return np.ascontiguousarray(rows.reshape(-1, WIDTH, rows.shape[1]).transpose(0, 2, 1)).reshape(-1)
