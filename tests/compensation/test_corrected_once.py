"""Errors that the control corrects itself are not corrected a second time in the program.

The machine with its control is simulated by `tests.truth.machine`, with the tables looked up independently of `twin`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.compensation.test_compensate import ROUNDING_UM, SAMPLES, compensate
from tests.truth import hidden
from tests.truth.machine import TruthMachine, run_iso
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.cli.identify import tables_on
from twin.controls import ControlSection, TableEntry
from twin.diagnosis import diagnose
from twin.machine.machine import Machine
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import Reversal
from twin.model.iso16907 import Scope
from twin.numerics.covariance import Covariance
from twin.samples.dmu50_calibration import as_drawn
from twin.tool.uncertainty import error_budget

LENGTH = 120.0
SECOND_ORDER_UM = 0.05
"""Curves are read at q, not at q + c(q): some 100 µm of correction at slopes of a few 100 µm/m."""
NODES = {
    axis: np.linspace(low, high, 21) for axis, (low, high) in {"X": (0, 500), "Y": (0, 450), "Z": (-400, 0)}.items()
}


def write(folder: Path, machine: Machine, truth: TruthMachine, axes: str = "XYZ", up: float = 0.0) -> ControlSection:
    """Write LinuxCNC tables of the positioning errors (type 0: actual position); approached from below, ``up`` µm further."""
    ini = ["[TRAJ]", "COORDINATES = X Y Z B C", "LINEAR_UNITS = mm", "ANGULAR_UNITS = degree"]
    entries = []
    for axis in axes:
        is_at = NODES[axis] + 1e-3 * np.array([truth.curve(f"E_{axis}{axis}", q) for q in NODES[axis]])
        rows = zip(NODES[axis], is_at + 0.5e-3 * up, is_at - 0.5e-3 * up, strict=True)
        (folder / f"{axis}.comp").write_text("".join(f"{q:.4f} {a:.6f} {b:.6f}\n" for q, a, b in rows))
        ini += [f"[JOINT_{'XYZBC'.index(axis)}]", f"COMP_FILE = {axis}.comp", "COMP_FILE_TYPE = 0"]
        entries.append(TableEntry.of(folder / f"{axis}.comp", "linuxcnc", ["L-POS"]))
    (folder / "joints.ini").write_text("\n".join(ini) + "\n")
    entries.append(TableEntry.of(folder / "joints.ini", "linuxcnc", ["L-POS"]))
    return ControlSection("uncorrected", tuple(entries))


def driven(folder: Path, commands: np.ndarray) -> np.ndarray:
    """Return the axis positions commanded by the control: tables equal in both directions, looked up with numpy."""
    moved = commands.copy()
    for i, axis in enumerate("XYZ"):
        if (folder / f"{axis}.comp").exists():
            nominal, actual, _ = np.loadtxt(folder / f"{axis}.comp").T
            moved[:, i] += np.interp(commands[:, i], nominal, nominal - actual)
    return moved


@pytest.fixture(scope="module")
def calibration(dmu50: Machine, tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """The errors as drawn, with the constants of the positioning errors, which the axes' tables correct."""
    path = tmp_path_factory.mktemp("drawn") / "drawn.yaml"
    as_drawn(dmu50).save(path)
    return Calibration.load(path, dmu50)


@pytest.fixture
def truth(calibration: Calibration) -> TruthMachine:
    assert calibration.path is not None
    return TruthMachine(calibration.path, LENGTH)


@pytest.fixture
def section(tmp_path: Path, dmu50: Machine, truth: TruthMachine) -> ControlSection:
    return write(tmp_path, dmu50, truth)


