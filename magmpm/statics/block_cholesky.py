"""The tangent as a block-banded matrix, and its Cholesky factors.

Unknowns are numbered plane by plane along the grid's first axis, m in each plane. A cell couples three planes, so block row j has
block columns j - 2 to j + 2. Two threads eliminate the matrix from both ends at once, toward two planes `split` and `split` + 1 in the
middle. The halves share nothing. Panel j holds column block j as (m, 3 m), row index fastest:

* forward half, j < split: rows of planes j, j + 1, j + 2;
* backward half, j > split + 1: rows of planes j, j - 1, j - 2;
* the middle: `split` holds rows of split and split + 1, `split` + 1 its own.

Only the lower triangle of each diagonal block is used. Results do not depend on the number of threads.
This takes 19/3 m^3 operations for each plane, nearly all in dtrsm, dsyrk and dgemm on blocks of size m. A general banded solver with
half-width 3 m would work in strips of 32. Source: Golub and Van Loan, Matrix Computations, 4th ed., sections 4.3 and 4.5.1.
"""

import numpy as np
from numpy.typing import NDArray

from magmpm.compiled.arrays import Array, Mask
from magmpm.compiled.by_address import addresses, call
from magmpm.compiled.jit import inner, kernel, prange
from magmpm.compiled.kept_memory import empty

Single = NDArray[np.float32]


