"""What an effect does to a scene, by pairs of runs on the coarsest grid; an effect that is muted has no effect."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from reference.scenes import rod_scene

from magmpm import Scene
from magmpm.compare import influence, muted
from magmpm.compiled.arrays import Array
from magmpm.effects.acting import Effects
from magmpm.errors import InputError
from magmpm.solve import solve

LENGTH = 24e-3
PLAIN = rod_scene(length=LENGTH, field=[0.0, 0.0, 5e-3]).with_cells(2)


def tips(result_of: Scene, key: str) -> tuple[Array, Array]:
    """Tips (3,) m of a scene without an effect: left out, and muted."""
    whole = result_of.effects
    silent = result_of.model_copy(update={"effects": whole.model_copy(update={key: muted(getattr(whole, key))})})
    return solve(result_of.with_effects(**{key: None})).tip, solve(silent).tip


def test_a_muted_load_is_one_that_is_left_out() -> None:
    """1e-9 of the length: both are the same equilibrium, which solves know to 1e-6 at least, on the same way to it."""
    without, silent = tips(PLAIN.with_effects(gravity={}), "gravity")
    np.testing.assert_allclose(silent, without, atol=1e-9 * LENGTH)


@pytest.mark.parametrize("key", ["damping", "viscosity", "ground", "walls", "gravity", "magnetic_torque"])
def test_muted_effects_keep_their_kernels(key: str) -> None:
    """The same kinds of records, so that no kernel is compiled for them: numbers in them are tiny."""
    field: Any = Effects.model_fields[key]
    scene = Scene.from_si(PLAIN.to_si() | {"solver": {"dynamic": {"duration": 1e-3}}}).with_effects(**{key: field.examples[0]})
    effect = getattr(scene.effects, key)
    loud, silent = effect.records(scene, 1.0, np.zeros(1)), muted(effect).records(scene, 1.0, np.zeros(1))
    assert [part.dtype for part in loud] == [part.dtype for part in silent]
    name = {"damping": "damping_rate", "magnetic_torque": "field_over_mu0", "gravity": "gravity"}.get(key)
    name = name or next(one for one in silent[0].dtype.names if "stiffness" in one or "viscosity" in one)
    assert 0.0 < np.abs(silent[0][name]).max() < 1e-20 * np.abs(loud[0][name]).max()


def test_influence_is_the_distance_of_two_runs() -> None:
    """The weight of the short catheter, named by nobody."""
    (found,) = influence(PLAIN, "gravity")
    assert found.shift is not None
    both = [solve(scene).tip for scene in (PLAIN.with_effects(gravity={}), PLAIN)]
    assert found.shift == pytest.approx(float(np.linalg.norm(both[0] - both[1])), rel=1e-3)  # the end of the axis, not of the end face
    assert found.advice == ("add" if found.shift > 0.01 * LENGTH else "irrelevant")
    assert found.uncertainty is not None
    assert found.uncertainty < 0.1 * found.shift  # 2 cells against 3
    assert influence(PLAIN, "damping")[0].why == "it acts in motion only"
    with pytest.raises(InputError, match="must be one of"):
        influence(PLAIN, "glue")
