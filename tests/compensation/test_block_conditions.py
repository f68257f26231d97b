"""Programs under heat: temperature, speed and time of every block, against a machine whose course is integrated in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.compensation.test_compensate_effects import HEAD, ROUNDING_UM, WornMachine, extended
from twin import compensate
from twin._common.errors import InputError
from twin.compensation import Compensation, Options
from twin.compensation.programs import block_conditions
from twin.compensation.programs.block_conditions import BlockConditions
from twin.compensation.programs.execute import execute_file
from twin.compensation.programs.follow import follow
from twin.compensation.programs.words import Setup, WordSpace
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions, MachineLog
from twin.nc import read_program

LENGTH = 120.0
HIGHEST, AMPLITUDE, TAU = 12000.0, 25.0, 600.0
GROWTH = (
    f"effect: spindle_growth, where: Z, parameters: {{amplitude: {AMPLITUDE}, exponent: 1, "
    f"time_constant: {TAU}, highest_rpm: {HIGHEST}}}"
)
BED, LAG_TAU = 3.0, 900.0
BEDS = f"effect: thermal_growth, where: Z by bed, parameters: {{coefficient: {BED}}}"
LAG = f"effect: thermal_lag, where: Z by bed, parameters: {{coefficient: {BED}, time_constant: {LAG_TAU}}}"
EXPANSION = "effect: thermal_expansion, where: X, parameters: {coefficient: 11}"
DRIFT = "effect: thermal_drift, where: Y, parameters: {amplitude: 8, time_constant: 3600}"

BLOCKS = ((160.0, 6000.0), (360.0, 12000.0), (60.0, 0.0), (300.0, 9000.0))
"""X, and the speed on the way there; from X 60, at 10 mm/min."""
SECONDS = [600.0, 1200.0, 1800.0, 1440.0]
"""Time of each block by hand: 100, 200, 300 and 240 mm at 10 mm/min."""


def program(folder: Path, text: str = "") -> Path:
    lines = ["G21 G90 G94", "G0 X60 Y140 Z-100 B0 C0", "F10"]
    for x, speed in BLOCKS:
        lines.append(f"G1 X{x:g} {'M5' if not speed else f'S{speed:g} M3'}")
    # A spindle that is switched off stops after its block: it is switched off in the line before.
    lines[5] = "M5\nG1 X60"
    path = folder / "hot.nc"
    path.write_text(text or "\n".join([*lines, "M30", ""]))
    return path


def steps_to(time: np.ndarray, first: float, speeds: list[tuple[float, float]]) -> np.ndarray:
    """Return (n,) the growth in µm at times by dividing every second: (duration, speed) one after the other from time ``first``."""
    grown, at, found = 0.0, first, {}
    for duration, speed in speeds:
        for moment in time[(time > at - 1e-9) & (time <= at + duration + 1e-9)]:
            target = AMPLITUDE * speed / HIGHEST
            found[float(moment)] = target + (grown - target) * np.exp(-(moment - at) / TAU)
        target = AMPLITUDE * speed / HIGHEST
        grown, at = target + (grown - target) * np.exp(-duration / TAU), at + duration
    return np.array([found[float(moment)] for moment in time])


class HotMachine(WornMachine):
    """The independent machine with a shift of the tool side that differs from row to row."""

    def moved(self, commands: np.ndarray, meant: np.ndarray, shift_um: np.ndarray) -> np.ndarray:
        """Return (n,) the distance from the nominal points, µm; ``shift_um``: (n, 3)."""
        points = []
        for q, shift in zip(commands, shift_um, strict=True):
            self.shift_um = shift
            points.append(self.worn(q, np.zeros(5))[:3, 3])
        return np.linalg.norm(np.array(points) - self.meant(meant), axis=1) * 1e3


def times_of(result: Compensation, start: float) -> np.ndarray:
    """Return (n,) the time of every row: its place on the way of its block, by hand."""
    ends = np.concatenate([[start], start + np.cumsum(SECONDS)])
    places = np.array([60.0, *(x for x, _ in BLOCKS)])
    found = []
    for motion, x in zip(np.unique(result.moves, return_inverse=True)[1], result.nominal[:, 0], strict=True):
        k = max(int(motion) - 1, 0)
        share = 0.0 if motion == 0 else abs(x - places[k]) / abs(places[k + 1] - places[k])
        found.append(ends[k] + share * (ends[k + 1] - ends[k]))
    return np.array(found)


def done(source: Path, machine: Machine, calibration: Path, conditions: Conditions) -> Compensation:
    return compensate(
        source,
        machine,
        Calibration.load(calibration, machine),
        options=Options(tool_length_mm=LENGTH, conditions=conditions),
    )


def shift_z(size: np.ndarray) -> np.ndarray:
    return np.stack([np.zeros_like(size), np.zeros_like(size), size], axis=1)


def written(folder: Path, **columns: np.ndarray) -> MachineLog:
    path = folder / "machine.csv"
    rows = zip(*columns.values(), strict=True)
    path.write_text(",".join(columns) + "\n" + "".join(",".join(f"{v:.9g}" for v in row) + "\n" for row in rows))
    return MachineLog.load(path)


def test_speeds_of_the_program(dmu50: Machine, tmp_path: Path) -> None:
    """Growth with the speed of every block, from a cold start: before 12 to 23 µm, after: rounding."""
    calibration = extended(tmp_path, GROWTH)
    result = done(program(tmp_path), dmu50, calibration, Conditions(time_s=0.0))
    truth = HotMachine(calibration, reversal={})
    time = times_of(result, 0.0)
    speeds = [(seconds, speed) for seconds, (_, speed) in zip(SECONDS, BLOCKS, strict=True)]
    shift = shift_z(steps_to(time, 0.0, speeds))
    assert np.ptp(shift[:, 2]) > 15.0
    assert truth.moved(result.nominal, result.nominal, shift).max() > 15.0
    assert truth.moved(result.commands, result.nominal, shift).max() <= ROUNDING_UM
    assert result.report.before.max_um > 15.0 > 1.5 > result.report.after.max_um
    (note,) = [note.text for note in result.report.notes if "takes" in note.text]
    assert "takes 84.0 min" in note and "spindle 0 to 12000 1/min (S words)" in note


def test_the_speed_before_the_program_is_that_of_the_log(dmu50: Machine, tmp_path: Path) -> None:
    calibration = extended(tmp_path, GROWTH)
    log = written(tmp_path, time_s=np.array([0.0, 1200.0, 1800.0]), spindle_rpm=np.array([0.0, 12000.0, 3000.0]))
    result = done(program(tmp_path), dmu50, calibration, Conditions(time_s=1800.0, log=log, speed_of_program=True))
    time = times_of(result, 1800.0)
    speeds = [(1200.0, 12000.0), (600.0, 3000.0)]
    speeds += [(seconds, speed) for seconds, (_, speed) in zip(SECONDS, BLOCKS, strict=True)]
    shift = shift_z(steps_to(time, 0.0, speeds))
    truth = HotMachine(calibration, reversal={})
    assert shift[0, 2] > 10.0
    assert truth.moved(result.commands, result.nominal, shift).max() <= ROUNDING_UM


def test_temperatures_of_a_log(dmu50: Machine, tmp_path: Path) -> None:
    """The bed warms at 1 K in 1,000 s; a growth at once and one that lags, each with its closed form; X's scale and a drift in time."""
    time_s = np.linspace(0.0, 9000.0, 46)
    log = written(tmp_path, time_s=time_s, T_bed_degC=20.0 + time_s / 1000.0, T_X_degC=24.0 - time_s / 3000.0)
    start = 2000.0
    conditions = Conditions(time_s=start, log=log)
    for effect, growth in (
        (BEDS, lambda t: BED * t / 1000.0),
        (LAG, lambda t: BED * (t - LAG_TAU * (1.0 - np.exp(-t / LAG_TAU))) / 1000.0),
    ):
        calibration = extended(tmp_path, effect, EXPANSION, DRIFT)
        result = done(program(tmp_path), dmu50, calibration, conditions)
        time = times_of(result, start)
        shift = shift_z(growth(time))
        shift[:, 1] = 8.0 * (1.0 - np.exp(-time / 3600.0))
        shift[:, 0] = 11.0 * (4.0 - time / 3000.0) * result.commands[:, 0] * 1e-3  # along X, which carries all
        truth = HotMachine(calibration, reversal={})
        assert truth.moved(result.nominal, result.nominal, shift).max() > 14.0
        assert truth.moved(result.commands, result.nominal, shift).max() <= ROUNDING_UM


