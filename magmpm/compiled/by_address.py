"""Calls of machine code by its address: of C functions that are compiled apart from the kernels that call them, and of Fortran's.

A kernel that is given addresses as numbers is compiled once, whatever it calls. Functions that use ctypes objects can't be cached on disk;
those that take an address as a number can. So BLAS and LAPACK are called as SciPy has them, without the interpreter's lock, with addresses
of all arguments; Numba itself has only a few of them.
"""

from collections.abc import Callable
from functools import cache
from inspect import Parameter, Signature
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import get_cython_function_address, intrinsic

BLAS = "scipy.linalg.cython_blas"
LAPACK = "scipy.linalg.cython_lapack"
_BYTE = ir.IntType(8).as_pointer()
_DOUBLE = ir.DoubleType()


def instruction(returns: Any, *takes: Any) -> Callable[..., Any]:
    """Decorator: a function for compiled code, from the one that makes its LLVM instructions; takes: types of arguments; None: as given."""

    def made(generate: Callable[..., Any]) -> Any:
        def typed(typing_context, *given):
            for one in given:
                if isinstance(one, types.Array) and one.layout != "C":
                    raise TypingError(f"what is read by its address must be contiguous, not {one}")
            return (
                returns(
                    *(
                        of if wanted is None else wanted
                        for wanted, of in zip(takes, given, strict=True)
                    )
                ),
                generate,
            )

        # Numba asks for the arguments that a function declares
        names = ["typing_context", *(f"value{k}" for k in range(len(takes)))]
        declared = [Parameter(name, Parameter.POSITIONAL_OR_KEYWORD) for name in names]
        typed.__signature__ = Signature(declared)  # type: ignore[attr-defined]
        return intrinsic(typed)

    return made


def first_of(context: Any, builder: Any, kind: Any, values: Any) -> Any:
    """LLVM pointer to the first number of an array, or of what a pointer points to."""
    if isinstance(kind, types.CPointer):
        return values
    return context.make_array(kind)(context, builder, values).data


@instruction(types.intp, None, types.intp)
def address(context, builder, signature, values):
    """(array, index) -> address of array[index] of a contiguous array, counted as if it were flat. Bounds are unchecked."""
    first = first_of(context, builder, signature.args[0], values[0])
    return builder.ptrtoint(builder.gep(first, [values[1]]), ir.IntType(64))


@instruction(types.void, types.intp, None)
def call(context, builder, signature, values):
    """(address, arguments): call what is at an address with a tuple of addresses, whole numbers and floats. It returns nothing."""
    given = cgutils.unpack_tuple(builder, values[1])
    # whole numbers are passed as addresses are
    ready = [value if value.type == _DOUBLE else builder.inttoptr(value, _BYTE) for value in given]
    kind = ir.FunctionType(ir.VoidType(), [value.type for value in ready]).as_pointer()
    builder.call(builder.inttoptr(values[0], kind), ready)
    return context.get_dummy_value()


def _pointer(kind: Any) -> Any:
    """Function for compiled code: a pointer to numbers of this kind, from their address."""

    def generate(context, builder, signature, values):
        return builder.inttoptr(values[0], context.get_value_type(signature.return_type))

    return instruction(types.CPointer(kind), types.intp)(generate)


floats = _pointer(types.float64)  # floats(address)
numbers = _pointer(types.int64)  # numbers(address)


@cache
def addresses(precision: str = "d") -> tuple[int, int, int, int, int, int]:
    """Addresses of potrf, trsm, syrk, gemm, trsv, gemv, in "d" double or "s" single precision. SciPy takes 0.1 s to import: not before."""
    found = [get_cython_function_address(LAPACK, f"{precision}potrf")]
    found += [
        get_cython_function_address(BLAS, precision + name)
        for name in ("trsm", "syrk", "gemm", "trsv", "gemv")
    ]
    return tuple(found)  # type: ignore[return-value]
