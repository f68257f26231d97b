"""The kinematics module for LinuxCNC: what its functions do, and what is refused; `tests/linuxcnc` lets the control execute it."""

from __future__ import annotations

import ctypes
import json
import re
import shutil
import subprocess
import types
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.cli.commands import TWIN
from tests.linuxcnc.machines import KINDS
from tests.model.errors import random_calibration
from tests.truth import few_axes
from twin._common.errors import InputError
from twin._common.provenance import CORRECTED_IN_CONTROL
from twin.cli.identify import tables_on
from twin.compensation.live import earlier_of, make_module, write_module
from twin.compensation.live.folder import Proof
from twin.compensation.live.module import Damping, LiveCorrection, channel_of, channels_of
from twin.model.calibration_file import ColumnEntry, UnidentifiedEntry, empirical_named
from twin.monitoring.record import ControlRecord
from twin.numerics.covariance import Covariance

TOOL_MM = 120.0
MACHINES = ("dmu50", "trunnion_ac", "xyzbc_trunnion")


def with_errors(name: str, size: float = 60.0) -> twin.Calibration:
    """Return a calibration with constant errors of a size, and curves where the machine has them."""
    machine, rng = twin.Machine.load(name), np.random.default_rng(3)
    draw = lambda names: {one: float(rng.normal(0.0, size)) for one in names}  # noqa: E731
    errors = twin.Calibration.default(machine)
    return replace(errors, squareness=draw(machine.squareness_names), location=draw(machine.location_names))


@pytest.fixture(scope="module", params=MACHINES)
def errors(request: pytest.FixtureRequest) -> twin.Calibration:
    return with_errors(request.param)


def poses(machine: twin.Machine, count: int = 300) -> np.ndarray:
    """Return positions inside the ranges, away from their ends by more than any correction: metres and radians."""
    low, high = np.array([axis.domain for axis in machine.axes]).T
    share = np.random.default_rng(1).uniform(0.02, 0.98, (count, len(machine.axes)))
    return (low + share * (high - low)) * machine.scale


def test_the_machine_with_errors_goes_where_the_program_means(errors: twin.Calibration) -> None:
    machine = errors.machine
    made = make_module(errors, tool_length_mm=TOOL_MM)
    n = poses(machine)
    tool = np.array([0.0, 0.0, 1e-3 * TOOL_MM])
    check_proof(errors, made.proof)
    still = np.zeros(len(machine.axes))
    c = np.array([made.live.correction(row, still, tool, 1.0) for row in n]).reshape(n.shape)
    real, nominal = (
        twin.Kinematics(machine, one, tool_length_mm=TOOL_MM) for one in (errors, twin.Calibration.zero(machine))
    )
    (turn, goal), (after, reached), (before, plain) = nominal.reached(n), real.reached(n + c), real.reached(n)
    assert np.linalg.norm(plain - goal, axis=1).max() > 50e-6
    assert np.linalg.norm(reached - goal, axis=1).max() < 0.05e-6
    sigma = np.array([float(made.live.slopes(row, still, tool)[0]) for row in n])
    whole = sigma > made.live.damping.region
    assert 0.3 < whole.mean() < 1.0
    tilt = np.linalg.norm((after - turn)[:, 6:], axis=1)
    assert tilt[whole].max() < 1e-8 < 1e-4 < np.linalg.norm((before - turn)[:, 6:], axis=1).max()
    assert np.all(tilt <= 1.01 * np.linalg.norm((before - turn)[:, 6:], axis=1) + 1e-9)


def check_proof(errors: twin.Calibration, proof: Proof) -> None:
    """The figures of README.txt: those of other poses without the module, and what it leaves, the orientation near singular poses."""
    q = poses(errors.machine, 2000) / errors.machine.scale
    real, nominal = (
        twin.Kinematics(errors.machine, one, tool_length_mm=TOOL_MM).forward(q)
        for one in (errors, twin.Calibration.zero(errors.machine))
    )
    off = 1e3 * np.linalg.norm(real.point_mm - nominal.point_mm, axis=1)
    tilt = 1e6 * np.linalg.norm(real.axis - nominal.axis, axis=1)
    for (rms, largest), values in ((proof.point_before_um, off), (proof.tilt_before_urad, tilt)):
        assert rms == pytest.approx(np.sqrt(np.mean(values**2)), rel=0.1)
        assert largest == pytest.approx(values.max(), rel=0.3)
    assert proof.point_after_um[1] < 0.05 < 10.0 < proof.point_before_um[0]
    assert proof.tilt_after_urad[0] < 0.3 * proof.tilt_before_urad[0]


