"""Programs compensated for backlash, temperatures and warm-up, executed on a worn, warm machine that shares no code with `twin`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tests.compensation.heads import body
from tests.model.errors import random_calibration
from tests.tool.sampled import sampled
from tests.truth.machine import AXES, RANGES, TruthMachine, run_iso
from tests.truth.reference import dmu50_pose
from twin import cli, compensate
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.backlash import Backlash
from twin.compensation.programs.execute import execute
from twin.compensation.programs.follow import follow
from twin.compensation.programs.motions import ToolPath
from twin.compensation.programs.words import WordSpace
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.conditions import Conditions
from twin.model.effects.entries import effect_named
from twin.model.iso16907 import Scope, error_motion_of, iso_class
from twin.nc import dialect_for
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import ToolUncertainty, error_budget, without_missing_channels

SAMPLES = Path(__file__).resolve().parents[2] / "twin" / "samples"
LENGTH = 120.0
ROUNDING_UM = 0.9  # three linear words at 0.001 mm: half of 1.73 µm
HEAD = "schema: twin.calibration/1\nmachine: DMU 50 eVolution\nsource: a test\n"
WARM = {"X": 26.0}

PROGRAM = """G21 G90
(turns on X and Y)
G0 X100 Y100 Z-100 B30 C10
G1 X160 Y140 F500
G1 Y90
X120
Y130 (a comment)
X150 Y120 M8
(four quadrants)
G2 X150 Y120 I20 J0
(five axes)
G1 X140 Y110 Z-120 B40 C30
X160 Y120 Z-110 B30 C50
B35
X170
G0 X200 Y200
G1 Y190
M30
"""
Y_TURNS = 10  # from nowhere; at 140, 90, 130; where the circle begins, on its top and bottom; at 120, 110 and 200


class WornMachine(TruthMachine):
    """The independent machine with backlash, warm scales and spindle growth, implemented from the table of effects."""

    def __init__(
        self,
        calibration: Path,
        *,
        reversal: Mapping[str, float],
        expansion: Mapping[str, float] | None = None,
        warm: Mapping[str, float] | None = None,
        shift_um: tuple[float, float, float] = (0.0, 0.0, 0.0),
        varying: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        super().__init__(calibration, LENGTH)
        self.reversal = {name: (size, 0.0) for name, size in reversal.items()} | dict(varying or {})
        self.expansion = expansion or {}
        self.warm = warm or {}
        self.shift_um = np.array(shift_um)

    def run(self, commands: np.ndarray) -> np.ndarray:
        """Return (n, 3) tool points, mm: an axis that lags (negative) has play, one that jumps ahead does so at the first step back."""
        sides = np.zeros(commands.shape)
        for name in self.reversal:
            axis = AXES.index(name)
            side = 0.0
            for i, step in enumerate(np.diff(commands[:, axis], prepend=commands[0, axis])):
                size = self.lost(name, commands[i, axis])
                width = abs(size) * (1e-3 if axis < 3 else np.degrees(1e-6))
                if size < 0.0:
                    side = min(1.0, max(-1.0, side + 2.0 * step / width))
                elif abs(step) > 1e-9:
                    side = np.sign(step)
                sides[i, axis] = side
        return np.array([self.worn(q, side)[:3, 3] for q, side in zip(commands, sides, strict=True)])

    def lost(self, name: str, q: float) -> float:
        """Return the reversal value at an axis position, µm or µrad: a constant plus a linear change over the range."""
        mean, change = self.reversal.get(name, (0.0, 0.0))
        if change == 0.0:
            return mean
        low, high = RANGES[name]
        return mean + change * (2.0 * q - low - high) / (high - low)

    def worn(self, q: np.ndarray, side: np.ndarray) -> np.ndarray:
        errors = self.errors(q)
        for i, name in enumerate(AXES):
            along = 0.5 * self.lost(name, q[i]) * side[i]
            along += self.expansion.get(name, 0.0) * (self.warm.get(name, 20.0) - 20.0) * q[i] * 1e-3
            column, scale = {"X": (0, 1e-3), "Y": (1, 1e-3), "Z": (2, 1e-3), "B": (5, 1e-6), "C": (5, -1e-6)}[name]
            errors[name][column] += scale * along
        errors["X"][:3] += self.shift_um * 1e-3  # X carries the whole tool side
        return dmu50_pose(q * [1, 1, 1, np.pi / 180, np.pi / 180], errors, self.tool_length)

    def meant(self, commands: np.ndarray) -> np.ndarray:
        return np.array([self.pose(q, real=False)[:3, 3] for q in commands])

    def off(self, commands: np.ndarray, meant: np.ndarray) -> np.ndarray:
        """(n,) µm."""
        return np.linalg.norm(self.run(commands) - self.meant(meant), axis=1) * 1e3


def extended(folder: Path, *effects: str, base: str = HEAD) -> Path:
    path = folder / "extended.yaml"
    path.write_text(base + "effects:\n" + "".join(f"- {{{effect}}}\n" for effect in effects))
    return path


def reversal(axis: str, size: float) -> str:
    return f"effect: reversal, where: {axis}, parameters: {{size: {size}}}"


EXPANSION = "effect: thermal_expansion, where: X, parameters: {coefficient: 11}"
GROWTH = "effect: thermal_growth, where: Z by bed, parameters: {coefficient: 3}"
DRIFT = "effect: thermal_drift, where: Y, parameters: {amplitude: 8, time_constant: 3600}"


def done(
    text: str, machine: Machine, calibration: Path | Calibration, name: str = "p.nc", **options: object
) -> Compensation:
    dialect = dialect_for(Path(name))
    known = calibration if isinstance(calibration, Calibration) else Calibration.load(calibration, machine)
    chosen = Options(**{"tool_length_mm": LENGTH, **options})
    return Compensator(machine, known, chosen).compensate(dialect.read(text.encode("latin-1"), name), dialect)


def densely(rows: np.ndarray, points: int = 8) -> np.ndarray:
    """Return straight lines through rows, with ``points`` points each."""
    share = (np.arange(points) + 1.0) / points
    return np.concatenate([rows[:1], *(a + share[:, None] * (b - a) for a, b in pairwise(rows))])


def taking_up(result: Compensation) -> np.ndarray:
    """Return (rows,) whether a block starts where the one before ended: the inserted backlash moves."""
    return np.append(False, (np.diff(result.nominal, axis=0) == 0.0).all(axis=1))


# ---- programs on the worn machine


@pytest.mark.slow
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_turns_quadrants_and_five_axes(dmu50: Machine, tmp_path: Path, sign: float) -> None:
    """End points and interiors of blocks, in order; 12 µm of Y, 60 µrad of B, X at 26 °C."""
    path = extended(tmp_path, reversal("Y", 12.0 * sign), reversal("B", 60.0 * sign), EXPANSION)
    truth = WornMachine(path, reversal={"Y": 12.0 * sign, "B": 60.0 * sign}, expansion={"X": 11.0}, warm=WARM)
    result = done(PROGRAM, dmu50, path, conditions=Conditions(WARM))
    words = [code for code, _ in run_iso(result.text)]
    commands = np.array([position for _, position in run_iso(result.text)])
    assert commands == pytest.approx(result.commands, abs=1e-9)
    cut = np.repeat([code != "G0" for code in words], 8)[7:]
    before = truth.off(densely(result.nominal), densely(result.nominal))[cut]
    after = truth.off(densely(commands), densely(result.nominal))
    assert np.sqrt(np.mean(before**2)) > 12.0
    there = cut & ~np.repeat(taking_up(result), 8)[7:]
    assert np.sqrt(np.mean(after[there] ** 2)) < 0.5  # almost all of it rounding
    assert after[there].max() <= ROUNDING_UM
    if sign < 0.0:  # an axis that lags stands still while its play is taken up
        assert after[cut].max() <= ROUNDING_UM + 1.0
    notes = {note.axis: note for note in result.report.reversals}
    assert notes["Y"].taken_up == Y_TURNS and notes["Y"].size == pytest.approx(12.0 * sign)
    assert result.report.complete
    assert result.report.after.rms_um < 1.0 < 12.0 < result.report.before.rms_um
    kept = [line for line in PROGRAM.splitlines() if not run_iso(line)]
    assert [line for line in body(result).splitlines() if not run_iso(line)] == kept
    assert "(a comment)" in result.text and "M8" in result.text


def test_the_backlash_move_precedes_the_way_back(dmu50: Machine, tmp_path: Path) -> None:
    text = "G90\nG0 X100 Y100 Z-100 B30 C10\nG1 Y110 F500 (up)\nX120\nY120\nX100\nY90 (down)\nY80\nG0 Y100\nG1 Y105\n"
    lagging = body(done(text, dmu50, extended(tmp_path, reversal("Y", -12.0))))
    assert lagging == (
        "G90\nG0 X100 Y100 Z-100 B30 C10\nG1 Y100.006 F500 (up)\nY110.006\nX120\nY120.006\nX100\nY119.994 (down)\nY89.994\n"
        "Y79.994\nG0 Y100.006\nG1 Y105.006\n"
    )
    # Jumping ahead: beyond the corrected position and back, so that the axis has reversed before the way back begins.
    ahead = body(done(text, dmu50, extended(tmp_path, reversal("Y", 12.0))))
    assert "X100\nY120.009 (down)\nY120.006\nY90.006\nY80.006\nG0 Y99.994\n" in ahead


def test_a_circle_is_cut_at_its_quadrants(dmu50: Machine, tmp_path: Path) -> None:
    path = extended(tmp_path, reversal("Y", -12.0), reversal("X", -5.0))
    result = done("G90 G17\nG0 X160 Y110 Z-100 B20 C10\nG3 X160 Y110 I10 J10 F500\n", dmu50, path)
    turned = result.nominal[taking_up(result)]
    radius = np.hypot(10.0, 10.0)
    expected = [(170.0, 120.0 - radius), (170.0 + radius, 120.0), (170.0, 120.0 + radius), (170.0 - radius, 120.0)]
    assert turned[0, :2].tolist() == [160.0, 110.0]  # both from nowhere
    assert turned[1:, :2] == pytest.approx(np.array(expected), abs=1e-5)
    on = result.lines == 3
    assert np.hypot(*(result.nominal[on, :2] - [170.0, 120.0]).T) == pytest.approx(radius, abs=1e-9)


def test_axes_that_reverse_inside_a_tool_tip_block(dmu50: Machine, tmp_path: Path) -> None:
    """At B = 0 the tip moves with the table: the machine's X and Y follow a circle although their words do not change."""
    path = extended(tmp_path, reversal("X", -10.0), reversal("Y", -12.0))
    result = done("G43.4 H1\nG0 X60 Y0 Z50 B0 C0\nG1 C350 F500\n", dmu50, path, scope=Scope.parse(["L-POS"]))
    turned = result.nominal[taking_up(result)]
    assert len(turned) == 4  # at the start from nowhere, and at 90, 180 and 270 degrees
    radial = turned[:, :2] - [250.0, 225.0]
    assert np.sort(np.abs(radial), axis=1) == pytest.approx(np.tile([0.0, 60.0], (4, 1)), abs=1e-4)
    truth = WornMachine(path, reversal={"X": -10.0, "Y": -12.0})
    assert (
        truth.off(result.commands, result.nominal).max() <= ROUNDING_UM + 1.0
    )  # the first from the middle of its play


