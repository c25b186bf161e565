"""Python files outside the packages as modules: scripts of the gallery, and files that a test writes."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType


def module_of(path: Path, name: str | None = None, *, kept: bool = True) -> ModuleType:
    """A file, run anew as the module of this name [that of the file]; kept: where imports and dataclasses find it."""
    spec = importlib.util.spec_from_file_location(name or path.stem, path)
    module = importlib.util.module_from_spec(spec)
    if kept:
        sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module
