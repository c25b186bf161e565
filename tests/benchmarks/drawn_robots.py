"""Equilibria of robots of parts drawn at random: do they converge, and to the shape that a slowly growing load leads to?

A robot is a held cube with two to four arms of one to three boxes each, straight on or around a corner, turned as a whole in space.
Parts are magnetized in any direction; a field and weight act.
`python tests/benchmarks/drawn_robots.py --robots 40` prints a line each, and JSON.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from magmpm.errors import SolveError
from magmpm.model import build
from magmpm.scene import Scene, load_scene
from magmpm.statics.equilibrium import Equilibrium, solve_static
from magmpm.statics.layout import static_model

HUB = 6.0  # mm
SLOW = 32  # load steps of the slow path
SAME = 0.01  # of the body's size: farther apart, two shapes are not the same
FACES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def box_stl(low: np.ndarray, high: np.ndarray, turn: np.ndarray, path: Path) -> None:
    """Write a box between two corners (3,) mm, turned about the origin, as an STL file."""
    corners = (
        np.array(
            [
                [x, y, z]
                for x in (low[0], high[0])
                for y in (low[1], high[1])
                for z in (low[2], high[2])
            ]
        )
        @ turn.T
    )
    lines = ["solid box"]
    for a, b, c, d in FACES:
        for triangle in ((a, b, c), (a, c, d)):
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += ["vertex {:.9g} {:.9g} {:.9g}".format(*corners[k]) for k in triangle]
            lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid box", ""]))


def boxes(rng: np.random.Generator) -> list[tuple[np.ndarray, np.ndarray]]:
    """Corners of a robot's boxes, mm, the hub first; none overlaps another."""
    made = [(np.full(3, -HUB / 2), np.full(3, HUB / 2))]
    directions = [(axis, sign) for axis in range(3) for sign in (1.0, -1.0)]
    for arm in rng.permutation(6)[: rng.integers(2, 5)]:
        axis, sign = directions[arm]
        center = np.zeros(3)
        center[axis] = sign * HUB / 2
        for _ in range(rng.integers(1, 4)):
            length = rng.uniform(4, 8)
            wide = rng.uniform(2.5, 4)
            thin = rng.uniform(1.2, 2)
            across = [other for other in range(3) if other != axis]
            low = center.copy()
            high = center.copy()
            ends = sorted((center[axis], center[axis] + sign * length))
            low[axis], high[axis] = ends
            low[across] -= np.array([wide, thin]) / 2
            high[across] += np.array([wide, thin]) / 2
            if any(
                np.all(low < other[1] - 1e-9) and np.all(high > other[0] + 1e-9) for other in made
            ):
                break
            made.append((low, high))
            center[axis] += sign * length
            if (
                rng.random() < 0.3
            ):  # around a corner: the next box stands on a side of this one, near its end
                center[axis] -= sign * thin / 2
                side = across[1]
                turn = rng.choice([-1.0, 1.0])
                center[side] = high[side] if turn > 0 else low[side]
                axis = side
                sign = float(turn)
    return made


def draw(seed: int, folder: Path) -> Scene:
    """The scene of a robot."""
    rng = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix() if seed % 4 else np.eye(3)
    meshes = []
    for k, (low, high) in enumerate(boxes(rng)):
        box_stl(low, high, turn, folder / f"part{k}.stl")
        magnet = rng.standard_normal(3)
        about = (
            {"clamp": True}
            if k == 0
            else {"magnetization": (magnet / np.linalg.norm(magnet)).tolist()}
        )
        meshes.append({"mesh": f"part{k}.stl", "material": "silicone", **about})
    field = rng.standard_normal(3)
    field *= rng.uniform(1, 8) / np.linalg.norm(field)
    scene = {
        "name": f"robot {seed}",
        "materials": {
            "silicone": {
                "shear_modulus": f"{rng.uniform(60, 300):.4g} kPa",
                "bulk_to_shear": 20,
                "density": "1882 kg/m^3",
                "remanence": "100 mT",
            },
        },
        "body": {"parts": {"unit": "mm", "meshes": meshes}},
        "field": {"uniform": [f"{value:.6g} mT" for value in field]},
        "effects": {"magnetic_torque": {}, "gravity": {}},
        "resolution": {"cells_across": 2},
    }
    (folder / "scene.yaml").write_text(json.dumps(scene))
    return load_scene(folder / "scene.yaml")


def with_load_steps(scene: Scene, steps: int) -> Scene:
    """The scene with its load in so many steps."""
    return Scene.from_si({**scene.to_si(), "solver": {"static": {"field_steps": steps}}})


def solved(scene: Scene) -> tuple[Equilibrium | None, float]:
    """The equilibrium of a scene, or None, and the seconds it took."""
    begun = time.perf_counter()
    try:
        return solve_static(static_model(build(scene))), time.perf_counter() - begun
    except SolveError as error:
        print("   ", error)
        return None, time.perf_counter() - begun


def judge(seed: int, slow: bool) -> dict[str, object]:
    """One robot: Newton steps, seconds, and how far it is from the end of a slow path, over its size."""
    with tempfile.TemporaryDirectory() as folder:
        scene = draw(seed, Path(folder))
        found, seconds = solved(scene)
        row: dict[str, object] = {
            "seed": seed,
            "parts": len(scene.regions()),
            "converged": found is not None,
            "seconds": round(seconds, 2),
        }
        if found is None:
            return row
        size = float(np.ptp(found.point.position, axis=0).max())
        moved = float(np.linalg.norm(found.point.displacement, axis=1).max()) / size
        row |= {
            "steps": found.steps,
            "moved": round(moved, 4),
            "stability": round(found.stability or 0.0, 4),
        }
        path = solved(with_load_steps(scene, SLOW))[0] if slow else None
        if path is not None:
            away = (
                float(
                    np.linalg.norm(path.point.displacement - found.point.displacement, axis=1).max()
                )
                / size
            )
            row |= {"path_steps": path.steps, "away": round(away, 5), "same": away < SAME}
        return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--first", type=int, default=1, help="seed of the first")
    parser.add_argument("--quick", action="store_true", help="without the slow paths")
    given = parser.parse_args()
    rows = []
    for seed in range(given.first, given.first + given.robots):
        rows.append(judge(seed, not given.quick))
        print(rows[-1], flush=True)
    print(
        json.dumps(
            {
                "robots": len(rows),
                "converged": sum(bool(row["converged"]) for row in rows),
                "same": sum(bool(row.get("same")) for row in rows),
            }
        )
    )


if __name__ == "__main__":
    main()
