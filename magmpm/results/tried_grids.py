"""Where the motions of grids that are only tried are written: apart from a folder's results, until one of them is the answer."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from magmpm.results.file_names import CHECKPOINT, OF_MOTION, TRYING, forget_motion


@contextmanager
def tried_grids(folder: Path | str, on_begin: Callable[[], None] | None) -> Iterator[Path]:
    """A folder in `folder` for motions of several grids. The last one moves to `folder` when all is done; in between, and after a refusal,
    a failure or an interruption, `folder` is as it was.

    Without its checkpoint: what is asked for is a time, which a run that goes on has no share of. on_begin(): called before it moves.
    """
    apart = Path(folder) / TRYING
    forget_tried(folder)
    apart.mkdir(parents=True)
    try:
        yield apart
        _move(apart, Path(folder), on_begin)
    finally:
        forget_tried(folder)


def forget_tried(folder: Path | str) -> None:
    """Remove what a run left that was killed as it tried grids."""
    shutil.rmtree(Path(folder) / TRYING, ignore_errors=True)


def _move(apart: Path, folder: Path, on_begin: Callable[[], None] | None) -> None:
    if on_begin is not None:
        on_begin()
    forget_motion(folder)
    for name in OF_MOTION:
        if name != CHECKPOINT and (apart / name).exists():
            (apart / name).replace(folder / name)
