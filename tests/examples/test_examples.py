"""Each script of examples/ computes what theory, symmetry or a balance says; quick settings here, whole runs marked slow.

The first two show how little a user must write, and their lines of code are counted.
"""

import ast
import runpy
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.interpolate import CubicSpline
from scipy.optimize import curve_fit

import magmpm

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
PICTURES = ROOT / "docs" / "images" / "examples"
PAGE = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
Example = Callable[[str], ModuleType]


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Example:
    """example(name): the script of that name, imported from its folder as a user's own would be."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    monkeypatch.chdir(ROOT)  # from where some read files of data/
    monkeypatch.delitem(
        sys.modules, "swing", raising=False
    )  # a script of other tests has this name
    return __import__


def code_lines(path: Path) -> int:
    """Count a file's lines of code: what is left without its docstring and empty lines."""
    text = path.read_text(encoding="utf-8")
    docstring = ast.parse(text).body[0].end_lineno or 0
    return sum(bool(line.strip()) for line in text.splitlines()[docstring:])


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_scripts_are_alike(path: Path) -> None:
    """A title, what is computed and how long it takes; a `main` with a folder; a picture on the page; 20 to 60 lines of code at most."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    said = ast.get_docstring(tree) or ""
    title, _, text = said.partition("\n\n")
    assert len(title) < 100
    assert title.endswith(".")
    assert text.endswith("second.") or "second" in text or "minute" in text
    main = next(node for node in tree.body if getattr(node, "name", "") == "main")
    assert isinstance(main, ast.FunctionDef)
    assert main.args.args[0].arg == "folder"
    assert code_lines(path) <= 60
    picture = PICTURES / f"{path.stem}.png"
    assert 5_000 < picture.stat().st_size < 150_000
    assert f"images/examples/{picture.name}" in PAGE
    assert f"examples/{path.name}" in PAGE


def test_the_first_two_are_short() -> None:
    """From nothing to a picture of five segments in 15 lines, to a design in 25, without a file."""
    assert len(EXAMPLES) >= 14
    assert code_lines(ROOT / "examples/first_shape.py") <= 15
    assert code_lines(ROOT / "examples/design_shape.py") <= 25


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_a_script_runs_and_leaves_its_picture(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a user runs it, in an empty folder."""
    if path.stem == "dask_sweep" and find_spec("distributed") is None:
        pytest.skip("needs distributed: pip install distributed")
    monkeypatch.chdir(tmp_path)
    with np.errstate(all="warn"):  # what matplotlib does with numbers is its own
        runpy.run_path(str(path), run_name="__main__")
    assert (tmp_path / f"{path.stem}.png").stat().st_size > 5_000


def test_first_shape(example: Example) -> None:
    """A mirrored scene has the mirrored shape: fields and magnetizations are reflected as vectors, since energies are B . F Br."""
    first_shape = example("first_shape")
    result = first_shape.main()
    across = np.array([1, -1, 1])
    mirrored = first_shape.main(
        directions=np.array(first_shape.DIRECTIONS) * across, field=[0, 5e-3, 9e-3]
    )
    # both are solved to 1e-6 of the length (docs/design.md: the end of the solve)
    np.testing.assert_allclose(mirrored.tip, across * result.tip, atol=1e-6 * 40e-3)
    assert result.tip[1] < -5e-3  # it bends out of the plane, and by more than its thickness


def test_design_shape(example: Example, tmp_path: Path) -> None:
    """The best shape lies on the arc, also on a finer grid than the search used; all within the field that was allowed."""
    design_shape = example("design_shape")
    report, best = design_shape.main(tmp_path)
    arc = CubicSpline(design_shape.ARC[:, 0], design_shape.ARC[:, 1:])
    finer = magmpm.run(magmpm.Scene.from_si(best.scene).with_cells(5))
    for result in (best, finer):
        apart = np.linalg.norm(result.centreline[:, 1:] - arc(result.centreline[:, 0]), axis=1)
        # rms of what the report promises; a finer grid moves it by 0.1 % of the length (docs/accuracy.md)
        assert np.sqrt(np.mean(apart**2)) < report.best["rms_m"] + 1e-3 * 40e-3
    assert report.best["rms_m"] < 0.2e-3  # half a percent of the length: on the line of a plot
    assert np.linalg.norm(best.field) <= 10e-3 * (1 + 1e-9)


