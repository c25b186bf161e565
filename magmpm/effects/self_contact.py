"""self_contact: parts and folds of the body touch each other, with friction, and separate again.

Points of the surface of each component touch the other components, and folds of their own (kernels.body_contact). For force, friction and
stiffness see effects.contact_law. Without it, parts and folds pass through each other.
"""

from typing import Any

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects.base import Effect, Records, SceneLike
from magmpm.effects.contact_law import Friction, Stiffness, stable_step, stiffness_of


class SelfContact(Effect):
    """Parts and folds of the body that touch each other and separate again.

    Parameters
    ----------
    friction : float, no unit, optional
        Coulomb's coefficient of friction; 0, slippery, unless given.
    stiffness : float, no unit, optional
        Factor on the usual contact stiffness, at which the body sinks in by
        micrometers; 1 unless given. Above 1 the contact may require a smaller time step
        than the body.

    Examples
    --------
    >>> from magmpm import SelfContact
    >>> SelfContact(friction=0.3).friction
    0.3
    """

    PHASE = "contact"
    friction: Friction = 0.0
    stiffness: Stiffness = 1.0

    def records(
        self, scene: SceneLike, strength: float = 1.0, times: Array | None = None
    ) -> Records:
        """Nothing: its pairs are no effect on particles (dynamics.body_contact, statics.own_contact)."""
        return ()

    def stable_step(self, model: Any) -> float:
        """Largest stable step, s."""
        return stable_step(stiffness_of(model.scene, self.stiffness))


def gap(position: Array, reference: Array, size: float, apart: float, within: float) -> float:
    """Smallest gap (m) between surfaces of the body that are not neighbors in it; negative: they overlap; inf: none is near.

    position, reference (n, 3) m: particles now and in the undeformed body; size m: distance between the outermost particles of two surfaces
    in contact; apart m: particles that near in the undeformed body are neighbors (some cells over its thickness); within m: of the search.
    """
    from scipy.spatial import cKDTree  # imported only where it is used

    pairs = cKDTree(position).query_pairs(within, output_type="ndarray")
    rest = np.linalg.norm(reference[pairs[:, 0]] - reference[pairs[:, 1]], axis=1)
    pairs = pairs[rest > apart]
    if not len(pairs):
        return float("inf")
    now = np.linalg.norm(position[pairs[:, 0]] - position[pairs[:, 1]], axis=1)
    return float(now.min()) - size
