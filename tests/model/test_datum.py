"""The datum of a calibration: conversions of the numbers, and the datum entry of files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import twin
from tests.model.errors import random_calibration
from tests.truth.few_axes import write_drill, write_robot
from tests.truth.machine import TruthMachine
from twin.cli.commands import app
from twin.machine.machine import Machine
from twin.model.datum import END_POINTS, MEAN_LINES, Datum
from twin.model.effects.entries import effect_named
from twin.model.motion_curve import Curve
from twin.numerics.covariance import Covariance
from twin.samples import dmu50_calibration
from twin.tool.forward import Kinematics

NM, NRAD = 1e-6, 1e-9
"""Largest difference of two descriptions of one machine at the tool: mm and radians. Achieved: 0.03 nm, 0.03 nrad."""
STATEMENTS = (MEAN_LINES, END_POINTS)


def tools(calibration: twin.Calibration, seed: int = 0) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return points and rotations of the tool over the whole range of a machine, for two tool lengths."""
    machine = calibration.machine
    ranges = np.array([axis.domain for axis in machine.axes])
    q = np.random.default_rng(seed).uniform(ranges[:, 0], ranges[:, 1], (200, len(ranges)))
    found = []
    for length in (0.0, 250.0):
        poses = Kinematics(machine, calibration, tool_length_mm=length).forward(q)
        found.append((poses.point_mm, poses.rotation))
    return found


def assert_same_tool(one: twin.Calibration, two: twin.Calibration, scale: float = 1.0) -> None:
    for (point, rotation), (other, turned) in zip(tools(one), tools(two), strict=True):
        assert np.abs(point - other).max() <= NM * scale
        assert np.abs(np.einsum("nij,nkj->nik", rotation, turned) - np.eye(3)).max() <= NRAD * scale


def line_of(curve: Curve) -> tuple[float, float]:
    """Return mean and least-squares slope over half the range of a curve, by code independent of the conversion."""
    u = np.linspace(-1.0, 1.0, 20001)
    values = curve(np.linspace(*curve.domain, len(u)))
    return float(np.trapezoid(values, u)) / 2.0, 1.5 * float(np.trapezoid(values * u, u))


def linear_machine(folder: Path) -> Machine:
    """Return a machine with three linear axes on the tool side: no rotary axis absorbs a common rotation or the zeros of the scales."""
    source = Machine.load("dmu50").path
    text = source.read_text().replace("calibration: dmu50.calibration.yaml\n", "")
    head, _, rest = text.partition("axes:\n")
    kept = [line for line in rest.splitlines() if not line.strip().startswith(("- {name: B", "- {name: C"))]
    (folder / "dmu50.urdf").write_text((source.parent / "dmu50.urdf").read_text())
    path = folder / "three.yaml"
    path.write_text(head.replace("DMU 50 eVolution", "three") + "axes:\n" + "\n".join(kept) + "\n")
    return Machine.load(path)


@settings(max_examples=6)
@given(seed=st.integers(0, 2**32 - 1), name=st.sampled_from(["dmu50", "trunnion_ac", "xyzbc_trunnion"]))
@pytest.mark.parametrize("datum", STATEMENTS)
def test_five_axes_keep_their_tool(datum: Datum, seed: int, name: str) -> None:
    given_ = random_calibration(Machine.load(name), np.random.default_rng(seed), 100.0)
    found = given_.in_datum(datum)
    assert found.datum == datum
    assert_same_tool(given_, found)
    last = given_.machine.by_name["Z"]
    for curve in found.curves.values():
        axis = given_.machine.by_name[curve.name[3:]]
        if not axis.linear or (curve.name[2] in "ABC" and axis is last):
            continue
        if datum == END_POINTS and curve.name[2] in "XYZ" and curve.name[2] != axis.name:
            assert np.abs(curve(np.array(curve.domain))).max() < 1e-4, curve.name
            continue
        height, slope = line_of(curve)
        assert abs(height) < 1e-4, curve.name
        assert curve.name[2] in "ABC" or curve.name[2] == axis.name or abs(slope) < 1e-3, curve.name


@pytest.mark.parametrize("datum", STATEMENTS)
def test_three_linear_axes(datum: Datum, tmp_path: Path) -> None:
    machine = linear_machine(tmp_path)
    assert machine.names == ("X", "Y", "Z") and machine.location_names == ()
    given_ = random_calibration(machine, np.random.default_rng(4), 100.0)
    found = given_.in_datum(datum)
    assert found.datum == datum
    assert_same_tool(given_, found)
    # The direction of the frame remains as a common rotation of all lines and is not in a squareness.
    if datum == MEAN_LINES:
        slopes = {
            name: line_of(found.curves[name])[1] / (np.ptp(found.curves[name].domain) / 2e3)
            for name in ("E_YX", "E_XY", "E_ZX", "E_XZ", "E_ZY", "E_YZ")
        }
        assert abs(slopes["E_YX"]) > 1.0
        for one, other in (("E_YX", "E_XY"), ("E_ZX", "E_XZ"), ("E_ZY", "E_YZ")):
            assert slopes[one] == pytest.approx(-slopes[other], abs=0.05)


