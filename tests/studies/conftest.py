"""Rules for tests of studies: their databases are made quickly, and what many begin with is made once."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from alembic.config import Config
from alembic.script import ScriptDirectory
from rod_solve import solve, write_study

from magmpm.studies.engine.loop import run_study
from magmpm.studies.search.definition import Study, load_study


@pytest.fixture(autouse=True, scope="session")
def _migrations_are_read_once() -> Iterator[None]:
    """Optuna reads all its scripts of migration three times for each database that it makes; no test changes them."""
    read = ScriptDirectory.from_config
    known: dict[str | None, ScriptDirectory] = {}

    def read_once(config: Config) -> ScriptDirectory:
        place = config.get_main_option("script_location")
        if place not in known:
            known[place] = read(config)
        return known[place]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ScriptDirectory, "from_config", read_once)
        yield


@pytest.fixture(scope="session")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path, int], Study]:
    """begun(folder, trials): a study of random designs there, whose folder `out` has the first so many trials."""
    known: dict[int, Path] = {}

    def copied(folder: Path, trials: int) -> Study:
        if trials not in known:
            known[trials] = tmp_path_factory.mktemp("begun")
            study = load_study(write_study(known[trials]))
            run_study(study, solve=solve, out=known[trials] / "out", trials=trials)
        shutil.copytree(known[trials], folder, dirs_exist_ok=True)
        return load_study(folder / "probe.yaml")

    return copied
