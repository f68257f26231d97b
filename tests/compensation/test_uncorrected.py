"""Errors that cannot be corrected: refused where the cut would be wrong, otherwise listed with their size, never called corrected.

Sizes are compared with an independent machine model that shares no code with `twin`.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import refused, twin
from tests.compensation.test_compensate import LENGTH, ROUNDING_UM, compensate
from tests.nc.nc_support import iso_positions
from tests.truth.machine import RANGES, TruthMachine, in_datum, run_iso, written
from twin import cli
from twin._common.errors import InputError, OutputError
from twin.compensation import Compensator, Options, compensate_file
from twin.compensation.programs.report import CorrectionTally, LineNote, grouped
from twin.compensation.programs.uncorrected import FoundShortfalls, ShortfallTally
from twin.compensation.programs.words import Setup
from twin.compute.native.solver import OUT_OF_RANGE
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.iso16907 import Scope
from twin.nc.iso.dialect import Iso
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse, Solution
from twin.tool.uncertainty import ToolUncertainty

ARC = "G0 X100 Y5 Z-100\nG1 F500 Y2\nG3 X96 Y-2 I-4 J0\n"


@pytest.fixture(scope="module")
def truth(calibration: Calibration) -> TruthMachine:
    assert calibration.path is not None
    return TruthMachine(calibration.path, LENGTH)


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str]:
    with pytest.raises(SystemExit) as ended:
        cli.main([str(argument) for argument in arguments])
    return int(ended.value.code or 0), capsys.readouterr().out


# --- arcs ------------------------------------------------------------------------------------------------------------


def test_an_arc_out_of_range_is_refused_with_the_program_s_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    part, out = tmp_path / "p.nc", tmp_path / "o.nc"
    part.write_text(ARC)
    said = refused(capsys, "compensate", part, "-o", out)
    assert f"{part}:3: the arc ends at Y -2, below the axis's minimum 0" in said
    assert said.rstrip().endswith("is the work offset missing? (--work-offset)")
    assert not out.exists()
    code, _ = run(capsys, "compensate", part, "-o", out, "--work-offset", "Y=100")
    assert code == 0 and out.exists()


@pytest.mark.parametrize("radius", [4.0, 0.5])
@pytest.mark.parametrize("size_um", [100.0, 5.0])
@pytest.mark.parametrize("method", ["exact", "thesis"])
def test_no_arc_is_half_corrected(
    dmu50: Machine, calibration: Calibration, radius: float, size_um: float, method: str
) -> None:
    """At any size of the correction, an arc whose start is moved and whose centre is not would have another radius."""
    largest = 116.0  # µm, of the illustrative machine
    small = calibration if size_um > 50.0 else _scaled(calibration, size_um / largest)
    y = radius / 2.0
    text = f"G0 X100 Y5 Z-100\nG1 F500 Y{y}\nG3 X{100 - radius} Y{y - radius} I-{radius} J0\nG1 X90 Y10\n"
    with pytest.raises(InputError, match=r"p.nc:3: the arc ends at Y -") as caught:
        compensate(text, dmu50, small, method=method)
    assert caught.value.setting == "work offset"


def _scaled(calibration: Calibration, factor: float) -> Calibration:
    from types import MappingProxyType

    curves = {
        name: replace(curve, coefficients=tuple(factor * c for c in curve.coefficients))
        for name, curve in calibration.curves.items()
    }
    return replace(calibration, curves=MappingProxyType(curves), squareness={}, location={})


def test_an_arc_that_bulges_out_of_range_is_refused(dmu50: Machine, calibration: Calibration) -> None:
    """Both end points are within the range of Y, its lowest point is not."""
    with pytest.raises(InputError, match=r"p.nc:2: the arc passes Y -3, below the axis's minimum 0"):
        compensate("G0 X100 Y1 Z-100\nG3 X108 Y1 I4 J0 F500\n", dmu50, calibration)


def test_an_arc_whose_correction_leaves_the_range_is_compensated_whole(
    dmu50: Machine, calibration: Calibration
) -> None:
    """The arc ends at Y = 0 and the correction needs less: the chords stop at the limit, and the report states the error."""
    result = compensate("G0 X100 Y5 Z-100\nG1 F500 Y4\nG3 X96 Y0 I-4 J0\n", dmu50, calibration)
    assert "G3" not in result.text
    (left,) = result.report.not_corrected
    assert left.kind == "range" and set(left.lines) == {3} and "stopped at the limit" in left.reason
    assert min(position[1] for _, position in run_iso(result.text, {"B": 0.0, "C": 0.0})) >= 0.0


def test_what_cannot_be_read_back_is_a_defect_not_bad_input(
    dmu50: Machine, calibration: Calibration, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The line number is that of the output, which the user cannot find in the program."""
    text = "G0 X100 Y5 Z-100\nG1 F500 Y2\n"
    monkeypatch.setattr("twin.nc.iso.dialect.IsoRewriter.write", lambda self, *args: b"G1 X1..2\n")
    with pytest.raises(OutputError, match=r"line \d+ of the output"):
        compensate(text, dmu50, calibration)
    part = tmp_path / "p.nc"
    part.write_text(text)
    with pytest.raises(OutputError, match=r"line \d+ of the output"):
        compensate_file(part, tmp_path / "o.nc", dmu50, calibration)
    assert not (tmp_path / "o.nc").exists()


