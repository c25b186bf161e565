"""Files for ParaView: stress in a beam that is bent, from VTK files.

A motion writes motion.vtkhdf, its particles with stress, velocity and more at each frame, and a result gives its surface as a mesh,
saved here as surface.vtp: ParaView opens both. The file is read again with VTK's own reader, as ParaView does. Stress is
largest at the clamp, on top and below, and vanishes in between. A few seconds.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkIOHDF import vtkHDFReader

from magmpm import Damping, Dynamic, MagneticTorque, Material, Scene, Segment, Strip, run


def read(path, frame):
    """Positions (n, 3) m, and the arrays of the particles by name, at a frame of a VTK file."""
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.SetStep(range(reader.GetNumberOfSteps())[frame])
    reader.Update()
    data = reader.GetOutput()
    arrays = data.GetPointData()
    names = [arrays.GetArrayName(k) for k in range(arrays.GetNumberOfArrays())]
    found = {name: vtk_to_numpy(arrays.GetArray(name)).copy() for name in names}
    return vtk_to_numpy(data.GetPoints().GetData()).copy(), found


def main(folder="runs/paraview_files", duration=0.1, cells=4):
    silicone = Material(
        shear_modulus="120 kPa", bulk_to_shear=20, density="1882 kg/m^3", remanence="100 mT"
    )
    beam = Strip(
        length="20 mm",
        width="4 mm",
        thickness="2 mm",
        plane_strain=True,
        material="silicone",
        segments=[Segment(magnetization=[1, 0, 0])],
    )
    scene = Scene(
        name="bent beam",
        materials={"silicone": silicone},
        body=beam,
        field={"uniform": ["0 mT", "0 mT", "10 mT"]},
        effects=[MagneticTorque(), Damping(rate="100 1/s")],
        solver=Dynamic(duration=duration, output_every=duration / 10),
        resolution={"cells_across": cells},
        advice="off",  # the weight is left out
    )
    result = run(scene, folder=folder)
    result.mesh().save(Path(folder) / "surface.vtp")
    return read(Path(folder) / "motion.vtkhdf", -1)


if __name__ == "__main__":
    places, arrays = main()
    x, _, z = 1e3 * places.T
    figure, axes = plt.subplots(figsize=(5, 3.2), layout="constrained")
    along = arrays["cauchy_stress"].reshape(-1, 3, 3)[:, 0, 0]
    order = np.argsort(abs(along))
    drawn = axes.scatter(x[order], z[order], c=along[order] / 1e3, s=6, cmap="RdBu_r")
    axes.set(xlabel="x (mm)", ylabel="z (mm)", aspect="equal")
    figure.colorbar(drawn, label="stress along x (kPa)", shrink=0.8)
    figure.savefig("paraview_files.png", dpi=200)
