"""The three MPM steps of a static model in plain NumPy, written like the formulas: the reference for the compiled kernels.

It shares with the kernels only the particles, the materials and the numbering of unknowns. Splines are SciPy's
B-splines on the whole grid, the clamp is a condition on their coefficients (node 0 is minus node 1, so that
u = 0 on the face), and F-bar is a weighted least-squares fit in each cell. Around a tube, splines are those piecewise sums of 1, cos
and sin that are as smooth. All vectors and F are along x, y and z. Everything is dense: for small models only.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from magmpm.bodies.grid import Grid
from magmpm.bodies.polar_grid import PolarGrid
from magmpm.fields.dipole import MU0
from magmpm.statics.layout import StaticModel

LINEAR_STIFFNESS = (
    5.0  # times G, from docs/design.md; not imported from the model, which is compared with it
)


def spline_matrix(
    x: np.ndarray, origin: float, h: float, cells: int, derivative: int = 0
) -> np.ndarray:
    """Values or derivatives of all quadratic B-splines of one axis at x: (points, cells + 2)."""
    knots = origin + h * np.arange(-2, cells + 3)
    columns = []
    for node in range(cells + 2):
        spline = BSpline.basis_element(knots[node : node + 4], extrapolate=False)
        spline = spline.derivative(derivative) if derivative else spline
        columns.append(np.nan_to_num(spline(x)))
    return np.stack(columns, axis=1)


def along_matrix(x: np.ndarray, grid: Grid, derivative: int = 0) -> np.ndarray:
    """The same along x (n,) m from the grid's lower face, where cells differ and knots on joints are repeated: (n, nodes)."""
    faces = grid.faces
    joints = [run.start for run in grid.runs if run.after is not None]
    first = faces[1] - faces[0]
    last = faces[-1] - faces[-2]
    knots = np.sort([-2 * first, -first, *faces, faces[-1] + last, faces[-1] + 2 * last, *joints])
    return BSpline(knots, np.eye(len(knots) - 3), 2)(x, nu=derivative)


def around_matrix(
    angle: np.ndarray, origin: float, w: float, cells: int, derivative: int = 0
) -> np.ndarray:
    """Values or derivatives at angles (n,) rad of the splines around: (n, cells). Node k is nonzero in the three cells from k - 2 to k.

    In each of the three it is a + b cos t + c sin t. It begins and ends with value and slope 0, has no jump of either, and is 1/2 on the
    two faces between: there two nodes are nonzero, and sum to 1."""

    def row(t: float, slope: bool) -> np.ndarray:
        return (
            np.array([0.0, -np.sin(t), np.cos(t)])
            if slope
            else np.array([1.0, np.cos(t), np.sin(t)])
        )

    rules = []
    right = []
    for cell, place, slope, value in (
        (0, 0.0, False, 0.0),
        (0, 0.0, True, 0.0),
        (0, w, False, 0.5),
        (1, w, False, 0.5),
        (1, 2 * w, False, 0.5),
        (2, 2 * w, False, 0.5),
        (2, 3 * w, False, 0.0),
        (2, 3 * w, True, 0.0),
    ):
        rule = np.zeros((3, 3))
        rule[cell] = row(place, slope)
        rules.append(rule.ravel())
        right.append(value)
    smooth = np.zeros((3, 3))
    smooth[0], smooth[1] = row(w, True), -row(w, True)
    piece = np.linalg.solve(np.array([*rules, smooth.ravel()]), np.array([*right, 0.0])).reshape(
        3, 3
    )
    out = np.zeros((len(angle), cells))
    for node in range(cells):
        t = (angle - origin - (node - 2) * w) % (2 * np.pi)
        for k in range(3):
            on = (t >= k * w) & (t < (k + 1) * w)
            out[on, node] = [piece[k] @ row(one, bool(derivative)) for one in t[on]]
    return out


