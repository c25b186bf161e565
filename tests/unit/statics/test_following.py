"""Equilibria of neighbors, each found from what the last ones left: they are those that are found alone."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from magmpm import load_scene, run
from magmpm.rod.cosserat import RodShape
from magmpm.scene import Scene
from magmpm.simulate import simulated
from magmpm.statics.equilibrium import Following

SCENE = Path(__file__).resolve().parents[3] / "data" / "scenes" / "axial_transverse.yaml"
FIELDS = ([0.0, 0.0, 2e-3], [0.0, 1e-3, 3e-3], [1e-3, 2e-3, 4e-3], [-2e-3, 2e-3, 4e-3])


def stiffer(scene: Scene) -> Scene:
    """Another body."""
    data = scene.to_si()
    data["materials"]["magnetic silicone"]["shear_modulus"] *= 1.5
    return Scene.from_si(data)


def turned(scene: Scene) -> Scene:
    """The same body, magnetized in another direction."""
    data = scene.to_si()
    data["body"]["catheter"]["segments"][0]["magnetization"] = [0.6, 0.8, 0.0]
    return Scene.from_si(data)


@pytest.mark.parametrize("change", [stiffer, turned])
def test_they_are_those_found_alone(change: Callable[[Scene], Scene]) -> None:
    """Tips agree to 1e-6 L, as solves from different starts do, and stabilities to 1e-4, also after the body or its magnets were changed
    between two of them. Nothing that was left may count: not its stiffness, its remanence nor its soft modes."""
    scene, last = load_scene(SCENE).with_cells(2), [np.zeros((0, 0))]
    following = Following(lambda rod: last[-1])
    for k, field in enumerate(FIELDS):
        here = (scene if k < 2 else change(scene)).with_field(field)
        found, alone = simulated(here, start=following), run(here)
        last.append(found.grid_correction)
        np.testing.assert_allclose(found.tip, alone.tip, atol=1e-6 * scene.length)
        assert abs(found.stability - alone.stability) < 1e-4


def test_a_wrong_expectation_does_no_harm() -> None:
    """The solve begins at its rod if neighbors are nonsense, or of another grid."""
    scene = load_scene(SCENE).with_cells(2).with_field(FIELDS[2])
    alone = run(scene)
    shape = alone.grid_correction.shape

    def nonsense(rod: RodShape) -> np.ndarray:
        return np.asarray(1e-3 * np.random.default_rng(1).normal(size=shape))

    for expected in (nonsense, lambda rod: np.ones((2, 2)), lambda rod: None):
        found = simulated(scene, start=Following(expected))
        np.testing.assert_allclose(found.tip, alone.tip, atol=1e-6 * scene.length)


def test_blas_has_one_thread_in_a_fresh_process() -> None:
    """SciPy's library too, which is loaded at the first solve: with a thread for each core in each half of a factorization, moves of a
    slider took twice the time."""
    code = (
        "import sys\nfrom magmpm.statics.equilibrium import one_blas_thread\nfrom threadpoolctl import threadpool_info\n"
        "with one_blas_thread():\n    assert 'scipy.linalg.cython_lapack' in sys.modules\n"
        "    print([one['num_threads'] for one in threadpool_info() if one['user_api'] == 'blas'])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(json.loads(found.stdout)) == {1}
