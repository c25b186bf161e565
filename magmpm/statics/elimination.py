"""The order in which a sparse tangent is eliminated, and the dense fronts in which this is done.

Nodes (three unknowns each) that share an element are coupled. They are eliminated in an order that keeps the factors small; of three such
orders the one that two threads are done with first is taken. Eliminating a node couples all its neighbors that come later. Nodes in a row
with the same later neighbors form a front: a small dense matrix. Its first rows are the front's own nodes, which are eliminated in it;
the others, its boundary, pass what is left to one front above it, its parent. So the fronts form a forest. It is cut: the trees below
the cut are independent, and so are the fronts of one depth above it.

All of this depends on the pattern alone: it is found once for a body.
Sources: Duff and Reid, ACM Trans. Math. Softw. 9 (1983) 302 (multifrontal method); Liu, SIAM Review 34 (1992) 82 (supernodes and trees).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heapify, heappop, heappush
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Index
from magmpm.compiled.jit import compiled, kernel, prange

# zeros in a front joined with the one above it, over its entries, for which fewer and larger fronts
# are still quicker: of 0.03 to 0.3, for a slender prism, a gripper and a helix in four orders each
JOINED = 0.06


class Fronts(NamedTuple):
    """Fronts, in the order of their elimination, and the blocks (size, size) of the matrix that they start from.

    Nodes are numbered as they are eliminated.

    first (fronts + 1,): each front's own nodes are first[s] to first[s + 1].
    row_first (fronts + 1,), rows: its rows are rows[row_first[s] : row_first[s + 1]], its own nodes first.
    into: the place of each of these rows among the rows of the front's parent; -1 for its own nodes.
    at (fronts,): where its columns of the factors begin, (own unknowns, unknowns of the front), in blocks.
    passed (fronts,): where in the room of its depth begins what it passes on, (boundary, boundary), in blocks; depth (fronts,).
    child_first (fronts + 1,), child: the fronts that pass on to it.
    stage_first (stages + 1,), task_first (tasks + 1,), order: stages follow each other; tasks of one stage are independent, and each is
    fronts in a row. Tasks of the first stage are the trees below the cut, one or several; each other task is one front.
    tree (fronts,): the tree below the cut that it is of, -1 above it; above (nodes,): each node's place among those above the cut, or -1.
    block_first (nodes + 1,): first block of each node; block_place (blocks,): place of its later node in the front.
    """

    first: Index
    row_first: Index
    rows: Index
    into: Index
    at: Index
    passed: Index
    child_first: Index
    child: Index
    stage_first: Index
    task_first: Index
    order: Index
    tree: Index
    above: Index
    depth: Index
    block_first: Index
    block_place: Index


@dataclass(frozen=True)
class Elimination:
    """Plan to eliminate a pattern.

    number (nodes,): of each given node as it is eliminated; values, room: blocks of the factors and of the room of one depth;
    operations: multiplications and additions of one factorization with blocks (3, 3).
    """

    number: Index
    fronts: Fronts
    values: int
    room: int
    operations: float

    def blocks_of(self, elements: Index) -> NDArray[np.int32]:
        """Block (elements, k, k) that couples two nodes of an element, the first eliminated no later than the second; -1 otherwise.

        Raises ValueError for nodes that the pattern does not couple.
        """
        numbered = _numbered(self.number, elements)
        out = np.empty((*numbered.shape, numbered.shape[1]), np.int32)
        if _blocks(numbered, self.fronts.block_first, self._later, out) > 0:
            raise ValueError("an element couples nodes that no other element couples")
        return out

    @cached_property
    def _later(self) -> Index:
        """The later node of each block."""
        own = np.repeat(np.arange(len(self.number)), np.diff(self.fronts.block_first))
        front = np.searchsorted(self.fronts.first, own, side="right") - 1
        return self.fronts.rows[self.fronts.row_first[front] + self.fronts.block_place]


def elimination(elements: Sequence[Index], count: int) -> Elimination:
    """Plan to eliminate `count` nodes that are coupled in elements: tables (elements, k) whose rows have node numbers, or -1 for none.

    Where nodes are numbered plane by plane across a slender body, the order may be that of the planes.
    """
    coupled = _coupled(elements, count)
    number, first, structures = _with_order(*_best_order(coupled))
    return _laid_out(coupled, number, first, structures)


def _coupled(elements: Sequence[Index], count: int) -> Any:
    """The symmetric pattern (nodes, nodes), with its diagonal, as a sparse matrix of ones."""
    from scipy.sparse import (
        csr_matrix,
        identity,
    )  # 0.1 s to import, and straight bodies do not need it

    pattern = identity(count, format="csr")
    for table in elements:
        element, place = np.nonzero(table >= 0)
        holds = csr_matrix(
            (np.ones(len(element)), (element, table[element, place])), shape=(len(table), count)
        )
        pattern = pattern + holds.T @ holds
    pattern = pattern.tocsr()
    pattern.data[:] = 1.0
    pattern.sort_indices()
    return pattern


def _best_order(coupled: Any) -> tuple[Index, Index, Index, Index]:
    """The nodes in the order of elimination that two threads are done with first; with `_structures` of it.

    The same at any number of threads, so that results are.
    """
    found = [(order, *_structures_in(coupled, order)) for order in _orders(coupled)]
    return min(found, key=lambda one: _way(np.diff(one[1]), one[3]))


def _way(lengths: Index, parent: Index) -> float:
    """Operations that two threads wait for: half of all, or those of the longest way from a first node to a last one.

    A column of the factors takes as many operations as its length squared.
    """
    work = (lengths + 1.0) ** 2
    before = np.zeros(len(parent))
    longest = 0.0
    for node, above in enumerate(parent):
        done = before[node] + work[node]
        longest = max(longest, done)
        if above >= 0:
            before[above] = max(before[above], done)
    return max(longest, float(work.sum()) / 2)


def _orders(coupled: Any) -> list[Index]:
    """Orders of elimination, each the nodes in turn."""
    from scipy.sparse import identity
    from scipy.sparse.csgraph import reverse_cuthill_mckee
    from scipy.sparse.linalg import spilu

    count = coupled.shape[0]
    # It needs no pivoting, so that the order is the pattern's.
    dominant = (identity(count) * (2.0 * count) - coupled).tocsc()
    # Nothing is filled in: only the order is wanted, of minimum degree.
    minimum_degree = spilu(
        dominant,
        permc_spec="MMD_AT_PLUS_A",
        options={"SymmetricMode": True},
        drop_tol=1.0,
        fill_factor=1,
        diag_pivot_thresh=0.0,
    ).perm_c
    # Planes across the longest side of the grid, or bands, are eliminated from both ends at once: what comes from each meets in the middle.
    planes = np.arange(count)
    bands = np.asarray(reverse_cuthill_mckee(coupled, symmetric_mode=True), np.int64)
    half = count // 2
    from_both_ends = [np.concatenate([each[:half], each[half:][::-1]]) for each in (planes, bands)]
    return [np.argsort(minimum_degree), *from_both_ends]


def _structures_in(coupled: Any, order: Index) -> tuple[Index, Index, Index]:
    """`_structures` of the nodes in an order."""
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order))
    indptr = coupled.indptr.astype(np.int64)
    return _structures(indptr, coupled.indices.astype(np.int64), place, order)


def _with_order(
    order: Index, start: Index, rows: Index, parent: Index
) -> tuple[Index, Index, list[Index]]:
    """Number of each node in an order whose fronts are in a row, first node of each front, and the rows of each; given `_structures`."""
    places = _postorder(parent)  # children before their parent, and next to it
    number = np.empty(len(order), np.int64)
    new = np.empty(len(order), np.int64)
    new[places] = np.arange(len(order))
    number[order] = new
    columns = [np.sort(new[rows[start[j] : start[j + 1]]]) for j in places]
    return number, *_joined(columns)


@compiled
def _structures(indptr, indices, place, order):  # type: ignore[no-untyped-def]
    """Return of each node, in order: where its rows begin (nodes + 1,), rows: the later nodes that it is coupled to when it is eliminated,
    in order, and the first of them (nodes,), -1 for none. indptr, indices: of the pattern; place (nodes,): of each in the order.
    """
    count = len(order)
    start = np.zeros(count + 1, np.int64)
    rows = np.empty(4 * len(indices), np.int64)
    parent = np.full(count, -1)
    seen = np.full(count, -1)
    # the children of a node: the first, and of each child the next one
    child = np.full(count, -1)
    sibling = np.full(count, -1)
    for j in range(count):
        end = start[j]
        if end + count > len(rows):
            more = np.empty(2 * len(rows) + count, np.int64)
            more[:end] = rows[:end]
            rows = more
        for k in range(indptr[order[j]], indptr[order[j] + 1]):
            row = place[indices[k]]
            if row > j and seen[row] != j:
                seen[row] = j
                rows[end] = row
                end += 1
        below = child[j]
        while below >= 0:
            for k in range(start[below], start[below + 1]):
                row = rows[k]
                if row > j and seen[row] != j:
                    seen[row] = j
                    rows[end] = row
                    end += 1
            below = sibling[below]
        start[j + 1] = end
        if end > start[j]:
            parent[j] = rows[start[j] : end].min()
            sibling[j] = child[parent[j]]
            child[parent[j]] = j
    return start, rows[: start[count]], parent


def _postorder(parent: Index) -> Index:
    """The nodes of a forest, each after all that are below it."""
    children: list[list[int]] = [[] for _ in parent]
    roots: list[int] = []
    for node, above in enumerate(parent):
        (roots if above < 0 else children[above]).append(node)
    out = []
    stack = [(root, False) for root in reversed(roots)]
    while stack:
        node, done = stack.pop()
        if done:
            out.append(node)
            continue
        stack.append((node, True))
        stack += [(child, False) for child in reversed(children[node])]
    return np.array(out, np.int64)


def _joined(columns: list[Index]) -> tuple[Index, list[Index]]:
    """First node of each front, and its rows, from the later nodes of each node in postorder.

    A front is joined with the one above it where both are next to each other and few zeros come in.
    """
    fronts: list[tuple[int, int, Index, int]] = []  # first node, one past the last, boundary, zeros
    for j, later in enumerate(columns):
        fronts.append((j, j + 1, later, 0))
        while len(fronts) > 1:
            (low, middle, below, some), (_, high, boundary, others) = fronts[-2:]
            if not len(below) or below[0] != middle:  # it passes on to another one
                break
            zeros = some + others + (middle - low) * (high - middle + len(boundary) - len(below))
            if zeros > JOINED * (high - low) * (high - low + len(boundary)):
                break
            fronts[-2:] = [(low, high, boundary, zeros)]
    first = np.array([low for low, *_ in fronts] + [len(columns)], np.int64)
    return first, [
        np.concatenate([np.arange(low, high), boundary]) for low, high, boundary, _ in fronts
    ]


def _work(own: Array, whole: Array) -> Array:
    """Multiplications and additions of each front: of each own column, the square of its length below and on the diagonal."""
    rest = whole - own
    return np.asarray(
        (whole * (whole + 1) * (2 * whole + 1) - rest * (rest + 1) * (2 * rest + 1)) / 6
    )


def _laid_out(coupled: Any, number: Index, first: Index, structures: list[Index]) -> Elimination:
    """Lay everything out, for the order of `number`."""
    own = np.diff(first)
    count = np.array([len(rows) for rows in structures])
    rest = count - own
    front_of = np.repeat(np.arange(len(own)), own)
    above = np.array(
        [
            front_of[rows[k]] if len(rows) > k else -1
            for rows, k in zip(structures, own, strict=True)
        ]
    )
    into = []
    for rows, mine, parent in zip(structures, own, above, strict=True):
        boundary = rows[mine:]
        places = np.searchsorted(structures[parent], boundary) if parent >= 0 else boundary
        into.append(np.concatenate([np.full(mine, -1), places]))
    depth = np.zeros(len(own), np.int64)
    for front in reversed(range(len(own))):
        depth[front] = 0 if above[front] < 0 else depth[above[front]] + 1
    work = _work(3.0 * own, 3.0 * count)
    tree = _trees_below(above, work)
    passed, room = _rooms(tree, depth, rest**2)
    child = np.argsort(above, kind="stable")[int((above < 0).sum()) :]
    child_first = np.concatenate(
        [[0], np.cumsum(np.bincount(above[above >= 0], minlength=len(own)))]
    )
    sizes = own * count
    row_first = np.concatenate([[0], np.cumsum(count)])
    block_first, later = _upper(coupled, number)
    rows = np.concatenate(structures)
    holder = front_of[np.repeat(np.arange(len(number)), np.diff(block_first))]
    place = _places(rows, row_first, holder, later, len(number))
    fronts = Fronts(
        first,
        row_first,
        rows,
        np.concatenate(into),
        np.cumsum(sizes) - sizes,
        passed,
        child_first,
        child,
        *_stages(tree, depth, work, numba.get_num_threads()),
        tree,
        np.where(tree[front_of] < 0, np.cumsum(tree[front_of] < 0) - 1, -1),
        depth,
        block_first,
        place,
    )
    return Elimination(number, fronts, int(sizes.sum()), room, float(work.sum()))


def _trees_below(above: Index, work: Array, threads: int = 2) -> Index:
    """Cut a forest where so many threads are done with it first: of each front the tree below the cut that it is of, or -1 above it.

    Sums over trees depend on the cut, so it does not depend on the threads that there are.
    """
    whole = work.copy()  # of a front and all below it
    children: list[list[int]] = [[] for _ in above]
    roots = []
    for front, parent in enumerate(above):  # a front's children come before it
        if parent < 0:
            roots.append((-whole[front], front))
        else:
            whole[parent] += whole[front]
            children[parent].append(front)
    total = -sum(size for size, _ in roots)
    heapify(roots)
    before = 0.0  # work above the cut
    least = np.inf
    cut: list[int] = []
    kept = 0
    while roots and before < least:
        wait = before + max(-roots[0][0], (total - before) / threads)
        if wait < least:
            least = wait
            kept = len(cut)
        front = heappop(roots)[1]
        cut.append(front)
        before += work[front]
        for child in children[front]:
            heappush(roots, (-whole[child], child))
    top = set(cut[:kept])
    tree = np.full(len(above), -1)
    trees = 0
    for front in reversed(range(len(above))):
        if front in top:
            continue
        parent = above[front]
        if parent < 0 or parent in top:
            tree[front] = trees
            trees += 1
        else:
            tree[front] = tree[parent]
    return tree


def _rooms(tree: Index, depth: Index, sizes: Index) -> tuple[Index, int]:
    """Find the place of each front's numbers in the room of its depth, and the room's size: each tree has its own part of both rooms."""
    begin = np.zeros(len(tree), np.int64)
    room = 0
    for one in range(-1, tree.max(initial=-1) + 1):
        mine = np.flatnonzero(tree == one)
        largest = 0
        for level in np.unique(depth[mine]):
            here = mine[depth[mine] == level]
            ends = np.cumsum(sizes[here])
            begin[here] = room + ends - sizes[here]
            largest = max(largest, int(ends[-1]))
        room += largest
    return begin, room


def _stages(tree: Index, depth: Index, work: Array, threads: int) -> tuple[Index, Index, Index]:
    """Stages and tasks (Fronts): trees below the cut are shared among threads, the largest first."""
    busy = np.zeros(threads)
    of_thread: list[list[Index]] = [[] for _ in range(threads)]
    deepest_first = np.argsort(-depth, kind="stable")
    trees = [deepest_first[tree[deepest_first] == one] for one in range(tree.max(initial=-1) + 1)]
    for fronts in sorted(trees, key=lambda fronts: -work[fronts].sum()):
        free = int(np.argmin(busy))
        busy[free] += work[fronts].sum()
        of_thread[free].append(fronts)
    tasks = [np.concatenate(fronts) for fronts in of_thread if fronts]
    ends = [0, len(tasks)]
    above = deepest_first[tree[deepest_first] < 0]
    for level in np.unique(-depth[above]):
        tasks += list(above[-depth[above] == level, None])
        ends.append(len(tasks))
    lengths = [len(fronts) for fronts in tasks]
    return np.array(ends), np.concatenate([[0], np.cumsum(lengths)]), np.concatenate(tasks)


def _places(rows: Index, row_first: Index, holder: Index, node: Index, nodes: int) -> Index:
    """The place of nodes among the rows of the fronts that hold them: rows are sorted within each front, so all are by one key."""
    key = np.repeat(np.arange(len(row_first) - 1), np.diff(row_first)) * nodes + rows
    return np.searchsorted(key, holder * nodes + node) - row_first[holder]


def _upper(coupled: Any, number: Index) -> tuple[Index, Index]:
    """The pattern's upper triangle in the order of elimination: first block of each node, and the later node of each block."""
    pairs = coupled.tocoo()
    a = number[pairs.row]
    b = number[pairs.col]
    upper = a <= b
    key = np.sort(a[upper] * len(number) + b[upper])
    first = np.searchsorted(key, np.arange(len(number) + 1) * len(number))
    return first, key % len(number)


def _numbered(number: Index, elements: Index) -> Index:
    """Elements with their nodes numbered as they are eliminated; -1 stays."""
    return np.where(elements >= 0, number[np.maximum(elements, 0)], -1)


@kernel
def _blocks(elements, block_first, later, out):  # type: ignore[no-untyped-def]
    """Write the block of each two nodes of each element (Elimination.blocks_of) to out (elements, k, k).

    Returns the number of those that no element of the pattern couples.
    """
    missing = 0
    for e in prange(len(elements)):
        for i, one in enumerate(elements[e]):
            for j, other in enumerate(elements[e]):
                out[e, i, j] = -1
                if one < 0 or one > other:
                    continue
                end = block_first[one + 1]
                at = block_first[one] + np.searchsorted(later[block_first[one] : end], other)
                if at < end and later[at] == other:
                    out[e, i, j] = at
                else:
                    missing += 1
    return missing
