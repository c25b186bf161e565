"""`magmpm design`, and `render` of a study: where studies meet the solver and the pictures."""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
from collections.abc import Callable
from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from magmpm.cli.answers import SURFACE, Progress, end_as_by_ctrl_c
from magmpm.errors import InputError, count
from magmpm.results.folder_lock import folder_lock

if TYPE_CHECKING:
    from magmpm.compiled.arrays import Named, Plain
    from magmpm.results.result import Result
    from magmpm.studies.engine.report import StudyReport
    from magmpm.studies.evaluate.trial import Trial
    from magmpm.studies.problem.study import Study
    from magmpm.viz.snapshot import Snapshot
    from magmpm.viz.worker import Renderer


def command(options: argparse.Namespace) -> int:
    """Run or resume a study, with a picture of every trial, then the pictures of the whole."""
    from magmpm.studies.goals.goal_study import has_goal
    from magmpm.studies.search.definition import load_study

    if has_goal(options.study):
        from magmpm.cli.goals import design_for_goal

        return design_for_goal(options)
    study = load_study(options.study)
    smooth = options.style == SURFACE
    from magmpm.simulate import run, sensitivities
    from magmpm.solving.precompile import fill_cache
    from magmpm.studies.engine.loop import check_study, kernel_uses, run_study
    from magmpm.studies.engine.storage import OUTAGE, TIMEOUT, Store
    from magmpm.studies.engine.storage_url import given_url, is_server, storage_url
    from magmpm.viz.worker import Renderer

    if options.trial is not None:
        return _rerun(options, study)
    out = options.out or Path("runs") / study.name
    storage = given_url(options.storage, os.environ)
    if is_server(url := storage_url(out, storage)):
        server = Store(url, TIMEOUT, OUTAGE, print)
        server.open()  # one that can't be used is refused before rods are compiled for the check
        server.forget()
    check_study(
        study.changed(trials=options.trials, sampler=options.sampler),
        options.workers,
        options.time_limit,
    )  # no folder yet
    end_as_by_ctrl_c()
    with (
        folder_lock(out),  # until the pictures of the whole are there
        nullcontext() if options.no_pictures else closing(Renderer()) as renderer,
        Progress(study.name) as progress,
    ):

        def prepare(opened: Study) -> None:
            if renderer is not None:
                renderer.start()  # while kernels are compiled, or the first design is solved
            fill_cache(opened.scene, progress.note, kernel_uses(opened))

        report = run_study(
            study,
            solve=run,
            differentiate=sensitivities,
            out=out,
            on_trial=lambda trial: _tell(trial, progress),
            on_advice=_advise,
            picture=None if renderer is None else TrialPicture(study, smooth, renderer),
            trials=options.trials,
            sampler=options.sampler,
            storage=storage,
            workers=options.workers,
            artifacts=options.artifacts,
            time_limit=options.time_limit,
            on_open=prepare,
            on_note=progress.note,
        )
        done = report.ended != "interrupted"
        files = []
        if renderer is not None and done:
            files = draw_study(
                out, report.summary(), study.target, renderer, smooth=smooth, note=progress.note
            )
    if renderer is not None and renderer.note:
        print(renderer.note, file=sys.stderr)
    summary = {**report.summary(), "files": [str(path) for path in files]}
    print(json.dumps(summary) if options.json else _text(report, files))
    return 1 if report.ended == "interrupted" else 0


def _rerun(options: argparse.Namespace, study: Study) -> int:
    """Solve one trial again, and compare it with what is stored."""
    from magmpm.simulate import run, sensitivities
    from magmpm.studies.engine.storage import OUTAGE, TIMEOUT, Store
    from magmpm.studies.engine.storage_url import given_url, storage_url
    from magmpm.studies.engine.study_session import rerun
    from magmpm.studies.evaluate.evaluator import Evaluator

    out = options.out or Path("runs") / study.name
    store = Store(
        storage_url(out, given_url(options.storage, os.environ)),
        TIMEOUT,
        OUTAGE,
        lambda line: _advise([line]),
    )
    study = study.changed(sampler=options.sampler)
    found = rerun(Evaluator(study, run, sensitivities, None, out), store, options.trial)
    if options.json:
        print(json.dumps(found))
    elif found["reason"] is not None:
        print(f"{study.name}, trial {found['number']}: {found['reason']}")
    else:
        verdict = (
            "the same bits" if found["same"] else f"stored {1e3 * found['stored_rms_m']:.9g} mm"
        )
        print(
            f"{study.name}, trial {found['number']}: rms {1e3 * found['rms_m']:.9g} mm; {verdict}"
        )
    return 0


