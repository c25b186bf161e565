"""Contact at equilibrium: the points of the body's surface (bodies.contact_surface) on the unknowns of a static solve.

Each point in an obstacle has the energy m w^2 depth^2 / 2 of the push that it feels in motion (effects.contact_law), so a damped motion
without friction settles where this energy has its minimum. Its gradient has kinks where points begin to touch: Newton's method settles
within a few more steps which points do (semismooth: Hintermueller, Ito, Kunisch, SIAM J. Optim. 13 (2002) 865).

Along a path of equilibria friction acts in increments. Through an increment every point that touches is held at its anchor by a spring
as stiff as its push: along the obstacle, with a pull of at most its grip, so with the energy k s^2 / 2 up to k s = g, and g s - g^2 / 2 k
beyond. Grip and normal are those of the last equilibrium; it is sought again with those that it has itself until the grip stays. Then
anchors follow the points that slid. A point that begins to touch is held where it met the obstacle, by its distance before and its depth
now. Sources: the spring with a slider: Cundall and Strack, Geotechnique 29 (1979) 47; return mapping: Wriggers, Computational Contact
Mechanics, 2nd ed., section 5.2.2; lagged grip, whose friction has an energy: Li et al., Incremental Potential Contact, ACM Trans. Graph. 39
(2020) 49, section 5.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from magmpm.bodies.contact_surface import ContactSurface
from magmpm.compiled.arrays import Array, Index, Mask, Plain
from magmpm.effects.base import Contact, Records, Touching
from magmpm.effects.calls import pushes_on, rows
from magmpm.effects.contact_force import RIGIDITY
from magmpm.effects.contact_law import grips, obstacle_contacts
from magmpm.kernels.equilibrium import STENCIL, Blocks, Panels, StaticCells
from magmpm.kernels.surface_contact import contact_to_matrix, touch_at_rest
from magmpm.model import Model

CONTACT_SETTLED = (
    1e-3  # of the grip of all points: how much it may still change, and so the force of friction
)


class Held(NamedTuple):
    """State of friction of points (n,): anchor (n, 3) m, normal (n, 3) outward, grip N, 0 where nothing holds, and stiffness N/m."""

    anchor: Array
    normal: Array
    grip: Array
    stiffness: Array


def held_at(
    effects: Records, x: Array, mass: Array, friction: Array, begun: tuple[Array, Held] | None
) -> Held:
    """Find how obstacles hold points at x (n, 3) m; begun: where and how they were as the increment began, or None."""
    calls = rows(effects, "contact")
    depth, f = pushes_on(calls, x, mass)
    grip = np.where(depth > 0.0, grips(f, friction), 0.0)
    anchor = x
    if begun is not None:
        was, held = begun
        before, _ = pushes_on(calls, was, mass)
        ratio = np.full_like(depth, -np.inf)  # of what touched before
        np.divide(np.maximum(depth, 0.0), before, out=ratio, where=before < 0.0)
        met = 1.0 / (1.0 - ratio)  # the share of the way from there that was clear
        anchor = np.where((held.grip > 0)[:, None], held.anchor, was + met[:, None] * (x - was))
    size = np.linalg.norm(f[:, :3], axis=1)
    normal = f[:, :3] / np.maximum(size, 1e-300)[:, None]
    return Held(anchor, normal, grip, f[:, RIGIDITY])


def change(one: Held, other: Held) -> float:
    """Difference of the grips of all points, over their sum."""
    return float(np.abs(one.grip - other.grip).sum()) / max(float(one.grip.sum()), 1e-300)


def followed(held: Held, x: Array) -> Held:
    """The same after an increment that ended at x (n, 3) m: anchors follow as far as their springs can't hold."""
    s, pull = _stretch(held, x)
    share = np.minimum(held.grip / np.maximum(pull, 1e-300), 1.0)
    return held._replace(anchor=x - share[:, None] * s)


def add_springs(held: Held, x: Array, energy: Array, f: Array, H: Array) -> Array:
    """Add the energy (n,) J, force (n, 3) N and its slope H (n, 3, 3) N/m of the springs at x (n, 3) m. Returns which slide."""
    s, pull = _stretch(held, x)
    slides = pull > held.grip
    r = np.linalg.norm(s, axis=1)
    k = np.where(slides, held.grip / np.maximum(r, 1e-300), held.stiffness)
    k[held.grip == 0] = 0.0
    energy += np.where(
        slides, held.grip * r - held.grip**2 / np.maximum(2 * held.stiffness, 1e-300), k * r**2 / 2
    )
    f -= k[:, None] * s
    across = np.eye(3) - np.einsum("ni,nj->nij", held.normal, held.normal)
    along = s / np.maximum(r, 1e-300)[:, None] * (slides & (held.grip > 0))[:, None]
    H += k[:, None, None] * (across - np.einsum("ni,nj->nij", along, along))
    return np.asarray(slides & (held.grip > 0))


def _stretch(held: Held, x: Array) -> tuple[Array, Array]:
    """Way (n, 3) m along the obstacle from the anchor, and the pull (n,) N of a spring so long."""
    s = x - held.anchor
    s -= np.einsum("ni,ni->n", s, held.normal)[:, None] * held.normal
    return s, held.stiffness * np.linalg.norm(s, axis=1)


