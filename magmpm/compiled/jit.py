"""Numba, set up once for the whole package: how every function is compiled.

* The disk cache is in a folder named by a hash of the package's sources (`environment`). Numba notices a change only in the file that
  defines a function. It would go on calling the old version of functions from other files. magmpm.compiled.cache protects the files.
* Arithmetic may be contracted and reassociated, but NaN and infinity keep their meaning in comparisons: write ``x < np.inf``.
  ``np.isfinite(x)`` is always true: Numba computes it from x - x, which reassociation replaces by zero.
* Kernels take records (NamedTuples of arrays) as arguments. They assign to arrays of a record only in functions that they call. If a
  parallel function itself assigns to a field of a record, Numba treats this as dead code and leaves it out.
* Division by zero gives inf, as in NumPy, and checks on the result catch it. Inside a parallel loop an exception would be lost.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
from numba import prange

from magmpm.compiled.cache import jit
from magmpm.errors import InputError, report

_settings: Any = numba.config
if _settings.DISABLE_JIT:
    raise InputError(
        report(
            "NUMBA_DISABLE_JIT",
            received=str(_settings.DISABLE_JIT),
            rule="magmpm's kernels work only when compiled: the compiler decides which effects act in them",
            remedy="unset it (and disable_jit in .numba_config.yaml)",
        )
    )
FASTMATH = {"contract", "reassoc", "arcp", "nsz", "afn"}
kernel: Callable[..., Any] = jit(parallel=True, fastmath=FASTMATH, error_model="numpy", nogil=True)
compiled: Callable[..., Any] = jit(fastmath=FASTMATH, error_model="numpy", nogil=True)
# For functions that inner loops call with many arrays. Without it, a call passes seven words for each array, some hundred instructions.
inlined: Callable[..., Any] = jit(fastmath=FASTMATH, error_model="numpy", nogil=True, forceinline=True)

__all__ = ["FASTMATH", "compiled", "inlined", "kernel", "prange"]
