"""One off-screen window, kept for as long as its process lives, and the few things drawn in it.

The meshes are PyVista's. The window is VTK's own and not a pyvista.Plotter: importing the plotter brings
matplotlib's pyplot, charts and widgets, about 70 MB and 0.3 s for a process that draws balls, arrows and
lines. Edges are smoothed by drawing two or four times with the camera moved by fractions of a pixel, and
averaging: in a parallel projection that equals drawing at twice the size, without the four times larger
frame buffers; and unlike multisampling it also smooths balls, whose edge is cut out by the fragment shader.
"""

from __future__ import annotations

import functools

import numpy as np
import pyvista as pv

# Registers the OpenGL implementations of the classes below; nothing is drawn without it.
import vtkmodules.vtkRenderingOpenGL2  # noqa: F401
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkUnsignedCharArray
from vtkmodules.vtkCommonMath import vtkMatrix4x4
from vtkmodules.vtkRenderingCore import vtkActor, vtkLight, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow

from viz import style
from viz.camera import View
from viz.layout import Panel

# Camera shifts in pixels: the centres of the four quarters of a pixel, or of two opposite ones.
_FOUR = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
_TWO = ((-0.25, 0.25), (0.25, -0.25))


class Canvas:
    """An off-screen window whose panels each have their own view. Not for two threads."""

    def __init__(self) -> None:
        self._window = vtkRenderWindow()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0)
        self._pixels = vtkUnsignedCharArray()
        self._panels: list[PanelCanvas] = []

    def clear(self, size: tuple[int, int]) -> None:
        """Start a picture of that width and height in pixels: everything drawn before is gone."""
        for panel in self._panels:
            panel.renderer.RemoveAllViewProps()
            panel.renderer.ReleaseGraphicsResources(self._window)
            self._window.RemoveRenderer(panel.renderer)
        self._panels.clear()
        self._window.SetSize(*size)
        # Whatever no panel covers is white as well.
        whole = View(np.eye(3)[0], np.eye(3)[1], np.eye(3)[2], np.zeros(3), 1.0)
        self.panel(Panel(0.0, 0.0, 1.0, 1.0), whole, reach=1.0)

    def panel(self, place: Panel, view: View, reach: float, *, over: bool = False) -> PanelCanvas:
        """A panel of the window, seen in that view, as near and as far as `reach` (m) from its centre; over: on what is there already,
        not on white."""
        panel = PanelCanvas(place, view, reach, self._window.GetSize()[1])
        panel.renderer.SetPreserveColorBuffer(over)
        self._window.AddRenderer(panel.renderer)
        self._panels.append(panel)
        return panel

    def image(self, *, fine: bool) -> np.ndarray:
        """What was drawn, (height, width, 3) uint8; fine: edges smoothed with four passes instead of two."""
        shifts = _FOUR if fine else _TWO
        width, height = self._window.GetSize()
        total = np.zeros((height, width, 3), dtype=np.uint16)
        for shift in shifts:
            for panel in self._panels:
                panel.aim(shift)
            self._window.Render()
            self._window.GetPixelData(0, 0, width - 1, height - 1, 1, self._pixels, 0)
            total += vtk_to_numpy(self._pixels).reshape(height, width, 3)[::-1]
        return ((total + len(shifts) // 2) // len(shifts)).astype(np.uint8)

    def close(self) -> None:
        """Give the window's memory back."""
        self.clear((8, 8))
        self._window.Finalize()


class PanelCanvas:
    """One panel of a Canvas: balls, solids, flat faces and lines, placed in metres."""

    def __init__(self, place: Panel, view: View, reach: float, page_height: int) -> None:
        self.view = view
        self._reach = reach
        # Pixels to a metre: balls are points, whose size is in pixels. Lines get thinner in small pictures.
        self._scale = 0.5 * page_height * (place.top - place.bottom) / view.half_height
        self._line_unit = page_height / 900
        self.renderer = vtkRenderer()
        self.renderer.SetViewport(place.left, place.bottom, place.right, place.top)
        self.renderer.SetBackground(1.0, 1.0, 1.0)
        self.renderer.AutomaticLightCreationOff()
        for position, intensity in (((0.0, 0.0, 1.0), 0.55), ((-0.6, 0.9, 0.9), 0.55)):
            light = vtkLight()
            light.SetLightTypeToCameraLight()
            light.SetPosition(*position)
            light.SetIntensity(intensity)
            self.renderer.AddLight(light)

    def aim(self, shift: tuple[float, float]) -> None:
        """Point the camera, moved by a shift in pixels to the right and up."""
        view, camera = self.view, self.renderer.GetActiveCamera()
        center = view.center + (shift[0] * view.right + shift[1] * view.up) / self._scale
        camera.ParallelProjectionOn()
        camera.SetFocalPoint(*center)
        camera.SetPosition(*(center + view.toward * self._reach))
        camera.SetViewUp(*view.up)
        camera.SetParallelScale(view.half_height)
        camera.SetClippingRange(1e-3 * self._reach, 2 * self._reach)

    def balls(self, points: np.ndarray, width: float, colour: str | np.ndarray, *, lit: bool = True) -> None:
        """Balls of that width (m) at points (n, 3) m; colour: one, or (n, 3) in 0..1, one for each."""
        cloud = pv.PolyData(np.ascontiguousarray(points, dtype=np.float32))
        if not isinstance(colour, str):
            cloud.point_data["colour"] = (255 * colour + 0.5).astype(np.uint8)
        actor = self._actor(cloud, colour, lit)
        actor.GetProperty().SetRepresentationToPoints()
        actor.GetProperty().SetRenderPointsAsSpheres(True)
        actor.GetProperty().SetPointSize(max(width * self._scale, 1.0))

    def solid(
        self, mesh: pv.PolyData, colour: str, *, lit: bool = True, only_far_side: bool = False
    ) -> vtkActor:
        """A closed surface; only_far_side: draw the faces turned away from the camera alone."""
        actor = self._actor(mesh, colour, lit)
        actor.GetProperty().SetFrontfaceCulling(only_far_side)
        return actor

    def surface(
        self,
        points: np.ndarray,
        triangles: np.ndarray,
        colour: str | np.ndarray,
        *,
        normals: np.ndarray | None = None,
        lit: bool = True,
        glossy: bool = False,
        only_far_side: bool = False,
    ) -> None:
        """Triangles (m, 3) between points (n, 3) m; colour: one, or (m, 3) in 0..1; normals (n, 3): shaded smoothly with them."""
        mesh = pv.PolyData.from_regular_faces(np.asarray(points, dtype=float), np.asarray(triangles))
        if not isinstance(colour, str):
            mesh.cell_data["colour"] = (255 * colour + 0.5).astype(np.uint8)
        if normals is not None:
            mesh.point_data.active_normals = np.asarray(normals, dtype=np.float32)
        actor = self._actor(mesh, colour, lit)
        if not isinstance(colour, str):
            actor.GetMapper().SetScalarModeToUseCellFieldData()
        look = actor.GetProperty()
        look.SetFrontfaceCulling(only_far_side)
        if normals is None:
            look.SetInterpolationToFlat()
        else:
            look.SetInterpolationToPhong()
        if glossy:
            look.SetSpecular(0.18)
            look.SetSpecularPower(18)

    def lines(self, segments: np.ndarray, colour: str, width: float) -> None:
        """Straight lines between points (n, 2, 3) m; width in pixels of a page 900 pixels high."""
        actor = self._actor(pv.line_segments_from_points(segments.reshape(-1, 3)), colour, lit=False)
        actor.GetProperty().SetLineWidth(width * self._line_unit)

    def arrow(
        self, start: np.ndarray, vector: np.ndarray, width: float, colour: str, *, halo: float = 0.0
    ) -> None:
        """An arrow from start (3,) along vector (3,), its shaft `width` thick, with a white rim; all in m."""
        length = float(np.linalg.norm(vector))
        thickness, rim = width / length, halo / length
        if halo > 0:
            # Of this larger white arrow only the far side is drawn: it shows around the arrow, not before it.
            shape = _arrow(round(1 + 2.5 * rim, 3), round(thickness, 3), round(rim, 3))
            actor = self.solid(shape, "#FFFFFF", lit=False, only_far_side=True)
            actor.SetUserMatrix(_placed(start - rim * vector, vector))
        self.solid(_arrow(1.0, round(thickness, 3), 0.0), colour).SetUserMatrix(_placed(start, vector))

    def _actor(self, mesh: pv.PolyData, colour: str | np.ndarray, lit: bool) -> vtkActor:
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(mesh)
        actor = vtkActor()
        actor.SetMapper(mapper)
        look = actor.GetProperty()
        if isinstance(colour, str):
            mapper.ScalarVisibilityOff()
            look.SetColor(*style.rgb(colour))
        else:
            mapper.SetScalarModeToUsePointFieldData()
            mapper.SelectColorArray("colour")
            mapper.SetColorModeToDirectScalars()
        # Without light VTK shows (ambient + diffuse) times the colour; it must be the colour itself.
        look.SetLighting(lit)
        look.SetAmbient(0.36 if lit else 1.0)
        look.SetDiffuse(0.72 if lit else 0.0)
        look.SetSpecular(0.0)
        self.renderer.AddActor(actor)
        return actor


@functools.lru_cache(maxsize=64)
def _arrow(length: float, width: float, rim: float) -> pv.PolyData:
    """Mesh of an arrow along +x whose shaft is `width` thick, everywhere `rim` thicker. PyVista takes a
    millisecond to make one, and all arrows of a study are alike: they are made once and placed."""
    return pv.Arrow(
        scale=length,
        tip_length=(min(2.6 * width, 0.5) + rim) / length,
        tip_radius=(1.25 * width + 1.5 * rim) / length,
        shaft_radius=(0.5 * width + rim) / length,
        tip_resolution=24,
        shaft_resolution=24,
    )


def _placed(start: np.ndarray, vector: np.ndarray) -> vtkMatrix4x4:
    """The similarity that takes the unit vector along +x from the origin to this vector from start."""
    length = float(np.linalg.norm(vector))
    along = vector / length
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    matrix = np.eye(4)
    matrix[:3, :3] = length * np.stack([along, across, np.cross(along, across)], axis=1)
    matrix[:3, 3] = start
    placed = vtkMatrix4x4()
    placed.DeepCopy(matrix.ravel().tolist())
    return placed
