"""Settings that libraries read from the environment when they are first imported: made before anything of magmpm is.

A user's own settings win; these only fill gaps.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
from pathlib import Path

PACKAGE = Path(__file__).parent
KEPT_CACHES = 4  # folders of earlier source versions that stay on disk


def source_hash() -> str:
    """Hash (16 hex digits) of every Python file of the package, names and content."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(PACKAGE)).encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    root = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "magmpm"
    folder = root / f"numba-{source_hash()}"
    if not folder.exists():
        old = sorted(root.glob("numba-*"), key=lambda p: p.stat().st_mtime, reverse=True)
        for stale in old[KEPT_CACHES - 1 :]:
            shutil.rmtree(stale, ignore_errors=True)
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def prepare() -> None:
    """Set Numba's cache folder and the threads' waiting policy, unless the user has."""
    if "NUMBA_CACHE_DIR" not in os.environ:
        os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder())
        if "numba" in sys.modules:  # it has read its environment already
            sys.modules["numba"].config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"]
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # spinning threads cost 2-4x beside a render process
