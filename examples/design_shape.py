"""A design: which directions of magnetization, and which field, bend a catheter into an arc.

Steps along exact derivatives turn the magnetization of five segments and a field of at most 10 mT until the axis lies on an
arc of 75 degrees. Look at the arrows: to bend evenly, the torque must sit at the tip, so the last segments stand across the
field and the first ones hardly. Ten seconds.
"""

import numpy as np

from magmpm import Catheter, MagneticTorque, Material, Result, Scene, Segment, UniformField, design

SILICONE = Material(shear_modulus=120e3, bulk_to_shear=20, density=1882, remanence=0.138)  # SI
ANGLE = np.linspace(0, np.radians(75), 26)
X, Z = 40e-3 / ANGLE[-1] * np.array([np.sin(ANGLE), 1 - np.cos(ANGLE)])
ARC = np.column_stack([40e-3 * ANGLE / ANGLE[-1], X, 0 * X, Z])  # rows [s, x, y, z], m


def main(folder="runs/design_shape"):
    segments = 5 * [Segment(magnetization=[1, 0, 0])]
    scene = Scene(
        name="arc",
        materials={"silicone": SILICONE},
        body=Catheter(length="40 mm", diameter="4 mm", material="silicone", segments=segments),
        field=UniformField(uniform=["0 mT", "0 mT", "8 mT"]),
        effects=[MagneticTorque()],
    )
    vary = {"magnetization": {}, "field": {"max": "10 mT"}}
    study = {"scene": scene, "vary": vary, "match": {"centreline": ARC}, "trials": 8}
    report = design(study, folder=folder)
    return report, Result.load(report.out / "best")


if __name__ == "__main__":
    main()[1].render("design_shape.png", target=ARC)
