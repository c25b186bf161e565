"""Cholesky factors of a sparse tangent, front by front (statics.elimination).

A front begins with the matrix's own blocks of its nodes, and with what the fronts below it pass on. Its own unknowns are eliminated
by dpotrf, dtrsm and dsyrk. Threads take the trees below the cut (Fronts), and then the fronts of each depth above it; each is the work of
one thread, in a fixed order, so that results do not depend on the number of threads.

Blocks are (size, size): 3 for a tangent; 1 where each axis has the same matrix, which then takes a 27th of the operations.
"""

import numpy as np

from magmpm.compiled.arrays import Array
from magmpm.compiled.by_address import addresses, call
from magmpm.compiled.jit import compiled, inner, task_body
from magmpm.compiled.parallel import over_parts, task
from magmpm.statics.elimination import Fronts


@inner
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


@inner
def _add_passed(child, front, fronts, below, out, boundary, size):
    """Add what a child passes on to its parent's own columns in the factors, or to those of its boundary in the room of its depth.

    out: the factors, or that room; below: the room of the child's depth.
    """
    own = fronts.first[front + 1] - fronts.first[front]
    first = own if boundary else 0
    begin = size * size * (fronts.passed[front] if boundary else fronts.at[front])
    low = fronts.row_first[child] + fronts.first[child + 1] - fronts.first[child]
    high = fronts.row_first[child + 1]
    length = size * (high - low)
    source = size * size * fronts.passed[child]
    rows = size * (fronts.row_first[front + 1] - fronts.row_first[front] - first)
    # of each row, one past the last of those that follow each other in the parent as well
    stretch = np.empty(high - low, np.int64)
    for q in range(high - 1, low - 1, -1):
        follows = q + 1 < high and fronts.into[q + 1] == fronts.into[q] + 1
        stretch[q - low] = stretch[q + 1 - low] if follows else q + 1
    for q in range(low, high):
        column = fronts.into[q] - first
        if column < 0 or (not boundary and column >= own):
            continue
        for k in range(size):
            target = begin + (size * column + k) * rows
            here = source + (size * (q - low) + k) * length
            r = q
            while r < high:
                end = stretch[r - low]
                there = target + size * (fronts.into[r] - first)
                passed = here + size * (r - low)
                for i in range(size * (end - r)):
                    out[there + i] += below[passed + i]
                r = end


@inner
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
    _add_own(front, fronts, blocks, values, n)
    for k in range(fronts.child_first[front], fronts.child_first[front + 1]):
        _add_passed(fronts.child[k], front, fronts, below, values, False, size)
    potrf = fortran[0]
    trsm = fortran[1]
    syrk = fortran[2]
    sizes = np.array([n, own, rest, 0], np.int32)
    letters = np.array([82, 76, 84, 78], np.uint8)  # R L T N
    signs = np.array([1.0, -1.0, 0.0])
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
    nothing = signs[2:].ctypes.data
    top = values[at:].ctypes.data
    call(potrf, (lower, columns, top, ld, info))
    if sizes[3] != 0 or rest == 0:
        return sizes[3]
    under = top + 8 * own
    call(trsm, (right, lower, trans, plain, rows, columns, plus, top, ld, under, ld))
    passed = room[passes:].ctypes.data
    # what is in the room is overwritten, and children are added to it: filled with zeros first, it would pass the memory twice more
    call(syrk, (lower, plain, rows, columns, minus, under, ld, nothing, passed, rows))
    for k in range(fronts.child_first[front], fronts.child_first[front + 1]):
        _add_passed(fronts.child[k], front, fronts, below, room, True, size)
    return 0


@task_body
def _eliminate_task(part, arguments):
    """Eliminate the fronts of a stage's task, until one is not positive definite. first: the stage's first task."""
    fronts, blocks, values, rooms, fortran, failed, first = arguments
    for k in range(fronts.task_first[first + part], fronts.task_first[first + part + 1]):
        front = fronts.order[k]
        failed[front] = _eliminate(front, fronts, blocks, values, rooms, fortran)
        if failed[front] != 0:
            return