def _advise(advice: list[str]) -> None:
    for line in advice:
        print(f"magmpm: warning: {line}", file=sys.stderr)


def _tell(trial: Trial, progress: Progress) -> None:
    best = "-" if trial.best_rms_m is None else f"{1e3 * trial.best_rms_m:.2f} mm"
    progress.at(trial.finished, trial.wanted, f"best {best}")


class TrialPicture:
    """Draws a trial; also in a worker process, where it starts a drawing process of its own with the first picture."""

    def __init__(self, study: Study, smooth: bool, renderer: Renderer | None = None) -> None:
        self._study = study
        self._smooth = smooth
        self._renderer = renderer

    def __getstate__(self) -> Plain:
        return {**self.__dict__, "_renderer": None}

    def __call__(self, result: Result, path: Path, trial: Trial) -> list[Path]:
        """The files: picture, deformed surface (STL, mm), centreline (CSV)."""
        from magmpm.inputs.csv_tables import write_centreline
        from magmpm.viz.from_result import write_stl

        table = path.with_suffix(".csv")
        picture = self._drawn(result, path, trial)
        write_centreline(table, result.centreline)
        return [picture, write_stl(result, path.with_suffix(".stl")), table]

    def _drawn(self, result: Result, path: Path, trial: Trial) -> Path:
        if self._renderer is None:
            from magmpm.viz.worker import Renderer

            self._renderer = Renderer()
        if trial.shapes:
            study = self._study
            scene = result.scene if study.keyframes else study.scene.to_si()
            shown = several_snapshot(
                study.name, scene, trial.target, trial.shapes, trial.number, trial.rms_m
            )
            return self._renderer.render(shown, path)
        from magmpm.viz.from_result import trial_snapshot

        kept: Plain = {
            "trial": trial.number,
            "rms": trial.rms_m,
            "title": self._study.name,
        }
        snapshot = trial_snapshot(result, target=trial.target, smooth=self._smooth, **kept)
        return self._renderer.render(snapshot, path)


