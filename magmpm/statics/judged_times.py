"""When a path of equilibria is judged: few of its equilibria tell what error its grid leaves."""

from __future__ import annotations

import numpy as np

from magmpm.rod.strongest_load import strongest
from magmpm.scene import Scene

JUDGED = 3  # at equal parts of the path's times


def judged_times(scene: Scene) -> list[float]:
    """Times (s) of the path, in order: at equal parts, the last one among them; and where the load is strongest, unless the body is fed.

    Raises as `strongest` does.
    """
    times = scene.path_times()
    parts = {times[k] for k in np.linspace(0, len(times) - 1, JUDGED + 1).round().astype(int)[1:]}
    return sorted(parts | ({strongest(scene)} if scene.effects.feed is None else set()))