@pytest.mark.sample(1)  # of 3
@pytest.mark.parametrize("suffix", ["nc", "h", "cls"])
def test_three_languages(dmu50: Machine, calibration: Calibration, tmp_path: Path, suffix: str) -> None:
    """The frustum on the illustrative machine with wear: every axis moves all the time, B and C reverse."""
    assert calibration.path is not None
    sizes = {"X": -5.0, "Y": -12.0, "B": -60.0, "C": -40.0}
    path = extended(
        tmp_path, *(reversal(axis, size) for axis, size in sizes.items()), base=calibration.path.read_text()
    )
    text = (SAMPLES / f"cone_frustum.{suffix}").read_text()
    result = done(text, dmu50, path, f"cone.{suffix}")
    truth = WornMachine(path, reversal=sizes)
    off = truth.off(result.commands, result.nominal)
    assert np.sqrt(np.mean(truth.off(result.nominal, result.nominal) ** 2)) > 50.0
    # Where rounded B and C move linear axes back by a µm or two, backlash absorbs it.
    assert off.max() <= ROUNDING_UM + 1.5 and np.sqrt(np.mean(off**2)) < 0.7
    assert result.report.complete
    added = len(body(result).splitlines()) - len(text.splitlines())
    assert added == result.report.added > 0


def test_a_correction_reverses_an_axis_that_the_program_holds_still(
    dmu50: Machine, calibration: Calibration, tmp_path: Path
) -> None:
    """Motion along X: Y and Z follow X's straightness back and forth by micrometres, which backlash would absorb."""
    assert calibration.path is not None
    path = extended(tmp_path, reversal("Y", -12.0), base=calibration.path.read_text())
    text = "G90\nG0 X20 Y100 Z-100 B30 C0\nG1 X480 F500\nY120\nX20\nY140\nX480\n"
    result = done(text, dmu50, path)
    truth = WornMachine(path, reversal={"Y": -12.0})
    off = truth.off(densely(result.commands), densely(result.nominal))
    assert {note.axis: note.taken_up for note in result.report.reversals}["Y"] >= 3  # one by the program alone
    # End points and interiors: tolerance between end points, rounding, and 1.5 least increments that do not count as a reversal.
    assert off[8:].max() <= 1.0 + ROUNDING_UM + 1.5
    assert np.sqrt(np.mean(off[8:] ** 2)) < 0.8


