"""Kernels count as ready only if Numba will actually load them; the scene that compiles them is coarse and faint."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from reference.scenes import rod_scene

from magmpm.compiled.cache import _SealedFiles
from magmpm.compiled.parallel import compile_task
from magmpm.scene import Scene, load_scene, time_limit
from magmpm.scene.coarsest import FAINT, coarsest, coarsest_cells
from magmpm.simulate import run
from magmpm.solving import precompile as warmup
from magmpm.statics.layout import static_model


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """An empty cache, and in place of the processes that fill it: what they are asked for, and `work`, what they answer."""
    found = SimpleNamespace(asked=[], lines=[], work=lambda: True)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(
        warmup,
        "_compiled_elsewhere",
        lambda small, jobs, tell: found.asked.append(list(jobs)) or found.work(),
    )
    return found


def test_a_fed_body_is_compiled_for_as_if_it_were_clamped() -> None:
    """Nothing but its guide holds it, which alone is refused at rest: so its runs ended before they began, once for each set of kernels."""
    scene = load_scene(Path(__file__).parents[3] / "data/scenes/fed_into_vessel.yaml")
    assert scene.effects.feed is not None
    assert static_model(warmup._built(coarsest(scene))).clamped_face


def test_only_what_is_used_is_compiled_and_once(compiler: SimpleNamespace) -> None:
    """A plain run asks for no kernels of derivatives; who asks for them later waits for these alone, and is told."""
    scene = rod_scene(field=(0.0, 0.0, 5e-3), gravity=(0.0, 0.0, -9.81))
    for uses in (
        [warmup.SOLVE],
        [warmup.SOLVE, warmup.DERIVATIVES],
        [warmup.SOLVE, warmup.DERIVATIVES, warmup.RODS],
    ):
        assert warmup.fill_cache(scene, compiler.lines.append, uses)
        assert not warmup.fill_cache(scene, compiler.lines.append, uses), (
            "a second time there is nothing to do"
        )
    uses = [[job for job in jobs if isinstance(job, str)] for jobs in compiler.asked]
    assert uses == [["solve"], ["sensitivities"], ["rods"]]
    functions = [[(job.pattern, job.module) for job in jobs[1:]] for jobs in compiler.asked]
    both = ["magmpm.effects.magnetic_torque", "magmpm.effects.gravity"]
    assert functions == [
        [(pattern, module) for module in both for pattern in ("energy", "load")],
        [("load_change", module) for module in both],
        [],
    ]
    assert "statics with magnetic_torque + gravity; once on this machine" in compiler.lines[0]
    assert "compiling kernels for sensitivities; once on this machine" in compiler.lines[2]
    assert len(compiler.lines) == 6
    assert not warmup.fill_cache(rod_scene(gravity=(0.0, 0.0, -9.81)), print, [warmup.RODS]), (
        "the same rods for any effects"
    )


def test_a_further_effect_compiles_its_functions_alone(compiler: SimpleNamespace) -> None:
    """Kernels are the same whatever acts; and an effect that another scene has had is ready."""
    torque = rod_scene(field=(0.0, 0.0, 5e-3))
    both = rod_scene(field=(0.0, 0.0, 5e-3), gravity=(0.0, 0.0, -9.81))
    assert warmup.fill_cache(torque, compiler.lines.append)
    assert warmup.fill_cache(both, compiler.lines.append)
    assert {job.module for job in compiler.asked[1]} == {"magmpm.effects.gravity"}
    assert not warmup.fill_cache(rod_scene(gravity=(0.0, 0.0, -9.81)), compiler.lines.append)


def test_one_process_compiles_and_others_wait_for_it(compiler: SimpleNamespace) -> None:
    """Two processes need the same kernels: one compiles them, the other finds them ready."""
    begun = threading.Event()
    go_on = threading.Event()
    compiler.work = lambda: begun.set() or go_on.wait(60)
    scene = rod_scene(field=(0.0, 0.0, 5e-3))
    found = list[bool]()
    one = threading.Thread(target=lambda: found.append(warmup.fill_cache(scene, lambda _: None)))
    one.start()
    assert begun.wait(60)
    other = threading.Thread(
        target=lambda: found.append(warmup.fill_cache(scene, compiler.lines.append))
    )
    other.start()
    while not compiler.lines and other.is_alive():
        time.sleep(0.01)
    go_on.set()
    one.join()
    other.join()
    assert compiler.lines == [
        f"waiting for process {os.getpid()}, which compiles the same kernels (30 s more at most)"
    ]
    assert sorted(found) == [False, True]


def test_who_needs_other_kernels_waits_for_nobody_and_who_needs_the_same_not_for_ever(
    compiler: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A static scene once waited eight minutes for the kernels of another one's motion. Here families of rods are the others."""
    monkeypatch.setattr(warmup, "SECONDS_TO_WAIT", 0.3)
    begun = threading.Event()
    go_on = threading.Event()
    compiler.work = lambda: begun.set() or go_on.wait(60)
    slow = rod_scene(field=(0.0, 0.0, 5e-3))
    one = threading.Thread(target=lambda: warmup.fill_cache(slow, lambda _: None))
    one.start()
    assert begun.wait(60)
    compiler.work = lambda: True
    assert warmup.fill_cache(slow, compiler.lines.append, [warmup.RODS])
    assert not [line for line in compiler.lines if "process" in line], "another set of kernels"
    compiler.lines.clear()
    assert warmup.fill_cache(slow, compiler.lines.append)
    go_on.set()
    one.join()
    waits, leaves, *compiles = compiler.lines
    assert f"waiting for process {os.getpid()}" in waits
    assert (
        f"process {os.getpid()} is still compiling the same kernels; this one compiles its own"
        in leaves
    )
    assert "compiling kernels for statics with magnetic_torque" in compiles[0]
    assert [jobs[0] for jobs in compiler.asked] == ["solve", "rods", "solve"]


