"""Tables made from a calibration: with commands q + c(q) a machine with errors comes nearer to the nominal pose.

The DMU 50 is that of `tests.truth.machine`, its tables are evaluated by `tests.controls.cases`: of `twin` only the files are used.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from tests.controls.cases import BY_HAND
from tests.controls.test_control_formats import put
from tests.truth.machine import TruthMachine
from twin._common.errors import InputError
from twin.cli import main
from twin.compensation import compensate
from twin.compensation.tables import ControlTables, Request, account_of, make, write_folder
from twin.controls import ControlSection, TableEntry, TableSum, format_named, read_tables, table_formats
from twin.display import figure
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects import CrossAxis, Reversal, ThermalExpansion
from twin.model.motion_curve import Curve
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics

LENGTH = 100.0


def slow(kind: str) -> object:
    return pytest.param(kind, marks=pytest.mark.slow)


TOLERANCE_UM = {form.name: form.tolerance_um for form in table_formats()}


def drawn(machine: Machine, seed: int, *, rotary: bool, um: float = 10.0, urad: float = 60.0) -> Calibration:
    """Return errors of some 10 µm and 60 µrad, of low order; location errors only with errors of the rotary axes."""
    rng = np.random.default_rng(seed)
    curves = {}
    for axis in machine.axes:
        for direction in "XYZABC" if axis.linear or rotary else "":
            name = f"E_{direction}{axis.name}"
            unit, size = ("um", um) if direction in "XYZ" else ("urad", urad)
            basis = "fourier" if axis.lower is None else "power"
            values = tuple(float(v) for v in rng.normal(0, 0.5 * size, 3 if axis.lower is None else 4))
            curves[name] = Curve(name, unit, axis.domain, basis, values)
    square = {name: float(rng.normal(0, 40)) for name in machine.squareness_names}
    places = {name: float(rng.normal(0, 15)) for name in machine.location_names} if rotary else {}
    return Calibration(machine, "drawn", *(MappingProxyType(one) for one in (curves, square, places)))


def positions(machine: Machine, count: int, seed: int = 8) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(*axis.domain, count) for axis in machine.axes], axis=1)


def state_of(machine: Machine, q: np.ndarray, side: float = 0.0) -> dict[str, np.ndarray]:
    state = {name: q[:, i] for i, name in enumerate(machine.names)}
    return state | {f"approach_{name}": np.full(len(q), side) for name in machine.names}


def line(machine: Machine, made: ControlTables, axis: str, count: int = 60) -> np.ndarray:
    rows = np.tile([made.required.at[name] for name in machine.names], (count, 1))
    rows[:, machine.names.index(axis)] = positions(machine, count)[:, machine.names.index(axis)]
    return rows


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module")
def truth(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, tuple[Calibration, TruthMachine]]:
    """Calibration of the DMU 50 and the simulated machine: with errors of all axes, or of the linear axes alone."""
    folder = tmp_path_factory.mktemp("truth")
    found = {}
    for rotary in (True, False):
        calibration = drawn(dmu50, 5, rotary=rotary)
        calibration.save(folder / f"{rotary}.yaml")
        found[rotary] = (calibration, TruthMachine(folder / f"{rotary}.yaml", LENGTH))
    return found


def sent(folder: Path, kind: str, machine: Machine, q: np.ndarray, side: float = 0.0) -> np.ndarray:
    """Return q + c(q), with the correction evaluated independently of twin."""
    state, commands = state_of(machine, q, side), q.copy()
    for i, axis in enumerate(machine.axes):
        if kind == "linuxcnc" or axis.linear or kind != "isg":
            try:
                shift = BY_HAND[kind](folder, axis.name, state)
            except IndexError:  # LinuxCNC: no such joint in the INI lines
                continue
            commands[:, i] += shift * 1e-3 if axis.linear else np.degrees(shift * 1e-6)
    return commands


@pytest.mark.parametrize(("kind", "rotary"), [("siemens", False), ("isg", True)])
def test_over_the_volume(
    kind: str, rotary: bool, dmu50: Machine, truth: dict[bool, tuple[Calibration, TruthMachine]], tmp_path: Path
) -> None:
    """Products correct angular errors over the volume; component errors correct everything at the point."""
    calibration, machine = truth[rotary]
    made = make(dmu50, calibration, Request(kind, tool_length_mm=LENGTH))
    assert made.unmet == ()
    assert dict(made.required.at) == {"X": 250.0, "Y": 225.0, "Z": -200.0, "B": 0.0, "C": 0.0}
    for table in made.tables:
        # Read back at random positions, of which some are near the largest deviation between the nodes.
        largest = table.deviation + table.rounding
        assert 0.5 * table.deviation - table.rounding < table.read_back_deviation < 1.01 * largest + 1e-6
    put(tmp_path, made.files)
    q = positions(dmu50, 150)
    before, _ = machine.deviations(q, q)
    after, _ = machine.deviations(sent(tmp_path, kind, dmu50, q), q)
    assert rms(before) > 25.0
    # Three axes, each within its tolerance between the nodes, in each direction: √9 · 1 µm · √(8/15) RMS of a parabola.
    assert rms(after) < 1.7
    account = account_of(made, calibration, calibration, {})
    assert account.to_dict()["illustrative"] is False
    assert account.remains.before.rms_um == pytest.approx(rms(before), rel=0.15)  # other places
    assert account.remains.tables.rms_um == pytest.approx(rms(after), rel=0.25)
    assert account.remains.program.max_um < 0.01
    assert {one.share for one in account.carried} == {"whole"}
    # The check on the machine is of a displacement, which a gauge can measure.
    assert "µm): move the axis over its range and measure the error with a dial gauge" in account.to_text()


@pytest.mark.parametrize("kind", ["isg", "siemens"])
def test_another_tool_than_the_tables_were_made_for(kind: str, dmu50: Machine, tmp_path: Path) -> None:
    """ISG's control takes the active tool into account, tables of axes do not; the model must predict the point for both."""
    calibration = drawn(dmu50, 5, rotary=kind == "isg")
    calibration.save(tmp_path / "errors.yaml")
    made = make(dmu50, calibration, Request(kind, tool_length_mm=LENGTH))
    write_folder(made, calibration, calibration, {}, tmp_path / "tables")
    longer = LENGTH + 80.0
    machine = TruthMachine(tmp_path / "errors.yaml", longer)
    q = positions(dmu50, 60)
    with_tables = Calibration.load(tmp_path / "tables" / "calibration.yaml", dmu50)
    model = Kinematics(dmu50, with_tables, tool_length_mm=longer).forward(q).point_mm
    active = {
        name: text.replace(f"tool length {LENGTH:g} mm", f"tool length {longer:g} mm")
        for name, text in made.files.items()
    }
    put(tmp_path / "active", active)
    commands = sent(tmp_path / "active", kind, dmu50, q)
    real = np.array([machine.pose(command)[:3, 3] for command in commands])
    assert np.abs(model - real).max() * 1e3 < 0.25  # second order: errors are read at q
    off = rms(machine.deviations(commands, q)[0])
    assert off < 1.7 if kind == "isg" else off > 3.0
    # Errors measured with the tables on hold for the tool active then, which is not recorded: the report must state it.
    left = ControlSection(
        "remaining",
        tuple(TableEntry.of(tmp_path / "tables" / name, kind, ()) for name in format_named(kind).to_read(made.files)),
    )
    report = compensate("cone_frustum.nc", dmu50, calibration.with_control(left)).report
    assert report.control is not None
    assert (
        ("valid only for the tool length" in report.control.sentence)
        == (kind == "isg")
        == ("length of the active tool" in report.to_text())
    )