def test_a_warm_up(dmu50: Machine, tmp_path: Path) -> None:
    path = extended(tmp_path, GROWTH, DRIFT)
    result = done(PROGRAM, dmu50, path, conditions=Conditions({"bed": 22.5}, 1800.0))
    shift = (0.0, 8.0 * (1.0 - np.exp(-0.5)), 7.5)
    truth = WornMachine(path, reversal={}, shift_um=shift)
    assert truth.off(result.nominal, result.nominal).min() > 7.0
    assert truth.off(result.commands, result.nominal).max() <= ROUNDING_UM
    assert any(
        "thermal_drift:Y changes by a further 0.7 µm in the 10 minutes" in note.text for note in result.report.notes
    )


def test_without_effects_nothing_changes(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    plain = done(PROGRAM, dmu50, calibration)
    none = effect_named("reversal", "Y", {"size": 0.0}, dmu50)
    assert done(PROGRAM, dmu50, replace(calibration, extra=(none,))).text == plain.text
    warm = done(PROGRAM, dmu50, calibration, conditions=Conditions({"Z": 24.0}, 60.0))
    assert warm.text == plain.text
    notes = [note.text for note in warm.report.notes]
    assert "T_Z_degC was given and the calibration does not need it" in notes
    assert "time_s was given and the calibration does not need it" in notes
    assert "  conditions" not in warm.report.to_text() and "backlash" not in plain.report.to_text()


def test_scope_and_the_baseline(dmu50: Machine, tmp_path: Path) -> None:
    path = extended(tmp_path, reversal("Y", -12.0), EXPANSION)
    at = Conditions(WARM)
    straight = done(PROGRAM, dmu50, path, conditions=at, scope=Scope.parse(["L-STR"]))
    assert straight.text == PROGRAM and "Y -12.0 µm: not in scope" in straight.report.to_text()
    assert straight.report.after.rms_um == pytest.approx(straight.report.before.rms_um)
    assert {share.name: share.before_max_um > 6.0 for share in straight.report.classes} == {"L-POS": True}
    thesis = done(PROGRAM, dmu50, path, conditions=at, method="thesis")
    assert thesis.report.reversals[0].taken_up == 0 and thesis.report.after.rms_um > 5.0


def test_inverse_time_feed_of_each_piece(dmu50: Machine, tmp_path: Path) -> None:
    text = "G90\nG0 X100 Y100 Z-100 B30 C10\nG1 G93 Y140 F2.\nY90 F2.\n"
    result = done(text, dmu50, extended(tmp_path, reversal("Y", -12.0)))
    feeds = [float(line.split("F")[1]) for line in body(result).splitlines() if "F" in line]
    assert feeds[1] == feeds[3] == 2.0
    # 12 µm of 50 mm take the same fraction of half a minute.
    assert feeds[2] == pytest.approx(2.0 * 50.012 / 0.012, rel=1e-3)


# ---- sides


def path_of(machine: Machine, text: str, *, tcp: bool = False) -> tuple[ToolPath, WordSpace, Compensator]:
    dialect = dialect_for(Path("p.nc"))
    program = dialect.read(text.encode(), "p.nc")
    compensator = Compensator(machine, Calibration.zero(machine), Options())
    space = compensator.prepared.space
    return follow(program, dialect.moves(program, space.axes, tcp=tcp), space), space, compensator


def test_sides_with_play_and_with_an_overcompensating_control(dmu50: Machine) -> None:
    path, _, _ = path_of(dmu50, "G0 X1 Y1 Z-1 B0 C0\n")
    way = np.array([100.0, 100.003, 100.02, 100.02, 100.0167, 100.0, 100.002, 99.0])
    commands = np.zeros((len(way), 5))
    commands[:, 1] = way
    motion = np.zeros(len(way), dtype=int)

    def of(size: float) -> Backlash:
        effect = effect_named("reversal", "Y", {"size": size}, dmu50)
        return Backlash(replace(Calibration.zero(dmu50), extra=(effect,)))

    play = of(-10.0).sides(path, motion, commands)[:, 1]
    assert play == pytest.approx([0.0, 0.6, 1.0, 1.0, 0.34, -1.0, -0.6, -1.0])
    # 1.5 increments are a reversal, and the commanded side changes directly after the extreme point.
    jumping = of(10.0).sides(path, motion, commands)[:, 1]
    assert jumping.tolist() == [0.0, 1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0]
    slow = commands[:6].copy()
    slow[:, 1] = [100.0, 101.0, 101.0, 100.9996, 100.9992, 100.998]
    assert of(10.0).sides(path, motion[:6], slow)[:, 1].tolist() == [0.0, 1.0, 1.0, 1.0, 1.0, -1.0]
    assert of(-10.0).commanded_sides(path, motion[:6], slow)[:, 1].tolist() == [0.0, 1.0, 1.0, -1.0, -1.0, -1.0]


def test_sides_after_lines_left_as_written(dmu50: Machine, tmp_path: Path) -> None:
    """After a block in machine coordinates the side is that of its motion; after a reference return it is unknown."""
    text = "G90\nG0 X100 Y100 Z-100 B30 C10\nG1 Y120 Z-110 F500\nG53 Y400\nG1 X110\nG28 Z-50\nG0 X120 Y200\nG0 Z-100\nG1 Z-120\n"
    path, space, _ = path_of(dmu50, text)
    assert [(passage.before, passage.moved.tolist().index(True)) for passage in path.passages] == [
        (2, 1),
        (3, 2),
        (3, 0),
    ]
    effects = tuple(effect_named("reversal", axis, {"size": -10.0}, dmu50) for axis in "YZ")
    backlash = Backlash(replace(Calibration.zero(dmu50), extra=effects))
    commands = space.commands(
        np.array([motion.end for motion in path.motions]), np.zeros(len(path.motions), dtype=bool)
    )
    sides = backlash.sides(path, np.arange(len(path.motions)), commands)
    assert sides[:, 1].tolist() == [0.0, 1.0, 1.0, -1.0, -1.0]
    assert sides[:, 2].tolist() == [0.0, -1.0, -1.0, 0.0, -1.0]
    result = done(text, dmu50, extended(tmp_path, reversal("Y", -12.0), reversal("Z", -8.0)))
    # Z stays where the reference return took it: its side is unknown until the program moves it again.
    assert "G53 Y400\n" in result.text and "G28 Z-50\nG0 X120 Y200\nG0 Z" in result.text
    assert any("approach direction of Z unknown" in note.text for note in result.report.notes)


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0.0, 50.0, 300.0]), sign=st.sampled_from([-1.0, 1.0]))
def test_compensate_then_execute(dmu50: Machine, seed: int, size: float, sign: float) -> None:
    """Random worn machines, random programs that move every axis in every block: the executed output is on the nominal path."""
    rng = np.random.default_rng(seed)
    known = worn(dmu50, rng, size, sign)
    ends = np.cumsum(rng.uniform(0.5, 6.0, (12, 5)) * rng.choice([-1.0, 1.0], (12, 5)), axis=0)
    ends += [250.0, 225.0, -200.0, 90.0, 0.0] - ends.mean(axis=0)
    result, off = executed(program_of(ends, np.ones(ends.shape, dtype=bool)), dmu50, known)
    assume(result.report.complete)
    assert off.max() <= ROUNDING_UM


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([5.0, 50.0, 300.0]), sign=st.sampled_from([-1.0, 1.0]))
def test_compensate_then_execute_with_words_left_out(dmu50: Machine, seed: int, size: float, sign: float) -> None:
    """Axes that the program holds still move only by corrections; backlash absorbs no more than a motion too small to be a reversal."""
    rng = np.random.default_rng(seed)
    known = worn(dmu50, rng, size, sign)
    ends = rng.uniform([5, 5, -395, 30, -400], [495, 445, -5, 150, 400], (12, 5))
    ends[0] = ends[1] - 1.0  # every axis is first approached from below; unknown sides are tested elsewhere
    named = rng.random(ends.shape) < 0.5
    named[:2] = True
    result, off = executed(program_of(ends, named), dmu50, known)
    assume(result.report.complete)
    # 1.5 increments of each axis do not count as a reversal: 2.6 µm of the linear ones together, 26 µrad of a rotary one at 300 mm.
    assert off.max() <= 2.6 + 7.8
    assert np.sqrt(np.mean(off**2)) < 2.0


