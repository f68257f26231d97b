"""LinuxCNC's interpreter as the judge of reading: every position is the same, or twin refuses the program with the line.

Where the two differ in a program that both accept, the manual of LinuxCNC decides ("G-Codes", "O Codes", "Parameters"), unless the
word means something else on another control: then twin says so.
"""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.nc import rs274
from tests.nc.linuxcnc_programs import PARAMETERS, TOOLS, ControlProgram
from tests.nc.nc_support import read_moves
from tests.nc.readings import Comparison, compare
from tests.truth.machine import TruthMachine
from twin._common.bundled import find_program
from twin.compensation import Compensator, Options
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import dialect_for, read_program
from twin.nc.arithmetic import evaluate
from twin.nc.iso import cycles

pytestmark = rs274.needed
NCFILES = Path("/usr/share/linuxcnc/ncfiles")
KINDS = {
    "lines and arcs": ("line", "line", "arc", "arc", "mode", "feed"),
    "parameters": ("line", "assign", "assign", "arc"),
    "offsets": ("line", "line", "offset", "machine"),
    "turned offsets": ("line", "line", "turned", "machine"),
    "tools": ("line", "line", "tool", "machine"),
    "subprograms": ("line", "call", "assign"),
    "loops": ("line", "loop", "assign"),
    "unknown positions": ("line", "loop", "arc", "machine", "call"),
    "arcs in other frames": ("loop", "loop", "arc", "tool", "offset"),
    "cycles": ("line", "cycle", "mode"),
    "polar words": ("line", "polar", "polar", "assign", "mode"),
    "saved modes": ("line", "saved", "mode", "polar"),
    "others": ("line", "other"),
    "everything": (
        *("line", "line", "arc", "mode", "feed", "assign", "offset", "tool", "machine", "cycle", "call", "loop"),
        *("other", "polar", "saved"),
    ),
}
SEEDS = 25