@dataclass
class Reference:
    """N (n, nodes): value of every free spline at every particle; dN (3, n, nodes): its gradient, 1/m, along x, y and z. Nodes
    plane by plane. axes (n, 3, 3): columns are the directions of the grid's axes; places (n, 3): coordinates along these.
    """

    model: StaticModel
    N: np.ndarray
    dN: np.ndarray
    axes: np.ndarray
    places: np.ndarray

    @classmethod
    def of(cls, model: StaticModel) -> "Reference":
        grid = model.grid
        layout = model.layout
        values = []
        slopes = []
        places = model.particles.position.copy()
        axes = np.tile(np.eye(3), (len(places), 1, 1))
        if isinstance(grid, PolarGrid):
            _, y, z = model.particles.position.T
            places[:, 1], places[:, 2] = np.arctan2(-z, y), np.hypot(y, z)
            c = np.cos(places[:, 1])
            s = np.sin(places[:, 1])
            axes[:, 1:, 1], axes[:, 1:, 2] = np.column_stack([-s, -c]), np.column_stack([c, -s])
        for axis in range(3):
            matrix = around_matrix if isinstance(grid, PolarGrid) and axis == 1 else spline_matrix
            for derivative, table in enumerate((values, slopes)):
                if axis == 0:
                    table.append(along_matrix(places[:, 0] - grid.origin[0], grid, derivative))
                else:
                    table.append(
                        matrix(
                            places[:, axis],
                            grid.origin[axis],
                            grid.spacing[axis],
                            grid.cells[axis],
                            derivative,
                        )
                    )
        if isinstance(grid, PolarGrid):
            slopes[1] /= places[:, 2:]
        for table in (values, slopes):  # the clamp: coefficient of node 0 = - that of node 1
            table[0] = np.column_stack([table[0][:, 1] - table[0][:, 0], table[0][:, 2:]])
        y, z = layout.node_yz.T

        def product(fx: np.ndarray, fy: np.ndarray, fz: np.ndarray) -> np.ndarray:
            return np.einsum("np,nm,nm->npm", fx, fy[:, y], fz[:, z]).reshape(len(fx), -1)

        (Nx, Ny, Nz), (Dx, Dy, Dz) = values, slopes
        dN = np.stack([product(Dx, Ny, Nz), product(Nx, Dy, Nz), product(Nx, Ny, Dz)])
        return cls(model, product(Nx, Ny, Nz), np.einsum("nij,jna->ina", axes, dN), axes, places)

    @property
    def remanence(self) -> np.ndarray:
        """Remanence of the particles along x, y and z, (n, 3) T."""
        return np.einsum("nij,nj->ni", self.axes, self.model.remanence[:, :3])

    def magnetization(self, F: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """m (n, 3) T, and d(-h . m)/dF (n, 3, 3): of F Br, or of R Br where the particle's law says so, with R from F = A S C."""
        b = self.remanence
        law = self.model.remanence[:, 3:]
        m = np.einsum("nij,nj->ni", F, b)
        P = -np.einsum("i,nj->nij", h, b)
        A, S, C = np.linalg.svd(F)
        H = A.transpose(0, 2, 1) @ P @ C.transpose(0, 2, 1)
        turned = A @ ((H - H.transpose(0, 2, 1)) / (S[:, :, None] + S[:, None])) @ C
        on = law[:, :1] > 0 if law.shape[1] else np.zeros((len(F), 1), bool)
        return np.where(on, np.einsum("nij,nj->ni", A @ C, b), m), np.where(
            on[..., None], turned, P
        )

    def gather(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """u = sum N_a c_a (n, 3) and F = I + sum c_a (x) grad N_a (n, 3, 3), for coefficients c (planes, m)."""
        c = c.reshape(-1, 3)
        return self.N @ c, np.eye(3) + np.einsum("ak,jna->nkj", c, self.dN)

    def cells(self) -> list[np.ndarray]:
        """The particles of each cell, which share a grid cell and a segment."""
        p = self.model.particles
        key = np.column_stack([p.cell, p.segment])
        _, inverse = np.unique(key, axis=0, return_inverse=True)
        return [np.flatnonzero(inverse == k) for k in range(inverse.max() + 1)]

    def volume_stiffness(self) -> np.ndarray:
        """Q (n, n) N m of the volume energy (J - 1)^T Q (J - 1) / 2, with J = det F of the particles.

        Plain: K V on the diagonal. F-bar: a linear function is fitted to J in each cell, by least squares weighted with the volumes.
        Its mean has the stiffness K, its variation at most LINEAR_STIFFNESS G, but K through a tube's wall, the residual of the fit none.
        """
        model = self.model
        V = model.particles.volume
        G = model.shear
        K = model.bulk
        if model.modes.shape[1] == 0:
            return np.diag(V * K)
        Q = np.zeros((len(V), len(V)))
        for cell in self.cells():
            x = self.places[cell]
            one = np.ones(len(cell))
            x = (x - x.mean(axis=0)) / model.grid.spacing
            W = np.diag(V[cell])
            stiff, line = (
                B @ np.linalg.pinv(B.T @ W @ B) @ B.T @ W
                for B in (
                    np.column_stack([one, x[:, 2]] if isinstance(model.grid, PolarGrid) else [one]),
                    np.column_stack([one, x]),
                )
            )
            slope = line - stiff
            k = K[cell[0]]
            g = G[cell[0]]
            Q[np.ix_(cell, cell)] = (
                k * stiff.T @ W @ stiff + min(k, LINEAR_STIFFNESS * g) * slope.T @ W @ slope
            )
        return Q

    def energy_parts(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Energy (n,) J of each particle, and its det F. Only sums of the energy over whole cells are meaningful."""
        model = self.model
        u, F = self.gather(c)
        J = np.linalg.det(F)
        W = model.shear / 2 * (J ** (-2 / 3) * np.einsum("nij,nij->n", F, F) - 3)
        B, g = loads(model)
        W -= self.magnetization(F, B / MU0)[0] @ B / MU0 + model.density * (
            (model.particles.position + u) @ g
        )
        return model.particles.volume * W + (J - 1) * (self.volume_stiffness() @ (J - 1)) / 2, J

    def _terms(self, c: np.ndarray) -> tuple[np.ndarray, ...]:
        """F, J, F^-T, V, I1, G J^(-2/3), the stiffness of volumes and the pressure."""
        (_, F), V, Q = self.gather(c), self.model.particles.volume, self.volume_stiffness()
        J = np.linalg.det(F)
        scaled = self.model.shear * J ** (-2 / 3)
        return (
            F,
            J,
            np.linalg.inv(F).transpose(0, 2, 1),
            V,
            np.einsum("nij,nij->n", F, F),
            scaled,
            Q,
            Q @ (J - 1) / V,
        )

    def residual(self, c: np.ndarray) -> np.ndarray:
        """dE/dc (planes, m): sum over particles of V (P grad N - f N)."""
        model = self.model
        F, J, H, V, I1, g, _, p = self._terms(c)
        P = g[:, None, None] * (F - I1[:, None, None] / 3 * H) + (p * J)[:, None, None] * H
        B, weight = loads(model)
        P += self.magnetization(F, B / MU0)[1]
        f = model.density[:, None] * weight
        out = np.einsum("n,nkj,jna->ak", V, P, self.dN) - np.einsum("n,nk,na->ak", V, f, self.N)
        return out.reshape(c.shape)

    def tangent(self, c: np.ndarray) -> np.ndarray:
        """d^2E/dc^2 (unknowns, unknowns), from dP/dF written with H = F^-T."""
        F, J, H, V, I1, g, Q, p = self._terms(c)
        eye = np.eye(3)

        def outer(
            scale: np.ndarray, left: np.ndarray, right: np.ndarray, indices: str
        ) -> np.ndarray:
            return np.einsum(f"n,{indices}->niJkL", scale, left, right)

        A = np.einsum("n,ik,JL->niJkL", g, eye, eye)
        A -= outer(2 / 3 * g, F, H, "niJ,nkL") + outer(2 / 3 * g, H, F, "niJ,nkL")
        A += outer(2 / 9 * g * I1 + p * J, H, H, "niJ,nkL") + outer(
            g * I1 / 3 - p * J, H, H, "niL,nkJ"
        )
        nodes = self.N.shape[1]
        full = np.einsum("n,niJkL,Jna,Lnb->aibk", V, A, self.dN, self.dN, optimize=True)
        dJ = np.einsum("n,nkL,Lna->nak", J, H, self.dN).reshape(len(J), -1)
        return full.reshape(3 * nodes, 3 * nodes) + dJ.T @ Q @ dJ


def loads(model: StaticModel) -> tuple[np.ndarray, np.ndarray]:
    """Field (3,) T and acceleration (3,) m/s^2 of the effects that the scene names; zero for the others."""
    named = model.scene.effects
    B = np.zeros(3) if named.magnetic_torque is None else np.array(model.scene.field.uniform)
    g = np.zeros(3) if named.gravity is None else np.array(named.gravity.acceleration)
    return B, g