def test_a_solve_that_only_compiles_ends_after_a_few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a coarse scene has no equilibrium all the time once went there; what comes after one is called all the same."""
    steps = []
    judged = []

    def endless(*_: object, **__: object) -> None:
        for step in range(1000):
            time_limit.check()
            steps.append(step)
        raise AssertionError("the solve that only compiles has no end")

    monkeypatch.setattr(warmup, "solve_static", endless)
    monkeypatch.setattr(warmup, "_stability", judged.append)
    small = coarsest(rod_scene())
    warmup.solve_small(small)
    assert 0 < len(steps) <= warmup.STEPS_OF_SMALL_SOLVE
    assert judged == [small]
    warmup.differentiate_small(small)
    assert len(steps) <= 2 * warmup.STEPS_OF_SMALL_SOLVE


def test_a_kernel_that_is_saved_stays_as_it_is(tmp_path: Path) -> None:
    """Two processes may compile the same one for different sets, and its bits may differ: a study and its resumed half need the same."""
    files = _SealedFiles(str(tmp_path), "kernel", "stamp")
    files.save("signature", b"the first")
    files.save("signature", b"the second")
    assert files.load("signature") == b"the first"
    files._path("signature").write_bytes(b"damaged")
    files.save("signature", b"the third")
    assert files.load("signature") == b"the third"


def test_nothing_is_compiled_where_a_compiling_process_fails(compiler: SimpleNamespace) -> None:
    """A cache that could not be filled is not marked as filled."""
    compiler.work = lambda: False
    assert warmup.fill_cache(rod_scene(), lambda _: None)
    assert warmup.fill_cache(rod_scene(), lambda _: None), "it is tried again"


def test_edited_sources_are_not_ready(
    compiler: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Kernels of one version of the sources are not those of another."""
    for version in ("one", "two"):
        monkeypatch.setattr(warmup, "source_hash", lambda named=version: named)
        assert warmup.fill_cache(rod_scene(), print)
        assert not warmup.fill_cache(rod_scene(), print)
    assert len(compiler.asked) == 2