@pytest.mark.parametrize("kind", [slow("linuxcnc"), "heidenhain"])
def test_on_the_line(
    kind: str, dmu50: Machine, truth: dict[bool, tuple[Calibration, TruthMachine]], tmp_path: Path
) -> None:
    """With tables over single axes an axis that moves alone has no error while the others stand at the reference positions."""
    for i, axis in enumerate("XYZ"):
        calibration = truth[False][0].where(lambda name, axis=axis: name.endswith(axis))
        calibration.save(tmp_path / f"{axis}.yaml")
        machine = TruthMachine(tmp_path / f"{axis}.yaml", LENGTH)
        made = make(dmu50, calibration, Request(kind, tool_length_mm=LENGTH))
        put(tmp_path, made.files)
        q = line(dmu50, made, axis)
        commands = sent(tmp_path, kind, dmu50, q)
        before = np.array([(machine.pose(m) - machine.pose(m, real=False))[:3, 3] for m in q])
        after = np.array(
            [(machine.pose(c) - machine.pose(m, real=False))[:3, 3] for c, m in zip(commands, q, strict=True)]
        )
        # LinuxCNC moves an axis by its own table only. B = C = 0: the work frame's directions are those of the axes.
        own = slice(None) if kind == "heidenhain" else slice(i, i + 1)
        assert np.abs(before[:, own]).max() * 1e3 > 5.0
        assert (
            np.abs(after[:, own]).max() * 1e3 < 1.0 + 0.06
        )  # the tolerance, half of the last digit, 10 nm of second order


