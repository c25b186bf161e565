"""Numba, set up once for the whole package: how every function is compiled.

* The disk cache is in a folder named by a hash of the package's sources (`environment`). Numba notices a change only in the file that
  defines a function. It would go on calling the old version of functions from other files. magmpm.compiled.cache protects the files.
* Arithmetic may be contracted and reassociated, but NaN and infinity keep their meaning in comparisons: write ``x < np.inf``.
  ``np.isfinite(x)`` is always true: Numba computes it from x - x, which reassociation replaces by zero.
* Kernels take records (NamedTuples of arrays) as arguments. They assign to arrays of a record only in functions that they call. If a
  parallel function itself assigns to a field of a record, Numba treats this as dead code and leaves it out.
* Numba's symbols count functions and records. Two processes count alike what differs, and the linker takes the first of two for both. So
  records count by a hash of their fields here, and functions that are made from a text have names of their own, with their module's.
* Loops that the compiler would run in two ways, in lanes where it finds at run time that arrays lie apart, are not taken in lanes: the two
  round differently, and which one runs depends on where arrays happen to lie in memory. Lanes are written out (magmpm.compiled.simd).
* Division by zero gives inf, as in NumPy, and checks on the result catch it. Inside a parallel loop an exception would be lost.
"""

from collections.abc import Callable
from hashlib import sha256
from inspect import signature
from typing import Any

import llvmlite.binding
import numba
from numba import prange, types
from numba.extending import overload

import magmpm.compiled.fork  # noqa: F401  (what becomes of kernels in a fork)
from magmpm.compiled.cache import jit
from magmpm.errors import InputError

llvmlite.binding.set_option("magmpm", "-vectorize-memory-check-threshold=0")
_settings: Any = numba.config
_record: Any = types.Record
_record.mangling_args = property(lambda one: ("Record", (sha256(one.name.encode()).hexdigest(),)))
if _settings.DISABLE_JIT:
    raise InputError(
        "NUMBA_DISABLE_JIT",
        received=str(_settings.DISABLE_JIT),
        rule=(
            "magmpm's kernels work only when compiled: they call effects by the addresses of their"
            " machine code"
        ),
        remedy="unset it (and disable_jit in .numba_config.yaml)",
    )
FASTMATH = {"contract", "reassoc", "arcp", "nsz", "afn"}
_OPTIONS: Any = {
    "fastmath": FASTMATH,
    "no_cfunc_wrapper": True,
}  # wrappers for C would take 5 % of compiling; nobody calls them
_ALL: dict[str, Any] = {**_OPTIONS, "error_model": "numpy", "nogil": True}
C_OPTIONS: dict[str, Any] = {"fastmath": FASTMATH, "error_model": "numpy"}  # of C functions
kernel: Callable[..., Any] = jit(parallel=True, **_ALL)
compiled: Callable[..., Any] = jit(**_ALL)
# For functions that are called before the kernels of a run are compiled, as a body or a field is made.
compiled_elsewhere: Callable[..., Any] = jit(elsewhere=True, **_ALL)
inlined_elsewhere: Callable[..., Any] = jit(elsewhere=True, forceinline=True, **_ALL)
# What only compiled code calls: to be called from Python as well takes a tenth of compiling.
inner: Callable[..., Any] = jit(no_cpython_wrapper=True, **_ALL)
# What `compiled.parallel.task` takes: to be found by a symbol, it must be machine code on the disk.
task_body: Callable[..., Any] = jit(written=True, no_cpython_wrapper=True, **_ALL)
inner_kernel: Callable[..., Any] = jit(parallel=True, no_cpython_wrapper=True, **_ALL)
# For functions that inner loops call with many arrays. Without it, a call passes seven words for each array, some hundred instructions.
inlined: Callable[..., Any] = jit(forceinline=True, **_ALL)


def chosen_by_types(build: Callable[..., Any]) -> Callable[..., Any]:
    """Function for compiled code: `build` chooses its code by the types of the arguments. Called from Python it raises TypeError."""

    def called(*_: Any) -> Any:
        raise TypeError(
            "only compiled code can call this: which code it is depends on the types of the"
            " arguments"
        )

    overload(called, jit_options=_OPTIONS, strict=False)(build)
    return called


def only_where(
    argument: str, needed: Callable[[Any], bool], function: Any, otherwise: str = "None"
) -> Callable[..., Any]:
    """A compiled function that is called, and compiled into its callers, only where the type of one argument needs it.

    needed: of that argument's Numba type; otherwise: Python text of the value elsewhere. The result can be called by compiled code alone.
    """
    name = f"where{function.py_func.__name__}"
    names = ", ".join(signature(function.py_func).parameters)
    space = {"function": function, "needed": needed, "__name__": function.py_func.__module__}
    exec(
        f"def {name}({names}):\n    if needed({argument}):\n        return lambda {names}:"
        f" function({names})\n    return lambda {names}: {otherwise}",
        space,
    )
    return chosen_by_types(space[name])


__all__ = [
    "C_OPTIONS",
    "FASTMATH",
    "chosen_by_types",
    "compiled",
    "compiled_elsewhere",
    "inlined",
    "inlined_elsewhere",
    "inner",
    "inner_kernel",
    "kernel",
    "only_where",
    "prange",
    "task_body",
]
