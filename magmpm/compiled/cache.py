"""Numba's cache of compiled functions on disk, protected against damaged files and full disks.

Every file begins with a checksum of the rest. A damaged file (cut off by a full disk, or changed) gives a message, and its function is
compiled anew. Numba alone would fail with some error, or run wrong code. If the disk accepts no more files, the run continues, and the next
process compiles the function again.
This relies on private names (with an underscore) of numba.core.caching and codegen, versions 0.61 to 0.68.
"""

import gc
import hashlib
import inspect
import pickle
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.core.ccallback import CFunc

from magmpm.compiled.environment import PACKAGE, cache_folder, source_hash
from magmpm.compiled.process import started

_DIGEST = 32  # bytes
_noted: set[str] = set()
_compiles_here = False


def jit(*, elsewhere: bool = False, **options: Any) -> Callable[..., Any]:
    """numba.njit with this cache, as a decorator; options: of njit.

    elsewhere: for functions called before a run's kernels are compiled (magmpm.solving.precompile says why not in this process).
    """
    compiles = numba.njit(**options)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiles(function)
        try:
            dispatcher._cache = KernelCache(function)
        except RuntimeError:  # raised by Numba if no folder can be written
            _tell("no folder can be written", "is not kept")
            return dispatcher
        if elsewhere:
            dispatcher.compile = lambda signature: _compile_elsewhere(dispatcher, signature)
        return dispatcher

    return decorate


def c_functions(
    wanted: Sequence[tuple[Callable[..., Any], Any, dict[str, Any], Any]],
    compile_them: Callable[[Any], None],
) -> list[Any]:
    """C functions, each with an `address`, to be kept as long as they are called: from the disk, or compiled in a process of their own.

    wanted: of each its Python function, signature, options of njit, and what `compile_them`, a function of a module, takes a list of in
    that process.
    """
    found: list[Any] = []
    missing = []
    for function, signature, options, job in wanted:
        made: Any = CFunc(function, (signature.args, signature.return_type), {}, options)
        found.append(made)
        with suppress(RuntimeError):  # raised by Numba if no folder can be written
            made._cache = KernelCache(function)
            if made._cache.load_overload(made._sig, made._targetdescr.target_context) is None:
                missing.append(job)
    if missing and not _compiles_here:
        _ask_elsewhere((compile_them, missing))
    for made in found:
        made.compile()
    return found


def _compile_elsewhere(dispatcher: Any, signature: Any) -> Any:
    """Compile a function in a process of its own, unless this is one that compiles, and load it from the disk."""
    known = tuple(signature) in dispatcher.overloads
    if not (
        known or _compiles_here or dispatcher._cache.load_overload(signature, dispatcher.targetctx)
    ):
        of = dispatcher.py_func
        _ask_elsewhere((_compile_one, (of.__module__, of.__name__, signature)))
    return type(dispatcher).compile(dispatcher, signature)


def compile_here() -> None:
    """Let this process compile for others. It is short, and the compiler's objects stay: looking for garbage took a seventh of its time."""
    global _compiles_here
    _compiles_here = True
    gc.disable()


def _compile_one(about: tuple[str, str, Any]) -> None:
    """Compile a function by module, name and signature."""
    module, name, signature = about
    getattr(import_module(module), name).compile(signature)


def _ask_elsewhere(job: tuple[Callable[..., None], Any]) -> None:
    """Have a process of its own compile something, a function and what it takes; whatever fails there is compiled here."""
    with started(1, _begin) as (process,), suppress(Exception):
        process.ask(job)


def _begin(_: object) -> Callable[[tuple[Callable[..., None], Any]], None]:
    """Begin a process that compiles for others."""
    compile_here()
    return lambda job: job[0](job[1])


def kept_all() -> bool:
    """True if the disk has saved everything that this process compiled."""
    return not any("not kept" in line for line in _noted)


class KernelCache(FunctionCache):  # type: ignore[misc]
    """The cache of one function."""

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        stamp = [source_hash(), self._cache_file._source_stamp]
        place = Path(inspect.getfile(function)).parent
        if place.is_relative_to(PACKAGE):
            # Time and place of the package's own files differ in every clone; their hash does not.
            self._cache_path = cache_folder() / place.relative_to(PACKAGE)
            self._impl.locator.get_cache_path = lambda: self._cache_path
            stamp.pop()
        self._cache_file = _SealedFiles(
            self._cache_path, f"{self._impl.filename_base}.sealed", stamp
        )

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save a compiled function, if the disk accepts it."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _tell(f"{self._cache_path}: {error.strerror or error}", "is not kept")

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The saved function, or None."""
        try:
            if (found := super().load_overload(sig, target_context)) is not None:
                found.library._reload_init.update(
                    found.reload_init
                )  # Numba forgets that what calls a parallel kernel must start threads
            return found
        except OSError as error:
            _tell(f"{self._cache_path}: {error.strerror or error}", "can't be read")
            return None


class _SealedFiles(IndexDataCacheFile):  # type: ignore[misc]
    """A function's files: one for each signature, behind a checksum, named by what it was compiled for.

    Numba's own files are numbered by an index. Two processes that save at once both take the next number, and then the index can name the
    other's code for a signature: a run ends with a segmentation fault, or computes with it.
    """

    def save(self, key: Any, data: Any) -> None:
        if self.load(key) is not None:
            # another process was faster, and others may run what it saved: two of a kind can differ
            # in the last bit
            return
        data = self._dump((self._version, self._source_stamp, key, data))
        with self._open_for_write(self._path(key)) as stream:
            stream.write(hashlib.sha256(data).digest() + data)

    def load(self, key: Any) -> Any:
        *about, data = _unsealed(self._path(key)) or [None]
        return data if about == [self._version, self._source_stamp, key] else None

    def _path(self, key: Any) -> Path:
        number = int(hashlib.sha256(repr(key).encode()).hexdigest()[:12], 16)
        return Path(self._data_path(self._data_name(number)))


def _unsealed(path: Path) -> Any:
    """Content of a file, or None if the file is missing or damaged."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    data = content[_DIGEST:]
    if hashlib.sha256(data).digest() != content[:_DIGEST]:
        _tell(f"{path}: damaged", "is compiled again")
        return None
    return pickle.loads(data)


def _tell(what: str, then: str) -> None:
    """Print once what is wrong with the cache, and what happens to a compiled function."""
    line = f"magmpm: compiled kernels on disk: {what}; the kernel {then}"
    if then == "is not kept":
        line += (
            ", so every run waits up to a minute for it; free disk space, or set NUMBA_CACHE_DIR "
            "to another folder"
        )
        if not kept_all():
            return
    if line not in _noted:
        _noted.add(line)
        print(line, file=sys.stderr, flush=True)