@pytest.mark.parametrize("kind", [slow("heidenhain"), "siemens", "isg", "grid"])
def test_an_axis_on_the_work_side(kind: str, tmp_path: Path) -> None:
    """The trunnion machine has Y on the work side: signs follow from its kinematics."""
    machine = Machine.load("trunnion_ac")
    calibration = drawn(machine, 6, rotary=kind == "isg")
    made = make(machine, calibration, Request(kind, tool_length_mm=LENGTH, tolerance_um=TOLERANCE_UM[kind]))
    correction = read_tables(kind, put(tmp_path, {n: t for n, t in made.files.items() if n != "volcomp.lis"}), machine)
    q = positions(machine, 300)
    if kind == "heidenhain":  # single tables: no levers where they stand
        calibration = calibration.where(lambda name: name[2] in "XYZ" or "0" in name)
        made = make(machine, calibration, Request(kind, tool_length_mm=LENGTH))
        correction = read_tables(kind, put(tmp_path, made.files), machine)
    state, commands = state_of(machine, q), q.copy()
    for name in correction.axes:
        commands[:, machine.names.index(name)] += correction.shift(name, state) * 1e-3
    meant = Kinematics(machine, Calibration.zero(machine), tool_length_mm=LENGTH).forward(q).point_mm
    inside = ~(calibration.outside(commands) | calibration.outside(q)).any(axis=1)
    real = Kinematics(machine, calibration, tool_length_mm=LENGTH)
    before = np.linalg.norm(real.forward(q[inside]).point_mm - meant[inside], axis=1) * 1e3
    after = np.linalg.norm(real.forward(commands[inside]).point_mm - meant[inside], axis=1) * 1e3
    assert inside.sum() > 200
    assert rms(before) > 15.0
    assert rms(after) < 1.7 * TOLERANCE_UM[kind] / (2.0 if kind == "grid" else 1.0)


@pytest.mark.parametrize(("name", "rotary"), [("trunnion_ac", "AC"), ("dmu50", "BC")])
def test_a_rotary_axis_by_itself(name: str, rotary: str, tmp_path: Path) -> None:
    """R-POS alone: with its table a rotary axis reaches the nominal angle, in both senses of rotation."""
    machine = Machine.load(name)
    own = {f"E_{'ABC'[int(np.argmax(np.abs(machine.by_name[a].direction)))]}{a}" for a in rotary}
    calibration = drawn(machine, 3, rotary=True).where(lambda one: one in own)
    assert len(calibration.curves) == 2
    made = make(machine, calibration, Request("siemens", tool_length_mm=LENGTH))
    correction = read_tables("siemens", put(tmp_path, made.files), machine)
    assert set(correction.axes) == set(rotary)
    q = positions(machine, 200)
    state, commands = state_of(machine, q), q.copy()
    for axis in rotary:
        commands[:, machine.names.index(axis)] += np.degrees(correction.shift(axis, state) * 1e-6)
    inside = ~calibration.outside(commands).any(axis=1)
    real, zero = (Kinematics(machine, one, tool_length_mm=LENGTH) for one in (calibration, Calibration.zero(machine)))
    meant = zero.forward(q[inside]).point_mm
    before, after = (np.linalg.norm(real.forward(one[inside]).point_mm - meant, axis=1) * 1e3 for one in (q, commands))
    assert rms(before) > 5.0
    assert after.max() < 2.5  # 2 µrad of each between nodes, at half a metre


