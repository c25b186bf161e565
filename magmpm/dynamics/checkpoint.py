"""State of a motion on disk. From it the motion continues as if it had never stopped."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from magmpm.compiled.arrays import Array, Plain
from magmpm.errors import InputError
from magmpm.results.file_names import CHECKPOINT
from magmpm.results.whole_file import whole_file
from magmpm.scene import Scene
from magmpm.scene.options import Dynamic


def motion_hash(scene: Scene) -> str:
    """Scene.hash() of all settings that decide a motion up to any time: all but its duration, its frames and its budgets.

    Of equilibria along time, whose steps decide how a branch is followed: all but its budget.
    """
    if scene.solver.dynamic is None:
        assert scene.solver.quasi_static is not None
        path = scene.solver.quasi_static.model_copy(update={"max_disk": None})
        return scene.model_copy(
            update={"solver": scene.solver.model_copy(update={"quasi_static": path})}
        ).hash()
    endless = scene.solver.dynamic.model_copy(
        update={"duration": 1.0, "output_every": None, "max_disk": None, "max_memory": None}
    )
    return scene.model_copy(
        update={"solver": scene.solver.model_copy(update={"dynamic": endless})}
    ).hash()


@dataclass(frozen=True)
class Checkpoint:
    """State arrays of a motion after `steps` steps, at frame number `frame`, time s.

    scene_hash: see `motion_hash`; every s: time between frames; control: state of StepControl.
    """

    scene_hash: str
    every: float
    time: float
    formulation: str
    frame: int
    steps: int
    control: Plain
    state: dict[str, Array]

    def save(self, folder: Path | str) -> Path:
        """Write the checkpoint to a folder, over an earlier one, completely or not at all. Raises OSError, with the name of the file."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        about = {name: value for name, value in vars(self).items() if name != "state"}
        with whole_file(folder / CHECKPOINT) as part, part.open("wb") as stream:
            np.savez(stream, **{"about": np.array(json.dumps(about)), **self.state})  # type: ignore[arg-type]
        return folder / CHECKPOINT

    @classmethod
    def load(cls, folder: Path | str, scene: Scene) -> Checkpoint | None:
        """The checkpoint in a folder, or None. Raises InputError if it is another scene's, exceeds its duration, or can't be read."""
        path = Path(folder) / CHECKPOINT
        if not path.exists():
            return None
        try:
            with np.load(path) as stored:
                arrays = dict(stored)
            saved = cls(**json.loads(str(arrays.pop("about"))), state=arrays)
        except Exception as error:  # a damaged archive raises a dozen kinds: BadZipFile, EOFError, zlib.error, TypeError, ...
            raise _useless(
                path, f"a file that can't be read ({type(error).__name__}: {error})"
            ) from None
        saved._must_be_of(scene, path)
        return saved

    def _must_be_of(self, scene: Scene, path: Path) -> None:
        """Raise InputError unless the motion of a scene can continue from here: the same scene, possibly with a longer duration."""
        options = scene.solver.dynamic
        if self.scene_hash != motion_hash(scene) or (
            options is not None and (options.output_every or self.every) != self.every
        ):
            but = "only its budget (max_disk) may differ"
            if options is not None:
                but = (
                    "only its duration may be longer, and its budgets (max_disk, max_memory) may "
                    "differ"
                )
            raise InputError(
                str(path),
                received="the checkpoint of another scene (or the file was changed since)",
                rule=f"a checkpoint resumes only the scene that wrote it; {but}",
                remedy="run without --resume, or into another folder with --out",
            )
        if options is None:  # equilibria along time
            return
        if options.duration < self.time * (1 - 1e-9):
            raise InputError(
                f"{path}: solver.dynamic.duration",
                received=f"{options.duration:.6g} s",
                rule=f"must be at least the time already simulated, {self.time:.6g} s",
                remedy="give a longer one, or run without --resume to start over",
            )
        if (
            self.frame
            and not abs(self.times(options)[self.frame - 1] - self.time) <= 1e-9 * self.time
        ):
            raise InputError(
                f"{path}: solver.dynamic.duration",
                received=f"{options.duration:.6g} s, of a motion that ended at {self.time:.6g} s",
                rule=(
                    f"a motion is extended from one of its frames, every {self.every:.6g} s, and "
                    "it ended between two of them"
                ),
                remedy="run without --resume to start over",
            )

    def times(self, options: Dynamic) -> list[float]:
        """Times (s) of all frames but the first of a motion that continues from here, at the same interval."""
        return options.model_copy(update={"output_every": self.every}).frame_times

    def must_fit(self, state: dict[str, Array], folder: Path | str) -> None:
        """Raise InputError unless the checkpoint has the arrays and shapes of a motion's state. folder: where it was loaded from."""
        found, needed = (
            {name: name[:5] == "pair_" or array.shape for name, array in each.items()}
            for each in (self.state, state)
        )
        if found != needed:
            raise _useless(
                Path(folder) / CHECKPOINT, f"arrays {found}, where this motion has {needed}"
            )


def _useless(path: Path, received: str) -> InputError:
    rule = "the checkpoint to resume from must be whole, and of this version of magmpm"
    return InputError(
        str(path),
        received=received,
        rule=rule,
        remedy="remove it, or run without --resume to start over",
    )
