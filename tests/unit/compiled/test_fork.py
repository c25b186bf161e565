"""The ordinary parallel sweep: one run, then a pool of processes, which are forks on Linux up to Python 3.13."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

# 200 small runs in two forks of a process that has run with two threads; then a motion in a fork that a thread has made.
SWEEP = """
import json, os, threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numba

import magmpm

SILICONE = {"shear_modulus": "120 kPa", "bulk_to_shear": 20, "density": "1882 kg/m^3", "remanence": "138 mT"}
ROD = {"length": "16 mm", "diameter": "4 mm", "material": "silicone", "segments": [{"magnetization": [1, 0, 0]}]}
SCENE = {
    "name": "small", "materials": {"silicone": SILICONE}, "body": {"catheter": ROD}, "field": {"uniform": ["0 mT", "6 mT", "8 mT"]},
    "effects": {"magnetic_torque": {}}, "resolution": {"cells_across": 2},
}
MOTION = {**SCENE, "solver": {"dynamic": {"duration": "1 ms", "output_every": "0.5 ms"}}}

def tip(strength):
    found = magmpm.run(magmpm.load_scene(SCENE).with_field(f"{strength} mT"))
    return found.tip.tobytes().hex(), numba.get_num_threads(), os.getpid()

def moved(_):
    return magmpm.run(magmpm.load_scene(MOTION)).tip.tobytes().hex()

if __name__ == "__main__":
    here, motion = {k: tip(k) for k in range(1, 11)}, moved(0)
    with ProcessPoolExecutor(2, mp_context=get_context("fork")) as pool:
        there = list(pool.map(tip, [1 + k % 10 for k in range(200)]))
    of_a_thread = []
    def fork():
        moved(0)
        with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool:
            of_a_thread.extend(pool.map(moved, range(2)))
    thread = threading.Thread(target=fork)
    thread.start()
    thread.join()
    print(json.dumps({
        "layer": numba.threading_layer(), "threads": sorted({found[1] for found in there}), "here": here[1][1],
        "same": [found[0] == here[1 + k % 10][0] for k, found in enumerate(there)],
        "processes": len({found[2] for found in there} - {os.getpid()}),
        "motion": [found == motion for found in of_a_thread],
    }))
"""


@pytest.mark.skipif(
    not hasattr(os, "fork") or sys.platform == "darwin", reason="processes are not forked here"
)
def test_a_pool_of_forks_after_a_run_gives_the_same_bits(tmp_path: Path) -> None:
    script = tmp_path / "sweep.py"
    script.write_text(SWEEP)
    env = {**os.environ, "NUMBA_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, str(script)],
        env=env,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["here"] == 2
    assert found["processes"] >= 1
    assert found["same"] == [True] * 200
    assert found["motion"] == [True] * 2
    if found["layer"] == "omp":
        assert found["threads"] == [1], "OpenMP has no other threads after a fork"
