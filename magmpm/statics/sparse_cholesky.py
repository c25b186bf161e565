"""Cholesky factors of a sparse tangent, front by front (statics.elimination).

A front begins with the matrix's own blocks of its nodes, and with what the fronts below it pass on. Its own unknowns are eliminated
by dpotrf, dtrsm and dsyrk. Fronts of one depth share nothing, and threads take them in turn; each is the work of one thread, in a fixed
order, so that results do not depend on the number of threads.

Blocks are (size, size): 3 for a tangent; 1 where each axis has the same matrix, which then takes a 27th of the operations.
"""

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.by_address import addresses, call
from magmpm.compiled.jit import compiled, kernel, prange
from magmpm.statics.elimination import Fronts


@compiled
def _add_own(front, fronts, blocks, values, n):
    """Add the matrix's blocks of a front's own nodes to its columns."""
    size = blocks.shape[1]
    first = fronts.first[front]
    begin = size * size * fronts.at[front]
    for node in range(first, fronts.first[front + 1]):
        for block in range(fronts.block_first[node], fronts.block_first[node + 1]):
            row = size * fronts.block_place[block]
            for r in range(size):
                column = begin + (size * (node - first) + r) * n + row
                for c in range(size):
                    values[column + c] += blocks[block, r, c]


@compiled
def _add_passed(child, front, fronts, values, below, room, size):
    """Add what a child passes on: `below` is the room of its depth, `room` that of the front's depth."""
    begin = fronts.row_first[child] + fronts.first[child + 1] - fronts.first[child]
    end = fronts.row_first[child + 1]
    n = size * (fronts.row_first[front + 1] - fronts.row_first[front])
    own = size * (fronts.first[front + 1] - fronts.first[front])
    rest = n - own
    mine = size * size * fronts.at[front]
    passed = size * size * fronts.passed[front]
    source = size * size * fronts.passed[child]
    length = size * (end - begin)
    for q in range(begin, end):
        column = size * fronts.into[q]
        for k in range(size):
            if column < own:
                target = mine + (column + k) * n
                shift = 0
            else:
                target = passed + (column + k - own) * rest
                shift = own
            for r in range(q, end):
                there = target + size * fronts.into[r] - shift
                here = source + (size * (q - begin) + k) * length + size * (r - begin)
                if shift == 0:
                    for i in range(size):
                        values[there + i] += below[here + i]
                else:
                    for i in range(size):
                        room[there + i] += below[here + i]


@compiled
def _eliminate(front, fronts, blocks, values, rooms, fortran):
    """Fill a front, and eliminate its own unknowns. Returns LAPACK's info: 0 if they were positive definite."""
    size = blocks.shape[1]
    n = size * (fronts.row_first[front + 1] - fronts.row_first[front])
    own = size * (fronts.first[front + 1] - fronts.first[front])
    rest = n - own
    depth = fronts.depth[front]
    room = rooms[depth % 2]
    below = rooms[(depth + 1) % 2]
    at = size * size * fronts.at[front]
    passes = size * size * fronts.passed[front]
    values[at : at + n * own] = 0.0
    room[passes : passes + rest * rest] = 0.0
    _add_own(front, fronts, blocks, values, n)
    for k in range(fronts.child_first[front], fronts.child_first[front + 1]):
        _add_passed(fronts.child[k], front, fronts, values, below, room, size)
    potrf = fortran[0]
    trsm = fortran[1]
    syrk = fortran[2]
    sizes = np.array([n, own, rest, 0], np.int32)
    letters = np.array([82, 76, 84, 78], np.uint8)  # R L T N
    signs = np.array([1.0, -1.0])
    ld = sizes[0:].ctypes.data
    columns = sizes[1:].ctypes.data
    rows = sizes[2:].ctypes.data
    info = sizes[3:].ctypes.data
    right = letters[0:].ctypes.data
    lower = letters[1:].ctypes.data
    trans = letters[2:].ctypes.data
    plain = letters[3:].ctypes.data
    plus = signs[0:].ctypes.data
    minus = signs[1:].ctypes.data
    top = values[at:].ctypes.data
    call(potrf, (lower, columns, top, ld, info))
    if sizes[3] != 0 or rest == 0:
        return sizes[3]
    under = top + 8 * own
    call(trsm, (right, lower, trans, plain, rows, columns, plus, top, ld, under, ld))
    passed = room[passes:].ctypes.data
    call(syrk, (lower, plain, rows, columns, minus, under, ld, plus, passed, rows))
    return 0


