"""Plots and picture files say what the numbers say, and the same numbers give the same file."""

import base64
import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from magmpm.viz import plots, tip_map
from magmpm.viz.from_motion import MotionRenderer
from magmpm.viz.picture_file import save_image

RMS = [8e-3, None, 5e-3, 6e-3, float("nan"), 3e-3, 4e-3]


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that would have been written."""
    drawn: list[Figure] = []

    def keep(figure: Figure, path: Any) -> Path:
        drawn.append(figure)
        return Path(path)

    monkeypatch.setattr(plots, "saved", keep)
    return drawn


def line(figure: Figure, label: str, axes: int = 0) -> np.ndarray:
    """Points (n, 2) of the line whose label starts so."""
    (found,) = (
        drawn for drawn in figure.axes[axes].lines if str(drawn.get_label()).startswith(label)
    )
    return np.asarray(found.get_xydata())


def test_best_so_far_never_rises_and_passes_over_failures(figures: list[Figure]) -> None:
    plots.convergence(RMS, "unused.png")
    best = line(figures[0], "best so far (3.00 mm, trial 5)")
    assert best[:, 0].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert best[:, 1] == pytest.approx([8, 8, 5, 5, 5, 3, 3])


def test_a_failed_trials_penalty_counts_for_nothing(figures: list[Figure]) -> None:
    plots.convergence([4e-3, 1e-4, 3e-3], "unused.png", failed=[1])
    assert line(figures[0], "best so far")[:, 1] == pytest.approx([4, 4, 3])
    labels = [str(drawn.get_label()) for drawn in figures[0].axes[0].collections]
    assert "failed" in labels
    plots.convergence([4e-3, 3e-3], "unused.png")
    assert "failed" not in [str(drawn.get_label()) for drawn in figures[1].axes[0].collections]


@pytest.mark.parametrize(
    ("rms", "stop", "scale"),
    [
        ([5e-3, 4e-3], None, "linear"),
        ([5e-3, 4e-4], None, "log"),
        ([5e-3, 4e-3], 1e-4, "log"),
        ([None], None, "linear"),
    ],
)
def test_the_axis_is_logarithmic_where_values_span_more_than_ten(
    figures: list[Figure], rms: list[float | None], stop: float | None, scale: str
) -> None:
    plots.convergence(rms, "unused.png", stop=stop)
    assert figures[0].axes[0].get_yscale() == scale


def test_convergence_without_trials_is_a_plot_that_says_so(tmp_path: Path) -> None:
    assert plots.convergence([], tmp_path / "none.png").stat().st_size > 1000


def table(order: float = 2.0) -> list[dict[str, Any]]:
    sizes = [(n, (2 / n) ** order) for n in (4, 2, 6, 10)]
    errors = [
        {"error_finest": None if n == 10 else 0.02 * fall, "error_reference": 0.025 * fall}
        for n, fall in sizes
    ]
    return [
        {"cells_across": n, "cell_size": 4e-3 / n, "seconds": 0.01 * n**3, **error}
        for (n, _), error in zip(sizes, errors)
    ]


def test_accuracy_shows_both_series_in_per_cent(figures: list[Figure]) -> None:
    plots.accuracy(table(), "unused.png", reference_name="FEM")
    assert line(figures[0], "against FEM")[:, 1] == pytest.approx([2.5, 0.625, 2.5 / 9, 0.1])
    assert line(figures[0], "against the finest")[:, 0] == pytest.approx([0.08, 0.64, 2.16])
    assert line(figures[0], "against the finest", axes=1)[:, 0] == pytest.approx([2.0, 1.0, 2 / 3])
    texts = [text.get_text() for text in figures[0].axes[0].texts]
    assert {"2", "4", "6", "10"} <= set(texts)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0, 3.0])
def test_the_triangle_has_the_order_that_was_found(figures: list[Figure], order: float) -> None:
    """Not the slope of the series, which to a finest solution with an error of its own is steeper."""
    plots.accuracy(table(2.0), "unused.png", order_finest=order)
    assert f"{order:.1f}" in [text.get_text() for text in figures[0].axes[1].texts]
    triangle = next(
        drawn for drawn in figures[0].axes[1].lines if str(drawn.get_label()).startswith("_")
    )
    (x0, y0), _, (x1, y1), _ = np.asarray(triangle.get_xydata())
    assert np.log(y1 / y0) / np.log(x1 / x0) == pytest.approx(order)


def test_accuracy_without_a_reference_or_with_one_row(tmp_path: Path) -> None:
    rows = table()
    for row in rows:
        del row["error_reference"]
    assert plots.accuracy(rows, tmp_path / "finest.png").exists()
    assert plots.accuracy(rows[:1], tmp_path / "one.png").exists()


@pytest.mark.parametrize("kind", ["png", "pdf", "svg"])
def test_the_same_numbers_give_the_same_file(tmp_path: Path, kind: str) -> None:
    one, two = (
        plots.convergence(RMS, tmp_path / f"{k}.{kind}", stop=2e-3, title="S") for k in range(2)
    )
    assert one.read_bytes() == two.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"0.{kind}", f"1.{kind}"]


def test_energies_and_forces_are_plotted(motion: MotionRenderer, tmp_path: Path) -> None:
    path = plots.motion(
        motion.motion.energies, motion.motion.contacts, tmp_path / "energies.svg", "bending"
    )
    text = path.read_text()
    for word in ("kinetic", "elastic", "magnetic torque", "total", "ground", "time (s)"):
        assert word in text
    alone = plots.motion(motion.motion.energies, {}, tmp_path / "alone.svg")
    assert "contact force" not in alone.read_text()


def test_labels_of_the_plots_stand_whole(tmp_path: Path) -> None:
    """One spike among zeros: its axis gets wide ticks once the layout is made, and they pushed the label over the edge."""
    time = np.linspace(0.0, 0.02, 21)
    spike = np.where(time == time[19], 3.46e-3, 0.0)
    energies = {
        "t": time,
        "kinetic": 3e-6 * np.sin(300 * time) ** 2,
        "elastic": 6e-6 * np.sin(300 * time),
        "total": -6.9e-6 * np.sin(400 * time),
    }
    walls = {"t": time, "Fx": -0.03 * spike, "Fy": -0.1 * spike, "Fz": spike}
    with Image.open(plots.motion(energies, {"walls": walls}, tmp_path / "energies.png")) as image:
        pixels = np.asarray(image.convert("L"))
    for edge in (pixels[:2], pixels[-2:], pixels[:, :2], pixels[:, -2:]):
        assert edge.min() > 250


def test_the_front_is_drawn_with_its_units_and_its_compromise(
    figures: list[Figure], tmp_path: Path
) -> None:
    """Points in mm and mT; failed trials are not there; one point is a front too."""
    report = {
        "name": "probe",
        "objectives": ["rms_m", "largest_field_T"],
        "values": [[1e-3, 9e-3], [2e-3, 3e-3], None, [4e-3, 8e-3], [5e-3, 1e-3]],
        "pareto": [
            {"number": k, "values": v}
            for k, v in ((0, [1e-3, 9e-3]), (1, [2e-3, 3e-3]), (4, [5e-3, 1e-3]))
        ],
        "compromise": 1,
    }
    plots.pareto(report, tmp_path / "pareto.png")
    axes = figures[-1].axes[0]
    others, front, best = (np.asarray(drawn.get_offsets()) for drawn in axes.collections)
    np.testing.assert_allclose(others, [[4, 8]])
    np.testing.assert_allclose(front, [[1, 9], [2, 3], [5, 1]])
    np.testing.assert_allclose(best, [[2, 3]])
    assert axes.get_ylabel() == "largest field (mT)"
    assert [drawn.get_label() for drawn in axes.collections][
        2
    ] == "best compromise: trial 1 (2 mm, 3 mT)"
    one = {
        "values": [[1e-3, 9e-3]],
        "pareto": report["pareto"][:1],
        "objectives": ["rms_m", "magnetized_volume_m3"],
    }
    plots.pareto({**report, **one}, tmp_path / "b.png")


def test_the_color_bar_has_the_strengths_of_the_fields(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the weakest to the strongest, no color for what is not there."""
    bars: list[Any] = []
    whole = Figure.colorbar
    monkeypatch.setattr(
        Figure,
        "colorbar",
        lambda self, shown, **kind: bars.append(shown) or whole(self, shown, **kind),
    )
    strengths = np.linspace(3e-3, 20e-3, 4)
    fields = np.kron(np.array([[0, 0, 1.0], [0, 0.6, 0.8], [0, 1.0, 0]]), strengths[:, None])
    tips = np.array([0.04, 0.0, 0.0]) + fields
    found = tip_map.MappedTips(
        fields, tips, np.full(12, "sure"), "rays", (1, 2), (3, 4), length=0.04
    )
    path = tip_map.draw(tmp_path / "map.svg", "", found)
    assert bars[0].get_clim() == pytest.approx((3.0, 20.0))
    assert "strength of the field, mT" in path.read_text(encoding="utf-8"), "text as text"


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_a_picture_is_in_its_file_without_loss(kind: str, tmp_path: Path) -> None:
    image = np.random.default_rng(1).integers(0, 256, (120, 200, 3), dtype=np.uint8)
    written = save_image(image, tmp_path / f"a/picture.{kind}").read_bytes()
    if kind == "svg":
        (coded,) = re.findall(rb"data:image/png;base64,\s*([^\"]+)", written)
        written = base64.b64decode(coded)
    assert (np.asarray(Image.open(io.BytesIO(written)).convert("RGB")) == image).all()


def test_the_same_picture_gives_the_same_page(tmp_path: Path) -> None:
    image = np.zeros((120, 200, 3), dtype=np.uint8)
    first, again = (save_image(image, tmp_path / f"{name}.pdf").read_bytes() for name in "ab")
    assert first == again
    assert first.startswith(b"%PDF-")
    assert b"/MediaBox [ 0 0 72 43.2 ]" in first  # 200 pixels to the inch of 72 points
