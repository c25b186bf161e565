"""A folder of results belongs to one scene and holds one result of it: what a run writes there, and what happens to earlier results.

A run replaces earlier results only when it has succeeded. A motion is written while it runs, so earlier results are kept in FOLDER/earlier
until it has ended. If a run fails, the earlier results stay and its last good state goes to FOLDER/failed, or to an empty FOLDER itself.
"""

import json
import time
from collections.abc import Collection
from pathlib import Path

from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError
from magmpm.inputs.user_files import MOST_JSON_BYTES, read_regular
from magmpm.results.file_names import (
    ABOUT,
    CHECKPOINT,
    EARLIER,
    FAILED,
    FORMATS,
    FRAMES,
    MOTION,
    NUMBERS,
    OF_ACCURACY,
    OF_EQUILIBRIUM,
    OF_MOTION,
    OWNER,
    PICTURES,
)
from magmpm.results.folder_lock import LOCK
from magmpm.results.result import Result
from magmpm.results.whole_file import write_json
from magmpm.scene import Scene


def holds_run(folder: Path) -> bool:
    """True if a folder holds the results of a run, finished or begun."""
    return any((folder / name).exists() for name in (OWNER, NUMBERS, MOTION))


class RunFolder:
    """The folder that a scene's results go to. Whoever writes it holds its lock (magmpm.results.folder_lock)."""

    def __init__(self, path: Path | str, scene: Scene, scene_file: Path | str) -> None:
        self.path = Path(path)
        self.scene = scene
        self.scene_file = Path(scene_file).resolve()
        self.written = False  # whether a motion of this run is there: one that began, or goes on

    def claim(self, overwrite: bool = False) -> None:
        """Check that the folder is this scene's: written from this file, or by the same definition. Raises InputError, unless overwrite."""
        if (self.path / EARLIER).is_dir() and not any(
            (self.path / name).exists() for name in (NUMBERS, MOTION)
        ):
            self.put_back()  # a run was killed before anything was written in its place
        holder = self._holder()
        if overwrite or not holder:
            return
        stem = self.scene_file.stem
        other = self.path.with_name(stem if stem != self.path.name else f"{stem}-2")
        raise InputError(
            f"{self.path}: holds the results of another scene, {holder}",
            received=f"{self.scene.name} ({self.scene_file})",
            rule="a folder of results belongs to one scene",
            remedy=(
                f"use another folder, say, --out {other}; or --overwrite, which removes those"
                " results"
            ),
        )

    def holding(self) -> str:
        """Describe the files there that a run would replace; "" if none."""
        words = _described(self.path / EARLIER if (self.path / EARLIER).is_dir() else self.path)
        if any((self.path / name).exists() for name in (*PICTURES, FRAMES)):
            words = f"{words}, with its pictures" if words else "pictures of an earlier result"
        holder = self._holder()
        return f"{words} (of {holder})" if words and holder else words

    def set_aside(self) -> None:
        """Make room for a motion that begins: a result is kept in FOLDER/earlier, anything else is removed."""
        waiting = self.path / EARLIER
        if not waiting.exists() and _worth_keeping(self.path):
            waiting.mkdir()
            _move(self.path, waiting)
        else:
            _remove(self.path)
        self.written = True
        self._sign()

    def put_back(self) -> None:
        """Move the results kept in FOLDER/earlier back."""
        waiting = self.path / EARLIER
        if waiting.is_dir():
            _remove(self.path)
            _move(waiting, self.path)
            waiting.rmdir()

    def save(self, result: Result) -> None:
        """Save a result in place of all that was there."""
        result.save(self.path)
        kept = {*OF_EQUILIBRIUM, *(() if result.formulation == "static" else OF_MOTION)}
        if (
            read_mapping(self.path / OWNER).get("accuracy_hash", self.scene.hash())
            != self.scene.hash()
        ):
            _remove(self.path, OF_ACCURACY)
        _remove(self.path, (*OF_EQUILIBRIUM, *OF_MOTION), kept=kept)
        for folder in (EARLIER, FAILED):
            _remove(self.path / folder)
        self._sign()

    def save_failed(self, result: Result) -> Path:
        """The last good state of a run that failed, marked as such. Returns the folder it is in."""
        moving = result.formulation != "static" and self.written
        waiting = (self.path / EARLIER).is_dir()
        if not moving and waiting and not (self.path / CHECKPOINT).exists():
            self.put_back()
        if waiting if moving else _worth_keeping(self.path):
            target = self.path / FAILED
            _remove(target)
            target.mkdir(exist_ok=True)
            if moving:
                _move(self.path, target)
                self.put_back()
        else:
            target = self.path
            if not moving:
                _remove(self.path)
        result.save(target)
        self._sign(target)
        return target

    def sign_accuracy(self) -> None:
        """Note that what `magmpm accuracy` writes next to a run's results is this scene's; results of another scene are removed."""
        if self._holder():
            _remove(self.path)
        self._sign(accuracy_hash=self.scene.hash())

    def _sign(self, folder: Path | None = None, **more: str) -> None:
        folder = folder or self.path
        known = {
            key: value
            for key, value in read_mapping(folder / OWNER).items()
            if key == "accuracy_hash"
        }
        about = {
            "name": self.scene.name,
            "scene_file": str(self.scene_file),
            "scene_hash": self.scene.hash(),
        }
        write_json(folder / OWNER, {**about, **known, **more}, indent=1)

    def _holder(self) -> str:
        """Name and file of the scene whose results are there; "" if it is this one, or unknown."""
        owner = read_mapping(self.path / OWNER)
        if owner.get("scene_file"):
            if (
                owner.get("scene_hash") == self.scene.hash()
                or Path(str(owner["scene_file"])) == self.scene_file
            ):
                return ""
            return f"{owner.get('name')} ({owner['scene_file']})"
        for name in (NUMBERS, ABOUT):  # saved by Python code, which knows no file
            known = read_mapping(self.path / name)
            if known.get("scene") and known["scene"] != json.loads(json.dumps(self.scene.to_si())):
                return str(known.get("name") or "one without a name")
        return ""


