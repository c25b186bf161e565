"""Large arrays get memory that another has left, and never memory that something still sees."""

import gc
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from magmpm.compiled import kept_memory
from magmpm.compiled.kept_memory import LEAST_BYTES_KEPT, MOST_BYTES_KEPT, WASTE, empty

MEGABYTE = 1 << 17  # entries


@pytest.fixture(autouse=True)
def nothing_kept(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    gc.collect()
    monkeypatch.setattr(kept_memory, "_free", {})
    yield
    gc.collect()  # arrays of a test give back to its own store


def place(array: np.ndarray) -> int:
    return array.ctypes.data


def test_the_memory_of_an_array_that_is_gone_is_used_again() -> None:
    one = empty((4, MEGABYTE))
    at = place(one)
    one[:] = 7.0
    del one
    again = empty((2, 2, MEGABYTE))
    assert (place(again), again.shape, again.dtype) == (at, (2, 2, MEGABYTE), np.float64)


def test_a_view_keeps_the_memory() -> None:
    """Also a view of a view, and one of another type: what a caller holds of an array never changes under it."""
    one = empty((4, MEGABYTE))
    one[:] = 7.0
    view = one[1:][1].view(np.float32)[:5]
    kept = view.copy()
    del one
    other = empty((4, MEGABYTE))
    other[:] = -1.0
    assert np.array_equal(view, kept)
    assert not np.shares_memory(view, other)


def test_a_small_array_does_not_take_the_place_of_a_large_one() -> None:
    large = empty((2 * WASTE * 2, MEGABYTE))
    at = place(large)
    del large
    small = empty((2, MEGABYTE))
    assert place(small) != at
    assert place(empty((2 * WASTE * 2, MEGABYTE))) == at


def test_what_waits_is_limited() -> None:
    """The oldest pieces go first; arrays below LEAST_BYTES_KEPT are none of its business."""
    pieces = [empty((MOST_BYTES_KEPT // 8 // 4 + k,)) for k in range(6)]
    while pieces:
        del pieces[0]
    assert sum(map(len, kept_memory._free.values())) <= MOST_BYTES_KEPT
    assert [
        len(piece) // 8 - MOST_BYTES_KEPT // 8 // 4 for piece in kept_memory._free.values()
    ] == [3, 4, 5]
    before = len(kept_memory._free)
    del pieces
    _ = empty((LEAST_BYTES_KEPT // 8 - 1,))
    del _
    assert len(kept_memory._free) == before


def test_threads_never_share_memory() -> None:
    def work(number: int) -> bool:
        for k in range(50):
            array = empty((1 + k % 3, MEGABYTE))
            array[:] = number
            if not (array == number).all():
                return False
        return True

    with ThreadPoolExecutor(4) as threads:
        assert all(threads.map(work, range(8)))
