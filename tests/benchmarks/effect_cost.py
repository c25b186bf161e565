"""Time that an effect adds to that of a step of motion, by short runs in pairs on one thread: a busy machine disturbs them little."""

import time
from dataclasses import replace
from typing import Any

import numba
import numpy as np

from magmpm.dynamics.total_lagrangian import TotalMotion
from magmpm.model import Model, build
from magmpm.scene import Scene
from magmpm.studies.explore.effects_costs import _records

REPEATS, PART, STILL = 60, 0.004, 1e-12  # pairs of short runs; s, each; s, a step in which nothing moves


def measured(scene: Scene, key: str, model: Model | None = None) -> float:
    """Percent of a bare step, at the scene's settings of the effect or else at its key's example. Raises MagmpmError where it can't act.

    model: of the scene, or of one with the same body."""
    model, records = model or build(scene), _records(scene, key)
    motion, bare = TotalMotion(replace(model, effects=records)), TotalMotion(replace(model, effects=()))
    numba.set_num_threads(1)
    motion.advance(1, STILL, records)
    bare.advance(1, STILL, ())
    steps = int(np.clip(PART / _seconds(bare, 1, ()), 2, 1000))
    pairs = [_seconds(motion, steps, records) / _seconds(bare, steps, ()) for _ in range(REPEATS)]
    return 100 * (float(np.median(pairs)) - 1)


def _seconds(motion: TotalMotion, steps: int, records: Any) -> float:
    begun = time.thread_time()
    motion.advance(steps, STILL, records)
    return time.thread_time() - begun