def test_one_axis_two_axes_and_a_robot(tmp_path: Path) -> None:
    for folder in ("drill", "robot"):
        (tmp_path / folder).mkdir()
    for path in (write_drill(tmp_path / "drill"), write_robot(tmp_path / "robot", reach_deg=170.0)):
        machine = Machine.load(path)
        given_ = random_calibration(machine, np.random.default_rng(5), 100.0)
        found = given_.in_datum(MEAN_LINES)
        assert found.datum == MEAN_LINES
        assert_same_tool(given_, found)
    one = Machine.load(write_robot(tmp_path / "robot", joints=1))
    given_ = random_calibration(one, np.random.default_rng(6), 100.0)
    assert_same_tool(given_, given_.in_datum(MEAN_LINES))


def test_every_basis_and_a_curve_over_part_of_the_range(dmu50: Machine) -> None:
    drawn = random_calibration(dmu50, np.random.default_rng(7), 100.0)
    curves = dict(drawn.curves)
    for name in ("E_XX", "E_CX", "E_YB", "E_AB"):
        curves[name] = curves[name].written("bernstein", 6)
    curves["E_XB"] = Curve("E_XB", "um", (0.0, 180.0), "fourier", (3.0, 4.0, 5.0))
    del curves["E_BY"], curves["E_CB"]
    given_ = replace(drawn, curves=MappingProxyType(curves))
    found = given_.in_datum(MEAN_LINES)
    assert found.curves["E_XX"].basis == "bernstein" and found.curves["E_XB"].basis == "fourier"
    assert_same_tool(given_, found)
    shorter = replace(curves["E_YY"], domain=(50.0, 400.0))
    part = replace(drawn, curves=MappingProxyType({**curves, "E_YY": shorter}))
    found = part.in_datum(MEAN_LINES)
    q = np.array([[100.0, y, -200.0, 60.0, 20.0] for y in (50.0, 225.0, 400.0)])
    one, two = (Kinematics(dmu50, side).forward(q) for side in (part, found))
    assert np.abs(one.point_mm - two.point_mm).max() <= NM


def test_effects_keep_their_numbers(dmu50: Machine) -> None:
    """The pose changes only by the product of the effect and the transferred angle: 20 µm times some 100 µrad, 2 nm."""
    extra = (
        effect_named("pitch_error", "X", {"amplitude": 20.0, "period": 10.0, "phase": 0.3}, dmu50),
        effect_named("zero_offset", "Y", {"offset": 20.0}, dmu50),
    )
    given_ = replace(random_calibration(dmu50, np.random.default_rng(8), 100.0), extra=extra)
    found = given_.in_datum(MEAN_LINES)
    assert found.extra == extra
    assert_same_tool(given_, found, scale=8.0)


def test_there_and_back(dmu50: Machine) -> None:
    first = random_calibration(dmu50, np.random.default_rng(9), 100.0).in_datum(MEAN_LINES)
    assert first.in_datum(MEAN_LINES) is first
    back = first.in_datum(END_POINTS).in_datum(MEAN_LINES)
    for name, curve in first.curves.items():
        q = np.linspace(*curve.domain, 101)
        assert np.abs(back.curves[name](q) - curve(q)).max() < 1e-3, name
    assert dict(back.squareness) == pytest.approx(dict(first.squareness), abs=1e-3)
    assert dict(back.location) == pytest.approx(dict(first.location), abs=1e-3)


def with_covariance(found: twin.Calibration, seed: int) -> twin.Calibration:
    names = tuple(number.name for effect in found.effects for number in effect.parameters)
    root = np.random.default_rng(seed).normal(size=(len(names), len(names)))
    return replace(found, joint=Covariance(names, root @ root.T / len(names)))


def shifted(calibration: twin.Calibration, off: Mapping[str, float]) -> twin.Calibration:
    """Return the calibration with every parameter changed."""
    curves = {
        name: replace(c, coefficients=tuple(v + off[f"{name}[{k}]"] for k, v in enumerate(c.coefficients)))
        for name, c in calibration.curves.items()
    }
    constants = [
        MappingProxyType({name: value + off[name] for name, value in group.items()})
        for group in (calibration.squareness, calibration.location)
    ]
    return twin.Calibration(calibration.machine, "moved", MappingProxyType(curves), *constants)


