"""The sparse factorization against dense algebra: solutions, what is not positive definite, and the same bits on any number of threads."""

import numba
import numpy as np
import pytest

from magmpm.statics import sparse_cholesky
from magmpm.statics.elimination import Elimination, elimination

CHAIN = np.array([[k, k + 1, k + 2] for k in range(30)])
STAR = np.concatenate(
    [CHAIN[:9], CHAIN[:9] + 11, CHAIN[:9] + 22, [[10, 21, 32]]]
)  # three arms that meet
RING = np.array([[k, (k + 1) % 24, (k + 2) % 24, -1] for k in range(24)])
APART = np.concatenate([CHAIN[:5], CHAIN[:5] + 7])  # two bodies that share nothing
PATTERNS = {"chain": CHAIN, "star": STAR, "ring": RING, "apart": APART, "one": np.array([[0, -1]])}


def drawn(
    elements: np.ndarray, seed: int, size: int = 3
) -> tuple[Elimination, np.ndarray, np.ndarray]:
    """How to eliminate a pattern, blocks of a positive definite matrix of it, and the matrix, dense, in the order of elimination."""
    count = int(elements.max()) + 1
    order = elimination([elements], count)
    rng = np.random.default_rng(seed)
    blocks = np.zeros((int(order.fronts.block_first[-1]), size, size))
    dense = np.zeros((count, size, count, size))
    for element, block in zip(elements, order.blocks_of(elements), strict=True):
        nodes = element[element >= 0]
        root = rng.standard_normal((size * len(nodes), size * len(nodes)))
        matrix = (root @ root.T + np.eye(len(root))).reshape(len(nodes), size, len(nodes), size)
        number = order.number[nodes]
        dense[number[:, None], :, number[None, :], :] += matrix.transpose(0, 2, 1, 3)
        for a in range(len(nodes)):
            for b in range(len(nodes)):
                if block[a, b] >= 0:
                    blocks[block[a, b]] += matrix[a, :, b]
    return order, blocks, dense.reshape(size * count, size * count)


def factored(order: Elimination, blocks: np.ndarray) -> tuple[int, np.ndarray]:
    size = blocks.shape[1]
    # whatever was there
    values = np.full(size**2 * order.values, np.nan)
    rooms = np.full((2, size**2 * max(order.room, 1)), np.nan)
    return sparse_cholesky.factor(order.fronts, blocks, values, rooms), values


@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.parametrize("name", PATTERNS)
def test_it_solves_what_dense_algebra_solves(name: str, size: int) -> None:
    order, blocks, dense = drawn(PATTERNS[name], 1, size)
    failed, values = factored(order, blocks)
    assert failed == -1
    right = np.random.default_rng(2).standard_normal((4, len(dense)))
    expected = np.linalg.solve(dense, right.T).T
    allowed = 1e-13 * np.linalg.cond(dense) * np.abs(expected).max()  # rounding of either
    np.testing.assert_allclose(
        sparse_cholesky.solve_columns(order.fronts, values, right), expected, rtol=0, atol=allowed
    )
    np.testing.assert_allclose(
        sparse_cholesky.solve_columns(order.fronts, values, right[:1]),
        expected[:1],
        rtol=0,
        atol=allowed,
    )
    assert sparse_cholesky.solve_columns(order.fronts, values, right[:0]).shape == (0, len(dense))


@pytest.mark.parametrize("name", PATTERNS)
def test_a_matrix_with_a_negative_eigenvalue_has_no_factors(name: str) -> None:
    """Shifted to just below and just above its smallest eigenvalue, by 1e-6 of it."""
    order, blocks, dense = drawn(PATTERNS[name], 3)
    smallest = np.linalg.eigvalsh(dense)[0]
    for share, definite in ((1 - 1e-6, True), (1 + 1e-6, False)):
        shifted = blocks.copy()
        shifted[order.fronts.block_first[:-1]] -= share * smallest * np.eye(3)
        assert (factored(order, shifted)[0] == -1) == definite


@pytest.mark.parametrize("name", ["chain", "star"])
def test_results_do_not_depend_on_threads(name: str) -> None:
    """Neither on those that there are as the order is planned, nor on those that factor and solve."""
    before = numba.get_num_threads()
    found = []
    try:
        for threads in (1, before):
            numba.set_num_threads(threads)
            order, blocks, dense = drawn(PATTERNS[name], 4)
            values = factored(order, blocks)[1]
            right = np.random.default_rng(5).standard_normal((2, len(dense)))
            solved = sparse_cholesky.solve_columns(order.fronts, values, right)
            found.append(np.concatenate([values, solved.ravel()]))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*found)


def test_trees_below_the_cut_share_nothing() -> None:
    """A chain is cut in its middle: each half is a tree, and neither couples to the other."""
    long = np.array([[k, k + 1, k + 2] for k in range(200)])
    fronts = elimination([long], 202).fronts
    assert fronts.tree.max() == 1, "two halves"
    halves = []
    for one in (0, 1):
        mine = np.flatnonzero(fronts.tree == one)
        rows = [fronts.rows[fronts.row_first[s] : fronts.row_first[s + 1]] for s in mine]
        halves.append({int(node) for node in np.concatenate(rows) if fronts.above[node] < 0})
    assert halves[0].isdisjoint(halves[1])
    assert min(len(half) for half in halves) > 80
    assert sorted(fronts.order) == list(range(len(fronts.tree)))


def test_a_chain_costs_a_chain() -> None:
    """Operations grow with its length: twenty times as many nodes take twenty times as many, to within the ends' share."""
    cost = [
        elimination([np.array([[k, k + 1, k + 2] for k in range(n)])], n + 2).operations
        for n in (50, 1000)
    ]
    assert cost[1] / cost[0] == pytest.approx(20, rel=0.3)


def test_nodes_that_no_element_couples_are_refused() -> None:
    order = elimination([CHAIN], 32)
    with pytest.raises(ValueError, match="no other element couples"):
        order.blocks_of(np.array([[0, 20]]))
