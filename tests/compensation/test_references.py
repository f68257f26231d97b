"""Reference returns to positions that the machine file names.

Truth: LinuxCNC's interpreter, whose parameters name the same positions.
"""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.compensation.test_shifts import ONE, PARAMETERS, compensated, distinct
from tests.model.errors import random_calibration
from tests.nc import rs274
from twin._common.errors import InputError
from twin.compensation.programs.words import Setup
from twin.machine.machine import Machine
from twin.model.calibration import Calibration

HOME = {"X": 480.0, "Y": 430.0, "Z": -20.0, "B": 0.0, "C": 12.5}
OTHER = {"X": 20.0, "Y": 30.0, "Z": -40.0, "B": 3.0, "C": 0.0}
STORED = "".join(
    f"{first + axis} {value:.6f}\n"
    for first, row in ((5161, HOME), (5181, OTHER))
    for axis, value in zip((0, 1, 2, 4, 5), row.values(), strict=True)
)


def machine_with(folder: Path, references: str) -> Machine:
    """Return the DMU 50 with reference positions."""
    found = Machine.load("dmu50")
    path = folder / "machine.yaml"
    text = found.path.read_text().replace(f"urdf: {found.urdf.name}", f"urdf: {found.urdf}")
    lines = [line for line in text.splitlines() if not line.startswith("calibration:")]
    assert not any(line.startswith("programs:") for line in lines)
    path.write_text("\n".join([*lines, f"programs: {{references: {references}}}", ""]))
    return Machine.load(path)


def random_program(rng: Random) -> str:
    def words(axes: str) -> str:
        chosen = sorted(rng.sample(axes, rng.randint(1, len(axes))))
        return " ".join(f"{axis}{(40 if axis == 'B' else 0) + rng.uniform(-30, 30):.3f}" for axis in chosen)

    lines = ["G90 G21 G17 G94 G54 F500", "G0 X0 Y0 Z0 B40 C0"]
    for _ in range(12):
        kind = rng.choice(["move", "move", "zero", "all", "other"])
        if kind == "move":
            lines.append(f"G{rng.choice([0, 1])} {words('XYZBC')}")
        elif kind == "zero":
            axes = sorted(rng.sample("XYZBC", rng.randint(1, 3)))
            lines += ["G91 G28 " + " ".join(f"{axis}0" for axis in axes), "G90"]
        else:
            lines.append("G28" if kind == "all" else f"G30 {words('XYZ')}")
    return "\n".join([*lines, "G1 X1", "M2", ""])


def positions(text: str, folder: Path) -> np.ndarray:
    path = folder / "part.ngc"
    path.write_text(text)
    reading = rs274.read(path, folder, parameters=STORED + PARAMETERS)
    assert not reading.refusal, f"line {reading.line}: {reading.refusal}\n{text}"
    return distinct(np.array([motion.machine for motion in reading.motions]))


@rs274.needed
@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", range(8))
def test_a_program_goes_on_from_a_known_reference(tmp_path: Path, seed: int) -> None:
    """Check that every move of the original and of the output ends where the control has it."""
    machine = machine_with(tmp_path, f"{{G28: {HOME}, G30: {OTHER}}}".replace("'", ""))
    errors = random_calibration(machine, np.random.default_rng(4), size=30.0)
    text = random_program(Random(seed))
    assert "G28" in text
    for calibration in (Calibration.zero(machine), errors):
        result = compensated(text, machine, calibration, ONE)
        done, at = positions(result.text, tmp_path), 0
        for row in distinct(result.commands):
            near = np.flatnonzero(np.abs(done[at : at + 16] - row).max(axis=1) < 2e-6)
            assert near.size, f"{row}\n{result.text}"
            at += int(near[0])
        assert not [one for one in result.report.not_corrected if one.kind == "unknown"]
        returns = [line for line in text.splitlines() if line.split()[-1] != "G90" and ("G28" in line or "G30" in line)]
        assert all(line in result.text.splitlines() for line in returns)


PROGRAM = "G90 G21 G54\nG0 X0 Y0 Z0 B40 C0\nG1 X1 F100\nG91 G28 {}\nG90\nG1 X5\n"


