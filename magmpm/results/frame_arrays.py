"""Quantities stored of a frame of a motion, for each particle, in single precision."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from magmpm import materials
from magmpm.compiled.arrays import Array, Mask
from magmpm.compiled.jit import compiled

QUANTITIES = {  # name of each array of the file: its components
    "displacement": 3,  # m
    "velocity": 3,  # m/s
    # Pa, row by row; not symmetric: its skew part is the magnetic torque per volume
    "cauchy_stress": 9,
    "von_mises": 1,  # Pa, of the symmetric part
    # T, F Br: remanence carried along with the material; R Br where it only rotates
    "magnetisation": 3,
    "det_F": 1,
}
Numbers = NDArray[np.float32]


class FrameArrays:
    """Arrays of one frame, filled anew for each frame.

    reference: (n, 3) m, of the undeformed body; remanence: (n, 3) T, its remanence; rotating: (n,), where that does not stretch, or None.
    """

    def __init__(self, reference: Array, remanence: Array, rotating: Mask | None = None) -> None:
        self.rotating = rotating
        self.reference = np.ascontiguousarray(reference)
        self.remanence = np.ascontiguousarray(remanence)
        n = len(reference)
        sizes = {"Points": 3, **QUANTITIES}
        self.arrays: dict[str, Numbers] = {
            name: np.empty((n, size) if size > 1 else n, dtype=np.float32)
            for name, size in sizes.items()
        }

    def of(self, x: Array, v: Array, F: Array, P: Array) -> Mapping[str, Numbers]:
        """Positions (m) as `Points`, and all quantities by name. x, v (n, 3): m, m/s; F, P (n, 3, 3): P Pa, first Piola-Kirchhoff."""
        points, *others = self.arrays.values()
        points[:] = x
        _fill(
            *map(np.ascontiguousarray, (x, v, F, P)), self.reference, self.remanence, tuple(others)
        )
        if self.rotating is not None and self.rotating.any():
            self.arrays["magnetisation"][:] = materials.magnetization(
                self.rotating, self.remanence, F
            )
        return self.arrays


@compiled
def _fill(x, v, F, P, reference, remanence, quantities):  # type: ignore[no-untyped-def]
    """Write the quantities (a tuple of their arrays, as in QUANTITIES) of particles."""
    displacement, velocity, stress, mises, magnetisation, det = quantities
    cauchy = np.empty((3, 3))
    for p in range(len(x)):
        J = materials.determinant(F[p])
        for i in range(3):
            displacement[p, i] = x[p, i] - reference[p, i]
            velocity[p, i] = v[p, i]
            magnetisation[p, i] = (
                F[p, i, 0] * remanence[p, 0]
                + F[p, i, 1] * remanence[p, 1]
                + F[p, i, 2] * remanence[p, 2]
            )
            for j in range(3):
                cauchy[i, j] = (
                    P[p, i, 0] * F[p, j, 0] + P[p, i, 1] * F[p, j, 1] + P[p, i, 2] * F[p, j, 2]
                ) / J
                stress[p, 3 * i + j] = cauchy[i, j]
        mises[p] = von_mises(cauchy)
        det[p] = J


@compiled
def von_mises(cauchy):  # type: ignore[no-untyped-def]
    """Von Mises stress (Pa) of the symmetric part of a stress (3, 3): sqrt(3/2 s:s), s its deviator."""
    mean = (cauchy[0, 0] + cauchy[1, 1] + cauchy[2, 2]) / 3
    total = 0.0
    for i in range(3):
        total += (cauchy[i, i] - mean) ** 2
    for i, j in ((0, 1), (0, 2), (1, 2)):
        total += 0.5 * (cauchy[i, j] + cauchy[j, i]) ** 2
    return np.sqrt(1.5 * total)
