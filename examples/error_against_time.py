"""Error against time: what accuracy costs.

The same catheter is computed on coarser and finer grids. Its error, the distance of the axis from a converged finite-element
solution, falls faster than the cells shrink, while the CPU time of a run grows. `magmpm.error` bounds the error from runs alone,
without that solution, and must not be below it by more than finite elements err, 2 um. Half a minute.
"""

import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.interpolate import CubicSpline

import magmpm

REFERENCE = Path(__file__).parents[1] / "data" / "references" / "axial_transverse_5mT.csv"


def distance(result, reference):
    """Largest distance of the axis from the reference's (rows [s, x, y, z], m), m."""
    axis = CubicSpline(result.centreline[:, 0], result.centreline[:, 1:])
    return np.linalg.norm(axis(reference[:, 0]) - reference[:, 1:], axis=1).max()


def main(folder=None, cells=(3, 4, 5, 6)):
    silicone = magmpm.Material(shear_modulus="120 kPa", bulk_to_shear=20, remanence="100 mT")
    axial = magmpm.Segment(magnetization=[1, 0, 0])
    scene = magmpm.Scene(
        name="axial catheter across a field",
        materials={"silicone": silicone},
        body=magmpm.Catheter(
            length="40 mm", diameter="4 mm", material="silicone", segments=[axial]
        ),
        field=magmpm.UniformField(uniform=["0 mT", "0 mT", "5 mT"]),
        effects=[magmpm.MagneticTorque()],
        advice="off",  # the weight is left out, as in the finite elements
    )
    reference = 1e-3 * np.loadtxt(REFERENCE, delimiter=",", skiprows=2)
    rows = []
    for count in cells:
        finer = scene.with_cells(count)
        magmpm.run(finer)  # so that compiled kernels are there
        begun = time.process_time()
        result = magmpm.run(finer)
        seconds = time.process_time() - begun
        rows.append((count, seconds, distance(result, reference), magmpm.error(finer).error))
    return np.array(rows)


if __name__ == "__main__":
    _, seconds, errors, bounds = main().T
    figure, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
    axes.loglog(seconds, 1e6 * errors, "o-", label="error")
    axes.loglog(seconds, 1e6 * bounds, "v--", label="bound by magmpm.error")
    axes.set(xlabel="CPU time of a run (s)", ylabel="distance from finite elements (um)")
    axes.set_xticks([0.1, 0.2, 0.5, 1, 2], [0.1, 0.2, 0.5, 1, 2])
    axes.set_yticks([1, 2, 5, 10, 20], [1, 2, 5, 10, 20])
    axes.minorticks_off()
    axes.legend(frameon=False)
    figure.savefig("error_against_time.png", dpi=200)