def worn(machine: Machine, rng: np.random.Generator, size: float, sign: float) -> Calibration:
    drawn = random_calibration(machine, rng, size) if size else Calibration.zero(machine)
    sizes = {axis: sign * rng.uniform(*((2.0, 30.0) if axis in "XYZ" else (30.0, 150.0))) for axis in "XYZBC"}
    effects = [effect_named("reversal", axis, {"size": float(size)}, machine) for axis, size in sizes.items()]
    effects.append(effect_named("thermal_expansion", "X", {"coefficient": 11.0}, machine))
    effects.append(effect_named("thermal_growth", "Z by bed", {"coefficient": 3.0}, machine))
    return replace(drawn, extra=tuple(effects))


def program_of(ends: np.ndarray, named: np.ndarray) -> str:
    lines = ["G90"]
    for i, (row, said) in enumerate(zip(ends, named, strict=True)):
        words = " ".join(f"{axis}{value:.3f}" for axis, value, yes in zip(AXES, row, said, strict=True) if yes)
        if words:
            lines.append(f"{'G0' if i == 0 else 'G1'} {words}" + (" F500" if i == 1 else ""))
    return "\n".join(lines) + "\n"


def executed(text: str, machine: Machine, known: Calibration) -> tuple[Compensation, np.ndarray]:
    """Return the output, and the error of its block end points when executed by `twin`, µm, without inserted backlash moves."""
    dialect = dialect_for(Path("p.nc"))
    options = Options(tool_length_mm=LENGTH, conditions=Conditions({"X": 26.0, "bed": 23.0}), tolerance_mm=0.05)
    compensator = Compensator(machine, known, options)
    result = compensator.compensate(dialect.read(text.encode(), "p.nc"), dialect)
    program = dialect.read(result.text.encode(), "out.nc")
    space = compensator.prepared.space
    run = execute(
        program, follow(program, dialect.moves(program, space.axes, tcp=False), space), space, compensator.prepared.real
    )
    reached = run.reached_mm[run.ends]
    off = np.linalg.norm(reached - space.nominal.forward(result.nominal).point_mm, axis=1) * 1e3
    return result, off[~taking_up(result)]