class Touched(NamedTuple):
    """Points that touch or are held: their indices on (t,), place x (t, 3) m, mass (t,) kg, coefficient of friction of their own material
    (t,), pull (t, 3) N of friction and the most (t,) N that it can be, force f (t, 3) N, its slope H (t, 3, 3) N/m, whether they slide
    (t,); particle (t,): one in the cell of each; energy of all, J.
    """

    on: Index
    x: Array
    mass: Array
    friction: Array
    pull: Array
    most: Array
    f: Array
    H: Array
    slides: Array
    particle: Index
    energy: float

    def chosen(self, some: Mask) -> Touched:
        """Some of these points (t,), with the energy of all."""
        each: Plain = {name: getattr(self, name)[some] for name in self._fields[:-1]}
        return self._replace(**each)

    @property
    def pattern(self) -> Index:
        """Points that touch and slide: the tangent is another where it changes."""
        return np.asarray(2 * self.on + self.slides)


@dataclass(frozen=True)
class RestingSurface(ContactSurface):
    """A surface whose points (n) are sorted by cells: those cells, splines as a sparse matrix (n, nodes), and how friction holds them."""

    cells: StaticCells
    splines: Any  # scipy.sparse.csr_matrix
    held: Held | None = None

    def positions(self, grid: Array) -> Array:
        """Places (n, 3) m of the points for grid coefficients (planes, m) m."""
        return np.asarray(self.place + self.splines @ grid.reshape(-1, 3))

    def touched(self, effects: Records, grid: Array) -> Touched:
        """The points that touch for grid coefficients (planes, m) m."""
        x = self.positions(grid)
        n = len(self.mass)
        energy = np.zeros(n)
        f = np.zeros((n, 3))
        H = np.zeros((n, 3, 3))
        touch_at_rest(rows(effects, "touch"), x, self.mass, energy, f, H)
        held = energy != 0.0
        pull = np.zeros((n, 3))
        most = np.zeros(n)
        slides = np.zeros(n, bool)
        if self.held is not None:
            slides = add_springs(self.held, x, energy, pull, H)
            f += pull
            most = self.held.grip
            held |= most > 0.0
        on = np.flatnonzero(held)
        return Touched(
            on,
            x[on],
            self.mass[on],
            self.friction[on],
            pull[on],
            most[on],
            f[on],
            H[on],
            slides[on],
            self.particle[on],
            float(energy.sum()),
        )

    def force(self, touched: Touched) -> Array:
        """Force (nodes, 3) N on the grid."""
        return np.asarray(self.splines[touched.on].T @ touched.f)

    def add_tangent(self, touched: Touched, matrix: Panels | Blocks) -> None:
        """Add the second derivative of the energy to a matrix."""
        H = np.zeros((len(self.mass), 3, 3))
        H[touched.on] = touched.H
        contact_to_matrix(self.cells, self.weights, H, matrix)

    def product(self, touched: Touched, columns: Array) -> Array:
        """The second derivative of the energy times columns (planes, k, m), N."""
        planes, k, m = columns.shape
        splines = self.splines[touched.on]
        at = (
            splines @ columns.reshape(planes, k, -1, 3).transpose(0, 2, 3, 1).reshape(-1, 3 * k)
        ).reshape(-1, 3, k)
        back = splines.T @ np.einsum("tij,tjk->tik", touched.H, at).reshape(-1, 3 * k)
        return np.asarray(
            back.reshape(planes, -1, 3, k).transpose(0, 3, 1, 2).reshape(planes, k, m)
        )


def contacts_at_rest(model: Model, touched: Touched) -> dict[str, Contact]:
    """The contact of each obstacle with a model, and with each of its parts."""
    still = Touching(touched.x, touched.mass, touched.friction, touched.pull, touched.most)
    return obstacle_contacts(model, still, model.particles.segment[touched.particle])


def resting(surface: ContactSurface, planes: int, node_yz: Index, model: Model) -> RestingSurface:
    """The surface of a model on its unknowns; planes, node_yz: of its layout (statics.layout)."""
    from scipy.sparse import csr_matrix  # 0.1 s to import, and most scenes have no obstacles

    nodes = model.nodes_in_motion
    number: Index = np.asarray(np.ravel_multi_index(surface.first.T, nodes))
    order = np.argsort(number, kind="stable")
    first = surface.first[order]
    weights = np.ascontiguousarray(surface.weights[order])
    begins = np.flatnonzero(np.diff(number[order], prepend=-1))
    in_plane = np.zeros(nodes[1:], np.int64)
    in_plane[tuple(node_yz.T)] = np.arange(len(node_yz))
    plane: Index = first[:, 0] - int(model.clamped_face)
    row = np.stack(
        [
            in_plane[(first[:, 1] + b) % nodes[1], first[:, 2]]
            for b in ([1, 1, 1] if model.plane_strain else [0, 1, 2])
        ],
        axis=1,
    )
    slab: Index = plane[begins] // 2
    n = len(first)
    wide = len(node_yz)
    cells = StaticCells(
        np.searchsorted(slab, np.arange(slab[-1] + 2)),
        np.append(begins, n),
        plane[begins],
        np.ascontiguousarray(row[begins]),
        STENCIL,
    )
    at = [
        np.minimum(plane + a, planes - 1) * wide + row[:, b] + c
        for a, b, c in product(range(3), repeat=3)
    ]
    share = [
        weights[:, 0, a] * weights[:, 1, b] * weights[:, 2, c]
        for a, b, c in product(range(3), repeat=3)
    ]
    splines = csr_matrix(
        (np.stack(share, 1).ravel(), np.stack(at, 1).ravel(), STENCIL * np.arange(n + 1)),
        (n, planes * wide),
    )
    mass = surface.mass[order]
    particle = surface.particle[order]
    friction = surface.friction[order]
    return RestingSurface(
        surface.place[order],
        first,
        weights,
        mass,
        particle,
        surface.still,
        friction,
        cells,
        splines,
    )
