"""Files that a study leaves in its folder: a picture of every trial, and the result of every design that was the best so far.

OUT/pictures/trial_007.png    also an Optuna artifact of the trial, in OUT/artifacts, which the dashboard shows
OUT/improvements/007/         result and design of a trial that was the best when it ran
OUT/best/                     the same of the best trial, and its scene as a file that runs, scene.yaml
"""

from __future__ import annotations

import filecmp
import json
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.compiled.arrays import Plain
from magmpm.errors import InputError, require
from magmpm.inputs.user_files import MOST_JSON_BYTES, read_regular
from magmpm.results.result import readable
from magmpm.results.whole_file import whole_file
from magmpm.studies.engine.storage import StorageError, storage_faults
from magmpm.studies.engine.storage_url import shown_url
from magmpm.studies.evaluate.evaluator import PICTURES

if TYPE_CHECKING:
    import optuna
    from optuna.artifacts import Boto3ArtifactStore, FileSystemArtifactStore
    from optuna.trial import FrozenTrial

    from magmpm.results.result import Result

ARTIFACTS = "artifacts"
S3 = "s3://"
SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")
BEST = "best"
IMPROVEMENTS = "improvements"
DESIGN = "design.json"


def whole_place(place: str) -> str:
    """Name the place of pictures from wherever it is looked for.

    Parameters
    ----------
    place : str
        A folder, or s3://BUCKET.

    Returns
    -------
    str
        An absolute path, or s3://BUCKET.

    Raises
    ------
    InputError
        For other addresses.
    """
    if SCHEME.match(place) and not place.startswith(S3):
        raise InputError(
            "--artifacts",
            received=shown_url(place),
            rule="must be a folder, or s3://BUCKET",
            remedy="--artifacts s3://my-study, or a folder that all machines see",
        )
    return place if place.startswith(S3) else str(Path(place).resolve())


def artifact_store(place: str | None, out: Path) -> FileSystemArtifactStore | Boto3ArtifactStore:
    """Make the store of a study's pictures, by Optuna's own stores.

    The keys of S3 come from where its clients look for them (AWS_ACCESS_KEY_ID, ~/.aws, a role),
    the address of a store that is not Amazon's from AWS_ENDPOINT_URL; neither is kept with the
    study.

    Parameters
    ----------
    place : str or None
        A folder, s3://BUCKET, or None for the study's own.
    out : Path
        The study's folder.

    Returns
    -------
    FileSystemArtifactStore or Boto3ArtifactStore
        The store.

    Raises
    ------
    InputError
        Where there is no such store.
    """
    from optuna.artifacts import Boto3ArtifactStore, FileSystemArtifactStore

    if place is not None:
        place = whole_place(place)
    if place is None or not place.startswith(S3):
        folder = out / ARTIFACTS if place is None else Path(place)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                "--artifacts",
                received=str(folder),
                rule=f"must be a folder that can be made, or s3://BUCKET ({error.strerror})",
                remedy="name another folder",
            ) from None
        return FileSystemArtifactStore(str(folder))
    bucket = place.removeprefix(S3).rstrip("/")
    if not BUCKET.fullmatch(bucket):
        rule = (
            "must name a bucket alone: 3 to 63 letters a to z, digits, dots and hyphens; keys come"
            " from the environment"
        )
        raise InputError(
            "--artifacts", received="s3://...", rule=rule, remedy="--artifacts s3://my-study"
        )
    require("boto3", "s3", key="--artifacts", use="S3-compatible stores")
    return Boto3ArtifactStore(bucket)