@pytest.mark.parametrize("kind", ["linuxcnc", slow("heidenhain"), slow("siemens")])
def test_reversals_have_two_directions(kind: str, dmu50: Machine, tmp_path: Path) -> None:
    bare = drawn(dmu50, 7, rotary=False).where(lambda name: name in ("E_XX", "E_YX"))
    calibration = replace(bare, extra=(Reversal(dmu50.by_name["X"], 8.0), Reversal(dmu50.by_name["C"], 60.0)))
    made = make(dmu50, calibration, Request(kind, tool_length_mm=LENGTH))
    put(tmp_path, made.files)
    q = line(dmu50, made, "X")
    real = Kinematics(dmu50, calibration, tool_length_mm=LENGTH)
    meant = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=LENGTH).forward(q).point_mm
    for side in (1.0, -1.0):
        sides = np.full(q.shape, side)
        before = (real.forward(q, sides).point_mm - meant)[:, 0] * 1e3
        commands = np.clip(sent(tmp_path, kind, dmu50, q, side), *np.array([a.domain for a in dmu50.axes]).T)
        within = (commands[:, 4] != 360.0) & (np.abs(commands[:, 0] - 250) < 250)
        after = (real.forward(commands, sides).point_mm - meant)[within, 0] * 1e3
        assert np.abs(before).max() > 5.0
        assert np.abs(after).max() < 1.1
        required = 30.0 * -side
        assert BY_HAND[kind](tmp_path, "C", state_of(dmu50, q, side)) == pytest.approx(required, abs=0.1)
    carried = {one.name: one.share for one in account_of(made, calibration, calibration, {}).carried}
    assert carried["reversal:X"] == "whole"
    assert carried["E_YX"] == ("no" if kind == "linuxcnc" else "whole")


def test_errors_a_format_cannot_correct_are_reported(dmu50: Machine) -> None:
    extra = (Reversal(dmu50.by_name["Y"], 5.0), CrossAxis("E_XZ", "Y", 30.0))
    bare = drawn(dmu50, 7, rotary=True).where(lambda name: name in ("E_XX", "E_AX", "E_C0Y", "E_XC", "E_CC", "E_CB"))
    calibration = replace(bare, extra=extra)
    cross = extra[1].name

    def shares(kind: str) -> dict[str, str]:
        request = Request(kind, tool_length_mm=LENGTH, tolerance_um=20.0)
        return {
            one.name: one.share
            for one in account_of(make(dmu50, calibration, request), calibration, calibration, {}).carried
        }

    names = ("E_XX", "E_AX", "E_C0Y", "E_XC", "E_CC", "E_CB", "reversal:Y", cross)
    linuxcnc, isg = ([found[name] for name in names] for found in (shares("linuxcnc"), shares("isg")))
    assert linuxcnc == ["whole", "line", "no", "no", "whole", "whole", "whole", "no"]
    assert isg == ["whole", "whole", "whole", "whole", "whole", "whole", "no", "line"]


@pytest.mark.slow
def test_few_tables_are_used_for_the_largest_corrections(
    dmu50: Machine, truth: dict[bool, tuple[Calibration, TruthMachine]]
) -> None:
    made = make(dmu50, truth[False][0], Request("siemens", tool_length_mm=LENGTH, most=8))
    counted = set(re.findall(r"^\$AN_CEC\[(\d+),", made.files["cec.mpf"], re.M))
    assert 7 <= len(counted) <= 8
    assert made.left_out
    smallest = min(one.content.largest for one in made.tables if " times " not in one.content.name)
    assert all(float(text.split(": ")[1]) <= smallest + 0.05 for text in made.left_out if " times " not in text)
    assert any("no table available" in text for text in made.unmet)


def test_a_step_that_is_too_wide_is_reported(
    dmu50: Machine, truth: dict[bool, tuple[Calibration, TruthMachine]]
) -> None:
    made = make(dmu50, truth[False][0], Request("linuxcnc", tool_length_mm=LENGTH, step=250.0))
    assert [one.content.nodes for one in made.tables] == [3, 3, 3]
    assert any("more than the tolerance" in text for text in made.unmet)
    with pytest.raises(InputError, match="more points than the format has"):
        make(dmu50, truth[False][0], Request("linuxcnc", step=0.5))


