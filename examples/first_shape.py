"""A first shape: a catheter of five magnetic segments in a uniform field.

The equilibrium is computed in three dimensions, with the weight of the catheter. Each segment turns toward the field as a
compass needle does, until the bent silicone holds it. A fraction of a second, after kernels were compiled once.
"""

from magmpm import Catheter, Gravity, MagneticTorque, Material, Scene, Segment, UniformField, run

SILICONE = Material(shear_modulus=120e3, bulk_to_shear=20, density=1882, remanence=0.138)  # SI
DIRECTIONS = [1, 0, 0], [1, 0.3, 0], [1, 0.6, 0], [0.3, 1, 0], [-0.5, 1, 0]


def main(folder=None, directions=DIRECTIONS, field=("0 mT", "-5 mT", "9 mT")):
    segments = [Segment(magnetization=direction) for direction in directions]
    scene = Scene(
        name="five segments",
        materials={"silicone": SILICONE},
        body=Catheter(length="40 mm", diameter="4 mm", material="silicone", segments=segments),
        field=UniformField(uniform=field),
        effects=[MagneticTorque(), Gravity()],
    )
    return run(scene, folder=folder)


if __name__ == "__main__":
    main().render("first_shape.png")