def test_without_orientation_the_rotary_axes_stay(errors: twin.Calibration) -> None:
    machine, live = errors.machine, make_module(errors, tool_length_mm=TOOL_MM).live
    n, tool = poses(machine, 5), np.array([0.0, 0.0, 1e-3 * TOOL_MM])
    real, nominal = (
        twin.Kinematics(machine, one, tool_length_mm=TOOL_MM) for one in (errors, twin.Calibration.zero(machine))
    )
    for row in n:
        c = np.array(live.correction(row, np.zeros(len(row)), tool, 0.0)).ravel()
        assert np.all(c[list(machine.rotary)] == 0.0)
        assert np.linalg.norm(real.reached((row + c)[None])[1] - nominal.reached(row[None])[1]) < 0.05e-6


def test_the_correction_can_be_undone_everywhere(errors: twin.Calibration) -> None:
    """The slope is below one half, also at a singular position and beyond the ranges: n → n + c(n) is invertible."""
    machine, live = errors.machine, make_module(errors, tool_length_mm=TOOL_MM).live
    tool, still = np.array([0.0, 0.0, 1e-3 * TOOL_MM]), np.zeros(len(machine.axes))
    n = poses(machine, 200)
    first = machine.rotary[0]
    n[:100, first] = np.random.default_rng(5).uniform(-0.1, 0.1, 100)
    n[100:110] *= 2.0
    for row in n:
        slope = np.array(live.slopes(row, still, tool)[1])
        assert np.all(np.isfinite(slope)) and np.linalg.norm(slope, 2) < 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_finite_and_can_be_undone_for_every_kind(kind: str, tmp_path: Path) -> None:
    """All curves and constants of other kinds of machines: at singular positions, at the ends of the ranges and far beyond."""
    machine = KINDS[kind]().machine(tmp_path)
    live = make_module(random_calibration(machine, np.random.default_rng(7), 100.0), tool_length_mm=TOOL_MM).live
    tool, rng = np.array([0.003, -0.002, 0.12]), np.random.default_rng(9)
    n = poses(machine, 60)
    low, high = np.array([axis.domain for axis in machine.axes]).T * machine.scale
    for first in machine.rotary[:1]:
        n[:20, first] = np.concatenate([[0.0, 1e-300, -1e-12], rng.uniform(-0.02, 0.02, 17)])
    n[20:40] = np.where(rng.random((20, len(low))) < 0.5, low, high)
    n[40:50] *= 10.0
    for row in n:
        states = np.append(rng.choice([-1.0, 0.0, 1.0], len(low)), np.zeros(live.channel_count - len(low)))
        for share in (0.0, 0.5, 1.0):
            assert np.all(np.isfinite(np.array(live.correction(row, states, tool, share))))
        slope = np.array(live.slopes(row, states, tool)[1])
        assert np.all(np.isfinite(slope)) and np.linalg.norm(slope, 2) < 0.9


