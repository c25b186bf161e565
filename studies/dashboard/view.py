"""A study as optuna-dashboard shows it: distances in mm, designs that failed or were refused as such, notes, and the study's own pictures.

The storage stays in SI and as it is. The dashboard gets a view of it: values in mm and mT; a trial that counts as the penalty, because it
was not solved, as failed; a trial that `stability` refuses as infeasible: dashboard 0.21 reads an attribute that Optuna 5 does not write.
"""

from __future__ import annotations

import copy
import json
import shlex
import threading
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from optuna.storages import BaseStorage
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from magmpm.errors import shown_unit
from magmpm.studies.engine.report import feasible, refused
from magmpm.studies.problem import REPORT
from magmpm.studies.search.objectives import NAMES
from magmpm.studies.search.samplers.optuna_ids import storage_of, study_id, trial_id

if TYPE_CHECKING:
    import optuna
    from optuna.artifacts import Boto3ArtifactStore, FileSystemArtifactStore

# by the name in SI: the name that is shown, and the factor
SHOWN = {
    NAMES["rms"]: ("rms (mm)", 1e3),
    NAMES["largest_field"]: ("largest field (mT)", 1e3),
    NAMES["magnetized_volume"]: ("magnetized volume (mm³)", 1e9),
}
METRICS = "study:metric_names"  # Optuna's attribute
CONSTRAINTS = "constraints"  # the attribute that the dashboard reads


def shown(name: str) -> tuple[str, float]:
    """Find how a value is shown.

    Parameters
    ----------
    name : str
        Of the value, with its SI unit.

    Returns
    -------
    label : str
        What is shown.
    factor : float
        From the SI value.
    """
    return SHOWN[name] if name in SHOWN else shown_unit(name)


def _may_be_best(trial: FrozenTrial) -> bool:
    """True if a shape's trial is feasible, or a goal's trial keeps its constraints."""
    if "feasible" in trial.user_attrs:
        return feasible(trial)
    return all(beyond <= 0.0 for beyond in trial.constraints.values())


def _passed_on(name: str) -> Callable[..., Any]:
    def call(self: Any, *arguments: Any, **options: Any) -> Any:
        return getattr(self.storage, name)(*arguments, **options)

    return call


_Passing: Any = type(
    "_Passing", (BaseStorage,), {name: _passed_on(name) for name in BaseStorage.__abstractmethods__}
)


