"""Taylor tests: a derivative is correct if the remainder falls with the order of the first missing term."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np


def slopes(remainder: Callable[[float], Any], steps: Sequence[float]) -> np.ndarray:
    """Orders at which the norm of remainder(t) falls between neighboring steps t, (len(steps) - 1,)."""
    sizes = np.array([np.linalg.norm(np.atleast_1d(remainder(t))) for t in steps])
    return np.diff(np.log(sizes)) / np.diff(np.log(np.asarray(steps)))


def convergence_order(h: Sequence[float], error: Sequence[float]) -> float:
    """Order of error against h: slope of the least-squares line through their logarithms."""
    return float(
        np.polyfit(np.log(np.asarray(h, dtype=float)), np.log(np.asarray(error, dtype=float)), 1)[0]
    )
