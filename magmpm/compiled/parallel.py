"""Parallel loops over a compiled function: `over_parts(count, task(function, arguments))` calls function(k, arguments) for every k.

Numba takes three times as long to compile a loop of its own, with prange, as to compile the function that does the work of one part. So
here are the only two: compiled once, they call a part by its address. Arguments are passed as one piece of memory, which lives as long as
the function that made the task. What a function raises is lost: kernels do not raise.

The function of a task is compiled for itself, and its machine code is found by a symbol when its callers are loaded. Linked into them, as
functions that compiled code calls are, it would be optimized and written once more for each caller, and could not be compiled beside them.
"""

from hashlib import sha256
from importlib import import_module
from typing import Any, NamedTuple

from llvmlite import ir
from llvmlite.binding import add_symbol
from numba import prange, typeof, types
from numba.core import cgutils
from numba.extending import intrinsic

from magmpm.compiled.by_address import call
from magmpm.compiled.cache import load_first
from magmpm.compiled.jit import compiled, inner, inner_kernel

_INT = ir.IntType(64)
_BYTE = ir.IntType(8).as_pointer()


TOGETHER = 128  # particles, points or nodes that a thread takes at a time, where each takes little


@compiled
def parts_of(count):
    """Number of parts of TOGETHER, the last perhaps smaller."""
    return (count + TOGETHER - 1) // TOGETHER


class Linked(NamedTuple):
    """A compiled function that others call by a symbol: module and name, and the types of its arguments. Called, it loads the function
    and says where it is: Numba does that before it loads a caller from the disk."""

    module: str
    name: str
    args: tuple[Any, ...]

    def symbol(self) -> str:
        """The function's symbol, the same in every process."""
        stamp = sha256(str(self.args).encode()).hexdigest()[:16]
        return f"{self.module}.{self.name}.{stamp}"

    def __call__(self) -> Any:
        """The compiled function, which its symbol names from now on."""
        function = getattr(import_module(self.module), self.name)
        function.compile(self.args)
        found = function.overloads[self.args]
        add_symbol(
            self.symbol(), found.library.get_pointer_to_function(found.fndesc.llvm_func_name)
        )
        return found


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
        of = signature.args[0].dispatcher.py_func
        linked = Linked(of.__module__, of.__name__, called.args)
        described = linked().fndesc
        load_first(context, linked)
        takes = context.call_conv.get_function_type(described.restype, described.argtypes)
        context.call_conv.call_function(
            inside,
            cgutils.get_or_insert_function(inside.module, takes, linked.symbol()),
            called.return_type,
            called.args,
            [entry.args[1], given],
        )
        inside.ret_void()
        both = [builder.ptrtoint(one, _INT) for one in (entry, packed)]
        return context.make_tuple(builder, signature.return_type, both)

    return types.UniTuple(types.intp, 2)(function, arguments), generate


def compile_task(function: Any, arguments: tuple[Any, ...]) -> None:
    """Compile the function of a task for these arguments, before anything that makes the task."""
    function.compile((types.intp, typeof(arguments)))


@inner
def once(task_of):
    """Do a task for k = 0."""
    entry, given = task_of
    call(entry, (given, 0))


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