@compiled
def _factor(fronts, blocks, values, rooms, fortran):
    """Factor into values. Returns -1, or the first node of a front that is not positive definite."""
    failed = np.zeros(len(fronts.depth), np.int64)
    for stage in range(len(fronts.stage_first) - 1):
        first = fronts.stage_first[stage]
        last = fronts.stage_first[stage + 1]
        given = (fronts, blocks, values, rooms, fortran, failed, first)
        over_parts(last - first, task(_eliminate_task, given))
        for k in range(fronts.task_first[first], fronts.task_first[last]):
            if failed[fronts.order[k]] != 0:
                return fronts.first[fronts.order[k]]
    return -1


@inner
def _substitute(front, fronts, values, x, aside, back, fortran):
    """One step of the substitution: x (columns, size nodes) in place.

    aside (trees, columns, size nodes above the cut): what trees below the cut add to x above it, where other trees do as well.
    """
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
    tree = fronts.tree[front]
    work = np.empty(columns * n)
    for column in range(columns):
        for q in range(begin, end):
            node = fronts.rows[q]
            shared = tree >= 0 and not back and fronts.above[node] >= 0
            for i in range(size):
                if shared:
                    value = aside[tree, column, size * fronts.above[node] + i]
                else:
                    value = x[column, size * node + i]
                work[column * n + size * (q - begin) + i] = value
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
            node = fronts.rows[q]
            shared = tree >= 0 and not back and fronts.above[node] >= 0
            for i in range(size):
                value = work[column * n + size * (q - begin) + i]
                if shared:
                    aside[tree, column, size * fronts.above[node] + i] = value
                else:
                    x[column, size * node + i] = value


@task_body
def _substitute_task(part, arguments):
    """Substitute in the fronts of a task of the first stage."""
    fronts, values, x, aside, back, fortran = arguments
    first = fronts.task_first[part]
    count = fronts.task_first[part + 1] - first
    for k in range(count):
        front = fronts.order[first + (count - 1 - k if back else k)]
        _substitute(front, fronts, values, x, aside, back, fortran)


@compiled
def _solve(fronts, values, x, aside, fortran):
    """x (columns, size nodes), right-hand sides, in place -> solutions; aside: zeros (_substitute)."""
    tasks = fronts.stage_first[1]
    size = x.shape[1] // fronts.first[-1]
    over_parts(tasks, task(_substitute_task, (fronts, values, x, aside, False, fortran)))
    for node in range(fronts.first[-1]):
        place = fronts.above[node]
        if place >= 0:
            for tree in range(len(aside)):
                for column in range(len(x)):
                    for i in range(size):
                        x[column, size * node + i] += aside[tree, column, size * place + i]
    begin = fronts.task_first[tasks]
    count = len(fronts.order) - begin
    for k in range(count):
        _substitute(fronts.order[begin + k], fronts, values, x, aside, False, fortran)
    for k in range(count):
        _substitute(fronts.order[begin + count - 1 - k], fronts, values, x, aside, True, fortran)
    over_parts(tasks, task(_substitute_task, (fronts, values, x, aside, True, fortran)))


def factor(fronts: Fronts, blocks: Array, values: Array, rooms: Array) -> int:
    """Write the Cholesky factors of blocks (blocks, size, size) to values; rooms (2, room): work space.

    Returns -1, or the first node (in the order of elimination) of a front that proved not positive definite.
    """
    return int(_factor(fronts, blocks, values, rooms, addresses()))


def solve_columns(fronts: Fronts, values: Array, right: Array) -> Array:
    """Solutions (k, size nodes) for right-hand sides (k, size nodes) in the order of elimination."""
    x = np.array(right, float, order="C")
    size = x.shape[1] // int(fronts.first[-1])
    aside = np.zeros(
        (int(fronts.tree.max()) + 1, len(x), size * (int(fronts.above.max(initial=-1)) + 1))
    )
    if len(x):
        _solve(fronts, values, x, aside, addresses())
    return x
