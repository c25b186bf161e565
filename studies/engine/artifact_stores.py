"""Extra stores for the pictures of trials: in the study's folder, in a folder that sessions share, or in an S3-compatible store.

All by Optuna's own stores. The keys of S3 come from where its clients look for them (AWS_ACCESS_KEY_ID, ~/.aws, a role), the address of a
store that is not Amazon's from AWS_ENDPOINT_URL; neither is kept with the study.
"""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import TYPE_CHECKING

from magmpm.errors import InputError, report
from magmpm.studies.engine.storage_url import shown_url

if TYPE_CHECKING:
    from optuna.artifacts import Boto3ArtifactStore, FileSystemArtifactStore

ARTIFACTS = "artifacts"
S3 = "s3://"
SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")


def whole_place(place: str) -> str:
    """The place of pictures from wherever it is looked for: an absolute path, or s3://BUCKET. Raises InputError for other addresses."""
    if SCHEME.match(place) and not place.startswith(S3):
        rule, remedy = "must be a folder, or s3://BUCKET", "--artifacts s3://my-study, or a folder that all machines see"
        raise InputError(report("--artifacts", received=shown_url(place), rule=rule, remedy=remedy))
    return place if place.startswith(S3) else str(Path(place).resolve())


def artifact_store(place: str | None, out: Path) -> FileSystemArtifactStore | Boto3ArtifactStore:
    """The store that `place` names: a folder, s3://BUCKET, or None for the folder's own. Raises InputError."""
    from optuna.artifacts import Boto3ArtifactStore, FileSystemArtifactStore

    if place is not None:
        place = whole_place(place)
    if place is None or not place.startswith(S3):
        folder = out / ARTIFACTS if place is None else Path(place)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            rule = f"must be a folder that can be made, or s3://BUCKET ({error.strerror})"
            raise InputError(report("--artifacts", received=str(folder), rule=rule, remedy="name another folder")) from None
        return FileSystemArtifactStore(str(folder))
    bucket = place.removeprefix(S3).rstrip("/")
    if not BUCKET.fullmatch(bucket):
        rule = "must name a bucket alone: 3 to 63 letters a to z, digits, dots and hyphens; keys come from the environment"
        raise InputError(report("--artifacts", received="s3://...", rule=rule, remedy="--artifacts s3://my-study"))
    if importlib.util.find_spec("boto3") is None:
        rule, remedy = "an S3-compatible store needs the package boto3", "pip install 'magmpm[s3]'"
        raise InputError(report("--artifacts", received=place, rule=rule, remedy=remedy))
    return Boto3ArtifactStore(bucket)
