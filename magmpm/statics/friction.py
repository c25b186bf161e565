"""Friction along a path of equilibria, in increments.

Through an increment every point that touches is held by a spring at its anchor, as in motion (effects.contact_force): along the obstacle,
with a pull of at most its grip, so with the energy k s^2 / 2 up to k s = g, and g s - g^2 / 2 k beyond. Grip and normal are those of the
last equilibrium; it is sought again with those that it has itself until the grip stays. Then anchors follow the points that slid.
A point that begins to touch is held where it met the obstacle, by its distance before and its depth now.
Sources: return mapping: Wriggers, Computational Contact Mechanics, 2nd ed., section 5.2.2; lagged grip, whose friction has an energy: Li et
al., Incremental Potential Contact, ACM Trans. Graph. 39 (2020) 49, section 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.jit import compiled
from magmpm.effects.base import Records
from magmpm.effects.contact_force import PARTS, own_grip
from magmpm.effects.hooks import add_contact, deepest

SETTLED = 1e-3  # of the grip of all points: how much it may still change, and so the force of friction


class Held(NamedTuple):
    """State of friction of points (n,) of a surface: anchor (n, 3) m, normal (n, 3) out of the obstacle, grip (n,) N, 0 where nothing holds
    a point, and stiffness (n,) N/m."""

    anchor: Array
    normal: Array
    grip: Array
    stiffness: Array


def held_at(effects: Records, x: Array, mass: Array, friction: Array, begun: tuple[Array, Held] | None) -> Held:
    """Find how obstacles hold points at x (n, 3) m; begun: where they were as the increment began, and how they were held; None: where they
    are now, by nothing."""
    f, met = np.zeros((len(x), PARTS)), np.ones(len(x))
    _grips(effects, x, x if begun is None else begun[0], mass, friction, f, met)
    grip, anchor = np.linalg.norm(f[:, 3:6], axis=1), x
    if begun is not None:
        was, held = begun
        anchor = np.where((held.grip > 0)[:, None], held.anchor, was + met[:, None] * (x - was))
    return Held(anchor, f[:, 3:6] / np.maximum(grip, 1e-300)[:, None], grip, f[:, 6])


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
    energy += np.where(slides, held.grip * r - held.grip**2 / np.maximum(2 * held.stiffness, 1e-300), k * r**2 / 2)
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


@compiled
def _grips(effects, x, was, mass, friction, f, met):  # type: ignore[no-untyped-def]
    """Write the grip of points at x (n, 3) m to f (n, PARTS), and which share of the way from `was` was clear to met (n,)."""
    still = np.zeros(3)
    for p in range(len(x)):
        depth = deepest(effects, 0, x[p])
        if depth > 0.0:
            before = deepest(effects, 0, was[p])
            met[p] = 0.0 if before >= 0.0 else 1.0 / (1.0 - depth / before)
            add_contact(effects, 0, x[p], still, mass[p], 0.0, f[p])
            own_grip(friction[p], f[p])
