"""BLAS and LAPACK in compiled code: the routines in SciPy, called by address, so that they run without the interpreter's lock.

Numba itself has only a few of them. Functions that use ctypes objects can't be cached on disk; those that take an address as a number can.
"""

from functools import cache

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import get_cython_function_address, intrinsic

BLAS = "scipy.linalg.cython_blas"
LAPACK = "scipy.linalg.cython_lapack"


@cache
def addresses(precision: str = "d") -> tuple[int, int, int, int, int, int]:
    """Addresses of potrf, trsm, syrk, gemm, trsv, gemv, in "d" double or "s" single precision. SciPy takes 0.1 s to import: not before."""
    found = [get_cython_function_address(LAPACK, f"{precision}potrf")]
    found += [
        get_cython_function_address(BLAS, precision + name)
        for name in ("trsm", "syrk", "gemm", "trsv", "gemv")
    ]
    return tuple(found)  # type: ignore[return-value]


@intrinsic  # type: ignore[misc]
def call(typingctx, address, arguments):
    """Call the Fortran routine at `address` with a tuple of addresses: Fortran takes every argument by reference."""
    signature = types.void(address, arguments)

    def codegen(context, builder, sig, args):
        pointer = ir.IntType(8).as_pointer()
        values = cgutils.unpack_tuple(builder, args[1])
        kind = ir.FunctionType(ir.VoidType(), [pointer] * len(values)).as_pointer()
        routine = builder.inttoptr(args[0], kind)
        builder.call(routine, [builder.inttoptr(v, pointer) for v in values])
        return context.get_dummy_value()

    return signature, codegen
