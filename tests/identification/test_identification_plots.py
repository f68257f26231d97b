"""Plots of an identification: they show the identified values in one datum, with units, and render without a display."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from twin._common.errors import InputError
from twin.display.figures import save
from twin.identification import Identification, identify
from twin.identification.plots import (
    correlation,
    plot_correlation,
    plot_motions,
    plot_orders,
    plot_residuals,
    plot_uncertainty,
)
from twin.identification.thesis import identify_as_thesis
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.samples import thesis_plan
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty


@pytest.fixture(scope="module")
def data(dmu50: Machine, calibration: Calibration) -> Measurements:
    plan = thesis_plan.plan(dmu50)
    two = plan.select(np.isin(plan.round, ["1", "2"]))
    return simulate(two, dmu50, calibration, LaserTracker(), np.random.default_rng(4))[0]


@pytest.fixture(scope="module")
def found(dmu50: Machine, data: Measurements) -> Identification:
    return identify(data, dmu50)


def lines(figure: Figure, panel: int, label: str) -> np.ndarray:
    """Return (2, n) the points of a panel's line with that label."""
    (line,) = [line for line in figure.axes[panel].lines if line.get_label() == label]
    return np.array([line.get_xdata(), line.get_ydata()], dtype=float)


def renders(figure: Figure, path: Path) -> None:
    save(figure, path, dpi=50)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_motions_of_a_linear_axis(
    dmu50: Machine, calibration: Calibration, data: Measurements, found: Identification, tmp_path: Path
) -> None:
    thesis = identify_as_thesis(data, dmu50)
    figure = plot_motions(found, "Y", thesis=thesis, truth=calibration.curves)
    names = [plot.get_title(loc="left") for plot in figure.axes]
    assert names == [f"E_{letter}Y" for letter in "XYZABC"]
    for panel, name in enumerate(names):
        plot = figure.axes[panel]
        assert plot.get_xlabel() == "Y [mm]"
        assert plot.get_ylabel() == f"{name} [{'µm' if panel < 3 else 'µrad'}]"
        q, shown = lines(figure, panel, "identified")
        value, u = found.interval(name, q)
        assert np.array_equal(shown, value)
        band = plot.collections[0].get_paths()[0].vertices
        assert band[:, 1].max() == pytest.approx((value + 1.959964 * u).max(), rel=1e-6)
        # One datum: no mean, and no line in a straightness.
        q, true = lines(figure, panel, "true (simulated)")
        assert np.abs(np.polyfit(q - q.mean(), true, 1)[1]) < 1e-9
        points = plot.containers[0][0]
        at, values = np.array(points.get_xdata()), np.array(points.get_ydata())
        line = np.polyfit(at - at.mean(), values, 1)
        assert abs(line[1]) < 1e-9 and (name in ("E_XY", "E_ZY")) == (abs(line[0]) < 1e-9)
        # What was taken off the points was taken off the curve: apart by the points' residuals and one constant (listing 3.1).
        fine, curve = lines(figure, panel, "thesis: degree 8")
        motion = thesis.motions[name]
        slope = np.polyfit(at, motion.mean, 1)[0] if name in ("E_XY", "E_ZY") else 0.0
        left = thesis.calibration.curves[name](at) + slope * at - motion.mean
        assert np.interp(at, fine, curve) - values == pytest.approx(
            left, abs=0.02 * np.ptp(values)
        )  # drawn in 361 points
    renders(figure, tmp_path / "y.png")


@pytest.mark.slow
def test_motions_of_a_rotary_axis(
    dmu50: Machine, calibration: Calibration, data: Measurements, found: Identification, tmp_path: Path
) -> None:
    """Polar alone, against the angle with the thesis; the rotating shift excluded by the datum is subtracted from all."""
    polar = plot_motions(found, "C", truth=calibration.curves)
    assert [plot.name for plot in polar.axes] == ["polar"] * 6
    angle, shown = lines(polar, 0, "identified")
    assert shown == pytest.approx(found.interval("E_XC", np.degrees(angle))[0], abs=1e-9)  # degrees there and back
    beside = plot_motions(found, "C", thesis=identify_as_thesis(data, dmu50), truth=calibration.curves)
    assert {plot.get_xlabel() for plot in beside.axes} == {"C [°]"}
    for x, y in ((0, 1), (3, 4)):
        q, first = lines(beside, x, "true (simulated)")
        second = lines(beside, y, "true (simulated)")[1]
        c, s = np.cos(np.radians(q)), -np.sin(np.radians(q))  # C turns about −z
        for pair in ((c, s), (-s, c)):
            assert abs(first @ pair[0] + second @ pair[1]) < 1e-6 * np.linalg.norm(first)
    half = plot_motions(found, "B")
    assert half.axes[0].get_thetamax() == 180.0  # type: ignore[attr-defined]
    for figure, name in ((polar, "c.png"), (beside, "cb.png"), (half, "b.png")):
        renders(figure, tmp_path / name)
    with pytest.raises(InputError, match="no error motions"):
        plot_motions(found, "W")


