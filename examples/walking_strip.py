"""A walking strip: a sheet a millimeter wide that inches along the ground.

The magnetization turns once along the sheet. A field that tilts as it grows arches the sheet, and is then turned off at once: the
rear foot is drawn up while the front one holds, and the front one slides ahead as the sheet falls flat. All of that is
friction: on ice the same field leaves the center of mass where it is, since a uniform field pulls nothing. Ten seconds.
"""

import numpy as np

import magmpm

CYCLE = 0.1  # s


def field(cycles):
    """Keyframes of the uniform field, mT: it grows and tilts, and drops to zero."""
    steps = (0.0, [0, 0, 0]), (0.5, [-4.62, 0, -1.91]), (0.99, [-7.07, 0, -7.07])
    frames = [
        {"time": CYCLE * (k + share) + 1e-6 * (share == 0), "uniform": 1e-3 * np.array(uniform)}
        for k in range(cycles)
        for share, uniform in steps
    ]
    end = {"time": CYCLE * cycles + 1e-6, "uniform": [0.0, 0.0, 0.0]}
    return {"over_time": {"keyframes": [*frames, end]}}


def main(folder="runs/walking_strip", friction=0.5, cycles=3):
    silicone = magmpm.Material(
        shear_modulus="28.2 kPa", bulk_to_shear=20, density="1860 kg/m^3", remanence="78 mT"
    )
    sheet = magmpm.Strip(
        length="4.5 mm",
        width="0.9 mm",
        thickness="0.3 mm",
        position=["0 mm", "0 mm", "0.15 mm"],
        clamp="none",
        material="silicone",
        magnetization_profile={"harmonic": {"periods": 1.125, "phase": "22.5 deg"}},
    )
    scene = magmpm.Scene(
        name="walking strip",
        materials={"silicone": silicone},
        body=sheet,
        field=field(cycles),
        effects=[
            magmpm.MagneticTorque(),
            magmpm.Gravity(),
            magmpm.Damping(rate="180 1/s"),
            magmpm.Viscosity(loss_factor=0.1),
            magmpm.Ground(point=[0, 0, 0], friction=friction),
        ],
        solver=magmpm.Dynamic(duration=CYCLE * cycles + 0.05, output_every="5 ms"),
        resolution={"cells_across": 2},
    )
    magmpm.run(scene, folder=folder)
    motion = magmpm.Motion.load(folder)
    way = [motion.position(k)[:, 0] @ motion.volume for k in range(len(motion))]
    return motion, (np.array(way) - way[0]) / motion.volume.sum()


if __name__ == "__main__":
    motion, way = main()
    print(f"{1e3 * way[-1]:.2f} mm in {motion.times[-1]:.1f} s")
    motion.render("walking_strip.png", frames=[0, 19, -1])