def test_field_sweep(example: Example) -> None:
    """Heights are those of the elastica. At L/D = 20 the clamp, which restrains the section, is worth some 0.3 % of the length."""
    field_sweep = example("field_sweep")
    fields, heights = field_sweep.main(fields=[0.5e-3, 1e-3, 3e-3], workers=1)
    theory = [field_sweep.elastica(field) for field in fields]
    np.testing.assert_allclose(heights, theory, atol=0.005 * field_sweep.LENGTH)
    # the elastica itself, in a weak field: A Br B L^3/(3 mu0 EI)
    young = 9 * 20 * field_sweep.SHEAR / 61
    weak = 16 * field_sweep.REMANENCE * 1e-6 * field_sweep.LENGTH**3
    weak /= 3 * field_sweep.mu_0 * young * field_sweep.DIAMETER**2
    assert field_sweep.elastica(1e-6) == pytest.approx(weak, rel=1e-4)


def test_own_objective(example: Example, tmp_path: Path) -> None:
    """The search finds the best of a scan over all directions; there the bent outer half stands across the field."""
    own_objective = example("own_objective")
    report, best = own_objective.main(tmp_path, trials=15)
    angles = np.radians(np.arange(0, 360, 30))
    outer = [[float(np.cos(angle)), 0.0, float(np.sin(angle))] for angle in angles]
    table = magmpm.sweep(
        own_objective.scene(),
        {"body.catheter.segments[1].magnetization": outer},
        measure=[own_objective.room],
        workers=1,
    )
    scanned = max(row["room"] for row in table.rows)
    assert own_objective.room(best) > 0.98 * scanned  # a scan by 30 degrees misses 2 % of a cosine
    assert own_objective.room(best) == pytest.approx(report.best["values"][0], rel=1e-9)
    turned = best.segment_remanence[1] / np.linalg.norm(best.segment_remanence[1])
    assert abs(turned[2]) < np.sin(np.radians(30))


def test_insertion(example: Example, tmp_path: Path) -> None:
    """At each depth the body lies on the path of the tip; each field is one that is allowed."""
    insertion = example("insertion")
    best, _ = insertion.main(tmp_path, depths=3, trials=2, cells=2)
    assert len(best["insertion"]) == 3
    for row in best["insertion"]:
        assert np.linalg.norm(row["field_T"]) <= 10e-3 * (1 + 1e-9)
    assert best["worst_m"] < 0.5 * 3e-3  # nowhere farther from the path than the catheter's radius
    bend = np.degrees(np.arctan2(*np.diff(insertion.path()[48:50, [3, 1]], axis=0)[0]))
    assert bend == pytest.approx(40.0 * insertion.LENGTH / np.pi * 180 / np.pi, rel=1e-3)


def test_swing(example: Example, tmp_path: Path) -> None:
    """The tip swings at the frequency of Euler and Bernoulli's cantilever, and the energy that is lost is what damping takes."""
    swing = example("swing")
    times, height, energies = swing.main(tmp_path, duration=0.25)

    def ringing(t: np.ndarray, rest: float, rate: float, frequency: float) -> np.ndarray:
        pace = 2 * np.pi * frequency
        swung = np.cos(pace * t) + rate / (2 * pace) * np.sin(pace * t)
        return rest * (1 - np.exp(-rate / 2 * t) * swung)

    (_, _, frequency), _ = curve_fit(
        ringing, times, height, p0=(height.mean(), swing.RATE, swing.frequency())
    )
    # 2 cells across are 0.9 % too stiff (docs/design.md, Motion); shear and rotary inertia at L/D = 15 take 0.5 %
    assert frequency == pytest.approx(swing.frequency(), rel=0.02)
    # what damping has taken: rate v^2 a mass, of which the kinetic energy is a half; by the trapezoidal rule over frames, 4 ms apart
    taken = 2 * swing.RATE * trapezoid(energies["kinetic"], energies["t"])
    lost = energies["total"][0] - energies["total"][-1]
    assert lost == pytest.approx(taken, rel=0.02)


