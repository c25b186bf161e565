"""One explicit step of a motion in plain NumPy, written like the formulas: the reference for the compiled kernels.

Everything is dense over the nodes of one box, and particle loops are explicit: for small models only. It shares with the kernels only
the model (particles, materials, splines at the start) and the hooks of the effects.

The grid lies in the undeformed body (c (nodes, 3) m displacement and v (nodes, 3) m/s velocity of each node):

    F = I + sum c_a (x) grad N_a, x = X + sum c_a N_a, M_a = sum m_p N_a
    f_a = sum_p [ -V P grad N_a + (V f + contact) N_a ]
    v_a += dt f_a / M_a, then the node hooks, friction point by point, the node hooks for no time, then c_a += dt v_a

P: the neo-Hookean stress with its volume part projected on model.modes, plus the effects'. Source: de Vaucorbeil, CMAME 360 (2020).
"""

from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from magmpm.bodies.wetted_surface import END
from magmpm.effects import hooks
from magmpm.effects.contact_force import GRIP, PARTS
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


def allowed(pull: np.ndarray, normal: np.ndarray, most: float) -> np.ndarray:
    """The friction (3,) N nearest to a pull (3,) N that lies along the surface and within the circle of `most` (N)."""
    along = pull - (pull @ normal) * normal
    size = np.linalg.norm(along)
    return along * (most / size if size > most else 1.0)


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
    on (points, nodes): splines at the points of the surface; patch (points,): those of one cell; friction (patches, 3) N: of the step
    before; normal (patches, 3) and most (patches,) N: of their pushes, and the largest friction that these allow; mean (patches, nodes):
    splines, weighed by what the pushes of their points allow; order (patches,): in which friction goes through them.
    """

    model: Model
    N: np.ndarray
    dN: np.ndarray
    X: np.ndarray
    mass: np.ndarray
    fixed: np.ndarray
    on: np.ndarray
    patch: np.ndarray
    friction: np.ndarray
    normal: np.ndarray
    most: np.ndarray
    mean: np.ndarray
    order: np.ndarray

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
        patch = np.zeros(0, int)
        if surface is not None:
            _, patch = np.unique(surface.first, axis=0, return_inverse=True)
        patch = patch.ravel()
        patches = int(patch.max(initial=-1)) + 1
        return cls(
            model,
            N,
            dN,
            X,
            N.T @ (model.density * model.particles.volume),
            fixed,
            on,
            patch,
            np.zeros((patches, 3)),
            np.zeros((patches, 3)),
            np.zeros(patches),
            np.zeros((patches, N.shape[1])),
            np.arange(patches),
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
        every = self.N.T @ force - np.einsum("n,nkj,jna->ak", V, P, self.dN) + self.contact(c, step)
        return self.immersed(c, v, every, step)

    def immersed(self, c: np.ndarray, v: np.ndarray, force: np.ndarray, step: int) -> np.ndarray:
        """Force (nodes, 3) N with the drag of a fluid on pieces of the surface, and less by what accelerates the fluid along with nodes:
        (1 + a n n^T + b (1 - n n^T))^-1 of it, with the n of the nearest piece."""
        fluid = self.model.scene.effects.fluid
        if fluid is None:
            return force
        at = self.model.wetted
        surface = at.surface
        normal = np.empty((len(surface.size), 3))
        law = fluid.law(surface)
        for k, tangents in enumerate(surface.tangents):
            N = np.zeros(len(c))
            dN = np.zeros((len(c), 3))
            w, s = at.weights[k], at.slopes[k]
            for a, b, d in product(range(3), repeat=3):
                node = np.ravel_multi_index(
                    at.first[k] + np.array([a, b, d]), self.model.grid.nodes
                )
                N[node] += w[0, a] * w[1, b] * w[2, d]
                dN[node] += [
                    s[0, a] * w[1, b] * w[2, d],
                    w[0, a] * s[1, b] * w[2, d],
                    w[0, a] * w[1, b] * s[2, d],
                ]
            first, second = tangents @ (np.eye(3) + c.T @ dN).T
            normal[k] = np.cross(first, second) if tangents[1].any() else first
            f = np.zeros(3)
            x = surface.place[k] + N @ c
            call(self.model, "drag", law[k], x, normal[k], N @ v, f, step=step)
            force = force + np.outer(N, f)
        side = np.flatnonzero(surface.kind != END)
        nearest = side[cKDTree(surface.place[side]).query(self.X)[1]]
        n = normal[nearest] / np.linalg.norm(normal[nearest], axis=1)[:, None]
        volume = self.N.T @ self.model.particles.volume
        share = fluid.density * volume / np.where(self.mass > 0, self.mass, 1.0)
        along, beside = (share * each[nearest] for each in fluid.carried(surface))
        out = np.einsum("ai,ai->a", n, force)[:, None] * n
        return out / (1.0 + along)[:, None] + (force - out) / (1.0 + beside)[:, None]

    def contact(self, c: np.ndarray, step: int = 0) -> np.ndarray:
        """Contact of the surface's points on every node, (nodes, 3) N, with the friction of the step before as far as it is allowed."""
        forces = np.zeros((len(self.on), 3))
        grips = np.zeros(len(self.on))
        for p, splines in enumerate(self.on):
            x = self.model.surface.place[p] + splines @ c
            f = np.zeros(PARTS)
            call(self.model, "contact", x, self.model.surface.mass[p], f, step=step)
            own = self.model.surface.friction[p]
            forces[p] = f[:3]
            grips[p] = f[GRIP] if np.isnan(own) else own * np.linalg.norm(f[:3])
        total = self.on.T @ forces
        for k in range(len(self.most)):
            mine = self.patch == k
            push = forces[mine].sum(axis=0)
            size = np.linalg.norm(push)
            self.most[k] = grips[mine].sum()
            self.normal[k] = push / size if size > 0 else 0.0
            self.friction[k] = allowed(self.friction[k], self.normal[k], self.most[k])
            if self.most[k] > 0:
                self.mean[k] = grips[mine] @ self.on[mine] / self.most[k]
                total += np.outer(self.mean[k], self.friction[k])
        return total

    def touching(self) -> np.ndarray:
        """Patches that touch something with friction in the undeformed body."""
        rest = np.zeros((len(self.mass), 3))
        self.contact(rest)
        return np.asarray(self.most > 0)

    def rub(self, v: np.ndarray, push: float) -> None:
        """Friction stops the sliding of one patch after another, there and back, as far as it is allowed."""
        free = (self.mass > 0) & ~self.fixed
        inverse = self.inverse_mass() * np.outer(free, free)
        for p in [*self.order, *self.order[::-1]]:
            quicker = inverse @ self.mean[p]
            give = self.mean[p] @ quicker
            if self.most[p] == 0.0 or give == 0.0:
                continue
            before = self.friction[p].copy()
            pull = before - (self.mean[p] @ v) / (push * give)
            self.friction[p] = allowed(pull, self.normal[p], self.most[p])
            v += push * np.outer(quicker, self.friction[p] - before)

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
        self.change_nodes(c, after, dt, step)
        if self.most.any():
            self.rub(after, push)
            self.change_nodes(c, after, 0.0, step)
        after[self.fixed] = 0.0
        return c + dt * after, after

    def change_nodes(self, c: np.ndarray, v: np.ndarray, dt: float, step: int) -> None:
        """Let effects change the velocities of the nodes with mass."""
        for node in np.flatnonzero(self.mass > 0):
            free = not self.fixed[node]
            call(self.model, "node", self.X[node], c[node], v[node], free, dt, step=step)
