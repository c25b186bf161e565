"""The benchmarks measure what they state: a fair baseline kernel, a body that moves and touches, growth of the process."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from magmpm.kernels.watch import unlimited
from magmpm.scene.memory import BYTES, BYTES_PER_PARTICLE

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(autouse=True)
def _importable(monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in (BENCHMARKS, BENCHMARKS.parent / "faults", BENCHMARKS.parent):
        monkeypatch.syspath_prepend(str(folder))


def module(name: str) -> ModuleType:
    return __import__(name)


@pytest.mark.slow
def test_the_twin_moves_a_body_as_the_kernel_does() -> None:
    """From a state without zeros, bit for bit: the sums are the same."""
    rates = module("motion_rates")
    plain = module("plain_total")
    model, motion, dt = rates.started(cells=2)
    rates.advance(motion, 300, dt, model.effects)
    assert np.count_nonzero(motion.v) > 0.9 * np.count_nonzero(motion.packed.nodes.inverse_mass)
    u = motion.u.copy()
    v = motion.v.copy()
    motion.model = replace(model, effects=())
    motion.advance(20, dt, ())
    ours = motion.u.copy(), motion.v.copy()
    motion.u[:], motion.v[:], motion.watch[:] = u, v, unlimited()
    assert plain.steps_of(motion, 20, dt, motion.u, motion.v) == 20
    for one, other in zip(ours, (motion.u, motion.v), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-14 * np.abs(one).max())


def test_contact_is_measured_on_a_body_that_touches() -> None:
    rates = module("motion_rates")
    lying = rates.scene(cells=2)
    radius = lying.thickness / 2
    low = lying.with_effects(ground={"point": [0.0, 0.0, -0.4 * radius]})
    assert 0.1 < rates.touching_share(low, "ground") < 0.5
    far = lying.with_effects(ground={"point": [0.0, 0.0, -3 * radius]})
    assert rates.touching_share(far, "ground") == 0.0


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/statm").exists(), reason="memory of a process is read from /proc"
)
def test_memory_that_is_told_is_what_a_process_grows_by(monkeypatch: pytest.MonkeyPatch) -> None:
    """The estimate before the model is built is below the growth; the one after it is near (a tenth: share of libraries, and rounding)."""
    found = module("resident").grown()
    assert found["particles"] > 1e5
    assert found["peak"] > BYTES
    assert found["counted"] == pytest.approx(found["peak"], rel=0.1)
    assert found["counted"] >= BYTES_PER_PARTICLE


def test_bench_says_what_it_was_measured_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Host, processor, threads, commit, load, a matrix product, a copy. A figure that fails is a row; the exit status tells of it."""
    machine = module("machine")
    bench = module("bench")
    monkeypatch.setattr(machine, "SIDE", 128)
    monkeypatch.setattr(machine, "COPIED", 8_000_000)

    def fails() -> float:
        raise RuntimeError("the body does not touch")

    monkeypatch.setitem(
        bench.FIGURES, "particle_steps_per_s", bench.Figure(lambda: 4e7, "1/s", 24e6, least=True)
    )
    monkeypatch.setitem(bench.FIGURES, "a figure", bench.Figure(fails, "s", 1.0))
    assert bench.main(["a figure", "particle_steps_per_s"], tmp_path) == 1
    found = json.loads((tmp_path / "bench.json").read_text())
    host = found["machine"]
    assert set(host) >= {"host", "cpu", "cores", "threads", "commit", "load"}
    assert 0.0 < host["dgemm_flop_per_s"] < np.inf
    assert 0.0 < host["copy_bytes_per_s"] < np.inf
    rate = found["particle_steps_per_s"]
    assert rate["value"] == 4e7
    assert rate["per_gflop"] == pytest.approx(4e16 / host["dgemm_flop_per_s"])
    assert rate["commit"] == host["commit"]
    said = capsys.readouterr().out
    assert "Gflop/s" in said
    assert "FAILED: the body does not touch" in said


def test_the_design_benchmark_counts_what_it_says() -> None:
    """Solves from 1, seconds at that solve; quantiles over studies, none where too few came that near; every target is there."""
    design = module("design")
    one = {
        "rms_mm": [5.0, 1.9, 0.05],
        "seconds": [0.2, 0.4, 0.6],
        "best_mm": 0.05,
        "finer_mm": 0.06,
    }
    other = {"rms_mm": [1.0, 3.0], "seconds": [0.1, 0.3], "best_mm": 1.0, "finer_mm": 1.1}
    assert design.reached(one, 2.0) == (2.0, 0.4)
    assert design.reached(other, 0.5) == (float("inf"), float("inf"))
    rows = design.summary([one, other, other])
    assert rows["2 mm"] == {"share": 1.0, "solves": [1.0, 2.0], "seconds": [0.1, 0.4]}
    assert rows["0.5 mm"] == {
        "share": pytest.approx(1 / 3),
        "solves": [None, None],
        "seconds": [None, None],
    }
    assert (rows["best_mm"], rows["finer_mm"]) == (1.0, 1.1)
    assert "| tpe | free | 1, 2 | 100 % | 0.1 | -, - | 33 % | - |" in design.table(
        {"tpe": {"free": rows}}
    )
    for kind in ("reachable", "free"):
        assert len(list(design.TARGETS.glob(f"{kind}_*.csv"))) == 12
    study = design.study_of(design.TARGETS / "free_01.csv", "gp+rod", 7)
    assert (study.sampler, study.start, study.trials, study.stop_rms) == (
        "gp",
        "rod",
        7,
        pytest.approx(1e-4),
    )


def test_a_fault_whose_probe_fails_is_a_row_and_the_others_are_injected() -> None:
    faults = module("faults")

    def fails() -> None:
        raise TimeoutError("180 s")

    one, other = faults.rows({"first": fails, "second": lambda: faults.Row("second", 1, 1, 1, 0)})
    assert (one.kind, other.kind, other.wrong) == ("first", "second", [])
    assert "TimeoutError" in one.wrong[0]


def test_only_kills_that_met_something_complete_count() -> None:
    """Attempts go on until so many have, and end where none does; a fault that found nothing to lose is no proof."""
    faults = module("faults")
    kinds = module("kinds")
    row = faults.Row("kills")
    for attempt in kinds.until_met(row, 4):
        # every other one comes too early
        row.injected = row.injected + 1
        row.met = row.met + attempt % 2
    assert (row.injected, row.met, row.wrong) == (8, 4, [])
    never = faults.Row("kills")
    assert len(list(kinds.until_met(never, 4))) > 4
    assert never.wrong == ["0 of 4 kills met something complete"]
    (missed,) = faults.rows({"missed": lambda: faults.Row("missed", injected=1)})
    assert "shows nothing" in missed.wrong[0]


def test_every_target_has_a_short_form() -> None:
    """`make targets-short` goes over all that the Makefile offers, and every rule but those for files is declared there."""
    short = module("targets_short")
    assert short.SHORT.keys() | short.ELSEWHERE.keys() == short.targets()
    assert short.SHORT.keys().isdisjoint(short.ELSEWHERE)
    makefile = (BENCHMARKS.parents[1] / "Makefile").read_text(encoding="utf-8")
    assert set(re.findall(r"^([a-z][a-z-]*):", makefile, re.MULTILINE)) == short.targets()