def test_stl_robot(example: Example) -> None:
    """The two tips come together, as mirror images of each other; nothing moves across the plane of the arms."""
    stl_robot = example("stl_robot")
    result = stl_robot.main()
    at_first = {"left_tip": [-3.5e-3, 1e-3, 12e-3], "right_tip": [3.5e-3, 1e-3, 12e-3]}
    left, right = (result.positions[name] - place for name, place in at_first.items())
    assert left[0] > 0.5e-3
    # the grid itself lies as a mirror image: what is left is the tolerance of the solve
    np.testing.assert_allclose(right, left * [-1, 1, 1], atol=1e-6 * 14e-3)
    assert abs(left[1]) < 1e-6 * 14e-3


@pytest.mark.slow
def test_walking_strip(example: Example, tmp_path: Path) -> None:
    """It walks, by a third of its length or so in three cycles."""
    _, way = example("walking_strip").main(tmp_path)
    assert 0.1 < way[-1] / 4.5e-3 < 1.0


@pytest.mark.slow
def test_walking_on_ice(example: Example, tmp_path: Path) -> None:
    """Without friction nothing pulls on it sideways: its center of mass stays, while it arches as it does when it walks."""
    motion, way = example("walking_strip").main(tmp_path, friction=0.0, cycles=1)
    bent = np.ptp(motion.position(19)[:, 2])  # at the end of the growing field
    assert bent > 2 * 0.3e-3
    assert np.abs(way).max() < 1e-4 * 4.5e-3  # positions are in single precision


@pytest.mark.slow
def test_gripper(example: Example, tmp_path: Path) -> None:
    """The ball is lifted along the axis, and in the end the ground carries nothing of it; opposite arms move alike."""
    motion = example("gripper").main(tmp_path)
    ball = motion.positions["gripper_ball"]
    assert ball[-1, 2] - ball[0, 2] > 0.1e-3
    assert np.hypot(*ball[-1, :2]) < 0.02 * 2.5e-3  # of its radius: contact magnifies rounding
    assert abs(motion.contacts["ground"]["Fz"][-1]) < 1e-6
    for one, other in ((1, 4), (2, 5), (3, 6)):
        moved = [
            np.diff(motion.positions[f"gripper_outer_{number}"][[0, 12]], axis=0)[0]
            for number in (one, other)
        ]  # at 30 ms, when the field has its full strength
        assert np.linalg.norm(moved[0] + moved[1] * [1, 1, -1]) < 0.02 * np.linalg.norm(moved[0])


def test_swimmer(example: Example, tmp_path: Path) -> None:
    """A field that turns the other way sends it as far to the other side: x -> -x maps one scene to the other."""
    swimmer = example("swimmer")
    _, way = swimmer.main(tmp_path / "one", duration=0.05)
    _, back = swimmer.main(tmp_path / "other", frequency="-25 Hz", duration=0.05)
    assert abs(way[-1]) > 0.1e-3
    np.testing.assert_allclose(back, -way, atol=1e-3 * abs(way[-1]))


def test_fit_modulus(example: Example, tmp_path: Path) -> None:
    """The interval holds the modulus that was hidden, and is as wide as noise and slope say: exact tips give the modulus exactly."""
    fit_modulus = example("fit_modulus")
    found, _ = fit_modulus.main(tmp_path)
    assert found.low < 105e3 < found.high
    (tmp_path / "exact").mkdir()
    exact, _ = fit_modulus.main(tmp_path / "exact", noise=0.0)
    assert exact.value == pytest.approx(105e3, rel=1e-3)  # the table has 1 um of 20 mm


