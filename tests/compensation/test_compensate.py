"""Compensated programs, executed on an independent machine model that shares no code with `twin`."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.compensation.heads import body
from tests.model.errors import random_calibration
from tests.truth.machine import TruthMachine, run_iso
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.iso16907 import Scope
from twin.model.motion_curve import Curve
from twin.nc import dialect_for
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty

SAMPLES = Path(__file__).resolve().parents[2] / "twin" / "samples"
LENGTH = 120.0
# B and C at 0.001°, half of it 8.73 µrad each, turn the tool axis by at most sin 45° and 1 of that.
ROUNDING_URAD = 15.0
ROUNDING_UM = 0.9  # three linear words at 0.001 mm: half of 1.73 µm


def compensate(
    text: str, machine: Machine, calibration: Calibration, name: str = "p.nc", **options: object
) -> Compensation:
    dialect = dialect_for(Path(name))
    program = dialect.read(text.encode("latin-1"), name)
    return Compensator(machine, calibration, Options(**{"tool_length_mm": LENGTH, **options})).compensate(
        program, dialect
    )


@pytest.fixture(scope="module")
def truth(calibration: Calibration) -> TruthMachine:
    assert calibration.path is not None
    return TruthMachine(calibration.path, LENGTH)


def test_the_compensated_cone_frustum_is_on_the_nominal_path(
    dmu50: Machine, calibration: Calibration, truth: TruthMachine
) -> None:
    text = (SAMPLES / "cone_frustum.nc").read_text()
    result = compensate(text, dmu50, calibration)
    meant = np.array([position for _, position in run_iso(text)])
    done = np.array([position for _, position in run_iso(result.text)])
    assert meant.shape == done.shape
    before_um, before_urad = truth.deviations(meant, meant)
    after_um, after_urad = truth.deviations(done, meant)
    assert np.sqrt(np.mean(before_um**2)) > 50.0
    assert after_um.max() <= ROUNDING_UM
    assert after_urad.max() <= ROUNDING_URAD
    assert before_urad.max() > 300.0
    assert result.report.after.max_um <= ROUNDING_UM + 1.0  # between ends the tolerance comes on top
    assert result.report.rounding_um == pytest.approx(after_um.max(), abs=1e-6)
    assert result.report.complete


@pytest.mark.slow
def test_long_blocks_are_split_to_the_tolerance(dmu50: Machine, calibration: Calibration, truth: TruthMachine) -> None:
    """Across the whole of X and through a turn of C, the error between end points is no more than tolerance and rounding."""
    text = "G21 G90\nG0 X10 Y20 Z-100 B40 C0\nG1 X490 F500\nG1 Y400\nG1 C300\nG1 X100 Y50 Z-300 B70 C20\n"
    tolerance_um = 1.0
    result = compensate(text, dmu50, calibration, tolerance_mm=tolerance_um * 1e-3)
    assert result.report.split >= 3
    meant = [position for _, position in run_iso(text)]
    done = [position for _, position in run_iso(result.text)]
    fractions = np.linspace(0.0, 1.0, 41)
    ends = np.flatnonzero(np.diff(result.lines, append=-1))  # the last piece of each block
    worst = uncompensated = 0.0
    for block in range(1, len(meant)):
        first, last = ends[block - 1], ends[block]
        pieces = last - first
        for k in range(pieces):
            commands = done[first + k] + fractions[:, None] * (done[first + k + 1] - done[first + k])
            wanted = meant[block - 1] + ((k + fractions) / pieces)[:, None] * (meant[block] - meant[block - 1])
            worst = max(worst, truth.deviations(commands, wanted)[0].max())
        wanted = meant[block - 1] + fractions[:, None] * (meant[block] - meant[block - 1])
        uncompensated = max(uncompensated, truth.deviations(wanted, wanted)[0].max())
    assert uncompensated > 50.0
    # Rotary words rounded at two end points turn the tool between them; the first-order effect is corrected at the end points.
    assert worst <= tolerance_um + ROUNDING_UM


def test_short_blocks_are_not_split(dmu50: Machine, calibration: Calibration) -> None:
    text = "G21 G90\nG0 X250 Y225 Z-100 B40 C0\nG1 X251 F500\nX252\nX253\n"
    assert compensate(text, dmu50, calibration).report.added == 0


def test_every_block_carries_all_corrected_words(dmu50: Machine, calibration: Calibration, truth: TruthMachine) -> None:
    """A classic defect: X is rewritten, but the correction of Y that changes with it is omitted."""
    text = "G90\nG0 X20 Y30 Z-50 B10 C15\n" + "".join(f"X{x}\n" for x in range(40, 480, 20)) + "Y200\nZ-300\n"
    result = compensate(text, dmu50, calibration)
    meant = np.array([p for _, p in run_iso(text)])
    done = np.array([p for _, p in run_iso(result.text)])
    assert truth.deviations(done, meant)[0].max() <= ROUNDING_UM
    assert "Y" in result.text.splitlines()[2]


@pytest.mark.slow
@settings(max_examples=16)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.sampled_from([5.0, 50.0, 300.0]),
    decimals=st.integers(0, 3),
)
def test_compensate_then_execute(
    dmu50: Machine, tmp_path_factory: pytest.TempPathFactory, seed: int, size: float, decimals: int
) -> None:
    """Random machines and random programs with words omitted at random."""
    rng = np.random.default_rng(seed)
    calibration = random_calibration(dmu50, rng, size)
    path = tmp_path_factory.mktemp("truth") / "c.yaml"
    calibration.save(path)
    lines = ["G21 G90"]
    position = None
    for _ in range(int(rng.integers(2, 8))):
        new = np.array(
            [
                rng.uniform(5, 495),
                rng.uniform(5, 445),
                rng.uniform(-395, -5),
                rng.uniform(30, 150),
                rng.uniform(-400, 400),
            ]
        )
        named = rng.random(5) < 0.5 if position is not None else np.ones(5, dtype=bool)
        words = " ".join(
            f"{axis}{value:.{decimals}f}" for axis, value, say in zip("XYZBC", new, named, strict=True) if say
        )
        if words:
            lines.append(f"G0 {words}")
        position = new
    text = "\n".join(lines) + "\n"
    result = compensate(text, dmu50, Calibration.load(path, dmu50))
    truth = TruthMachine(path, LENGTH)
    meant = np.array([p for _, p in run_iso(text)])
    done = np.array([p for _, p in run_iso(result.text)])
    um, urad = truth.deviations(done, meant)
    assert um.max() <= ROUNDING_UM
    assert urad.max() <= ROUNDING_URAD


def test_tcp_and_axis_mode_reach_the_same_points(dmu50: Machine, calibration: Calibration) -> None:
    """The frustum in three languages: the commands that follow from the compensated words agree to rounding."""
    found = {}
    for suffix in ("nc", "h", "cls"):
        result = compensate((SAMPLES / f"cone_frustum.{suffix}").read_text(), dmu50, calibration, f"cone.{suffix}")
        assert result.report.after.max_um <= ROUNDING_UM + 1.0
        assert result.report.rounding_um <= ROUNDING_UM
        found[suffix] = result.commands
    # B and C of the .cls are not rounded to 0.001°: they differ by half of it, which moves X, Y, Z by some µm, together.
    assert np.abs(found["nc"] - found["h"]).max() <= 4e-3
    assert np.abs(found["nc"] - found["cls"])[:, 3].max() <= 1e-3


@pytest.mark.slow
def test_scope_decides_what_is_corrected_and_where(
    dmu50: Machine, calibration: Calibration, truth: TruthMachine
) -> None:
    text = (SAMPLES / "cone_frustum.nc").read_text()
    meant = np.array([p for _, p in run_iso(text)])

    def left(*classes: str) -> tuple[float, float, np.ndarray]:
        result = compensate(text, dmu50, calibration, scope=Scope.parse(classes))
        done = np.array([p for _, p in run_iso(result.text)])
        um, urad = truth.deviations(done, meant)
        return um.max(), urad.max(), done

    everything_um, everything_urad, _ = left("L-VOL+", "R-VOL+")
    assert everything_um <= ROUNDING_UM
    assert everything_urad <= ROUNDING_URAD
    point_um, point_urad, done = left("L-VOL", "R-POR", "R-RAX", "R-ANG", "R-POS")
    assert point_um <= ROUNDING_UM
    assert point_urad > 300.0
    some_um, _, done = left("L-POS", "L-STR")
    assert 10.0 < some_um
    assert np.abs(done - meant)[:, 3:].max() == 0.0
    turned_um, turned_urad, done = left("FOR")  # the orientation alone: the rotary axes move, the point keeps its error
    assert turned_urad <= ROUNDING_URAD
    assert turned_um > 10.0
    assert np.abs(done - meant)[:, 3:].max() > 0.0
    only = compensate(text, dmu50, calibration, scope=Scope.parse(["L-POS"])).report
    assert {share.name: share.corrected for share in only.classes}["L-POS"] is True
    assert {share.name: share.corrected for share in only.classes}["L-ANG"] is False
    with pytest.raises(InputError, match="L-POS L-STR"):
        Scope.parse(["L-PUS"])


def test_three_axis_program_keeps_its_words(dmu50: Machine, calibration: Calibration, truth: TruthMachine) -> None:
    """A program that names no rotary axis gets no rotary words, so its orientation is not corrected."""
    text = "G90\nG0 X100 Y100 Z-100\nG1 X120 F300\nY140\n"
    result = compensate(text, dmu50, calibration)
    assert not set("BC") & set(body(result))
    assert "L-VOL R-VOL" in result.report.scope
    start = {"B": 0.0, "C": 0.0}
    meant = np.array([p for _, p in run_iso(text, start)])
    done = np.array([p for _, p in run_iso(result.text, start)])
    assert truth.deviations(done, meant)[0].max() <= ROUNDING_UM
    assert any("taken as B = 0°, C = 0°" in note.text for note in result.report.notes)


def test_a_rotary_position_that_was_lost_is_not_assumed(dmu50: Machine, calibration: Calibration) -> None:
    """A feed there stays as written: the reference is where the builder has put it, not where the set-up begins."""
    lines = ["G90", "G0 X100 Y100 Z-100", "G1 X120 F300", "G28 B0", "G0 X100 Y100 Z-100", "G1 X120 F300", "M30"]
    result = compensate("\n".join([*lines, ""]), dmu50, calibration)
    (left,) = (one for one in result.report.not_corrected if one.kind == "unknown")
    assert left.missed == (6,) and "has not given a position of B" in left.reason
    assert "\n".join([*lines[3:], ""]) in result.text
    lines[4] += " B0"
    notes = compensate("\n".join([*lines, ""]), dmu50, calibration).report.notes
    assert [note.line for note in notes if "taken as" in note.text] == [2]


def test_out_of_range_is_listed_and_nothing_dropped(dmu50: Machine, calibration: Calibration) -> None:
    text = "G90\nG0 X100 Y100 Z-100 B30 C0\nG1 X600 F300\nX300\nX0\n"
    result = compensate(text, dmu50, calibration)
    assert len(run_iso(result.text)) == 4 + result.report.added
    notes = {line: one for one in result.report.not_corrected if one.kind == "range" for line in one.lines}
    assert "outside the range of X: left as written" in notes[3].reason
    assert (notes[3].worst, notes[3].unit, notes[3].missed) == (pytest.approx(100.0), "mm", (3,))
    assert "X600" in result.text
    assert not result.report.complete
    # X = 0 with a positive error needs X < 0: the axis stops at its limit and the report states it.
    assert "stopped at the limit" in notes[5].reason and notes[5].unit == "um"


def test_work_offset(dmu50: Machine, calibration: Calibration, truth: TruthMachine) -> None:
    shift = np.array([200.0, 150.0, -250.0, 10.0, 30.0])
    text = "G90 G54\nG0 X10 Y20 Z30 B40 C50\nG1 X40 F300\n"
    setup = Setup(work_offset=dict(zip("XYZBC", shift, strict=True)))
    result = compensate(text, dmu50, calibration, setup=setup)
    meant = np.array([p for _, p in run_iso(text)]) + shift
    done = np.array([p for _, p in run_iso(result.text)]) + shift
    assert truth.deviations(done, meant)[0].max() <= ROUNDING_UM


def test_work_origin_in_tcp(dmu50: Machine, calibration: Calibration) -> None:
    """The same path with its zero moved: the commands do not change."""
    plain = "G43.4 H1\nG0 X50 Y20 Z60 B40 C50\nG1 X40 F300\n"
    moved = "G43.4 H1\nG0 X40 Y10 Z50 B40 C50\nG1 X30 F300\n"
    a = compensate(plain, dmu50, calibration)
    b = compensate(moved, dmu50, calibration, setup=Setup(work_origin_mm=(10.0, 10.0, 10.0)))
    assert a.exact == pytest.approx(b.exact, abs=1e-8)


def test_mode_tcp_equals_switching_it_on_in_the_program(dmu50: Machine, calibration: Calibration) -> None:
    words = "G0 X50 Y20 Z60 B40 C50\nG1 X40 F300\n"
    switched = compensate("G43.4 H1\n" + words, dmu50, calibration)
    given = compensate(words, dmu50, calibration, tcp=True)
    assert body(switched) == "G43.4 H1\n" + body(given)
    assert given.exact == pytest.approx(switched.exact, abs=1e-12)


def test_an_ignored_offset_is_noted(dmu50: Machine, calibration: Calibration) -> None:
    tip = compensate(
        "G43.4 H1\nG0 X50 Y20 Z60 B40 C50\n", dmu50, calibration, setup=Setup(work_offset={"X": 5.0, "B": 1.0})
    )
    assert any("the work origin shifts" in note.text for note in tip.report.notes)
    axis = compensate("G0 X50 Y20 Z-60 B40 C50\n", dmu50, calibration, setup=Setup(work_origin_mm=(5.0, 0.0, 0.0)))
    assert any("work offsets shift" in note.text for note in axis.report.notes)


def test_arcs_become_chords(dmu50: Machine, calibration: Calibration, truth: TruthMachine) -> None:
    text = "G90 G17\nG0 X200 Y200 Z-100 B20 C10\nG2 X240 Y200 I20 J0 F500\nG1 X250\nG3 X250 Y200 I-10 J0\n"
    result = compensate(text, dmu50, calibration)
    assert "G2" not in body(result) and "G3" not in body(result) and "I" not in body(result)
    done = [p for _, p in run_iso(result.text)]
    radius = 20.0
    for q, line in zip(done, result.lines, strict=True):
        if line == 3:
            real = truth.pose(q)[:3, 3]
            centre = truth.pose(np.array([220.0, 200.0, -100.0, 20.0, 10.0]), real=False)[:3, 3]
            assert abs(np.linalg.norm(real - centre) - radius) * 1e3 <= ROUNDING_UM
    # The sagitta of a chord stays within the tolerance.
    count = int(np.count_nonzero(result.lines == 3))
    assert radius * (1 - np.cos(np.pi / count / 2)) * 1e3 <= 1.0
    assert all(code == "G1" for code, _ in run_iso(result.text)[1:])


def test_feed_move_from_an_unknown_position_is_refused(dmu50: Machine, calibration: Calibration) -> None:
    with pytest.raises(InputError, match=r"p.nc:2: .*Y, Z"):
        compensate("G90\nG1 X10 F100\n", dmu50, calibration)
    with pytest.raises(InputError, match="motion"):
        compensate("G90\nM30\n", dmu50, calibration)


def test_report_reads_and_counts(dmu50: Machine, calibration: Calibration) -> None:
    report = compensate((SAMPLES / "cone_frustum.nc").read_text(), dmu50, calibration).report
    text = report.to_text()
    assert "ILLUSTRATIVE" in text
    data = report.to_dict()
    assert data["schema"] == "twin.compensation/1"
    assert data["moves"] == 365 and data["rewritten"] == 365
    assert data["after"]["rms_um"] < 0.01 * data["before"]["rms_um"]
    assert data["largest_correction"]["X"]["unit"] == "mm"
    total = np.sqrt(sum(share["before_rms_um"] ** 2 for share in data["classes"]))
    assert total > 0.5 * data["before"]["rms_um"]


def uncertain(calibration: Calibration, u: float) -> Calibration:
    """Return the calibration with an independent standard uncertainty of ``u`` µm or µrad for every number."""
    names = tuple(parameter.name for effect in calibration.effects for parameter in effect.parameters)
    return replace(calibration, joint=Covariance(names, read_only(u**2 * np.eye(len(names)))))


TURNS = "G90\nG0 X100 Y100 Z-100 B40 C10\nG1 X120 F300\nY140 B60\nZ-200 C200\n"


def test_a_correction_is_reported_with_its_uncertainty(dmu50: Machine, calibration: Calibration) -> None:
    known = uncertain(calibration, 0.3)
    result = compensate(TURNS, dmu50, known)
    point, axis = result.report.uncertainty.point, result.report.uncertainty.axis
    assert point is not None and axis is not None
    assert point.shown is True and axis.shown is True and len(point.below) == 0
    ends = result.nominal
    at = ToolUncertainty(Kinematics(dmu50, known, tool_length_mm=LENGTH)).at(ends)
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=LENGTH)
    moved = np.linalg.norm(nominal.forward(result.exact).point_mm - nominal.forward(ends).point_mm, axis=1) * 1e3
    assert point.rms == pytest.approx(np.sqrt(np.mean(moved**2)))
    assert point.expanded_rms == pytest.approx(np.sqrt(np.mean(at.expanded_um**2)))
    assert point.max_expanded == pytest.approx(at.expanded_um[np.argmax(moved)])
    assert axis.expanded_max == pytest.approx(at.axis_expanded_urad.max())
    text = result.report.to_text()
    assert f"correction    {point.rms:.1f} ± {point.expanded_rms:.1f} µm RMS" in text
    assert "not shown" not in text and "unknown" not in text
    data = result.report.to_dict()["uncertainty"]
    assert data["point"]["shown"] is True and data["point"]["expanded_rms_um"] == point.expanded_rms
    assert data["unknown"] is None


def test_a_correction_below_its_uncertainty_is_no_improvement(dmu50: Machine, calibration: Calibration) -> None:
    result = compensate(TURNS, dmu50, uncertain(calibration, 100.0))
    point = result.report.uncertainty.point
    assert point is not None and point.shown is False
    assert point.rms < point.expanded_rms
    assert [one.line for one in point.below] == [2, 3, 4, 5]
    text = result.report.to_text()
    assert (
        f"not shown to be an improvement: correction {point.rms:.0f} µm, its uncertainty U {point.expanded_rms:.0f}"
        in text
    )
    assert "in 4 of 4 blocks" in text
    data = result.report.to_dict()["uncertainty"]["point"]
    assert data["shown"] is False
    assert data["below"][0]["line"] == 2 and data["below"][0]["correction_um"] < data["below"][0]["expanded_um"]


def test_blocks_below_their_uncertainty_are_listed_by_line(dmu50: Machine) -> None:
    """A scale error known to 3 µm (u): its effect at X 10 and 20 is below U of 5.9 µm, at X 490 it is not."""
    curve = replace(random_calibration(dmu50, np.random.default_rng(2)).curves["E_XX"], coefficients=(50.0, 50.0))
    known = replace(
        Calibration.zero(dmu50),
        curves={"E_XX": curve},  # 0 at X = 0, 100 µm at X = 500
        joint=Covariance(("E_XX[0]", "E_XX[1]"), read_only(np.diag([9.0, 0.0]))),
    )
    report = compensate("G90\nG0 X490 Y100 Z-100\nX20\nX490\nX10\n", dmu50, known).report
    point = report.uncertainty.point
    assert point is not None and report.uncertainty.axis is None
    assert point.shown is True
    assert point.expanded_rms == pytest.approx(1.96 * 3.0, rel=1e-4)
    assert point.max == pytest.approx(98.0, rel=1e-3) and point.max_line == 2
    # 0.2 µm per mm; the correction moves X, and with it the error, by 1/5000.
    assert {one.line: round(one.correction, 2) for one in point.below} == {3: 4.0, 5: 2.0}
    assert "in 2 of 4 blocks" in report.to_text() and "line 3: correction 4.0 µm, U 5.9 µm" in report.to_text()


def test_an_unknown_uncertainty_is_reported(dmu50: Machine, calibration: Calibration) -> None:
    none = compensate(TURNS, dmu50, calibration).report
    assert "uncertainty of the correction: unknown (no covariance in the calibration: E_XX, E_YX" in none.to_text()
    data = none.to_dict()["uncertainty"]["point"]
    assert data["shown"] is None and data["expanded_rms_um"] is None and data["known"] is False
    full = uncertain(calibration, 0.3)
    assert full.joint is not None
    some = replace(full, joint=full.joint.where(lambda name: not name.startswith("E_XX")))
    part = compensate(TURNS, dmu50, some).report
    point = part.uncertainty.point
    assert point is not None and point.shown is None  # larger than the known U, which is only a lower bound
    assert (
        "U at least" in part.to_text()
        and "known only in part (no covariance in the calibration: E_XX)" in part.to_text()
    )
    # An error out of scope is not corrected and has no part in the uncertainty of the correction.
    scoped = compensate(TURNS, dmu50, some, scope=Scope.parse(["L-STR"])).report.uncertainty
    assert scoped.point is not None and scoped.point.without_uncertainty == () and scoped.axis is None
    assert scoped.point.expanded_rms < point.expanded_rms
    turned = compensate(TURNS, dmu50, full, scope=Scope.parse(["FOR"])).report.uncertainty
    assert turned.point is None and turned.axis is not None and turned.axis.shown is True


def test_the_uncertainty_covers_the_residual_of_a_compensation(
    dmu50: Machine, calibration: Calibration, tmp_path: Path
) -> None:
    """Machines drawn from the calibration's distribution execute the compensated program: 95 % of the end points are within U."""
    known = uncertain(calibration, 10.0)
    result = compensate(TURNS, dmu50, known)
    known.save(tmp_path / "c.yaml")
    drawn, rng = TruthMachine(tmp_path / "c.yaml", LENGTH), np.random.default_rng(11)
    at = ToolUncertainty(Kinematics(dmu50, known, tool_length_mm=LENGTH)).at(result.nominal).expanded_um
    ends = [0, len(at) - 1]
    within = []
    for _ in range(400):
        one = copy.deepcopy(drawn)
        for entry in one.curves.values():
            entry["coefficients"] = list(entry["coefficients"] + 10.0 * rng.normal(size=len(entry["coefficients"])))
        one.squareness = {name: value + 10.0 * rng.normal() for name, value in one.squareness.items()}
        left, _ = one.deviations(result.commands[ends], result.nominal[ends])
        within.append(left <= at[ends])
    # Three and a half standard errors of 400 draws; rounding adds at most 0.9 µm to some 40.
    assert np.abs(np.mean(within, axis=0) - 0.95).max() < 0.038


