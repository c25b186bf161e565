"""Eight floats in one register: a Numba type for kernels that work on eight particles, or on the components of two nodes, at a time.

By itself the compiler vectorizes only part of such loops. With this type, arithmetic uses plain operators, and every operation is a
vector instruction (one AVX-512 instruction, two of AVX2, four of NEON).
Only for compiled code: Python itself never holds lanes. Sums are made in a fixed order, so results are the same bit for bit each time.
"""

import math
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, models, register_model, type_callable

from magmpm.compiled.by_address import first_of, instruction
from magmpm.compiled.jit import chosen_by_types, inlined, inner

WIDTH = 8
_DOUBLE = ir.DoubleType()
_INT = ir.IntType(64)
_VECTOR = ir.VectorType(_DOUBLE, WIDTH)
_INTEGERS = ir.VectorType(_INT, WIDTH)
_FLAGS = ("contract", "reassoc", "nsz", "arcp")


class Lanes(types.Type):  # type: ignore[misc]
    """Type of eight floats."""

    def __init__(self) -> None:
        super().__init__(name="Lanes8")


lanes = Lanes()


@register_model(Lanes)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _VECTOR)


def _mask(order: list[int]) -> ir.Constant:
    return ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order)


def _everywhere(builder: Any, value: Any) -> Any:
    """A float in all lanes."""
    none = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(none, value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, none, _mask([0] * WIDTH))


def _constant(value: float) -> ir.Constant:
    return ir.Constant(_VECTOR, [value] * WIDTH)


def _wide(builder: Any, signature: Any, values: Any) -> list[Any]:
    """Lanes of each value, which are lanes or floats."""
    kinds = zip(values, signature.args, strict=True)
    return [value if of == lanes else _everywhere(builder, value) for value, of in kinds]


def _operator(function: Any, name: str) -> None:
    """Define an operator between lanes, and between lanes and a float."""
    type_callable(function)(
        lambda context: (
            lambda a, b: (
                lanes
                if lanes in (a, b) and all(t in (lanes, types.float64) for t in (a, b))
                else None
            )
        )
    )

    def lower(left: Any, right: Any) -> None:
        @lower_builtin(function, left, right)  # type: ignore[untyped-decorator]
        def _lowered(context, builder, signature, values):
            return getattr(builder, name)(*_wide(builder, signature, values), flags=_FLAGS)

    for pair in ((lanes, lanes), (lanes, types.float64), (types.float64, lanes)):
        lower(*pair)


for _name, _instruction in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    _operator(getattr(operator, _name), _instruction)
    _operator(getattr(operator, f"i{_name}"), _instruction)
type_callable(operator.neg)(lambda context: lambda a: lanes if a == lanes else None)
lower_builtin(operator.neg, lanes)(
    lambda context, builder, signature, values: builder.fneg(values[0])
)


def _function(of: Any, name: str) -> None:
    """Define a function of one float for lanes, by its name in LLVM."""
    type_callable(of)(lambda context: lambda a: lanes if a == lanes else None)

    @lower_builtin(of, lanes)  # type: ignore[untyped-decorator]
    def _lowered(context, builder, signature, values):
        kind = ir.FunctionType(_VECTOR, [_VECTOR])
        function = cgutils.get_or_insert_function(builder.module, kind, f"llvm.{name}.v8f64")
        return builder.call(function, values)


for _of, _name in ((abs, "fabs"), (math.floor, "floor"), (math.sqrt, "sqrt")):
    _function(_of, _name)


def _address(context: Any, builder: Any, signature: Any, array: Any, index: Any) -> Any:
    """Pointer to eight floats of a flat array."""
    data = first_of(context, builder, signature.args[0], array)
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


@instruction(lanes, None, types.intp)
def load(context, builder, signature, values):
    """(array, index) -> lanes from array[index : index + 8] of a flat contiguous array. Bounds are unchecked."""
    loaded = builder.load(_address(context, builder, signature, *values))
    loaded.align = 8
    return loaded


