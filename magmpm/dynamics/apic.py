"""State of the updated formulation: particles sorted by slabs of the moving box, eight to a block."""

from __future__ import annotations

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.simd import WIDTH
from magmpm.compiled.thread_count import Threads
from magmpm.dynamics.drift_correction import INTERVAL, DriftCorrection
from magmpm.dynamics.moving_grid import Box
from magmpm.dynamics.particle_groups import slab_edges
from magmpm.dynamics.steps import Look, at_step
from magmpm.effects.hooks import has_hook
from magmpm.errors import SolveError
from magmpm.kernels import apic_step as kernels
from magmpm.kernels import multi_grid_contact
from magmpm.kernels.watch import BROKEN, WHY, new_slabs, unlimited
from magmpm.model import Model

SLAB = 4  # cells: particles that have drifted by up to one cell since they were sorted still touch no other slab of their colour
MARGIN = 2  # cells around the body
NODES_MOST = 60_000_000  # 4 GB of grid


class UpdatedMotion:
    """Positions, velocities, their affine parts and deformation gradients of a model's particles, moved by `advance`.

    Rows are in sorted order and padded: `particle` (n8,) is the model's particle of a row, -1 for padding, which has no mass.
    """

    formulation = "updated"

    def __init__(self, model: Model) -> None:
        self.model = model
        self.keeps_gradient = has_hook("rate_stress", model.effects)
        self.drift_correction: DriftCorrection | None = DriftCorrection(model)  # None: F is what the steps make of it
        self.since = 0  # steps since F was last relaxed
        self.component = model.scene.body.shape.components(model.particles)  # one grid each
        self.curve = multi_grid_contact.distances()
        self.lag, self._last = 0.0, model.effects  # s that velocities are behind the places; effects at the time of the places
        self.watch = unlimited()
        n = len(model.density)
        self.threads = Threads(n)
        self.place(model.particles.position, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3, 3)))

    def place(self, x: Array, v: Array, F: Array, C: Array, L: Array | None = None) -> None:
        """Put the particles, in the model's order: x, v (n, 3), F, APIC's C and L = dv/dx (n, 3, 3). Sorts them.

        L is needed only where an effect's stress depends on it; C by default, which is the same of a motion that is linear in space.
        """
        model = self.model
        order, source = self._fit(x)
        self.x, self.v = _blocks(x, source), _blocks(v, source)
        self.C, self.F = _blocks(C.reshape(-1, 9), source), _blocks(F.reshape(-1, 9), source)
        self.L = _blocks((C if L is None else L).reshape(-1, 9), source) if self.keeps_gradient else np.zeros(0)
        self.volume = np.where(order >= 0, model.particles.volume[source], 0.0)
        self.shear, self.bulk, self.density = model.shear[source], model.bulk[source], model.density[source]
        self.remanence = _blocks(model.remanence, source)
        self.stiffness = np.full(len(order), np.nan)
        self.particle = order

    def sort(self) -> None:
        """Sort the particles, and fit the box to them: to the same bits as `place` with what they are and do."""
        row = self.rows()
        order, source = self._fit(self._places())
        rows = row[source]
        columns = {"x": 3, "v": 3, "C": 9, "F": 9, "remanence": self.model.remanence.shape[1]}
        columns |= dict.fromkeys(("shear", "bulk", "density", "stiffness"), 1)
        for name, width in (columns | {"L": 9} if self.keeps_gradient else columns).items():
            moved = np.empty(width * len(rows))
            kernels.rearrange(rows, width, getattr(self, name), moved)
            setattr(self, name, moved)
        self.volume = np.where(order >= 0, self.model.particles.volume[source], 0.0)
        self.particle = order

    def _fit(self, x: Array) -> tuple[Index, Index]:
        """Fit the grid's box and the slabs to positions (n, 3); empties the grid.

        Returns the particles in sorted order (n8,), padded with -1, and the particle each row takes its values from.
        """
        model, h = self.model, self.model.grid.spacing
        cell = np.floor((x - model.grid.origin) / h)
        if not np.all(np.isfinite(x)) or np.abs(cell).max() > 1e7:
            raise SolveError("a particle's position is no number, or it has left every box")
        cell = cell.astype(np.int64)
        low, high = cell.min(axis=0) - MARGIN, cell.max(axis=0) + MARGIN + 1
        if model.clamped_face:
            low[0], high[0] = min(low[0], -MARGIN), max(high[0], MARGIN + 2)
        self.shape = (high - low + 2).astype(np.int64)
        grids = int(self.component.max()) + 1
        if np.prod(self.shape) * grids > NODES_MOST:
            raise SolveError(
                f"the box around the particles has {' x '.join(map(str, self.shape))} nodes for each of {grids} components; "
                "a particle has flown off, or the components are too many"
            )
        free = np.flatnonzero(~model.held)  # what is held has no rows: its nodes are at rest, it moves nothing and does not move
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
        """Take up to `steps` steps of dt (s), stopping early where a sort is due. Returns steps taken and whether the motion broke."""
        return self.threads.run(lambda: self._advance(steps, dt, effects))

    def _advance(self, steps: int, dt: float, effects: tuple[Any, ...]) -> tuple[int, bool]:
        if not self.keeps_gradient and has_hook("rate_stress", effects):
            raise ValueError("effects with a rate stress need a motion that was made for a model with one")
        if self.drift > kernels.DRIFT:
            self.sort()
        taken, self.drift = self._steps(steps, dt, effects, self.x, self.v, self.C, self.L, self.F)
        self.lag, self._last = dt / 2 if taken else self.lag, at_step(effects, taken)
        broken = bool(self.watch[WHY] == BROKEN)
        self.since += taken
        if not broken and self.since >= INTERVAL:
            self._relax()
        return taken, broken

    def _steps(
        self, steps: int, dt: float, effects: tuple[Any, ...], x: Array, v: Array, C: Array, L: Array, F: Array
    ) -> tuple[int, float]:
        state = kernels.State(x, v, C, L, F, self.stiffness)
        particles = kernels.Particles(self.slab_first, self.lift, self.volume, self.shear, self.bulk, self.density, self.remanence)
        low, high = self.shared
        contact = multi_grid_contact.Contact(bool((low < high).all()), low, high, self.weight, self.curve)
        taken, drift = kernels.advance(
            steps, dt, self.grid, contact, particles, state, effects, self.watch, self.slabs, self.moved, self.drift
        )
        return int(taken), float(drift)

    def _kick(self, dt: float, effects: tuple[Any, ...]) -> tuple[Array, Array]:
        """What forces alone, from where the particles are, add to v and C in dt (s); the watch looks at the motion as it is now."""
        v, C = np.zeros_like(self.v), np.zeros_like(self.C)
        self._steps(1, dt, effects, self.x.copy(), v, C, self.L.copy(), self.F.copy())
        return v, C

    def look(self) -> Look:
        """The motion as it is now, which the watch looks at as well.

        Velocities are half a step behind the places, as in the total formulation, and are brought up to them.
        """
        if self.drift > kernels.DRIFT:
            self.sort()
        with self.threads.alone():
            dv, dC = self._kick(self.lag, self._last)
            return self._look(self.v + dv, self.C + dC)

    def _look(self, v: Array, C: Array) -> Look:
        F = self._in_order(self.F, 9).reshape(-1, 3, 3)
        F[self.model.held] = np.eye(3)
        return Look(self._places(), self._in_order(v, 3), F, self._kinetic(v, C))

    def set_off(self, dt: float, effects: tuple[Any, ...]) -> None:
        """Take the velocities to half a step of dt (s) before the places, where steps of dt expect them (see TotalMotion)."""
        back = dt / 2 - self.lag
        if abs(back) <= 1e-9 * dt:
            return
        if self.drift > kernels.DRIFT:
            self.sort()
        dv, dC = self._kick(abs(back), effects)
        self.v -= np.sign(back) * dv
        self.C -= np.sign(back) * dC
        self.lag, self._last = dt / 2, at_step(effects, 0)

    def kept(self) -> dict[str, Any]:
        """What `rewind` needs, in the same process: cheaper than `state`."""
        field = None if self.drift_correction is None else self.drift_correction.field.copy()
        changed = {name: getattr(self, name).copy() for name in ("x", "v", "C", "L", "F", "stiffness")}
        return {**vars(self), **changed, "field": field}

    def rewind(self, kept: dict[str, Any]) -> None:
        """Go back to what was kept."""
        field = kept["field"]
        for name, value in kept.items():
            if name != "field":
                setattr(self, name, value.copy() if name in ("x", "v", "C", "L", "F", "stiffness") else value)
        self.grid.momentum[:] = 0.0
        if self.drift_correction is not None:
            self.drift_correction.field[:] = field

    def _relax(self) -> None:
        """Take places and F towards the fit (dynamics.drift_correction).

        Places that are shifted under their velocities change a free body's spin: it is given back as a rotation of the whole.
        """
        if self.drift_correction is None:
            return
        before = self.x.copy()
        self.stiffness[:] = np.nan  # it changes, but not because of the motion
        self.drift += self.drift_correction.relax(self.x, self.F, self.rows(), self.touching, self.since)
        self.since = 0
        if not self.model.free:
            return
        mass = self.density * self.volume
        x, v, moved = (self._rowwise(blocks) for blocks in (self.x, self.v, self.x - before))
        lost = -mass @ np.cross(moved, v)
        arm = x - mass @ x / mass.sum()
        affine = np.diag(self.model.grid.spacing**2 / 4)  # of APIC: C of a particle turns as a block with this second moment does
        second = arm.T @ (mass[:, None] * arm) + mass.sum() * affine
        turn = np.linalg.solve(np.trace(second) * np.eye(3) - second, lost)
        self.v += _flat(np.cross(turn, arm))
        C = self.C.reshape(-1, 9, WIDTH)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            C[:, 3 * j + i] += turn[k]
            C[:, 3 * i + j] -= turn[k]

    def rows(self) -> Index:
        """Row (n,) of each of the model's particles; 0 of held ones, which have none."""
        row = np.zeros(len(self.model.density), np.int64)
        real = self.particle >= 0
        row[self.particle[real]] = np.flatnonzero(real)
        return row

    def particles(self) -> tuple[Array, Array, Array]:
        """x, v (n, 3) and F (n, 3, 3), in the model's order."""
        F = self._in_order(self.F, 9).reshape(-1, 3, 3)
        F[self.model.held] = np.eye(3)
        return self._places(), self._in_order(self.v, 3), F

    def _places(self) -> Array:
        x = self._in_order(self.x, 3)
        x[self.model.held] = self.model.particles.position[self.model.held]
        return x

    def affine(self) -> Array:
        """APIC's C (n, 3, 3) 1/s, in the model's order: dv/dx averaged over a cell."""
        return self._in_order(self.C, 9).reshape(-1, 3, 3)

    def _in_order(self, blocks: Array, width: int) -> Array:
        """(n, width) values in the model's order, of blocks as the kernel has them."""
        rows = self._rowwise(blocks, width)
        real = self.particle >= 0
        out = np.zeros((len(self.model.density), width))
        out[self.particle[real]] = rows[real]
        return out

    @staticmethod
    def _rowwise(blocks: Array, width: int = 3) -> Array:
        """(n8, width) values of blocks as the kernel has them, padding included."""
        return blocks.reshape(-1, width, WIDTH).transpose(0, 2, 1).reshape(-1, width)

    def kinetic_energy(self) -> float:
        """Of the particles' velocities and of their affine parts, J."""
        return self._kinetic(self.v, self.C)

    def _kinetic(self, v: Array, C: Array) -> float:
        """Of velocities and their affine parts in blocks, J.

        What the nodes get from a particle has the second moment m h^2 / 4 along each axis (kernels.apic_step): what turns, or changes
        shape, moves there as well.
        """
        mass = (self.density * self.volume).reshape(-1, 1, WIDTH)
        affine = np.tile(self.model.grid.spacing**2 / 4, 3)[:, None] * C.reshape(-1, 9, WIDTH) ** 2
        return 0.5 * float(np.sum(mass * v.reshape(-1, 3, WIDTH) ** 2) + np.sum(mass * affine))

    @property
    def unknowns(self) -> int:
        """Components of the particles' positions."""
        return 3 * len(self.model.density)

    def state(self) -> dict[str, Array]:
        """What `restore` needs; taken just after a sort, going on from it gives the same bits as going on."""
        x, v, F = self.particles()
        kept: dict[str, Array] = {"lag": np.array(self.lag)}
        if self.keeps_gradient:
            kept["L"] = self._in_order(self.L, 9).reshape(-1, 3, 3)
        if self.drift_correction is not None:
            kept |= {"fit": self.drift_correction.field.copy(), "since": np.array(self.since)}
        return {"x": x, "v": v, "F": F, "C": self.affine(), **kept}

    def restore(self, state: dict[str, Array]) -> None:
        """Go back to a state."""
        self.place(state["x"], state["v"], state["F"], state["C"], state.get("L"))
        self.lag = float(state.get("lag", 0.0))
        if self.drift_correction is not None:
            self.drift_correction.field[:], self.since = state["fit"], int(state["since"])


def _blocks(rows: Array, source: Index) -> Array:
    """Values (n, k) of particles, taken in an order, in blocks of eight: flat, (n8 / 8, k, 8)."""
    return _flat(rows[source])


def _flat(rows: Array) -> Array:
    """Rows (n8, k) as the kernel has them."""
    return np.ascontiguousarray(rows.reshape(-1, WIDTH, rows.shape[1]).transpose(0, 2, 1)).reshape(-1)