@pytest.mark.parametrize("kind", [slow("linuxcnc"), slow("heidenhain"), "siemens", slow("isg"), "grid"])
def test_new_tables_are_added_to_old_ones(kind: str, dmu50: Machine, tmp_path: Path) -> None:
    """Errors measured with tables on remain under them: the control gets the sum, the model the new part alone."""
    names = ("E_XX", "E_YX", "E_CX", "E_ZZ", "E_BB", "E_CC")
    first, second = (drawn(dmu50, seed, rotary=True).where(lambda name: name in names) for seed in (1, 2))
    request = Request(kind, tool_length_mm=LENGTH, step=100.0, tolerance_um=100.0)
    write_folder(make(dmu50, first, request), first, first, {}, put(tmp_path / "old", {"a": ""})[0].parent)
    old = Calibration.load(tmp_path / "old" / "calibration.yaml", dmu50).control
    assert old is not None
    left = second.with_control(ControlSection("remaining", old.tables))
    with pytest.raises(InputError, match="measured with tables switched on") as caught:
        make(dmu50, left, request)
    assert caught.value.setting == "add"
    made = make(dmu50, left, replace(request, add=True))
    assert made.unmet == ()
    (tmp_path / "new").mkdir()
    write_folder(made, left, left, {}, tmp_path / "new")
    with_tables = Calibration.load(tmp_path / "new" / "calibration.yaml", dmu50)
    assert with_tables.control is not None and with_tables.control.errors_are == "uncorrected"
    before = read_tables(kind, [one.file for one in old.tables], dmu50)
    part = read_tables(kind, [one.file for one in with_tables.control.tables], dmu50)
    whole = read_tables(kind, [tmp_path / "new" / one.file.name for one in with_tables.control.tables], dmu50)
    state = state_of(dmu50, positions(dmu50, 100))
    for axis in whole.axes:
        both = [one.shift(axis, state) for one in (before, part) if axis in one.axes]
        # Of Heidenhain 0.05 µm and 0.09 µrad for each of three tables, twice.
        assert np.abs(whole.shift(axis, state) - sum(both)).max() <= (0.6 if kind == "heidenhain" else 0.05)
    with pytest.raises(InputError, match="only if the calibration was measured with those switched on"):
        make(dmu50, first, replace(request, add=True))


PRODUCTS = "the products of tables correct this."
NO_PRODUCTS = ", which remains uncorrected."


@pytest.mark.parametrize(
    ("kind", "elsewhere", "shares", "sign"),
    [
        ("siemens", PRODUCTS, ["corrected: E_XX E_AX E_CC"], "Y by X"),
        ("linuxcnc", NO_PRODUCTS, ["corrected: E_XX E_CC", "corrected in part: E_AX (only"], "X by X"),
        ("grid", "", ["corrected: E_XX E_AX", "not corrected: E_CC (error of a rotary axis"], "dY over the box"),
    ],
)
def test_the_account_says_what_the_tables_correct_and_where(
    kind: str, elsewhere: str, shares: list[str], sign: str, dmu50: Machine
) -> None:
    calibration = drawn(dmu50, 5, rotary=True).where(lambda name: name in ("E_XX", "E_AX", "E_CC"))
    made = make(dmu50, calibration, Request(kind, tool_length_mm=LENGTH))
    account = account_of(made, calibration, calibration, {})
    text = account.to_text()
    assert [end for end in (PRODUCTS, NO_PRODUCTS) if end in text] == ([elsewhere] if elsewhere else [])
    assert all(f"\n  {one}" in text for one in shares)
    assert "for a length other than 100 mm make new tables" in text and "do not follow them" not in text
    # A displacement before a rotation, whatever its number; of several displacements the largest.
    lengths = [one.content for one in made.tables if one.content.unit == "um"]
    largest = max(one.largest for one in lengths)
    assert f"the largest correction ({sign}, up to {largest:.1f} µm): move the axis" in text
    assert "Not met" not in text and "would be corrected twice" in text and "READ-BACK FAILED" not in text
    assert "ABOVE TOLERANCE" not in text and "do not load it" not in text

    (worst, *_), remains = made.tables, account.remains
    failed = replace(
        worst, read_back_deviation=2.0 * (worst.deviation + worst.rounding), tolerance=0.5 * worst.deviation
    )
    faulty = replace(
        account,
        made=replace(made, tables=(failed, *made.tables[1:]), increment={"a": ""}),
        remains=replace(remains, before=remains.tables, tables=remains.before),
        missing=MappingProxyType({"T_X_degC": ("thermal_expansion:X", "scale_growth:X")}),
    )
    (row,) = [line for line in faulty.to_text().splitlines() if line.endswith("READ-BACK FAILED  ABOVE TOLERANCE")]
    assert row.split()[0] == worst.content.name.split()[0] and "do not load it" in faulty.to_text()
    assert {
        "not included: thermal_expansion:X, scale_growth:X (T_X_degC is not given)",
        "over the volume the error is larger with the tables than without them",
    } < set(faulty.unmet)
    assert faulty.to_text().endswith(f"- {faulty.unmet[-1]}\n")


