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
from numba.core.codegen import JITCodeLibrary
from numba.core.environment import lookup_environment
from numba.core.registry import cpu_target

from magmpm.compiled.environment import PACKAGE, cache_folder, source_hash
from magmpm.compiled.process import started

_DIGEST = 32  # bytes
_ENVIRONMENT = "_ZN08NumbaEnv"  # how the names of Numba's environments begin
_noted: set[str] = set()
_compiles_here = False


def jit(*, elsewhere: bool = False, written: bool = False, **options: Any) -> Callable[..., Any]:
    """numba.njit with this cache, as a decorator; options: of njit.

    elsewhere: for functions called before a run's kernels are compiled (magmpm.solving.precompile says why not in this process);
    written: for those that are found by their address, of which machine code is kept.
    """
    compiles = numba.njit(**options)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiles(function)
        try:
            dispatcher._cache = KernelCache(function, written)
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
    _write_late()


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


def load_first(context: Any, load: Callable[[], Any]) -> None:
    """Have this called, in every process, before the function that is being compiled is loaded from the disk."""
    context.active_code_library._reload_init.add(load)


def kept_all() -> bool:
    """True if the disk has saved everything that this process compiled."""
    return not any("not kept" in line for line in _noted)


def _write_late() -> None:
    """Write machine code late, in this process."""
    codegen: Any = cpu_target.target_context.codegen()
    set_env = codegen.set_env

    def set_known(name: str, environment: Any) -> None:
        if codegen._engine.is_symbol_defined(name):
            set_env(name, environment)

    codegen._library_class = _LateLibrary
    codegen.set_env = set_known


class _LateLibrary(JITCodeLibrary):  # type: ignore[misc]
    """A function's code with that of what it calls, of which machine code is written when its address is asked for.

    Most compiled functions are only linked into others, as LLVM's code. Numba writes machine code for each of them too: a sixth of the time
    to compile. What is never written is kept on the disk as LLVM's code.
    """

    _written = False

    def _finalize_final_module(self) -> None:
        if self._object_caching_enabled and self._compiled_object:  # it comes from the disk
            self._write()
            return
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def _write(self) -> None:
        self._written = True
        super()._finalize_final_module()
        codegen: Any = self._codegen
        for variable in self._final_module.global_variables:
            if variable.name.startswith(_ENVIRONMENT):
                environment = lookup_environment(variable.name)
                if environment is not None:
                    codegen.set_env(variable.name, environment)

    def get_pointer_to_function(self, name: str) -> int:
        """Address of a function, 0 if there is none of this name."""
        self._ensure_finalized()
        if not self._written and any(one.name == name for one in self.get_defined_functions()):
            self._write()
        return int(super().get_pointer_to_function(name))

    def serialize_using_object_code(self) -> Any:
        """Name, kind and code to be kept on the disk."""
        if self._written:
            return super().serialize_using_object_code()
        return self.serialize_using_bitcode()


class KernelCache(FunctionCache):  # type: ignore[misc]
    """The cache of one function."""

    def __init__(self, function: Callable[..., Any], written: bool = False) -> None:
        super().__init__(function)
        self._written = written
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
        if self._written:
            data.library.get_pointer_to_function(data.fndesc.llvm_func_name)
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
