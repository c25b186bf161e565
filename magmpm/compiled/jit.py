"""Numba, set up once for the whole package: how every compiled function is compiled.

* The disk cache lies in a folder named by a hash of the package's sources (`environment`): Numba notices a change only in the file
  that holds a function, and would go on calling the old version of what that function uses in another file. Its files are guarded by
  magmpm.compiled.cache.
* Arithmetic may be contracted and reassociated, but NaN and infinity keep their meaning in comparisons: write ``x < np.inf``.
  ``np.isfinite(x)`` is always true, since Numba makes it of x - x, which reassociation takes for zero.
* Kernels take records (NamedTuples of arrays) as arguments, but they assign to arrays of a record only in functions that they call: what a
  parallel function assigns to a record's field itself, Numba takes for dead code, and leaves out.
* Division by zero gives inf, as in NumPy, and is caught by the checks on the result: inside a parallel loop an exception
  would be lost.
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
            rule="magmpm's kernels exist only compiled: which effects act in them is decided by the compiler",
            remedy="unset it (and disable_jit in .numba_config.yaml)",
        )
    )
FASTMATH = {"contract", "reassoc", "arcp", "nsz", "afn"}
kernel: Callable[..., Any] = jit(parallel=True, fastmath=FASTMATH, error_model="numpy", nogil=True)
compiled: Callable[..., Any] = jit(fastmath=FASTMATH, error_model="numpy", nogil=True)
# For what inner loops call with many arrays: a call hands over seven words an array, some hundred instructions, unless it is inlined.
inlined: Callable[..., Any] = jit(fastmath=FASTMATH, error_model="numpy", nogil=True, forceinline=True)

__all__ = ["FASTMATH", "compiled", "inlined", "kernel", "prange"]
