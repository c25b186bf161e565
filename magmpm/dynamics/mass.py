"""How much too slowly a free body turns: mass that sits on nodes sits farther out than it is.

Nodes get a particle's mass by splines whose second moment is h^2 / 4 along each axis: lumped in the total formulation, and in the updated
one through APIC's affine part. A body of mass M so turns with the inertia I + M (h_y^2 + h_z^2) / 4 about x, and so on: a cube of two
cells by 75 % too much, of four by 19 %, of eight by 5 %. Momentum, spin and energy are kept as exactly as ever, and what bends and
swings has little of it (a rod's first frequency 0.6 % at 2 cells).

Source: Belytschko et al., Nonlinear Finite Elements (2014), 2.4 (lumped mass).
"""

from __future__ import annotations

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.model import Model

TOLD = 0.02  # of the inertia: less is not worth a warning


def excess(model: Model) -> Array:
    """Excess (3,) of the moments of inertia over the body's own, smallest first, of the worst free component; 0 if all is held."""
    particles, found = model.particles, np.zeros(3)
    mass = model.density * particles.volume
    component = model.scene.body.shape.components(particles)
    held = model.held | model.clamped_face | (model.scene.effects.feed is not None)
    h2 = model.grid.spacing**2
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
    """One sentence where a free body turns noticeably too slowly. A body in plane strain turns about y alone."""
    if model.plane_strain:
        return []
    least, _, most = excess(model)
    if most < TOLD:
        return []
    return [
        f"resolution: what is free here turns as if its moments of inertia were {100 * least:.2g} to {100 * most:.2g} % larger "
        "(mass sits on nodes: M h^2 / 4 along each axis); twice the cells across bring that down to a quarter"
    ]