@instruction(types.void, None, types.intp, lanes)
def store(context, builder, signature, values):
    """(array, index, lanes): array[index : index + 8] = lanes, in a flat contiguous array. Bounds are unchecked."""
    stored = builder.store(values[2], _address(context, builder, signature, *values[:2]))
    stored.align = 8
    return context.get_dummy_value()


@instruction(lanes, types.float64)
def splat(context, builder, signature, values):
    """A float in all lanes."""
    return _everywhere(builder, values[0])


@instruction(lanes, types.float64, types.float64)
def halves(context, builder, signature, values):
    """One float in lanes 0 to 3, another in lanes 4 to 7."""
    return builder.shuffle_vector(
        *(_everywhere(builder, v) for v in values), _mask([0, 1, 2, 3, 12, 13, 14, 15])
    )


@instruction(types.UniTuple(types.float64, 3), lanes)
def folded(context, builder, signature, values):
    """Lanes 0 to 2 plus lanes 4 to 6: three floats."""
    parts = [
        builder.extract_element(values[0], ir.Constant(ir.IntType(32), i))
        for i in (0, 4, 1, 5, 2, 6)
    ]
    out = [builder.fadd(*parts[i : i + 2], flags=_FLAGS) for i in (0, 2, 4)]
    return context.make_tuple(builder, signature.return_type, out)


@instruction(lanes, *[types.float64] * WIDTH)
def eight(context, builder, signature, values):
    """Lanes of eight floats."""
    out = ir.Constant(_VECTOR, ir.Undefined)
    for k, value in enumerate(values):
        out = builder.insert_element(out, value, ir.Constant(ir.IntType(32), k))
    return out


@instruction(types.UniTuple(types.float64, WIDTH), lanes)
def one_by_one(context, builder, signature, values):
    """The eight floats of lanes."""
    out = [builder.extract_element(values[0], ir.Constant(ir.IntType(32), k)) for k in range(WIDTH)]
    return context.make_tuple(builder, signature.return_type, out)


def _join(builder: Any, pair: Any, low: list[int], high: list[int]) -> Any:
    left = builder.shuffle_vector(*pair, _mask(low))
    right = builder.shuffle_vector(*pair, _mask(high))
    return builder.fadd(left, right)


@instruction(lanes, *[lanes] * WIDTH)
def sums(context, builder, signature, values):
    """Lanes of the eight arguments' sums over their lanes, by a tree: 21 instructions, where eight single sums take 56."""
    for low, high in (
        ([0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]),
        ([0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]),
        ([0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15]),
    ):
        values = [_join(builder, values[i : i + 2], low, high) for i in range(0, len(values), 2)]
    return values[0]


def _reduction(name: str) -> Any:
    def generate(context, builder, signature, values):
        kind = ir.FunctionType(_DOUBLE, [_DOUBLE, _VECTOR] if name == "fadd" else [_VECTOR])
        function = cgutils.get_or_insert_function(
            builder.module, kind, f"llvm.vector.reduce.{name}.v8f64"
        )
        start = [ir.Constant(_DOUBLE, 0.0)] if name == "fadd" else []
        return builder.call(
            function, [*start, values[0]], fastmath=("reassoc",) if name == "fadd" else ()
        )

    return instruction(types.float64, lanes)(generate)


total = _reduction("fadd")  # sum over the lanes
lowest = _reduction("fmin")  # smallest lane
highest = _reduction("fmax")  # largest lane


@instruction(lanes, None, None, None, None)
def _above(context, builder, signature, values):
    a, b, then, other = _wide(builder, signature, values)
    return builder.select(builder.fcmp_ordered(">", a, b), then, other)