def _described(folder: Path) -> str:
    """A run's result in words; "" if there is none."""
    at = next((folder / name for name in (NUMBERS, MOTION) if (folder / name).exists()), None)
    if at is None:
        return ""
    when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(at.stat().st_mtime))
    if at.name == MOTION:
        return f"the unfinished motion of {when}"
    known = read_mapping(at)
    if not known:
        return f"a result of {when} that can't be read"
    what = (
        "equilibrium"
        if known.get("formulation") == "static"
        else f"motion over {known.get('time', 0.0):g} s"
    )
    return f"the {'' if known.get('converged') else 'failed '}{what} of {when}"


def _worth_keeping(folder: Path) -> bool:
    """True if a run that fails must save this: a result, or a motion that can be resumed; not an older failure."""
    if (folder / NUMBERS).exists():
        return read_mapping(folder / NUMBERS).get("converged") is True
    return (folder / CHECKPOINT).exists()


def _move(source: Path, target: Path) -> None:
    """Move what a run writes into another folder, which has none of it."""
    for name in (*OF_MOTION, *OF_EQUILIBRIUM, OWNER, *PICTURES, FRAMES):
        if (source / name).exists():
            (source / name).replace(target / name)


def _remove(
    folder: Path,
    names: tuple[str, ...] = (*OF_EQUILIBRIUM, *OF_MOTION, OWNER),
    kept: Collection[str] = (),
) -> None:
    """Remove what a run writes and its pictures, and the folder if it is then empty and not the scene's own."""
    for name in (*names, *PICTURES):
        if name not in kept:
            (folder / name).unlink(missing_ok=True)
    frames = folder / FRAMES
    for picture in frames.glob("frame_*"):
        if picture.suffix[1:] in FORMATS:
            picture.unlink()
    if folder.name in (EARLIER, FAILED):
        (folder / LOCK).unlink(missing_ok=True)  # of `magmpm render`
    for empty in (frames, folder):
        if empty.name in (FRAMES, EARLIER, FAILED) and empty.is_dir() and not any(empty.iterdir()):
            empty.rmdir()


def read_mapping(path: Path) -> Plain:
    """A JSON file's mapping; empty where it can't be read."""
    try:
        known = json.loads(read_regular(path, MOST_JSON_BYTES))
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) else {}
