"""Error of a free body's rotation in the updated formulation, too slow: mass on nodes lies farther out than the mass of the particles.

Particles give their mass to the nodes by splines with second moment h^2 / 4 along each axis, through the affine part of APIC. So a body of
mass M turns with the inertia I + M (h_y^2 + h_z^2) / 4 about x, and likewise about y and z. This is 75 % too much for a cube of two cells,
19 % for four, 5 % for eight. Momentum, angular momentum and energy are still
conserved. The total formulation has the body's own inertia (dynamics.nodal_mass).

Source: Belytschko et al., Nonlinear Finite Elements (2014), 2.4 (lumped mass).
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.model import Model

TOLD = 0.02  # of the inertia: a smaller excess gives no warning


def excess(model: Model) -> Array:
    """Relative excess (3,) of the moments of inertia of the worst free component, smallest first; 0 if every component is held."""
    particles, found = model.particles, np.zeros(3)
    mass = model.density * particles.volume
    component = model.scene.body.shape.components(particles)
    held = model.held | model.clamped_face | (model.scene.effects.feed is not None)
    h2 = model.grid.spacing**2
    h2[0] = np.average(model.grid.along.width[particles.cell[:, 0]] ** 2, weights=mass)
    for which in np.unique(component):
        on = component == which
        if held[on].any():
            continue
        arm = particles.position[on] - mass[on] @ particles.position[on] / mass[on].sum()
        second = arm.T @ (mass[on, None] * arm)
        own, more = np.trace(second) * np.eye(3) - second, mass[on].sum() / 4 * np.diag(h2.sum() - h2)
        here = np.sort(np.linalg.eigvals(np.linalg.solve(own, more)).real)
        found = here if here[-1] > found[-1] else found
    return found


def warnings(model: Model) -> list[str]:
    """One sentence if a free body turns noticeably too slowly, else none. A body in plane strain turns about y alone."""
    if model.plane_strain:
        return []
    least, _, most = excess(model)
    if most < TOLD:
        return []
    return [
        f"resolution: a free body here turns as if its moments of inertia were {100 * least:.2g} to {100 * most:.2g} % larger "
        "(mass sits on nodes: M h^2 / 4 along each axis); twice as many cells across reduce this to a quarter"
    ]
