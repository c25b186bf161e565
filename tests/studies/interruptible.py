"""A study in a separate process, which a test can kill in the middle of a trial.

python interruptible.py STUDY OUT SAMPLER [N WHERE]: stops in the N-th trial of this process (from 1), at WHERE: before its
solve ("solve"), or after its picture and attributes, when only its value is missing ("tell"). Then OUT/waiting exists.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import optuna
from rod_solve import RodResult, RodSensitivities, differentiate, solve

from magmpm.scene import Scene
from magmpm.studies.engine.loop import run_study
from magmpm.studies.evaluate.trial import Trial
from magmpm.studies.search.definition import load_study


def draw(result: RodResult, path: Path, trial: Trial) -> Path:
    """Writes a stand-in for a picture file."""
    path.write_bytes(f"trial {trial.number} rms {trial.rms_m}".encode())
    return path


def main(study: str, out: str, sampler: str, at: str = "0", where: str = "solve") -> None:
    calls = {"solve": 0, "tell": 0}
    tell = optuna.Study.tell

    def count(place: str) -> None:
        calls[place] += 1
        if place == where and calls[place] == int(at):
            _wait(Path(out))

    def counted_solve(scene: Scene) -> RodResult:
        count("solve")
        return solve(scene)

    def counted_differentiate(scene: Scene, of: Sequence[str]) -> RodSensitivities:
        count("solve")
        return differentiate(scene, of)

    def counted_tell(*args: Any, **options: Any) -> Any:
        count("tell")
        return tell(*args, **options)

    optuna.Study.tell = counted_tell  # type: ignore[method-assign]
    run_study(
        load_study(study),
        solve=counted_solve,
        differentiate=counted_differentiate,
        picture=draw,
        out=out,
        sampler=sampler,
    )  # type: ignore[arg-type]


def _wait(out: Path) -> NoReturn:
    (out / "waiting").touch()
    while True:
        time.sleep(60)


if __name__ == "__main__":
    main(*sys.argv[1:])
