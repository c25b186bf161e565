"""The same bits for any number of threads: the order of sums is given by the slabs, not by the threads."""

from __future__ import annotations

from collections.abc import Iterator

import numba
import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm.model import build
from magmpm.simulate import run
from magmpm.statics.block_cholesky import factor, solve
from magmpm.statics.energy import Energy
from magmpm.statics.layout import static_model

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


def test_kernels_at_any_thread_count(rng: np.random.Generator) -> None:
    """Gather, energy, residual, tangent, factors and solution: 1 and 2 threads, twice each."""
    model = static_model(build(SCENE))
    c = 1e-6 * rng.standard_normal((model.layout.planes, model.layout.m))
    found = []
    for threads in (1, 2, 2, 1):
        numba.set_num_threads(threads)
        energy = Energy(model)
        point = energy.at(c)
        residual, panels = energy.tangent(point)
        unfactored = panels[: model.layout.planes].copy()
        assert factor(panels, model.layout.split) == -1
        answer = solve(panels, model.layout.split, residual)
        alone = energy.residual(point)
        found.append((point.energy, point.displacement, point.F, residual, alone, unfactored, answer))
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            assert np.array_equal(one, two)


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
