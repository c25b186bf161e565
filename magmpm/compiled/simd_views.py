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


class IndexedView(types.Type):  # type: ignore[misc]
    """Type of a vector or (3, 3) matrix, by its number of indices, of lanes or of floats that follow each other."""

    def __init__(self, indices: int, of: types.Type) -> None:
        self.indices = indices
        self.of = of
        super().__init__(name=f"IndexedView{indices}of{of}")


@register_model(IndexedView)
class _ViewModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, fe_type: Any) -> None:
        super().__init__(manager, fe_type, _POINTER)


def _view(kind: types.Type) -> Any:
    def generate(context, builder, signature, values):
        data = first_of(context, builder, signature.args[0], values[0])
        return builder.gep(data, [values[1]])

    return instruction(kind, None, types.intp)(generate)


# vector(array, index): the lanes from array[index] on, of a flat array; matrix: nine lanes, row by row
vector = _view(IndexedView(1, lanes))
matrix = _view(IndexedView(2, lanes))
# row(array, index): the floats array[index], array[index + 1], ..., for hooks that branch. A slice of an array would work too, but
# counting references to it costs more than a contact, and ten times as much as the damping of a node.
row = _view(IndexedView(1, types.float64))


def _entry(context: Any, builder: Any, signature: Any, values: Any) -> Any:
    """Address of what is at an index, or a pair of indices, of a view."""
    kind, index_type = signature.args[:2]
    view, index = values[:2]
    if kind.indices == 1:
        at = context.cast(builder, index, index_type, types.intp)
    else:
        i, j = (
            context.cast(builder, builder.extract_value(index, k), index_type[k], types.intp)
            for k in range(2)
        )
        at = builder.add(builder.mul(i, ir.Constant(i.type, 3)), j)
    if kind.of != lanes:
        return builder.gep(view, [at])
    first = builder.gep(view, [builder.mul(at, ir.Constant(at.type, WIDTH))])
    return builder.bitcast(first, ir.VectorType(ir.DoubleType(), WIDTH).as_pointer())


def _indexes(kind: Any, index: Any) -> bool:
    if not isinstance(kind, IndexedView):
        return False
    if kind.indices == 1:
        return isinstance(index, types.Integer)
    return isinstance(index, (types.Tuple, types.UniTuple)) and [
        isinstance(t, types.Integer) for t in index
    ] == [True, True]


type_callable(operator.getitem)(
    lambda context: lambda view, index: view.of if _indexes(view, index) else None
)
type_callable(operator.setitem)(
    lambda context: (
        lambda view, index, value: (
            types.void if _indexes(view, index) and value == view.of else None
        )
    )
)


@lower_builtin(operator.getitem, IndexedView, types.Any)
def _getitem(context, builder, signature, values):
    loaded = builder.load(_entry(context, builder, signature, values))
    loaded.align = 8
    return loaded


@lower_builtin(operator.setitem, IndexedView, types.Any, types.Any)
def _setitem(context, builder, signature, values):
    stored = builder.store(values[2], _entry(context, builder, signature, values))
    stored.align = 8
    return context.get_dummy_value()
