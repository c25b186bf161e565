"""Buckling: a catheter against the field stays straight, until it does not.

The catheter is magnetized from tip to base, and the field points from base to tip and grows slowly; each equilibrium is found from
the one before. At a critical field the straight shape becomes unstable and the catheter bends over: theory has Euler's load of a
column under its own compass torque, A Br B/mu0 = pi^2 EI/(4 L^2). A quarter of a minute.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.constants import mu_0

import magmpm

LENGTH, DIAMETER, SHEAR, REMANENCE = 40e-3, 2e-3, 120e3, 0.138  # SI


def critical_field():
    """Of the slender rod, T."""
    young = 9 * 20 * SHEAR / (3 * 20 + 1)  # E = 9 K G/(3 K + G) with K = 20 G
    return mu_0 * np.pi**2 * young * DIAMETER**2 / (64 * REMANENCE * LENGTH**2)  # I/A = D^2/16


def main(folder="runs/buckling", largest=2e-3, steps=20, cells=2):
    silicone = magmpm.Material(shear_modulus=SHEAR, bulk_to_shear=20, remanence=REMANENCE)
    body = magmpm.Catheter(
        length=LENGTH,
        diameter=DIAMETER,
        material="silicone",
        segments=[magmpm.Segment(magnetization=[-1, 0, 0])],
    )
    scene = magmpm.Scene(
        name="buckling",
        materials={"silicone": silicone},
        body=body,
        field={"uniform": [largest, 0, 0], "over_time": {"ramp": {"duration": "1 s"}}},
        effects=[magmpm.MagneticTorque()],
        solver=magmpm.QuasiStatic(steps=steps),
        resolution={"cells_across": cells},
        advice="off",  # the weight is left out
    )
    magmpm.run(scene, folder=folder)
    return magmpm.Motion.load(folder)


if __name__ == "__main__":
    motion = main()
    print(f"buckles at {1e3 * motion.jumps[0]['field']:.3f} mT")
    fields = 1e3 * motion.fields[:, 0]
    figure, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
    axes.plot(fields, 1e3 * np.hypot(motion.steps["tip_y"], motion.steps["tip_z"]), "o", mfc="w")
    axes.axvline(1e3 * critical_field(), color="gray", ls="--", label="Euler's load")
    axes.set(xlabel="field against the catheter (mT)", ylabel="deflection of the tip (mm)", xlim=0)
    axes.legend(frameon=False)
    figure.savefig("buckling.png", dpi=200)