# ---- conditions that are given, and that are refused


def run_cli(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        cli.main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


@pytest.fixture
def part(tmp_path: Path) -> Path:
    path = tmp_path / "part.nc"
    path.write_text(PROGRAM)
    return path


def test_a_missing_channel_is_refused(part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = extended(tmp_path, reversal("Y", -12.0), EXPANSION, GROWTH, DRIFT)
    for given_, words in (
        ([], ["thermal_expansion:X needs T_X_degC", "the temperature of X and bed, the time (--temperature, --time)"]),
        (["--temperature", "X=23.1", "bed=21"], ["thermal_drift:Y needs time_s", "expected the time (--time)"]),
        (
            ["--temperature", "X=23.1", "--time", "60"],
            ["thermal_growth:Z by bed needs T_bed_degC", "the temperature of bed (--temperature)"],
        ),
    ):
        for command in ("compensate", "scene"):
            out = tmp_path / ("out.nc" if command == "compensate" else "out.html")
            status, _, message = run_cli(capsys, command, part, "-o", out, "-c", path, *given_)
            assert status == 2 and message.count("\n") == 1
            assert "extended.yaml" in message
            for word in words:
                assert word in message
            assert not out.exists()


def test_an_impossible_channel_is_refused(part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = extended(tmp_path, EXPANSION, GROWTH, DRIFT)
    out = tmp_path / "out.nc"
    for given_, word in (
        (["--temperature", "X=23", "bedd=21"], "'bedd' (did you mean bed?); expected one of X, Y, Z, B, C, bed"),
        (["--temperature", "x=23", "bed=21"], "'x' (did you mean X?)"),
        (["--temperature", "X=23", "oil=21"], "'oil'; expected one of X, Y, Z, B, C, bed"),
        (["--temperature", "X=296", "bed=21"], "°C from -40 to 120"),
        (["--temperature", "X=warm"], "finite"),
        (["--temperature", "X=nan"], "finite"),
        (["--temperature", "23.1"], "X=23.1"),
        (["--temperature", "X=23", "X=24"], "once"),
        (["--temperature", "X=23", "bed=21", "--time", "-5"], "0 or more"),
    ):
        status, _, message = run_cli(capsys, "compensate", part, "-o", out, "-c", path, *given_)
        assert status == 2 and message.count("\n") == 1 and word in message, (given_, message)
        assert not out.exists()


def test_the_report_states_conditions_and_backlash(
    part: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = extended(tmp_path, reversal("Y", 12.0), EXPANSION, DRIFT)
    arguments = ["-c", path, "--temperature", "X=26,Y=21", "--time", 3600, "--tool-length", LENGTH]
    status, printed, _ = run_cli(
        capsys, "compensate", part, "-o", tmp_path / "out.nc", "--json", tmp_path / "r.json", *arguments
    )
    assert status == 0
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["conditions"] == {"T_X_degC": 26.0, "time_s": 3600.0}
    assert report["reversals"] == [{"axis": "Y", "unit": "um", "size": 12.0, "corrected": True, "taken_up": Y_TURNS}]
    notes = [note["text"] for note in report["notes"]]
    assert "T_Y_degC was given and the calibration does not need it" in notes
    assert any("jumps ahead when it reverses" in note for note in notes)
    assert "conditions    X 26 °C, time 3600 s" in printed
    assert f"Y 12.0 µm: taken up by extra moves at {Y_TURNS} reversals of Y" in printed
    known = Calibration.load(path, Machine.load("dmu50"))
    again = compensate(
        part, known.machine, known, options=Options(tool_length_mm=LENGTH), temperature={"X": 26.0}, time_s=3600.0
    )
    assert again.text == (tmp_path / "out.nc").read_text()
    status, printed, _ = run_cli(capsys, "scene", part, "-o", tmp_path / "s.html", *arguments)
    assert status == 0 and "T_Y_degC has no effect" in printed and (tmp_path / "s.html").is_file()


def test_info_lists_omitted_effects(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = extended(tmp_path, reversal("Y", 12.0), EXPANSION, GROWTH)
    status, printed, _ = run_cli(capsys, "info", "-c", path, "--temperature", "X=26")
    assert status == 0
    assert "omitted: thermal_growth:Z by bed (needs the temperature of bed)" in printed
    for word in ("reversal:Y", "thermal_expansion:X", "± half its size", "T_X_degC 26"):
        assert word in printed
    assert run_cli(capsys, "info", "-c", path, "--temperature", "bad=26")[0] == 2


def test_the_budget_of_effects(dmu50: Machine, tmp_path: Path) -> None:
    known = Calibration.load(extended(tmp_path, reversal("Y", 12.0), EXPANSION, GROWTH, reversal("B", 60.0)), dmu50)
    known = replace(known, joint=Covariance(("reversal:Y.size",), read_only(np.array([[4.0]]))))
    at = Conditions({"X": 26.0})
    rest, missing = without_missing_channels(at, known)
    assert missing == {"T_bed_degC": ("thermal_growth:Z by bed",)}
    rows = {row.name: row for row in error_budget(dmu50, rest, conditions=at)[0]}
    assert list(rows) == ["reversal:Y", "thermal_expansion:X", "reversal:B"]
    lost = rows["reversal:Y"]
    assert (lost.iso_class, lost.unit, lost.peak) == ("L-POS", "um", pytest.approx(6.0))
    assert (lost.tool_rms_um, lost.tool_max_um, lost.peak_u) == pytest.approx((6.0, 6.0, 1.0))
    assert rows["thermal_expansion:X"].tool_max_um == pytest.approx(11.0 * 6.0 * 0.5, rel=2e-3)
    assert (rows["reversal:B"].iso_class, rows["reversal:B"].unit, rows["reversal:B"].peak) == (
        "R-POS",
        "urad",
        pytest.approx(30.0),
    )
    total = {row.name: row.tool_rms_um for row in error_budget(dmu50, rest, conditions=at)[1]}
    # Both sides are equally likely: their squares add, except for the sample correlation over 2000 poses.
    assert total["all"] == pytest.approx(np.sqrt(sum(row.tool_rms_um**2 for row in rows.values())), rel=0.05)
    with pytest.raises(InputError, match="T_bed_degC"):
        error_budget(dmu50, known, conditions=at)


def test_the_uncertainty_of_a_reversal_counts_half(dmu50: Machine, tmp_path: Path) -> None:
    known = Calibration.load(extended(tmp_path, reversal("Y", 12.0)), dmu50)
    known = replace(known, joint=Covariance(("reversal:Y.size",), read_only(np.array([[4.0]]))))
    tool = ToolUncertainty(Kinematics(dmu50, known))
    q = [250.0, 225.0, -200.0, 0.0, 0.0]
    for side in (-1.0, 1.0):
        found = tool.at(q, [0.0, side, 0.0, 0.0, 0.0])
        assert found.standard_um[0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
    assert tool.at(q).expanded_um[0] == 0.0
    assert tool.over_volume(200).rms_um == pytest.approx(1.959964, rel=1e-4)
    drawn = sampled(tool, q, np.random.default_rng(3), approach=[[0.0, 1.0, 0.0, 0.0, 0.0]])
    assert drawn.covariance[0, 1, 1] == pytest.approx(1.0, rel=0.05)  # 10,000 draws: 1.4 % standard error
    report = done(PROGRAM, dmu50, known).report.uncertainty
    assert report.point is not None and report.point.expanded_max == pytest.approx(1.959964, rel=1e-3)


@pytest.mark.parametrize(
    ("effect", "where", "numbers", "acts", "found"),
    [
        ("reversal", "Y", {"size": 1.0}, "E_YY", "L-POS"),
        ("reversal", "C", {"size": 1.0}, "E_CC", "R-POS"),
        ("thermal_growth", "Z by bed", {"coefficient": 1.0}, "E_ZX", "L-STR"),
        ("table_load", "B", {"tilt": 1.0}, "E_AB", "R-ANG"),
        ("cross_axis", "E_ZY by Z", {"coefficient": 1.0}, "E_ZY", "L-STR"),
        ("harmonic", "E_XB", {"order": 2.0, "cos": 0.0, "sin": 1.0}, "E_XB", "R-RAX"),
        ("gravity_compliance", "B", {"compliance": 1.0}, "E_CB", "R-POS"),
    ],
)
def test_every_effect_has_a_class(
    dmu50: Machine, effect: str, where: str, numbers: dict[str, float], acts: str, found: str
) -> None:
    name = error_motion_of(effect_named(effect, where, numbers, dmu50), dmu50)
    assert (name, iso_class(name, dmu50)) == (acts, found)


def test_growth_with_the_spindle_speed(dmu50: Machine, tmp_path: Path) -> None:
    """Two hours at 8,000 of 12,000 1/min, time constant 20 min; without the speed nothing is written."""
    growth = effect_named(
        "spindle_growth",
        "Z",
        {"amplitude": 25.0, "exponent": 1.5, "time_constant": 1200.0, "highest_rpm": 12000.0},
        dmu50,
    )
    path = tmp_path / "grown.yaml"
    Calibration.default(dmu50).extended([growth], Covariance.none(), "a test").save(path)
    with pytest.raises(InputError, match="spindle_growth:Z needs spindle_rpm"):
        done(PROGRAM, dmu50, path, conditions=Conditions({}, 7200.0))
    with pytest.raises(InputError, match="spindle speed must be zero or positive"):
        done(PROGRAM, dmu50, path, conditions=Conditions({}, 7200.0, -1.0))
    result = done(PROGRAM, dmu50, path, conditions=Conditions({}, 7200.0, 8000.0))
    truth = WornMachine(path, reversal={}, shift_um=(0.0, 0.0, 25.0 * (8.0 / 12.0) ** 1.5 * (1.0 - np.exp(-6.0))))
    assert truth.off(result.nominal, result.nominal).min() > 7.0
    assert truth.off(result.commands, result.nominal).max() <= ROUNDING_UM


def test_a_load_in_the_spindle(dmu50: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Z gives way by 0.1 µm/N under its own 240 kg (URDF) and 20 kg in the spindle; without the load nothing is written."""
    path, program = tmp_path / "loaded.yaml", tmp_path / "program.nc"
    program.write_text(PROGRAM)
    carried = "{effect: carried_load, where: tool, parameters: {centre_x_mm: 0, centre_y_mm: 0, centre_z_mm: -80}}"
    gives_way = "{effect: gravity_compliance, where: Z, parameters: {compliance: 0.1}}"
    path.write_text(f"{HEAD}curves: {{}}\neffects:\n- {carried}\n- {gives_way}\n")
    words = ["compensate", str(program), "-o", str(tmp_path / "out.nc"), "--calibration", str(path), "--tool-length"]
    status, _, message = run_cli(capsys, *words, "120")
    assert status == 2
    assert "gravity_compliance:Z needs load_kg" in message and "--load" in message
    assert not (tmp_path / "out.nc").exists()
    with pytest.raises(InputError, match="load must be zero or positive"):
        done(PROGRAM, dmu50, path, conditions=Conditions(load_kg=-1.0))
    result = done(PROGRAM, dmu50, path, conditions=Conditions(load_kg=20.0))
    assert "load 20 kg, over the whole program" in result.report.to_text()
    truth = WornMachine(path, reversal={}, shift_um=(0.0, 0.0, -0.1 * (240.0 + 20.0) * 9.81))
    assert truth.off(result.nominal, result.nominal).min() > 15.0
    assert truth.off(result.commands, result.nominal).max() <= ROUNDING_UM
    assert run_cli(capsys, *words, "120", "--load", "20")[0] == 0
    assert (tmp_path / "out.nc").read_bytes() == compensate(
        program, dmu50, Calibration.load(path, dmu50), options=Options(tool_length_mm=120.0), load_kg=20.0
    ).text.encode()