# --- orientation -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("z", [0.0, -0.001, -400.0])
def test_the_point_precedes_the_orientation_where_a_linear_axis_has_no_travel(
    dmu50: Machine, calibration: Calibration, z: float
) -> None:
    """At the limit of Z with B 30, C 45: Z cannot follow the correction of B and C, so these stay as programmed."""
    text = f"G90\nG0 X400 Y400 Z-100 B30 C45\nG0 Z{z}\n"
    for length in (0.0, LENGTH):
        machine = TruthMachine(calibration.path, length)  # type: ignore[arg-type]
        result = compensate(text, dmu50, calibration, tool_length_mm=length)
        meant, done = (np.array([q for _, q in run_iso(one)]) for one in (text, result.text))
        before_um, before_urad = machine.deviations(meant, meant)
        after_um, after_urad = machine.deviations(done, meant)
        assert before_urad.min() > 100.0 and after_urad[0] <= 15.0
        relaxed = [one for one in result.report.not_corrected if "the point would be farther off" in one.reason]
        assert bool(relaxed) == (z > -0.1) == (done[1, 3] == 30.0)
        assert after_um[1] < before_um[1] if relaxed else after_urad[1] <= 15.0
        for one in relaxed:
            assert (one.kind, one.lines) == ("orientation", (3,))
            assert one.worst == pytest.approx(after_urad[1], abs=10.0)  # the words' rounding


@pytest.mark.parametrize("seed", range(4))
def test_a_position_at_a_limit_is_rounded_towards_the_inside(dmu50: Machine, tmp_path: Path, seed: int) -> None:
    """The work offset is between two least increments, so that no word gives the limit itself."""
    rng = np.random.default_rng(46 + seed)
    written(tmp_path / "c.yaml", in_datum(rng, size=60.0))
    low, high = np.array(list(RANGES.values())).T
    offset = np.array([250.0, 225.0, -200.0, 10.0, 0.0]) + rng.uniform(-5e-4, 5e-4, 5)
    inward = np.tile([1.0, 1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0], (5, 1)).T
    at = np.where(inward > 0.0, low, high) + inward * rng.choice([0.0, 0.002, 0.01], (8, 5))
    at[:, 4] = rng.uniform(30.0, 40.0, 8)
    words = np.where(inward > 0.0, np.ceil((at - offset) * 1e3), np.floor((at - offset) * 1e3)) / 1e3
    text = "".join("G1 F500 X{:.3f} Y{:.3f} Z{:.3f} B{:.3f} C{:.3f}\n".format(*row) for row in words)
    known = Calibration.load(tmp_path / "c.yaml", dmu50)
    setup = Setup(work_offset=dict(zip(RANGES, offset.tolist(), strict=True)))
    result = compensate(text, dmu50, known, setup=setup, tolerance_mm=1.0)
    reached = np.array([position for _, position in iso_positions(result.text)]) + offset
    assert np.all(reached >= low - 1e-9) and np.all(reached <= high + 1e-9)
    assert np.count_nonzero(np.minimum(reached - low, high - reached)[:, :4] < 1e-3, axis=0).all(), "every limit is met"


