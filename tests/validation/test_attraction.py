"""Free magnetized parts attract each other: against the charges on the faces of two cubes, and until they touch."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from reference.moving import DENSITY
from reference.parts import momenta, of_part, parts_scene
from reference.scenes import BR
from reference.solids import box

from magmpm.dynamics.time_loop import move
from magmpm.model import build
from magmpm.scene import Scene

EDGE, CELL, MU0 = 2e-3, 1e-3, 4e-7 * np.pi


def cubes(folder: Path, apart: float, effects: dict[str, Any], duration: float) -> Scene:
    """Two free cubes, magnetized along the line through their centers, which are so far apart (m)."""
    meshes = {"a": box((0.0, 0.0, 0.0), (EDGE, EDGE, EDGE)), "b": box((apart, 0.0, 0.0), (apart + EDGE, EDGE, EDGE))}
    data = parts_scene(folder, meshes, {"magnetic_interaction": {}, **effects}, CELL, duration=duration).to_si()
    for part in data["body"]["parts"]["meshes"]:
        part["magnetization"] = [1.0, 0.0, 0.0]
    return Scene.from_si(data)


def pull(apart: float, points: int = 12) -> float:
    """Force (N) between the cubes: their faces have the charges +-Br / mu0 (Jackson, section 5.9), here by Gauss's rule."""
    at, weight = np.polynomial.legendre.leggauss(points)
    at, weight = (at + 1) * EDGE / 2, weight * EDGE / 2
    y, z, other_y, other_z = np.meshgrid(at, at, at, at, indexing="ij")
    total = 0.0
    for own in (0.0, EDGE):
        for other in (apart, apart + EDGE):
            r = np.sqrt((own - other) ** 2 + (y - other_y) ** 2 + (z - other_z) ** 2)
            total += (1 if (own > 0) == (other > apart) else -1) * np.einsum("abcd,a,b,c,d", (own - other) / r**3, *[weight] * 4)
    return float(total * BR**2 / (4 * np.pi * MU0))


@pytest.mark.slow
@pytest.mark.parametrize(("apart", "share"), [(8e-3, 0.002), (4e-3, 0.01), (3e-3, 0.03)])
def test_cubes_attract_as_the_charges_on_their_faces(tmp_path: Path, apart: float, share: float) -> None:
    """Blocks stand for 2 x 2 x 2 parts of a cube: the nearer, the less exact. Momentum is kept to rounding."""
    time = 2e-4
    state = move(build(cubes(tmp_path, apart, {}, time)))
    model = state.motion.model
    way = of_part(model, 0, state.x - model.particles.position)[0]
    assert DENSITY * EDGE**3 * 2 * way / time**2 == pytest.approx(pull(apart), rel=share)
    assert np.abs(momenta(state.motion)[:3]).max() < 1e-12 * DENSITY * EDGE**3 * np.abs(state.v).max()


@pytest.mark.slow
def test_cubes_that_meet_stay_together(tmp_path: Path) -> None:
    """With damping the sum of all energies only falls, and at rest they press each other."""
    rows: list[float] = []
    effects = {"self_contact": {}, "damping": {"rate": 400.0}}
    state = move(build(cubes(tmp_path, 3e-3, effects, 0.03)), on_state=lambda now: rows.append(sum(now.energies.values())))
    assert np.diff(rows).max() < 1e-3 * (rows[0] - rows[-1])
    touching = state.contacts["self_contact: a, b"]
    assert touching["force"][0] < -0.9 * pull(2.4e-3, 20)
    assert state.contacts["self_contact"]["depth"] < 0.1 * CELL