def test_tables_of_a_rotary_axis_are_checked_with_a_measured_angle(dmu50: Machine) -> None:
    calibration = drawn(dmu50, 3, rotary=True).where(lambda name: name == "E_CC")
    made = make(dmu50, calibration, Request("siemens", tool_length_mm=LENGTH))
    text = account_of(made, calibration, calibration, {}).to_text()
    assert "(C by C, up to" in text and " µrad): move the axis" in text and "reference encoder" in text
    assert "dial gauge" not in text
    none = calibration.where(lambda name: False)
    text = account_of(replace(made, tables=()), none, none, {}).to_text()
    assert "Before cutting" not in text


def test_tables_for_one_temperature_say_so(dmu50: Machine) -> None:
    bare = drawn(dmu50, 5, rotary=False).where(lambda name: name == "E_XX")
    calibration = replace(bare, extra=(ThermalExpansion(dmu50.by_name["X"], 10.0),))
    made = make(dmu50, calibration, Request("siemens", conditions=Conditions({"X": 26.0})))
    text = account_of(made, calibration, calibration, {}).to_text()
    assert "\nThe tables are for X 26 °C, and do not follow them: at others make new tables." in text


def test_tables_in_use_are_replaced_by_those_for_the_errors_alone(dmu50: Machine, tmp_path: Path) -> None:
    errors = drawn(dmu50, 4, rotary=False).where(lambda name: name == "E_XX")
    request = Request("linuxcnc", tool_length_mm=LENGTH)
    first = make(dmu50, errors, request)
    write_folder(first, errors, errors, {}, tmp_path)
    again = make(dmu50, Calibration.load(tmp_path / "calibration.yaml", dmu50), request)
    assert again.files == first.files