@pytest.mark.parametrize("name", MACHINES)
def test_coordinates_of_the_workpiece_and_axes_are_inverse(name: str) -> None:
    machine = twin.Machine.load(name)
    live = LiveCorrection(twin.Calibration.zero(machine), (), Damping.for_tilt(0.0))
    tool, linear = np.array([0.01, -0.02, 0.12]), list(machine.linear)
    nominal = twin.Kinematics(machine, twin.Calibration.zero(machine), tool_length_mm=120.0)
    for row in poses(machine, 10):
        words = row.copy()
        words[linear] = np.array(live.to_workpiece(row, tool)).ravel()
        assert np.allclose(np.array(live.to_axes(words, tool)).ravel(), row[linear], atol=1e-14)
        at_rest = np.where(np.isin(np.arange(len(row)), linear), row, 0.0)
        assert np.allclose(np.array(live.to_workpiece(at_rest, tool)).ravel(), row[linear] - tool, atol=1e-14)
        # A point of the workpiece: the distance of two tips on the table is that of their coordinates.
        other = row.copy()
        other[linear] += [0.03, -0.02, 0.01]
        ends = [np.array(live.to_workpiece(one, np.array([0, 0, 0.12]))).ravel() for one in (row, other)]
        tips = nominal.reached(np.array([row, other]))[1]
        assert np.linalg.norm(ends[1] - ends[0]) == pytest.approx(np.linalg.norm(tips[1] - tips[0]), abs=1e-14)


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_the_c_file_computes_what_the_graph_does(errors: twin.Calibration, tmp_path: Path) -> None:
    made = make_module(errors, tool_length_mm=TOOL_MM)
    text = made.text.partition("/* --- What follows")[0]
    (tmp_path / "functions.c").write_text(text)
    command = ["cc", "-O1", "-w", "-shared", "-fPIC", "functions.c", "-o", "functions.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "functions.so"))
    numbers = ctypes.POINTER(ctypes.c_double)
    n = poses(errors.machine, 20)
    still, tool, one = np.zeros(n.shape[1]), np.array([0.0, 0.0, 0.12]), np.ones(1)
    for row in n:
        found = np.zeros(n.shape[1])
        arguments = (numbers * 4)(*(value.ctypes.data_as(numbers) for value in (row.copy(), still, tool, one)))
        assert library.twin_correction(arguments, (numbers * 1)(found.ctypes.data_as(numbers)), None, None, None) == 0
        expected = np.array(made.live.correction(row, still, tool, 1.0)).ravel()
        assert np.allclose(found, expected, rtol=0.0, atol=1e-13)


def test_the_folder_knows_what_the_control_corrects(tmp_path: Path) -> None:
    errors = with_errors("dmu50")
    errors.save(tmp_path / "mine.yaml")
    words = [*TWIN, "control", "--to", "linuxcnc-kinematics", "-o", "live", "-c", "mine.yaml", "--json", "a.json"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    account = json.loads((tmp_path / "a.json").read_text())
    assert account["point_after_um"][1] < 0.1 < 50.0 < account["point_before_um"][0]
    assert (tmp_path / "live" / "README.txt").read_text() in done.stdout
    written = twin.Calibration.load(tmp_path / "live" / "calibration.yaml", errors.machine)
    corrected = twin.Calibration.load(tmp_path / "live" / "corrected.yaml", errors.machine)
    assert corrected.location == pytest.approx(dict(errors.location)) and corrected.control is None
    assert written.control is not None and written.control.errors_are == "uncorrected"
    assert CORRECTED_IN_CONTROL in written.warnings and CORRECTED_IN_CONTROL not in corrected.warnings
    for use in (
        lambda: make_module(written),
        lambda: earlier_of(written, add=True),
        lambda: twin.compensate("cone_frustum.nc", errors.machine, written),
    ):
        with pytest.raises(InputError, match="would be corrected twice"):
            use()
    assert twin.compensate("cone_frustum.nc", errors.machine, corrected).report.complete


def test_errors_measured_with_the_module_are_added_to_its_own(tmp_path: Path) -> None:
    errors, rest = with_errors("dmu50"), with_errors("dmu50", 7.0)
    write_module(make_module(errors), tmp_path / "first")
    section = twin.Calibration.load(tmp_path / "first" / "calibration.yaml", errors.machine).control
    active = tables_on([f"linuxcnc-kinematics={tmp_path / 'first' / 'calibration.yaml'}"], errors.machine)
    assert active == replace(section, errors_are="remaining")
    for wrong in (["corrected.yaml"], ["calibration.yaml", "calibration.yaml"]):
        with pytest.raises(InputError, match="kinematics module"):
            tables_on([f"linuxcnc-kinematics={tmp_path / 'first' / name}" for name in wrong], errors.machine)
    # A tracker sees the corrections of the linear axes: only the tool relative to the workpiece shows what remains.
    readings = "".join(f"{x},0,0,0,0,K,tool,{x},{y},3\n" for x, y in ((0, 2), (90, 2), (200, 7), (300, 2), (400, 9)))
    (tmp_path / "m.csv").write_text(f"X_mm,Y_mm,Z_mm,B_deg,C_deg,target,carrier,x_mm,y_mm,z_mm\n{readings}")
    on = ["--control", "linuxcnc-kinematics=first/calibration.yaml"]
    words = [*TWIN, "identify", "m.csv", "-o", "no.yaml", *on]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "m.csv:2: a reading from the base" in done.stderr
    assert not (tmp_path / "no.yaml").exists()
    remaining = rest.with_control(active)
    with pytest.raises(InputError, match="a new module must hold the old ones as well"):
        earlier_of(remaining, add=False)
    with pytest.raises(InputError, match="nothing to add them to"):
        earlier_of(rest, add=True)
    earlier = earlier_of(remaining, add=True)
    made = make_module(remaining, earlier=earlier, tool_length_mm=TOOL_MM)
    both = made.live
    write_module(made, tmp_path / "second")
    again = twin.Calibration.load(tmp_path / "second" / "calibration.yaml", errors.machine)
    (entry,) = again.control.live
    assert entry.file == tmp_path / "second" / "corrected.yaml", "the folder needs no other"
    locations = {name: value + rest.location[name] for name, value in errors.location.items()}
    angles = {name: value + rest.squareness[name] for name, value in errors.squareness.items()}
    curves = {
        name: replace(curve, coefficients=tuple(2.0 * value for value in curve.coefficients))
        for name, curve in errors.curves.items()
    }
    alone = make_module(
        replace(errors, curves=curves, location=locations, squareness=angles), tool_length_mm=TOOL_MM
    ).live
    row, tool = poses(errors.machine, 1)[0], np.array([0.0, 0.0, 0.12])
    found, expected = (np.array(one.correction(row, np.zeros(5), tool, 1.0)).ravel() for one in (both, alone))
    assert np.allclose(found, expected, rtol=1e-9)
    # With the module off, these are the errors of the machine.
    for held in (again, twin.Calibration.load(entry.file, errors.machine)):
        assert (held.location, held.squareness) == (pytest.approx(locations), pytest.approx(angles))
        assert held.curves["E_XX"](200.0) == pytest.approx(2.0 * errors.curves["E_XX"](200.0))


def test_the_sum_of_two_measurements_is_as_certain_as_the_last(tmp_path: Path) -> None:
    """The second uncertainty counts where both measured an error; what no measurement determined stays unknown."""
    machine = twin.Machine.load("dmu50")

    def measured(values: dict[str, float], u_um: dict[str, float], *unknown: str) -> twin.Calibration:
        covariance = Covariance(tuple(u_um), np.diag([one**2 for one in u_um.values()]))
        why = tuple(UnidentifiedEntry(name=name, why="a reason") for name in unknown)
        return replace(twin.Calibration.zero(machine), location=values, joint=covariance, not_identifiable=why)

    first = measured({"E_X0C": 40.0, "E_Y0C": 9.0}, {"E_X0C": 3.0, "E_Y0C": 2.0}, "E_X0B", "E_Y0B", "E_A0B")
    second = measured(
        {"E_X0C": -15.0, "E_X0B": 7.0, "E_A0B": 0.0}, {"E_X0C": 1.0, "E_X0B": 0.5, "E_A0B": 50.0}, "E_Y0C", "E_A0B"
    )
    made = make_module(second, earlier=[first], force=True)
    whole = made.whole
    assert whole.location == {"E_X0C": 25.0, "E_Y0C": 9.0, "E_X0B": 7.0, "E_A0B": 0.0}
    sizes = dict(zip(whole.covariance.names, np.sqrt(np.diag(whole.covariance.matrix)), strict=True))
    assert sizes == pytest.approx({"E_X0C": 1.0, "E_Y0C": 2.0, "E_X0B": 0.5, "E_A0B": 50.0})
    assert sorted(error.name for error in whole.not_identifiable) == ["E_A0B", "E_Y0B"]
    with pytest.raises(InputError, match="E_Y0B, E_A0B were not identified"):
        make_module(second, earlier=[first])
    write_module(made, tmp_path)
    assert dict(twin.Calibration.load(tmp_path / "corrected.yaml", machine).location) == whole.location


@pytest.mark.parametrize(("u_um", "is_proven"), [(5.0, True), (5.2, False)])
def test_errors_smaller_than_their_uncertainty_are_no_reason_for_a_module(u_um: float, is_proven: bool) -> None:
    """A location shifts the tool by 10 µm everywhere; U (95 %) of one direction is 1.96 u."""
    machine = twin.Machine.load("dmu50")
    covariance = Covariance(("E_X0C",), np.array([[u_um**2]]))
    errors = replace(twin.Calibration.zero(machine), location={"E_X0C": 10.0}, joint=covariance)
    if is_proven:
        made = make_module(errors, tool_length_mm=TOOL_MM)
        assert "FORCED" not in made.text + made.to_text() and made.to_dict()["unproven"] == ""
        return
    with pytest.raises(InputError, match=r"tool point 10\.00 µm, U 10\.19 µm"):
        make_module(errors, tool_length_mm=TOOL_MM)
    made = make_module(errors, tool_length_mm=TOOL_MM, force=True)
    assert all("FORCED: U (95 %)" in text for text in (made.text, made.to_text(), made.component))
    # What depends on a channel was found significant when it was identified.
    growth = twin.effect_named("thermal_growth", "Z by bed", {"coefficient": 1.0}, machine)
    assert make_module(replace(errors, extra=(growth,))).unproven == ""


@pytest.mark.parametrize("kind", ["head-head", "head-table"])
def test_the_bound_of_the_correction_leaves_room_for_a_longer_tool(kind: str, tmp_path: Path) -> None:
    """A wobble of the head does not move its centre: made without a tool, the module corrects one of half a metre in full."""
    machine = KINDS[kind]().machine(tmp_path)
    name = {"head-head": "E_BA", "head-table": "E_AB"}[kind]
    effect = twin.effect_named("harmonic", name, {"order": 1.0, "cos": 0.0, "sin": 80.0}, machine)
    made = make_module(replace(twin.Calibration.zero(machine), extra=(effect,)), tool_length_mm=0.0)
    bound, still = np.array(made.proof.bound) * machine.scale, np.zeros(made.live.channel_count)
    for orientation in (0.0, 1.0):
        rows = [made.live.correction(row, still, [0.0, 0.0, 0.5], orientation) for row in poses(machine)]
        found = np.array(rows)[:, :, 0]
        assert np.all(np.abs(found).max(axis=0) <= bound)
        assert orientation == 1.0 or np.abs(found[:, list(machine.linear)]).max() > 20e-6


def test_effects_of_time_and_temperature_get_pins() -> None:
    machine = twin.Machine.load("dmu50")
    lag = {"coefficient": 5.0, "time_constant": 600.0}
    growth = {"amplitude": 20.0, "exponent": 1.5, "time_constant": 300.0, "highest_rpm": 12000.0}
    extra = (
        twin.effect_named("thermal_lag", "Z by bed", lag, machine),
        twin.effect_named("spindle_growth", "Z", growth, machine),
    )
    made = make_module(replace(twin.Calibration.default(machine), extra=extra))
    assert made.to_dict()["pins"] == ["temperature-bed", "spindle-speed"]
    found = {
        name: [float(one) for one in values.split(",")]
        for name, values in re.findall(r"(\w+)\[[^]]*\] = \{([-+e.\d, ]+)\}", made.text)
    }
    # A lag of temperatures begins in balance with its sensor, growth with the spindle's speed at rest; the last of each is unused.
    assert found["HISTORY_SETTLED"][:2] == [1, 0] and found["HISTORY_CONSTANT"][:2] == [600, 300]
    assert found["CHANNEL_START"][:2] == [20, 0] and found["CHANNEL_RATE"][:2] == [0.2, 1e6]
    assert found["LARGEST"] == pytest.approx(np.array(made.proof.bound) * machine.scale, rel=1e-12)
    assert found["SCALE"] == pytest.approx(machine.scale, rel=1e-15)
    drives = np.array(made.live.drives(np.array([0, 0, 0, 0, 0, 26.0, 6000.0, 0.0, 0.0]))).ravel()
    assert drives == pytest.approx([6.0, 0.5**1.5])
    row, tool = poses(machine, 1)[0], np.array([0.0, 0.0, 0.12])
    rest, warm = (
        np.array(made.live.correction(row, np.array([0, 0, 0, 0, 0, 20.0, 0.0, *lags]), tool, 1.0)).ravel()
        for lags in ((0.0, 0.0), (6.0, 0.5))
    )
    assert (warm - rest)[2] == pytest.approx(-40e-6, rel=1e-2)  # 6 K · 5 µm/K + half of 20 µm


def pattern(where: str, size: float, machine: twin.Machine, **ranges: tuple[float, float]) -> twin.Calibration:
    """Return a machine whose tool side has moved along x by size·cos(π (value − low)/(high − low)), cause unknown."""
    columns = [ColumnEntry(column=name, functions="half_waves", order=1, range=span) for name, span in ranges.items()]
    key = "x[1]" if len(columns) == 1 else "x[1,0]"
    extra = empirical_named(f"tool by {where}", "base", columns, {key: size}, machine)
    return replace(twin.Calibration.zero(machine), extra=(extra,))


def test_an_empirical_effect_is_not_used_beyond_its_range() -> None:
    """Beyond, the value at the end of the range is corrected; a pin beyond its range keeps the last value within (tests/linuxcnc)."""
    machine = twin.Machine.load("dmu50")
    live = make_module(pattern("X_mm", 30.0, machine, X_mm=(100.0, 300.0))).live
    found = [live.correction([x, 0.2, -0.1, 0, 0], [0] * 5, [0, 0, 0.1], 1.0) for x in (0.05, 0.1, 0.2, 0.3, 0.35)]
    assert np.array(found)[:, 0, 0] == pytest.approx([-30e-6, -30e-6, 0.0, 30e-6, 30e-6], abs=1e-8)
    live = make_module(pattern("T_bed_degC", 30.0, machine, T_bed_degC=(22.0, 27.0))).live
    (pin,) = channels_of(live)
    assert (pin.pin, pin.low, pin.high, pin.start) == ("temperature-bed", 22.0, 27.0, 22.0)


def test_what_it_cannot_carry_is_refused(tmp_path: Path) -> None:
    machine = twin.Machine.load("dmu50")
    errors = twin.Calibration.default(machine)
    growth = twin.effect_named("thermal_growth", "Z by oil tank", {"coefficient": 1.0}, machine)
    with pytest.raises(InputError, match="name of a pin"):
        make_module(replace(errors, extra=(growth,)))
    steep = replace(errors.curves["E_XX"], coefficients=tuple(3e4 * one for one in errors.curves["E_XX"].coefficients))
    with pytest.raises(InputError, match="changes by more than the position does"):
        make_module(replace(errors, curves={**errors.curves, "E_XX": steep}))
    with pytest.raises(InputError, match="did not settle"):
        make_module(replace(errors, settled=False))
    with pytest.raises(InputError, match="C, which turns without a limit"):
        make_module(pattern("C_deg", 30.0, machine, C_deg=(0.0, 90.0)))
    with pytest.raises(InputError, match="no value of T_oven_degC is within"):
        make_module(pattern("T_oven_degC", 30.0, machine, T_oven_degC=(70.0, 90.0)))
    cold = replace(errors, extra=pattern("X_mm", 30.0, machine, X_mm=(-90.0, -10.0)).extra)
    with pytest.raises(InputError, match="no value of X is within"):
        make_module(cold)
    words = [*TWIN, "control", "--to", "linuxcnc-kinematics", "-o", str(tmp_path / "no"), "--step", "5"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "--step means nothing" in done.stderr and not (tmp_path / "no").exists()


@pytest.mark.parametrize(
    ("write", "says"),
    [
        (few_axes.write_stage, "1 linear and 0 rotary axes; expected three linear axes and at most two rotary ones"),
        (few_axes.write_drill, "2 linear and 0 rotary axes"),
        (few_axes.write_robot, "has no word in LinuxCNC: 'J1'"),
    ],
    ids=["stage", "drill", "robot"],
)
def test_a_chain_that_the_module_does_not_carry_is_refused(
    write: Callable[[Path], Path], says: str, tmp_path: Path
) -> None:
    machine = write(tmp_path)
    done = written(tmp_path, "--machine", str(machine))
    assert done.returncode == 2 and says in done.stderr, done.stderr
    assert not (tmp_path / "live").exists()


def written(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [*TWIN, "control", "--to", "linuxcnc-kinematics", "-o", "live", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_locations_that_were_not_identified_are_refused_unless_they_are_accepted(tmp_path: Path) -> None:
    unknown = "not_identifiable:\n- {name: E_X0B, why: cannot be separated from station 1}\n"
    head = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: by hand\n"
    (tmp_path / "mine.yaml").write_text(f"{head}location: {{E_X0C: 25.0}}\n{unknown}")
    done = written(tmp_path, "-c", "mine.yaml")
    assert done.returncode == 2 and "E_X0B were not identified" in done.stderr and "(--force)" in done.stderr
    assert not (tmp_path / "live").exists()
    forced = written(tmp_path, "-c", "mine.yaml", "--force")
    assert (
        forced.returncode == 0 and "KINEMATICS NOT IDENTIFIED: E_X0B" in (tmp_path / "live" / "twinkins.c").read_text()
    )


def test_an_effect_without_a_pin_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="for which the module has no pin: 'feed_mm_min'"):
        channel_of("feed_mm_min")
    effect = "effects:\n- {effect: thermal_growth, where: Z by oil tank, parameters: {coefficient: 1.0}}\n"
    head = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: by hand\n"
    (tmp_path / "mine.yaml").write_text(head + effect)
    done = written(tmp_path, "-c", "mine.yaml")
    assert done.returncode == 2 and "mine.yaml" in done.stderr and "name of a pin" in done.stderr
    assert not (tmp_path / "live").exists()


@pytest.fixture(scope="module")
def component_text(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("component") / "live"
    machine = twin.Machine.load("dmu50")
    named = {"thermal_growth Z by bed": {"coefficient": 12.0}, "thermal_expansion X": {"coefficient": 9.0}}
    extra = tuple(twin.effect_named(*name.split(" ", 1), numbers, machine) for name, numbers in named.items())
    write_module(make_module(replace(twin.Calibration.zero(machine), extra=extra)), folder)
    return (folder / "twinlive.py").read_text()


@pytest.fixture
def component(component_text: str) -> types.ModuleType:
    """Return the component that supplies the temperatures of two sensors; without HAL, which it imports when it runs."""
    module = types.ModuleType("twinlive")
    exec(compile(component_text, "twinlive.py", "exec"), vars(module))
    return module


def settings_of(component: types.ModuleType, folder: Path, **entries: str) -> object:
    (folder / "checks").mkdir(exist_ok=True)
    return component.Settings(({"SENSORS": "shop.csv", "RECORD": "checks"} | entries).get, str(folder))


NOW = datetime(2026, 3, 2, 7, 10, tzinfo=UTC).timestamp()


@pytest.mark.parametrize(
    ("text", "entries", "found", "missing"),
    [
        ("time,T_bed_degC,X\n2026-03-02T08:09:30+01:00,26.5,23\n", {}, {"bed": 26.5, "X": 23.0}, ()),
        ("time;bed;Halle;X\n2026-03-02 07:09:30Z;26,5;19;23\n", {}, {"bed": 26.5, "X": 23.0}, ()),
        (f"# log\r\ntime\tB 1\tX\r\n{NOW - 30}\t26,5\t23\r\n", {"COLUMNS": "bed=B 1"}, {"bed": 26.5, "X": 23.0}, ()),
        (f"time,bed,X\n{NOW},26,23\n{NOW},99", {}, {"bed": 26.0, "X": 23.0}, ()),
        (f"time,bed,X\n{NOW},-127,23\n", {}, {"X": 23.0}, ("-127 is outside 0 to 60",)),
        (f"time,bed,X\n{NOW},26,41\n", {"HIGH": "40"}, {"bed": 26.0}, ("41 is outside 0 to 40",)),
        (f"time,bed,X\n{NOW},nan,\n", {}, {}, ("nan is outside", "no number: ''")),
        (
            f"time,bed\n{NOW},26\n",
            {},
            {"bed": 26.0},
            ("no column for the sensor X: expected T_X_degC or X, got time, bed",),
        ),
        (f"time,bed,X\n{NOW - 61},26,23\n", {}, {}, ("no new row for 61 s",) * 2),
        (f"time,bed,X\n{NOW + 61},26,23\n", {}, {}, ("61 s ahead of the clock",) * 2),
        ("time,bed,X\nyesterday,26,23\n", {}, {}, ("Invalid isoformat string: 'yesterday'",) * 2),
        (f"time,bed,X\n{NOW},26\n", {}, {}, ("2 cells in the last row, 3 in the header",) * 2),
        ("time,bed,X\n", {}, {}, ("no header and no row",) * 2),
        ("", {}, {}, ("no header and no row",) * 2),
        (None, {}, {}, ("No such file",) * 2),
    ],
)
def test_the_last_row_of_a_log_gives_the_temperatures(
    component: types.ModuleType,
    tmp_path: Path,
    text: str | None,
    entries: dict[str, str],
    found: dict[str, float],
    missing: tuple[str, ...],
) -> None:
    if text is not None:
        (tmp_path / "shop.csv").write_bytes(text.encode())
    values, reasons = component.read_sensors(settings_of(component, tmp_path, **entries), NOW)
    assert values == found and set(values).isdisjoint(reasons) and {*values, *reasons} == {"bed", "X"}
    assert len(reasons) == len(missing)
    for reason, expected in zip((reasons[name] for name in ("bed", "X") if name in reasons), missing, strict=True):
        assert expected in reason


def test_without_temperatures_the_component_writes_the_record_alone(tmp_path: Path) -> None:
    write_module(make_module(with_errors("dmu50")), tmp_path / "live")
    module = types.ModuleType("twinlive")
    exec(compile((tmp_path / "live" / "twinlive.py").read_text(), "twinlive.py", "exec"), vars(module))
    assert module.read_sensors(settings_of(module, tmp_path, SENSORS=""), NOW) == ({}, {})
    assert "temperature" not in (tmp_path / "live" / "twinlive.hal").read_text()
    assert "SENSORS" not in (tmp_path / "live" / "README.txt").read_text()


def test_a_long_log_is_read_at_its_end(component: types.ModuleType, tmp_path: Path) -> None:
    rows = "".join(f"{NOW - 50_000 + i},{20 + i * 1e-4:.3f},23\n" for i in range(50_000))
    (tmp_path / "shop.csv").write_text("# made by the logger\ntime,bed,X\n" + rows)
    values, reasons = component.read_sensors(settings_of(component, tmp_path), NOW)
    assert values == {"bed": 25.0, "X": 23.0} and not reasons


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"SENSORS": ""}, r"\[TWIN\]SENSORS is missing: the file of the temperatures bed, X"),
        ({"RECORD": ""}, r"\[TWIN\]RECORD is missing"),
        ({"RECORD": "nowhere"}, "expected a folder that .* may write, got .*nowhere"),
        ({"STALE": "0"}, r"\[TWIN\]STALE: expected a number of 1 or more, got '0'"),
        ({"HIGH": "warm"}, r"\[TWIN\]HIGH: expected a number, got 'warm'"),
        ({"COLUMNS": "oven=T"}, "expected SENSOR=COLUMN, of bed, X, got 'oven=T'"),
    ],
)
def test_the_component_does_not_start_with(
    component: types.ModuleType, tmp_path: Path, entries: dict[str, str], says: str
) -> None:
    with pytest.raises(component.Refused, match=says):
        settings_of(component, tmp_path, **entries)


def test_records_go_on_and_never_mix(component: types.ModuleType, tmp_path: Path) -> None:
    """After a new start the same file goes on; after midnight, after a torn line and with other columns there is a new one."""
    row: Callable[[float], str] = lambda elapsed: f"{elapsed:.1f}" + ",0" * (len(component.Record.columns) - 1)  # noqa: E731
    local = datetime.now().replace(hour=12, minute=0, second=0, microsecond=0).timestamp()
    for start in (local, local + 3600.0):
        component.Record(str(tmp_path)).add(row, start)
    (path,) = tmp_path.glob("control_*.csv")
    loaded = ControlRecord.load(path)
    assert loaded.time_s.tolist() == [0.0, 3600.0] and loaded.begin.timestamp() == local
    path.write_text(path.read_text() + "7200.0,0")
    component.Record(str(tmp_path)).add(row, local + 7200.0)
    component.Record(str(tmp_path)).add(row, local + 86400.0)
    assert len(list(tmp_path.glob("control_*.csv"))) == 3
    second = next(tmp_path.glob("control_*_2.csv"))
    assert ControlRecord.load(second).begin.timestamp() == local + 7200.0
