"""Subprograms: the program with its calls written out by hand is the truth."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.model.errors import random_calibration
from twin._common.errors import InputError
from twin.compensation import Compensator, Options
from twin.compensation.programs.compensator import compensate_file
from twin.compensation.programs.execute import execute_file
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.nc import read_program
from twin.nc.blocks import AxisWords, Interpretation, Program
from twin.nc.iso.calls import IsoInliner

AXES = AxisWords(("X", "Y", "Z"), ("B", "C"), dict.fromkeys("XYZBC", 0.001))
CASES: dict[str, tuple[dict[str, str], str]] = {
    "Fanuc, same file": (
        {
            "main.nc": "%\nO1\nG90 G21 G0 X300. Y200. Z-300. B0. C0.\nM98 P1000 L2\nG0 Z-290.\nM98 P21000\nM30\n"
            "O1000\nG91 G1 X1. F100\nG90\nM98 P2000\nM99\nO2000\nG1 Y[201+1]\nM99\n%\n"
        },
        "G90 G21 G0 X300. Y200. Z-300. B0. C0.\n" + "G91 G1 X1. F100\nG90\nG1 Y202\n" * 2 + "G0 Z-290.\n"
        "" + "G91 G1 X1. F100\nG90\nG1 Y202\n" * 2,
    ),
    "Fanuc, files and macro": (
        {
            "main.nc": "G90 G21 G0 X300. Y200. Z-300. B0. C0.\n#100=7\nG65 P12 A5. B[#100+1] X310.\nM98 P0034\nM30\n",
            "O0012.nc": "%\nO0012 (MACRO)\nG1 Z[-#1] F50\nX#24 Y[#2*10]\nM99\n%\n",
            "34.NC": "O34\nG0 Z-250.\nM99\n",
        },
        "G90 G21 G0 X300. Y200. Z-300. B0. C0.\nG1 Z-5. F50\nX310. Y80.\nG0 Z-250.\n",
    ),
    "LinuxCNC": (
        {
            "main.ngc": "o100 sub\nG1 X[300+#1] F100\no<up> call\no100 endsub\nG90 G21 G0 X300. Y200. Z-300. B0. C0.\n"
            "o100 call [1.5]\no100 call [2]\nM2\n",
            "up.ngc": "o<up> sub\nG0 Z-290.\no<up> endsub\n",
        },
        "G90 G21 G0 X300. Y200. Z-300. B0. C0.\nG1 X301.5 F100\nG0 Z-290.\nG1 X302 F100\nG0 Z-290.\n",
    ),
    "SINUMERIK": (
        {
            "main.mpf": "N10 G90 G710\nN20 G0 X300 Y200 Z-300 B0 C0\nN25 R1=4\nN30 POCKET_A(5,R1+2)\nN40 L12 P2\n"
            'N50 CALL "L12"\nN60 M30\n',
            "pocket_a.spf": "PROC POCKET_A(REAL _D, REAL _W)\nG1 Z=-300-_D F100\nX=300+_W*2\nRET\n",
            "L12.SPF": "G91\nY1\nG90\nM17\n",
        },
        "G90 G710\nG0 X300 Y200 Z-300 B0 C0\nG1 Z-305 F100\nX312\n" + "G91\nY1\nG90\n" * 3,
    ),
    "Heidenhain": (
        {
            "main.h": "0 BEGIN PGM MAIN MM\n1 L X+300 Y+200 Z-300 B+0 C+0 FMAX\n2 CALL LBL 5\n3 LBL 1\n4 L IX+2 F100\n"
            "5 CALL LBL 1 REP 2\n"
            '6 CALL PGM up.h\n7 CALL LBL "END"\n8 L Z-200 FMAX M30\n9 LBL 5\n10 L IY+1 F100\n11 LBL 0\n12 LBL "END"\n13 L Y+210\n'
            "14 CALL LBL 5\n15 LBL 0\n16 END PGM MAIN MM\n",
            "up.h": "0 BEGIN PGM UP MM\n1 L Z-250 FMAX\n2 END PGM UP MM\n",
        },
        "BEGIN PGM A MM\nL X+300 Y+200 Z-300 B+0 C+0 FMAX\nL IY+1 F100\nL IX+2 F100\nL IX+2\nL IX+2\nL Z-250 FMAX\nL Y+210 F100\n"
        "L IY+1\nL Z-200 FMAX\nEND PGM A MM\n",
    ),
}
REFUSED = {
    "missing": ({"main.nc": "G0 X1 Y1 Z1\nM98 P77\nM30\n"}, "main.nc", 2, "no subprogram O77"),
    "endless": ({"main.nc": "M98 P1\nM30\nO1\nM98 P1\nM99\n"}, "main.nc", 4, "too deeply"),
    "local of a macro": (
        {"main.nc": "G65 P5 A1\nM30\nO5\n#30=#3\nG1 X#30\nM99\n"},
        "main.nc",
        5,
        "value of #30 is unknown",
    ),
    "vacant": ({"main.nc": "#3=1\nG65 P5 A1\nM30\nO5\nG1 X#3 F1\nM99\n"}, "main.nc", 5, "value of X is unknown"),
    "repeats of a macro": ({"main.nc": "G65 P5 A1 L10.\nM30\nO5\nM99\n"}, "main.nc", 1, "a whole number L"),
    "with motion": ({"main.nc": "X1 M98 P5\nM30\nO5\nM99\n"}, "main.nc", 1, "only M98"),
    "DEF": (
        {"main.mpf": "SUBA\nM30\n", "suba.spf": "DEF REAL _A=R7\nG1 X=_A\nM17\n"},
        "suba.spf",
        2,
        "value of _A is unknown",
    ),
    "SAVE": ({"main.mpf": "SUBA\nM30\n", "suba.spf": "PROC SUBA SAVE\nM17\n"}, "suba.spf", 1, "SAVE"),
    "error inside": ({"main.mpf": "SUBA\nM30\n", "suba.spf": "G0 X1\nG33 X2\nM17\n"}, "suba.spf", 2, "thread"),
    "no end": ({"main.h": "BEGIN PGM A MM\nCALL LBL 3\nM30\nLBL 3\nEND PGM A MM\n"}, "main.h", 2, "without an end"),
    "units": (
        {"main.h": "BEGIN PGM A MM\nCALL PGM B\nEND PGM A MM\n", "b.h": "BEGIN PGM B INCH\nEND PGM B INCH\n"},
        "b.h",
        1,
        "other units",
    ),
    "loop": ({"main.nc": "M98 P1\nM30\nO1\nWHILE [#1 LT 3] DO1\nM99\n"}, "main.nc", 4, "without its end"),
}


def written(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder / next(iter(files))


ELSEWHERE = {
    "CALL PGM": ("a.h", "0 BEGIN PGM A MM\n1 CALL PGM TNC:\\sub\\FIN.H\n2 END PGM A MM\n", "fin.h", "L Z-250 FMAX\n"),
    "M98": ("a.nc", "G0 X1 Y1 Z1\nM98 P77\nM30\n", "O0077.eia", "O77\nG0 Z-250\nM99\n"),
    "EXTCALL": ("a.mpf", 'G0 X1 Y1 Z1\nEXTCALL("/_N_EXT_DIR/FIN.SPF")\nM30\n', "fin.spf", "G0 Z-250\nM17\n"),
}


@pytest.mark.parametrize("name", ELSEWHERE)
def test_subprograms_in_other_folders(tmp_path: Path, name: str) -> None:
    """Search the program's folder first, then the others in their order."""
    main, text, other, body = ELSEWHERE[name]
    folders = [tmp_path / "empty", tmp_path / "first one", tmp_path / "second"]
    for folder in (*folders, tmp_path / "main"):
        folder.mkdir()
    (tmp_path / "main" / main).write_text(text)
    (folders[1] / other).write_text(body)
    (folders[2] / other).write_text(body.replace("-250", "-99"))
    program, dialect = read_program(tmp_path / "main" / main, subprograms=folders)
    assert moved(dialect.moves(program, AXES, tcp=False))[-1][1][2] == -250.0
    assert str(folders[1] / other) in {origin.file for origin in program.origins}
    program, dialect = read_program(tmp_path / "main" / main, subprograms=folders[:1])
    expected = r"no subprogram .*in a folder of subprograms; or .* named as harmless"
    with pytest.raises(InputError, match=expected) as caught:
        dialect.moves(program, AXES, tcp=False)
    assert caught.value.line == 2
    with pytest.raises(InputError, match="cannot be searched"):
        read_program(tmp_path / "main" / main, subprograms=[tmp_path / "nowhere"])


