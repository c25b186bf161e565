"""The pages of `magmpm view`: of a scene at rest, with what the page requests of it, and of a motion, as it is saved or runs."""

import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.cli.page_server import Routes
from magmpm.compiled.arrays import Named, NamedNumbers, Plain
from magmpm.errors import InputError, MagmpmError, lengths
from magmpm.results.file_names import MOTION
from magmpm.results.result import Result
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.studies.explore.live import (
    DeformedShape,
    Overtaken,
    Preview,
    SolverProcess,
    changed,
    checked,
    controls,
    saved,
)
from magmpm.studies.problem.variables import VaryNumber
from magmpm.viz.page import MotionStage, Stage, about_scene, packed


class ShapeView:
    """The page of a scene at rest: previews, shapes and saved scenes by the values of its sliders."""

    def __init__(
        self,
        scene: Scene,
        path: Path,
        folder: Path,
        target: Any,
        target_name: str,
        more: Sequence[VaryNumber] = (),
    ) -> None:
        """scene: ready to be solved; path: its file; folder: where scenes are saved; target (m, 4) m or None; more: more sliders."""
        self.scene = scene
        self.path = path
        self.folder = folder
        self.target = target
        self.target_name = target_name
        self.controls = {control.id: control for control in controls(scene, more)}
        self._previewing = threading.Lock()
        self._drawing = threading.Lock()
        self._saving = threading.Lock()
        self._preview = Preview()
        self._stage = Stage()
        self._solver = SolverProcess(target)

    def routes(self) -> Routes:
        """Requests that the page may send, and the functions that answer them."""
        return {
            "about": self.about,
            "preview": self.preview,
            "solve": self.solve,
            "save": self.save,
        }

    def about(self, _: Any) -> Named:
        """The scene and its sliders."""
        return {
            "kind": "shape",
            "controls": [control.plain() for control in self.controls.values()],
            "cells": self.scene.resolution.cells_across,
            "effects": list(self.scene.effects.named()),
            **about_scene(self.scene, self.target, self.target_name),
        }

    def preview(self, request: Any) -> bytes:
        """The rod's shape, dressed by the last solve; without one, words that say so."""
        scene = self._scene(request)
        try:
            with self._previewing:
                shape = self._preview.shape(scene)
        except MagmpmError as error:
            return self._words("none", str(error))
        if shape is None or not np.isfinite(shape.position).all():
            return self._words("none", "")
        return self._drawn(scene, shape, request, {"state": "preview"})

    def solve(self, request: Any) -> bytes:
        """The shape that `magmpm run` finds, and its numbers; or why there is none."""
        scene = self._scene(request)
        try:
            solved = self._solver.solved(scene)
        except Overtaken:
            return self._words("overtaken", "")
        if solved.result is None:
            return self._words("failed", solved.failure)
        with self._previewing:
            self._preview.learn(solved.result)
        about = {
            "state": "solved",
            "seconds": solved.seconds,
            "numbers": _numbers(solved.result, solved.rms),
        }
        return self._drawn(
            scene,
            DeformedShape.of(solved.result),
            request,
            {**about, "warnings": solved.result.warnings},
        )

    def save(self, request: Any) -> Named:
        """Write the scene as it is shown. Raises InputError."""
        values = self._values(request)
        shown = changed(self.scene, self.controls, values)
        with self._saving:
            taken = {path.name for path in self.folder.glob("view-*.yaml")}
            name = next(name for k in range(1, 100_000) if (name := f"view-{k}.yaml") not in taken)
            read_back = saved(
                self.scene, self.path, shown, self.controls, values, self.folder / name
            )
        if read_back.hash() != shown.hash():
            raise InputError(
                f"{self.folder / name}: the saved file differs from the scene shown; please "
                "report this"
            )
        return {
            "path": str(self.folder / name),
            "command": f"magmpm run {self.folder / name} --render",
        }

    def close(self) -> None:
        """End the solver."""
        self._solver.close()

    def _values(self, request: Any) -> NamedNumbers:
        return checked(
            self.controls, request.get("values", {}) if isinstance(request, Mapping) else None
        )

    def _scene(self, request: Any) -> Scene:
        return changed(self.scene, self.controls, self._values(request))

    def _words(self, state: str, words: str) -> bytes:
        return packed({"state": state, "words": words}, {})

    def _drawn(self, scene: Scene, shape: DeformedShape, request: Any, about: Plain) -> bytes:
        with self._drawing:
            return self._stage.message(scene, shape, str(request.get("surface", "")), about)


