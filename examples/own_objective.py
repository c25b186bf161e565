"""An objective of your own: the magnetization that makes the most room under a catheter.

Any Python function of a result can be the goal: here the area between the catheter and the height of its base. The inner half is
magnetized along the axis; which direction should the outer half have in a field of 5 mT? One that leans away from the field by
about as much as the tip turns, so that the bent tip stands across the field, where the torque is largest. Half a minute.
"""

from pathlib import Path

import numpy as np

from magmpm import Catheter, Gravity, MagneticTorque, Material, Result, Scene, Segment, design


def room(result):
    """Area below the axis, m^2: the integral of z dx."""
    _, x, _, z = result.centreline.T
    return float(np.sum((z[1:] + z[:-1]) / 2 * np.diff(x)))


def scene(outer=(1, 0, 0)):
    silicone = Material(
        shear_modulus="120 kPa", bulk_to_shear=20, density="1882 kg/m^3", remanence="138 mT"
    )
    halves = [Segment(magnetization=direction) for direction in ([1, 0, 0], outer)]
    return Scene(
        name="room under a catheter",
        materials={"silicone": silicone},
        body=Catheter(length="40 mm", diameter="4 mm", material="silicone", segments=halves),
        field={"uniform": ["0 mT", "0 mT", "5 mT"]},
        effects=[MagneticTorque(), Gravity()],
        resolution={"cells_across": 2},
    )


def main(folder="runs/own_objective", trials=25):
    outer = {"of": "body.catheter.segments[1].magnetization", "direction": {"across": [0, -1, 0]}}
    study = {
        "scene": scene(),
        "vary": {"numbers": [outer]},
        "goal": {"maximize": {"python": room}},
        "trials": trials,
    }
    report = design(study, folder=folder)
    return report, Result.load(Path(folder) / "best")


if __name__ == "__main__":
    report, best = main()
    print(f"{1e6 * room(best):.0f} mm^2, at first {1e6 * report.values[0][0]:.0f} mm^2")
    best.render("own_objective.png")
