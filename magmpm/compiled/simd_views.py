"""Vectors and matrices of eight particles, indexed in compiled code like those of one: v[i] and F[i, j] are lanes.

A hook of an effect that is plain arithmetic works for one particle and for eight. With these views in place of arrays, and lanes in place
of floats, the same source compiles to vector instructions. Only for compiled code; bounds are unchecked.
"""

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import lower_builtin, models, register_model, type_callable

from magmpm.compiled.by_address import first_of, instruction
from magmpm.compiled.simd import WIDTH, lanes

_POINTER = ir.DoubleType().as_pointer()


class LaneView(types.Type):  # type: ignore[misc]
    """Type of a (3,) vector or (3, 3) matrix of lanes, by its number of indices."""

    def __init__(self, indices: int) -> None:
        self.indices = indices
        super().__init__(name=f"LaneView{indices}")


@register_model(LaneView)
class _ViewModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _POINTER)


def _view(kind: types.Type) -> Any:
    def generate(context, builder, signature, values):
        data = first_of(context, builder, signature.args[0], values[0])
        return builder.gep(data, [values[1]])

    return instruction(kind, None, types.intp)(generate)


vector = _view(
    LaneView(1)
)  # vector(array, index): the three lanes from array[index] on, of a flat array
matrix = _view(LaneView(2))  # matrix(array, index): the nine lanes from array[index] on, row by row


def _address(builder: Any, view: Any, at: Any) -> Any:
    """Address of lanes number `at` of a view."""
    first = builder.mul(at, ir.Constant(at.type, WIDTH))
    return builder.bitcast(
        builder.gep(view, [first]), ir.VectorType(ir.DoubleType(), WIDTH).as_pointer()
    )


def _entry(context: Any, builder: Any, kind: LaneView, index_type: Any, index: Any) -> Any:
    """Number of the lanes for an index or a pair of indices."""
    if kind.indices == 1:
        return context.cast(builder, index, index_type, types.intp)
    parts = [
        context.cast(builder, builder.extract_value(index, k), index_type[k], types.intp)
        for k in range(2)
    ]
    return builder.add(builder.mul(parts[0], ir.Constant(parts[0].type, 3)), parts[1])


def _indexes(kind: Any, index: Any) -> bool:
    if not isinstance(kind, LaneView):
        return False
    if kind.indices == 1:
        return isinstance(index, types.Integer)
    return isinstance(index, (types.Tuple, types.UniTuple)) and [
        isinstance(t, types.Integer) for t in index
    ] == [True, True]


type_callable(operator.getitem)(
    lambda context: lambda view, index: lanes if _indexes(view, index) else None
)


@lower_builtin(operator.getitem, LaneView, types.Any)
def _getitem(context, builder, signature, values):
    kind, index_type = signature.args
    at = _entry(context, builder, kind, index_type, values[1])
    loaded = builder.load(_address(builder, values[0], at))
    loaded.align = 8
    return loaded


type_callable(operator.setitem)(
    lambda context: (
        lambda view, index, value: types.void if _indexes(view, index) and value == lanes else None
    )
)


@lower_builtin(operator.setitem, LaneView, types.Any, lanes)
def _setitem(context, builder, signature, values):
    kind, index_type = signature.args[:2]
    at = _entry(context, builder, kind, index_type, values[1])
    stored = builder.store(values[2], _address(builder, values[0], at))
    stored.align = 8
    return context.get_dummy_value()


# Floats that follow each other in a flat array, for hooks that branch: v[i] is a float. A slice of an array would work too, but counting
# references to it costs more than a contact, and ten times as much as the damping of a node.


class Row(types.Type):  # type: ignore[misc]
    """Type of a vector whose components follow each other."""

    def __init__(self) -> None:
        super().__init__(name="RowView")


register_model(Row)(_ViewModel)


row = _view(Row())  # row(array, index): the floats array[index], array[index + 1], ...


def _place(context: Any, builder: Any, view: Any, index_type: Any, index: Any) -> Any:
    return builder.gep(view, [context.cast(builder, index, index_type, types.intp)])


def _of_row(view: Any, index: Any) -> bool:
    return isinstance(view, Row) and isinstance(index, types.Integer)


type_callable(operator.getitem)(
    lambda context: lambda view, index: types.float64 if _of_row(view, index) else None
)
type_callable(operator.setitem)(
    lambda context: (
        lambda view, index, value: (
            types.void if _of_row(view, index) and isinstance(value, types.Float) else None
        )
    )
)


@lower_builtin(operator.getitem, Row, types.Integer)
def _get_row(context, builder, signature, values):
    return builder.load(_place(context, builder, values[0], signature.args[1], values[1]))


@lower_builtin(operator.setitem, Row, types.Integer, types.Float)
def _set_row(context, builder, signature, values):
    _, index_type, value_type = signature.args
    given = context.cast(builder, values[2], value_type, types.float64)
    builder.store(given, _place(context, builder, values[0], index_type, values[1]))
    return context.get_dummy_value()
