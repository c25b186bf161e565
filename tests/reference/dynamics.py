"""One explicit step of a motion in plain NumPy, written like the formulas: the reference for the compiled kernels.

Everything is dense over the nodes of one box, and particle loops are explicit: for small models only. It shares with the kernels only
the model (particles, materials, splines at the start) and the hooks of the effects.

The grid lies in the undeformed body (c (nodes, 3) m displacement and v (nodes, 3) m/s velocity of each node):

    F = I + sum c_a (x) grad N_a, x = X + sum c_a N_a, M_a = sum m_p N_a
    f_a = sum_p [ -V P grad N_a + (V f + contact) N_a ]
    v_a += dt f_a / M_a, then the node hooks, then c_a += dt v_a

P: the neo-Hookean stress with its volume part projected on model.modes, plus the effects'. Source: de Vaucorbeil, CMAME 360 (2020).
"""

from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from magmpm.effects import hooks
from magmpm.model import Model


def call(model: Model, hook: str, *arguments: Any, step: int = 0) -> list[Any]:
    """One hook of every effect that has it, in the order of the model: function(effect, data, *arguments). Returns what each returns."""
    having = [
        (hooks.hook_of(hook, record), record[min(step, len(record) - 1)], data)
        for record, data in hooks.pairs(model.effects)
    ]
    return [
        function(one, data, *arguments) for function, one, data in having if function is not None
    ]


def push_time(model: Model, dt: float, step: int = 0) -> float:
    """Seconds for which forces push in a step of dt (s): the product of all hooks `push`."""
    push = dt
    for record, data in hooks.pairs(model.effects):
        function = hooks.hook_of("push", record)
        if function is not None:
            push *= function(record[min(step, len(record) - 1)], data, dt)
    return push


def projected(model: Model, change: np.ndarray) -> np.ndarray:
    """det F - 1 (n,) projected on the modes of each cell (F-bar)."""
    if not model.modes.shape[1]:
        return change
    found = np.zeros(len(change))
    for cell in (slice(a, b) for a, b in pairwise(model.particles.cell_first)):
        modes = model.modes[cell]
        found[cell] = modes @ (modes.T @ (model.particles.volume[cell] * change[cell]))
    return found


def elastic_stress(model: Model, F: np.ndarray) -> np.ndarray:
    """P (n, 3, 3) Pa: G J^(-2/3) (F - I1/3 F^-T) + p J F^-T, where p = K (J - 1), J projected on the modes of each cell."""
    J = np.linalg.det(F)
    H = np.linalg.inv(F).transpose(0, 2, 1)
    I1 = np.einsum("nij,nij->n", F, F)
    change = projected(model, J - 1)
    shape = (model.shear * J ** (-2 / 3))[:, None, None] * (F - I1[:, None, None] / 3 * H)
    return shape + (model.bulk * change * J)[:, None, None] * H


def held(
    x: np.ndarray, v: np.ndarray, depth: float, before: np.ndarray, f: np.ndarray, dt: float
) -> tuple[np.ndarray, np.ndarray]:
    """The force (3,) N of contact with friction on a point at x (3,) m with velocity v (3,) m/s, and what it remembers next; f (9,): of
    effects.contact_force; before (8,): anchor, 1 where it sticks, -1 where it slides, 0 where it does not touch, mean grip N, time s, the
    mean of the mean N, and the way since it stuck m.

    The spring is as long as x is from the anchor along the obstacle, as far as the lasting grip holds. A new anchor is where x came in.
    """
    grip, rigidity, thickness, wave = f[3:6], *f[6:]
    anchor, (mean, time, again, way) = before[:3], before[4:]
    now = np.linalg.norm(grip)
    if now == 0:
        return f[:3].copy(), np.array([*x, -1.0, mean, time, again, way])
    n = grip / now
    if before[3] == 0:
        anchor = x - v * min(dt, depth / max(-v @ n, 1e-300)) * (v @ n < 0)
    stretch = (np.eye(3) - np.outer(n, n)) @ (x - anchor)
    pull = rigidity * np.linalg.norm(stretch)
    old = min(way / (0.01 * thickness), 1.0)
    time = min(time + dt, max(4.0 * wave * (1.0 - 15.0 / 16.0 * old), dt))
    mean += dt / time * (now - mean)
    again += dt / time * (mean - again)
    most = max(1.5 * mean - 0.5 * again, 0.0)
    slides = pull > most
    stretch *= most / pull if slides else 1.0
    way = way + (pull - most) / rigidity if slides else 0.0
    return f[:3] - rigidity * stretch, np.array(
        [*(x - stretch), -1.0 if slides else 1.0, mean, time, again, way]
    )