@kernel
def _factor(fronts, blocks, values, rooms, fortran):
    """Factor into values. Returns -1, or the first node of a front that is not positive definite."""
    failed = np.zeros(len(fronts.depth), np.int64)
    for k in range(len(fronts.level_first) - 1):
        begin = fronts.level_first[k]
        for j in prange(fronts.level_first[k + 1] - begin):
            front = fronts.level[begin + j]
            failed[front] = _eliminate(front, fronts, blocks, values, rooms, fortran)
        for j in range(begin, fronts.level_first[k + 1]):
            if failed[fronts.level[j]] != 0:
                return fronts.first[fronts.level[j]]
    return -1


@compiled
def _substitute(front, fronts, values, x, work, back, fortran):
    """One step of the substitution: x (columns, size nodes) in place."""
    trsm = fortran[1]
    gemm = fortran[3]
    trsv = fortran[4]
    gemv = fortran[5]
    begin = fronts.row_first[front]
    end = fronts.row_first[front + 1]
    size = x.shape[1] // fronts.first[-1]
    n = size * (end - begin)
    own = size * (fronts.first[front + 1] - fronts.first[front])
    columns = x.shape[0]
    for column in range(columns):
        for q in range(begin, end):
            for i in range(size):
                work[column * n + size * (q - begin) + i] = x[column, size * fronts.rows[q] + i]
    sizes = np.array([n, own, n - own, columns, 1], np.int32)
    letters = np.array([76, 84, 78], np.uint8)  # L T N
    signs = np.array([1.0, -1.0])
    ld = sizes[0:].ctypes.data
    mine = sizes[1:].ctypes.data
    rest = sizes[2:].ctypes.data
    count = sizes[3:].ctypes.data
    inc = sizes[4:].ctypes.data
    left = letters[0:].ctypes.data
    trans = letters[1:].ctypes.data
    plain = letters[2:].ctypes.data
    plus = signs[0:].ctypes.data
    minus = signs[1:].ctypes.data
    way = trans if back else plain
    top = values[size * size * fronts.at[front] :].ctypes.data
    upper = work.ctypes.data
    under = top + 8 * own
    lower = upper + 8 * own
    for turn in range(2):
        if (
            (turn == 0) == back
        ):  # what the boundary has to do with the own unknowns: before their triangle on the way back, else after it
            if n == own:
                continue
            if columns == 1 and back:
                call(gemv, (trans, rest, mine, minus, under, ld, lower, inc, plus, upper, inc))
            elif columns == 1:
                call(gemv, (plain, rest, mine, minus, under, ld, upper, inc, plus, lower, inc))
            elif back:
                call(
                    gemm,
                    (trans, plain, mine, count, rest, minus, under, ld, lower, ld, plus, upper, ld),
                )
            else:
                call(
                    gemm,
                    (plain, plain, rest, count, mine, minus, under, ld, upper, ld, plus, lower, ld),
                )
        elif columns == 1:
            call(trsv, (left, way, plain, mine, top, ld, upper, inc))
        else:
            call(trsm, (left, left, way, plain, mine, count, plus, top, ld, upper, ld))
    last = begin + own // size if back else end  # on the way back the boundary is known
    for column in range(columns):
        for q in range(begin, last):
            for i in range(size):
                x[column, size * fronts.rows[q] + i] = work[column * n + size * (q - begin) + i]


@compiled
def _solve(fronts, values, x, fortran):
    """x (columns, size nodes), right-hand sides, in place -> solutions."""
    most = 0
    for front in range(len(fronts.depth)):
        most = max(most, fronts.row_first[front + 1] - fronts.row_first[front])
    work = np.empty(x.shape[1] // fronts.first[-1] * most * x.shape[0])
    count = len(fronts.depth)
    for front in range(count):
        _substitute(front, fronts, values, x, work, False, fortran)
    for step in range(count):
        _substitute(count - 1 - step, fronts, values, x, work, True, fortran)


def factor(fronts: Fronts, blocks: Array, values: Array, rooms: Array) -> int:
    """Write the Cholesky factors of blocks (blocks, size, size) to values; rooms (2, room): work space.

    Returns -1, or the first node (in the order of elimination) of a front that proved not positive definite.
    """
    return int(_factor(fronts, blocks, values, rooms, addresses()))


def solve_columns(fronts: Fronts, values: Array, right: Array) -> Array:
    """Solutions (k, size nodes) for right-hand sides (k, size nodes) in the order of elimination."""
    x = np.array(right, float, order="C")
    if len(x):
        _solve(fronts, values, x, addresses())
    return x