def test_a_block_is_split_where_its_middle_leaves_the_tolerance(dmu50: Machine) -> None:
    """Straightness by a parabola: the middle of a line is off by its sagitta, which decides alone, to a hundredth of the tolerance."""
    sagitta_um, tolerance_um = 100.0, 2.0
    parabola = Curve("E_YX", "um", (0.0, 500.0), "power", (0.0, 0.0, sagitta_um))
    errors = Calibration(
        dmu50, "a parabola", MappingProxyType({"E_YX": parabola}), MappingProxyType({}), MappingProxyType({})
    )
    # u = (2x − 500)/500; over a length L the sagitta of sagitta_um·u² is sagitta_um·(L/500)².
    factors = np.array([0.9, 0.98, 1.02, 1.2, 1.45, 3.9, 4.1])
    lengths = 500.0 * np.sqrt(factors * tolerance_um / sagitta_um)
    blocks = "".join(f"G0 X10\nG1 X{10.0 + length:.3f} F500\n" for length in lengths)
    text = f"G21 G90\nG0 X10 Y200 Z-200 B0 C0\n{blocks}"
    result = compensate(text, dmu50, errors, tolerance_mm=tolerance_um * 1e-3)
    pieces = np.bincount(result.moves)[2::2]
    assert np.all((pieces > 1) == (factors > 1.0))
    assert np.all(factors / pieces**2 <= 1.0)
