"""Tables and reports for machines other than five-axis mills: supported outputs are made, others are refused with a reason.

The errors of the drill are given by a formula in this file, and its tables are evaluated by `tests.controls.cases`.
"""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from tests.controls.cases import BY_HAND
from tests.controls.test_control_tables import state_of
from tests.real import stage
from tests.truth import few_axes
from twin._common.errors import InputError
from twin.cli import main
from twin.compensation import compensate
from twin.identification import Identification, identify
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.model.calibration import Calibration
from twin.planning import Kit, plan
from twin.reporting.page import machine_html
from twin.reporting.plots import plot_motion
from twin.reporting.result import machine_report

UM, URAD = 1e-3, 1e-6
MADE = datetime(2026, 11, 22, tzinfo=UTC)
ERRORS = """schema: twin.calibration/1
machine: drill
source: by hand
curves:
  E_XX: {unit: um, domain: [0, 300], basis: power, coefficients: [0, 8, 3]}
  E_YX: {unit: um, domain: [0, 300], basis: power, coefficients: [0, 0, 4]}
  E_ZX: {unit: um, domain: [0, 300], basis: power, coefficients: [0, 0, -6]}
  E_AX: {unit: urad, domain: [0, 300], basis: power, coefficients: [0, 30]}
  E_BX: {unit: urad, domain: [0, 300], basis: power, coefficients: [0, 60]}
  E_ZZ: {unit: um, domain: [-200, 0], basis: power, coefficients: [0, 5]}
"""
JOINT = "{unit: urad, domain: [-360, 360], basis: fourier, coefficients: [0, 20, 5]}"


def off_mm(commands: np.ndarray, meant: np.ndarray) -> np.ndarray:
    """Return the errors (n, 3) of the quill's nose in the frame of the table, mm.

    The errors are those of the table: its shift and rotation act on the point with the opposite sign.
    """
    x, z = commands.T
    u, v = x / 150.0 - 1.0, z / 100.0 + 1.0
    shift = UM * np.stack([8 * u + 3 * u**2, 4 * u**2, -6 * u**2], axis=1)
    turn = URAD * np.stack([30 * u, 60 * u, 0 * u], axis=1)
    place = np.stack([150.0 - x, 0 * x, 200.0 + z + UM * 5 * v], axis=1)
    point = place - shift - np.cross(turn, place)
    return point - np.stack([150.0 - meant[:, 0], 0 * x, 200.0 + meant[:, 1]], axis=1)


@pytest.fixture
def drill(tmp_path: Path) -> Path:
    (tmp_path / "mine.yaml").write_text(ERRORS)
    return few_axes.write_drill(tmp_path)


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    return int(caught.value.code or 0)


def control(machine: Path, kind: str, *more: object) -> int:
    folder = machine.parent
    where = ("--machine", machine, "-c", folder / "mine.yaml", "--json", folder / "account.json")
    return run("control", "--to", kind, "-o", folder / "tables", *where, *more)


