"""Environment variables that libraries read at their first import. They are set before the rest of magmpm is imported.

Settings of the user take precedence.
"""

import hashlib
import os
import re
import shutil
import stat
import sys
import tempfile
from functools import cache
from pathlib import Path

PACKAGE = Path(__file__).parents[1]
MOST_THREADS = 4096
WITHOUT_KERNELS = ("arrays", "thread_count")  # modules of magmpm.compiled that compile nothing
COMPILED_IMPORT = re.compile(r"^from magmpm\.compiled(?:\.(\w+))? import", re.MULTILINE)
NUMBA_IMPORT = re.compile(r"^(?:import|from) numba", re.MULTILINE)
FROM_IMPORT = re.compile(r"^from (magmpm[\w.]*) import (\([^)]*\)|[^\n]+)", re.MULTILINE)
ASSIGNMENT = re.compile(r"^\w+(?:: [^=\n]+)? = (.*(?:\n[ )\]}].*)*)", re.MULTILINE)
COMMENT = re.compile("#.*")
WORD = re.compile(r"\w+")
LAYERS = (
    "default",
    "safe",
    "threadsafe",
    "forksafe",
    "tbb",
    "omp",
    "workqueue",
)  # names that Numba accepts


def compiled_sources(package: Path = PACKAGE) -> list[Path]:
    """Files of the package from which kernels are made: an edit of any other one leaves them as they are.

    A kernel is made of compiled functions, of the records that it is called with, and of the constants that these name. So: all of
    magmpm.compiled; files that import Numba, or anything of it that compiles, or define a record (NamedTuple); and files from which those
    import a constant, or a function that they call for a constant of their own.
    """
    texts = {path: path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    found = {
        path for path, text in texts.items() if path.parent.name == "compiled" or _compiles(text)
    }
    new = sorted(found)
    while new:
        behind = {path for source in new for path in _behind_constants(texts[source], package)}
        new = sorted((behind & texts.keys()) - found)
        found.update(new)
    return sorted(found)


def _compiles(text: str) -> bool:
    """True for the text of a file that may define compiled functions, or records for them."""
    others = COMPILED_IMPORT.findall(text) if "magmpm.compiled" in text else ()
    return (
        any(name not in WITHOUT_KERNELS for name in others)
        or NUMBA_IMPORT.search(text) is not None
        or "(NamedTuple)" in text
    )


def _behind_constants(text: str, package: Path) -> set[Path]:
    """Files from which a file's text imports a constant, or a name that stands in an assignment of its module."""
    assigned = set(WORD.findall("\n".join(ASSIGNMENT.findall(text))))
    found = set()
    for module, listed in FROM_IMPORT.findall(text):
        names = WORD.findall(COMMENT.sub("", listed))
        if any(name.isupper() or name in assigned for name in names):
            path = package.parent / module.replace(".", "/")
            found |= {path.with_suffix(".py"), path / "__init__.py"}
            found |= {path / f"{name}.py" for name in names}
    return found


@cache
def source_hash(package: Path = PACKAGE) -> str:
    """Hash (16 hex digits) of the files that kernels are made from, names and content, as this process found them first."""
    digest = hashlib.sha256()
    for path in compiled_sources(package):
        digest.update(str(path.relative_to(package)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _folder_to_use() -> Path:
    """Folder for kernels compiled from these sources. It is in the system's temporary folder if the user's cache can't be written."""
    name = f"numba-{source_hash()}"
    try:
        root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "magmpm"
        folder = root / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
    except (OSError, RuntimeError) as error:  # RuntimeError: no home folder
        folder = Path(tempfile.gettempdir()) / f"magmpm-{_user()}" / name
        try:
            folder.parent.mkdir(mode=0o700, exist_ok=True)
            refuse_shared(folder.parent)
            folder.mkdir(exist_ok=True)
            print(
                f"magmpm: the cache folder can't be written ({error}); compiled kernels are kept in"
                f" {folder}",
                file=sys.stderr,
            )
        except OSError as other:  # magmpm.compiled.cache works without a folder
            print(
                f"magmpm: no folder for compiled kernels is writable ({error}; {other}): every "
                "run compiles them again",
                file=sys.stderr,
            )
        return folder
    old = sorted(
        (path for path in root.glob("numba-*") if path != folder),
        key=lambda p: p.stat().st_mtime,
        reverse=True,
    )
    for stale in old[3:]:  # with this one, four versions of the sources stay on the disk
        shutil.rmtree(stale, ignore_errors=True)
    return folder


def cache_folder() -> Path:
    """Folder for compiled kernels that this process uses."""
    return Path(os.environ["NUMBA_CACHE_DIR"])


def _user() -> int:
    """Number of this user; 0 on Windows, where files and users have none."""
    return os.getuid() if hasattr(os, "getuid") else 0


def refuse_shared(folder: Path) -> None:
    """Raise PermissionError unless a folder is this user's own and no other's to write: compiled kernels are code that is run."""
    about = folder.lstat()
    if (
        not stat.S_ISDIR(about.st_mode)
        or about.st_uid != _user()
        or about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    ):
        raise PermissionError(f"{folder} can be written by other users")


def prepare() -> None:
    """Set Numba's cache folder and the waiting policy of threads, unless the user has set them."""
    if not os.environ.get("NUMBA_CACHE_DIR"):
        os.environ["NUMBA_CACHE_DIR"] = str(_folder_to_use())
        if "numba" in sys.modules:  # it has already read the environment
            sys.modules["numba"].config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]
    os.environ.setdefault(
        "OMP_WAIT_POLICY", "passive"
    )  # with a render process beside them, spinning threads are 2-4 times slower
    # But a thread that sleeps between two loops of a step wakes late, so it spins for some ten microseconds, a third of a small step.
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")


def refuse_unusable() -> None:
    """Raise InputError for thread settings that would make Numba fail, at its first import or its first parallel loop."""
    from magmpm.errors import InputError

    threads = os.environ.get("NUMBA_NUM_THREADS")
    layer = os.environ.get("NUMBA_THREADING_LAYER")
    if threads is not None and not (
        re.fullmatch(r"\s*[0-9]{1,9}\s*", threads) and 1 <= int(threads) <= MOST_THREADS
    ):
        raise InputError(
            "NUMBA_NUM_THREADS",
            received=threads or "nothing",
            rule=f"must be a whole number from 1 to {MOST_THREADS}",
            remedy=f"set it to, say, {os.cpu_count() or 1}, or unset it",
        )
    if layer is not None and layer.lower() not in LAYERS:
        raise InputError(
            "NUMBA_THREADING_LAYER",
            received=layer or "nothing",
            rule=f"must be one of {', '.join(LAYERS)}",
            remedy="unset it",
        )
