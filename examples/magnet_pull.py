"""A permanent magnet: a catheter's magnetic tip, pulled by a magnet above it.

The field is that of a cylinder magnet, with its gradient, which pulls, and its torque, which holds the tip parallel to the magnet.
That makes the S: lifted, and straight at the end. From afar the magnet is a dipole of the moment Br V/mu0, and lifts the tip as
1/d^4; near it the lift lags behind, as the field grows and holds the tip. A few seconds.
"""

import numpy as np
from scipy.constants import mu_0

import magmpm

SIZE, REMANENCE = 20e-3, 1.3  # m, diameter and length of the magnet; T


def magnet(distance):
    """A magnet at this distance, m, above the tip, against whose axis it is magnetized."""
    shape = magmpm.Cylinder(diameter=SIZE, length=SIZE)
    place = [40e-3, 0, distance]
    return {
        "magnet": magmpm.Magnet(
            cylinder=shape, position=place, axis=[-1, 0, 0], remanence=REMANENCE
        )
    }


def dipole(distance):
    """The same magnet, as seen from afar."""
    moment = REMANENCE * np.pi / 4 * SIZE**3 / mu_0
    return {"dipole": magmpm.Dipole(position=[40e-3, 0, distance], moment=[-moment, 0, 0])}


def main(folder=None, distance=50e-3, source=magnet):
    plain = magmpm.Material(shear_modulus="60 kPa", bulk_to_shear=20)
    magnetic = magmpm.Material(shear_modulus="60 kPa", bulk_to_shear=20, remanence="138 mT")
    tip = magmpm.Segment(length="10 mm", magnetization=[1, 0, 0], material="magnetic")
    segments = [magmpm.Segment(length="30 mm"), tip]
    scene = magmpm.Scene(
        name="catheter and magnet",
        materials={"plain": plain, "magnetic": magnetic},
        body=magmpm.Catheter(length="40 mm", diameter="3 mm", material="plain", segments=segments),
        field=source(distance),
        effects=[magmpm.MagneticTorque(), magmpm.MagneticForce()],
        advice="off",  # the catheter floats
    )
    return magmpm.run(scene, folder=folder)


if __name__ == "__main__":
    for distance in (120e-3, 80e-3, 50e-3):
        lifts = [main(distance=distance, source=source).tip[2] for source in (magnet, dipole)]
        print(f"{1e3 * distance:.0f} mm: {1e3 * lifts[0]:.2f} mm; dipole {1e3 * lifts[1]:.2f} mm")
    main().render("magnet_pull.png")