def parameters(calibration: twin.Calibration) -> dict[str, float]:
    return {number.name: float(number.value) for effect in calibration.effects for number in effect.parameters}


@pytest.mark.parametrize("datum", STATEMENTS)
@pytest.mark.parametrize("name", ["dmu50", "xyzbc_trunnion"])
def test_covariance_follows_the_exact_conversion(name: str, datum: Datum) -> None:
    """A covariance of one direction d becomes that of the difference quotient of the exact conversion along d."""
    drawn = random_calibration(Machine.load(name), np.random.default_rng(10), 30.0)
    names = tuple(parameters(drawn))
    for seed in range(3):
        d = np.random.default_rng(seed).normal(size=len(names))
        step = dict(zip(names, d, strict=True))
        found = replace(drawn, joint=Covariance(names, np.outer(d, d))).in_datum(datum).joint
        assert found is not None
        up, down = (
            parameters(shifted(drawn, {k: sign * v for k, v in step.items()}).in_datum(datum)) for sign in (1.0, -1.0)
        )
        common = [one for one in found.names if one in up and one in down]
        assert len(common) > 0.9 * len(found.names) and set(drawn.squareness) | set(drawn.location) <= set(common)
        rate = np.array([(up[one] - down[one]) / 2.0 for one in common])
        # Curves and angles of 30 µm and µrad: products of two make 1e-3 µm; coefficients of high powers are ten times the curve.
        assert np.abs(found.of(common).matrix - np.outer(rate, rate)).max() <= 1e-3 * np.abs(rate).max() ** 2
        # And it differs from before: squareness and locations absorb amounts of the curves.
        rate_of = dict(zip(common, rate, strict=True))
        assert max(abs(rate_of[one] - step[one]) for one in (*drawn.squareness, *drawn.location)) > 0.5


def test_a_curve_at_the_tool_keeps_its_uncertainty(dmu50: Machine) -> None:
    """The covariance of the tool point does not depend on the datum."""
    given_ = with_covariance(random_calibration(dmu50, np.random.default_rng(13), 30.0), 14)
    q = np.array([[120.0, 300.0, -80.0, 40.0, 200.0], [450.0, 30.0, -350.0, 110.0, 10.0]])
    one, two = (
        twin.ToolUncertainty(Kinematics(dmu50, side)).at(q).covariance for side in (given_, given_.in_datum(MEAN_LINES))
    )
    assert np.abs(one - two).max() < 1e-3 * np.abs(one).max()


def test_files_state_their_datum(dmu50: Machine, tmp_path: Path) -> None:
    drawn, path = dmu50_calibration.as_drawn(dmu50), tmp_path / "c.yaml"
    drawn.save(path)
    assert "\ndatum: as given\n" in path.read_text() and twin.Calibration.load(path, dmu50).datum == "as given"
    drawn.in_datum(END_POINTS).save(path)
    assert "\ndatum: end points\n" in path.read_text() and twin.Calibration.load(path, dmu50).datum == END_POINTS
    drawn.in_datum(MEAN_LINES).save(path)
    text = path.read_text()
    assert "\ndatum: mean lines\n" in text
    # Without the entry it is computed.
    path.write_text(text.replace("datum: mean lines\n", ""))
    assert twin.Calibration.load(path, dmu50).datum == MEAN_LINES
    # And coefficients rounded by hand are no contradiction.
    path.write_text(text)
    data = twin.Calibration.load(path, dmu50)
    rounded = {n: replace(c, coefficients=tuple(round(v, 4) for v in c.coefficients)) for n, c in data.curves.items()}
    replace(data, curves=MappingProxyType(rounded)).save(path)
    assert "\ndatum: mean lines\n" in path.read_text()


def test_a_wrong_statement_is_refused(dmu50: Machine, tmp_path: Path) -> None:
    path = tmp_path / "c.yaml"
    dmu50_calibration.as_drawn(dmu50).save(path)
    path.write_text(path.read_text().replace("datum: as given", "datum: mean lines"))
    with pytest.raises(twin.InputError) as caught:
        twin.Calibration.load(path, dmu50)
    text = str(caught.value)
    assert f"{path}:" in text and "E_AX has a mean" in text and "-156.7 µrad" in text and "twin info" in text
    path.write_text(path.read_text().replace("datum: mean lines", "datum: mean line"))
    with pytest.raises(twin.InputError, match="no such datum"):
        twin.Calibration.load(path, dmu50)


def test_the_bundled_calibration_equals_its_source(dmu50: Machine, calibration: twin.Calibration) -> None:
    assert_same_tool(dmu50_calibration.as_drawn(dmu50), calibration)
    assert calibration.datum == MEAN_LINES