@pytest.fixture(autouse=True)
def pecks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each control has a parameter for the height at which it feeds again."""
    monkeypatch.setattr(cycles, "CLEARANCE_MM", rs274.PECK_MM)


def judged(text: str, folder: Path, *, known: bool = True) -> Comparison:
    path = folder / "part.ngc"
    path.write_text(text)
    return compare(path, folder, known=known, tools=TOOLS, parameters=PARAMETERS)


@pytest.mark.sample(70)
@pytest.mark.parametrize("seed", range(SEEDS))
@pytest.mark.parametrize("kind", KINDS)
def test_random_programs(kind: str, seed: int, tmp_path: Path) -> None:
    """A line that twin refuses is taken out, until it reads the program."""
    rng = Random(f"{kind} {seed}")
    lines = ControlProgram(rng, KINDS[kind]).grow(12).text.split("\n")
    known = rng.random() < 0.7
    for _ in range(len(lines)):
        found = judged("\n".join(lines), tmp_path, known=known)
        if not found.refused:
            break
        assert found.line is not None, found.refused
        del lines[found.line - 1]
    assert not found.refused and not found.difference, f"{found.difference}\n{found.refused}\n" + "\n".join(lines)
    assert found.blocks or (found.judge is not None and found.judge.refusal)


START = "G21 G90 G17 G94 G54 G98 F500\nG0 X250 Y200 Z50 B10 C20\n"
SUB = "o100 sub\n{}\no100 endsub\n"
EQUAL = {
    "a parameter keeps its value in the block that sets it": "#1=5\n#1=6 #2=#1 G1 X#1\nG1 X#1 Y#2",
    "a subprogram has named parameters of its own": SUB.format("#<a>=7\nG1 X#<a>") + "#<a>=5\no100 call\nG1 Y#<a>",
    "but not global ones": SUB.format("#<_a_>=7\nG1 X#<_a_>") + "#<_a_>=5\no100 call\nG1 Y#<_a_>",
    "named parameters of nested subprograms": "o101 sub\n#<a>=9\nG1 Y#<a>\no101 endsub\n"
    + SUB.format("#<a>=#1\no101 call\nG1 X#<a>")
    + "o100 call [3]\no100 call [4]",
    "named parameters of each level": SUB.format(
        "#<a>=#1\no2 if [#1 GT 0]\no100 call [#1-1] [#<a>]\no100 call [#1-2] [#<a>*2]\no2 endif\nG1 X#<a> Y#2"
    )
    + "o100 call [4] [1]",
    "spaces in a name do not count": "#<a b>=1\n#<ab>=2\nG1 X#<a b>",
    "arguments with brackets in brackets": SUB.format("G1 X#1 Y#2") + "o100 call [[1+2]*[3+1]] [SQRT[[4]]]",
    "probing stays in force": "G38.2 Z5\nX240\nG0 X3 Z9",
    "powers": "G1 X[2 ** 3 ** 2] Y[-2 ** 2] Z[7 - -3 ** 2]",
    "the present position is declared": "G92 X0 C7\nG1 X5\nG92 Y3\nG91 G1 Y5 C1\nG92.2\nG1 X5\nG92.3\nG1 Z1\nG90 G92.1\nG1 X1",
    "a local shift": "G52 X5 B1\nG91 G1 X5\nG90 G52 X7\nG1 Y5\nG52 X0 B0\nG1 Z2",
    "a work offset by its value and by the position": "G10 L2 P1 X7 Y3\nG90 G1 X5 Y2\n#<a>=1\nG10 L20 P1 X0 Y9\nG91 X1 Y1",
    "a turned work offset": "G10 L2 P1 X7 Y3 Z1 R30\nG90 G1 X5 Y2 Z1\nG2 X9 Y2 I2 J0\nG10 L2 P1 R-20\nG91 G1 X1",
    "machine coordinates where the work offset is turned": "G10 L2 P1 R30\nG53 G0 X5\nG1 X7\nY3 X1\nG53 G1 Z5\nX2",
    "the angle of the spindle": "M19 R90 Q1\nG1 X5 Y6\nG81 X9 Z-5 R2\nG80 M19 R7\nG1 X5",
    "the angle of the spindle where nothing is known": "G1 X5 Y6\nG28.1\nM19 R90\nX5",
    "an argument that changes": SUB.format("#101=9\nG1 X#1") + "#101=5\no100 call [#101]",
    "and one that changes within": "o101 sub\n#101=9\no101 endsub\n"
    + SUB.format("o101 call\nG1 X#1")
    + "#101=5\no100 call [#101]",
    "analogue outputs": "M67 E0 Q5\nG1 X5 F100 M68 E1 Q-3\nG81 X5 Y5 Z-5 R2\nM67 E2 Q1\nX7\nG80\nG1 X9",
    "inputs": "G1 X5\nM66 P0 L0\nG1 Y7\nM66 E0 L0\nX9",
    "the tool in the spindle": "G1 X5\nM61 Q2\nG43\nG1 X7 Z9\nM61 Q1 G49\nG43 Z5",
    "a length of the tool by its value": "G43.1 Z5\nG1 Z4\nX7\nG20 G43.1 Z1\nG1 Z1 X2\nG43 H1\nG1 Z3\nG43.1 Z2\nZ7\nG49\nZ1",
    "a circle of holes by polar words": "G90 G0 X30 Y0 Z5\nG91 G81 R-1 Z-3 ^60 L6\n@5\nG80\nG90 G1 @20 ^30\n^40\n@[5+5]",
    "polar words in shifted and turned coordinates": "G92 X3 Y1\nG1 @5 ^45\nG91 ^10\nG90 G92.1\nG10 L2 P1 R30\nG1 @5 ^45\nG91 @1",
    "modal words saved": "M70\nG91 G20 G18\nG1 X1\nM72\nG1 X3\nG91\nM72\nX4\nM71",
    "the end of no shift": "G92.1 G55\nG1 X5 Y3\nG92.2 G54\nX9",
    "the position at the start": "\0G21 G90 G17 F500\nG92 X0 Y0 Z0\nG1 X5 Y6\nG91 Z3\nG90 X2 Y1 Z7\nG92 X1\nX2",
    "variables of a program that names one": "#<a>=1\n#1500=7\n#4000=3\nG1 X#1500 Y#4000 Z#<a>",
    "a hole after the unit has changed": "G81 X5 Y5 Z-5 R2\nG80 G20\nG81 X1 Y1 Z-.5 R1\nG80",
}
ENDS = ("M2", "M30", "X7 M02", "N7 (end) m 30", "M99", "%", "G0 Z9 M030 (end)", "/M2")
REFUSED = {
    "modal words saved in a subprogram": SUB.format("M70\nG91\nM72") + "M70\no100 call\nM72",
    "words after the arguments": SUB.format("G1 X#1") + "o100 call [8] G1 X5",
    "another unit within a cycle": "G81 X5 Y5 Z-5 R2\nG20 X.7\nG80",
    "the angle of the spindle or the height of a cycle": "G81 X5 Y5 Z-5 R2\nM19 R4\nX7\nG80",
    "a dwell and a move": "G4 P.001 G0 X1 Y1\nG1 Z3",
    "a root of a negative number": "#1=-4\nG1 X[#1 ** 0.5]",
    "a cycle from below R on LinuxCNC": "M67 E1 Q3\nG1 Z-9\nG81 X5 Y5 Z-15 R2\nG80",
    **{word: f"{word}\nG1 X5" for word in ("G92.3", "G10 L2 P0 X7", "G10 L20 P1 X7", "#5221=7")},
    "a rotation of the work offset after G92": "G92 X0\nG10 L2 P1 R30\nG1 X5",
    **{
        word: f"T1 M6 G43\n{word}\nG1 Z5"
        for word in ("G43.1 X5", "G43.1 H2", "G1 G43.1 Z5", "G43.2 H2", "G10 L1 P1 Z9", "M73", "G7", "G41.1 D1")
    },
}


@pytest.mark.parametrize("name", EQUAL)
def test_what_was_once_read_differently(name: str, tmp_path: Path) -> None:
    text = EQUAL[name]
    found = judged((text[1:] if text[0] == "\0" else START + text) + "\nM2\n", tmp_path)
    assert found.judge is not None and not found.judge.refusal
    assert not found.difference and not found.refused and found.values > 5


@pytest.mark.parametrize("end", ENDS)
def test_behind_the_end_nothing_is_executed(end: str, tmp_path: Path) -> None:
    """In a block, or many together; twin says so, with the line, and refuses where a switch of the control decides."""
    tape = "%\n" if end == "%" else ""
    for behind in ("G1 X1 Y2\nX3", "\n".join(f"G1 X{x} Y{x}" for x in range(30)), "(M2)\n\nG2 X9 Y9 I2 J0"):
        found = judged(f"{tape}{START}G1 X5 F100 (M2 M30)\n{end}\n{behind}\n", tmp_path)
        line = 4 + len(tape.splitlines())
        if end.startswith("/"):
            assert "switch for block skip" in found.refused and found.line is not None and found.line > line
            continue
        assert not found.refused and not found.difference and found.values > 5
        assert found.judge is not None and (not found.judge.refusal) and f"in line {line})" in found.said
    again = judged(f"{tape}{START}G1 X5 F100\n{end}\n(nothing but comments)\n\n%\n", tmp_path)
    assert again.blocks and "behind the end" not in again.said


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused(name: str, tmp_path: Path) -> None:
    found = judged(START + REFUSED[name] + "\nM2\n", tmp_path)
    assert found.refused and found.line is not None and found.line > 2


NOTED = {
    "LinuxCNC raises it first": (
        "G99 G81 X5 Y5 Z-5 R2\nX7\nG98 X9\nG80",
        "G99 G81 X5 Y5 Z-5 R2\nX7 R9\nG80",
    ),
    "G98 is assumed": (START.replace(" G98", "") + "G81 X5 Y5 Z-5 R2\nG80",),
}


@pytest.mark.parametrize("said", NOTED)
def test_where_controls_differ_twin_says_so(said: str, tmp_path: Path) -> None:
    for text in NOTED[said]:
        found = judged((text if text.startswith("G21") else START + text) + "\nM2\n", tmp_path)
        assert found.difference and said in found.said
    same = judged(START + "G99 G81 X5 Y5 Z-5 R2\nX7 R1\nG80\nM2\n", tmp_path)
    assert not same.difference and said not in same.said


@pytest.mark.parametrize("known", [True, False])
def test_machine_coordinates_in_increments_are_noted(known: bool, tmp_path: Path) -> None:
    """LinuxCNC refuses them; twin passes them, says so, and does not know where the axes are until an absolute word."""
    text = START + f"G9{0 if known else 1}\nG53 G0 Z5\nG90 X1\nG91 Z1\nG90 Z7\nM2\n"
    found = judged(text, tmp_path)
    assert (
        found.judge is not None and bool(found.judge.refusal) is not known and ("G53 in G91" in found.said) is not known
    )
    moves = read_moves(dialect_for(tmp_path / "part.ngc"), text).moves[1:]
    assert [move.position[2] for move in moves] == pytest.approx(
        [5.0 if known else np.nan, np.nan, np.nan, 7.0], nan_ok=True
    )


@pytest.mark.sample(3)
@pytest.mark.parametrize("seed", range(40))
def test_expressions(seed: int, tmp_path: Path) -> None:
    rng = Random(seed)
    program = ControlProgram(rng, ("assign",), known=["#101", "#102", "#<a>"])
    values = {"#101": -3.25, "#102": 2.0, "#<A>": 7.5}
    expressions = [program.expression(rng.choice([1, 2])) for _ in range(12)]
    head = "G21 G90 F100 #101=-3.25 #102=2.0 #<a>=7.5"
    known = 0
    while expressions:
        path = tmp_path / "sums.ngc"
        path.write_text("\n".join([head, *(f"G1 X[{one}]" for one in expressions), "M2"]))
        reading = rs274.read(path, tmp_path)
        if not reading.refusal:
            break
        # Division by zero, a root of a negative number: of no value for both.
        assert not np.isfinite(evaluate(expressions.pop(len(reading.motions)), values))
    for text, motion in zip(expressions, reading.motions, strict=True):
        value = evaluate(text, values)
        known += value == value
        assert value != value or value == pytest.approx(motion.event.end[0], rel=1e-9, abs=1e-6), text
    assert known > 1


@pytest.mark.parametrize("name", ["cone_frustum.nc", "cone_frustum.cls"])
def test_bundled_programs(name: str, dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """The cutter locations as they are posted."""
    path = find_program(name)
    if name.endswith(".cls"):
        path = tmp_path / "posted.ngc"
        zero = Compensator(dmu50, Calibration.zero(dmu50), Options(tool_length_mm=120.0))
        zero.compensate_file(find_program(name), path, into=dialect_for(path))
    found = compare(path, tmp_path, known=False, tools=TOOLS)
    assert found.judge is not None and not found.judge.refusal
    assert not found.difference and not found.refused and found.blocks > 300


def test_the_boat(programs: Path, tmp_path: Path) -> None:
    """M428 and M429, which switch the kinematics, are M codes that a machine adds; millimetres are those of its INI file."""
    text = (programs / "linuxcnc_boat-xyzbc.ngc").read_text()
    found = judged(
        text.replace("M428", "(tcp)").replace("M429", "(tcp)").replace("G00 G17", "G21 G0 G17"), tmp_path, known=False
    )
    assert found.judge is not None and not found.judge.refusal
    assert not found.difference and not found.refused and found.blocks > 1700


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.name for path in NCFILES.glob("*.ngc")))
def test_the_samples_of_linuxcnc(name: str, tmp_path: Path) -> None:
    found = compare(NCFILES / name, tmp_path, known=False, tools=TOOLS)
    noted = ("LinuxCNC raises it first", "does not state its unit")  # rs274's own unit is the inch
    assert found.refused or not found.difference or any(one in found.said for one in noted)


def test_the_output_lands_where_the_original_meant(dmu50: Machine, calibration: Calibration, tmp_path: Path) -> None:
    """Original and output by LinuxCNC's interpreter, errors by the machine in plain numpy: the pose at every original end point."""
    truth = TruthMachine(calibration.path, 120.0)
    program, dialect = read_program("cone_frustum.nc")
    result = Compensator(dmu50, calibration, Options(tool_length_mm=120.0)).compensate(program, dialect)
    (tmp_path / "original.ngc").write_text(program.text)
    (tmp_path / "output.ngc").write_text(result.text)
    original, output = (rs274.read(tmp_path / f"{name}.ngc", tmp_path, tools=TOOLS) for name in ("original", "output"))
    assert not original.refusal and not output.refusal
    meant = np.array([motion.event.end for motion in original.motions])[2:-1]
    done = np.array([motion.event.end for motion in output.motions])
    # Every end point of the original is one of the output, in order; the nearest in axis coordinates, corrections are below 0.3.
    at, ends = 0, []
    for goal in meant:
        at += int(np.argmin(np.abs(done[at : at + 6] - goal).max(axis=1)))
        ends.append(done[at])
    distance, tilt = truth.deviations(np.array(ends), meant)
    before, _ = truth.deviations(meant, meant)
    assert before.mean() > 40.0
    rounding = result.report.rounding_um
    assert distance.max() < rounding + 0.5
    assert np.abs(tilt).max() < 20.0
