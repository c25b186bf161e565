"""The same bits for any number of threads: the order of sums is given by the slabs, not by the threads."""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.simulate import run

pytestmark = pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="Numba was started with one thread")

SCENE = rod_scene(
    length=23e-3,
    directions=[(1, 0, 0), (0.3, -0.5, 0.8)],
    lengths=[9e-3, 14e-3],
    field=(4e-3, -3e-3, 9e-3),
    gravity=(0, 1, -9.81),
    cells=3,
)


@pytest.fixture(autouse=True)
def _threads_restored() -> Iterator[None]:
    before = numba.get_num_threads()
    yield
    numba.set_num_threads(before)


def test_whole_run_at_any_thread_count() -> None:
    """A whole run gives the same bits: shape, energy, steps."""
    results = []
    for threads in (1, 2, 2):
        numba.set_num_threads(threads)
        results.append(run(SCENE))
    for other in results[1:]:
        assert np.array_equal(results[0].particle_position, other.particle_position)
        assert np.array_equal(results[0].centreline, other.centreline)
        assert (results[0].energy, results[0].iterations) == (other.energy, other.iterations)