def _text(report: StudyReport, files: list[Path]) -> str:
    """The report for people."""
    from magmpm.studies.engine.records import BEST
    from magmpm.studies.engine.report import on_the_brink, verified_lines
    from magmpm.studies.search.best_scene import SCENE
    from magmpm.studies.search.search_space import FIELD

    refused = f", {report.refused} refused: less stable than the margin" if report.refused else ""
    lines = [
        f"{report.name}: {count(report.trials, 'trial')} ({report.failed} failed{refused}), sampler"
        f" {report.sampler}, seed {report.seed}"
    ]
    if report.why_sampler is not None:
        lines.append(f"  sampler          {report.sampler}: {report.why_sampler}")
    if report.reasons and report.best is None:
        lines.append(f"  trial {report.failed_trials[-1]:<4}       {report.reasons[-1]}")
    if report.best is not None:
        lines.append(
            f"  best             trial {report.best['number']}, rms"
            f" {1e3 * report.best['rms_m']:.3f} mm"
        )
        if "measure_m" in report.best:
            mean, sigma, scatter = (
                1e3 * report.best[key] for key in ("mean_rms_m", "sigma_rms_m", "scatter_m")
            )
            lines.append(
                f"  made with errors rms {mean:.3f} mm on average, sigma {sigma:.3f} mm; the shape"
                f" scatters by {scatter:.3f} mm"
            )
        for k, direction in enumerate(report.best["magnetization"] or [], 1):
            if not any(direction):  # a plain segment
                continue
            lines.append(f"    segment {k}      [{', '.join(f'{x:+.4f}' for x in direction)}]")
        if FIELD[0] in report.best["params"]:
            field = 1e3 * np.array(report.best["field_T"])
            found = ", ".join(f"{x:+.4f}" for x in field)
            lines.append(
                f"    field          [{found}] mT, magnitude {np.linalg.norm(field):.4g} mT"
            )
    if report.front is not None:
        found = report.front["pareto"]
        lines.append(
            f"  Pareto front     {count(len(found), 'trial')}; best compromise: trial"
            f" {report.front['compromise']}"
        )
    if report.stop_rms_m is not None:
        first = report.first_trial_below_stop
        lines.append(
            f"  rms {1e3 * report.stop_rms_m:g} mm        "
            f" {'not reached' if first is None else f'reached in trial {first}'}"
        )
    lines += [f"  warning          {line}" for line in on_the_brink(report.best)]
    lines += [f"  judged finer     {line}" for line in verified_lines(report.verified)]
    lines += [f"  held back        {one['says']}" for one in report.limits]
    if report.seconds_per_trial is not None:
        lines.append(
            f"  seconds per trial  {report.seconds_per_trial:.2f} (median, from start to end)"
        )
    lines.append(
        f"  trials in        {report.storage}; browse them with: magmpm dashboard"
        f" {shlex.quote(str(report.out))}"
    )
    lines += [f"  saved            {path}" for path in files]
    if (scene := report.out / BEST / SCENE).exists():
        lines.append(f"  best as a scene  magmpm run {shlex.quote(str(scene))} --render")
    lines.append(f"  {report.why}")
    return "\n".join(lines)


def render_study(
    folder: Path, out: Path, *, smooth: bool = False, kind: str = "png"
) -> tuple[list[Path], str]:
    """Pictures of a study's best designs, drawn anew from what is saved; the files, and the renderer's note.

    smooth: bodies are drawn by their surface in place of their particles; kind: of picture files, png, svg or pdf.
    """
    from magmpm.viz.worker import Renderer

    report = saved_report(folder)
    with Renderer() as renderer:
        return (
            draw_study(
                folder, report, saved_target(folder), renderer, out, smooth=smooth, kind=kind
            ),
            renderer.note,
        )


def saved_report(folder: Path) -> Plain:
    """Read the report that a study saved in its folder. Raises InputError."""
    from magmpm.studies.problem import REPORT

    try:
        report: Plain = json.loads((folder / REPORT).read_text(encoding="utf-8"))
        for key, kind in (
            ("rms_m", list),
            ("storage", str),
            ("failed_trials", list),
            ("name", str),
        ):
            if not isinstance(report[key], kind):
                raise ValueError(f"`{key}` is {json.dumps(report[key])[:40]}")
        _ = report["stop_rms_m"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{folder / REPORT}: can't be read as a study's report ({error})",
            rule="must be as `magmpm design` wrote it",
            remedy="run `magmpm design` again: it rewrites the report, and no trial is lost",
        ) from None
    return report


def saved_target(folder: Path) -> np.ndarray | None:
    """The target that a study's folder holds, rows [s, x, y, z], m."""
    from magmpm.inputs.csv_tables import read_centreline
    from magmpm.studies.problem import TARGET

    path = folder / TARGET
    if not path.exists():
        return None

    return np.asarray(read_centreline(path))


