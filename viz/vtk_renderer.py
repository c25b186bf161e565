"""The three-dimensional renderer: one off-screen window, kept for as long as its process lives.

The meshes are PyVista's. The window is VTK's own and not a pyvista.Plotter: importing the plotter brings matplotlib's pyplot, charts
and widgets, about 70 MB and 0.3 s for a process that draws balls, arrows and lines. Edges are smoothed by drawing two or four times
with the camera moved by fractions of a pixel, and averaging: in a parallel projection that equals drawing at twice the size without
the four times larger frame buffers; and unlike multisampling it also smooths balls, whose edge is cut out by the fragment shader.
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
from vtkmodules.vtkRenderingCore import (
    vtkActor,
    vtkLight,
    vtkPolyDataMapper,
    vtkProperty,
    vtkRenderer,
    vtkRenderWindow,
)

from magmpm.viz import style
from magmpm.viz.camera import View
from magmpm.viz.drawing import Layer, outward
from magmpm.viz.layout import Panel
from magmpm.viz.meshes import normals
from magmpm.viz.snapshot import Balls, DrawnSolid, Snapshot

# Camera shifts in pixels: the centers of the four quarters of a pixel, or of two opposite ones.
_FOUR = ((-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25))
_TWO = ((-0.25, 0.25), (0.25, -0.25))


class VtkCanvas:
    """An off-screen window whose panels each have their own view. Not for two threads. Without OpenGL the process ends here."""

    def __init__(self) -> None:
        self._window = vtkRenderWindow()
        self._window.SetOffScreenRendering(1)
        self._window.SetMultiSamples(0)
        self._pixels = vtkUnsignedCharArray()
        self._panels: list[VtkPanel] = []
        self._thin = 0.0

    def clear(self, size: tuple[int, int], thin: float) -> None:
        """Start a picture of that width and height in pixels; thin: m, a step between flat layers."""
        for panel in self._panels:
            panel.renderer.RemoveAllViewProps()
            panel.renderer.ReleaseGraphicsResources(self._window)
            self._window.RemoveRenderer(panel.renderer)
        self._panels.clear()
        self._thin = thin
        self._window.SetSize(*size)
        paper = self.panel(
            Panel(0.0, 0.0, 1.0, 1.0),
            View(np.eye(3)[0], np.eye(3)[1], np.eye(3)[2], np.zeros(3), 1.0),
            reach=1.0,
        )
        paper.renderer.SetPreserveColorBuffer(False)

    def panel(self, place: Panel, view: View, reach: float) -> VtkPanel:
        """A panel seen in that view, as near and as far as `reach` (m) from its center. It does not cover what is there already."""
        panel = VtkPanel(place, view, reach, self._window.GetSize()[1], self._thin)
        self._window.AddRenderer(panel.renderer)
        self._panels.append(panel)
        return panel

    def image(self, *, fine: bool) -> np.ndarray:
        """Image of what was drawn, (height, width, 3) uint8; fine: edges smoothed with four passes instead of two."""
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


class VtkPanel:
    """A panel of the window; what its methods do, viz.drawing.PanelCanvas says."""

    def __init__(
        self, place: Panel, view: View, reach: float, page_height: int, thin: float
    ) -> None:
        self.view = view
        self._reach = reach
        self._thin = thin
        # Pixels to a meter: balls are points, whose size is in pixels. Lines get thinner in small pictures.
        self._scale = 0.5 * page_height * (place.top - place.bottom) / view.half_height
        self._line_unit = page_height / 900
        self.renderer = vtkRenderer()
        self.renderer.SetViewport(place.left, place.bottom, place.right, place.top)
        self.renderer.SetBackground(1.0, 1.0, 1.0)
        self.renderer.SetPreserveColorBuffer(True)
        self.renderer.AutomaticLightCreationOff()
        for position, intensity in (((0.0, 0.0, 1.0), 0.55), ((-0.6, 0.9, 0.9), 0.55)):
            light = vtkLight()
            light.SetLightTypeToCameraLight()
            light.SetPosition(*position)
            light.SetIntensity(intensity)
            self.renderer.AddLight(light)

    def aim(self, shift: tuple[float, float]) -> None:
        """Point the camera, moved by a shift in pixels to the right and up."""
        view = self.view
        camera = self.renderer.GetActiveCamera()
        center = view.center + (shift[0] * view.right + shift[1] * view.up) / self._scale
        camera.ParallelProjectionOn()
        camera.SetFocalPoint(*center)
        camera.SetPosition(*(center + view.toward * self._reach))
        camera.SetViewUp(*view.up)
        camera.SetParallelScale(view.half_height)
        camera.SetClippingRange(1e-3 * self._reach, 2 * self._reach)

    def balls(
        self,
        points: np.ndarray,
        width: float,
        colors: str | np.ndarray,
        layer: Layer,
        *,
        lit: bool = True,
        rim: bool = False,
    ) -> None:
        lifted = self._lifted(points, layer)
        if rim:
            self._dots(self.view.lift(lifted, -width), 1.4 * width, "#FFFFFF", lit=False)
        # What has no light is a mark on a tilted surface: it must not sink into it.
        self._dots(lifted if lit else self.view.lift(lifted, 2 * width), width, colors, lit)

    def flat(self, points: np.ndarray, triangles: np.ndarray, color: str, layer: Layer) -> None:
        self._actor(
            pv.PolyData.from_regular_faces(self._lifted(points, layer), triangles), color, lit=False
        )

    def solids(self, obstacles: tuple[DrawnSolid, ...], snapshot: Snapshot) -> None:
        for o in obstacles:
            self._solid(o.points, o.triangles, o.color).SetFrontfaceCulling(o.hollow)
        body = snapshot.body
        colors = snapshot.colors
        if isinstance(body, Balls):
            colors = (
                colors * self.view.brightness(outward(body, snapshot.axis), contrast=0.15)[:, None]
            )
            self._dots(body.points, style.BALL_WIDTH * body.size, colors, lit=True)
            return
        look = self._solid(body.points, body.triangles, colors)
        look.SetSpecular(0.18)
        look.SetSpecularPower(18)

    def lines(self, segments: np.ndarray, color: str, width: float, layer: Layer) -> None:
        lines = pv.line_segments_from_points(self._lifted(segments.reshape(-1, 3), layer))
        self._actor(lines, color, lit=False).GetProperty().SetLineWidth(width * self._line_unit)

    def arrow(
        self,
        start: np.ndarray,
        vector: np.ndarray,
        width: float,
        color: str,
        layer: Layer,
        *,
        halo: bool = False,
    ) -> None:
        """An arrow from start (3,) along vector (3,), its shaft `width` thick, all in m; halo: with a white rim."""
        start = self._lifted(start, layer)
        length = float(np.linalg.norm(vector))
        thickness = width / length
        rim = style.ARROW_HALO * width / length
        if halo:
            # Of this larger white arrow only the far side is drawn: it shows around the arrow, not in front of it.
            around = self._actor(
                _arrow(round(1 + 2.5 * rim, 3), round(thickness, 3), round(rim, 3)),
                "#FFFFFF",
                lit=False,
            )
            around.GetProperty().SetFrontfaceCulling(True)
            around.SetUserMatrix(_placed(start - rim * vector, vector))
        self._actor(_arrow(1.0, round(thickness, 3), 0.0), color, lit=True).SetUserMatrix(
            _placed(start, vector)
        )

    def _lifted(self, points: np.ndarray, layer: Layer) -> np.ndarray:
        return self.view.lift(points, layer.steps * self._thin + layer.share * self._reach)

    def _dots(self, points: np.ndarray, width: float, colors: str | np.ndarray, lit: bool) -> None:
        cloud = pv.PolyData(np.ascontiguousarray(points, dtype=np.float32))
        if not isinstance(colors, str):
            cloud.point_data["color"] = (255 * colors + 0.5).astype(np.uint8)
        look = self._actor(cloud, colors, lit).GetProperty()
        look.SetRepresentationToPoints()
        look.SetRenderPointsAsSpheres(True)
        look.SetPointSize(max(width * self._scale, 1.0))

    def _solid(
        self, points: np.ndarray, triangles: np.ndarray, colors: str | np.ndarray
    ) -> vtkProperty:
        """A smoothly shaded surface; its look. Edges are sharp where its triangles share no points."""
        mesh = pv.PolyData.from_regular_faces(
            np.asarray(points, dtype=float), np.asarray(triangles)
        )
        if not isinstance(colors, str):
            mesh.cell_data["color"] = (255 * colors + 0.5).astype(np.uint8)
        mesh.point_data.active_normals = normals(points, triangles).astype(np.float32)
        actor = self._actor(mesh, colors, lit=True)
        if not isinstance(colors, str):
            actor.GetMapper().SetScalarModeToUseCellFieldData()
        actor.GetProperty().SetInterpolationToPhong()
        return actor.GetProperty()

    def _actor(self, mesh: pv.PolyData, colors: str | np.ndarray, lit: bool) -> vtkActor:
        mapper = vtkPolyDataMapper()
        mapper.SetInputData(mesh)
        actor = vtkActor()
        actor.SetMapper(mapper)
        look = actor.GetProperty()
        if isinstance(colors, str):
            mapper.ScalarVisibilityOff()
            look.SetColor(*style.rgb(colors))
        else:
            mapper.SetScalarModeToUsePointFieldData()
            mapper.SelectColorArray("color")
            mapper.SetColorModeToDirectScalars()
        # Without light VTK shows (ambient + diffuse) times the color; it must be the color itself.
        look.SetLighting(lit)
        look.SetAmbient(0.36 if lit else 1.0)
        look.SetDiffuse(0.72 if lit else 0.0)
        look.SetSpecular(0.0)
        self.renderer.AddActor(actor)
        return actor


@functools.lru_cache(maxsize=64)
def _arrow(length: float, width: float, rim: float) -> pv.PolyData:
    """Mesh of an arrow along +x whose shaft is `width` thick, everywhere `rim` thicker.

    PyVista takes a millisecond to make one, and all arrows of a study are alike: they are made once and placed.
    """
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
