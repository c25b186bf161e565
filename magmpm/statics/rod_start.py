"""Start of the equilibrium solve: the shape of the rod, with the deformation of its sections.

Each section moves and turns with the rod's frame. It contracts and bends as in Saint-Venant's solution: with axial strain
eps = eps0 + k2 z - k3 y, points of the section move by
u_y = -nu (eps0 y + k2 y z - k3 (y^2 - z^2)/2), u_z = -nu (eps0 z + k2 (z^2 - y^2)/2 - k3 y z).
A section that is much wider than thick bends like a plate: u_y = 0, u_z = -nu/(1 - nu) (eps0 z + k2 z^2/2).
Without this the start would have a volume change that costs one or two Newton steps.
Source: Love, A Treatise on the Mathematical Theory of Elasticity, 4th ed., chapter 15.
"""

import numpy as np

from magmpm.bodies.curves import linear
from magmpm.bodies.segments import StraightBody
from magmpm.compiled.arrays import Array
from magmpm.materials import poisson_ratio
from magmpm.rod.cosserat import RodShape
from magmpm.statics.layout import StaticModel


def straight(model: StaticModel) -> Array:
    """Coefficients (planes, m) of the undeformed body."""
    return np.zeros((model.layout.planes, model.layout.m))


def from_rod(model: StaticModel, rod: RodShape) -> Array:
    """Coefficients (planes, m), m, of the displacement from the undeformed body to the rod's shape."""
    grid = model.grid
    layout = model.layout
    length = rod.s[-1]
    assert model.line is not None  # only straight bodies are rods
    x = model.plane_coordinates()  # plane 0 is node 1: node 0 is eliminated by the clamp
    y, z = (grid.section_nodes(layout.node_yz) - model.line.base[1:]).T

    inside = np.clip(x, 0.0, length)
    frames = plane_frames(model, rod)
    strain = linear(inside, rod.s, rod.strain)
    curvature = linear(inside, rod.s, rod.curvature)
    overhang = (x - inside)[:, None] * np.einsum("pij,pj->pi", frames, strain)
    axis = linear(inside, rod.s, rod.position) + overhang

    nu = poisson_ratio(model.shear.mean(), model.bulk.mean())
    # Right up to the clamp, though it holds the section's shape: letting this grow with the distance from the clamp costs more energy.
    e, k2, k3 = (c[:, None] for c in (strain[:, 0] - 1.0, curvature[:, 1], curvature[:, 2]))
    in_plane = np.zeros((len(x), len(y), 3))
    shape = model.scene.body.shape
    if isinstance(shape, StraightBody) and shape.bends_as_plate:
        in_plane[:, :, 1] = y
        in_plane[:, :, 2] = z - nu / (1 - nu) * (e * z + k2 * z * z / 2)
    else:
        in_plane[:, :, 1] = y - nu * (e * y + k2 * y * z - k3 * (y * y - z * z) / 2)
        in_plane[:, :, 2] = z - nu * (e * z + k2 * (z * z - y * y) / 2 - k3 * y * z)
    position = axis[:, None, :] + np.einsum("pij,pnj->pni", frames, in_plane)
    undeformed = np.stack(np.broadcast_arrays(x[:, None], y, z), axis=-1)
    u = position - undeformed

    # Values at the nodes -> spline coefficients: c = f - h^2/8 f'', exact for quadratics. Along y and z the second derivatives of
    # the field above cancel between its terms; along x they do not. Node 0 comes before plane 0, with minus its value (the clamp).
    before = np.concatenate([-u[:1], u[:-1]])
    after = np.concatenate([u[1:], 2 * u[-1:] - u[-2:-1]])
    down, here, up = _second_difference(grid.node_widths[int(model.clamped_face) :])
    u = u - (down * before + here * u + up * after) / 8
    out = np.ascontiguousarray(u.reshape(layout.planes, layout.m))
    out[layout.fixed] = 0.0
    return out


def _second_difference(width: Array) -> tuple[Array, Array, Array]:
    """Weights (planes, 1, 1) of the plane before, the plane and the next one in h^2 f'' for planes of these node widths h (planes,) m."""
    h = width[:, None, None]
    below = (np.concatenate([h[:1], h[:-1]]) + h) / 2
    above = (np.concatenate([h[1:], h[-1:]]) + h) / 2
    both = below + above
    return 2 * h * h / (below * both), -2 * h * h / (below * above), 2 * h * h / (above * both)


def plane_frames(model: StaticModel, rod: RodShape) -> Array:
    """The rod's frames at the planes of nodes, (planes, 3, 3)."""
    inside = np.clip(model.plane_coordinates(), 0.0, rod.s[-1])
    return _orthonormal(linear(inside, rod.s, rod.frames.reshape(-1, 9)).reshape(-1, 3, 3))


def local_correction(model: StaticModel, rod: RodShape, grid: Array) -> Array:
    """Coefficients `grid` (planes, m) minus the rod's shape, in the rod's frames. Nearly the same for a neighboring design."""
    extra = (grid - from_rod(model, rod)).reshape(model.layout.planes, -1, 3)
    return np.einsum("pij,pni->pnj", plane_frames(model, rod), extra).reshape(grid.shape)


def with_correction(model: StaticModel, rod: RodShape, local: Array) -> Array:
    """Coefficients (planes, m) of the rod's shape plus the `local_correction` of a neighboring design, in this rod's frames."""
    extra = np.einsum(
        "pij,pnj->pni", plane_frames(model, rod), local.reshape(model.layout.planes, -1, 3)
    )
    return from_rod(model, rod) + extra.reshape(local.shape)


def _orthonormal(frames: Array) -> Array:
    """Nearest rotations to nearly orthonormal frames (n, 3, 3): one step of Newton's polar iteration, which squares the error."""
    return (frames + np.linalg.inv(frames).transpose(0, 2, 1)) / 2