def interpreted(path: Path) -> Interpretation:
    program, dialect = read_program(path)
    return dialect.moves(program, AXES, tcp=False)


def moved(reading: Interpretation) -> list[tuple[str, tuple[float, ...]]]:
    return [(move.kind.value, tuple(round(value, 9) for value in move.position)) for move in reading.moves]


@pytest.mark.parametrize("name", CASES)
def test_calls_are_written_out(tmp_path: Path, name: str) -> None:
    files, by_hand = CASES[name]
    path = written(tmp_path, files)
    wanted = written(tmp_path, {f"hand{path.suffix}": by_hand})
    assert moved(interpreted(path)) == moved(interpreted(wanted))
    program, _ = read_program(path)
    assert len(program.origins) == len(program.texts)
    assert program.numbers.max() <= len(path.read_text().splitlines())
    texts = {file.resolve(): file.read_text().splitlines() for file in tmp_path.iterdir()}
    for text, origin in zip(program.texts, program.origins, strict=True):
        if not text.lstrip("0123456789 N").startswith((";", "(")) and not set("#[(_") & set(text):
            body = text.strip().lstrip("0123456789 ")
            assert body.rstrip("0123456789") in texts[Path(origin.file).resolve()][origin.line - 1]


@pytest.mark.parametrize("name", CASES)
def test_the_output_needs_no_subprograms(tmp_path: Path, dmu50: Machine, name: str) -> None:
    """Compensated from file to file, then read alone: the same positions to the size of the errors, and nothing is called."""
    files, by_hand = CASES[name]
    path = written(tmp_path, files)
    hand = written(tmp_path, {f"hand{path.suffix}": by_hand})
    errors = random_calibration(dmu50, np.random.default_rng(2), size=20.0)
    alone = tmp_path / "out"
    alone.mkdir()
    report = compensate_file(path, alone / path.name, dmu50, errors)
    compensate_file(hand, alone / hand.name, dmu50, errors)
    out, wanted = interpreted(alone / path.name), interpreted(alone / hand.name)
    assert moved(out) == moved(wanted)
    assert not read_program(alone / path.name)[0].origins
    assert report.after.max_um < 2.0
    assert report.before.worst_line <= len(path.read_text().splitlines())
    run = execute_file(path, dmu50, errors)
    assert run.lines.max() <= len(path.read_text().splitlines())


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_written_out_is_refused(tmp_path: Path, dmu50: Machine, name: str) -> None:
    files, file, line, words = REFUSED[name]
    path = written(tmp_path, files)
    with pytest.raises(InputError, match=words) as caught:
        compensate_file(path, tmp_path / f"out{path.suffix}", dmu50, Calibration.zero(dmu50))
    assert (Path(caught.value.file or "").name, caught.value.line) == (file, line)
    assert not (tmp_path / f"out{path.suffix}").exists()