def test_constant_conditions_are_the_same_from_a_log(dmu50: Machine, tmp_path: Path) -> None:
    """Backlash, orientation and uncertainty go the same way; the text is the same, byte for byte."""
    five = "G21 G90\nG0 X100 Y100 Z-100 B30 C10\nG1 X160 Y140 F500\nY90 S3000\nX120\nG2 X140 Y110 I20 J0\nG1 X140 Z-120 B40 C30\nM30\n"
    source = program(tmp_path, five)
    calibration = extended(tmp_path, BEDS, EXPANSION, "effect: reversal, where: X, parameters: {size: -7}")
    warm = {"bed": 22.0, "X": 25.0}
    time_s = np.array([0.0, 1e5])
    log = written(tmp_path, time_s=time_s, T_bed_degC=np.full(2, 22.0), T_X_degC=np.full(2, 25.0))
    whole = done(source, dmu50, calibration, Conditions(warm))
    blocks = done(source, dmu50, calibration, Conditions(time_s=500.0, log=log))
    without = [[line for line in one.text.splitlines() if not line.startswith("(")] for one in (blocks, whole)]
    assert without[0] == without[1]
    assert "ONLY FOR BED 22 DEGC, X 25 DEGC" in whole.text and "ONLY FOR A START AT 500 S OF MACHINE.CSV" in blocks.text
    assert blocks.report.after.max_um == pytest.approx(whole.report.after.max_um, abs=1e-6)


