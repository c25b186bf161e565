"""The time step bound of a single particle, at any place in its cell: the relevant one in the updated formulation."""

from __future__ import annotations

import numpy as np
from reference.scenes import rod_scene

from magmpm import materials
from magmpm.bodies.grid import spline_slopes, spline_weights
from magmpm.dynamics.apic import UpdatedMotion
from magmpm.dynamics.stable_step import present_bound, stable_step
from magmpm.model import build


def alone(motion: UpdatedMotion, place: np.ndarray) -> float:
    """2 / omega, s, of the fastest oscillation of one particle at rest, on the 27 nodes around its place in a cell (3,).

    From the full matrices: stiffness dP/dF with the gradients of the nodes, and the share of each node in the mass of the particle.
    """
    model, h = motion.model, motion.model.grid.spacing
    A, cof, F = np.empty((9, 9)), np.empty((3, 3)), np.eye(3)
    materials.cofactor(F, cof)
    materials.tangent(F, cof, 1.0, model.shear[0], 0.0, model.bulk[0], A)
    N, slope = spline_weights(place[None])[0], spline_slopes(place[None])[0] / h[:, None]
    a, b, c = np.indices((3, 3, 3)).reshape(3, -1)
    weight = N[0, a] * N[1, b] * N[2, c]
    gradient = np.stack([slope[0, a] * N[1, b] * N[2, c], N[0, a] * slope[1, b] * N[2, c], N[0, a] * N[1, b] * slope[2, c]])
    strain = np.einsum("ik,Ja->iJak", np.eye(3), gradient / np.sqrt(weight)).reshape(9, -1)
    return float(2 / np.sqrt(np.linalg.eigvalsh(strain.T @ A @ strain)[-1] / model.density[0]))


def test_it_holds_wherever_the_particle_is_and_no_shorter_one_would_do() -> None:
    """The worst place is near a corner of the cell, where three nodes along each axis share the particle, one of them with a small share:
    s_a = 6/h^2. At the center of the cell it is 4/h^2, and the step may be longer by sqrt(3/2).
    """
    motion = UpdatedMotion(build(rod_scene(length=8e-3)))
    told = stable_step(motion).isolated
    rng = np.random.default_rng(4)
    corner, middle = alone(motion, np.full(3, 1e-4)), alone(motion, np.full(3, 0.5))
    places = [alone(motion, place) for place in rng.uniform(1e-6, 1 - 1e-6, (200, 3))]
    assert told <= min(corner, *places)
    assert corner <= 1.001 * told
    assert 1.15 * told <= middle <= 1.3 * told
    assert 0.999 * told <= present_bound(motion) <= 1.001 * told, "of the body as it is made, it is the same"
