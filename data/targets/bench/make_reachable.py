"""The twelve reachable targets of `make bench-design`: equilibria of random designs by 3D finite elements, never by the package's solver.

    pip install -e .[fem]
    python data/targets/bench/make_reachable.py [NUMBER ...]     # some minutes a target; without a number: 1 to 12

Body, material and field are those of data/scenes/five_segments.yaml. Directions come from NumPy's default generator, seeded with
[SEED, number]. Of numbers 1 to 6, each segment's direction is uniform on the sphere, so bends largely cancel; of numbers 7 to 12, it is the
one before plus 0.7 times a normal vector, made a unit vector again, so bends add up.

`data/references/make_fem.py` has the method: the branch of the straight rod, up to order 4. A design whose branch becomes unstable before
full field is replaced by the next draw of its generator, and the comment of the file says how many were. Everything here was fixed before
any study ran on these targets.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "references"))

import make_fem as fem  # noqa: E402 (its folder is no package)

SEED = 9
COUNT = 12
SPREAD = 0.7
LENGTH, DIAMETER, REMANENCE, FIELD = 40e-3, 4e-3, 0.138, (0.0, 6e-3, 8e-3)
MESH_SIZE = (
    0.32  # of the diameter: the coarser mesh of make_fem.py, within 0.003 mm of the finer one
)
STATIONS = np.append(
    np.arange(1, 20) * 2e-3, 39.8e-3
)  # m; the face of the tip itself is not inside the mesh


def directions(rng: np.random.Generator, alike: bool) -> np.ndarray:
    """Five unit vectors (5, 3); alike: each is near the one before."""
    drawn = rng.normal(size=(5, 3))
    for k in range(5):
        if alike and k > 0:
            drawn[k] = drawn[k - 1] + SPREAD * drawn[k]
        drawn[k] /= np.linalg.norm(drawn[k])
    return drawn


def make(number: int) -> None:
    """Write reachable_NN.csv."""
    rng = np.random.default_rng([SEED, number])
    refused, found = 0, None
    while found is None:
        design = directions(rng, number > COUNT // 2)
        segments = fem.equal_segments(LENGTH, REMANENCE, *(tuple(map(float, d)) for d in design))
        try:
            found, _, _ = fem.solve(
                fem.Case(segments, DIAMETER, FIELD, ramp_order=3), MESH_SIZE * DIAMETER
            )
        except RuntimeError as error:
            refused += 1
            print(f"reachable_{number:02d}: {error}", flush=True)
    rows = np.vstack([np.zeros(4), np.column_stack([STATIONS, found.centreline(STATIONS)])])
    magnets = " ".join(f"({a:.9f} {b:.9f} {c:.9f})" for a, b, c in design)
    lines = [
        f"# reachable {number}: 3D finite elements of order 4 (make_reachable.py); {refused} designs before it had no stable branch",
        f"# directions of the segments, base to tip: {magnets}",
        "s_mm,x_mm,y_mm,z_mm",
        *(",".join(f"{1e3 * value + 0.0:.6f}" for value in row) for row in rows),
    ]
    (HERE / f"reachable_{number:02d}.csv").write_text("\n".join(lines) + "\n")
    print(lines[0], flush=True)


if __name__ == "__main__":
    fem.ngs.SetNumThreads(1)
    for chosen in [int(word) for word in sys.argv[1:]] or range(1, COUNT + 1):
        make(chosen)