def test_the_run_of_a_program_is_simulated_by_block(dmu50: Machine, tmp_path: Path) -> None:
    calibration = extended(tmp_path, GROWTH)
    source = program(tmp_path)
    result = done(source, dmu50, calibration, Conditions(time_s=0.0))
    output = tmp_path / "out.nc"
    output.write_text(result.text)
    errors = Calibration.load(calibration, dmu50)
    at = Conditions(time_s=0.0, speed_of_program=True)
    runs = [execute_file(one, dmu50, errors, tool_length_mm=LENGTH, conditions=at) for one in (source, output)]
    off = [np.linalg.norm(run.reached_mm - runs[0].meant_mm[-1], axis=1)[-1] * 1e3 for run in runs]
    assert off[0] > 15.0 and off[1] < 1.5


@pytest.mark.parametrize(
    ("text", "conditions", "expected"),
    [
        ("G0 X60 Y140 Z-100 B0 C0\nG1 X70 F10\n", {}, "has no speed word"),
        ("S100 M3\nG0 X60 Y140 Z-100 B0 C0\nG1 X70\n", {}, r"hot.nc:3: the time of a block is unknown: no feed"),
        ("M5\nG0 X60 Y140 Z-100 B0 C0\nG95 G1 X70 F.1 S1\n", {}, r"the spindle is not turning"),
        ("S100 M3\nG0 X60 Y140 Z-100 B0 C0\nG1 X70 F10\n", {"time_s": 60.0}, "speed before the program is unknown"),
        ("G96 S100 M3\nG0 X60 Y140 Z-100 B0 C0\nG1 X70 F10\n", {}, r"hot.nc:1: the spindle speed follows"),
        ("S=R1 M3\nG0 X60 Y140 Z-100 B0 C0\nG1 X70 F10\n", {}, r"hot.nc:1: the spindle speed is not a number"),
    ],
)
def test_what_is_missing_is_named(
    dmu50: Machine, tmp_path: Path, text: str, conditions: dict[str, float], expected: str
) -> None:
    calibration = extended(tmp_path, GROWTH)
    with pytest.raises(InputError, match=expected):
        done(program(tmp_path, text), dmu50, calibration, Conditions(**{"time_s": 0.0, **conditions}))


def test_a_log_that_does_not_cover_the_program(dmu50: Machine, tmp_path: Path) -> None:
    calibration = extended(tmp_path, BEDS)
    log = written(tmp_path, time_s=np.array([0.0, 3000.0]), T_bed_degC=np.array([20.0, 21.0]))
    with pytest.raises(InputError, match="the log is of 0 to 3000 s; the program runs from 0 to 5040 s"):
        done(program(tmp_path), dmu50, calibration, Conditions(time_s=0.0, log=log))
    late = written(tmp_path, time_s=np.array([100.0, 6000.0]), T_bed_degC=np.array([20.0, 21.0]))
    with pytest.raises(InputError, match="the log is of 100 to 6000 s; the program runs from 0 to 5040 s"):
        done(program(tmp_path), dmu50, calibration, Conditions(time_s=0.0, log=late))
    with pytest.raises(InputError, match="the beginning of the program is unknown"):
        done(program(tmp_path), dmu50, calibration, Conditions(log=log))
    with pytest.raises(InputError, match="T_bed_degC is given and in the log"):
        done(program(tmp_path), dmu50, calibration, Conditions({"bed": 21.0}, 0.0, log=log))
    with pytest.raises(InputError, match="needs T_X_degC"):
        other = extended(tmp_path, EXPANSION)
        done(program(tmp_path), dmu50, other, Conditions(time_s=0.0, log=log))


def test_no_calibration_needs_a_log(dmu50: Machine, tmp_path: Path) -> None:
    """A calibration without such effects is compensated as before: the program's feed does not matter."""
    path = tmp_path / "plain.yaml"
    path.write_text(HEAD + "curves: {E_XX: {unit: um, domain: [0, 500], basis: power, coefficients: [0, 5]}}\n")
    result = done(program(tmp_path, "G0 X60 Y140 Z-100 B0 C0\nG1 X70 Y150\n"), dmu50, path, Conditions())
    assert result.report.rewritten == 2