@instruction(types.UniTuple(lanes, 3), None, lanes, types.intp)
def _picked(context, builder, signature, values):
    array, at, further = values
    first = builder.gep(first_of(context, builder, signature.args[0], array), [further])
    places = builder.fptosi(at, _INTEGERS)
    rows = []
    for k in range(WIDTH):
        place = builder.extract_element(places, ir.Constant(ir.IntType(32), k))
        four = ir.VectorType(_DOUBLE, 4).as_pointer()
        rows.append(builder.load(builder.bitcast(builder.gep(first, [place]), four)))
        rows[-1].align = 8

    def pairs(parts: list[Any], order: list[int]) -> list[Any]:
        return [
            builder.shuffle_vector(*parts[k : k + 2], _mask(order)) for k in range(0, len(parts), 2)
        ]

    two = pairs(rows, list(range(WIDTH)))
    four_each = pairs(two, [0, 4, 8, 12, 1, 5, 9, 13])
    last = pairs(two, [2, 6, 10, 14, 2, 6, 10, 14])
    low = [0, 1, 2, 3, 8, 9, 10, 11]
    found = (
        *pairs(four_each, low),
        *pairs(four_each, [4, 5, 6, 7, 12, 13, 14, 15]),
        *pairs(last, low),
    )
    return context.make_tuple(builder, signature.return_type, found)


# What hooks call with floats too: of one particle or point, and of eight.
# above(a, b, then, other): `then` where a > b; `other` elsewhere, and where one of them is NaN
above = chosen_by_types(
    lambda a, b, then, other: (
        (lambda a, b, then, other: _above(a, b, then, other))
        if lanes in (a, b, then, other)
        else (lambda a, b, then, other: then if a > b else other)
    )
)
# pick(array, at, further): three numbers of a flat array, from index `at`, a whole float, plus `further` on; of eight, one beyond is read
pick = chosen_by_types(
    lambda array, at, further: (
        (lambda array, at, further: _picked(array, at, further))
        if at == lanes
        else (
            lambda array, at, further: (
                array[int(at) + further],
                array[int(at) + further + 1],
                array[int(at) + further + 2],
            )
        )
    )
)


@inlined
def smaller(a, b):
    """Return the smaller of two; the second where the first is NaN."""
    return above(b, a, a, b)


@inlined
def larger(a, b):
    """Return the larger of two; the second where the first is NaN."""
    return above(a, b, a, b)


# 4/3 of the bits of 1.0, minus a shift that makes the error of the guess equally large above and below.
_MAGIC = 4.0 / 3.0 * 0x3FF0000000000000 - 0.0434 * 2.0**52


@instruction(lanes, lanes)
def cube_root_guess(context, builder, signature, values):
    """x^(-1/3) of lanes x to 4 %: the exponent's bits, divided by -3."""
    bits = builder.sitofp(builder.bitcast(values[0], _INTEGERS), _VECTOR)
    guess = builder.fadd(builder.fmul(bits, _constant(-1.0 / 3.0)), _constant(_MAGIC))
    return builder.bitcast(builder.fptosi(guess, _INTEGERS), _VECTOR)


@inner
def inverse_cube_root(x):
    """x^(-1/3) of positive, normal lanes to a few units in the last place, by Newton's method on y^-3 = x from a guess good to 4 %.

    Each step squares the relative error and doubles it: 4e-2, 3e-3, 2e-5, 1e-9, 1e-18. For x <= 0 the value is meaningless.
    """
    y = cube_root_guess(x)
    third = x * (1.0 / 3.0)
    for _ in range(4):
        y = y * (4.0 / 3.0 - third * y * y * y)
    return y


@inlined
def determinant_of(a, b, c, d, e, f, g, h, i):
    """Determinant of the matrix with these entries, row by row: numbers, or lanes of eight particles."""
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


@inner
def cross(a, b):
    """Product a x b of two triples."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inner
def dot(a, b):
    """Product a . b of two triples."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inner
def rows(F):
    """Rows of F (3, 3) as triples: numbers, or lanes of eight particles."""
    return (F[0, 0], F[0, 1], F[0, 2]), (F[1, 0], F[1, 1], F[1, 2]), (F[2, 0], F[2, 1], F[2, 2])
