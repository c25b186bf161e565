"""A swimmer: a sheet in a liquid that a turning field sends a wave along.

The magnetization turns once along the sheet, so in a field that turns, a wave runs from one end to the other and pushes the liquid
back. Turn the field the other way and everything happens in the mirror: the sheet swims as far to the other side, which the
two curves show. Ten seconds.
"""

import matplotlib.pyplot as plt
import numpy as np

import magmpm


def main(folder="runs/swimmer", frequency="25 Hz", duration=0.4):
    silicone = magmpm.Material(
        shear_modulus="30 kPa", bulk_to_shear=10, density="1150 kg/m^3", remanence="60 mT"
    )
    sheet = magmpm.Strip(
        length="16 mm",
        width="8 mm",
        thickness="0.8 mm",
        plane_strain=True,
        clamp="none",
        material="silicone",
        magnetization_profile={"harmonic": {"periods": 1}},
    )
    scene = magmpm.Scene(
        name="swimmer",
        materials={"silicone": silicone},
        body=sheet,
        field={
            "uniform": ["5 mT", 0, 0],
            "over_time": {"rotation": {"axis": [0, 1, 0], "frequency": frequency}},
        },
        effects=[
            magmpm.MagneticTorque(),
            magmpm.Gravity(),
            magmpm.Viscosity(loss_factor=0.1),
            magmpm.Fluid(density="1150 kg/m^3", viscosity="10 mPa s"),
        ],
        solver=magmpm.Dynamic(duration=duration, output_every="4 ms"),
        resolution={"cells_across": 2},
    )
    magmpm.run(scene, folder=folder)
    motion = magmpm.Motion.load(folder)
    way = [np.average(motion.position(k)[:, 0], weights=motion.volume) for k in range(len(motion))]
    return motion, np.array(way) - way[0]


if __name__ == "__main__":
    motion, way = main()
    _, back = main("runs/swimmer_back", frequency="-25 Hz")
    motion.render("swimmer_moments.png")
    figure, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
    axes.plot(motion.times, 1e3 * way, label="field turns at 25 Hz")
    axes.plot(motion.times, 1e3 * back, label="field turns the other way")
    axes.axhline(0, color="gray", lw=0.8)
    axes.set(
        xlabel="time (s)", ylabel="displacement of the center (mm)", xlim=(0, motion.times[-1])
    )
    axes.legend(frameon=False)
    figure.savefig("swimmer.png", dpi=200)
