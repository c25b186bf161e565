"""Magnets and coils as kernels take them: on a table, or where no box excludes a magnet, as a cloud of dipoles.

The table is a tricubic spline through their exact field, refined to the given tolerance. A fixed random sample of points, denser at the
faces, checks the error of the field, the error of the gradient (at most ten times the tolerance, relative to the gradient), and the
spline's curl and divergence, which are zero for the exact field (the same bound).

A cloud is for a magnet that turns or that the body surrounds. Each dipole stands for a piece of the magnet, at Gauss points of a block, or
of a cylinder's height, radius squared and angle. Their error falls exponentially with the number along an edge (a cube, at one edge from
its face: 0.11 % with 3 per edge, 0.008 % with 4). That number grows until at the given distance the field is magpylib's to tolerance.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from magmpm.compiled.arrays import Array, Index
from magmpm.errors import SceneError
from magmpm.fields import spline
from magmpm.fields.dipole import MU0, POINT, K
from magmpm.fields.kernels import PLACE, fields_at, gradients_at
from magmpm.fields.magnets import Box, Solid

MAX_DIPOLES = 1000  # per magnet: some 40 microseconds per particle


def cloud(
    solid: Solid,
    polarization: Array,
    exact: Callable[[Array], Array],
    distance: float,
    tolerance: float,
) -> Array:
    """Dipoles (k, 7) (fields.dipole) that stand for a magnet at points `distance` m or farther from its surface.

    polarization (3,) T in space; exact: the magnet's field. Raises SceneError where MAX_DIPOLES do not reach the tolerance.
    """
    points = _around(solid, distance)
    B = exact(points)
    size = np.linalg.norm(B, axis=1)
    count = np.ones(3)
    error = np.inf
    while True:
        positions, weights = (_cylinder if solid.round else _block)(
            solid, np.rint(count).astype(int)
        )
        if len(weights) > MAX_DIPOLES:
            raise SceneError(
                solid.name,
                found=(
                    f"within {1e3 * distance:.3g} mm of it the field can't be known to "
                    f"{1e2 * tolerance:g} % with {MAX_DIPOLES} dipoles ({1e2 * error:.2g} % was "
                    "reached)"
                ),
                rule=(
                    "a magnet that turns, or that the body goes round, is computed as a cloud of"
                    " dipoles, and needs some distance"
                ),
                remedy="keep the body farther from it, or raise field.tabulation.tolerance",
            )
        volume = (2 * np.pi if solid.round else 8.0) * solid.half.prod()
        moments = weights[:, None] * volume * polarization / MU0
        error = float((np.linalg.norm(_field(positions, moments, points) - B, axis=1) / size).max())
        if error <= tolerance:
            radius = np.full((len(positions), 1), POINT)
            return np.concatenate([positions, moments, radius], axis=1)
        # refine first where the pieces are longest
        pieces = solid.half / count
        count = np.where(pieces > 0.7 * pieces.max(), count + 1, count)


def _block(solid: Solid, count: Index) -> tuple[Array, Array]:
    rules = [np.polynomial.legendre.leggauss(int(n)) for n in count]
    points = np.stack(np.meshgrid(*[rule[0] for rule in rules], indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    weights = np.einsum("i,j,k->ijk", *[rule[1] / 2 for rule in rules]).ravel()
    return solid.position + (points * solid.half) @ solid.frame.T, weights


def _cylinder(solid: Solid, count: Index) -> tuple[Array, Array]:
    radial = int(max(count[0], count[1]))
    height = int(count[2])
    s, ws = np.polynomial.legendre.leggauss(radial)
    z, wz = np.polynomial.legendre.leggauss(height)
    around = 1 if radial == 1 and height == 1 else 4 * radial
    angle = 2 * np.pi * (np.arange(around) + 0.5) / around
    r = np.zeros(1) if around == 1 else np.sqrt((1 + s) / 2)
    grid_r, grid_a, grid_z = np.meshgrid(r, angle, z, indexing="ij")
    local = np.stack([grid_r * np.cos(grid_a), grid_r * np.sin(grid_a), grid_z], axis=-1).reshape(
        -1, 3
    )
    weights = np.einsum("i,j,k->ijk", ws / 2, np.full(around, 1 / around), wz / 2).ravel()
    return solid.position + (local * solid.half) @ solid.frame.T, weights


def _around(solid: Solid, distance: float) -> Array:
    """Points at a distance from the box or cylinder of a magnet, (n, 3) m in the sources' frame."""
    rng = np.random.default_rng(21)
    far = rng.standard_normal((600, 3)) * 3 * solid.half.max()
    near = replace(solid, position=np.zeros(3), frame=np.eye(3)).nearest(far)
    outward = far - near
    outside = np.linalg.norm(outward, axis=1) > 1e-6 * solid.half.max()
    near = near[outside]
    outward = outward[outside]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    return solid.position + (near + distance * outward) @ solid.frame.T


