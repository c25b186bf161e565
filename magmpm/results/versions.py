"""The versions of what a result was made with."""

from __future__ import annotations

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version


def versions() -> dict[str, str]:
    """Versions of Python, magmpm and the packages that compute for it, by name."""
    return dict(_versions())


@cache
def _versions() -> dict[str, str]:
    found = {"python": platform.python_version()}
    for name in ("magmpm", "numpy", "scipy", "numba"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


# How to cite, in words: as CITATION.cff says it.
CITATION = (
    "The magmpm developers (2026). magmpm: simulation and computational design of magnetic soft robots with the material point method, "
    "version 0.1.0, MIT license."
)
SOURCES = (
    "T. Akiba, S. Sano, T. Yanase, T. Ohta, M. Koyama: Optuna: a next-generation hyperparameter optimization framework. KDD 2019. "
    "doi:10.1145/3292500.3330701 (the search)",
    "S. K. Lam, A. Pitrou, S. Seibert: Numba: a LLVM-based Python JIT compiler. LLVM-HPC 2015. doi:10.1145/2833157.2833162 (the kernels)",
    "R. Zhao, Y. Kim, S. A. Chester, P. Sharma, X. Zhao: Mechanics of hard-magnetic soft materials. J. Mech. Phys. Solids 124 (2019) 244. "
    "doi:10.1016/j.jmps.2018.10.008 (the magnetic stress)",
)  # what a study stands on
