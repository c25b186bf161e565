"""Rules for every test: NumPy floating-point errors raise, random numbers are reproducible, BLAS uses one thread."""

import gc
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

# Set before NumPy is imported: one BLAS thread, because Numba's threads and xdist's workers share the same few cores.
for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

# Where the environment forbids to keep bytecode, each worker and each process of a test would compile all sources anew: what is imported
# before the first test is kept. Tests write files of users anew within a second, and there the environment decides.
sys.dont_write_bytecode = False

# Tests write scenes in temporary folders that name shipped files, and others; test_allowed_paths.py is of the rule itself.
os.environ["MAGMPM_ALLOW_OUTSIDE"] = os.sep
os.environ["XDG_CONFIG_HOME"] = tempfile.mkdtemp(
    prefix="magmpm-tests-"
)  # `magmpm import` keeps folders there

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from hypothesis import configuration, settings  # noqa: E402

import magmpm  # noqa: E402, F401  (its settings for Numba must be made before Numba is imported)

configuration.set_hypothesis_home_dir(Path(tempfile.gettempdir()) / "magmpm-hypothesis")
# derandomize: the same examples on every run; no deadline: the first example may wait for a compilation.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")


def pytest_sessionstart(session: pytest.Session) -> None:
    """In every test the kernels come from the disk cache, as in the second run of a user (magmpm.solving.precompile explains why).

    They run on one thread, unless a test sets more: workers share few cores, and threads that wait for each other took half as long again.
    """
    import numba

    from magmpm.scene import load_scene
    from magmpm.solving.precompile import prepare_kernels

    scenes = Path(__file__).parents[1] / "data/scenes"
    for path in ("hollow.yaml", "gallery/catheter_swing.yaml"):  # at rest and in motion
        prepare_kernels(load_scene(scenes / path))
    numba.set_num_threads(1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest tests come first, so that no worker is left alone with them at the end."""
    first = Path(__file__).parent / "validation"
    items.sort(key=lambda item: first not in item.path.parents)


def pytest_collection_finish(session: pytest.Session) -> None:
    """What is loaded by now stays to the end. Garbage is not sought in it over and over: that took an eighth of a study's time."""
    sys.dont_write_bytecode = bool(os.environ.get("PYTHONDONTWRITEBYTECODE"))
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


@pytest.fixture(autouse=True)
def _floating_errors_raise() -> Iterator[None]:
    """Division by zero, overflow and invalid operations are errors; underflow to zero is fine."""
    with np.errstate(divide="raise", over="raise", invalid="raise"):
        yield


@pytest.fixture(autouse=True)
def _seeded() -> None:
    """Seeds NumPy's old global generator, for code that draws from it."""
    np.random.seed(20240229)  # noqa: NPY002


@pytest.fixture
def rng() -> np.random.Generator:
    """A random generator with the same seed in every test."""
    return np.random.default_rng(20240229)


@pytest.fixture
def told(capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """told(*words, status=0, says=()): what the command with these words prints; its message has these phrases."""
    from magmpm.cli import main

    def command(*words: object, status: int = 0, says: str | tuple[str, ...] = ()) -> Any:
        capsys.readouterr()
        assert main([str(word) for word in words]) == status
        printed = capsys.readouterr()
        missing = [
            phrase
            for phrase in ((says,) if isinstance(says, str) else says)
            if phrase not in printed.err
        ]
        assert not missing, f"not said: {missing}\nin:\n{printed.err}"
        return printed

    return command
