"""Programs that select work offsets and tools from the machine's tables.

Truth: each section on its own, as a program with one work offset (tool length included) and one tool length.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.model.errors import random_calibration
from twin._common.errors import InputError
from twin.compensation import Compensation, Compensator, Options
from twin.compensation.programs.execute import execute_file
from twin.compensation.programs.follow import follow
from twin.compensation.programs.words import Setup, WordSpace
from twin.controls.offsets import OffsetTable, ToolTable
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import DIALECTS, read_program
from twin.tool.forward import Kinematics

OFFSETS = OffsetTable(
    Path("offsets.csv"),
    {
        "G54": {"X": 250.0, "Y": 225.0, "Z": -390.0},
        "G55": {"X": 200.0, "Y": 180.0, "Z": -350.0, "C": 12.5},
        "G54.1 P2": {"X": 100.0, "Y": 100.0, "Z": -300.0},
        "G505": {"X": 120.0, "Y": 110.0, "Z": -320.0},
        "7": {"X": 250.0, "Y": 225.0, "Z": -390.0},
        "8": {"X": 200.0, "Y": 180.0, "Z": -350.0, "C": 12.5},
    },
)
TOOLS = ToolTable(Path("tools.csv"), {"1": 80.0, "2": 131.5, "MILL": 80.0, "DRILL": 131.5, "DRILL D2": 133.0})
ROWS = "G0 X{0} Y10. Z60. B20. C5.\nG1 X{1} Y20. Z15. F500.\nX-30. Y-25. B40. C30.\nG3 X-20. Y-15. I10. J0.\nG0 Z60.\n"
ROWS_H = (
    "L X{0:+} Y+10 Z+60 B+20 C+5 FMAX\nL X{1:+} Y+20 Z+15 F500\nL X-30 Y-25 B+40 C+30\nCC X-20 Y-25\nC X-20 Y-15 DR-\n"
    "L Z+60 FMAX\n"
)
ISO, HEIDENHAIN = DIALECTS[0], DIALECTS[1]


@pytest.fixture(scope="module")
def errors(dmu50: Machine) -> Calibration:
    return random_calibration(dmu50, np.random.default_rng(5), size=30.0)


def compensated(
    text: str, machine: Machine, errors: Calibration, setup: Setup, length: float | None = None, **how: object
) -> Compensation:
    dialect = HEIDENHAIN if text.startswith("BEGIN") else ISO
    program = dialect.read(text.encode(), "part.h" if dialect is HEIDENHAIN else "part.nc")
    options = Options(setup=setup, tool_length_mm=length)
    return Compensator(machine, errors, options).compensate(program, dialect)


def blocks(text: str) -> list[str]:
    """Return the lines that move axes, without those that only select."""
    return [
        line for line in text.splitlines() if line[:3] in ("G0 ", "G1 ") or line[:2] in ("L ", "X-", "X2", "X3", "X4")
    ]


def plain(row: str, length: float) -> Setup:
    shift = dict(OFFSETS.rows[row])
    return Setup(work_offset=shift | {"Z": shift["Z"] + length})


ISO_PROGRAMS = {
    "fanuc": (
        "G90 G21\nT1 M6\nG54\nG43 H1\n{0}G49\nT2 M6\nG55\nG43 H2\n{1}M30\n",
        [("G54", 80.0), ("G55", 131.5)],
    ),
    "further offsets": (
        "G90 G21\nT1\nM6 T2\nG54.1 P2\nG43 H1\n{0}M6\nG55 G43 H2\n{1}M30\n",
        [("G54.1 P2", 80.0), ("G55", 131.5)],
    ),
    "sinumerik": (
        'G90 G710\nT="MILL"\nM6\nG54\n{0}T="DRILL"\nM6\nG505 D1\n{1}M30\n',
        [("G54", 80.0), ("G505", 131.5)],
    ),
    "sinumerik edge": (
        'G90 G710\nT="MILL"\nM6\nG54\n{0}T="DRILL"\nM6\nG505 D2\n{1}M30\n',
        [("G54", 80.0), ("G505", 133.0)],
    ),
}


@pytest.mark.sample(1)  # of 4
@pytest.mark.parametrize("name", ISO_PROGRAMS)
def test_each_section_is_that_of_a_program_of_its_own(dmu50: Machine, errors: Calibration, name: str) -> None:
    form, parts = ISO_PROGRAMS[name]
    rows = [ROWS.format(30.0, 40.0), ROWS.format(-10.0, 25.0)]
    result = compensated(form.format(*rows), dmu50, errors, Setup(offsets=OFFSETS, tools=TOOLS))
    alone = [
        compensated("G90 G21\n" + text, dmu50, errors, plain(row, length), length)
        for text, (row, length) in zip(rows, parts, strict=True)
    ]
    assert blocks(result.text) == [line for one in alone for line in blocks(one.text)]
    assert [use.offset for use in result.report.frames] == [row for row, _ in parts]
    assert [use.tool_length_mm for use in result.report.frames] == [length for _, length in parts]
    after = [one.report.after.max_um for one in alone]
    assert result.report.after.max_um == pytest.approx(max(after), abs=0.4)
    before = np.sqrt(np.mean([one.report.before.rms_um**2 for one in alone]))
    assert result.report.before.rms_um == pytest.approx(before, rel=0.05)
    # The moves of the original reach the same lines in the output: nothing else was changed.
    for line in form.format("", "").splitlines():
        assert line in result.text.splitlines()


def test_presets_and_tool_calls(dmu50: Machine, errors: Calibration) -> None:
    rows = [ROWS_H.format(30.0, 40.0), ROWS_H.format(-10.0, 25.0)]
    text = (
        "BEGIN PGM A MM\nTOOL CALL 1 Z S5000\nCYCL DEF 247 DATUM SETTING ~\n Q339=+7 ;DATUM NUMBER\n"
        f'{rows[0]}TOOL CALL "DRILL" Z S3000 DL+0.25\nCYCL DEF 247 DATUM SETTING Q339=+8\n{rows[1]}M30\nEND PGM A MM\n'
    )
    result = compensated(text, dmu50, errors, Setup(offsets=OFFSETS, tools=TOOLS))
    alone = [
        compensated(f"BEGIN PGM A MM\n{text}END PGM A MM\n", dmu50, errors, plain(row, length), length)
        for text, row, length in zip(rows, ("7", "8"), (80.0, 131.75), strict=True)
    ]
    assert blocks(result.text) == [line for one in alone for line in blocks(one.text)]


def test_tool_tip_coordinates_begin_at_the_offset(dmu50: Machine, errors: Calibration) -> None:
    """The nose of the DMU 50 stands over the table's centre at X 250, Y 225 and on the table at Z −400 (contract, clause 1)."""
    text = "G90 G21\nT2 M6\nG54\nG43 H2\nG43.4 H2\n" + ROWS.format(30.0, 40.0).replace("G3 X-20. Y-15. I10. J0.\n", "")
    result = compensated(text, dmu50, errors, Setup(offsets=OFFSETS, tools=TOOLS))
    wanted = compensated(text.replace("T2 M6\nG54\n", ""), dmu50, errors, Setup(work_origin_mm=(0.0, 0.0, 10.0)), 131.5)
    assert blocks(result.text) == blocks(wanted.text)
    assert result.report.frames[0].work_origin_mm == pytest.approx((0.0, 0.0, 10.0), abs=1e-9)


