"""A sweep: how far a field lifts the tip of a catheter, against the elastica.

The catheter is magnetized along its axis and lies across the field. Small fields bend it in proportion; then the tip turns into
the field, and the last millitesla do little. The line is the theory of the planar rod, EI theta'' = -(A Br B/mu0) cos(theta),
which knows nothing of particles. Half a minute.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.constants import mu_0
from scipy.integrate import solve_bvp, trapezoid

import magmpm

LENGTH = 40e-3  # m
DIAMETER = 2e-3  # m
SHEAR = 120e3  # Pa
REMANENCE = 0.138  # T
FIELDS = np.linspace(0.25e-3, 4e-3, 16)  # T


def elastica(field):
    """Height of the tip, m, of the rod in this field, T; s counts in lengths."""
    young = 9 * 20 * SHEAR / (3 * 20 + 1)  # E = 9 K G/(3 K + G) with K = 20 G
    load = 16 * REMANENCE * field * LENGTH**2 / (mu_0 * young * DIAMETER**2)  # A/I = 16/D^2
    s = np.linspace(0, 1, 201)
    bent = solve_bvp(
        lambda s, y: np.array([y[1], -load * np.cos(y[0])]),
        lambda base, tip: np.array([base[0], tip[1]]),
        s,
        np.array([np.arctan(load / 3) * s, 0 * s]),
        tol=1e-8,
    )
    return LENGTH * trapezoid(np.sin(bent.sol(s)[0]), s)


def main(folder=None, fields=FIELDS, workers=None):
    body = magmpm.Catheter(
        length=LENGTH,
        diameter=DIAMETER,
        material="silicone",
        segments=[magmpm.Segment(magnetization=[1, 0, 0])],
    )
    silicone = magmpm.Material(shear_modulus=SHEAR, bulk_to_shear=20, remanence=REMANENCE)
    scene = magmpm.Scene(
        name="catheter across a field",
        materials={"silicone": silicone},
        body=body,
        field=magmpm.UniformField(uniform=[0, 0, 1e-3]),
        effects=[magmpm.MagneticTorque()],
        advice="off",  # the weight is left out, as in the elastica
    )
    table = magmpm.sweep(scene, {"field.uniform[2]": list(fields)}, workers=workers, folder=folder)
    return np.array(fields), np.array([row["tip_z_m"] for row in table.rows])


if __name__ == "__main__":
    fields, heights = main()
    smooth = np.linspace(0, fields[-1], 80)
    figure, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
    axes.plot(1e3 * smooth, [1e3 * elastica(field) for field in smooth], label="elastica")
    axes.plot(1e3 * fields, 1e3 * heights, "o", mfc="none", label="magmpm, 3D")
    axes.set(xlabel="field (mT)", ylabel="height of the tip (mm)", xlim=0, ylim=0)
    axes.legend(frameon=False)
    figure.savefig("field_sweep.png", dpi=200)