def run(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    return int(caught.value.code or 0)


def test_the_command(dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mine, out = tmp_path / "mine.yaml", tmp_path / "tables"
    drawn(dmu50, 4, rotary=False).where(lambda name: name in ("E_XX", "E_YY", "E_C0Y")).save(mine)
    common = ["control", "-c", str(mine), "--tool-length", "100"]
    assert run([*common, "--to", "linuxcnc", "-o", str(out), "--json", str(tmp_path / "a.json")]) == 0
    shown = capsys.readouterr().out
    assert (out / "README.txt").read_text() in shown
    assert "not corrected: E_C0Y" in shown
    report = json.loads((tmp_path / "a.json").read_text())
    assert [one["table"] for one in report["tables"]] == ["X by X", "Y by Y"]
    assert all(one["holds"] for one in report["tables"])
    assert report["error_at_tool"]["with_tables"]["rms_um"] < report["error_at_tool"]["before"]["rms_um"]
    names = ["X.comp", "Y.comp", "joints.ini"]
    assert sorted(path.name for path in out.iterdir()) == sorted([*names, "README.txt", "calibration.yaml"])

    files = [str(out / name) for name in names]
    assert run([*common, "--read", *files, "--format", "linuxcnc", "--json", str(tmp_path / "b.json")]) == 0
    found = json.loads((tmp_path / "b.json").read_text())
    differs = {(one["moved"], one["along"]): one["differs"] for one in found["differences"]}
    # Squareness of Y moves X too; along X it is a constant at Y 225.
    assert differs["Y", "Y"] < 1.0 and differs["X", "X"] < 40e-3 * 225 * 4
    turned = tmp_path / "turned"
    swapped = {name: (out / name).read_text() for name in names}
    for name in names[:2]:  # sign reversed
        rows = [
            [float(word) for word in text.split()] for text in swapped[name].splitlines() if text[0] in "-0123456789"
        ]
        swapped[name] = "".join(f"{q} {2 * q - a} {2 * q - b}\n" for q, a, b in rows)
    put(turned, swapped)
    capsys.readouterr()
    assert run([*common, "--read", *(str(turned / name) for name in names), "--format", "linuxcnc"]) == 0
    assert "worse with these tables" in capsys.readouterr().out

    assert run([*common, "--to", "linuxcnc", "-o", str(out), "--step", "250"]) == 3
    assert "Not met:" in capsys.readouterr().out
    assert run(["control", "-c", str(out / "calibration.yaml"), "--to", "linuxcnc", "-o", str(out)]) == 2
    assert "output file is also an input" in capsys.readouterr().err
    assert run([*common, "--to", "linuxcnc", "-o", str(out), "--at", "Y=900"]) == 2
    assert "out of the range of Y" in capsys.readouterr().err
    assert run([*common, "--to", "linuxcnc", "-o", str(out), "--scope", "FOR"]) == 2
    assert run(["control", "--to", "linuxcnc"]) == 2
    assert run(["control", "--read", "--format", "linuxcnc"]) == 2


def test_illustrative_is_in_every_file(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    out = tmp_path / "out"
    account = tmp_path / "account.json"
    assert run(["control", "--to", "heidenhain", "-o", str(out), "--tool-length", "120", "--json", str(account)]) == 0
    assert json.loads(account.read_text())["illustrative"] is True
    for file in out.iterdir():
        if file.suffix != ".CMA":
            assert "illustrative" in file.read_text().lower(), file.name


# --- uncertainty ---------------------------------------------------------------------------------------------------------


def known_to(machine: Machine, u_um: float | None, *, rest: bool = True) -> Calibration:
    """Return errors of X and Y; only one constant along X is uncertain, the other numbers are exact or have no uncertainty."""
    calibration = drawn(machine, 5, rotary=False).where(lambda name: name in ("E_XX", "E_YX", "E_AY", "E_C0Y"))
    names = tuple(parameter.name for effect in calibration.effects for parameter in effect.parameters)
    if u_um is None:
        return calibration
    kept = names if rest else ("E_XX[0]",)
    matrix = np.diag([u_um**2 if name == "E_XX[0]" else 0.0 for name in kept])
    return replace(calibration, joint=Covariance(kept, matrix))


def test_u_stands_beside_the_remaining_error(dmu50: Machine) -> None:
    """An error along one line has U = 1.96 standard uncertainties in every line; its variance adds to the mean square."""
    calibration = known_to(dmu50, 2.0)
    account = account_of(
        make(dmu50, calibration, Request("siemens", tool_length_mm=LENGTH)), calibration, calibration, {}
    )
    found = account.remains
    assert found.uncertainty.rms_um == pytest.approx(1.96 * 2.0, rel=1e-3) == found.uncertainty.max_um
    assert found.program is not None and found.program.rms_um < 0.01
    for left in (found.before, found.tables, found.program):
        assert left.expected_rms_um == pytest.approx(np.hypot(left.rms_um, 2.0), rel=1e-3)
    rows = [
        line for line in account.to_text().splitlines() if line.startswith(("  without tables", "  with the tables"))
    ]
    assert len(rows) == 3 and all("3.92" in row for row in rows) and "0.00         3.92       2.00" in rows[2]
    assert "lower bound" not in account.to_text()


def test_an_unknown_uncertainty_is_unknown_and_never_zero(dmu50: Machine) -> None:
    calibration = known_to(dmu50, None)
    account = account_of(
        make(dmu50, calibration, Request("siemens", tool_length_mm=LENGTH)), calibration, calibration, {}
    )
    rows = [
        line for line in account.to_text().splitlines() if line.startswith(("  without tables", "  with the tables"))
    ]
    assert len(rows) == 3 and all(row.count("unknown") == 2 for row in rows)
    report = json.loads(json.dumps(account.to_dict(), allow_nan=False))["error_at_tool"]
    assert report["uncertainty"]["rms_um"] is None and report["uncertainty"]["max_um"] is None
    assert {report[name]["expected_rms_um"] for name in ("before", "with_tables", "with_tables_and_program")} == {None}
    part = known_to(dmu50, 2.0, rest=False)
    text = account_of(make(dmu50, part, Request("siemens", tool_length_mm=LENGTH)), part, part, {}).to_text()
    assert "up to at least 3.92 µm" in text and "U is a lower bound: no uncertainty is given for E_XX[1]" in text


@pytest.mark.slow
@pytest.mark.parametrize("length", [pytest.param(0.0, marks=pytest.mark.slow), 120.0])
def test_the_report_gives_the_same_figures(length: float, dmu50: Machine, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    known_to(dmu50, 2.0).save(mine)
    given = ["-c", str(mine), "--tool-length", f"{length:g}"]
    assert run(["report", "-o", str(tmp_path / "r.html"), *given, "--json", str(tmp_path / "r.json")]) == 0
    report = json.loads((tmp_path / "r.json").read_text())
    assert {one["format"] for one in report["control_tables"]} == {
        form.name for form in table_formats() if form.correction is TableSum
    }
    for one in report["control_tables"]:
        out = tmp_path / one["format"]
        assert run(["control", "--to", one["format"], "-o", str(out), *given, "--json", str(tmp_path / "c.json")]) == 0
        control = json.loads((tmp_path / "c.json").read_text())
        assert one == {key: control[key] for key in ("format", "at", "tool_length_mm", "error_at_tool")}
    # And the same U as in the budget.
    assert control["error_at_tool"]["uncertainty"]["rms_um"] == pytest.approx(
        report["budget"]["total"]["U_rms_um"], rel=1e-9
    )
    (step,) = [one for one in report["summary"]["steps"] if "axis tables" in one["title"]]
    best = report["control_tables"][0]
    assert step["kind"] == "do" and f"twin control --to {best['format']} " in step["text"]
    assert f"siemens {figure(best['error_at_tool']['with_tables']['rms_um'], 'µm')} by the model" in step["text"]
    # With the tables on: no further tables are offered, and the remaining error is the same figure.
    again = ["report", "-o", str(tmp_path / "s.html"), "-c", str(tmp_path / "siemens" / "calibration.yaml"), *given[2:]]
    assert run([*again, "--json", str(tmp_path / "s.json")]) == 0
    after = json.loads((tmp_path / "s.json").read_text())
    assert after["control_tables"] == []
    left = best["error_at_tool"]["with_tables"]
    assert after["budget"]["total"]["rms_um"] == pytest.approx(left["rms_um"], rel=1e-9)


def test_poses_with_tables_are_those_of_their_kinematics(dmu50: Machine, tmp_path: Path) -> None:
    errors = drawn(dmu50, 5, rotary=True)
    made = make(dmu50, errors, Request("heidenhain", tool_length_mm=LENGTH))
    write_folder(made, errors, errors, {}, tmp_path)
    known, required = Calibration.load(tmp_path / "calibration.yaml", dmu50), made.required
    assert known.corrections
    q = required.volume.q
    found, expected = required.poses_with(known, q), required.kinematics_with(known).forward(q, required.volume.sides)
    assert found.point_mm == pytest.approx(expected.point_mm, abs=1e-9)
    assert np.abs(expected.point_mm - required.poses_with(errors, q).point_mm).max() > 1e-3


def test_tables_that_make_the_machine_worse_are_not_written(dmu50: Machine, tmp_path: Path) -> None:
    """Two constants that cancel, only one of which is shown: its table alone would double what it should correct."""
    curves = {
        name: Curve(name, "um", dmu50.by_name[name[3]].domain, "power", (value, slope))
        for name, value, slope in (("E_XX", 20.0, 1.0), ("E_XZ", -20.0, -4.0))
    }
    none = MappingProxyType[str, float]({})
    names = ("E_XX[0]", "E_XX[1]", "E_XZ[0]", "E_XZ[1]")
    calibration = Calibration(
        dmu50,
        "drawn",
        MappingProxyType(curves),
        none,
        none,
        joint=Covariance(names, np.diag([30.0, 30.0, 1.0, 1.0]) ** 2),
    )
    for unproven in (False, True):
        made = make(dmu50, calibration, Request("siemens", tool_length_mm=LENGTH, unproven=unproven))
        if unproven:
            assert write_folder(made, calibration, calibration, {}, tmp_path / "forced").remains.tables.rms_um < 5.0
            continue
        with pytest.raises(InputError, match="larger with these tables than without them; 1 more not written"):
            write_folder(made, calibration, calibration, {}, tmp_path / "none")
        assert not (tmp_path / "none").exists()
