"""Rules for every test: NumPy's floating errors raise, random numbers repeat, BLAS keeps to one thread."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

# Set before NumPy is imported: one BLAS thread. Numba's threads and xdist's workers share the same few cores.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import configuration, settings  # noqa: E402

import magmpm  # noqa: E402, F401  (its settings for Numba must be made before Numba is imported)

configuration.set_hypothesis_home_dir(Path(tempfile.gettempdir()) / "magmpm-hypothesis")
# derandomize: the same examples on every run; no deadline: the first example may wait for a compilation.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Kernels come from the disk cache in every test, as in a user's second run (magmpm.precompile says why it matters)."""
    from magmpm.precompile import prepare_kernels
    from magmpm.scene import load_scene

    prepare_kernels(load_scene(Path(__file__).parents[1] / "data/scenes/hollow.yaml"))


@pytest.fixture(autouse=True)
def _floating_errors_raise() -> Iterator[None]:
    """Division by zero, overflow and invalid operations are errors; underflow to zero is fine."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield


@pytest.fixture(autouse=True)
def _seeded() -> None:
    """For code that draws from NumPy's old global generator."""
    np.random.seed(20240229)  # noqa: NPY002


@pytest.fixture
def rng() -> np.random.Generator:
    """A generator that gives the same numbers in every test."""
    return np.random.default_rng(20240229)