MODES = {"axis": "p.nc", "tool tip": "p.nc", "vector": "p.nc", "posted": "p.cls"}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", range(2))
def test_nothing_is_worse_than_programmed_at_the_limits(dmu50: Machine, tmp_path: Path, mode: str, seed: int) -> None:
    """Random errors, and positions at and near the limits of axes: at block ends and between them."""
    rng = np.random.default_rng(313 + seed)
    truth = written(tmp_path / "c.yaml", in_datum(rng, size=60.0))
    truth.tool_length = LENGTH
    low, high = np.array(list(RANGES.values())).T
    inward = rng.choice([-1.0, 1.0], 5)
    far = rng.choice([0.0, 0.0, 0.01, 0.04, 30.0], (8, 5))
    far[:, 4] = rng.uniform(30.0, 40.0, 8)
    q = np.round(np.where(inward > 0.0, low, high) + inward * far, 3)
    pose = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=LENGTH).forward(q)
    values = {"axis": q, "tool tip": np.hstack([pose.point_mm, q[:, 3:]])}.get(
        mode, np.hstack([pose.point_mm, pose.axis])
    )
    words = "X{:.6f} Y{:.6f} Z{:.6f} " + ("I{:.9f} J{:.9f} K{:.9f}" if mode == "vector" else "B{:.3f} C{:.3f}")
    form = "GOTO/" + ",".join(["{:.9f}"] * 6) if mode == "posted" else f"G1 {words} F500"
    head = {"axis": "G90\n", "tool tip": "G43.4 H1\n", "vector": "G43.5 H1\n", "posted": "PARTNO A\nUNITS/MM\n"}[mode]
    text = head + "".join(f"{form.format(*row)}\n" for row in values)
    known = Calibration.load(tmp_path / "c.yaml", dmu50)
    result = compensate(text, dmu50, known, MODES[mode], tolerance_mm=0.005)
    ends = np.append(np.diff(result.moves) != 0, True)
    meant, done = result.nominal[ends], result.commands[ends]
    before_um, after_um = truth.deviations(meant, meant)[0], truth.deviations(done, meant)[0]
    assert np.count_nonzero(after_um > ROUNDING_UM) >= 1, "limits stop some"
    assert np.all(after_um <= before_um + 1.0)
    if mode == "axis":
        assert np.all(result.commands >= low - 1e-6) and np.all(result.commands <= high + 1e-6)
        for share in (0.2, 0.5, 0.8):
            meant, done = (q[:-1] + share * np.diff(q, axis=0) for q in (result.nominal, result.commands))
            meant, done = meant[::4], done[::4]
            before_um, after_um = truth.deviations(meant, meant)[0], truth.deviations(done, meant)[0]
            assert np.all(after_um <= before_um + 1.0 + 5.0)  # rounding and tolerance