class Gallery:
    """The pictures of a study's trials, as files and as Optuna artifacts.

    Parameters
    ----------
    out : Path
        The study's folder.
    storage : optuna.storages.BaseStorage
        The storage.
    url : str
        Of the storage.
    place : str, optional
        Where artifacts are kept; None for the folder itself.
    """

    def __init__(
        self, out: Path, storage: optuna.storages.BaseStorage, url: str, place: str | None = None
    ) -> None:
        """url: of the storage; place: where artifacts are kept, None for the folder itself."""
        self._out = out
        self._storage = storage
        self._url = url
        (out / PICTURES).mkdir(parents=True, exist_ok=True)
        self._store = artifact_store(place, out)
        self._own = place is None

    def attach(self, trial: optuna.Trial, files: Sequence[Path]) -> str | None:
        """Attach pictures to a trial. What an interrupted run of the same trial has attached already is replaced.

        Parameters
        ----------
        trial : optuna.Trial
            The trial.
        files : sequence of Path
            Its pictures.

        Returns
        -------
        str or None
            The reason if that is not possible: a missing picture never fails a trial.
        """
        from optuna.artifacts import get_all_artifact_meta, upload_artifact

        try:
            with storage_faults(self._url):
                known = {
                    meta.filename: meta.artifact_id
                    for meta in get_all_artifact_meta(trial, storage=self._storage)
                }
                for path in files:
                    if path.name in known:
                        self._put(path, known[path.name])
                    else:
                        key = upload_artifact(
                            artifact_store=self._store, file_path=str(path), study_or_trial=trial
                        )
                        self._stored_once(path, key)
        except StorageError:
            raise
        except Exception as error:  # files go through disks and networks
            return f"{type(error).__name__}: {error}"
        return None

    def _put(self, path: Path, key: str) -> None:
        """Makes a file the artifact with this id."""
        if not self._stored_once(path, key):
            with path.open("rb") as stream:
                self._store.write(key, stream)

    def _stored_once(self, path: Path, key: str) -> bool:
        """Makes the artifact another name of the same file. Returns whether it is one.

        Surfaces alone, some 350 kB a trial: a copy of a picture mends the one that is damaged. Some file systems have no such names.
        """
        kept = self._out / ARTIFACTS / key
        if not self._own or path.suffix != ".stl" or Path(key).name != key:
            return False
        try:
            if not (kept.exists() and kept.samefile(path)):
                with whole_file(kept) as part:
                    part.unlink(missing_ok=True)
                    part.hardlink_to(path)
        except OSError:
            return False
        return True

    def mend(self, trials: Sequence[FrozenTrial]) -> list[str]:
        """Put back artifacts that are gone or damaged from the study's pictures.

        Parameters
        ----------
        trials : sequence of FrozenTrial
            Those whose pictures are looked at.

        Returns
        -------
        list of str
            A sentence for each that can't be put back.
        """
        from optuna.artifacts import get_all_artifact_meta

        mended = 0
        lost = []
        if not self._own:  # other sessions write there as well
            return []
        for trial in trials:
            for meta in get_all_artifact_meta(trial, storage=self._storage):
                if any(Path(name).name != name for name in (meta.filename, meta.artifact_id)):
                    continue  # a database is data: what it names stays below the study's folder
                picture = self._out / PICTURES / meta.filename
                kept = self._out / ARTIFACTS / meta.artifact_id
                if not picture.is_file():
                    if not kept.is_file():
                        lost.append(
                            f"trial {trial.number}: its artifact {meta.filename} is gone, and so is"
                            f" the file in {PICTURES}"
                        )
                elif not kept.is_file() or not filecmp.cmp(picture, kept, shallow=False):
                    self._put(picture, meta.artifact_id)
                    mended += 1
        return [
            *(
                [f"artifacts that were damaged or gone, and are put back from {PICTURES}: {mended}"]
                if mended
                else []
            ),
            *lost,
        ]


def save_design(folder: Path, result: Result, design: Plain) -> None:
    """Write a result and the design that it belongs to into a folder; the design last.

    Parameters
    ----------
    folder : Path
        Where they are written.
    result : Result
        The result.
    design : dict[str, Any]
        number, rms_m, params, ...
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / DESIGN).unlink(missing_ok=True)
    result.save(folder)
    with whole_file(folder / DESIGN) as part:
        part.write_text(json.dumps(design, indent=1) + "\n", encoding="utf-8")


def holds(folder: Path, trial: FrozenTrial) -> bool:
    """Tell whether a folder holds the complete result of a trial, readable.

    Parameters
    ----------
    folder : Path
        The folder.
    trial : FrozenTrial
        The trial.

    Returns
    -------
    bool
        True if it does.
    """
    design = read_design(folder)
    return (
        design.get("number") == trial.number
        and design.get("params") == trial.params
        and readable(folder)
    )


def read_design(folder: Path) -> Plain:
    """Read what a folder says of its design.

    Parameters
    ----------
    folder : Path
        The folder.

    Returns
    -------
    dict[str, Any]
        The design; empty if nothing is readable.
    """
    try:
        design = json.loads(read_regular(folder / DESIGN, MOST_JSON_BYTES))
    except (OSError, ValueError):
        return {}
    return design if isinstance(design, dict) else {}


def designs(out: Path) -> dict[int, Plain]:
    """Find the designs that a study's folder holds.

    Parameters
    ----------
    out : Path
        The study's folder.

    Returns
    -------
    dict[int, dict[str, Any]]
        Parameters by the trials' numbers.
    """
    found = [read_design(folder) for folder in [out / BEST, *(out / IMPROVEMENTS).glob("[0-9]*")]]
    return {
        design["number"]: design["params"]
        for design in found
        if "number" in design and "params" in design
    }


def replace_folder(source: Path, target: Path) -> None:
    """Make a folder a copy of another; it is never left half copied.

    Parameters
    ----------
    source : Path
        The other folder.
    target : Path
        What becomes its copy.
    """
    part = target.with_name(f".{target.name}")
    shutil.rmtree(part, ignore_errors=True)
    shutil.copytree(source, part)
    shutil.rmtree(target, ignore_errors=True)
    part.replace(target)