def test_a_block_that_lasts_longer_than_the_machine_warms(dmu50: Machine, tmp_path: Path) -> None:
    """Between the end points of blocks of 20 to 30 min the error stays within the tolerance: the blocks are split."""
    calibration = extended(tmp_path, GROWTH)
    result = done(program(tmp_path), dmu50, calibration, Conditions(time_s=0.0))
    rows = np.flatnonzero(np.diff(result.moves) == 0)
    assert len(rows) > 5
    truth, time = HotMachine(calibration, reversal={}), times_of(result, 0.0)
    speeds = [(seconds, speed) for seconds, (_, speed) in zip(SECONDS, BLOCKS, strict=True)]
    grown = steps_to(0.5 * (time[rows] + time[rows + 1]), 0.0, speeds)
    nominal, commands = (0.5 * (values[rows] + values[rows + 1]) for values in (result.nominal, result.commands))
    assert truth.moved(commands, nominal, shift_z(grown)).max() <= ROUNDING_UM + 1.0


def test_times_of_blocks_by_hand(dmu50: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines, rapids, arcs, inverse time, a feed beyond an axis; in tool-tip words the path of the tip, unless only the tool turns."""
    lines = [
        "G21 G90 G94 G17",
        "G0 X0 Y0 Z-100 B0 C0",
        "F600",
        "G1 X30 Y40",
        "G3 X20 Y50 I-10 J0",
        "G0 X120",
        "G1 X0 C90 F1000000",
    ]
    lines += ["G43.4 H1", "G1 X0 Y0 Z0 C90 F600", "G1 X10 C120", "G1 C150"]
    lines += ["G93 G1 X30 F4"]  # a quarter of a minute, whatever the way
    source, dialect = read_program(program(tmp_path, "\n".join([*lines, "M30", ""])))
    space = WordSpace(dmu50, Setup(), LENGTH)
    path = follow(source, dialect.moves(source, space.axes, tcp=False), space)
    monkeypatch.setattr(
        block_conditions, "velocity_limits", lambda machine: np.array([500.0, 500.0, 400.0, 90.0, 180.0])
    )
    times = block_conditions.durations_s(source.source, dialect.technology(source), path, [(0, space)])
    assert times[:5] == pytest.approx([0.0, 5.0, np.pi / 2.0, 100.0 / 500.0, 90.0 / 180.0], rel=1e-9)
    assert times[6:] == pytest.approx([1.0, 3.0, 15.0], rel=1e-9)


def test_a_part_of_a_program_keeps_its_times() -> None:
    """At any place of its motions, and a speed is that of the time up to its moment, at the change itself too."""
    whole = BlockConditions(
        ("time_s", "spindle_rpm"),
        np.array([0.0, 10.0, 15.0]),
        np.array([10.0, 5.0, 30.0]),
        np.array([0.0, 10.0, 15.0, 45.0]),
        np.array([[0.0, 100.0], [10.0, 100.0], [15.0, 200.0], [45.0, 300.0]]),
    )
    motion, share = np.repeat(np.arange(3), 3), np.tile([0.0, 0.5, 1.0], 3)
    found = whole.channels(motion, share)
    assert found["time_s"].tolist() == [0.0, 5.0, 10.0, 10.0, 12.5, 15.0, 15.0, 30.0, 45.0]
    assert found["spindle_rpm"].tolist() == [100.0, 100.0, 100.0, 100.0, 200.0, 200.0, 200.0, 300.0, 300.0]
    for begin in range(3):
        own = motion >= begin
        part = whole.part(begin, 3).channels(motion[own] - begin, share[own])
        assert {name: values.tolist() for name, values in part.items()} == {
            n: v[own].tolist() for n, v in found.items()
        }


def test_dwells_add_up(dmu50: Machine, tmp_path: Path) -> None:
    """Every motion begins after all dwells before it; that of the first line at once."""
    lines = [
        "G21 G90 G94 S6000 M3 G0 X0 Y0 Z-100 B0 C0",
        "F600",
        "G1 X10",
        "G4 P2000",
        "G1 X20",
        "G4 P5000",
        "G1 X30",
    ]
    source, dialect = read_program(program(tmp_path, "\n".join([*lines, "M30", ""])))
    space = WordSpace(dmu50, Setup(), LENGTH)
    path = follow(source, dialect.moves(source, space.axes, tcp=False), space)
    calibration = Calibration.load(extended(tmp_path, GROWTH), dmu50)
    conditions = Conditions(time_s=0.0, speed_of_program=True)
    found = block_conditions.block_conditions(source, dialect, path, [(0, space)], calibration, conditions)
    dwells = np.cumsum(dialect.technology(source).dwell_s)[path.columns.line]
    assert np.unique(dwells).tolist() == [0.0, dwells[2], dwells[3]] and dwells[3] == pytest.approx(3.5 * dwells[2])
    assert found.begin_s == pytest.approx(dwells + np.array([0.0, 0.0, 1.0, 2.0]), abs=1e-9)
