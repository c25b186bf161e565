"""Trials a second with one and with two workers: `make bench-workers`.

Each number of workers runs data/studies/s_shape.yaml past its `stop`, without and with pictures, on a warm cache; the time counts from the
end of trial WARM to the last, so that starts of processes do not, and over TRIALS of them, so that the end, where one worker waits for the
other, weighs little. One worker is the default: this process solves, with all threads. The row
"one thread" is that process with one thread for kernels and BLAS: two workers over it is what a second process gives, two workers over
one is what a user gains.
"""

import os
import subprocess
import sys
import tempfile

import machine
import optuna

from magmpm.cli.design import TrialPicture
from magmpm.simulate import run, sensitivities
from magmpm.solving.precompile import fill_cache
from magmpm.studies.engine.loop import kernel_uses, run_study
from magmpm.studies.search.definition import load_study
from magmpm.viz.worker import Renderer

# make hands on what it is given
TRIALS = int(os.environ.get("TRIALS", "200"))
WARM = 10


def rate(workers: int | None, pictures: bool) -> float:
    """Trials a second."""
    study = load_study(machine.ROOT / "data/studies/s_shape.yaml").changed(sampler="tpe")
    fill_cache(study.scene, uses=kernel_uses(study))
    with tempfile.TemporaryDirectory() as folder, Renderer() as renderer:
        picture = TrialPicture(study, False, renderer) if pictures else None
        run_study(
            study,
            solve=run,
            differentiate=sensitivities,
            picture=picture,
            out=folder,
            trials=TRIALS,
            workers=workers,
        )
        kept = optuna.load_study(study_name=study.name, storage=f"sqlite:///{folder}/study.db")
        ends = sorted(
            trial.datetime_complete for trial in kept.trials if trial.datetime_complete is not None
        )
        return (len(ends) - WARM) / (ends[-1] - ends[WARM - 1]).total_seconds()


def on_one_thread(pictures: bool) -> float:
    """Trials a second of one process that solves with one thread. Threads are counted once, when a process loads them: it is a new one."""
    env = {
        **os.environ,
        "NUMBA_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [sys.executable, __file__, "--pictures" if pictures else "--alone"]
    return float(
        subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout.split()[
            -1
        ]
    )


def main() -> int:
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    if len(sys.argv) > 1:
        print(rate(None, sys.argv[1] == "--pictures"))
        return 0
    found = {}
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before")
    for pictures in (False, True):
        one = rate(None, pictures)
        two = rate(2, pictures)
        single = on_one_thread(pictures)
        what = "with pictures" if pictures else "without pictures"
        found[what] = {
            "one": one,
            "two": two,
            "ratio": two / one,
            "one_thread": single,
            "ratio_to_one_thread": two / single,
        }
        print(
            f"{what}: one {one:.2f}, two {two:.2f} trials a second; {two / one:.2f} times",
            flush=True,
        )
        print(f"    one on one thread {single:.2f}; two {two / single:.2f} times that", flush=True)
    machine.save("workers", found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
