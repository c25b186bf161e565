"""BLAS and LAPACK in compiled code: the routines in SciPy, called by address, so that they run without the interpreter's lock.

Numba itself has only a few of them. Compiled code calls them by compiled.by_address with a tuple of addresses: Fortran takes every argument
by reference.
"""

from functools import cache

from numba.extending import get_cython_function_address

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