def test_a_program_is_corrected_for_the_errors_remaining_after_the_control(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, truth: TruthMachine, section: ControlSection
) -> None:
    text = (SAMPLES / "cone_frustum.nc").read_text()
    meant = np.array([position for _, position in run_iso(text)])
    known = compensate(text, dmu50, calibration.with_control(section))
    done = np.array([position for _, position in run_iso(known.text)])
    after, _ = truth.deviations(driven(tmp_path, done), meant)
    assert after.max() <= ROUNDING_UM + SECOND_ORDER_UM
    # Without the section, the same error would be corrected twice.
    blind = compensate(text, dmu50, calibration)
    twice, _ = truth.deviations(driven(tmp_path, np.array([position for _, position in run_iso(blind.text)])), meant)
    assert np.sqrt(np.mean(twice**2)) > 20.0
    # The reported error before is that of the machine with its control.
    before, _ = truth.deviations(driven(tmp_path, meant), meant)
    report = known.report
    assert report.before.max_um == pytest.approx(before.max(), rel=0.02)  # dense points lie between the block ends
    assert report.control is not None and report.control.axes == ("X", "Y", "Z")
    moved = np.linalg.norm(driven(tmp_path, meant) - meant, axis=1) * 1e3
    assert report.control.max_um == pytest.approx(moved.max(), rel=0.02)
    assert "its tables (X.comp, Y.comp, Z.comp, joints.ini; axes X Y Z) correct" in report.to_text()


def test_errors_measured_with_active_tables_are_corrected_in_full(
    dmu50: Machine, calibration: Calibration, section: ControlSection
) -> None:
    text = (SAMPLES / "cone_frustum.nc").read_text()
    left = calibration.with_control(replace(section, errors_are="remaining"))
    result = compensate(text, dmu50, left)
    assert result.text == compensate(text, dmu50, calibration).text
    assert (
        "were measured with its tables active (X.comp, Y.comp, Z.comp, joints.ini): keep them active"
        in result.report.to_text()
    )


def test_the_section_is_read_back(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, section: ControlSection
) -> None:
    """File names are relative to the calibration; the errors do not change."""
    (tmp_path / "sub").mkdir()
    path = tmp_path / "sub" / "c.yaml"
    calibration.with_control(section).save(path)
    assert "file: ../X.comp" in path.read_text()
    again = Calibration.load(path, dmu50)
    assert again.control is not None and again.control.errors_are == "uncorrected"
    assert [entry.file.resolve() for entry in again.control.tables] == [entry.file for entry in section.tables]
    assert [effect.name for effect in again.corrections] == [f"control:linuxcnc {axis}" for axis in "XYZ"]
    names = [effect.name for effect in again.effects]
    assert [effect.name for effect in again.with_control(None).effects] == names[:-3]
    assert again.where(lambda name: name == "control:linuxcnc Y").effects == again.corrections[1:2]
    rows, classes = error_budget(dmu50, again, tool_length_mm=LENGTH)
    peak = {row.name: row.peak for row in rows}
    assert peak["control:linuxcnc X"] == pytest.approx(peak["E_XX"], rel=0.02)
    alone = {row.name: row.tool_rms_um for row in classes}
    # Positioning errors and the control's correction of them are equally large and of opposite sign.
    assert alone["control"] == pytest.approx(alone["L-POS"], rel=0.02)
    bare = {row.name: row for row in error_budget(dmu50, calibration, tool_length_mm=LENGTH)[1]}
    assert alone["all"] != pytest.approx(bare["all"].tool_rms_um, rel=0.02)


@pytest.mark.parametrize("change", ["table", "class", "gone"])
def test_the_state_of_the_control_tables_must_be_given(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, section: ControlSection, change: str
) -> None:
    path = tmp_path / "c.yaml"
    calibration.with_control(section).save(path)
    if change == "table":
        (tmp_path / "Y.comp").write_text((tmp_path / "Y.comp").read_text().replace("22.5", "22.6"))
    elif change == "gone":
        (tmp_path / "Y.comp").unlink()
    else:
        path.write_text(path.read_text().replace("L-POS", "L-POSE", 1))
    with pytest.raises(InputError) as caught:
        Calibration.load(path, dmu50)
    message = str(caught.value)
    assert {"table": "not the control table", "gone": "cannot be read", "class": "L-POSE"}[change] in message
    assert ("c.yaml:" if change == "class" else "Y.comp") in message


