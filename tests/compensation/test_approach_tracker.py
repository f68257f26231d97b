"""Approach directions followed portion by portion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.compensation import Compensator, Options
from twin.compensation.programs import parts
from twin.compensation.programs.backlash import ApproachTracker, Backlash
from twin.compensation.programs.correction import correct
from twin.compensation.programs.motions import MotionColumns, Passage, ToolPath
from twin.compensation.programs.path_errors import PathErrors
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.model.calibration_file import acting_frame
from twin.model.effects import Empirical, Reversal, ReversalCurve
from twin.model.effects.harmonic import Waves
from twin.nc import dialect_for

SIZES = {"X": -8.0, "Y": 6.0, "B": -60.0}


@pytest.fixture(scope="module")
def backlash() -> Backlash:
    machine = Machine.load("dmu50")
    added = tuple(Reversal(machine.by_name[name], size) for name, size in SIZES.items())
    return Backlash(replace(Calibration.zero(machine), extra=added))


def walk(rng: np.random.Generator, count: int) -> np.ndarray:
    """Return commands with long, short and no steps, mm and degrees."""
    size = rng.choice([0.0, 0.001, 0.003, 1.0], size=(count, 5))
    return np.cumsum(size * rng.choice([-1.0, 1.0], size=size.shape), axis=0)


def path(rng: np.random.Generator, count: int) -> ToolPath:
    """Return a path with lines passed through before some of its motions; its motions are not used."""
    none = MotionColumns.of({}, 5)
    places = np.sort(rng.choice(count, size=count // 20, replace=False)).tolist()
    passages = [Passage(i, rng.choice([np.nan, 1.0], size=5), rng.random(5) < 0.5) for i in places]
    return ToolPath(none, none, (), tuple(passages))


@pytest.mark.parametrize("seed", range(10))
def test_portions_give_the_directions_of_the_whole(backlash: Backlash, seed: int) -> None:
    rng = np.random.default_rng(seed)
    commands, program = walk(rng, 300), path(rng, 100)
    motion = np.repeat(np.arange(100), 3)
    cuts = np.split(np.arange(300), np.sort(rng.choice(300, size=8)))
    tracker = ApproachTracker(backlash, program)
    found = np.concatenate([tracker.after(motion[part], commands[part]) for part in cuts])
    assert np.allclose(found, backlash.sides(program, motion, commands), rtol=0.0, atol=1e-7)


def test_the_play_of_a_varying_reversal_value_is_its_largest_by_size() -> None:
    machine = Machine.load("dmu50")
    curve = ReversalCurve(machine.by_name["X"], (-4.0, -6.0))  # from +2 to −10 µm
    assert Backlash(replace(Calibration.zero(machine), extra=(curve,))).size == pytest.approx(
        [-0.01, 0.0, 0.0, 0.0, 0.0], abs=1e-12
    )


def test_an_axis_whose_direction_only_a_pattern_depends_on_is_followed() -> None:
    machine = Machine.load("dmu50")
    frame, turning = acting_frame("tool", "base", machine)
    pattern = Empirical("tool by approach_Y", "base", [Waves("approach_Y", "direction", 1)], {}, frame, turning)
    followed = Backlash(replace(Calibration.zero(machine), extra=(pattern,)))
    assert [machine.names[axis] for axis in followed.axes] == ["Y"]
    steps = np.zeros((4, 5))
    steps[:, machine.names.index("Y")] = [1.0, 1.0, -1.0, -1.0]
    sides = followed.sides(path(np.random.default_rng(0), 0), np.arange(4), np.cumsum(steps, axis=0))
    assert sides[:, machine.names.index("Y")].tolist() == [0.0, 1.0, -1.0, -1.0]


def test_an_inserted_move_that_prints_as_its_neighbour_is_omitted(tmp_path: Path) -> None:
    """A reversal value below half an increment of the words: its moves lead nowhere and are omitted (a `ValueError` once)."""
    machine = Machine.load("dmu50")
    added = (Reversal(machine.by_name["C"], -5.0),)
    given = Calibration.default(machine)
    compensator = Compensator(machine, replace(given, extra=(*given.extra, *added)), Options(tool_length_mm=120.0))
    rng = np.random.default_rng(2)
    steps = 0.5 * rng.integers(-3, 4, size=(200, 5)) * (rng.random((200, 5)) < 0.6)
    rows = np.array([200.0, 200.0, -150.0, 30.0, 40.0]) + np.cumsum(steps, axis=0)
    source, target = tmp_path / "p.nc", tmp_path / "out.nc"
    lines = ("X{:.3f} Y{:.3f} Z{:.3f} B{:.3f} C{:.3f}\n".format(*row) for row in rows.tolist())
    source.write_text(f"G90 G21\nG1 F2000\n{''.join(lines)}M30\n")
    report = compensator.compensate_file(source, target)
    assert report.complete and report.rewritten == 200


def test_errors_between_end_points_are_those_of_the_final_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Errors kept from splitting are discarded where rows change afterwards: moves that take up backlash are inserted."""
    machine = Machine.load("dmu50")
    given = Calibration.default(machine)
    added = (Reversal(machine.by_name["X"], -40.0), Reversal(machine.by_name["C"], -900.0))
    compensator = Compensator(machine, replace(given, extra=(*given.extra, *added)), Options(tool_length_mm=120.0))
    t = np.linspace(0.0, 6.0, 60)
    rows = np.c_[200 + 60 * np.cos(t), 200 + 60 * np.sin(t), -150 + 5 * t, 30 + 10 * np.sin(t), 60 * np.sin(2 * t)]
    lines = ("X{:.3f} Y{:.3f} Z{:.3f} B{:.3f} C{:.3f}\n".format(*row) for row in rows.tolist())
    dialect = dialect_for(Path("p.nc"))
    program = dialect.read(f"G90 G21\nG1 F2000\n{''.join(lines)}M30\n".encode(), "p.nc")
    kept = []
    monkeypatch.setattr(parts, "correct", lambda *a, **b: kept.append(correct(*a, **b)) or kept[-1])
    compensator.compensate(program, dialect)
    assert kept
    for corrected in kept:
        fresh = PathErrors(corrected.pieces).motion_errors_mm(corrected.rows)
        assert corrected.rows.backlash_move.any()
        assert np.allclose(corrected.path_errors.motion_errors_mm(corrected.rows), fresh, rtol=0.0, atol=1e-12)
