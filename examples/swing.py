"""A motion: a catheter rings when a weak field is turned on.

The field is turned on at once and lifts the tip, which swings about its new place and comes to rest there. Its frequency is that
of a cantilever, 3.516/(2 pi L^2) sqrt(E I/(rho A)), and its amplitude falls as exp(-rate t/2). A few seconds.
"""

import matplotlib.pyplot as plt
import numpy as np

import magmpm

LENGTH, DIAMETER, SHEAR, DENSITY, RATE = 30e-3, 2e-3, 120e3, 1882.0, 4.0  # SI


def frequency():
    """Of the first bending mode by Euler and Bernoulli, Hz."""
    young = 9 * 20 * SHEAR / (3 * 20 + 1)  # E = 9 K G/(3 K + G) with K = 20 G
    return 3.516 / (2 * np.pi * LENGTH**2) * np.sqrt(young * DIAMETER**2 / (16 * DENSITY))


def main(folder="runs/swing", duration=0.6, cells=2):
    silicone = magmpm.Material(
        shear_modulus=SHEAR, bulk_to_shear=20, density=DENSITY, remanence=0.1
    )
    body = magmpm.Catheter(
        length=LENGTH,
        diameter=DIAMETER,
        material="silicone",
        segments=[magmpm.Segment(magnetization=[1, 0, 0])],
    )
    scene = magmpm.Scene(
        name="swing",
        materials={"silicone": silicone},
        body=body,
        field=magmpm.UniformField(uniform=["0 mT", "0 mT", "0.05 mT"]),
        effects=[magmpm.MagneticTorque(), magmpm.Damping(rate=RATE)],
        solver=magmpm.Dynamic(duration=duration, output_every="4 ms"),
        resolution={"cells_across": cells},
        advice="off",  # the weight is left out, as in the formula
    )
    magmpm.run(scene, folder=folder)
    motion = magmpm.Motion.load(folder)
    tip = motion.reference[:, 0] > LENGTH - DIAMETER / 2
    height = [motion.position(k)[tip, 2].mean() for k in range(len(motion))]
    return motion.times, np.array(height), motion.energies


if __name__ == "__main__":
    times, height, energies = main()
    figure, (above, below) = plt.subplots(2, 1, figsize=(5, 5), sharex=True, layout="constrained")
    above.plot(1e3 * times, 1e3 * height)
    above.set(ylabel="height of the tip (mm)")
    for name in ("kinetic", "elastic"):
        below.plot(1e3 * energies["t"], 1e9 * energies[name], label=name)
    below.set(xlabel="time (ms)", ylabel="energy (nJ)", xlim=(0, 1e3 * times[-1]))
    below.legend(frameon=False)
    figure.savefig("swing.png", dpi=200)
