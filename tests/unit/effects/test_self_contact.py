"""Pairs of near particles that are not neighbors: compared with a loop over all pairs."""

from __future__ import annotations

import numpy as np
import pytest

from magmpm.effects import self_contact


@pytest.mark.parametrize("seed", range(4))
def test_near_pairs_are_those_of_all_pairs(seed: int) -> None:
    """Particles of random cells, parts and components, displaced by more than a cell: the selection by cells loses no pair."""
    rng = np.random.default_rng(seed)
    n = 400
    cell = rng.integers(-3, 5, (n, 3))
    rest = cell + rng.random((n, 3))
    x = rest * [0.6, 1.0, 0.5] + 0.4 * rng.standard_normal((n, 3))
    part = (cell[:, 0] > 0).astype(int) + 2 * (cell[:, 1] > 2)
    component = (part >= 2).astype(np.int64)
    within, apart, in_part = 1.1, 2.3, 3.1
    i, j = self_contact._near(x, rest, cell, component, part, within=within, apart=apart, in_part=in_part)
    a, b = np.triu_indices(n, 1)
    far = np.linalg.norm(rest[a] - rest[b], axis=1) > np.where(part[a] == part[b], in_part, apart)
    wanted = (np.linalg.norm(x[a] - x[b], axis=1) <= within) & (far | (component[a] != component[b]))
    found = {tuple(pair) for pair in np.sort(np.column_stack([i, j]), axis=1).tolist()}
    assert found == set(zip(a[wanted].tolist(), b[wanted].tolist()))
    assert len(i) == len(found) > 100
