"""Notes and pictures that optuna-dashboard shows of a study beside its numbers; and which trial it calls the best."""

from __future__ import annotations

import json
import shlex
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

from optuna.storages import RDBStorage
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from magmpm.compiled.arrays import Plain
from magmpm.studies.engine.report import feasible, refused
from magmpm.studies.problem import REPORT
from magmpm.studies.search.samplers.optuna_ids import storage_of, study_id, trial_id

if TYPE_CHECKING:
    import optuna
    from optuna.artifacts import Boto3ArtifactStore, FileSystemArtifactStore


class FeasibleFirst(RDBStorage):
    """A database whose best trial keeps its constraints, where one does: dashboard 0.21 asks the storage, which knows no constraints."""

    def get_best_trial(self, study_id: int) -> FrozenTrial:
        """Find the best of the feasible trials; where none is feasible, of all."""
        trials = self.get_all_trials(study_id, deepcopy=False, states=(TrialState.COMPLETE,))
        if not trials:
            raise ValueError("no trial of this study is complete")
        kept = [trial for trial in trials if all(one <= 0.0 for one in trial.constraints.values())]
        largest = self.get_study_directions(study_id)[0] == StudyDirection.MAXIMIZE
        best = max if largest else min
        return best(kept or trials, key=lambda trial: trial.values[0])


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

    def _report(self) -> Plain:
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
        definition = self.study.user_attrs.get("definition", {})
        vary = ", ".join(definition.get("vary", {})) or "nothing"
        report = self._report()
        lines = [
            f"{MARK}{plain(self.study.study_name)}",
            (
                f"Searches {plain(vary)} with the sampler"
                f" `{plain(definition.get('sampler', '?'))}`, seed {definition.get('seed', '?')}."
                " A trial that was not solved has the length of the body as its distance from the"
                " target."
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
