"""Compiled P2G and G2P against plain NumPy (tests/reference/mpm_numpy.py): two materials, a cut cell, with and without F-bar."""

from itertools import pairwise

import numpy as np
import pytest
from reference.mpm_numpy import Reference
from reference.plain_forms import to_dense
from reference.scenes import rod_scene

from magmpm.model import build
from magmpm.statics.energy import Energy
from magmpm.statics.layout import StaticModel, static_model

# relative to the largest entry: sums of a few thousand terms of either sign, in another order
ROUNDING = 1e-12


def small_scene(**changes: object) -> StaticModel:
    """3 cells across, 4 along; the segments meet inside a cell."""
    given = {
        "length": 5.3e-3,
        "directions": [(1, 0, 0), (0.3, -0.5, 0.8)],
        "lengths": [2.3e-3, 3e-3],
        "shear": [120e3, 40e3],
        "cells": 3,
    }
    return static_model(
        build(
            rod_scene(
                **{**given, "field": (4e-3, -3e-3, 6e-3), "gravity": (1.0, -2.0, -9.81), **changes}
            )
        )
    )


CASES = {
    "f-bar": {},
    "none": {"anti_locking": "none"},
    "tube": {"inner_diameter": 3e-3, "cells": 2},
    "thick tube": {"inner_diameter": 0.6e-3, "cells": 3, "bulk_to_shear": 500},
    "three particles": {"particles": 3, "cells": 2},
    "nearly incompressible": {"bulk_to_shear": 500, "cells": 2},
    "compressible": {
        "bulk_to_shear": 4.5,
        "cells": 2,
    },  # below 5 G: F-bar leaves linear variations of J as they are
    "thin wall": {"inner_diameter": 3.8e-3, "cells": 3},  # cells with few particles, in rows
}


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Energy, Reference, np.ndarray]:
    """Kernels, reference, and coefficients that strain the body by tens of percent."""
    model = small_scene(**CASES[request.param])
    rng = np.random.default_rng(5)
    c = (
        0.08
        * min(model.grid.spacing[0], model.grid.spacing[2])
        * rng.standard_normal((model.layout.planes, model.layout.m))
    )
    return Energy(model), Reference.of(model), c


def test_gather(case: tuple[Energy, Reference, np.ndarray]) -> None:
    """u = sum N_a c_a, F = I + sum c_a (x) grad N_a."""
    energy, reference, c = case
    point = energy.at(c)
    u, F = reference.gather(c)
    np.testing.assert_allclose(point.displacement, u, rtol=0, atol=ROUNDING * np.abs(u).max())
    np.testing.assert_allclose(point.F, F @ reference.axes, rtol=0, atol=ROUNDING)
    assert np.abs(F - np.eye(3)).max() > 0.1, "the body is deformed enough for a wrong term to show"
    assert np.linalg.det(F).min() > 0.2, "and not torn"


def test_cell_energy(case: tuple[Energy, Reference, np.ndarray]) -> None:
    """Energy of the whole; smallest and largest det F."""
    energy, reference, c = case
    point = energy.at(c)
    parts, J = reference.energy_parts(c)
    assert point.energy == pytest.approx(parts.sum(), rel=ROUNDING)
    assert (point.min_det_F, point.max_det_F) == pytest.approx((J.min(), J.max()), rel=ROUNDING)


def test_scatter_residual(case: tuple[Energy, Reference, np.ndarray]) -> None:
    """dE/dc = sum V (P grad N - f N), from the residual kernel and from the tangent kernel."""
    energy, reference, c = case
    point = energy.at(c)
    expected = reference.residual(c)
    size = np.abs(expected).max()
    np.testing.assert_allclose(energy.residual(point), expected, rtol=0, atol=ROUNDING * size)
    np.testing.assert_allclose(energy.tangent(point)[0], expected, rtol=0, atol=ROUNDING * size)


def test_magnetization_that_rotates() -> None:
    """Energy and residual with R Br in place of F Br in one of two materials."""
    mixed = small_scene(law=["rotates", "stretches"], gravity=None)
    energy = Energy(mixed)
    reference = Reference.of(mixed)
    c = 0.08 * mixed.grid.spacing[0] * np.random.default_rng(5).standard_normal(energy.shape)
    point = energy.at(c)
    expected = reference.residual(c)
    assert point.energy == pytest.approx(reference.energy_parts(c)[0].sum(), rel=ROUNDING)
    np.testing.assert_allclose(
        energy.residual(point), expected, rtol=0, atol=ROUNDING * np.abs(expected).max()
    )


def test_scatter_tangent(case: tuple[Energy, Reference, np.ndarray]) -> None:
    """d^2E/dc^2, every entry, assembled densely."""
    energy, reference, c = case
    _, matrix = energy.tangent(energy.at(c))
    found = to_dense(matrix.panels, energy.model.layout.split)
    expected = reference.tangent(c)
    np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING * np.abs(expected).max())


def test_slabs_of_one_colour_share_no_node(case: tuple[Energy, Reference, np.ndarray]) -> None:
    """This allows threads to add without locks: slabs 2k and 2k + 2 write to different planes."""
    layout = case[0].model.layout
    touched = [
        set((layout.cell_plane[a:b, None] + np.arange(3)).ravel())
        for a, b in pairwise(layout.slab_first)
    ]
    for color in (touched[0::2], touched[1::2]):
        for one, two in pairwise(color):
            assert not one & two
    assert sum(b - a for a, b in pairwise(layout.slab_first)) == len(layout.cell_plane)


def test_crushed_cell_has_infinite_energy() -> None:
    """det F <= 0 anywhere: the energy is inf, so a line search rejects it; the state still gives det F."""
    model = small_scene(cells=2)
    energy = Energy(model)
    c = np.zeros(energy.shape)
    c[2, :] = 8e-3  # one plane moved past its neighbors
    point = energy.at(c)
    assert point.energy == np.inf
    assert point.min_det_F < 0