class DashboardView(_Passing):  # type: ignore[misc]
    """A storage as the dashboard shall see it; what it does not change it passes on.

    Parameters
    ----------
    storage : BaseStorage
        The storage.
    """

    def __init__(self, storage: BaseStorage) -> None:
        self.storage = storage
        self._factors: dict[int, list[float]] = {}
        self._of_trial: dict[int, list[float]] = {}

    def factors(self, study_id: int) -> list[float]:
        """Find the factors by which the values of a study are multiplied.

        Parameters
        ----------
        study_id : int
            Number of the study in the storage.

        Returns
        -------
        list of float
            A factor for each value.
        """
        if study_id not in self._factors:
            names = self.storage.get_study_system_attrs(study_id).get(METRICS) or []
            count = len(self.storage.get_study_directions(study_id))
            self._factors[study_id] = [shown(name)[1] for name in names] or [1.0] * count
        return self._factors[study_id]

    def get_all_trials(
        self, study_id: int, deepcopy: bool = True, states: Container[TrialState] | None = None
    ) -> list[FrozenTrial]:
        """Trials of a study, as they are shown."""
        shown = [
            self._shown(trial, study_id)
            for trial in self.storage.get_all_trials(study_id, deepcopy=False)
        ]
        return [trial for trial in shown if states is None or trial.state in states]

    def get_best_trial(self, study_id: int) -> FrozenTrial:
        """The best of the feasible trials; where none is feasible, of all: the dashboard requests one."""
        done = self.get_all_trials(study_id, states=(TrialState.COMPLETE,))
        if not done:
            raise ValueError("no trial of this study was solved")
        largest = self.storage.get_study_directions(study_id)[0] == StudyDirection.MAXIMIZE
        best = max if largest else min
        return best([t for t in done if _may_be_best(t)] or done, key=lambda t: t.values[0])

    def set_trial_state_values(
        self, trial_id: int, state: TrialState, values: Sequence[float] | None = None
    ) -> bool:
        """Store the state and values that the dashboard sends, back in SI."""
        factors = self._of_trial.get(trial_id)
        in_si = (
            None
            if values is None
            else [
                value / factor
                for value, factor in zip(values, factors or [1.0] * len(values), strict=True)
            ]
        )
        return bool(self.storage.set_trial_state_values(trial_id, state, in_si))

    def get_study_system_attrs(self, study_id: int) -> dict[str, Any]:
        """Attributes of a study, with the names of its values as they are shown."""
        return _renamed(self.storage.get_study_system_attrs(study_id))

    def get_all_studies(self) -> list[Any]:
        """All studies."""
        found = []
        for study in self.storage.get_all_studies():
            one = copy.copy(study)
            one.system_attrs = _renamed(study.system_attrs)
            found.append(one)
        return found

    def _shown(self, trial: FrozenTrial, study_id: int) -> FrozenTrial:
        self._of_trial[trial_id(trial)] = factors = self.factors(study_id)
        found = copy.copy(trial)
        found.user_attrs = dict(trial.user_attrs)
        found.system_attrs = dict(trial.system_attrs)
        if trial.state != TrialState.COMPLETE:
            return found
        found.values = [value * factor for value, factor in zip(trial.values, factors, strict=True)]
        if not feasible(trial) and "feasible" in trial.user_attrs:
            if refused(trial):
                beyond = max([0.0, *trial.constraints.values()])
                found.system_attrs[CONSTRAINTS] = [beyond or 1.0]
            else:
                found.state = TrialState.FAIL
                found.values = None
        elif trial.constraints:
            found.system_attrs[CONSTRAINTS] = list(trial.constraints.values())
        return found


def _renamed(attributes: Mapping[str, Any]) -> dict[str, Any]:
    names = attributes.get(METRICS)
    return {
        **attributes,
        **({METRICS: [shown(name)[0] for name in names]} if names else {}),
    }


