"""Kernels in a process that was forked from one that has run some: they go on with one thread.

GNU OpenMP, which runs Numba's parallel loops on Linux, has no threads any more after a fork. Numba ends a child that begins a parallel loop
("fork() called from a process already using GNU OpenMP"), and so a sweep by ProcessPoolExecutor, which forks on Linux up to Python 3.13.
A loop with one thread needs no other, and magmpm's results have the same bits with any number of threads. So the child says to Numba's
layer of threads that it begins anew, with one.

This is the only file that calls Numba's layer itself, which has no public name for it: `launch_threads` notes the process that
it belongs to, and `set_num_threads` acts as numba.set_num_threads does, without locks, which another thread of the parent may have
held at the fork. Where the layer was not loaded before the fork, or is another one, nothing is done: TBB, Numba's own queue and
other makers' OpenMP stand a fork.
"""

import os
import sys
from ctypes import CFUNCTYPE, c_int
from typing import Any

LAYER = "numba.np.ufunc.omppool"


def go_on_with_one_thread() -> None:
    """Let this process, a fork, run parallel loops by itself."""
    layer: Any = sys.modules.get(LAYER)
    if layer is None or layer.openmp_vendor != "GNU":
        return
    count = CFUNCTYPE(None, c_int)
    count(layer.launch_threads)(1)
    count(layer.set_num_threads)(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=go_on_with_one_thread)