def test_without_room_on_the_disk_nothing_is_compiled_ahead(
    compiler: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernels could not be stored: each run compiles its own, once instead of twice."""
    monkeypatch.setattr(warmup, "ROOM", 1e30)
    assert warmup.fill_cache(rod_scene(), compiler.lines.append)
    (line,) = compiler.lines
    assert "no room" in line
    assert compiler.asked == []


RUN = """
import gc, sys
from numba.core.dispatcher import Dispatcher
from magmpm.scene import load_scene
from magmpm.simulate import run, sensitivities
scene = load_scene(sys.argv[1])
if sys.argv[3:]:
    derivatives = sensitivities(scene)
    derivatives.adjoint(derivatives.centreline[:, :, 0])
else:
    run(scene, folder=sys.argv[2])
found = [d for d in gc.get_objects() if issubclass(type(d), Dispatcher) and str(d.py_func.__module__).startswith("magmpm")]
assert any(d.stats.cache_hits for d in found), "kernels were loaded"
print(*sorted({d.py_func.__qualname__ for d in found if d.stats.cache_misses}))
"""


DERIVED = pytest.param("static: {}", ["derivatives"], marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("solver", "more"), [("static: {}", []), DERIVED, ("dynamic: {duration: 0.1 ms}", [])]
)
def test_a_run_compiles_nothing_itself(solver: str, more: list[str], tmp_path: Path) -> None:
    """Every kernel of a run or of sensitivities, also those for frames, is compiled before the clock starts, and then loaded."""
    scene = tmp_path / "scene.yaml"
    text = (Path(__file__).parents[3] / "data/scenes/five_segments.yaml").read_text(
        encoding="utf-8"
    )
    scene.write_text(
        text.replace("static: {}", solver).replace("cells_across: 4", "cells_across: 2"),
        encoding="utf-8",
    )
    command = [sys.executable, "-c", RUN, str(scene), str(tmp_path / "out"), *more]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, ""), done.stderr


def test_tasks_are_compiled_for_the_arguments_that_a_step_makes() -> None:
    """Each once: for others, however alike, the step would compile it again."""
    at_rest = rod_scene(field=(0.0, 0.0, 5e-3)).to_si()
    scene = Scene.from_si({**at_rest, "solver": {"dynamic": {"duration": 1e-4}}})
    motion, acting = warmup._in_motion(coarsest(scene))
    tasks = [one for part in motion.tasks(acting).values() for one in part]
    for function, arguments in tasks:
        compile_task(function, arguments)
    known = {function: set(function.overloads) for function, _ in tasks}
    motion.advance(1, 1e-12, acting)
    assert {function: set(function.overloads) for function in known} == known
    assert len(known) == 6


FIELD = """
import numpy as np
from magmpm.fields.kernels import PLACE, field, fields_at
fields_at(np.zeros(1, PLACE)[0], np.zeros(2), np.ones((1, 3)), np.empty((1, 3)))
print(sum(fields_at.stats.cache_hits.values()), sum(fields_at.stats.cache_misses.values()), len(field.signatures))
"""


def test_a_field_that_is_needed_before_the_run_is_compiled_elsewhere(tmp_path: Path) -> None:
    """From an empty cache as well: kernels of the run would call its functions, and the first run differ from others in the last bit."""
    done = subprocess.run(
        [sys.executable, "-c", FIELD],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": ""},
    )
    assert done.stdout.split() == ["1", "0", "0"], done.stderr


ROD = """
import numpy as np
from magmpm.rod.cosserat import rod_model, solve_rod
from magmpm.rod.derivative_kernels import relax_all, softest
from magmpm.rod.family import RodFamily
from magmpm.rod.kernels import frames_of, relax
from magmpm.scene import load_scene
import sys
scene = load_scene(sys.argv[1])
solve_rod(scene)
family = RodFamily.of(rod_model(scene, 40), scene.body.shape.segment_lengths(), [0])
one = np.array([[[1.0, 0.0, 0.0]]])
q = family.straight(1)
family.relaxed(q, one)
family.stability(q[0], one[0], np.zeros(3))
kernels = (relax, frames_of, relax_all, softest)
print(*(sum(counts.values()) for one in kernels for counts in (one.stats.cache_hits, one.stats.cache_misses)))
"""


@pytest.mark.slow
def test_a_rod_that_is_needed_before_the_run_is_compiled_elsewhere(tmp_path: Path) -> None:
    """A study looks at rods before it prepares kernels: from an empty cache, its trials differed from a later run's in the last bits."""
    scene = Path(__file__).parents[3] / "data/scenes/five_segments.yaml"
    done = subprocess.run(
        [sys.executable, "-c", ROD, str(scene)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path), "NUMBA_CACHE_DIR": ""},
    )
    assert done.stdout.split() == ["1", "0"] * 4, done.stderr


def test_it_is_coarse_and_faint_and_has_every_effect() -> None:
    scene = rod_scene().with_cells(6).with_effects(gravity={"acceleration": [0.0, 0.0, -9.81]})
    small = coarsest(scene)
    assert small.resolution.cells_across == 2
    assert list(small.effects.named()) == list(scene.effects.named())
    assert small.effects.gravity.acceleration == (0.0, 0.0, -9.81 * FAINT)
    for name, material in scene.materials.items():
        assert small.materials[name].remanence == (material.remanence or 0.0) * FAINT


def test_it_has_the_cells_that_the_scene_needs() -> None:
    """A strip whose magnetization turns once needs 3 cells across: it was refused on 2, by a message about a number nobody wrote."""
    profile = {"harmonic": {"periods": 1.0, "phase": 0.0, "plane": "xz", "turn": "ccw"}}
    strip = {
        "length": 6e-3,
        "width": 2e-3,
        "thickness": 2e-3,
        "material": "m",
        "clamp": "base",
        "magnetization_profile": profile,
    }
    materials = {"m": {"shear_modulus": 3e5, "bulk_to_shear": 20.0, "remanence": 0.1}}
    data = {
        "name": "turning",
        "materials": materials,
        "body": {"strip": strip},
        "resolution": {"cells_across": 3},
    }
    scene = Scene.from_si(
        {
            **data,
            "field": {"uniform": [0.0, 0.0, 0.01]},
            "effects": {"magnetic_torque": {}},
            "solver": {"static": {}},
        }
    )
    assert coarsest(scene).resolution.cells_across == 3
    asked = Scene.from_si({**scene.to_si(), "resolution": {"error": 0.01}})
    assert coarsest_cells(asked) == 3
    result = run(asked)
    assert next(one["cells_across"] for one in result.resolution["tried"]) == 3
