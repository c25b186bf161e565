"""Stability of an equilibrium: the smallest eigenvalue of its tangent, over that of the unloaded body.

K v = lambda M v, with M the mass matrix of unit density: lambda is the least stiffness, per mass, against any small motion. The ratio is 1
at rest and 0 at a critical load (buckling, snapping, turning round), toward which it falls linearly for most loads.

The solve leaves factors of a tangent a step or two old. Inverse iteration with them gives a few soft vectors; in their span the true
tangent decides, by products without its matrix (Rayleigh-Ritz: the error of the eigenvalue is the square of the vector's), and one more
preconditioned residual is added until it would change little. Source: Knyazev, SIAM J. Sci. Comput. 23 (2001) 517 (LOBPCG).
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects import acting
from magmpm.statics.energy import Energy, Point
from magmpm.statics.interacting import InteractingEnergy
from magmpm.statics.layout import StaticModel

COLUMNS = 3  # soft vectors: of a rod two of bending and one of twist
NO_LOAD = (
    1e-12  # of the load, as good as none: other kernels would have to be compiled for none at all
)
_rest: OrderedDict[bytes, float] = OrderedDict()
BRINK = 0.02  # of the unloaded body's least stiffness: below, an equilibrium has a warning

Products = Callable[[Array], tuple[Array, Array]]


def stability(energy: Energy | InteractingEnergy, point: Point) -> float:
    """Smallest eigenvalue of the tangent at an equilibrium over that of the unloaded body, no unit.

    energy: of the solve, with its last factors in its matrix, which stay; with interaction, the other parts are factored here.
    """
    alone = energy.alone
    rest = _of_rest(alone)
    here = energy.at(point.grid)  # and tables that follow the shape
    stiffer = 1.0
    if isinstance(
        energy, InteractingEnergy
    ):  # its last factors are of a tangent with another shift, or several steps old
        energy.factor(here)
        stiffer += energy.shift / rest
    return _smallest(alone, lambda columns: energy.products(here, columns), rest, stiffer) / rest


def on_the_brink(stability: float | None) -> list[str]:
    """A warning where an equilibrium is close to a critical load."""
    if stability is None or stability > BRINK:
        return []
    return [
        f"stability: the softest motion of this equilibrium has {100 * max(stability, 0.0):.2g} % "
        "of the unloaded body's stiffness: it is at a critical load (buckling, turning around) "
        "or free to turn about an axis, so a small change of the load may move it far"
    ]


def unloaded(model: StaticModel) -> tuple[Energy, Point]:
    """The energy of a model without loads, with the factors of its tangent in its matrix, and its point at rest."""
    energy = Energy(replace(model, effects=acting.collect(model.scene, NO_LOAD, model.times)))
    at = energy.at(np.zeros(energy.shape))
    if not energy.tangent(at)[1].factor():
        raise ArithmeticError("the unloaded body's tangent has no Cholesky factors")
    return energy, at


def _of_rest(energy: Energy) -> float:
    """Smallest eigenvalue (1/s^2 per kg/m^3) of the unloaded body's tangent, kept for the next solve of the same body."""
    model = energy.model
    parts = [
        model.particles.position,
        model.particles.volume,
        model.shear,
        model.bulk,
        model.weights,
        model.modes,
        model.layout.fixed,
    ]
    key = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts)).digest()
    if key not in _rest:
        bare, at = unloaded(replace(model, touching=None, pairs=None))
        _rest[key] = _smallest(bare, lambda columns: bare.products(at, columns), 0.0)
        while len(_rest) > 64:  # bodies
            _rest.popitem(last=False)
    _rest.move_to_end(key)
    return _rest[key]


def _smallest(energy: Energy, products: Products, scale: float, stiffer: float = 1.0) -> float:
    """Smallest eigenvalue of the tangent whose products are given; scale: what its error is measured by, 0 for itself;
    stiffer: how many times as stiff the factors in the energy's matrix may be in the softest motions.
    """
    # of the unloaded body's eigenvalue: what one more vector would win; it is subtracted, so a tenth of
    # it is left
    most_won = 1e-5
    # vectors: one or two after usual solves, ten where segments press each other together so that they
    # alone would buckle
    most_added = 40
    X = _start(energy)
    for _ in range(2):  # rounds of inverse iteration
        MX = energy.volumes * X
        X = energy.solve_columns(_mixed(MX, _orthonormal(_inner(X, MX))))
    X = _mixed(X, _orthonormal(_inner(X, energy.volumes * X)))
    KX, MX = products(X)
    value = np.inf
    for _ in range(most_added):
        turn = _orthonormal(_inner(X, MX))
        values, vectors = np.linalg.eigh(turn.T @ _inner(X, KX) @ turn)
        value = float(values[0])
        mix = (turn @ vectors)[:, :1]
        left = energy.free_columns(_mixed(KX, mix) - value * _mixed(MX, mix))
        w = energy.solve_columns(left)
        won = float(np.sum(w * left))  # mix is of norm 1 in M: what w can win, to first order
        if stiffer * won < most_won * max(scale, abs(value)):
            return value - won
        w /= np.abs(w).max()
        Kw, Mw = products(w)
        X, KX, MX = (
            np.concatenate([old, new], axis=1) for old, new in ((X, w), (KX, Kw), (MX, Mw))
        )
    return value


def _inner(X: Array, Y: Array) -> Array:
    """Symmetric products (k, k) of columns (planes, k, m)."""
    products = np.einsum("pam,pbm->ab", X, Y, optimize=True)
    return np.asarray((products + products.T) / 2)


def _mixed(columns: Array, mix: Array) -> Array:
    """Columns (planes, k, m) mixed to (planes, q, m) by mix (k, q)."""
    return np.ascontiguousarray(np.einsum("pkm,kq->pqm", columns, mix, optimize=True))


def _orthonormal(gram: Array) -> Array:
    """Mix (k, q) that makes columns with these inner products (k, k) orthonormal; q < k where some are not independent to rounding."""
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, np.inf)  # what can't move: a column of zeros
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    kept = (
        values > 1e-10
    )  # of the squared size: what is nearer to the others' span adds nothing but rounding
    return np.asarray((vectors[:, kept] / np.sqrt(values[kept])) / size[:, None])


def _start(energy: Energy) -> Array:
    """Columns (planes, COLUMNS, m) of smooth motion: to both sides, growing along the body, and twist about its axis."""
    model = energy.model
    layout = energy.model.layout
    x = model.plane_coordinates()
    x = (x - x[0]) / (x[-1] - x[0])
    y, z = (model.grid.section_nodes(layout.node_yz) - model.grid.origin[1:]).T
    out = np.zeros((layout.planes, COLUMNS, layout.nodes_per_plane, 3))  # along the body's axes
    out[:, 0, :, 1] = (1.0 + x**2)[:, None]
    out[:, 1, :, 2] = (1.0 + x**2)[:, None]
    middle = [
        (one - one.mean()) / np.ptp(one) if np.ptp(one) > 0.0 else np.zeros(len(one))
        for one in (y, z)
    ]  # in plane strain one y
    out[:, 2, :, 1] = -(1.0 + x)[:, None] * middle[1]
    out[:, 2, :, 2] = (1.0 + x)[:, None] * middle[0]
    out[:, 2, :, 0] = 0.1 * (1.0 + x)[:, None]
    turned = out @ model.frame.T
    return energy.free_columns(turned.reshape(layout.planes, COLUMNS, layout.m))
