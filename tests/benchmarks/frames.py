"""The cost of frames: whole runs with frames against the steps alone, and writing a frame to disk."""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np

from magmpm.dynamics.time_loop import CHUNK, begin
from magmpm.effects.acting import collect
from magmpm.model import build
from magmpm.results.trajectory import MotionWriter
from magmpm.scene import Scene, load_scene
from magmpm.simulate import run

SCENE = Path(__file__).resolve().parents[2] / "data/scenes/five_segments.yaml"


def scene(duration: float, every: float) -> Scene:
    """The five-segment catheter, released and damped so that it comes to rest; times in s."""
    data = load_scene(SCENE).to_si()
    data["effects"]["damping"] = {"rate": 20.0}
    data["solver"] = {"dynamic": {"duration": duration, "output_every": every}}
    return Scene.from_si(data)


def run_over_steps() -> float:
    """0.3 s with 60 frames: time of the whole run, from the scene to the last frame, over the time of the same number of steps alone."""
    moving = scene(0.3, 5e-3)
    with tempfile.TemporaryDirectory() as folder:
        run(scene(1e-3, 1e-4), folder=folder)
        begun = time.perf_counter()
        result = run(moving, folder=folder)
        whole = time.perf_counter() - begun
    model = build(moving)
    motion = begin(model).motion
    named = collect(moving, times=np.zeros(1))
    for _ in range(10):  # the number of threads is chosen in the first calls
        motion.advance(CHUNK, result.time_step, named)
    begun = time.perf_counter()
    for _ in range(result.iterations // CHUNK):
        motion.advance(CHUNK, result.time_step, named)
    steps = (time.perf_counter() - begun) * result.iterations / (result.iterations // CHUNK * CHUNK)
    return whole / steps


def short_run() -> float:
    """1 ms with 100 frames, from the scene to the last frame: median of five."""
    moving = scene(1e-3, 1e-5)
    times = []
    for _ in range(6):
        with tempfile.TemporaryDirectory() as folder:
            begun = time.perf_counter()
            run(moving, folder=folder)
            times.append(time.perf_counter() - begun)
    return statistics.median(times[1:])


def frame_ms() -> float:
    """Writing one frame of the same body (5 120 particles): median of 200."""
    model = build(scene(1e-3, 1e-5))
    x = model.particles.position
    F = np.tile(np.eye(3), (len(x), 1, 1))
    times = []
    with tempfile.TemporaryDirectory() as folder:
        writer = MotionWriter(folder, model)
        for k in range(201):
            begun = time.perf_counter()
            writer.frame(1e-3 * k, x, x, F, F, {"kinetic": 1.0, "elastic": 1.0})
            times.append(time.perf_counter() - begun)
    return 1e3 * statistics.median(times[1:])