def _field(positions: Array, moments: Array, points: Array) -> Array:
    """B (n, 3) T of dipoles (k, 3), the plain formula."""
    d = points[:, None, :] - positions
    r = np.linalg.norm(d, axis=2)
    along = np.einsum("nkj,kj->nk", d, moments)
    return K * np.sum(3 * (along / r**5)[..., None] * d - moments / (r**3)[..., None], axis=1)


MOST_TABLE_NODES = 2_500_000  # 60 MB
# times the tolerance: allowed error of the gradient; a cubic's derivative converges one order
# slower
GRADIENT = 10.0


@dataclass(frozen=True)
class Errors:
    """Largest errors of a table on its sample: of B and grad B relative to their size there, of curl and divergence to grad B's."""

    field: float
    gradient: float
    curl: float
    divergence: float

    def within(self, tolerance: float) -> bool:
        return (
            self.field <= tolerance
            and max(self.gradient, self.curl, self.divergence) <= GRADIENT * tolerance
        )


def grid_points(lower: Array, spacing: Array, shape: tuple[int, ...]) -> Array:
    """Nodes of a regular grid, (N M K, 3) m, x slowest."""
    axes = [lower[k] + spacing[k] * np.arange(shape[k]) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def tabulate(
    exact: Callable[[Array], Array], box: Box, tolerance: float, what: str
) -> tuple[Array, Errors]:
    """The packed table (fields.spline) of a field over a box, and its errors.

    exact: points (n, 3) m -> B (n, 3) T; tolerance: of B, relative. Raises SceneError where MOST_TABLE_NODES do not reach it; `what`: the
    sources.
    """
    extent = box.upper - box.lower
    points = _sample(box) @ box.frame.T
    B = exact(points)
    G = _differences(exact, points)
    # at first
    step = float(extent.max()) / 20
    errors = None
    while True:
        shape = tuple(
            int(n)
            for n in np.maximum(
                np.ceil(extent / step).astype(int) + 1, spline.LEAST_NODES_OF_SPLINE + 2
            )
        )
        if np.prod(shape, dtype=float) > MOST_TABLE_NODES:
            found = (
                ""
                if errors is None
                else (
                    f" (reached: {1e2 * errors.field:.2g} %, gradient"
                    f" {1e2 * errors.gradient:.2g} %)"
                )
            )
            raise SceneError(
                what,
                found=(
                    f"a table over {box.text()} can't be accurate to {1e2 * tolerance:g} % with "
                    f"{MOST_TABLE_NODES} nodes{found}"
                ),
                rule=(
                    "the field near an edge of a magnet or a wire varies too fast for a table that"
                    " reaches close to it"
                ),
                remedy=(
                    "keep the body farther from it, give a smaller box (field.tabulation.lower and"
                    " upper), or a larger field.tabulation.tolerance"
                ),
            )
        packed = on_nodes(exact, box, shape)
        errors = _errors(packed, points, B, G, float(extent.max()))
        if errors.within(tolerance):
            return packed, errors
        step /= 1.5


def on_nodes(exact: Callable[[Array], Array], box: Box, shape: tuple[int, ...]) -> Array:
    """The packed table of a field, points (n, 3) m -> B (n, 3) T, on so many nodes along each axis of a box."""
    spacing = (box.upper - box.lower) / (np.array(shape) - 1)
    nodes = grid_points(box.lower, spacing, shape) @ box.frame.T
    values = (exact(nodes) @ box.frame).reshape(*shape, 3)
    return spline.packed(box.lower, spacing, values, box.frame)


def of_values(lower: Array, spacing: Array, values: Array) -> tuple[Array, Errors]:
    """The packed table through measured values (N, M, K, 3) T, and its curl and divergence (root mean squares, of grad B's)."""
    packed = spline.packed(lower, spacing, values)
    shape = np.array(values.shape[:3]) - 1
    points = grid_points(lower + spacing / 2, spacing, tuple(shape))
    _, G = evaluate(packed, points)
    size = float(np.sqrt(np.mean(np.sum(G**2, axis=(1, 2))))) or 1.0
    divergence = np.trace(G, axis1=1, axis2=2)
    return packed, Errors(
        0.0,
        0.0,
        float(np.sqrt(np.mean(np.sum(_curl(G) ** 2, axis=1)))) / size,
        float(np.sqrt(np.mean(divergence**2))) / size,
    )


def _curl(G: Array) -> Array:
    """Curl (n, 3) of a field with the gradients G (n, 3, 3)."""
    return np.stack(
        [G[:, 2, 1] - G[:, 1, 2], G[:, 0, 2] - G[:, 2, 0], G[:, 1, 0] - G[:, 0, 1]], axis=1
    )


def evaluate(packed: Array, points: Array) -> tuple[Array, Array]:
    """B (n, 3) T and grad B (n, 3, 3) T/m of one packed table at points (n, 3) m."""
    place = np.zeros(1, np.dtype(PLACE))
    place["strength"], place["frame"] = 1.0, np.eye(3).ravel()
    data = np.concatenate([[0.0, 1.0], packed])
    B = np.empty((len(points), 3))
    G = np.empty((len(points), 3, 3))
    fields_at(place[0], data, points, B)
    gradients_at(place[0], data, points, G)
    return B, G


def _sample(box: Box) -> Array:
    """Points in the whole box (two thirds) and on its faces, (n, 3) m along its axes."""
    rng = np.random.default_rng(20)
    inside = rng.random((1500, 3))
    faces = rng.random((750, 3))
    for k in range(3):
        for side in range(2):
            faces[2 * k + side :: 6, k] = 0.999 if side else 0.001
    return box.lower + np.concatenate([inside, faces]) * (box.upper - box.lower)


def _differences(exact: Callable[[Array], Array], points: Array) -> Array:
    """grad B (n, 3, 3) T/m by central differences."""
    gradient_step = 2e-6  # m, of the differences for the exact gradient
    out = np.empty((len(points), 3, 3))
    for k in range(3):
        shift = gradient_step * np.eye(3)[k]
        out[:, :, k] = (exact(points + shift) - exact(points - shift)) / (2 * gradient_step)
    return out


def _errors(packed: Array, points: Array, B: Array, G: Array, extent: float) -> Errors:
    found, slope = evaluate(packed, points)
    size = np.linalg.norm(B, axis=1)
    steep = np.linalg.norm(G, axis=(1, 2)) + size / extent
    return Errors(
        field=float((np.linalg.norm(found - B, axis=1) / size).max()),
        gradient=float((np.linalg.norm(slope - G, axis=(1, 2)) / steep).max()),
        curl=float((np.linalg.norm(_curl(slope), axis=1) / steep).max()),
        divergence=float((np.abs(np.trace(slope, axis1=1, axis2=2)) / steep).max()),
    )