def split_plane(planes: int) -> int:
    """First of the two middle planes. The lengths of the halves differ by at most one plane."""
    return max((planes - 2) // 2, 0)


def new_panels(planes: int, m: int) -> Array:
    """Panels (planes + 2, m, 3 m) with any content: one for each plane, and two for what the backward half adds to the middle."""
    return empty((planes + 2, m, 3 * m))


def panel_bytes(planes: int, m: int) -> float:
    """Memory that `new_panels` takes."""
    return 24.0 * (planes + 2) * m**2


@kernel
def clear(panels):
    """Set panels to zero. Two threads, because the first touch of fresh memory takes longer than anything that is written to it."""
    for j in prange(panels.shape[0]):
        panels[j] = 0.0


@kernel
def _round(panels, rounded):
    """Entries of panels (planes + 2, m, 3 m) as the first half of each row of the same memory in single precision."""
    count = panels.shape[2]
    for j in prange(panels.shape[0]):
        row = np.empty(count, np.float32)
        for a in range(panels.shape[1]):
            for b in range(count):
                row[b] = panels[j, a, b]
            for b in range(count):
                rounded[j, a, b] = row[b]


def rounded(panels: Array) -> Single:
    """The panels in single precision, (planes + 2, m, 6 m) with 3 m entries in each row, in their own memory: they are overwritten.

    Their factors take half the time, and are right to some 1e-7 of the stiffest mode: good for steps whose residuals are not rounded.
    """
    single = panels.view(np.float32)
    _round(panels, single)
    return single


def fix(panels: Array, split: int, fixed: Mask) -> None:
    """Fix these unknowns (planes, m) at zero in unfactored panels: replace their rows and columns by those of a multiple of the identity.

    The multiple is the largest diagonal entry, so neither scale nor definiteness changes.
    """
    planes, m = fixed.shape
    largest = np.einsum("jaa->ja", panels[:planes, :, :m]).max()
    at = [np.flatnonzero(row) for row in fixed]
    for j in range(planes):
        step = 1 if j < split + 2 else -1
        panels[j, at[j]] = 0.0
        for k in range(3):
            if 0 <= j + step * k < planes and len(at[j + step * k]):
                panels[j][:, k * m + at[j + step * k]] = 0.0
        panels[j, at[j], at[j]] = largest


@inner
def _signs(panels):
    """1 and -1, in the precision of the panels."""
    work = np.ones(2, panels.dtype)
    work[1] = -1.0
    return work


@inner
def _eliminate(panels, j, one, two, m, fortran, work, sizes, letters):
    """Factor panel j in place and update panels `one` and `two` (its next two planes; negative: none). Returns LAPACK's info."""
    potrf = fortran[0]
    trsm = fortran[1]
    syrk = fortran[2]
    gemm = fortran[3]
    byte = panels.itemsize
    n = sizes[0:].ctypes.data
    ld = sizes[1:].ctypes.data
    two_n = sizes[2:].ctypes.data
    info = sizes[3:].ctypes.data
    right = letters[0:].ctypes.data
    lower = letters[1:].ctypes.data
    trans = letters[2:].ctypes.data
    plain = letters[3:].ctypes.data
    plus = work[0:].ctypes.data
    minus = work[1:].ctypes.data
    top = panels[j].ctypes.data
    call(potrf, (lower, n, top, ld, info))
    if sizes[3] != 0 or one < 0:
        return sizes[3]
    rows = n if two < 0 else two_n
    below = top + byte * m
    call(trsm, (right, lower, trans, plain, rows, n, plus, top, ld, below, ld))
    next_top = panels[one].ctypes.data
    call(syrk, (lower, plain, n, n, minus, below, ld, plus, next_top, ld))
    if two >= 0:
        last = below + byte * m
        call(
            gemm, (plain, trans, n, n, n, minus, last, ld, below, ld, plus, next_top + byte * m, ld)
        )
        call(syrk, (lower, plain, n, n, minus, last, ld, plus, panels[two].ctypes.data, ld))
    return 0


@kernel
def _factor(panels, split, fortran):
    """Cholesky in place. Returns -1, or the plane whose pivot block is not positive definite."""
    planes = panels.shape[0] - 2
    m = panels.shape[1]
    failed = np.array([-1, -1])
    panels[planes:] = 0.0
    for half in prange(2):
        sizes = np.array([m, panels.shape[2], 2 * m, 0], np.int32)
        letters = np.array([82, 76, 84, 78], np.uint8)  # R L T N
        work = _signs(panels)
        if half == 0:
            for j in range(split):
                if _eliminate(panels, j, j + 1, j + 2, m, fortran, work, sizes, letters) != 0:
                    failed[0] = j
                    break
        else:
            for step in range(planes - split - 2):
                j = planes - 1 - step
                one = j - 1
                two = j - 2
                one = (
                    planes if one == split + 1 else one
                )  # the middle planes: this half has its own copy
                two = planes + (split + 1 - two) if two <= split + 1 else two
                if _eliminate(panels, j, one, two, m, fortran, work, sizes, letters) != 0:
                    failed[1] = j
                    break
    for half in range(2):
        if failed[half] >= 0:
            return failed[half]
    for a in range(m):
        for b in range(m):
            panels[split + 1, a, b] += panels[planes, a, b]
            panels[split, a, b] += panels[planes + 1, a, b]
            panels[split, a, m + b] += panels[planes, b, m + a]
    sizes = np.array([m, panels.shape[2], 2 * m, 0], np.int32)
    letters = np.array([82, 76, 84, 78], np.uint8)
    work = _signs(panels)
    none = -m  # as in _solve
    if _eliminate(panels, split, split + 1, none, m, fortran, work, sizes, letters) != 0:
        return split
    if _eliminate(panels, split + 1, none, none, m, fortran, work, sizes, letters) != 0:
        return split + 1
    return -1


@inner
def _words(panels, x):
    """Arguments of BLAS: sizes, letters and signs."""
    # L T N
    sizes = np.array([x.shape[2], panels.shape[2], 1, x.shape[1]], np.int32)
    letters = np.array([76, 84, 78], np.uint8)
    return sizes, letters, _signs(panels)


@inner
def _reduce(panels, x, j, one, two, back, fortran, words):
    """One step of the substitution with panel j, forward or back: x (planes, columns, m) in place."""
    sizes, letters, work = words
    trsm = fortran[1]
    gemm = fortran[3]
    trsv = fortran[4]
    gemv = fortran[5]
    m = x.shape[2]
    columns = x.shape[1]
    n = sizes[0:].ctypes.data
    ld = sizes[1:].ctypes.data
    inc = sizes[2:].ctypes.data
    count = sizes[3:].ctypes.data
    lower = letters[0:].ctypes.data
    plain = letters[2:].ctypes.data
    way = letters[1:].ctypes.data if back else plain
    plus = work[0:].ctypes.data
    minus = work[1:].ctypes.data
    top = panels[j].ctypes.data
    xj = x[j].ctypes.data
    for turn in range(2):
        if (
            (turn == 0) == back
        ):  # what the next two planes have to do with this one: before its own triangle on the way back, else after
            for k in range(2):
                other = one if k == 0 else two
                if other >= 0:
                    block = top + panels.itemsize * m * (k + 1)
                    there = x[other].ctypes.data
                    source, target = (there, xj) if back else (xj, there)
                    if columns == 1:
                        call(gemv, (way, n, n, minus, block, ld, source, inc, plus, target, inc))
                    else:
                        call(
                            gemm,
                            (way, plain, n, count, n, minus, block, ld, source, n, plus, target, n),
                        )
        elif columns == 1:
            call(trsv, (lower, way, plain, n, top, ld, xj, inc))
        else:
            call(
                trsm, (lower, lower, way, plain, n, count, plus, top, ld, xj, n)
            )  # the first L: from the left


@inner
def _reduce_half(panels, x, half, back, split, fortran):
    """Substitute in one half: from its end to the middle, or back. Rows of x past `planes` are the second half's copy of the middle."""
    planes = panels.shape[0] - 2
    words = _words(panels, x)
    count, ahead = (split, 1) if half == 0 else (planes - split - 2, -1)
    for step in range(count):
        far = count - 1 - step if back else step
        j = far if half == 0 else planes - 1 - far
        one = j + ahead
        two = j + 2 * ahead
        if half == 1 and not back:
            one = planes if one == split + 1 else one
            two = planes + split + 1 - two if two <= split + 1 else two
        _reduce(panels, x, j, one, two, back, fortran, words)


@kernel
def _solve(panels, split, x, fortran):
    """x (planes + 2, columns, m) in place: right-hand sides -> solutions."""
    planes = panels.shape[0] - 2
    columns = x.shape[1]
    m = x.shape[2]
    x[planes:] = 0.0
    # no plane: of a number that the compiler knows, such as -1, it would make a function of its own
    none = -m
    words = _words(panels, x)
    for back in (False, True):
        if back:
            for column in range(columns):
                for a in range(m):
                    x[split + 1, column, a] += x[planes, column, a]
                    x[split, column, a] += x[planes + 1, column, a]
            for turn in range(4):
                first = turn == 0 or turn == 3
                _reduce(
                    panels,
                    x,
                    split if first else split + 1,
                    split + 1 if first else none,
                    none,
                    turn > 1,
                    fortran,
                    words,
                )
        for half in prange(2):
            _reduce_half(panels, x, half, back, split, fortran)


def _routines(panels: Array | Single) -> tuple[int, ...]:
    return addresses("d" if panels.dtype == np.float64 else "s")


def factor(panels: Array | Single, split: int) -> int:
    """Cholesky factors in place of panels (planes + 2, m, 3 m), or of `rounded` ones.

    Returns -1, or the plane at which the matrix proved not positive definite (the panels are then overwritten).
    """
    return int(_factor(panels, split, _routines(panels)))


def solve(panels: Array | Single, split: int, right: Array) -> Array:
    """Solution (planes, m) for a right-hand side (planes, m), from factored panels."""
    single = panels.dtype == np.float32
    size = (float(np.abs(right).max()) or 1.0) if single else 1.0  # single precision ends at 1e-38
    return solve_columns(panels, split, right[:, None] / size)[:, 0] * size


def solve_columns(panels: Array | Single, split: int, right: Array) -> Array:
    """Solutions (planes, k, m) for k right-hand sides at once (planes, k, m), from factored panels."""
    planes, columns, m = right.shape
    x = np.zeros((planes + 2, columns, m), panels.dtype)
    x[:planes] = right
    if columns:
        _solve(panels, split, x, _routines(panels))
    return np.asarray(x[:planes], float)