@pytest.mark.parametrize("kind", ["linuxcnc", "heidenhain", "siemens"])
def test_tables_reduce_the_errors_of_a_drill(kind: str, drill: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert control(drill, kind, "--tolerance", "0.0002") == 0
    rng = np.random.default_rng(2)
    meant = np.stack([rng.uniform(0, 300, 200), rng.uniform(-200, 0, 200)], axis=1)
    if kind != "siemens":
        meant[:100, 1], meant[100:, 0] = (
            -100.0,
            150.0,
        )  # no products: exact only at the other axis's position assumed in the tables
    commands, machine = meant.copy(), Machine.load(drill)
    for i, axis in enumerate("XZ"):
        commands[:, i] += UM * BY_HAND[kind](drill.parent / "tables", axis, state_of(machine, meant))
    before, after = np.abs(off_mm(meant, meant)) / UM, np.abs(off_mm(commands, meant)) / UM
    assert before[:, 0].max() > 10.0 and before[:, 2].max() > 4.0
    # Two tables of 0.2 µm each along either axis; LinuxCNC moves no axis by another.
    assert after[:, 0].max() < 0.5 and (after[:, 2].max() < 0.5) == (kind != "linuxcnc")
    np.testing.assert_allclose(after[:, 1], before[:, 1], atol=0.01)  # no axis moves in that direction
    account = json.loads((drill.parent / "account.json").read_text())
    shares = {one["name"]: (one["share"], one["why"]) for one in account["errors"]}
    assert shares["E_AX"] == ("no", "no linear axis moves the point in its direction")
    assert shares["E_YX"][0] == "no" and shares["E_XX"] == shares["E_ZZ"] == ("whole", "")
    # No program runs on it, so the text does not mention programs.
    assert account["error_at_tool"]["with_tables_and_program"] is None
    text = (drill.parent / "tables" / "README.txt").read_text()
    assert text in capsys.readouterr().out and "NC program" not in text and "While these tables are switched on" in text

    files = [
        path for path in (drill.parent / "tables").iterdir() if path.name not in ("README.txt", "calibration.yaml")
    ]
    where = (
        "--machine",
        drill,
        "-c",
        drill.parent / "mine.yaml",
        "--format",
        kind,
        "--json",
        drill.parent / "read.json",
    )
    assert run("control", "--read", *files, *where) == 0
    found = json.loads((drill.parent / "read.json").read_text())
    assert max(one["differs"] for one in found["differences"] if one["moved"] == one["along"] == "Z") < 0.2


def test_unsupported_formats_and_machines_are_refused(drill: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for kind in ("isg", "grid"):
        assert control(drill, kind) == 2
        assert "tables of single axes" in capsys.readouterr().err
    few_axes.write_drill(drill.parent, second="1 0 0")
    (drill.parent / "mine.yaml").write_text(ERRORS.replace("E_ZZ", "E_XZ"))
    assert control(drill, "siemens") == 2
    message = capsys.readouterr().err
    assert "linearly dependent directions: 'X Z'" in message and "drill.yaml" in message


def test_a_joint_by_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    machine = few_axes.write_robot(tmp_path)
    (tmp_path / "mine.yaml").write_text(
        f"schema: twin.calibration/1\nmachine: arm\nsource: by hand\ncurves: {{E_CJ1: {JOINT}}}\n"
    )
    for kind in ("linuxcnc", "heidenhain"):
        assert control(machine, kind) == 2
        assert "no such axis: 'J1'; expected axes named by one of X Y Z A B C U V W" in capsys.readouterr().err
    assert control(machine, "siemens") == 0
    q = np.random.default_rng(0).uniform(-360, 360, 100)
    state = state_of(Machine.load(machine), np.tile(q[:, None], 6))
    sent = q + np.degrees(URAD * BY_HAND["siemens"](tmp_path / "tables", "J1", state))
    angle = np.radians(sent)
    left = 20 * np.cos(angle) + 5 * np.sin(angle) + np.radians(sent - q) / URAD
    assert np.abs(left).max() < 2.1  # 2 µrad for the µm of the tolerance, and the digits
    assert "with_tables" in (tmp_path / "account.json").read_text()
    assert "reference encoder" in capsys.readouterr().out


def identified(drill: Path, seed: int) -> Identification:
    """Identify the drill with the errors of its file from a measurement plan of one hour."""
    machine = Machine.load(drill)
    truth = Calibration.load(drill.parent / "mine.yaml", machine)
    planned = plan(machine, Kit.default(machine), minutes=60.0, seed=0).table
    readings, _ = simulate(planned, machine, truth, LaserTracker(), np.random.default_rng(seed))
    return identify(readings, machine)


@pytest.mark.slow
def test_the_estimate_of_a_drill_converges_and_insignificant_errors_enter_no_table(drill: Path) -> None:
    """One station and six targets hardly determine the station's rotation: plain steps needed 80 iterations for this seed."""
    found = identified(drill, seed=16)
    machine = found.calibration.machine
    assert found.converged and found.calibration.settled
    assert found.solution.steps <= 25
    found.calibration.save(drill.parent / "found.yaml")
    one = machine_report(machine, Calibration.load(drill.parent / "found.yaml", machine), made=MADE)
    tabled = [c for c in one.budget.errors if c.iso_class in ("L-POS", "L-STR") and c.peak > c.peak_half]
    advice = " ".join(step.text for step in one.advice.steps)
    assert ("L-POS" in advice, "L-STR" in advice) == tuple(
        any(c.iso_class == n for c in tabled) for n in ("L-POS", "L-STR")
    )
    # The suggested command is for this machine.
    assert "`twin plan -o plan.csv --machine drill.yaml --reduce " in advice


def test_an_estimate_that_did_not_settle_is_not_used(
    drill: Path,
    dmu50: Machine,
    calibration: Calibration,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The file is marked, and no program is corrected and no table is made with it."""
    # An estimate whose steps never become small.
    monkeypatch.setattr("twin.identification.solve.CONVERGED_CHANGE", 0.0)
    found = identified(drill, seed=2)
    machine = found.calibration.machine
    assert not found.converged and not found.calibration.settled
    found.calibration.save(drill.parent / "mine.yaml")
    assert "settled: false" in (drill.parent / "mine.yaml").read_text()
    assert control(drill, "siemens") == 2
    assert "mine.yaml: the estimate this calibration comes from did not settle" in capsys.readouterr().err
    report = machine_report(machine, Calibration.load(drill.parent / "mine.yaml", machine), made=MADE)
    assert "Use this calibration" in [step.title for step in report.advice.steps if step.kind == "never"]
    replace(calibration, settled=False).save(drill.parent / "five.yaml")
    with pytest.raises(
        InputError, match=r"five.yaml: .* did not settle: 'settled: false'; expected a settled estimate"
    ):
        compensate("cone_frustum.nc", dmu50, Calibration.load(drill.parent / "five.yaml", dmu50))


def test_a_report_for_a_machine_without_programs(drill: Path) -> None:
    machine = Machine.load(drill)
    one = machine_report(machine, Calibration.load(drill.parent / "mine.yaml", machine), made=MADE)
    done = [step for step in one.advice.steps if step.kind == "do"]
    assert [step.title for step in done] == ["Use the control's axis tables"]
    # The straightness across the plane of both axes is no table's.
    assert (
        "positioning (L-POS), straightness (L-STR) and angular errors of the linear axes (L-ANG) for all"
        in done[0].text
    )
    only_y = Calibration.load(drill.parent / "mine.yaml", machine).where(lambda name: name in ("E_XX", "E_YX"))
    (step,) = [step for step in machine_report(machine, only_y, made=MADE).advice.steps if step.kind == "do"]
    assert "positioning (L-POS) for all" in step.text
    text = machine_html(one)
    assert "not possible on this machine" in text and "the calibration gives no uncertainty</span>" not in text


def test_programs_are_refused_with_the_required_axes(drill: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("compensate", "scene"):
        out = drill.parent / ("out.nc" if command == "compensate" else "out.html")
        assert run(command, "cone_frustum.nc", "-o", out, "--machine", drill) == 2
        assert "drill has 2 linear and 0 rotary axes; expected three linear" in capsys.readouterr().err


@pytest.mark.slow
def test_a_stage_and_an_arm_have_reports(tmp_path: Path) -> None:
    slide = Machine.load(stage.write_machine(tmp_path))
    (tmp_path / "slide.yaml").write_text(
        "schema: twin.calibration/1\nmachine: stage\nsource: by hand\n"
        "curves: {E_XX: {unit: um, domain: [-21, 21], basis: power, coefficients: [0, 3]}}\n"
    )
    text = machine_html(machine_report(slide, Calibration.load(tmp_path / "slide.yaml", slide), made=MADE))
    assert "the machine has no second linear axis and no rotary axis" in text

    arm = Machine.load(few_axes.write_robot(tmp_path))
    (tmp_path / "arm.cal.yaml").write_text(
        f"schema: twin.calibration/1\nmachine: arm\nsource: by hand\ncurves: {{E_CJ1: {JOINT}, E_CJ3: {JOINT}}}\n"
    )
    one = machine_report(arm, Calibration.load(tmp_path / "arm.cal.yaml", arm), made=MADE)
    assert "Angular positioning of J3" in machine_html(one)
    # Two turns on one circle would be two curves on top of each other.
    (plot,) = plot_motion(one.motions[0]).axes
    assert plot.name == "rectilinear" and plot.get_xlabel() == "J1 [°]"
    turned = Machine.load(few_axes.write_robot(tmp_path, reach_deg=180.0))
    (tmp_path / "arm.cal.yaml").write_text(
        f"schema: twin.calibration/1\nmachine: arm\nsource: by hand\ncurves: {{E_CJ1: {JOINT.replace('360', '180')}}}\n"
    )
    within = machine_report(turned, Calibration.load(tmp_path / "arm.cal.yaml", turned), made=MADE).motions[0]
    assert plot_motion(within).axes[0].name == "polar"
