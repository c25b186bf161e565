"""A robot of STL parts: tweezers with two magnetic tips that close in a field.

Five files, a foot, two arms and two tips, are joined where they touch. The tips are magnetized along their arms, one up and one
down, so that a field across turns them toward each other. The robot is its own mirror image, and so must be the way of its
tips: equal and opposite, without any lean to a side. Two seconds.
"""

from pathlib import Path

import numpy as np

from magmpm import MagneticTorque, Material, MeshPart, Parts, Scene, UniformField, run

MESHES = Path(__file__).parents[1] / "data" / "goals" / "meshes"


def main(folder=None, field="2 mT"):
    plain = {"material": "plain silicone"}
    up = {"material": "magnetic silicone", "magnetization": [0, 0, 1]}
    down = {"material": "magnetic silicone", "magnetization": [0, 0, -1]}
    parts = {
        "foot": {"clamp": True, **plain},
        "left_arm": plain,
        "left_tip": up,
        "right_arm": plain,
        "right_tip": down,
    }
    meshes = [
        MeshPart(name=name, mesh=MESHES / f"tweezers_{name}.stl", **settings)
        for name, settings in parts.items()
    ]
    scene = Scene(
        name="tweezers",
        materials={
            "plain silicone": Material(shear_modulus="60 kPa", bulk_to_shear=20),
            "magnetic silicone": Material(
                shear_modulus="90 kPa", bulk_to_shear=20, remanence="100 mT"
            ),
        },
        body=Parts(unit="mm", spacing="0.5 mm", meshes=meshes),
        field=UniformField(uniform=[field, 0, 0]),
        effects=[MagneticTorque()],
        advice="off",  # the weight is left out
    )
    return run(scene, folder=folder)


if __name__ == "__main__":
    result = main()
    gap = result.positions["right_tip"] - result.positions["left_tip"]
    print(f"between the tips: {1e3 * np.linalg.norm(gap):.2f} mm, at first 7 mm")
    result.render("stl_robot.png")
