"""The components of a body that can part: STL parts that touch as they are made are one component, and so is a body of any other kind."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from magmpm.bodies.assembly import Parts


def connected_components(parts: Parts | None, cell: NDArray[np.integer], part: NDArray[np.integer]) -> NDArray[np.int64]:
    """Which component each particle (n,) is of, from 0: parts whose boxes and cells touch are of one.

    parts: scene.body.parts; cell (n, 3), part (n,): of each particle of the undeformed body.
    """
    if parts is None:
        return np.zeros(len(part), np.int64)
    from scipy.sparse import csgraph  # only for such bodies
    from scipy.spatial import cKDTree

    first = cell.min(axis=0)
    box = (*(np.ptp(cell, axis=0) + 1).tolist(), len(parts.meshes))
    full = np.unique(np.ravel_multi_index((*(cell - first).T, part), box))
    *places, of = np.unravel_index(full, box)
    near = np.zeros((len(parts.meshes), len(parts.meshes)), bool)
    pairs = of[cKDTree(np.column_stack(places)).query_pairs(1.01, output_type="ndarray")]  # the same cell, or neighbours by a face
    near[pairs[:, 0], pairs[:, 1]] = True
    number = csgraph.connected_components(near & parts.touching(), directed=False)[1]
    found: NDArray[np.int64] = np.asarray(number, np.int64)[part]
    return found