def test_a_move_across_sections_begins_where_the_one_before_ended(dmu50: Machine, errors: Calibration) -> None:
    """Going back to the same place in another offset needs other words, and no second approach."""
    text = "G90 G21\nG54\nG0 X10. Y20. Z60. B0. C0.\nG1 Z50. F500.\nG55\nG1 X70. F500.\nG54\nG1 X20. Z50.\n"
    result = compensated(text, dmu50, Calibration.zero(dmu50), Setup(offsets=OFFSETS))
    lines = result.nominal[:, 0]
    assert lines == pytest.approx([260.0, 260.0, 270.0, 270.0])
    assert result.nominal[2] == pytest.approx([270.0, 245.0, -340.0, 0.0, 0.0])


def test_the_scene_uses_the_same_frames(dmu50: Machine, errors: Calibration, tmp_path: Path) -> None:
    form, _ = ISO_PROGRAMS["fanuc"]
    text = form.format(ROWS.format(30.0, 40.0), ROWS.format(-10.0, 25.0))
    (tmp_path / "part.nc").write_text(text)
    setup = Setup(offsets=OFFSETS, tools=TOOLS)
    run = execute_file(tmp_path / "part.nc", dmu50, errors, setup=setup)
    result = compensated(text, dmu50, errors, setup)
    off = np.linalg.norm(run.reached_mm - run.meant_mm, axis=1) * 1e3
    assert off.max() == pytest.approx(result.report.before.max_um, rel=0.02)
    assert run.lines[int(np.argmax(off))] == result.report.before.worst_line


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("G54\nG0 X0 Y0 Z60\nG56\nG0 X1\n", 4, "no such work offset"),
        ("T9 M6\nG54\nG0 X0 Y0 Z60\n", 3, "no such tool"),
        ("M6\nG54\nG0 X0 Y0 Z60\n", 1, "tool change without a tool"),
        ("G54\nG43.1 H1\nG0 X0 Y0 Z60\n", 2, "tool length by G43.1"),
        ("G54\nT=_A M6\nG0 X0 Y0 Z60\n", 2, "value of T is unknown"),
    ],
)
def test_what_the_tables_do_not_have_is_refused(dmu50: Machine, text: str, line: int, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        compensated(text, dmu50, Calibration.zero(dmu50), Setup(offsets=OFFSETS, tools=TOOLS))
    assert caught.value.line == line


def test_offsets_given_twice_are_refused() -> None:
    with pytest.raises(InputError, match="given twice"):
        Setup(work_offset={"X": 1.0}, offsets=OFFSETS)


@pytest.mark.parametrize(
    "name",
    [
        "linuxcnc_boat-xyzbc.ngc",
        "spinnerU5_Bottle_opener_Flaschenoeffner.txt",
        "spinnerU5_Keychain_Schluesselanhaenger.mpf",
    ],
)
def test_real_programs_need_only_the_tables(programs: Path, name: str) -> None:
    machine = Machine.load("xyzbc_trunnion")
    errors = random_calibration(machine, np.random.default_rng(1), size=30.0)
    tools = dict.fromkeys(
        (
            "1",
            "SCHAFT_D8_N_AP20",
            "SCHAFT_D4_N_AP20",
            "ENTFRAESER_D8_90GRAD",
            "ENTFRAESER_D8_N_90GRAD",
            "BOHRER_D3.3_VHM",
        ),
        85.2,
    )
    tools["SCHAFT_D4_N_AP20"] = 70.1
    setup = Setup(
        offsets=OffsetTable(Path("a.csv"), {"G54": {"X": 10.0, "Y": -5.0, "Z": 40.0}}),
        tools=ToolTable(Path("b.csv"), tools),
    )
    read, dialect = read_program(programs / name)
    report = Compensator(machine, errors, Options(setup=setup)).compensate(read, dialect).report
    assert report.before.rms_um > 8.0
    assert report.after.max_um < 2.0
    # The programs were made for a machine whose tool-change position lies outside the range of this one.
    assert not [one for one in report.not_corrected if one.missed or one.kind == "tolerance"]


SHIFTED = {
    "G54": {"X": 210.5, "Y": 190.25, "Z": -300.125, "B": 3.5},
    "G55": {"X": 180.0, "Y": 160.0, "Z": -280.0, "C": 12.5},
}
RANGES = {"X": (60.0, 440.0), "Y": (60.0, 390.0), "Z": (-340.0, -60.0), "B": (12.0, 90.0), "C": (-150.0, 150.0)}


def random_statements(rng: np.random.Generator, *, lost: bool) -> list[tuple[str, dict[str, float]]]:
    """Return statements with axis positions of the machine: moves of some axes, machine coordinates, other offsets.

    Args:
        lost: whether rotary positions are unknown, at first, and so assumed as words; reference returns follow.
    """

    def some(names: str, least: int) -> dict[str, float]:
        chosen = rng.permutation(list(names))[: rng.integers(least, len(names) + 1)]
        return {name: round(float(rng.uniform(*RANGES[name])), 3) for name in names if name in chosen}

    first = [("G0", some("Z", 1)), ("G0", some("XYZ", 3))] if lost else [("G0", some("XYZBC", 5))]
    kinds = rng.choice(["G0", "G1", "G1", "G53", "G54", "G55", *(["G28"] if lost else [])], 14)
    axes = {"G53": "XYZ", "G28": "BC" if lost else "Z"}
    found = [*first, *((str(kind), some(axes.get(str(kind), "XYZBC"), 1)) for kind in kinds)]
    return [
        one
        for statement in found
        for one in ([statement, ("G0", some("BC", 2))] if statement[0] == "G28" else [statement])
    ]


def as_program(statements: list[tuple[str, dict[str, float]]], offsets: dict[str, dict[str, float]]) -> str:
    lines, frame = ["G90 G21 G94", "F600", "G54"], "G54"
    for kind, position in statements:
        shift = {} if kind == "G53" else offsets[frame]
        words = " ".join(f"{name}{value - shift.get(name, 0.0):.3f}" for name, value in position.items())
        if kind in offsets:
            frame = kind
            lines.append(kind)
        elif kind == "G28":
            lines.append("G91 G28 " + " ".join(f"{name}0" for name in position) + "\nG90")
        else:
            lines.append(f"G53 G0 {words}" if kind == "G53" else f"{kind} {words}")
    return "\n".join([*lines, "M30", ""])


def positions_written(text: str, offsets: dict[str, dict[str, float]]) -> list[dict[str, float]]:
    """Return the axis words of every line as positions of the machine."""
    found, frame = [], "G54"
    for line in text.splitlines():
        words = [] if line.startswith("(") else line.split()
        frame = next((word for word in words if word in offsets), frame)
        shift = {} if {"G53", "G28"} & {*words} else offsets[frame]
        found.append({word[0]: float(word[1:]) + shift.get(word[0], 0.0) for word in words if word[0] in RANGES})
    return found


@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_a_program_means_the_same_in_any_work_offset(
    dmu50: Machine, errors: Calibration, seed: int, lost: bool
) -> None:
    """The same positions of the machine, in two work offsets and in none, are compensated alike, with the same notes."""
    statements = random_statements(np.random.default_rng(seed), lost=lost)
    linear = {name: {axis: row[axis] for axis in row if axis in "XYZ"} for name, row in SHIFTED.items()}
    outcomes = []
    for offsets in ({name: {} for name in SHIFTED}, linear if lost else SHIFTED):
        setup = Setup(offsets=OffsetTable(Path("offsets.csv"), offsets), tools=TOOLS)
        result = compensated(as_program(statements, offsets), dmu50, errors, setup, 100.0)
        notes = [(note.line, note.text) for note in result.report.notes]
        outcomes.append((positions_written(result.text, offsets), notes, result.report.after.rms_um))
    (bare, bare_notes, rms), (shifted, shifted_notes, shifted_rms) = outcomes
    assert bare_notes == shifted_notes
    assert len(bare) == len(shifted)
    for one, other in zip(bare, shifted, strict=True):
        assert one == pytest.approx(other, abs=0.0021)  # each is rounded
    assert rms == pytest.approx(shifted_rms, abs=0.1)


def test_machine_coordinates_leave_the_place_of_the_tip_unknown(dmu50: Machine, errors: Calibration) -> None:
    """In tool centre point mode, a block that names one coordinate after them would be led from a place of before."""
    lines = ["G90 G21", "G0 X100 Y100 Z-100 B20 C10", "G43.4 H1", "G1 X10 Y10 Z50 F500", "G53 G0 Z-10"]
    part = compensated("\n".join([*lines, "G1 X30", "M30", ""]), dmu50, errors, Setup(), 100.0)
    (left,) = (one for one in part.report.not_corrected if one.kind == "unknown")
    assert left.missed == (6,) and "position of Y, Z" in left.reason and part.text.endswith("\nG1 X30\nM30\n")
    whole = compensated("\n".join([*lines, "G1 X30 Y10 Z50", "M30", ""]), dmu50, errors, Setup(), 100.0)
    assert whole.text.splitlines()[-2].startswith("G1 X30.0")


def test_a_rapid_to_a_place_not_yet_known_is_one_of_the_machine(dmu50: Machine) -> None:
    """The work offset is added: the direction of the rapid decides on which side an axis with backlash then stands."""
    program = ISO.read(b"G90 G21\nG0 Z50\nG0 X10 Y20\nM30\n", "part.nc")
    space = WordSpace(dmu50, Setup(work_offset={"X": 200.0, "Y": 100.0, "Z": -300.0}), 0.0)
    path = follow(program, ISO.moves(program, space.axes, tcp=False), space)
    (passage,) = path.passages
    assert passage.moved.tolist() == [False, False, True, False, False]
    assert passage.commands[2] == -250.0


@pytest.mark.parametrize("count", [1, 2])
def test_a_tool_vector_is_reached_from_where_the_axes_stand(dmu50: Machine, count: int) -> None:
    """The nearest of the turns of C that point the tool along a vector is taken, nearest on the machine, whatever the offset of C."""
    nominal = Kinematics(dmu50, Calibration.zero(dmu50), tool_length_mm=100.0)
    commands = [[0, 0, 0, 30, 150], [0, 0, 0, 40, 260]][:count]
    vectors = nominal.forward(commands).axis
    reached = []
    for offset in (0.0, 180.0):
        lines = ["G90 G710", "TRAORI", f"G1 X0 Y0 Z50 B30 C{10 - offset:g} F500"]
        lines += [f"X{i} A3={v[0]:.9f} B3={v[1]:.9f} C3={v[2]:.9f}" for i, v in enumerate(vectors, 1)]
        setup = Setup(work_offset={"C": offset}, work_origin_mm=(0.0, 0.0, -500.0))
        result = compensated("\n".join([*lines, "M30", ""]), dmu50, Calibration.zero(dmu50), setup, 100.0)
        reached.append(result.nominal)
    assert reached[0] == pytest.approx(reached[1], abs=1e-6)
    assert reached[0][-1, 3:] == pytest.approx(commands[-1][3:], abs=1e-5)


PARKING = {
    "fanuc": (
        "G90 G21\nG54\nG0 X10 Y20 Z60 B0 C0\nG1 Z50 F500\n{}G54\nG0 X15 Y25 B5\n{}G1 Y30\nM30\n",
        "G0\nG58 X0 Y0 B0\n",
    ),
    "sinumerik": (
        "G90 G710\nG54\nG0 X10 Y20 Z60 B0 C0\nG1 Z50 F500\n{}G54\nG0 X15 Y25 B5\n{}G1 Y30\nM30\n",
        "G500\nG0 X0 Y0 B0\n",
    ),
    "heidenhain": (
        "BEGIN PGM A MM\nCYCL DEF 247 Q339=+1\nL X+10 Y+20 Z+60 B+0 C+0 FMAX\nL Z+50 F500\n{}CYCL DEF 247 Q339=+1\n"
        "L X+15 Y+25 B+5 FMAX\n{}L Y+30 F500\nEND PGM A MM\n",
        "CYCL DEF 247 Q339=+9\nL X+0 Y+0 B+0 R0 FMAX\n",
    ),
}


@pytest.mark.parametrize("name", PARKING)
def test_rapids_in_an_unknown_work_offset_stay_as_they_are(dmu50: Machine, errors: Calibration, name: str) -> None:
    """Name them in the report; the axes that they move are unknown until the program gives them in its own work offset."""
    form, park = PARKING[name]
    setup = Setup(work_offset={"X": 200.0, "Y": 150.0, "Z": -250.0})
    result = compensated(form.format(park, ""), dmu50, errors, setup)
    without = compensated(form.format("", ""), dmu50, errors, setup)
    assert blocks(result.text)[0] == blocks(without.text)[0] and blocks(result.text)[-1] == blocks(without.text)[-1]
    assert park in result.text
    (left,) = (one for one in result.report.not_corrected if one.kind == "unknown")
    assert "work offset" in left.reason and "left as written" in left.reason and not left.missed
    assert result.report.complete
    part = compensated(form.format(park, "").replace("B5", "").replace("B+5", ""), dmu50, errors, setup)
    assert [one.missed for one in part.report.not_corrected if "position of B" in one.reason]
    with pytest.raises(InputError, match="second"):
        compensated(form.format("", park), dmu50, errors, setup)


def test_g58_with_axes_shifts_coordinates_where_the_control_may_be_a_sinumerik(
    dmu50: Machine, errors: Calibration
) -> None:
    form, park = PARKING["fanuc"]
    with pytest.raises(InputError, match="transformation G58"):
        compensated(form.format(park, "").replace("G21", "G71"), dmu50, errors, Setup())


def test_words_of_okuma_mean_those_of_fanuc(dmu50: Machine, errors: Calibration) -> None:
    """Work offset G15 H, tool length G56 H, its end G53, and tool centre point control G169 HA with G170."""
    fanuc = f"T1 M6\nG54\nG43 H1\n{ROWS}T2 M6\nG55\nG43 H2\n{ROWS}G49\nG43.4 H2\n{ROWS}G49\nG43 H2\n{ROWS}M30\n".format(
        30, 40
    )
    same = [
        *(("G54\n", "G15 H1\n"), ("G55\n", "G15 H2\n"), ("G43.4 H2", "G169 HA=2"), ("G43 H", "G56 H")),
        ("G49\nG169", "G53\nG169"),
        ("G49", "G170"),
    ]
    okuma = f"$A.MIN%\n{fanuc}"
    for word, other in same:
        okuma = okuma.replace(word, other)
    rows = {"G15 H1": OFFSETS.rows["G54"], "G15 H2": OFFSETS.rows["G55"]}
    one = compensated(fanuc, dmu50, errors, Setup(offsets=OFFSETS, tools=TOOLS))
    other = compensated(okuma, dmu50, errors, Setup(offsets=OffsetTable(Path("o.csv"), rows), tools=TOOLS))
    assert other.commands == pytest.approx(one.commands, abs=1e-9)
    changed = [line for line in other.text.splitlines() if line not in one.text.splitlines() and line[0] != "("]
    assert set(changed) == {"$A.MIN%", "G15 H1", "G56 H1", "G15 H2", "G56 H2", "G53", "G169 HA=2", "G170"}