def test_a_point_that_no_position_comes_nearer_to_stays_as_programmed(
    dmu50: Machine, calibration: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A solver that reports positions far off: the blocks keep their words, and the report names them."""
    solve = Inverse.solve

    def astray(self: Inverse, *args: Any, **options: Any) -> Solution:
        found = solve(self, *args, **options)
        return replace(found, positions=found.positions + 1.0, code=np.full(len(found.code), OUT_OF_RANGE))

    text = "G90\nG0 X400 Y400 Z-100 B30 C45\nG1 X300 F500\nG3 X310 Y410 R10\n"
    monkeypatch.setattr(Inverse, "solve", astray)
    result = compensate(text, dmu50, calibration)
    (left,) = [one for one in result.report.not_corrected if one.kind == "range"]
    assert left.lines == (2, 3, 4) and left.missed == (3, 4) and left.reason.endswith("left as programmed")
    assert [q for _, q in run_iso(result.text)][1].tolist() == [300.0, 400.0, -100.0, 30.0, 45.0]


def test_an_orientation_outside_the_curves_domain_is_listed(dmu50: Machine, calibration: Calibration) -> None:
    """The domain of B's curves ends at the position of B, and the correction would turn it further."""
    from types import MappingProxyType

    curves = {
        name: replace(curve, domain=(0.0, 30.0)) if name.endswith("B") else curve
        for name, curve in calibration.curves.items()
    }
    short = replace(calibration, curves=MappingProxyType(curves))
    result = compensate("G90\nG0 X100 Y100 Z-100 B10 C45\nG1 B30 F500\n", dmu50, short)
    (left,) = [one for one in result.report.not_corrected if one.kind == "orientation"]
    done = [q for _, q in run_iso(result.text)][-1]
    assert done[3] == 30.0 and left.lines == (3,) and "B is at its limit of 30°" in left.reason
    reached = Kinematics(dmu50, short, tool_length_mm=LENGTH).forward(done[None])
    meant = Kinematics(dmu50, Calibration.zero(dmu50)).forward(np.array([[100.0, 100.0, -100.0, 30.0, 45.0]]))
    angle_urad = 1e6 * np.linalg.norm(reached.axis - meant.axis)
    assert angle_urad > 50.0 and left.worst == pytest.approx(angle_urad, abs=10.0)  # the words' rounding


def test_an_orientation_not_corrected_at_a_limit_is_listed_with_its_size(
    dmu50: Machine, calibration: Calibration, truth: TruthMachine
) -> None:
    """B = 0 is the end of its range: the correction beyond it is not made, at the limit of Z either."""
    text = "G90\nG0 X100 Y100 Z-100 B30 C45\nG1 B0 F500\nG1 Z0\n"
    result = compensate(text, dmu50, calibration)
    meant, done = (np.array([q for _, q in run_iso(one)]) for one in (text, result.text))
    left_urad = truth.deviations(done[-1:], meant[-1:])[1][0]
    found = [one for one in result.report.not_corrected if one.kind == "orientation"]
    assert left_urad > 100.0 and found
    assert {line for one in found for line in one.lines} >= {3, 4}
    worst = max(found, key=lambda one: one.worst)
    assert worst.unit == "urad" and worst.worst >= 0.9 * left_urad
    assert "corrected, except the blocks below" in result.report.to_text()
    assert {share.left_rms_um for share in result.report.classes if share.corrected} == {None}
    assert result.report.complete is not any(one.missed for one in result.report.not_corrected)
    asked = compensate(text, dmu50, calibration, scope=Scope.parse(["L-VOL", "R-VOL", "FOR"]))
    assert {3, 4} <= {line for one in asked.report.not_corrected for line in one.missed}
    assert not asked.report.complete


# --- blocks that begin uncorrected -----------------------------------------------------------------------------------


@pytest.mark.parametrize("streamed", [False, True])
def test_the_block_after_a_machine_coordinate_move_is_listed(
    dmu50: Machine, calibration: Calibration, truth: TruthMachine, tmp_path: Path, streamed: bool
) -> None:
    """G53 moves Z to the position written; the next block begins there, with the uncorrected error of Z."""
    text = "G90\nG0 X100 Y100 Z-100 B30 C45\nG1 X120 F500\nG53 G0 Z-20.\nG1 X140\nX160\n"
    if streamed:
        part, out = tmp_path / "p.nc", tmp_path / "o.nc"
        part.write_text(text)
        report = compensate_file(part, out, dmu50, calibration, options=Options(tool_length_mm=LENGTH))
        written = out.read_text()
    else:
        result = compensate(text, dmu50, calibration)
        report, written = result.report, result.text
    (left,) = report.not_corrected
    assert left.lines == left.missed == (5,) and "begins at an uncorrected position" in left.reason
    assert not report.complete and "NOT ALL CORRECTED: 1 of 3 cutting blocks" in report.headline
    # Actual axis positions: X, Y, B, C from the block before, Z from G53.
    plain = [line for line in written.splitlines() if "G53" not in line]
    stands = run_iso("\n".join(plain))[1][1].copy()
    stands[2] = -20.0
    meant = np.array([120.0, 100.0, -20.0, 30.0, 45.0])
    off_um = truth.deviations(stands[None], meant[None])[0][0]
    assert off_um > 20.0
    # The first of five points inside the block is a tenth of the way on, and the error falls in proportion.
    assert left.worst == pytest.approx(0.9 * off_um, rel=0.03)


def test_a_rapid_that_cannot_be_corrected_is_no_failure(dmu50: Machine, calibration: Calibration) -> None:
    """No material is cut there: exit status 0, and 3 with --strict."""
    text = "G90\nG0 X100 Y100 Z-100\nG1 X120 F500\nG0 Z-50\nG0 X0 Y0\n"
    report = compensate(text, dmu50, calibration).report
    assert {line for one in report.not_corrected for line in one.lines} == {5}
    assert report.complete and not report.strictly_complete
    assert report.headline.startswith("corrected, except 1 of 4 blocks")


def test_a_correction_short_by_less_than_the_tolerance_is_met(dmu50: Machine, calibration: Calibration) -> None:
    """A cutting block stopped at a limit counts only by its remaining error."""
    text = "G90\nG0 X100 Y100 Z-100\nG1 X120 F500\nG1 X0\n"
    strict = compensate(text, dmu50, calibration)
    (left,) = [one for one in strict.report.not_corrected if one.kind == "range"]
    assert left.lines == (4,) and not strict.report.complete
    loose = compensate(text, dmu50, calibration, tolerance_mm=2e-3 * left.worst)
    assert loose.report.complete and not loose.report.strictly_complete


# --- nothing corrected -----------------------------------------------------------------------------------------------


def test_nothing_corrected_is_the_headline_and_no_success(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, out, report = tmp_path / "p.nc", tmp_path / "o.nc", tmp_path / "r.json"
    part.write_text("G90\nG0 X10 Y10 Z-10 B30 C10\nG1 X20 F500\n")
    code, said = run(capsys, "compensate", part, "-o", out, "-m", "xyzbc_trunnion", "--json", report)
    assert code == 3
    assert "NOTHING CORRECTED: no error motion is in scope" in said.splitlines()[0]
    assert json.loads(report.read_text())["complete"] is False
    assert out.read_bytes() == part.read_bytes()
    part.write_text("G90\n" + "".join(f"G1 X{-x} Y-5 Z20 F500\n" for x in range(1, 1819)))
    code, said = run(capsys, "compensate", part, "-o", out, "--json", report)
    assert code == 3
    first = said.splitlines()[0]
    assert "NOTHING CORRECTED: 1,818 of 1,818 blocks" in first and "is the work offset missing?" in first
    data = json.loads(report.read_text())
    (one,) = data["not_corrected"]
    assert one["blocks"] == 1818 and one["lines"] == list(range(2, 1820))
    assert one["worst"] == {"value": 1818.0, "unit": "mm", "line": 1819}
    assert said.count("outside the range") == 1, "one line a reason"


def test_nothing_corrected_with_several_programs_and_a_path(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a.nc", "b.nc"):
        (tmp_path / name).write_text("G90\nG0 X10 Y10 Z-10 B30 C10\nG1 X20 F500\n")
    words = ["-m", "xyzbc_trunnion", "--workers", 1]
    code, said = run(capsys, "compensate", tmp_path / "a.nc", tmp_path / "b.nc", "-o", tmp_path / "out", *words)
    assert code == 3 and said.count("NOTHING CORRECTED") == 2
    code, said = run(capsys, "path", tmp_path / "a.nc", "-o", tmp_path / "p.nc", "-m", "xyzbc_trunnion")
    assert code == 3 and "NOTHING CORRECTED" in said.splitlines()[0]
    code, said = run(
        capsys, "path", tmp_path / "a.nc", "-o", tmp_path / "p.nc", "-m", "xyzbc_trunnion", "--no-compensate"
    )
    assert code == 0


def test_strict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    part, other = tmp_path / "p.nc", tmp_path / "q.nc"
    part.write_text("G90\nG0 X100 Y100 Z-100\nG1 X120 F500\nG0 X0 Y0\n")
    other.write_text("G90\nG0 X100 Y100 Z-100\nG1 X120 F500\n")
    for words, expected in (((), 0), (("--strict",), 3)):
        assert run(capsys, "compensate", part, "-o", tmp_path / "o.nc", *words)[0] == expected
        several = ("compensate", part, other, "-o", tmp_path / "out", "--workers", 1)
        assert run(capsys, *several, *words)[0] == expected
        assert run(capsys, "path", part, "-o", tmp_path / "f.nc", *words)[0] == expected
    assert run(capsys, "compensate", other, "-o", tmp_path / "o.nc", "--strict")[0] == 0


# --- the report ------------------------------------------------------------------------------------------------------


def test_a_tally_by_hand() -> None:
    tally = ShortfallTally()
    tally.add(
        FoundShortfalls(
            "range", "far", "um", np.array([3, 3, 9]), np.array([1.0, 2.5, 2.0]), np.array([True, False, False])
        )
    )
    tally.add(FoundShortfalls("range", "far", "um", np.array([12]), np.array([2.4]), np.array([True])))
    tally.add(FoundShortfalls("tolerance", "near", "um", np.array([7]), np.array([0.5]), np.array([False])))
    first, second = tally.shortfalls()
    assert (first.lines, first.missed, first.worst, first.worst_line) == ((3, 9, 12), (3, 12), 2.5, 3)
    assert first.text == "3 blocks (lines 3, 9, 12): far; worst 2.50 µm (line 3)"
    assert second.lines == (7,) and second.missed == ()
    tally.add(FoundShortfalls("range", "far", "um", np.arange(100, 200), np.zeros(100), np.zeros(100, dtype=bool)))
    assert "103 blocks (lines 3, 9, 12, 100, 101, 102, 103, 104 … and 95 more)" in tally.shortfalls()[0].text


def test_corrections_and_their_uncertainty_by_hand(dmu50: Machine) -> None:
    """A block counts once, with the RMS over its pieces; the headline compares RMS with RMS, and equal is not shown."""
    tool = ToolUncertainty(Kinematics(dmu50, Calibration.zero(dmu50)))
    tally = CorrectionTally("tool point", "um")
    size = np.array([3.0, 4.0, 10.0])
    tally.add(
        np.array([5, 5, 8]),
        np.array([0, 0, 1]),
        size,
        np.array([[3.6, 1.0, 0.0, 2.0]] * 2 + [[9.0, 1.0, 0.0, 2.0]]),
        tool,
    )
    found = tally.correction()
    assert found is not None
    assert (found.blocks, found.max, found.max_line, found.max_expanded) == (2, 10.0, 8, 9.0)
    assert found.rms == pytest.approx(np.sqrt(125.0 / 3.0))
    assert found.expanded_rms == pytest.approx(np.sqrt(106.92 / 3.0)) and found.expanded_max_line == 8
    assert found.standard_rms == pytest.approx((1.0, 0.0, 2.0))
    # Its second piece alone is larger than 3.6, both together are √12.5.
    (below,) = found.below.tolist()
    assert below == pytest.approx((5, np.sqrt(12.5), 3.6))
    known = replace(found, known=True, without_uncertainty=(), rms=5.0, max_expanded=9.0, expanded_rms=4.0)
    assert known.shown is True
    assert replace(known, expanded_rms=5.0).shown is False
    assert replace(known, without_uncertainty=("E_XX",)).shown is None


def test_notes_of_one_text_are_one_line() -> None:
    notes = [LineNote(4, "passed"), LineNote(5, "assumed"), LineNote(9, "passed")]
    assert grouped(notes) == ["lines 4, 9: passed", "line 5: assumed"]


def test_nothing_corrected_in_html(dmu50: Machine) -> None:
    text = "G90\nG0 X100 Y100 Z-100\nG1 X120 F500\n"
    program = Iso().read(text.encode(), "p.nc")
    result = Compensator(dmu50, Calibration.zero(dmu50), Options(setup=Setup())).compensate(program, Iso())
    assert "NOTHING CORRECTED" in result.display().html().text and "NOTHING CORRECTED" in str(result)


@pytest.mark.slow
def test_every_sample_program_is_fully_corrected(tmp_path: Path) -> None:
    """The bundled program, as in the README: exit status 0, everything corrected."""
    done = twin("compensate", "cone_frustum.nc", "-o", tmp_path / "o.nc", "--tool-length", 120, "--strict")
    assert done.returncode == 0, done.stdout
    assert re.match(r"\S*cone_frustum\.nc on DMU 50 eVolution: corrected\n", done.stdout)
    assert ROUNDING_UM < 1.0


# --- increments of zero at unknown positions -------------------------------------------------------------------------


def test_increments_of_zero_after_a_reference_stay_and_later_blocks_are_corrected(
    dmu50: Machine, calibration: Calibration, truth: TruthMachine
) -> None:
    """B and C are at the reference, wherever that is: rapids stay as written, and X goes on from where the output has it."""
    head = "G21 G90\nG0 X100 Y100 Z-100 B10 C20\n"
    tail = "G90 B30 C40\nG1 X120 F500\n"
    text = f"{head}G91 G28 B0 C0\nG0 X5 B0 C0\nX5 C0\n{tail}"
    result = compensate(text, dmu50, calibration)
    out = result.text.splitlines()
    assert {"G91 G28 B0 C0", "G0 X5 B0 C0", "X5 C0"} <= set(out)
    assert "position of B, C not yet known: rapid passed through unchanged" in result.report.to_text()
    done = np.array([q for _, q in iso_positions(result.text)])[-2:]
    meant = np.array([[110.0, 100.0, -100.0, 30.0, 40.0], [120.0, 100.0, -100.0, 30.0, 40.0]])
    off_um, _ = truth.deviations(done, meant)
    assert off_um.max() < ROUNDING_UM
    for old, new, line in (("G0 X5 B0", "G1 F100 X5 B0", 4), ("X5 B0", "X5 B0.001", None)):
        changed = compensate(text.replace(old, new), dmu50, calibration)
        assert changed.text.splitlines()[-2:] == out[-2:] and new in changed.text
        lost = [one.missed[0] for one in changed.report.not_corrected if one.kind == "unknown"]
        assert lost == ([] if line is None else [line])


@pytest.mark.parametrize(
    ("word", "hint"), [("A5", "A is an axis of trunnion_ac"), ("W5", "no machine of twin has W"), ("U=5", "has U")]
)
def test_the_machine_that_has_an_axis_is_named(dmu50: Machine, calibration: Calibration, word: str, hint: str) -> None:
    with pytest.raises(InputError, match="unknown axis") as refused:
        compensate(f"G0 X1 Y1 Z-1\nG0 {word}\n", dmu50, calibration)
    assert refused.value.line == 2 and refused.value.expected.endswith(hint)