def test_subprograms_are_inputs(tmp_path: Path, dmu50: Machine) -> None:
    path = written(tmp_path, CASES["LinuxCNC"][0])
    before = (tmp_path / "up.ngc").read_text()
    with pytest.raises(InputError, match="input"):
        compensate_file(path, tmp_path / "up.ngc", dmu50, Calibration.zero(dmu50), options=Options())
    assert (tmp_path / "up.ngc").read_text() == before


def test_a_program_without_calls_is_itself(dmu50: Machine) -> None:
    program, dialect = read_program("cone_frustum.nc")
    assert dialect.expanded(program, [Path()]) is program
    assert Compensator(dmu50, Calibration.zero(dmu50)).compensate(program, dialect).text == program.text


WORDS = ["M", "m", "G", "g", "O", "L", "N7", "X", " ", "\t", "1", "98", "65", "198", "<", "9", "."]


@given(st.lists(st.lists(st.sampled_from(WORDS), max_size=6).map("".join), max_size=4))
@example(["X M198"])
@example(["X1", "Xg \t65."])
@example(["Xm98"])
def test_lines_that_may_be_calls(lines: list[str]) -> None:
    """All lines with a pattern of a call, one by one and in the whole text."""
    begin = re.compile(r"[ \t]*(?:N\d+[ \t]*)?(?:O[ \t]*[\d<]|L[ \t]*\d|[A-Z_][A-Z_])", re.IGNORECASE)
    inside = re.compile(r"M[ \t]*1?98|G[ \t]*65", re.IGNORECASE)
    texts = [f"{line}\n" for line in lines]
    inliner = IsoInliner(Program("p.nc", "iso", tuple(texts)), ())
    expected = [bool(begin.match(one) or inside.search(one)) for one in texts]
    assert [inliner.likely(one) for one in texts] == expected
    assert inliner.likely_within("".join(texts)) or not any(expected)
