"""Steps of a search along derivatives: SLSQP, which minimizes a goal under bounds of measures.

Source: Kraft, DFVLR-FB 88-28 (1988), as SciPy has it. Parameters are in tenths of their ranges, over which an angle's effect begins to
bend, and goal and bounds are divided by their first slopes: so the first step, for which no curvature is known, is of a good length.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from optuna.distributions import FloatDistribution
from scipy.optimize import minimize

from magmpm.compiled.arrays import Array, NamedNumbers

Slopes = tuple[
    Array, Array
]  # goal and what is left to each bound (1 + bounds,), and their derivatives (1 + bounds, k)


class Enough(Exception):
    """Sign that as many trials were run as were asked for."""


def descend(
    ranges: Mapping[str, FloatDistribution],
    begun: Mapping[str, float],
    tried: Callable[[NamedNumbers], Slopes | None],
    steps: int,
    units: float = 10.0,
) -> None:
    """Minimize a goal from the parameters `begun` (the middle of its range for one that is not given).

    units: of a range, in which it is measured. tried: goal and bounds at parameters, with derivatives, None where it failed.
    """
    names = list(ranges)
    low = np.array([each.low for each in ranges.values()])
    unit = (np.array([each.high for each in ranges.values()]) - low) / units
    middle = low + 0.5 * units * unit
    first = np.array([begun.get(name, m) for name, m in zip(names, middle, strict=True)])
    known: dict[bytes, Slopes] = {}
    sizes: Array | None = None  # by which goal and bounds are divided

    def at(x: Array) -> Slopes:
        nonlocal sizes
        key = x.tobytes()
        if key in known:
            return known[key]
        params = dict(zip(names, (low + unit * np.clip(x, 0.0, units)).tolist(), strict=True))
        found = tried(params)
        if found is None and not known:
            raise Enough  # the scene itself fails
        if found is None:  # worse than all before, so that a shorter step is tried
            worst = np.max([values for values, _ in known.values()], axis=0)
            before = next(iter(known.values()))[1]
            out = (np.concatenate([worst[:1] + 1.0, worst[1:]]), np.zeros_like(before))
        else:
            slopes = found[1] * unit
            if sizes is None:
                sizes = np.linalg.norm(slopes, axis=1)
                sizes[sizes == 0.0] = 1.0
            out = (found[0] / sizes, slopes / sizes[:, None])
        known[key] = out
        return out

    def best() -> Array:
        """Return where the goal is least among what keeps the bounds; the start where nothing does."""
        kept = {key: values for key, (values, _) in known.items() if (values[1:] >= 0.0).all()}
        return np.frombuffer(min(kept, key=lambda key: kept[key][0])) if kept else start

    start = np.clip((first - low) / unit, 0.0, units)
    bounds = len(at(start)[0]) - 1
    for inside in (1e-2, 1e-4) if bounds else (0.0,):
        # steps go beyond bounds that bend, so first they are kept off them, by this share of their change in a unit
        left = {
            "type": "ineq",
            "fun": lambda x, off=inside: at(x)[0][1:] - off,
            "jac": lambda x: at(x)[1][1:],
        }
        minimize(
            lambda x: at(x)[0][0],
            best(),
            jac=lambda x: at(x)[1][0],
            bounds=[(0.0, units)] * len(names),
            constraints=[left] if bounds else [],
            method="SLSQP",
            options={"ftol": 1e-6, "maxiter": steps},
        )
