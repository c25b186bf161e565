"""Starts of a solve from its neighbors: interpolation, exact for answers linear in the rod's curvature."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from magmpm.studies.explore.neighbors import Neighbors

RNG = np.random.default_rng(3)
MAP = RNG.normal(size=(6, 4, 6))  # from six numbers of a rod to what is added (4 planes, 6 coefficients)


def rod(numbers: np.ndarray) -> Any:
    """A rod of length 2 whose curvature is linear along it, by six numbers."""
    s = np.linspace(0.0, 2.0, 61)
    return SimpleNamespace(s=s, curvature=np.stack([s**0, s - 1.0], axis=1) @ numbers.reshape(2, 3) / 3)


def added(numbers: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("k,kpm->pm", numbers, MAP))


def taught(count: int, most: int | None = None) -> Neighbors:
    neighbors = Neighbors(most)
    for numbers in np.random.default_rng(5).normal(size=(count, 6)):
        neighbors.expected(rod(numbers))
        neighbors.learn(added(numbers))
    return neighbors


def test_nothing_is_expected_before_something_is_known() -> None:
    neighbors = Neighbors()
    assert neighbors.expected(rod(np.ones(6))) is None
    neighbors.learn(np.zeros((4, 6)))  # of a solve that did not begin at its rod
    assert neighbors.expected(rod(np.ones(6))) is None


def test_what_is_known_is_expected_again() -> None:
    """To the nugget, 1e-8 of the variance, times what the inverse of the covariance makes of it."""
    first = np.random.default_rng(5).normal(size=(12, 6))[4]
    np.testing.assert_allclose(taught(12).expected(rod(first)), added(first), atol=1e-5 * np.abs(MAP).max())


@pytest.mark.parametrize("far", [0.5, 0.25])
def test_what_is_linear_is_found(far: float) -> None:
    """Forty solves tell six numbers: a new one is expected with less than a quarter of the error of the nearest known one."""
    known, new = np.random.default_rng(5).normal(size=(40, 6)), far * np.random.default_rng(6).normal(size=6)
    nearest = known[np.argmin(np.linalg.norm(known - new, axis=1))]
    found = taught(40).expected(rod(new))
    assert found is not None
    assert np.linalg.norm(found - added(new)) < 0.25 * np.linalg.norm(added(nearest) - added(new))


def test_another_grid_begins_anew_and_the_oldest_are_forgotten() -> None:
    neighbors = taught(12, most=5)
    first = np.random.default_rng(5).normal(size=(12, 6))[0]
    forgotten = neighbors.expected(rod(first))
    assert forgotten is not None
    assert np.abs(forgotten - added(first)).max() > 1e-3
    neighbors.learn(np.ones((3, 3)))
    again = neighbors.expected(rod(first))
    assert again is not None
    assert again.shape == (3, 3)