def test_error_against_time(example: Example) -> None:
    """Errors fall with the cells, and the promised bound holds against finite elements."""
    rows = example("error_against_time").main(cells=(3, 6))
    _, _, errors, bounds = rows.T
    assert errors[1] < errors[0] / 2  # at least of first order in the cells
    assert np.all(
        errors < bounds + 1.6e-6
    )  # what the finite elements err: data/references/fem.json


def test_dask_sweep(example: Example) -> None:
    """Up is down, mirrored; by threads of this process, and by Dask where it is installed."""
    dask_sweep = example("dask_sweep")
    angles = np.radians([-120, -60, 60, 120])
    tips = dask_sweep.main(angles=angles, strengths=[2e-3])[0]
    np.testing.assert_allclose(tips[:2], tips[:1:-1] * [1, -1], atol=1e-6 * 40e-3)
    distributed = pytest.importorskip("distributed")
    with distributed.Client(n_workers=1, threads_per_worker=1, processes=False) as client:
        given = dask_sweep.main(executor=client.get_executor(), angles=angles[:1], strengths=[2e-3])
    np.testing.assert_allclose(given[0, 0], tips[0], atol=1e-6 * 40e-3)


def test_paraview_files(example: Example, tmp_path: Path) -> None:
    """What VTK's reader finds is what the motion has; stress along the beam is odd through its thickness, and none in its middle."""
    pytest.importorskip("vtkmodules")
    places, arrays = example("paraview_files").main(tmp_path, duration=0.05, cells=2)
    motion = magmpm.Motion.load(tmp_path)
    np.testing.assert_array_equal(places, motion.position(-1))
    assert (tmp_path / "surface.vtp").stat().st_size > 1_000
    along = arrays["cauchy_stress"].reshape(-1, 3, 3)[:, 0, 0]
    depth = motion.reference[:, 2]
    inner = abs(motion.reference[:, 0] - 5e-3) < 2e-3
    above = along[inner & (depth > 0)].mean()
    below = along[inner & (depth < 0)].mean()
    assert above < 0 < below  # it bends up: pressed above, stretched below
    assert abs(above + below) < 0.2 * (below - above)


def test_buckling(example: Example, tmp_path: Path) -> None:
    """It buckles at Euler's load. At L/D = 20 theory is exceeded by 0.6 % at 4 cells, and by some 1 % at 2 (docs/quasi_static.md)."""
    buckling = example("buckling")
    motion = buckling.main(tmp_path, steps=8)
    assert [jump["kind"] for jump in motion.jumps] == ["bifurcation"]
    assert motion.jumps[0]["field"] == pytest.approx(buckling.critical_field(), rel=0.02)
    before = motion.times < motion.jumps[0]["time"] * (1 - 1e-6)
    straight = np.hypot(motion.steps["tip_y"], motion.steps["tip_z"])[before]
    assert straight.max() < 1e-6 * buckling.LENGTH


def test_magnet_pull(example: Example) -> None:
    """From afar a magnet is a dipole, whose gradient falls as 1/d^4; near it the tip is held parallel to the magnet."""
    pytest.importorskip("magpylib")
    magnet_pull = example("magnet_pull")
    far, farther = (magnet_pull.main(distance=distance).tip[2] for distance in (200e-3, 240e-3))
    lift = magnet_pull.main(distance=200e-3, source=magnet_pull.dipole).tip[2]
    # a cylinder that is about as long as it is wide has next to no octupole: (10 mm/200 mm)^2 of it is below 0.3 %
    assert far == pytest.approx(lift, rel=0.005)
    # the tip reaches 10 mm to the side and is held by the field: (10/200)^2, and 1 % of the stiffness
    assert far / farther == pytest.approx((240 / 200) ** 4, rel=0.03)
    near = magnet_pull.main()
    slopes = np.diff(near.centreline[:, 3]) / np.diff(near.centreline[:, 1])
    assert slopes[-1] < slopes.max() / 2
