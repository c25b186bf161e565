"""A sweep on many machines: Dask runs what `magmpm.sweep` gives out.

Any executor of Python's concurrent.futures can run a sweep. Here it is that of a Dask cluster on this machine; with the address of
a scheduler in place of LocalCluster the same lines use a hundred. The tip over direction and strength of the field must have the
symmetry of the round catheter: a field from below bends it down as far as one from above bends it up. A minute.
Needs `pip install distributed`.
"""

import matplotlib.pyplot as plt
import numpy as np

import magmpm

ANGLES = np.radians(np.arange(-150, 151, 30))  # of the field from the catheter's axis
STRENGTHS = 1e-3 * np.array([1.0, 2.0, 4.0])  # T


def main(folder=None, executor=None, angles=ANGLES, strengths=STRENGTHS):
    silicone = magmpm.Material(shear_modulus="120 kPa", bulk_to_shear=20, remanence="138 mT")
    axial = magmpm.Segment(magnetization=[1, 0, 0])
    scene = magmpm.Scene(
        name="tips over fields",
        materials={"silicone": silicone},
        body=magmpm.Catheter(
            length="40 mm", diameter="3 mm", material="silicone", segments=[axial]
        ),
        field=magmpm.UniformField(uniform=[0, 0, 1e-3]),
        effects=[magmpm.MagneticTorque()],
        resolution={"cells_across": 2},
        advice="off",
    )
    fields = [
        [float(one * np.cos(angle)), 0.0, float(one * np.sin(angle))]
        for one in strengths
        for angle in angles
    ]
    table = magmpm.sweep(scene, {"field.uniform": fields}, executor=executor, folder=folder)
    tips = [[row["tip_x_m"], row["tip_z_m"]] for row in table.rows]
    return np.reshape(tips, (len(strengths), len(angles), 2))


if __name__ == "__main__":
    from distributed import Client, LocalCluster

    with LocalCluster(n_workers=2, threads_per_worker=1) as cluster, Client(cluster) as client:
        tips = main(executor=client.get_executor())
    figure, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
    for strength, row in zip(STRENGTHS, tips, strict=True):
        axes.plot(np.degrees(ANGLES), 1e3 * row[:, 1], "o-", label=f"{1e3 * strength:g} mT")
    axes.set(xlabel="angle from catheter to field (deg)", ylabel="height of the tip (mm)")
    axes.set_xticks(range(-150, 151, 50))
    axes.legend(frameon=False)
    figure.savefig("dask_sweep.png", dpi=200)