@pytest.mark.parametrize(
    ("axes", "cure"), [("B0", "G28: {B: ...}"), ("Y0 B0", "G28: {Y: ..., B: ...}"), ("Z0", "G28: {Z: ...}")]
)
def test_a_block_left_as_written_names_the_missing_entry(dmu50: Machine, axes: str, cure: str, tmp_path: Path) -> None:
    errors = random_calibration(dmu50, np.random.default_rng(5), size=20.0)
    report = compensated(PROGRAM.format(axes), dmu50, errors, Setup()).report
    (left,) = [one for one in report.not_corrected if one.kind == "unknown"]
    assert left.missed == (6,) and not report.complete
    assert f"programs: {{references: {{{cure}}}}}" in left.reason
    if "Y" not in axes:
        with pytest.raises(InputError, match="arc where the program has not given a position of") as refused:
            compensated(PROGRAM.format(axes) + "G2 X5 Y5 R5\n", dmu50, errors, Setup())
        assert refused.value.line == 7 and f"programs: {{references: {{{cure}}}}}" in refused.value.expected
    machine = machine_with(tmp_path, "{" + cure.replace("...", "1.5") + "}")
    result = compensated(PROGRAM.format(axes), machine, Calibration.zero(machine), ONE)
    gone = [machine.names.index(word[0]) for word in axes.split()]
    assert result.nominal[-1][gone] == pytest.approx(1.5)


def test_other_positions_of_a_program_are_not_those_of_the_machine_file(tmp_path: Path) -> None:
    machine = machine_with(tmp_path, "{G30: {Z: -5}, G30 P3: {Z: -7}}")
    zero, errors = Calibration.zero(machine), random_calibration(machine, np.random.default_rng(5), size=20.0)
    for words, height in (("G30 Z0", -5.0), ("G30 P2 Z0", -5.0), ("G30 P3 Z0", -7.0)):
        text = PROGRAM.replace("G28 {}", words)
        assert compensated(text, machine, zero, ONE).nominal[-1][2] == pytest.approx(height)
    for words in ("G28 Z0", "G30 P4 Z0", "G30.1\nG30 Z0"):
        report = compensated(PROGRAM.replace("G28 {}", words), machine, errors, ONE).report
        lost = [one.missed for one in report.not_corrected if one.kind == "unknown"]
        assert lost == [(6 + words.count("\n"),)]


@pytest.mark.parametrize(("entry", "words"), [("{G28: {W: 1}}", "not an axis"), ("{G27: {X: 1}}", "references")])
def test_entries_of_the_machine_file_are_checked(tmp_path: Path, entry: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        machine_with(tmp_path, entry)


def unknown_start(rng: Random) -> tuple[list[str], str]:
    """Return blocks before the program has given a position of every axis, and the program that begins with them."""
    lines = ["G21 G17 G94 G54 F500", rng.choice(["G90", "G91"])]
    given = rng.sample("XYZ", rng.randint(0, 2))
    for _ in range(rng.randint(1, 5)):
        kind = rng.choice(["feed", "rapid", "mode"])
        if kind == "mode":
            lines.append(rng.choice(["G90", "G91"]))
        elif (absolute := "G90" in [line for line in lines if line in ("G90", "G91")][-1:]) and not given:
            continue
        else:
            axes = sorted(rng.sample(given if absolute else "XYZ", rng.randint(1, len(given) if absolute else 3)))
            words = " ".join(f"{axis}{rng.uniform(-9, 9):.3f}" for axis in axes)
            lines.append(f"G{int(kind == 'feed')} {words}")
    later = [
        "G90",
        f"G{rng.choice([0, 1])} X1 Y2 Z3 B40 C5",
        "G1 X9 B41",
        "G91",
        "G1 X2.5 Y-1 Z.5",
        "G0 Z4",
        "G90 X3 Y4",
        "M2",
        "",
    ]
    return lines, "\n".join([*lines, *later])


@rs274.needed
@pytest.mark.sample(4)  # of 24
@pytest.mark.parametrize("seed", range(24))
def test_a_program_that_begins_anywhere(tmp_path: Path, seed: int) -> None:
    """Blocks before the first known position stay as written, feeds among them are listed, and later ones end where they are meant."""
    machine = machine_with(tmp_path, "{}")
    errors = random_calibration(machine, np.random.default_rng(4), size=30.0)
    lines, text = unknown_start(Random(seed))
    result = compensated(text, machine, errors, ONE)
    assert [line for line in result.text.splitlines() if not line.startswith("(")][: len(lines)] == lines
    feeds = [i for i, line in enumerate(lines, 1) if line.startswith("G1 ")]
    lost = [line for one in result.report.not_corrected if one.kind == "unknown" for line in one.missed]
    assert sorted(lost) == feeds and result.report.complete is not bool(feeds)
    done, at = positions(result.text, tmp_path), 0
    for row in distinct(result.commands):
        near = np.flatnonzero(np.abs(done[at : at + 16] - row).max(axis=1) < 2e-6)
        assert near.size, f"{row}\n{result.text}"
        at += int(near[0])
    assert at == len(done) - 1