class Notes:
    """Writes what the dashboard shows next to the numbers: notes on the study and its trials, and the study's pictures.

    Notes that somebody wrote are left alone.

    Parameters
    ----------
    study : optuna.Study
        The study in its storage.
    folder : Path
        The study's folder.
    store : FileSystemArtifactStore or Boto3ArtifactStore
        Where its pictures are.
    """

    report_name = REPORT
    pictures = ("best.png", "convergence.png", "pareto.png", "best_shapes.mp4", "insertion.mp4")

    def __init__(
        self, study: optuna.Study, folder: Path, store: FileSystemArtifactStore | Boto3ArtifactStore
    ) -> None:
        self.study = study
        self.folder = folder
        self.store = store
        self._done: set[int] = set()
        self._file = _from_here(
            Path(self._report().get("study_file") or f"{study.study_name}.yaml")
        )

    def keep_up(self) -> threading.Thread:
        """Begin a thread that writes while the study runs.

        Returns
        -------
        threading.Thread
            The thread.
        """
        thread = threading.Thread(target=self._go_on, daemon=True)
        thread.start()
        return thread

    def write(self) -> None:
        """Notes for all that is finished and has none."""
        from optuna_dashboard import get_note, save_note

        attached = self._pictures()
        known = get_note(self.study)
        about = self._of_study(attached)
        if known != about and (not known or known.startswith(MARK)):
            save_note(self.study, about)
        for trial in self.study.get_trials(deepcopy=False):
            if trial.state.is_finished() and trial.number not in self._done:
                there = SimpleNamespace(
                    storage=storage_of(self.study), study=self.study, _trial_id=trial_id(trial)
                )
                if not get_note(there):  # type: ignore[arg-type]
                    save_note(there, self._of_trial(trial))  # type: ignore[arg-type]
                self._done.add(trial.number)

    def _go_on(self) -> None:
        period = 3.0  # s between two looks for trials without a note
        pause = threading.Event()
        while True:
            try:
                self.write()
            except Exception:  # a database that is locked or away: notes can wait
                pause.wait(period)
            pause.wait(period)

    def _report(self) -> dict[str, Any]:
        try:
            found = json.loads((self.folder / self.report_name).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    def _pictures(self) -> dict[str, str]:
        """The study's own pictures as artifacts of the study: their ids by their names."""
        from optuna.artifacts import get_all_artifact_meta, upload_artifact

        known = {meta.filename: meta.artifact_id for meta in get_all_artifact_meta(self.study)}
        for name in self.pictures:
            path = self.folder / name
            if not path.exists():
                continue
            if name not in known:
                known[name] = upload_artifact(
                    artifact_store=self.store, file_path=str(path), study_or_trial=self.study
                )
            else:
                with path.open("rb") as stream:
                    self.store.write(known[name], stream)
        return known

    def _of_study(self, pictures: Mapping[str, str]) -> str:
        attributes = self.study.user_attrs
        definition = attributes.get("definition", {})
        vary = ", ".join(definition.get("vary", {})) or "nothing"
        report = self._report()
        lines = [
            f"{MARK}{plain(self.study.study_name)}",
            (
                f"Searches {plain(vary)} with the sampler"
                f" `{plain(definition.get('sampler', '?'))}`, seed {definition.get('seed', '?')}."
                " The value of a trial is its rms distance from the target, in mm here and in m in"
                " the database."
            ),
            f"Study file: `{plain(self._file)}`",
            *([f"{plain(report['why'])}."] if "why" in report else []),
            f"Reproduce:\n\n```\n{plain(self._command())}\n```",
            *(
                f"![{name}](/artifacts/{study_id(self.study)}/{pictures[name]})"
                for name in self.pictures[:3]
                if name in pictures
            ),
        ]
        return "\n\n".join(lines)

    def _of_trial(self, trial: FrozenTrial) -> str:
        attributes = trial.user_attrs
        if trial.state == TrialState.FAIL:
            what = (
                "Not solved:"
                f" {attributes.get('reason', 'its session ended; its design is another trial')}."
            )
        elif not feasible(trial):
            what = (
                f"{'Refused' if refused(trial) else 'Not solved'}: "
                f"{attributes.get('reason', 'for an unknown reason')}."
            )
        else:
            rms, tip = (attributes.get(key) for key in ("rms_m", "tip_error_m"))
            measures = [
                f"{name} {1e3 * value:.3f} mm"
                for name, value in (("rms", rms), ("tip error", tip))
                if value is not None
            ]
            what = f"Solved: {', '.join(measures)}."
        scene = str(attributes.get("scene_hash", "?"))[:12]
        lines = [
            f"{MARK}{plain(self.study.study_name)}, trial {trial.number}",
            plain(what),
            (
                f"Scene: of the study `{plain(self._file)}`, with this trial's parameters (hash"
                f" `{scene}`)."
            ),
            f"Reproduce:\n\n```\n{plain(self._command())} --trial {trial.number}\n```",
        ]
        return "\n\n".join(lines)

    def _command(self) -> str:
        return (
            f"magmpm design {shlex.quote(self._file)} --out {shlex.quote(_from_here(self.folder))}"
        )


MARK = "### "  # how every note of ours begins


def _from_here(path: Path) -> str:
    """A path as one would type it where the dashboard was begun."""
    with suppress(ValueError):
        return str(path.resolve().relative_to(Path.cwd()))
    return str(path.resolve())


def plain(text: str) -> str:
    """Write a text so that Markdown shows it as it is: names come from files.

    Parameters
    ----------
    text : str
        The text.

    Returns
    -------
    str
        On one line.
    """
    return "".join(f"&#{ord(c)};" if c in "<>&`|[]\\" else c for c in str(text)).replace("\n", " ")
