"""An insertion: a catheter that leaves a guide and follows its own tip along an S.

One magnetization serves all depths, and each depth has a field of its own; both are searched for together. The whole body must
stay where its tip has been, so what bends the tip at one depth must hold that bend further back at the next. One minute.
"""

import shutil

import numpy as np

from magmpm import Catheter, Gravity, MagneticTorque, Material, Result, Scene, Segment, design
from magmpm.cli import main as command

LENGTH = 48e-3  # m


def path(most=40.0):
    """Rows [s, x, y, z], m, of a curve in the xz plane that bends one way and back, by `most` per m."""
    s = np.linspace(0, LENGTH, 97)
    angle = most * LENGTH / (2 * np.pi) * (1 - np.cos(2 * np.pi * s / LENGTH))
    step = np.diff(s)[:, None] * np.column_stack(
        [np.cos((angle[1:] + angle[:-1]) / 2), np.sin((angle[1:] + angle[:-1]) / 2)]
    )
    x, z = np.vstack([[0.0, 0.0], np.cumsum(step, axis=0)]).T
    return np.column_stack([s, x, 0 * s, z])


def main(folder="runs/insertion", depths=8, trials=4, cells=3):
    silicone = Material(
        shear_modulus="120 kPa", bulk_to_shear=20, density="1882 kg/m^3", remanence="138 mT"
    )
    segments = 6 * [Segment(magnetization=[1, 0, 0])]
    scene = Scene(
        name="insertion",
        materials={"silicone": silicone},
        body=Catheter(length=LENGTH, diameter="3 mm", material="silicone", segments=segments),
        field={"uniform": ["0 mT", "0 mT", "10 mT"]},
        effects=[MagneticTorque(), Gravity()],
        resolution={"cells_across": cells},
    )
    study = {
        "scene": scene,
        "vary": {"magnetization": {}, "field": {"max": "10 mT", "at": "each depth"}},
        "match": {"path": path()},
        "insertion": {"depths": depths},
        "trials": trials,
    }
    report = design(study, folder=folder)
    return report.best, Result.load(report.out / "best")


if __name__ == "__main__":
    best, _ = main()
    for row in best["insertion"]:
        print(
            f"{1e3 * row['depth_m']:5.1f} mm: field {np.round(1e3 * np.array(row['field_T']), 2)} mT"
        )
    command(["render", "runs/insertion"])  # the same as `magmpm render runs/insertion` in a shell
    shutil.copy("runs/insertion/best.png", "insertion.png")
