"""`magmpm examples`: the scenes, studies and tables that come with magmpm, copied to where they can be changed."""

from __future__ import annotations

import argparse
import filecmp
import shutil
from pathlib import Path

from magmpm.cli.answers import print_summary
from magmpm.errors import InputError, MagmpmError, report

DATA = "data"
INSTALLED = "share/magmpm/data/"  # where a wheel puts them, below the environment's root


def command(options: argparse.Namespace) -> int:
    """Copy them. Returns the exit status. Raises InputError where a file there is another one."""
    source, target = examples_folder(), options.folder / DATA
    files = sorted(path.relative_to(source) for path in source.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    if target.exists() and target.resolve() == source.resolve():
        rule = "they are copied to another folder"
        raise InputError(report(f"{target}: holds the examples themselves", rule=rule, remedy="name another"))
    changed = [name for name in files if (target / name).exists() and not filecmp.cmp(source / name, target / name, shallow=False)]
    if changed and not options.overwrite:
        rule = "files that were changed are kept"
        remedy = "name another folder, or give --overwrite, which puts the examples back as they were"
        raise InputError(report(f"{target}: {len(changed)} of the files there are others, say, {changed[0]}", rule=rule, remedy=remedy))
    for name in files:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)
    first = target / "scenes/five_segments.yaml"
    text = f"{len(files)} files in {target}; try: magmpm run {first} --render"
    print_summary(options, {"folder": str(target), "files": len(files)}, text)
    return 0


def examples_folder() -> Path:
    """Folder of the examples: in the checkout, or where pip put them. Raises MagmpmError where they are gone."""
    checkout = Path(__file__).resolve().parents[2] / DATA
    if (checkout / "scenes").is_dir():
        return checkout
    from importlib.metadata import PackageNotFoundError, files

    try:
        known = files("magmpm") or []
    except PackageNotFoundError:
        known = []
    for name in known:
        before, found, _ = str(name).replace("\\", "/").partition(INSTALLED)
        if found:
            return Path(str(name.locate())).resolve().parents[str(name).replace("\\", "/").removeprefix(before + INSTALLED).count("/")]
    raise MagmpmError("the examples are not installed; install magmpm anew: pip install --force-reinstall magmpm-*.whl")