def draw_study(
    folder: Path,
    report: Plain,
    target: np.ndarray | None,
    renderer: Renderer,
    out: Path | None = None,
    *,
    smooth: bool = False,
    kind: str = "png",
    note: Callable[[str], object] = lambda text: None,
) -> list[Path]:
    """best.png, convergence.png and best_shapes.mp4 of a study's folder. note: is told what is being drawn."""
    from magmpm.results.result import Result
    from magmpm.studies.engine.records import BEST, DESIGN, IMPROVEMENTS, read_design
    from magmpm.viz import plots
    from magmpm.viz.from_result import trial_snapshot
    from magmpm.viz.movies import best_shapes_movie
    from magmpm.viz.style import FINAL_SIZE

    out = out or folder

    def snapshot(of: Path) -> Snapshot:
        known = read_design(of)
        if "number" not in known or "rms_m" not in known:
            raise InputError(
                f"{of / DESIGN}: can't be read as a design",
                rule="must be as `magmpm design` wrote it",
                remedy="run `magmpm design` again: it solves the design again",
            )
        result = Result.load(of)
        shown = (
            None
            if result.scene is None
            else _design_snapshot(report["name"], result.scene, target, known)
        )
        kept: Plain = {
            "trial": known["number"],
            "rms": known["rms_m"],
            "title": report["name"],
        }
        return shown or trial_snapshot(result, target=target, smooth=smooth, **kept)

    files = []
    if (folder / BEST).exists():
        note(f"drawing best.{kind}")
        best = snapshot(folder / BEST)
        files.append(
            renderer.render(best, out / f"best.{kind}", size=FINAL_SIZE if best.insets else None)
        )
        files += _draw_movie(folder / BEST, out, report["name"], renderer, note)
    if report["rms_m"]:
        shown = (
            report["rms_m"],
            out / f"convergence.{kind}",
            report["stop_rms_m"],
            report["name"],
            report["failed_trials"],
        )
        files.append(renderer.run(plots.convergence, *shown))
    if report.get("pareto"):
        files.append(renderer.run(plots.pareto, report, out / f"pareto.{kind}"))
    shapes = sorted(path.parent for path in (folder / IMPROVEMENTS).glob(f"[0-9]*/{DESIGN}"))
    if shapes:
        note("drawing best_shapes.mp4")
        files.append(
            best_shapes_movie(
                [snapshot(of) for of in shapes[-8:]], out / "best_shapes.mp4", renderer
            ).path
        )
    return [Path(path) for path in files]


def _design_snapshot(
    name: str, scene: Named, path: np.ndarray | None, known: Named
) -> Snapshot | None:
    """The picture of a design's insertion or schedule, from what is stored of it; None where it is one equilibrium.

    path: rows [s, x, y, z], (m, 4) m.
    """
    from magmpm.studies.evaluate.trajectory import shapes_of

    shapes = shapes_of(known)
    if not shapes or path is None:
        return None
    return several_snapshot(name, scene, path, shapes, known["number"], known["rms_m"])


def several_snapshot(
    name: str,
    scene: Named,
    path: np.ndarray,
    shapes: tuple[Named, ...],
    trial: int,
    rms: float,
) -> Snapshot:
    """The picture of a trial that has several equilibria: the depths of an insertion along its path, or the times of a schedule."""
    if "time_s" in shapes[-1]:
        from magmpm.viz.poses import poses_snapshot

        return poses_snapshot(name, scene, shapes, trial=trial, rms=rms)
    from magmpm.viz.insertion import InsertionPictures

    if "catheter" in shapes[-1]:  # a result's scene has what is outside alone
        scene = {**scene, "body": {"catheter": shapes[-1]["catheter"]}}
    return InsertionPictures(name, scene, path).trial(shapes, trial=trial, rms=rms)


def _draw_movie(
    folder: Path, out: Path, name: str, renderer: Renderer, note: Callable[[str], object]
) -> list[Path]:
    """The movie of the best design in `folder`, into `out`; nothing where its frames are not there. note: is told of each frame."""
    from magmpm.studies.evaluate.trajectory import MOVIE
    from magmpm.viz.camera import Framing
    from magmpm.viz.insertion import InsertionPictures
    from magmpm.viz.movies import frames_movie

    if not (folder / MOVIE).exists():
        return []
    content = json.loads((folder / MOVIE).read_text(encoding="utf-8"))
    shown = InsertionPictures(name, content["scene"], np.array(content["path_m"]))
    moments = [shown.moment(frame) for frame in content["frames"]]
    framing = Framing.of(moments)
    numbers = np.arange(len(moments))

    def image(number: int) -> np.ndarray:
        note(f"drawing insertion.mp4, frame {number + 1} of {len(moments)}")
        return renderer.image(moments[number], framing=framing)

    return [Path(frames_movie(out / "insertion.mp4", image, numbers).path)]
