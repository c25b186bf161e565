"""A motion in view: its frames as they are saved; one that was not run yet is run first, and shown as it grows."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from magmpm.cli.page_server import Routes
from magmpm.errors import InputError, MagmpmError
from magmpm.results.file_names import MOTION
from magmpm.results.trajectory import Motion
from magmpm.scene import Scene
from magmpm.viz.page import MotionStage, about_scene, packed


class MotionView:
    """The page of a motion: its frames, and how far its run is."""

    def __init__(self, scene: Scene, path: Path, folder: Path) -> None:
        """folder: of the results: saved ones of this scene are shown, otherwise it is run into it."""
        self.scene, self.path, self.folder = scene, path, folder
        self._reading = threading.Lock()
        self._stage: MotionStage | None = None
        self._run: subprocess.Popen[bytes] | None = None
        self._said = tempfile.TemporaryFile()  # noqa: SIM115
        if not self._saved():
            command = [sys.executable, "-m", "magmpm.cli", "run", str(path), "--out", str(folder), "--resume"]
            self._run = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._said)

    def routes(self) -> Routes:
        """Requests that the page may send, and the functions that answer them."""
        return {"about": self.about, "progress": self.progress, "frame": self.frame}

    def about(self, _: Any) -> Mapping[str, Any]:
        """The scene, and how it is solved."""
        kind = "equilibria along time" if self.scene.static else "motion"
        effects = list(self.scene.effects.named())
        return {"kind": "motion", "solved": kind, "effects": effects, "duration": self.scene.duration, **about_scene(self.scene, None, "")}

    def progress(self, _: Any) -> Mapping[str, Any]:
        """The frames there are: times (s), energies (J), the tip's path (m), and their box; whether the run goes on, or why it failed."""
        running, failure = self._state()
        with self._reading:
            motion = self._loaded()
            if motion is None or len(motion) == 0:
                return {"times": [], "running": running, "failure": failure}
            stage = self._staged(motion)
            told = stage.told()
        return {**told, "running": running, "failure": failure}

    def frame(self, asked: Any) -> bytes:
        """A frame by its number. Raises InputError."""
        number = asked.get("number") if isinstance(asked, Mapping) else None
        with self._reading:
            motion = self._loaded() if self._stage is None else self._stage.motion
            if motion is None or isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(motion):
                raise InputError(f"frame: received {number!r:.40}; the motion has frames 0 to {0 if motion is None else len(motion) - 1}")
            stage = self._staged(motion)
            header, arrays = stage.frame(number, str(asked.get("surface", "")))
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
        if motion.scene is None or Scene.from_si(motion.scene).hash() != self.scene.hash() or len(motion) == 0:
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
