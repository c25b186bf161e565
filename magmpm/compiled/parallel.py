"""Parallel loops over a compiled function: `over_parts(count, task(function, arguments))` calls function(k, arguments) for every k.

Numba takes three times as long to compile a loop of its own, with prange, as to compile the function that does the work of one part. So
here are the only two: compiled once, they call a part by its address. Arguments are passed as one piece of memory, which lives as long as
the function that made the task. What a function raises is lost: kernels do not raise.
"""

from llvmlite import ir
from numba import prange, types
from numba.core import cgutils
from numba.extending import intrinsic

from magmpm.compiled.by_address import call
from magmpm.compiled.jit import inner, inner_kernel

_INT = ir.IntType(64)
_BYTE = ir.IntType(8).as_pointer()


TOGETHER = 128  # particles, points or nodes that a thread takes at a time, where each takes little


@inner
def parts_of(count):
    """Number of parts of TOGETHER, the last perhaps smaller."""
    return (count + TOGETHER - 1) // TOGETHER


@intrinsic  # type: ignore[misc]
def task(typingctx, function, arguments):
    """(function, tuple of arguments) -> addresses of machine code that calls function(k, arguments), and of the arguments."""
    called = function.get_call_type(typingctx, (types.intp, arguments), {})

    def generate(context, builder, signature, values):
        packed = cgutils.alloca_once_value(builder, values[1])
        kind = ir.FunctionType(ir.VoidType(), [_BYTE, _INT])
        name = f"{builder.module.name}.task.{len(builder.module.functions)}"
        entry = ir.Function(builder.module, kind, name=name)
        entry.linkage = "internal"
        inside = ir.IRBuilder(entry.append_basic_block("entry"))
        given = inside.load(inside.bitcast(entry.args[0], packed.type))
        compiled = signature.args[0].dispatcher.get_compile_result(called)
        context.active_code_library.add_linking_library(compiled.library)
        context.call_conv.call_function(
            inside,
            context.declare_function(inside.module, compiled.fndesc),
            called.return_type,
            called.args,
            [entry.args[1], given],
        )
        inside.ret_void()
        both = [builder.ptrtoint(one, _INT) for one in (entry, packed)]
        return context.make_tuple(builder, signature.return_type, both)

    return types.UniTuple(types.intp, 2)(function, arguments), generate


@inner_kernel
def over_parts(count, task_of):
    """Do a task for k from 0 to before count, in parallel."""
    entry, given = task_of
    for k in prange(count):
        call(entry, (given, k))


@inner_kernel
def over_slabs(count, task_of):
    """Do a task for as many slabs in parallel, first those of one color, then those of the other: neighbors write to the same nodes."""
    entry, given = task_of
    for color in range(2):
        for half in prange((count + 1 - color) // 2):
            call(entry, (given, 2 * half + color))
