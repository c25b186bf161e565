"""A body's surface and its magnetization arrows, and how both follow the particles."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from magmpm.bodies.assembly import Parts
from magmpm.scene import Scene
from magmpm.viz import style
from magmpm.viz.binding import Binding
from magmpm.viz.meshes import TriangleSurface, bar, creased, refined, tube
from magmpm.viz.particle_surface import around_particles, connected_components, spacing


class DrawnBody:
    """The undeformed particles of a body, with the surface and the arrows that they carry along."""

    def __init__(
        self,
        scene: Scene | None,
        reference: np.ndarray,
        volume: np.ndarray,
        part: np.ndarray,
        remanence: np.ndarray,
    ) -> None:
        """reference (n, 3) m, volume (n,) m^3, part (n,), remanence (n, 3) T of the undeformed particles; None: the scene is unknown."""
        self.reference = np.asarray(reference, dtype=float)
        self.volume = np.asarray(volume, dtype=float)
        self.part = np.asarray(part)
        self.size = spacing(self.volume)
        parts = int(self.part.max()) + 1
        self._plane_strain = scene is not None and scene.body.shape.in_plane_strain
        self.held = (
            np.zeros(parts, dtype=bool)
            if scene is None
            else np.array([region.held for region in scene.regions()])
        )
        self.surface, self._binding = self._bound(scene)
        total = np.bincount(self.part, np.linalg.norm(remanence, axis=1), minlength=parts)
        strength = total / np.maximum(np.bincount(self.part, minlength=parts), 1)
        self.magnetized = strength > 1e-9 * max(float(strength.max()), 1e-12)
        self.length = float(np.ptp(self.reference, axis=0).max()) + self.size
        # In plane strain the particles' one layer is not as wide as the body.
        sides = (
            np.sort(np.ptp(self.surface.points if self._plane_strain else self.reference, axis=0))
            + self.size
        )
        self.thickness = float(np.clip(sides[1], 0.06 * self.length, 0.12 * self.length))
        self._remanence = np.asarray(remanence, dtype=float)

    def _bound(self, scene: Scene | None) -> tuple[TriangleSurface, Binding]:
        """The surface, and what moves it."""
        known = None if scene is None else _known_shape(scene, self.size)
        if known is not None and self._plane_strain:
            middle = np.array(known.points)
            middle[:, 1] = self.reference[:, 1].mean()
            return known, Binding(middle, self._layered(self.reference))
        if known is not None:
            return known, Binding(known.points, self.reference)
        if scene is not None and scene.body.parts is not None:
            whole = _meshes(scene.body.parts, self.size)
            return whole, Binding(whole.points, self.reference, whole.part_of_point, self.part)
        component = connected_components(self.reference, self.size)
        members = [component == k for k in range(int(component.max()) + 1)]
        surfaces = [
            around_particles(self.reference[of], self.volume[of], self.part[of]) for of in members
        ]
        whole = TriangleSurface.joined(surfaces)
        of_point = np.repeat(np.arange(len(surfaces)), [len(s.points) for s in surfaces])
        return whole, Binding(whole.points, self.reference, of_point, component)

    def points(self, position: np.ndarray) -> np.ndarray:
        """The surface's points (m, 3) m when the particles are at position (n, 3) m."""
        if not self._plane_strain:
            return self._binding.at(position)
        points = self._binding.at(self._layered(position))
        points[:, 1] = self.surface.points[:, 1]
        return points

    def surface_at(self, position: np.ndarray) -> TriangleSurface:
        """The deformed surface in single precision, without triangles that are not finite."""
        points = self.points(position)
        whole = np.isfinite(points).all(axis=1)[self.surface.triangles].all(axis=1)
        triangles = self.surface.triangles[whole].astype(np.int32)
        return TriangleSurface(
            np.nan_to_num(points, posinf=0.0, neginf=0.0).astype(np.float32),
            triangles,
            self.surface.part[whole],
        )

    def _layered(self, position: np.ndarray) -> np.ndarray:
        """Three layers of particles to fit to: in plane strain one stands for the whole width, along which nothing moves."""
        return np.vstack([position + shift * self.size * np.eye(3)[1] for shift in (-1, 0, 1)])

    def arrows(self, position: np.ndarray, magnetization: np.ndarray) -> np.ndarray:
        """Starts and vectors (a, 2, 3) m of the magnetization's arrows; magnetization (n, 3) T, deformed."""
        if not self._clusters:
            return np.zeros((0, 2, 3))
        center = np.array([position[middle].mean(axis=0) for _, middle in self._clusters])
        mean = np.array([magnetization[members].mean(axis=0) for members, _ in self._clusters])
        longest = float(np.linalg.norm(mean, axis=1).max())
        if not longest > 0:
            return np.zeros((0, 2, 3))
        vector = mean / longest * self.arrow_length
        return np.nan_to_num(np.stack([center - 0.5 * vector, vector], axis=1))

    @cached_property
    def _clusters(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Two groups for each arrow: the particles whose magnetization it shows, and those at its middle.

        A part magnetized evenly has one arrow, or a few if it is most of the body. Where the magnetization turns, each stretch has one.
        """
        clusters: list[np.ndarray] = []
        magnetized = np.flatnonzero(self.magnetized)
        for k in magnetized:
            members = np.flatnonzero(self.part == k)
            mean = self._remanence[members].mean(axis=0)
            even = (
                np.linalg.norm(mean)
                > 0.97 * np.linalg.norm(self._remanence[members], axis=1).mean()
            )
            place = self.reference[members]
            along = place[:, np.argmax(np.ptp(place, axis=0))]
            few = max(1, round(float(np.ptp(along)) / (0.34 * self.length)))
            count = few if even else max(2, min(8, 16 // max(len(magnetized), 1)))
            edges = np.linspace(along.min(), along.max() * (1 + 1e-12) + 1e-300, count + 1)
            which = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, count - 1)
            clusters += [members[which == i] for i in range(count) if np.any(which == i)]
        away = [
            np.linalg.norm(self.reference[c] - self.reference[c].mean(axis=0), axis=1)
            for c in clusters
        ]
        return [(c, c[np.argsort(distance)[:8]]) for c, distance in zip(clusters, away)]

    @cached_property
    def arrow_length(self) -> float:
        """Length (m) of the longest arrow: about as long as what it stands for, and so short that neighbors do not cross."""
        places = [self.reference[members] for members, _ in self._clusters]
        longest = (
            0.9 * float(np.median([np.linalg.norm(np.ptp(p, axis=0)) for p in places]))
            if places
            else self.length
        )
        if len(places) > 1:
            middles = np.array([p.mean(axis=0) for p in places])
            distances = np.asarray(cKDTree(middles).query(middles, k=2)[0])[:, 1]
            longest = min(longest, max(0.95 * float(np.median(distances)), 0.07 * self.length))
        return float(np.clip(longest, 0.05 * self.length, 0.3 * self.length))

    @property
    def arrow_reach(self) -> float:
        """m, how far arrows may stand out of the body: the longest one's length, or 0 without any."""
        return self.arrow_length if self._clusters else 0.0

    @property
    def arrow_width(self) -> float:
        """m, width of the arrows' shafts."""
        return min(style.ARROW_WIDTH * self.thickness, 0.085 * self.arrow_length)


def _known_shape(scene: Scene, step: float) -> TriangleSurface | None:
    """The surface of a catheter or strip with its sharp edges; None for a body of STL parts. step: m, about a triangle's edge."""
    shape = scene.body.catheter or scene.body.strip
    if shape is None:
        return None
    ends = np.cumsum(shape.segment_lengths()).tolist()
    if scene.body.strip is not None:
        return bar(ends, scene.body.strip.width, scene.thickness, step, shape.line.base)
    assert scene.body.catheter is not None  # one of the two
    return tube(ends, 0.5 * scene.thickness, 0.5 * scene.body.catheter.inner_diameter, step)


def _meshes(parts: Parts, step: float) -> TriangleSurface:
    """The surfaces of STL parts, with triangles of about three particles."""
    return TriangleSurface.joined(
        [refined(creased(*surface, k), 3 * step) for k, surface in enumerate(parts.surfaces())]
    )
