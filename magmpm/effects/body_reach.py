"""The region that a body can reach. An obstacle beyond it has no effect and is most likely a mistake of unit or place.

A straight body that is held at an end stays within its length of that end, with some stretch; a body that a guide feeds, within its
length of all places to which its base is pushed. STL parts, some of which may be loose, and free bodies may go anywhere, but a motion is
stopped once a particle is FARTHEST_MOVE times the body's size from its start (dynamics.watchdog).
"""

from dataclasses import dataclass

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.effects.base import SceneLike

# times the length of a held body: silicone stretches by some percent under its weight and in fields
# of tens of mT
STRETCHED = 1.5
FARTHEST_MOVE = 10.0  # sizes of the undeformed body: how far a particle may move from its start


@dataclass(frozen=True)
class BodyReach:
    """All points within `radius` (m) of one of the places of the base, `base` (k, 3) m. why: the radius in words."""

    base: Array
    radius: float
    why: str

    def beyond(self, from_base: Array) -> float:
        """Distance (m) of an obstacle beyond reach, given its distances (k,) m from the places of the base; 0 or less: within reach."""
        return float(np.min(from_base)) - self.radius


def body_reach(scene: SceneLike) -> BodyReach:
    """The region that a scene's body can reach."""
    points_on_way_of_base = 33  # points on the way of the base
    lower, upper = (np.array(corner) for corner in scene.box())
    size = float(np.linalg.norm(upper - lower))
    feed = scene.effects.feed
    line = scene.body.shape.line
    if line is not None and (feed is not None or scene.body.shape.clamp != "none"):
        pushed = 0.0 if feed is None else feed.speed * scene.duration
        way = np.linspace(0.0, pushed, points_on_way_of_base if pushed else 1)
        words = (
            f"{STRETCHED:g} times its length from"
            f" {'all places its base is pushed to' if pushed else 'its base'}"
        )
        return BodyReach(
            np.array(line.base) + way[:, None] * [1.0, 0.0, 0.0], STRETCHED * size, words
        )
    return BodyReach(
        ((lower + upper) / 2)[None],
        (0.5 + FARTHEST_MOVE) * size,
        f"{FARTHEST_MOVE:g} times its size, where a motion is stopped",
    )


def unreached(key: str, obstacle: str, reach: BodyReach, from_base: Array) -> list[str]:
    """A warning about an obstacle (in words; key: of its effect) that can't be reached; from_base (k,) m: from the places of the base."""
    beyond = reach.beyond(from_base)
    if beyond <= 0:
        return []
    return [
        f"effects.{key}: {obstacle} does nothing: it is {1e3 * beyond:.3g} mm beyond the reach of "
        f"the body ({reach.why}); check its position and units"
    ]
