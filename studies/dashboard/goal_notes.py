"""Notes of the dashboard on a search for a goal."""

from __future__ import annotations

from collections.abc import Mapping

from optuna.trial import FrozenTrial, TrialState

from magmpm.compiled.arrays import Plain
from magmpm.errors import in_words, unitless
from magmpm.studies.dashboard.view import MARK, Notes, plain
from magmpm.studies.goals.report import PICTURES, REPORT
from magmpm.studies.search.samplers.optuna_ids import study_id


class GoalNotes(Notes):
    """Writes what the dashboard shows next to the numbers of a goal's trials."""

    report_name = REPORT
    pictures = PICTURES

    def _of_study(self, pictures: Mapping[str, str]) -> str:
        report = self._report()
        goals = ", ".join(f"`{plain(unitless(goal))}`" for goal in report.get("goals", ()))
        limits = [_limit(limit) for limit in report.get("limits", ())]
        lines = [
            f"{MARK}{plain(self.study.study_name)}",
            f"Goals: {goals or 'not known yet'}; sampler `{plain(report.get('sampler', '?'))}`.",
            *(["Subject to: " + "; ".join(limits) + "."] if limits else []),
            f"Study file: `{plain(self._file)}`",
            "Goes on, or is done again in another folder, by",
            f"```\n{plain(self._command())}\n```",
            *(
                f"![{name}](/artifacts/{study_id(self.study)}/{pictures[name]})"
                for name in self.pictures
                if name in pictures and name.endswith(".png")
            ),
        ]
        return "\n\n".join(lines)

    def _of_trial(self, trial: FrozenTrial) -> str:
        attributes = trial.user_attrs
        report = self._report()
        lines = [f"{MARK}{plain(self.study.study_name)}, trial {trial.number}"]
        if trial.state == TrialState.FAIL:
            lines.append(plain(f"Failed: {attributes.get('failed', 'its session ended')}."))
        elif trial.state == TrialState.PRUNED:
            beyond = "not run: it breaks a constraint whatever its answer is"
            lines.append(plain(beyond if attributes.get("skipped") else "ended before its time"))
        else:
            lines += [
                plain(f"{name}: {value:.4g}")
                for name, value in zip(self.study.metric_names or (), trial.values, strict=False)
            ]
            for limit in report.get("limits", ()):
                value = attributes.get("measures", {}).get(limit["at"])
                if value is not None:
                    lines.append(plain(f"{_limit(limit)}: {in_words(limit['label'], value)}"))
        return "\n\n".join(lines)


def _limit(limit: Plain) -> str:
    """A constraint in words."""
    return f"{unitless(limit['label'])} {limit['bounds']}"