def test_orders_show_the_choice_and_degree_8(found: Identification, tmp_path: Path) -> None:
    figure = plot_orders(found, ["E_XX", "E_CC"])
    x, y = lines(figure, 0, "same number for all")
    assert dict(zip(x, y, strict=True)) == found.choice.uniform
    assert lines(figure, 0, f"degree 8 everywhere: {found.choice.uniform[9]:.3f}").tolist() == [
        [9.0],
        [found.choice.uniform[9]],
    ]
    x, y = lines(figure, 1, "E_CC")
    assert dict(zip(x, y, strict=True)) == found.choice.by_curve["E_CC"]
    rings = [line.get_xdata()[0] for line in figure.axes[1].lines if line.get_markersize() == 13]
    assert rings == [found.choice.counts["E_XX"], found.choice.counts["E_CC"]]
    renders(figure, tmp_path / "orders.png")
    renders(plot_orders(found), tmp_path / "four.png")


def test_residuals_lie_in_their_bands(found: Identification, tmp_path: Path) -> None:
    """Means by position: of some 70, one in twenty outside; more than five in twenty would mean a band too narrow or too wide."""
    figure = plot_residuals(found)
    inside = []
    for panel in range(5):
        _, mean = lines(figure, panel, "mean")
        band = figure.axes[panel].collections[0].get_paths()[0].vertices
        q = lines(figure, panel, "mean")[0]
        half = np.array([np.abs(band[np.isclose(band[:, 0], place), 1]).max() for place in q])
        inside += list(np.abs(mean) <= half)
    assert 0.75 < np.mean(inside) < 1.0
    assert figure.axes[5].get_xlabel() == "target"
    assert [text.get_text() for text in figure.axes[5].get_xticklabels()] == ["K", "P", "Q", "KT", "PT", "QT"]
    renders(figure, tmp_path / "r.png")


def test_correlation(found: Identification, tmp_path: Path) -> None:
    names, values = correlation(found)
    assert np.array_equal(values, values.T) and np.array_equal(np.diag(values), np.ones(len(names)))
    assert values.min() >= 0.0 and values.max() <= 1.0
    two = found.calibration.covariance.of(["E_C0Y", "E_B0Z"]).matrix
    expected = abs(two[0, 1]) / np.sqrt(two[0, 0] * two[1, 1])
    assert values[names.index("E_C0Y"), names.index("E_B0Z")] == pytest.approx(expected, rel=1e-6)
    # Linear and rotary axes never move together: next to nothing; a turn of a table and its mate in the datum: everything.
    assert values[names.index("E_XX"), names.index("E_CC")] < 0.2
    assert values[names.index("E_AC"), names.index("E_BC")] > 0.95
    renders(plot_correlation(found), tmp_path / "corr.png")


def test_uncertainty_over_a_plane(dmu50: Machine, found: Identification, tmp_path: Path) -> None:
    over = ToolUncertainty(Kinematics(dmu50, found.calibration, tool_length_mm=120.0)).on_grid((5, 3, 4))
    figure = plot_uncertainty(over, "X", "Z")
    assert (figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()) == ("X [mm]", "Z [mm]")
    assert figure.axes[0].get_title(loc="left").startswith("Y 225, B 0, C 0")
    shown = figure.axes[0].collections[0].zmax  # type: ignore[attr-defined]
    plane = over.positions[:, 1] == 225.0
    assert shown == pytest.approx(over.uncertainty.expanded_um[plane].max())
    renders(figure, tmp_path / "u.png")
    with pytest.raises(InputError, match="not a plane of this map"):
        plot_uncertainty(over, "X", "B")
