"""Large work arrays, whose memory the next one uses again.

The system hands out memory a page at a time, as it is first touched, and clears each page: the tangent of a catheter with 8 cells across
has 165 MB, which take 0.02 to 0.4 s to touch first (most on virtual machines) and 0.006 s from then on. Searches and viewers make dozens.
"""

import math
import mmap
import weakref
from contextlib import suppress

import numpy as np

from magmpm.compiled.arrays import Array

LEAST_BYTES_KEPT = 1 << 20  # bytes: below, the allocator keeps the memory itself
MOST_BYTES_KEPT = 1 << 29  # bytes that wait for their next use
WASTE = 2  # an array may get up to so many times the memory that it needs

_free: dict[
    int, mmap.mmap
] = {}  # by identity, oldest first; single operations on it are safe between threads


def empty(shape: tuple[int, ...]) -> Array:
    """An array (float64) with any content, as from numpy.empty. Once neither it nor a view of it is in use, another may get its memory."""
    size = 8 * math.prod(shape)
    if size < LEAST_BYTES_KEPT:
        return np.empty(shape)
    memory = _taken(size) or _mapped(size)
    # Its base is no array (as that of a memoryview of one would be), so NumPy makes views refer to this array, and they keep it alive.
    array: Array = np.ndarray(shape, np.float64, buffer=memory)
    weakref.finalize(array, _give_back, memory).atexit = False  # type: ignore[misc]
    return array


def _mapped(size: int) -> mmap.mmap:
    """Fresh memory, in pages of 2 MiB where the system has them. Raises MemoryError where there is none."""
    try:
        memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    except OSError as error:
        raise MemoryError(f"{size} bytes: {error.strerror}") from None
    if hasattr(mmap, "MADV_HUGEPAGE"):  # Linux
        with suppress(OSError):  # a kernel without them
            memory.madvise(mmap.MADV_HUGEPAGE)
    return memory


def _taken(size: int) -> mmap.mmap | None:
    """The smallest piece that will do, which is then no longer free; None where there is none."""
    for piece in sorted(_free.copy().values(), key=len):
        if size <= len(piece) <= WASTE * size and _free.pop(id(piece), None) is not None:
            return piece
    return None


def _give_back(memory: mmap.mmap) -> None:
    """Keep the pieces that came last."""
    _free[id(memory)] = memory
    pieces = list(_free.values())
    too_much = sum(map(len, pieces)) - MOST_BYTES_KEPT
    for piece in pieces:
        if too_much > 0 and _free.pop(id(piece), None) is not None:
            too_much -= len(piece)
