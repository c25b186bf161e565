"""A fit: the shear modulus of a catheter from photographs of its tip.

Tips in five fields, with errors of 0.2 mm as of a camera, are made here with a modulus that the fit is not told, and written as a
table such as you would measure. The fit finds the modulus and a 95 % interval, which should hold the truth nineteen times in
twenty; stiffness and remanence enter only by their ratio, so the other must be known. A few seconds.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from magmpm import Catheter, MagneticTorque, Material, Scene, Segment, UniformField, fit, run

FIELDS = np.array([1e-3, 2e-3, 3e-3, 4e-3, 5e-3])  # T


def scene(modulus):
    silicone = Material(shear_modulus=modulus, bulk_to_shear=20, remanence="100 mT")
    axial = Segment(magnetization=[1, 0, 0])
    return Scene(
        name="catheter in a photograph",
        materials={"silicone": silicone},
        body=Catheter(length="40 mm", diameter="4 mm", material="silicone", segments=[axial]),
        field=UniformField(uniform=["0 mT", "0 mT", "5 mT"]),
        effects=[MagneticTorque()],
        resolution={"cells_across": 2},
        advice="off",  # the weight is left out
    )


def main(folder=".", truth=105e3, noise=0.2e-3, seed=1):
    random = np.random.default_rng(seed)
    tips = np.array([run(scene(truth).with_field(float(field))).tip for field in FIELDS])
    tips += random.normal(0, noise, tips.shape)
    rows = [
        f"{1e3 * field:g},{1e3 * x:.3f},{1e3 * z:.3f}"
        for field, (x, _, z) in zip(FIELDS, tips, strict=True)
    ]
    table = Path(folder) / "tips.csv"
    table.write_text("\n".join(["field_z_mT,tip_x_mm,tip_z_mm", *rows, ""]))
    found = fit(table, scene("150 kPa"), vary=["shear_modulus"]).constants[0]
    return found, tips


if __name__ == "__main__":
    modulus, tips = main()
    print(f"G = {modulus.value / 1e3:.1f} kPa, {modulus.low / 1e3:.1f} to {modulus.high / 1e3:.1f}")
    smooth = np.linspace(0.2e-3, 5.5e-3, 25)
    fitted = [run(scene(modulus.value).with_field(float(field))).tip for field in smooth]
    figure, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
    axes.plot(1e3 * smooth, 1e3 * np.array(fitted)[:, 2], label="fitted")
    axes.errorbar(1e3 * FIELDS, 1e3 * tips[:, 2], 0.4, fmt="o", mfc="w", label="measured, 2 sigma")
    axes.set(xlabel="field (mT)", ylabel="height of the tip (mm)", xlim=0, ylim=0)
    axes.legend(frameon=False)
    figure.savefig("fit_modulus.png", dpi=200)