def _numbers(result: Result, rms: float | None) -> list[Plain]:
    """Numbers shown next to the shape: label, text, and whether it is cause for alarm."""
    rows: list[tuple[str, str, bool]] = (
        [] if result.tip is None else [("tip", lengths(result.tip), False)]
    )
    if rms is not None:
        rows.append(("rms to target", f"{1e3 * rms:.3g} mm", False))
    if result.stability is not None:
        soft = any(w.startswith("stability: ") for w in result.warnings)
        rows.append(
            (
                "stability",
                f"{result.stability:.3g}" + (" (close to losing stability)" if soft else ""),
                soft,
            )
        )
    rows.append(
        (
            "largest stretch",
            f"{result.largest_stretch:.3g}",
            any(w.startswith("strain: ") for w in result.warnings),
        )
    )
    rows.append(("Newton steps", str(result.iterations), False))
    return [{"label": label, "text": text, "alarm": alarm} for label, text, alarm in rows]


class MotionView:
    """The page of a motion: its frames, and how far its run is. One that was not run yet is run first, and shown as it grows."""

    def __init__(self, scene: Scene, path: Path, folder: Path) -> None:
        """Show the results that a folder holds of this scene; where it holds none, run the scene into it."""
        self.scene = scene
        self.path = path
        self.folder = folder
        self._reading = threading.Lock()
        self._stage: MotionStage | None = None
        self._run: subprocess.Popen[bytes] | None = None
        self._said = tempfile.TemporaryFile()  # noqa: SIM115
        if not self._saved():
            command = [
                sys.executable,
                "-m",
                "magmpm.cli",
                "run",
                str(path),
                "--out",
                str(folder),
                "--resume",
            ]
            self._run = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._said
            )

    def routes(self) -> Routes:
        """Requests that the page may send, and the functions that answer them."""
        return {"about": self.about, "progress": self.progress, "frame": self.frame}

    def about(self, _: Any) -> Named:
        """The scene, and how it is solved."""
        kind = "equilibria along time" if self.scene.static else "motion"
        effects = list(self.scene.effects.named())
        return {
            "kind": "motion",
            "solved": kind,
            "effects": effects,
            "duration": self.scene.duration,
            **about_scene(self.scene, None, ""),
        }

    def progress(self, _: Any) -> Named:
        """The frames there are: times (s), energies (J), the tip's path (m), and their box; whether the run goes on, or why it failed."""
        running, failure = self._state()
        with self._reading:
            motion = self._loaded()
            if motion is None or len(motion) == 0:
                return {"times": [], "running": running, "failure": failure}
            stage = self._staged(motion)
            state = stage.state()
        return {**state, "running": running, "failure": failure}

    def frame(self, request: Any) -> bytes:
        """A frame by its number. Raises InputError."""
        number = request.get("number") if isinstance(request, Mapping) else None
        with self._reading:
            motion = self._loaded() if self._stage is None else self._stage.motion
            if (
                motion is None
                or isinstance(number, bool)
                or not isinstance(number, int)
                or not 0 <= number < len(motion)
            ):
                raise InputError(
                    f"frame: received {number!r:.40}; the motion has frames 0 to"
                    f" {0 if motion is None else len(motion) - 1}"
                )
            stage = self._staged(motion)
            header, arrays = stage.frame(number, str(request.get("surface", "")))
        return packed(header, arrays)

    def close(self) -> None:
        """Let the run stop as Ctrl-C would: what was finished is kept."""
        if self._run is not None and self._run.poll() is None:
            self._run.terminate()
            self._run.wait()
        self._said.close()

    def _saved(self) -> bool:
        """True if the folder holds this scene's motion, complete."""
        if not (self.folder / MOTION).exists():
            return False
        motion = Motion.load(self.folder)
        if (
            motion.scene is None
            or Scene.from_si(motion.scene).hash() != self.scene.hash()
            or len(motion) == 0
        ):
            return False
        return bool(np.isclose(motion.times[-1], self.scene.duration, rtol=1e-6))

    def _state(self) -> tuple[bool, str]:
        """Return whether the run goes on, and why it failed."""
        if self._run is None or self._run.poll() is None:
            return self._run is not None, ""
        if self._run.returncode == 0:
            return False, ""
        self._said.seek(0)
        return False, self._said.read().decode(errors="replace").rsplit("\r", 1)[-1].strip()

    def _loaded(self) -> Motion | None:
        """The motion as it is on the disk now."""
        try:
            return Motion.load(self.folder)
        except MagmpmError:  # not begun, or between two writes
            return None if self._stage is None else self._stage.motion

    def _staged(self, motion: Motion) -> MotionStage:
        if self._stage is None:
            self._stage = MotionStage(self.scene, motion)
        self._stage.motion = motion
        return self._stage
