"""Tests of the plots of a plan: values, units, and rendering without a screen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.planning import kits
from tests.truth.reference import D, about, translation
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.display.figures import save
from twin.identification import identify
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.model.calibration import Calibration
from twin.planning import judge, plan
from twin.planning.plots import plot_places, plot_uncertainties
from twin.samples import thesis_plan


def drawn(figure: Figure, panel: int, label: str) -> np.ndarray:
    (line,) = [line for line in figure.axes[panel].lines if line.get_label() == label]
    return np.array([line.get_xdata(), line.get_ydata()], dtype=float).T


def renders(figure: Figure, path: Path) -> None:
    save(figure, path, dpi=50)
    assert path.read_bytes().startswith(b"\x89PNG")


def test_places(dmu50: Machine, tmp_path: Path) -> None:
    """Compare reflectors and station with the kinematic chains written out here."""
    whole = thesis_plan.plan(dmu50)
    first = whole.select(whole.round == "1")
    figure = plot_places(first, dmu50)
    assert [plot.get_xlabel() for plot in figure.axes] == ["x [mm]"] * 2
    assert [plot.get_ylabel() for plot in figure.axes] == ["y [mm]", "z [mm]"]
    tool, work = first.carrier == "tool", first.carrier == "work"
    at = first.place_mm[tool] + first.positions[tool, :3] + [-250.0, -225.0, 400.0]
    shown = np.column_stack(
        [drawn(figure, 0, "reflectors on the tool side"), drawn(figure, 1, "reflectors on the tool side")[:, 1]]
    )
    assert shown == pytest.approx(at, abs=1e-6)
    turned = []
    for place, (b, c) in zip(first.place_mm[work], np.radians(first.positions[work, 3:]), strict=True):
        chain = translation(0, 0, D) @ about(0, np.pi / 4) @ about(2, b) @ about(0, -np.pi / 4)
        turned.append((chain @ translation(0, 0, -D) @ about(2, -c) @ np.append(place, 1.0))[:2])
    assert drawn(figure, 0, "reflectors on the work side") == pytest.approx(np.array(turned), abs=1e-6)
    assert any(text.get_text() == f"1: {len(first)} readings" for text in figure.axes[0].texts)
    renders(figure, tmp_path / "places.png")
    nowhere = replace(first, station_pose=read_only(np.full((len(first), 6), np.nan)))
    with pytest.raises(InputError, match="positions of stations or targets are missing"):
        plot_places(nowhere, dmu50)


def test_uncertainties(tmp_path: Path) -> None:
    machine, own = kits.slides(tmp_path)
    made = plan(machine, own, minutes=100.0)
    assert made.forecast is not None
    half = judge(made.table.select(np.arange(0, len(made.table), 2)), machine)
    zero = Calibration.zero(machine)
    data, _ = simulate(made.table, machine, zero, LaserTracker(), np.random.default_rng(1), setting=own.setting)
    found = identify(data, machine)
    figure = plot_uncertainties({"half": half, "whole": made.forecast}, {"whole": found})
    assert [plot.get_ylabel() for plot in figure.axes] == ["standard uncertainty [µm]", "standard uncertainty [µrad]"]
    for panel, letters in ((0, "XYZ"), (1, "ABC")):
        names = [text.get_text() for text in figure.axes[panel].get_xticklabels()]
        assert all(name[2] in letters for name in names) and len({*names}) == len(names)
        values = drawn(figure, panel, "whole: predicted")
        assert {names[int(x)]: y for x, y in values} == {name: made.forecast.errors[name] for name in names}
        stated = drawn(figure, panel, "whole: identified")
        rows = {row["name"]: row.get("u_max", row.get("u")) for row in found.rows()}
        assert {names[int(x)]: y for x, y in stated} == {name: rows[name] for name in names if name in rows}
        assert not [line for line in figure.axes[panel].lines if line.get_label() == "half: identified"]
    renders(figure, tmp_path / "u.png")
    with pytest.raises(InputError, match="number of plans"):
        plot_uncertainties({})
