"""The path of an insertion: a smooth curve through the rows of a table, with frames that do not turn about it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from magmpm.compiled.arrays import Array

PIECES_OF_FRAMES = (
    280  # pieces for frames: a tenth of a radian each at most, for paths that catheters can take
)


class Path:
    """Path of an insertion: a curve by arc length from the guide's exit on, where it is at the origin and leaves along +x.

    Between the rows it is the cubic spline over s.

    Parameters
    ----------
    rows : array (m, 4), m
        Rows [s, x, y, z]; one of zeros is put before them where they do not begin at s = 0.
    """

    def __init__(self, rows: Array) -> None:
        from scipy.interpolate import CubicSpline  # 0.2 s to import, and only insertions have paths

        rows = np.asarray(rows, dtype=float)
        self.rows = rows if rows[0, 0] == 0 else np.vstack([np.zeros(4), rows])
        straight = np.array([1.0, 0.0, 0.0])
        self._spline = CubicSpline(
            self.rows[:, 0], self.rows[:, 1:], bc_type=((1, straight), "not-a-knot")
        )

    @property
    def length(self) -> float:
        """Its length, m."""
        return float(self.rows[-1, 0])

    @property
    def end(self) -> Array:
        """Its last point, (3,) m."""
        return np.asarray(self.rows[-1, 1:])

    def at(self, s: Array) -> Array:
        """Find points of the path.

        Parameters
        ----------
        s : array (n,), m
            Arc lengths.

        Returns
        -------
        array (n, 3), m
            The points there.
        """
        return np.asarray(self._spline(s))

    @cached_property
    def _fine(self) -> tuple[Array, Array]:
        """Arc lengths (PIECES_OF_FRAMES + 1,) and frames there, as quaternions, scalar first, (PIECES_OF_FRAMES + 1, 4)."""
        s = np.linspace(0.0, self.length, PIECES_OF_FRAMES + 1)
        tangent = self._spline(s, 1)
        tangent /= np.linalg.norm(tangent, axis=1)[:, None]
        axes = np.cross(tangent[:-1], tangent[1:])
        cosines = np.sum(tangent[:-1] * tangent[1:], axis=1)
        quaternions = np.empty((PIECES_OF_FRAMES + 1, 4))
        begin = 1.0 + tangent[0, 0]
        axis = np.cross([1.0, 0.0, 0.0], tangent[0])
        quaternions[0] = np.array([begin, *axis]) / np.linalg.norm([begin, *axis])
        for k in range(PIECES_OF_FRAMES):
            a, u, (b, *v) = 1.0 + cosines[k], axes[k], quaternions[k]
            q = np.array(
                [a * b - u @ v, *(a * np.array(v) + b * u + np.cross(u, v))]
            )  # the product
            quaternions[k + 1] = q / np.linalg.norm(q)
        return s, quaternions

    def flattened(self, share: float) -> Path:
        """Make the path that has a share of its curvature everywhere.

        Parameters
        ----------
        share : float, no unit
            0 is straight, 1 this path.

        Returns
        -------
        Path
            The flatter path.
        """
        from scipy.spatial.transform import (
            Rotation,
        )  # 0.2 s to import, and only insertions have paths

        s = self._fine[0]
        frame = np.eye(3)
        points = [np.zeros(3)]
        for half in Rotation.from_rotvec(share * self._turns / 2).as_matrix():
            middle = frame @ half
            points.append(points[-1] + s[1] * middle[:, 0])
            frame = middle @ half
        kept = slice(0, None, 4)
        return Path(np.column_stack([s[kept], np.array(points)[kept]]))

    @cached_property
    def _turns(self) -> Array:
        """Rotation vectors (PIECES_OF_FRAMES, 3) from each frame to the next, as the first sees them."""
        from scipy.spatial.transform import Rotation

        frames = Rotation.from_quat(self._fine[1][:, [1, 2, 3, 0]])
        return np.asarray((frames[:-1].inv() * frames[1:]).as_rotvec())

    def smallest_radius(self) -> float:
        """Find the radius of the sharpest bend.

        Returns
        -------
        float, m
            The radius; 1e300 where the path is straight.
        """
        s = np.linspace(0.0, self.length, PIECES_OF_FRAMES + 1)
        first = self._spline(s, 1)
        second = self._spline(s, 2)
        curvature = (
            np.linalg.norm(np.cross(first, second), axis=1) / np.linalg.norm(first, axis=1) ** 3
        )
        return float(1.0 / max(curvature.max(), 1e-300))
