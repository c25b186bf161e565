"""Which parts of a body are connected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def connected_components(touching: NDArray[np.bool_], cell: NDArray[np.integer], part: NDArray[np.integer]) -> NDArray[np.int64]:
    """Which connected component each particle (n,) is in, from 0.

    touching (parts, parts): which touch; cell (n, 3), part (n,): of each particle of the undeformed body. Two parts are connected
    where they touch and share a cell, or have cells that share a face.
    """
    from scipy.sparse import csgraph  # only for bodies of parts
    from scipy.spatial import cKDTree

    count = len(touching)
    box = (*(np.ptp(cell, axis=0) + 1).tolist(), count)
    full = np.unique(np.ravel_multi_index((*(cell - cell.min(axis=0)).T, part), box))
    *places, of = np.unravel_index(full, box)
    near = np.zeros((count, count), bool)
    pairs = of[cKDTree(np.column_stack(places)).query_pairs(1.01, output_type="ndarray")]  # the same cell, or neighbors by a face
    near[pairs[:, 0], pairs[:, 1]] = True
    number = csgraph.connected_components(near & touching, directed=False)[1]
    return np.asarray(np.asarray(number, np.int64)[part])