def particle_forces(
    model: Model, x: np.ndarray, F: np.ndarray, dF: np.ndarray, step: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Stress P (n, 3, 3) Pa and force (n, 3) N of every particle, with all effects but contact. dF (n, 3, 3) 1/s: rate of F."""
    P = elastic_stress(model, F)
    force = np.zeros_like(x)
    for p, volume in enumerate(model.particles.volume):
        rho = model.density[p]
        f = np.zeros(3)
        call(model, "stress", model.remanence[p], rho, x[p], F[p], P[p], step=step)
        call(model, "rate_stress", rho, F[p], dF[p], P[p], step=step)
        call(model, "force", model.remanence[p], rho, x[p], F[p], f, step=step)
        force[p] = volume * f
    return P, force


@dataclass
class Total:
    """A motion on a dense box of nodes, cells + 2 along each axis, x slowest.

    N (n, nodes): every spline at every particle; dN (3, n, nodes) 1/m; X (nodes, 3) m; mass (nodes,) kg; fixed (nodes,) bool;
    on (points, nodes): splines at the points of the surface; anchor (points, 8): what friction remembers of them (`held`).
    """

    model: Model
    N: np.ndarray
    dN: np.ndarray
    X: np.ndarray
    mass: np.ndarray
    fixed: np.ndarray
    on: np.ndarray
    anchor: np.ndarray

    @classmethod
    def of(cls, model: Model) -> "Total":
        shape = model.grid.nodes
        surface = model.surface
        first = model.first_nodes(model.particles.cell)
        n = len(first)
        N = np.zeros((n, np.prod(shape)))
        dN = np.zeros((3, n, np.prod(shape)))
        (w, s), rows = model.splines(), np.arange(n)
        for a, b, c in product(range(3), repeat=3):
            node = np.ravel_multi_index((first + np.array([a, b, c])).T, shape)
            N[rows, node] = w[:, 0, a] * w[:, 1, b] * w[:, 2, c]
            dN[0, rows, node] = s[:, 0, a] * w[:, 1, b] * w[:, 2, c]
            dN[1, rows, node] = w[:, 0, a] * s[:, 1, b] * w[:, 2, c]
            dN[2, rows, node] = w[:, 0, a] * w[:, 1, b] * s[:, 2, c]
        axes = [model.grid.node_coordinates(axis) for axis in range(3)]
        X = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        fixed = (N[model.held] > 0).any(axis=0)
        on = np.zeros((0 if surface is None else len(surface.mass), N.shape[1]))
        for a, b, c in product(range(3), repeat=3) if surface is not None else ():
            node = np.ravel_multi_index((surface.first + np.array([a, b, c])).T, shape)
            w = surface.weights
            on[np.arange(len(on)), node] += w[:, 0, a] * w[:, 1, b] * w[:, 2, c]
        return cls(
            model,
            N,
            dN,
            X,
            N.T @ (model.density * model.particles.volume),
            fixed,
            on,
            np.zeros((len(on), 8)),
        )

    def gradient(self, c: np.ndarray) -> np.ndarray:
        """sum c_a (x) grad N_a (n, 3, 3)."""
        return np.einsum("ak,jna->nkj", c, self.dN)

    def force(self, c: np.ndarray, v: np.ndarray, dt: float, step: int = 0) -> np.ndarray:
        """Force on every node, (nodes, 3) N."""
        V = self.model.particles.volume
        x = self.model.particles.position + self.N @ c
        P, force = particle_forces(
            self.model, x, np.eye(3) + self.gradient(c), self.gradient(v), step
        )
        return (
            self.N.T @ force
            - np.einsum("n,nkj,jna->ak", V, P, self.dN)
            + self.contact(c, v, dt, step)
        )

    def contact(self, c: np.ndarray, v: np.ndarray, dt: float, step: int = 0) -> np.ndarray:
        """Contact of the surface's points on every node, (nodes, 3) N. The dashpot acts on those that did not stick before."""
        forces = np.zeros((len(self.on), 3))
        for p, (splines, held_at) in enumerate(zip(self.on, self.anchor, strict=True)):
            x = self.model.surface.place[p] + splines @ c
            f = np.append(np.zeros(7), self.model.surface.grip[p, 1:])
            speed = splines @ v if held_at[3] != 1 else np.zeros(3)
            call(self.model, "contact", x, speed, self.model.surface.mass[p], dt, f, step=step)
            if not f[:7].any():
                held_at[3], held_at[5] = 0, max(held_at[5] - dt, 0.0)
                held_at *= held_at[5] > 0
                continue
            forces[p], held_at[:] = held(
                x, speed, max(call(self.model, "near", x, step=step)), held_at, f, dt
            )
        return self.on.T @ forces

    def fields(self) -> np.ndarray:
        """Nodal values (nodes, k) for which the mass is right: of each set of free nodes 1, x, y, z; of a straight body hats too."""
        free = (self.mass > 0) & ~self.fixed & (self.model.scene.effects.feed is None)
        rows, columns = np.nonzero((self.N > 0) & free)
        shared = coo_matrix((np.ones(len(rows)), (rows, columns)), self.N.shape)
        label = connected_components(shared.T @ shared, directed=False)[1]
        columns_of = []
        for one in np.unique(label[free]):
            on = free & (label == one)
            x, y, z = ((self.X - self.X[on].mean(axis=0)) / self.model.grid.spacing).T
            hats = [np.ones_like(x), x]
            if self.model.line is not None:
                planes = np.unique(x[on])
                spaces = max(1, round((len(planes) - 1) / 2))
                at = planes[np.round(np.linspace(0, len(planes) - 1, spaces + 1)).astype(int)]
                hats = [np.interp(x, at, row) for row in np.eye(len(at))]
                columns_of += [
                    on * hat * field for hat in hats for field in (np.ones_like(x), y, z)
                ]
            else:
                columns_of += [on * field for field in (*hats, y, z)]
        return np.column_stack(columns_of) if columns_of else np.zeros((len(free), 0))

    def inverse_mass(self) -> np.ndarray:
        """Inverse mass (nodes, nodes) 1/kg: lumped, corrected so that the fields have their consistent mass."""
        A = self.fields()
        weight = self.model.density * self.model.particles.volume
        lumped = A.T @ (self.mass[:, None] * A)
        values = self.N @ A
        consistent = values.T @ (weight[:, None] * values)
        inverse = [
            np.linalg.pinv(matrix, rcond=1e-10, hermitian=True) for matrix in (consistent, lumped)
        ]
        on = np.where(self.mass > 0, self.mass, np.inf)
        return np.asarray(np.diag(1.0 / on) + A @ (inverse[0] - inverse[1]) @ A.T)

    def step(
        self, c: np.ndarray, v: np.ndarray, dt: float, step: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and velocity of the nodes after a time dt. Nodes without mass stay at rest."""
        on = self.mass > 0
        after = np.zeros_like(v)
        push = push_time(self.model, dt, step)
        after[on] = v[on] + push * (self.inverse_mass() @ self.force(c, v, push, step))[on]
        for node in np.flatnonzero(on):
            call(
                self.model,
                "node",
                self.X[node],
                c[node],
                after[node],
                not self.fixed[node],
                dt,
                step=step,
            )
        after[self.fixed] = 0.0
        return c + dt * after, after
