"""Plots of the evaluations: they show the evaluated values, with units on the axes, and render without a display."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from twin.display.figures import BACKWARD, FORWARD, save
from twin.standards.iso230_1 import straightness
from twin.standards.iso230_2 import bidirectional
from twin.standards.iso230_4 import error_motion
from twin.standards.page import plot_error_motion, plot_positioning, plot_straightness

ROOT = Path(__file__).resolve().parents[2]


def texts(figure: Figure) -> list[str]:
    found = [text.get_text() for axes in figure.axes for text in axes.texts] + [
        text.get_text() for text in figure.texts
    ]
    for axes in figure.axes:
        legend = axes.get_legend()
        found += [] if legend is None else [text.get_text() for text in legend.get_texts()]
    return found


def drawn(figure: Figure, plot: int = 0) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata(), dtype=float) for line in figure.axes[plot].lines]


def is_drawn(values: np.ndarray, figure: Figure, plot: int = 0) -> bool:
    return any(line.shape == values.shape and np.array_equal(line, values) for line in drawn(figure, plot))


def rendered(figure: Figure, path: Path, *colours: str) -> None:
    """Check a PNG of the figure's size, not blank, that contains each of these colours."""
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[..., :3]  # type: ignore[attr-defined]
    width, height = figure.get_size_inches() * figure.dpi
    assert pixels.shape == (int(height), int(width), 3)
    for colour in colours:
        near = np.abs(pixels.astype(float) / 255.0 - to_rgb(colour)).max(axis=2) < 0.02
        assert near.sum() > 50, colour
    save(figure, path)
    assert path.read_bytes().startswith(b"\x89PNG")


def runs(seed: int, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, 2.0, shape) + 5.0, rng.normal(0.0, 2.0, shape)


def test_positioning(tmp_path: Path) -> None:
    target = np.array([300.0, 0.0, 100.0, 200.0, 400.0])  # not in order: the plot is
    forward, backward = runs(1, (5, 5))
    result = bidirectional(target, forward, backward, axis="X")
    figure = plot_positioning(result)
    plot, order = figure.axes[0], np.argsort(target)
    assert plot.get_xlabel() == "target position [mm]"
    assert plot.get_ylabel().endswith("[µm]")
    assert plot.get_title(loc="left") == "Axis X: positioning by ISO 230-2:2014"
    for mean, s, each in (
        (result.mean_forward, result.s_i_forward, forward),
        (result.mean_backward, result.s_i_backward, backward),
    ):
        assert is_drawn(mean[order], figure)
        assert is_drawn((mean + 2.0 * s)[order], figure)
        assert is_drawn((mean - 2.0 * s)[order], figure)
        assert all(is_drawn(each[order, j], figure) for j in range(5))
    assert is_drawn(result.mean[order], figure)
    shown = texts(figure)
    for value in (result.B, result.B_mean, result.R, result.R_forward, result.E, result.E_backward, result.M, result.A):
        assert f"{value:.{1 if result.A >= 10 else 2}f}" in shown
    assert {"B", "E", "M", "A"} <= {text.strip() for text in shown}
    assert not any("Not by the standard" in text for text in shown)
    rendered(figure, tmp_path / "p.png", FORWARD, BACKWARD)


def test_positioning_of_a_rotary_axis_short_of_the_standard(tmp_path: Path) -> None:
    result = bidirectional(np.linspace(0, 90, 3), *runs(2, (3, 3)), "deg")
    figure = plot_positioning(result, title="Table")
    assert figure.axes[0].get_xlabel() == "target position [°]"
    assert figure.axes[0].get_ylabel().endswith("[µrad]")
    assert figure.axes[0].get_title(loc="left") == "Table"
    assert any("Not by the standard (4.3): 3 cycles" in text for text in texts(figure))
    rendered(figure, tmp_path / "p.png", FORWARD, BACKWARD)


@pytest.mark.parametrize("u_um", [None, 0.3])
def test_straightness(tmp_path: Path, u_um: float | None) -> None:
    position = np.linspace(0.0, 500.0, 11)
    result = straightness(position, np.random.default_rng(3).normal(0.0, 2.0, 11), name="E_YX", u_um=u_um)
    figure = plot_straightness(result)
    above, below = figure.axes
    assert above.get_ylabel() == "measured deviation [µm]"
    assert below.get_xlabel() == "X position [mm]"
    assert below.get_ylabel().endswith("[µm]")
    assert is_drawn(result.deviation_um, figure)
    for line in result.lines:
        assert is_drawn(line.at_um(position), figure)
        assert is_drawn(line.residual_um, figure, 1)
        assert f"{line.kind}: {line.value_um:.2f} µm" in texts(figure)
    assert sum("k = 2" in text for text in texts(figure)) == (0 if u_um is None else 3)
    rendered(figure, tmp_path / "s.png", FORWARD, BACKWARD)


@pytest.mark.parametrize(("kind", "turns"), [("radial", 4), ("axial", 1), ("tilt", 1)])
def test_error_motion(tmp_path: Path, kind: str, turns: int) -> None:
    angle = np.arange(0.0, 360.0, 10.0)
    readings = np.random.default_rng(4).normal(0.0, 1.0, (turns, 36)) + 20.0 * np.cos(np.radians(angle))
    result = error_motion(angle, readings, kind, name="E_XC")  # type: ignore[arg-type]
    figure = plot_error_motion(result)
    polar, bars = figure.axes
    assert polar.name == "polar"
    assert is_drawn(np.append(result.synchronous, result.synchronous[0]), figure)
    for turn in result.total if turns > 1 else ():
        assert is_drawn(np.append(turn, turn[0]), figure)
    for radius in (0.0, result.synchronous.min(), result.synchronous.max()):
        assert is_drawn(np.full(361, radius), figure)
    low, high = polar.get_ylim()
    assert low < result.total.min() < result.total.max() < high
    unit = "µrad" if kind == "tilt" else "µm"
    assert bars.get_ylabel() == f"amplitude [{unit}]"
    shown = texts(figure)
    assert any(f"radial scale [{unit}]" in text for text in shown)
    for value in (result.total_value, result.synchronous_value, result.fundamental_value, result.residual_value):
        assert f"{value:.2f}" in shown
    assert ("asynchronous" in shown) == (turns > 1)
    heights = [bar.get_height() for bar in bars.patches]  # type: ignore[attr-defined]
    assert heights == [h.amplitude for h in result.harmonics if kind == "axial" or h.order > 1]
    rendered(figure, tmp_path / "e.png", FORWARD, BACKWARD)


def test_a_perfect_axis_can_be_drawn(tmp_path: Path) -> None:
    rendered(plot_error_motion(error_motion(np.arange(0, 360, 30), np.zeros(12), "axial")), tmp_path / "e.png")
    rendered(plot_straightness(straightness([0, 1, 2], [0, 0, 0])), tmp_path / "s.png")
    rendered(plot_positioning(bidirectional([0, 1], np.zeros((2, 5)), np.zeros((2, 5)))), tmp_path / "p.png")


def test_only_the_plots_need_matplotlib() -> None:
    """The global state of matplotlib, which belongs to the user's notebook, does not change."""
    code = (
        "import sys; import twin.standards; assert 'matplotlib' not in sys.modules; "
        "import twin.standards.page; assert 'matplotlib.pyplot' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    importing = [path.name for path in (ROOT / "twin" / "standards").rglob("*.py") if "matplotlib" in imports(path)]
    assert importing == ["page.py"]


def imports(path: Path) -> str:
    return " ".join(line for line in path.read_text().splitlines() if line.startswith(("import ", "from ")))