def test_classes_corrected_by_one_table_stay_together(
    dmu50: Machine, calibration: Calibration, section: ControlSection, truth: TruthMachine, tmp_path: Path
) -> None:
    text = "G90\nG1 X100 Y100 Z-100 B30 C10 F500\nX300 Y250\n"
    known = calibration.with_control(section)
    meant = np.array([position for _, position in run_iso(text)])
    for scope in ("L-VOL R-VOL", "L-STR L-ANG"):
        result = compensate(text, dmu50, known, scope=Scope.parse(scope.split()))
        assert result.report.complete
    # Positioning errors alone, corrected by the control: almost nothing remains to be corrected.
    result = compensate(text, dmu50, known, scope=Scope.parse(["L-POS"]))
    done = np.array([position for _, position in run_iso(result.text)])
    off = np.abs(
        (driven(tmp_path, done) - meant)[:, :3]
        + 1e-3
        * np.array([[truth.curve(f"E_{axis}{axis}", q) for axis, q in zip("XYZ", row, strict=False)] for row in meant])
    )
    assert off.max() <= 0.6e-3
    mixed = replace(section, tables=tuple(replace(one, classes=("L-POS", "L-STR")) for one in section.tables))
    with pytest.raises(InputError, match="cannot be split"):
        compensate(text, dmu50, calibration.with_control(mixed), scope=Scope.parse(["L-POS"]))
    with pytest.raises(InputError, match="does not model the control's own tables"):
        compensate(text, dmu50, known, method="thesis")


def test_backlash_corrected_by_the_control_is_not_corrected_again(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, truth: TruthMachine
) -> None:
    """−6 µm of backlash in X: extra moves at its reversals, unless a table of both directions corrects it."""
    text = "G90\nG1 X100 Y100 Z-100 B30 C10 F500\nX300\nX200\nX400\n"
    played = replace(calibration, extra=(Reversal(dmu50.by_name["X"], -6.0),))
    (note,) = compensate(text, dmu50, played).report.reversals
    assert note.taken_up > 0
    whole = compensate(text, dmu50, played.with_control(write(tmp_path, dmu50, truth, "X", up=-6.0)))
    assert whole.report.reversals == ()
    (half,) = compensate(text, dmu50, played.with_control(write(tmp_path, dmu50, truth, "X", up=-4.0))).report.reversals
    assert half.size == pytest.approx(-2.0, abs=2e-3)  # the last digit of the table
    rows = np.loadtxt(tmp_path / "X.comp")
    rows[10:, 1] += 3e-3
    np.savetxt(tmp_path / "X.comp", rows, fmt="%.6f")
    uneven = ControlSection(
        "uncorrected",
        tuple(TableEntry.of(tmp_path / name, "linuxcnc", ["L-POS"]) for name in ("X.comp", "joints.ini")),
    )
    with pytest.raises(InputError, match="varies along the axis"):
        compensate(text, dmu50, played.with_control(uneven))


@pytest.mark.slow
def test_measured_under_its_control_the_machine_is_consistent(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, section: ControlSection
) -> None:
    """Readings of a machine whose control corrects its errors; diagnosis without knowledge of that reports it."""
    rng = np.random.default_rng(5)
    of = hidden.rounded(hidden.plan(rng, poses=20, rounds=2))
    read = hidden.noisy(hidden.points(replace(of, q=driven(tmp_path, of.q)), []), rng, "isotropic", 2e-3)
    data = Measurements.load(hidden.write(tmp_path / "measured.csv", of, read, u_mm=2e-3), dmu50)
    names = ("E_XX[0]", "E_XX[1]")
    known = replace(calibration, joint=Covariance(names, read_only(np.eye(2) * 0.01))).with_control(section)
    assert diagnose(data, dmu50, known).verdict == "consistent"
    assert {cause.effect for cause in diagnose(data, dmu50, calibration).causes} >= {"positioning"}


def test_identify_with_active_tables(
    tmp_path: Path, dmu50: Machine, calibration: Calibration, section: ControlSection
) -> None:
    """``twin identify --control``: the errors are those that remain with the tables; the file is read back correctly."""
    found = tables_on([f"linuxcnc={entry.file}" for entry in section.tables], dmu50)
    assert found.errors_are == "remaining" and [one.sha256 for one in found.tables] == [
        one.sha256 for one in section.tables
    ]
    path = tmp_path / "left.yaml"
    calibration.with_control(found).save(path)
    again = Calibration.load(path, dmu50)
    assert again.corrections == () and again.control is not None
    assert [entry.file.resolve() for entry in again.control.tables] == [entry.file for entry in section.tables]
    with pytest.raises(InputError, match=r"linuxnc=X.comp' \(did you mean linuxcnc\?\)"):
        tables_on(["linuxnc=X.comp"], dmu50)
    with pytest.raises(InputError, match="read with the INI file"):
        tables_on([f"linuxcnc={tmp_path / 'X.comp'}"], dmu50)