def test_the_bundled_calibration_by_independent_code(dmu50: Machine, tmp_path: Path) -> None:
    """Poses of both files agree in `TruthMachine` too, which shares no code with `twin`."""
    dmu50_calibration.as_drawn(dmu50).save(tmp_path / "old.yaml")
    one, two = (
        TruthMachine(tmp_path / "old.yaml", 120.0),
        TruthMachine(dmu50.path.parent / "dmu50.calibration.yaml", 120.0),
    )
    rng = np.random.default_rng(1)
    for q in rng.uniform([0, 0, -400, 0, 0], [500, 450, 0, 180, 360], (50, 5)):
        assert np.abs(one.pose(q)[:3, 3] - two.pose(q)[:3, 3]).max() <= NM
        assert np.abs(one.pose(q)[:3, :3] - two.pose(q)[:3, :3]).max() <= NRAD


@pytest.mark.slow
def test_readme_commands_find_no_spurious_change(
    dmu50: Machine, calibration: twin.Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """README's commands: identify finds the numbers of the bundled machine; compare with the source file finds no change of them."""
    monkeypatch.chdir(tmp_path)
    run = CliRunner().invoke(app, ["simulate", "thesis_plan.csv", "-o", "m.csv", "--seed", "7"])
    assert run.exit_code == 0, run.output
    run = CliRunner().invoke(app, ["identify", "m.csv", "-o", "mine.yaml"])
    assert "datum mean lines" in run.output
    assert "\ndatum: mean lines\n" in (tmp_path / "mine.yaml").read_text()
    mine = twin.Calibration.load("mine.yaml", dmu50)
    found, own = ({**one.squareness, **one.location} for one in (mine, calibration))
    assert mine.joint is not None
    for name, value in found.items():
        u = float(np.sqrt(mine.joint.of([name]).matrix[0, 0]))
        # Eight numbers: the largest of eight normal deviates is below 3.3 in 99 of 100 cases.
        assert abs(value - own[name]) <= (1.96 if name in ("E_C0Y", "E_A0B") else 3.3) * u, name
    dmu50_calibration.as_drawn(dmu50).save("drawn.yaml")
    # The two conventions differ by 106 µrad, several times the uncertainty of the identified value.
    assert twin.Calibration.load("drawn.yaml", dmu50).squareness["E_C0Y"] - found["E_C0Y"] > 80.0
    run = CliRunner().invoke(app, ["compare", "drawn.yaml", "mine.yaml", "--json", "r.json"])
    assert "both converted to mean lines: drawn.yaml from as given" in run.output
    errors = {error["error"]: error for error in json.loads((tmp_path / "r.json").read_text())["errors"]}
    for name in ("E_C0Y", "E_A0B"):
        assert abs(errors[name]["largest"]) <= 1.96 * float(np.sqrt(mine.joint.of([name]).matrix[0, 0])), name


def test_info_converts_and_reports_the_datum(dmu50: Machine, tmp_path: Path) -> None:
    drawn, lines, report = tmp_path / "drawn.yaml", tmp_path / "lines.yaml", tmp_path / "r.json"
    dmu50_calibration.as_drawn(dmu50).save(drawn)
    run = CliRunner().invoke(app, ["info", "-c", str(drawn)])
    assert "datum         as given" in run.output and "twin doc datum" in run.output
    words = ["info", "-c", str(drawn), "--datum", "mean lines", "-o", str(lines), "--json", str(report)]
    run = CliRunner().invoke(app, words)
    assert run.exit_code == 0 and "datum         mean lines, converted from as given" in run.output
    assert json.loads(report.read_text())["datum"] == {"given": "as given", "shown": "mean lines"}
    written = twin.Calibration.load(lines, dmu50)
    assert written.datum == MEAN_LINES and "Datum changed to mean lines." in written.source
    assert_same_tool(twin.Calibration.load(drawn, dmu50), written)
    run = CliRunner().invoke(app, ["info", "-c", str(drawn), "-o", str(lines)])
    assert isinstance(run.exception, twin.InputError) and "--output needs --datum" in str(run.exception)


def test_only_errors_named_in_the_files_change(dmu50: Machine) -> None:
    """Two calibrations of X alone with a constant: no other error in them can absorb it, so it stays in the curve."""

    def of(constant: float) -> twin.Calibration:
        curve = Curve("E_XX", "um", (0.0, 500.0), "power", (constant, 5.0, 1.0), np.diag([0.1, 0.2, 0.3]))
        empty: MappingProxyType[str, float] = MappingProxyType({})
        return twin.Calibration(dmu50, "by hand", MappingProxyType({"E_XX": curve}), empty, empty)

    found = twin.compare(of(0.0), of(10.0), poses=20)
    (error,) = found.errors
    assert error.name == "E_XX" and error.largest == pytest.approx(10.0, rel=1e-6) and error.significant
