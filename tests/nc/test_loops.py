"""Loops, jumps, and subprograms that change their parameters: the program as it is executed, written by hand, is the truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.model.errors import random_calibration
from tests.nc import rs274
from tests.nc.test_calls import interpreted, moved, written
from twin._common.errors import InputError
from twin.compensation.programs.compensator import compensate_file
from twin.machine.machine import Machine
from twin.nc import read_program

START = "G90 G21 G0 X300. Y200. Z-300. B0. C0.\n"
START_S = "G90 G710 G0 X300. Y200. Z-300. B0. C0.\n"
START_H = "BEGIN PGM A MM\nL X+300 Y+200 Z-300 B+0 C+0 FMAX\n"


def points(*values: float, axis: str = "X") -> str:
    return "".join(f"G1 {axis}{value} F100\n" for value in values)


def plain(*values: float) -> str:
    return START_H + "".join(f"L X{value:+} F100\n" for value in values) + "END PGM A MM\n"


X_OF_R1 = "G1 X=R1 F100\n"
FANUC = {
    "WHILE": ("#1=301\nWHILE[#1LE303]DO1\nG1 X#1 F100\n#1=#1+1\nEND1\n", points(301, 302, 303)),
    "loops within each other": (
        "#1=0\nWHILE [#1 LT 2] DO1\n#2=0\nWHILE [#2 LT 2] DO2\nG1 X[300+10*#1+#2] F100\n#2=#2+1\nEND2\n#1=#1+1\nEND1\n",
        points(300, 301, 310, 311),
    ),
    "IF and GOTO back": ("#1=301\nN10 G1 X#1 F100\n#1=#1+1\nIF [#1 LT 304] GOTO 10\n", points(301, 302, 303)),
    "GOTO forward": ("#1=5\nIF[[#1 GT 3] AND [#1 NE 7]]GOTO20\nG1 X1\nN20 G1 X302 F100\n", points(302)),
    "GOTO out of a loop": (
        "#1=300\nWHILE [#1 LT 400] DO1\n#1=#1+1\nIF [#1 EQ 303] GOTO 50\nG1 X#1 F100\nEND1\nN50 G1 X310 F100\n",
        points(301, 302, 310),
    ),
    "GOTO behind the end": (
        "#1=5\nIF [#1 GT 3] GOTO 70\nG1 X1\nM30\nN70 G1 X302 F100\nX303\nM30\nO8\nN70 X9\nM99\n",
        points(302, 303),
    ),
    "GOTO behind the end, not taken": (
        "#1=2\nIF [#1 GT 3] GOTO 70\nG1 X302 F100\nM30\nN70 G1 X1 F100\nM30\n",
        points(302),
    ),
    "IF THEN": ("#1=2\nIF [#1 EQ 2] THEN #3=304\nIF [#1 EQ 3] THEN #3=305\nG1 X#3 F100\n", points(304)),
    "a loop in a subprogram": (
        "M98 P100\nM98 P100\nM30\nO100\n#1=1\nWHILE [#1 LE 2] DO1\nG91 G1 X#1 F100\n#1=#1+1\nEND1\nG90\nM99\n",
        "G91\n" + points(1, 2, 1, 2),
    ),
    "a macro changes its parameters": (
        "G65 P100 A301 K2\nG65 P100 A305 K1\nM30\nO100\nWHILE [#6 GT 0] DO1\nG1 X#1 F100\n#1=#1+1\n#6=#6-1\nEND1\nM99\n",
        points(301, 302, 305),
    ),
    "a vacant parameter": (
        "G65 P100 A301\nG65 P100 A301 B7\nM30\nO100\nIF [#2 EQ #0] THEN #2=5\nG1 X[#1+#2] F100\nM99\n",
        points(306, 308),
    ),
    "a subprogram returns early": (
        "#100=1\nM98 P100\n#100=2\nM98 P100\nM30\nO100\nG1 X[300+#100] F100\nIF [#100 EQ 2] GOTO 9\nG1 X310 F100\nM99\n"
        "N9 G1 X320 F100\nM99\n",
        points(301, 310, 302, 320),
    ),
    "a macro within a macro has parameters of its own": (
        "G65 P100 A1\nM30\nO100\n#1=#1+1\nG65 P200 A[#1+300]\nG1 X[310+#1] F100\nM99\nO200\n#1=#1+5\nG1 X#1 F100\nM99\n",
        points(307, 312),
    ),
}
LINUXCNC = {
    "while": ("#<i>=301\no1 while [#<i> le 303]\nG1 X#<i> F100\n#<i>=[#<i>+1]\no1 endwhile\n", points(301, 302, 303)),
    "do": ("#1=301\no1 do\nG1 X#1 F100\n#1=[#1+1]\no1 while [#1 LT 303]\n", points(301, 302)),
    "repeat": ("#1=301\no1 repeat [2]\nG1 X#1 F100\n#1=[#1+1]\no1 endrepeat\n", points(301, 302)),
    "if": (
        "#1=301\no1 repeat [4]\no2 if [#1 EQ 301]\nG1 X305 F100\no2 elseif [#1 GT 303]\nG1 X306 F100\no2 else\nG1 X#1 F100\no2 endif\n"
        "#1=[#1+1]\no1 endrepeat\n",
        points(305, 302, 303, 306),
    ),
    "break and continue": (
        "#1=300\no1 while [1]\n#1=[#1+1]\no2 if [#1 EQ 302]\no1 continue\no2 endif\no3 if [#1 GT 304]\no1 break\no3 endif\n"
        "G1 X#1 F100\no1 endwhile\n",
        points(301, 303, 304),
    ),
    "steps that are no whole numbers": (
        "#1=0\no1 while [#1 LE 0.3]\nG1 X[300+#1] F100\n#1=[#1+0.1]\no1 endwhile\n",
        points(300, 300.1, 300.2),  # 0.1 + 0.1 + 0.1 is more than 0.3
    ),
    "return": (
        "o100 sub\nG1 X#1 F100\no101 if [#1 GT 301]\no100 return\no101 endif\nG1 X310 F100\no100 endsub\no100 call [301]\n"
        "o100 call [302]\n",
        points(301, 310, 302),
    ),
    "recursion": (
        "o100 sub\nG1 X[300+#1] F100\no101 if [#1 GT 0]\no100 call [#1-1]\nG1 X[310+#1] F100\no101 endif\no100 endsub\no100 call [2]\n",
        points(302, 301, 300, 311, 312),
    ),
    "a subprogram changes its parameters": (
        "o100 sub\no101 while [#1 GT 0]\nG1 X[300+#1] F100\n#1=[#1-1]\no101 endwhile\no100 endsub\n"
        "#1=7\no100 call [2]\nG1 X[300+#1] F100\n",
        points(302, 301, 307),
    ),
    "a subprogram changes a value of its call": (
        "o100 sub\n#101=9\nG1 X[300+#1] F100\no100 endsub\n#101=5\no100 call [#101]\nG1 X[300+#101] F100\n",
        points(305, 309),
    ),
    "assignments in a block, all at once": (
        "#1=301\n#1=302 #2=#1\no1 if [#2 EQ 301]\nG1 X#2 F100\no1 endif\n",
        points(301),
    ),
    "a condition of several": (
        "#1=1 #2=0\no1 if [[#1 EQ 1] AND [#2 EQ 0]]\nG1 X301 F100\no1 endif\no2 if [[#1 XOR #1] OR 0]\nG1 X302\no2 endif\n",
        points(301),
    ),
}
SINUMERIK = {
    "FOR": (
        f"DEF INT K\nFOR K=1 TO 3\nG1 X=300+K F100\nENDFOR\nFOR R1=305 TO 306\n{X_OF_R1}ENDFOR\n",
        points(301, 302, 303, 305, 306),
    ),
    "FOR from a negative number": ("FOR R1=-1 TO 0\nG1 X=300+R1 F100\nENDFOR\n", points(299, 300)),
    "assignments in a block, one after another": ("R1=301 R2=R1\nIF R2==301\nG1 X=R2 F100\nENDIF\n", points(301)),
    "WHILE": (f"R1=301\nN10 WHILE R1<=302 AND R1<>305\n{X_OF_R1}R1=R1+1\nN20 ENDWHILE\n", points(301, 302)),
    "REPEAT": (f"R1=301\nREPEAT\n{X_OF_R1}R1=R1+1\nUNTIL R1>302\n", points(301, 302)),
    "LOOP": (f"R1=301\nLOOP\n{X_OF_R1}R1=R1+1\nIF R1==303 GOTOF OUT\nENDLOOP\nOUT:\nG1 X310\n", points(301, 302, 310)),
    "IF": (
        f"R1=301\nIF (R1>300) AND NOT (R1==302)\n{X_OF_R1}ELSE\nG1 X1\nENDIF\nIF R1==5\nG1 X2\nENDIF\n",
        points(301),
    ),
    "GOTOB": (f"R1=301\nAGAIN: {X_OF_R1}R1=R1+1\nIF R1<303 GOTOB AGAIN\n", points(301, 302)),
    "GOTOF over the same label": (f"R1=301\nGOTOF L_A\nG1 X1\nL_A: {X_OF_R1}GOTOF L_A\nG1 X2\nL_A:\n", points(301)),
    "jump to a block number": (f"R1=301\nN100 {X_OF_R1}R1=R1+1\nIF R1<303 GOTOB N100\n", points(301, 302)),
    "CASE": (
        "R2=1\nN5 CASE R2 OF 1 GOTOF ONE 2 GOTOF TWO DEFAULT GOTOF LAST\nONE: G1 X301 F100\nR2=R2+6\nGOTOB N5\n"
        "TWO: G1 X302 F100\nLAST:\n",
        points(301),
    ),
    "REPEAT of a part": (f"R1=301\nPART: {X_OF_R1}R1=R1+1\nREPEAT PART P=2\n", points(301, 302, 303)),
    "REPEAT of a part with its end": (
        f"R1=301\nPART: {X_OF_R1}R1=R1+1\nENDLABEL:\nG1 X350\nREPEAT PART P=1\n",
        points(301, 350, 302),
    ),
    "REPEATB": (f"R1=301\nLINE: {X_OF_R1}R1=310\nREPEATB LINE P=2\n", points(301, 310)),
}
PLAIN = {
    "FN 12": ("Q1=+301\nLBL 1\nL X+Q1 F100\nQ1 = Q1 + 1\nFN 12: IF +Q1 LT +304 GOTO LBL 1\n", (301, 302, 303)),
    "IF without FN": ('Q1=+301\nLBL "A"\nL X+Q1 F100\nFN 1: Q1 = +Q1 + +1\nIF Q1 NE +303 GOTO LBL "A"\n', (301, 302)),
    "out of a subprogram": (
        "Q1=+2\nCALL LBL 7\nL X+310 F100\nM30\nLBL 7\nFN 9: IF +Q1 EQU +1 GOTO LBL 8\nFN 9: IF +Q1 EQU +2 GOTO LBL 9\nL X+1\nLBL 0\n"
        "LBL 8\nL X+2\nLBL 0\nLBL 9\nL X+302 F100\nFN 10: IF +Q1 NE +1 GOTO LBL 10\nLBL 0\nLBL 10\nL X+303\nLBL 0\n",
        (302, 303, 310),
    ),
    "FN 9 forward": ("FN 0: Q1=+3\nFN 9: IF +Q1 EQU +3 GOTO LBL 5\nL X+1\nLBL 5\nL X+302 F100\n", (302,)),
    "a jump within a repeated part": (
        "Q1=+301\nLBL 1\nFN 9: IF +Q1 EQU +302 GOTO LBL 2\nL X+Q1 F100\nLBL 2\nQ1 = Q1 + 1\nCALL LBL 1 REP 2\n",
        (301, 303),
    ),
    "a jump within a subprogram": (
        "Q1=+2\nCALL LBL 7\nL X+310 M30\nLBL 7\nLBL 8\nL X+Q1 F100\nQ1 = Q1 + 299\nFN 11: IF +303 GT +Q1 GOTO LBL 8\nLBL 0\n",
        (2, 301, 310),
    ),
}
CASES = {
    **{f"fanuc, {name}": ("main.nc", START + text, START + hand) for name, (text, hand) in FANUC.items()},
    **{
        f"linuxcnc, {name}": ("main.ngc", START + text + "M2\n", START + hand)
        for name, (text, hand) in LINUXCNC.items()
    },
    **{
        f"sinumerik, {name}": ("main.mpf", START_S + text + "M30\n", START_S + hand)
        for name, (text, hand) in SINUMERIK.items()
    },
    **{
        f"heidenhain, {name}": ("main.h", START_H + text + "END PGM A MM\n", plain(*hand))
        for name, (text, hand) in PLAIN.items()
    },
}


def ends(path: Path) -> list[tuple[str, tuple[float, ...]]]:
    """Return the kind and the end of every move that goes somewhere."""
    found = moved(interpreted(path))
    return [one for before, one in zip([None, *found], found, strict=False) if one != before]


@pytest.mark.parametrize("name", CASES)
def test_loops_and_jumps_are_written_out(tmp_path: Path, name: str) -> None:
    file, text, by_hand = CASES[name]
    path = written(tmp_path, {file: text})
    hand = written(tmp_path, {f"hand{path.suffix}": by_hand})
    assert ends(path) == ends(hand)
    program, _ = read_program(path)
    again = written(tmp_path, {f"again{path.suffix}": program.text})
    assert not read_program(again)[0].origins
    assert ends(again) == ends(hand)


@rs274.needed
@pytest.mark.parametrize("name", LINUXCNC)
def test_linuxcnc_executes_the_program_alike(tmp_path: Path, name: str) -> None:
    _, text, _ = CASES[f"linuxcnc, {name}"]
    path = written(tmp_path, {"main.ngc": text})
    program, _ = read_program(path)
    found = [position for _, position in moved(interpreted(path))]
    for read in (text, program.text):
        judged = [event.end for event in rs274.events(read, tmp_path)]
        assert np.array(found) == pytest.approx(np.array(judged), abs=1e-6)


@pytest.mark.sample(4)
@pytest.mark.parametrize("name", CASES)
def test_the_output_lands_where_the_executed_program_meant(tmp_path: Path, dmu50: Machine, name: str) -> None:
    file, text, by_hand = CASES[name]
    path, errors = written(tmp_path, {file: text}), random_calibration(dmu50, np.random.default_rng(2), size=20.0)
    hand = written(tmp_path, {f"hand{path.suffix}": by_hand})
    alone = tmp_path / "out"
    alone.mkdir()
    report = compensate_file(path, alone / path.name, dmu50, errors)
    compensate_file(hand, alone / hand.name, dmu50, errors)
    assert ends(alone / path.name) == ends(alone / hand.name)
    assert any("loops and jumps are written out" in note.text for note in report.notes)


REFUSED = [
    ("main.nc", "WHILE [#1 LT 3] DO1\nG1 X1\nEND1\n", 2, r"value of \[#1 LT 3\] is unknown"),
    ("main.nc", "#1=0\nWHILE [#1 LT 3] DO1\nG1 X1\nEND1\n", 5, "the loop never ends"),
    ("main.nc", "#1=1\nWHILE [#1 LT 3] DO1\nG1 X1\n", 3, "without its end"),
    ("main.nc", "#1=1\nG1 X1\nEND1\n", 4, "without its beginning"),
    ("main.nc", "GOTO 20\nN10 G1 X1\n", 2, "no label N20"),
    ("main.nc", "GOTO 20\nN20 G1 X1\nN20 X2\n", 2, "several labels N20"),
    ("main.nc", "#1=0.1+0.2\nIF [#1 EQ 0.3] GOTO 20\nN20 G1 X1\n", 3, "almost equal"),
    ("main.ngc", "o1 while [#<a> LT 3]\nX1\no1 endwhile\nM2\n", 2, "is unknown"),
    ("main.ngc", "o1 if [1]\nX1\no2 endif\nM2\n", 4, "without its beginning"),
    ("main.ngc", "o1 break\nM2\n", 2, "outside a loop"),
    ("main.ngc", "o1 sub\no1 call\no1 endsub\no1 call\nM2\n", 3, "too deeply"),
    ("main.ngc", "o1 sub\no2 if [#1 EQ #2]\nG1 X1\no2 endif\no1 endsub\no1 call [0]\nM2\n", 3, "is unknown"),
    ("main.mpf", "FOR R1=1 TO 2\nG1 X=R1\nENDFOR\nG1 Y=R1\n", 5, "the value of R1 is unknown"),
    ("main.mpf", "GOTOB NOWHERE\nNOWHERE: G1 X1\n", 2, "no label NOWHERE"),
    ("main.mpf", "IF R1==5\nG1 X1\nENDIF\n", 2, "is unknown"),
    ("main.h", "FN 9: IF +Q1 EQU +3 GOTO LBL 5\nLBL 5\n", 3, "is unknown"),
    ("main.h", "FN 9: IF +3 EQU +3 GOTO LBL 5\n", 3, "no label 5"),
    ("main.h", "CALL LBL 1\nM30\nLBL 1\nFN 9: IF +3 EQU +3 GOTO LBL 5\nLBL 0\nLBL 5\n", 6, "no label 5"),
    ("main.h", "LBL 5\nLBL 0\nCALL LBL 1\nM30\nLBL 1\nFN 9: IF +3 EQU +3 GOTO LBL 5\nLBL 0\n", 8, "no label 5"),
]


@pytest.mark.parametrize(("file", "text", "line", "words"), REFUSED)
def test_what_cannot_be_executed_is_refused(tmp_path: Path, file: str, text: str, line: int, words: str) -> None:
    path = written(tmp_path, {file: (START_H if file == "main.h" else START) + text})
    with pytest.raises(InputError, match=words) as caught:
        interpreted(path)
    assert caught.value.line == line


ENDLESS = {
    "a condition that only the control changes": "#5070=1\nO4 while [#5070 NE 0]\nG38.3 X5\nO4 endwhile\n",
    "a jump": "#1=1\nN5 G91 G1 X1\nIF [#1 GT 0] GOTO 5\n",
    "counted loops within": "#1=1\nO4 while [#1 NE 0]\nO5 repeat [3]\nG91 G1 X1\nO5 endrepeat\nO4 endwhile\n",
}


@pytest.mark.parametrize("name", ENDLESS)
def test_a_loop_that_never_ends_is_refused_at_once(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.nc.inline.MOST_LINES", 50)
    path = tmp_path / "a.ngc"
    path.write_text(f"G21 G90 G0 X1 Y2 Z3\n{ENDLESS[name]}M2\n")
    with pytest.raises(InputError, match="the loop never ends"):
        read_program(path)


def test_an_index_is_no_assignment(tmp_path: Path) -> None:
    """``IDXQ8 = 0`` writes a row of the tool table; Q8 keeps its value, so that the loop ends."""
    loop = "Q8=+1\nLBL 1\nFN 17: SYSWRITE ID50 NR1 IDXQ8 = +0\nL X+Q8\nFN 1: Q8 = +Q8 + +1\nFN 11: IF +Q8 GT +2 GOTO LBL 5\n"
    (tmp_path / "table.h").write_text(f"{START_H}{loop}FN 9: IF +1 EQU +1 GOTO LBL 1\nLBL 5\nM30\nEND PGM A MM\n")
    program, _ = read_program(tmp_path / "table.h")
    assert sum("X+Q8" in text for text in program.texts) == 2
