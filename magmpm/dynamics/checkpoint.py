"""A motion's state on disk, from which it goes on as if it had never stopped."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmpm.basis import Array
from magmpm.errors import InputError
from magmpm.motion_files import CHECKPOINT
from magmpm.wording import report


@dataclass(frozen=True)
class Checkpoint:
    """State arrays of a motion after `steps` steps, at frame number `frame`; control: of StepControl; scene_hash: of what."""

    scene_hash: str
    formulation: str
    frame: int
    steps: int
    control: dict[str, float]
    state: dict[str, Array]

    def save(self, folder: Path | str) -> Path:
        """Write it into a folder, in place of an earlier one, whole or not at all."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        about = {k: getattr(self, k) for k in ("scene_hash", "formulation", "frame", "steps", "control")}
        part = folder / f".{CHECKPOINT}"
        with part.open("wb") as stream:
            np.savez(stream, **{"about": np.array(json.dumps(about)), **self.state})  # type: ignore[arg-type]
        return part.replace(folder / CHECKPOINT)

    @classmethod
    def load(cls, folder: Path | str, scene_hash: str) -> Checkpoint | None:
        """The checkpoint in a folder, None if there is none.

        Raises InputError if it belongs to another scene or can't be read.
        """
        path = Path(folder) / CHECKPOINT
        if not path.exists():
            return None
        try:
            with np.load(path) as stored:
                arrays = dict(stored)
            saved = cls(**json.loads(str(arrays.pop("about"))), state=arrays)
        except Exception as error:  # a damaged archive raises a dozen kinds: BadZipFile, EOFError, zlib.error, TypeError, ...
            raise _useless(path, f"a file that can't be read ({type(error).__name__}: {error})") from None
        if saved.scene_hash != scene_hash:
            raise InputError(
                report(
                    str(path),
                    received="the checkpoint of another scene (or the file was changed since)",
                    rule="only the scene that it was written by can be resumed from it",
                    remedy="run without --resume, or into another folder with --out",
                )
            )
        return saved

    def must_fit(self, state: dict[str, Array], folder: Path | str) -> None:
        """Raises InputError unless it holds the arrays that a motion's state has, in their shapes; folder: where it was loaded from."""
        found, needed = ({name: array.shape for name, array in arrays.items()} for arrays in (self.state, state))
        if found != needed:
            raise _useless(Path(folder) / CHECKPOINT, f"arrays {found}, where this motion has {needed}")


def _useless(path: Path, received: str) -> InputError:
    rule = "the checkpoint to resume from must be whole, and of this version of magmpm"
    return InputError(report(str(path), received=received, rule=rule, remedy="remove it, or run without --resume: from the start"))
