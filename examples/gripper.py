"""A gripper: six arms of STL parts close under a ball and lift it.

The outer halves of the arms are magnetized out of their plane. In a field that points down they turn under the ball, which lies
free on the ground, and raise it; what then carries it is contact and friction alone. The arms are mirror images of each other, so
the ball must stay on the axis, and opposite arms must move alike. A minute.
"""

from pathlib import Path

import numpy as np

import magmpm

MESHES = Path(__file__).parents[1] / "data" / "scenes" / "gallery" / "meshes"


def parts():
    """A hub that is held, the ball, and six arms of two halves each."""
    hub = magmpm.MeshPart(mesh=MESHES / "gripper_hub.stl", material="plain", clamp=True)
    found = [hub, magmpm.MeshPart(mesh=MESHES / "gripper_ball.stl", material="plain")]
    for number in range(1, 7):
        angle = np.radians(60 * (number - 1))
        outward = np.array([np.cos(angle), np.sin(angle), 0.0])
        inner = {"magnetization": outward, "mesh": MESHES / f"gripper_inner_{number}.stl"}
        raised = outward / 2 + np.array([0.0, 0.0, np.sqrt(0.75)])
        outer = {"magnetization": raised, "mesh": MESHES / f"gripper_outer_{number}.stl"}
        found += [magmpm.MeshPart(material="magnetic", **half) for half in (inner, outer)]
    return found


def main(folder="runs/gripper", duration=0.1, strength="-24 mT"):
    soft = {"shear_modulus": "30 kPa", "bulk_to_shear": 20}
    schedule = [{"time": 0, "strength": 0}, {"time": 0.03, "strength": 1}]
    scene = magmpm.Scene(
        name="gripper",
        materials={
            "magnetic": magmpm.Material(**soft, density="1860 kg/m^3", remanence="100 mT"),
            "plain": magmpm.Material(**soft, density="1000 kg/m^3"),
        },
        body=magmpm.Parts(unit="mm", spacing="0.5 mm", meshes=parts()),
        field={"uniform": [0, 0, strength], "over_time": {"keyframes": schedule}},
        effects=[
            magmpm.MagneticTorque(),
            magmpm.Gravity(),
            magmpm.Damping(rate="60 1/s"),
            magmpm.Ground(point=["0 mm", "0 mm", "-7.25 mm"], friction=0.5),
            magmpm.SelfContact(friction=0.5),
        ],
        solver=magmpm.Dynamic(duration=duration, output_every="2.5 ms"),
        resolution={"cells_across": 2},
    )
    magmpm.run(scene, folder=folder)
    return magmpm.Motion.load(folder)


if __name__ == "__main__":
    motion = main()
    ball = motion.positions["gripper_ball"]
    print(f"the ball is lifted by {1e3 * (ball[-1] - ball[0])[2]:.3f} mm")
    motion.render("gripper.png", frames=[0, 10, -1])
