"""Tables of work offsets and tools: every form gives the same values as the CSV form."""

from __future__ import annotations

from pathlib import Path

import pytest

from twin._common.errors import InputError
from twin.controls.offsets import load_offsets, load_tools

OFFSETS = {
    "offsets.csv": "offset,X_mm,Y_mm,Z_mm,B_deg,C_deg\nG54,-250.5,12.25,-310,0,1.5\nG55,10,0,-5,0,0\n",
    "linuxcnc.var": "\n".join(
        [
            *(f"{5161 + i}\t0.000000" for i in range(9)),
            "5210\t0.000000",
            "5220\t1.000000",
            *(f"{5221 + i}\t{value:.6f}" for i, value in enumerate((-250.5, 12.25, -310, 0, 0, 1.5, 0, 0, 0, 0))),
            *(f"{5241 + i}\t{value:.6f}" for i, value in enumerate((10, 0, -5, 0, 0, 0, 0, 0, 0, 0))),
        ]
    ),
    "sinumerik.ini": "%_N_UFR_INI\n;$PATH=/_N_INI_DIR\n$P_UIFR[1,X,TR]=-250.6\n$P_UIFR[1,X,FI]=0.1\n$P_UIFR[1,Y,TR]=12.25\n"
    "$P_UIFR[1,Z,TR]=-310\n$P_UIFR[1,C,TR]=1.5\n$P_UIFR[1,X,RT]=0\n$P_UIFR[1,X,SC]=1\n$P_UIFR[1,X,MI]=0\n"
    "$P_UIFR[2]=CTRANS(X,10,Y,0,Z,-5):CROT(X,0)\n",
    "fanuc.txt": "%\nG10 L2 P0 X1. Y0. Z0. B0. C0.\nG10 L2 P1 X-251.5 Y12.25 Z-310. B0. C1.5\nG10L2P2X9.Y0.Z-5.B0.C0.\n%\n",
}
TOOLS = {
    "tools.csv": "tool,name,length_mm\n1,MILL_D10,120.5\n12,DRILL_D3,80.25\n",
    "tool.tbl": "T1 P1 D10.0 Z+120.500 ;MILL_D10\nT12 P3 Z80.25 D3\n",
    "toa.ini": '$TC_TP2[1]="MILL_D10"\n$TC_DP3[1,1]=120.0\n$TC_DP12[1,1]=0.5\n$TC_TP2[12]="DRILL_D3"\n$TC_DP3[12,1]=80.25\n'
    "$TC_DP3[12,2]=81\n",
    "tools.nc": "G10 L10 P1 R120.0\nG10 L11 P1 R0.5\nG10 L10 P12 R80.25\n",
    "TOOL.T": "BEGIN TOOL .T MM\n"
    "T    NAME             L           R           DL       DR\n"
    "0                     +0          +0          +0       +0\n"
    "1    MILL_D10         +120,25     +5          +0.25    +0\n"
    "12   DRILL_D3         +80.25      +1.5        +0       +0\n"
    "[END]\n",
}
PRESETS = (
    "BEGIN PRESET.PR MM\n"
    "NO  DOC              X           Y           Z           SPA   SPB   SPC   B        C        ACTNO LOCKED\n"
    "0   machine          +0          +0          +0          +0    +0    +0    +0       +0       0\n"
    "1   vice             -250.5      +12,25      -310        +0    +0    +0    -        +1.5     1\n"
    "[END]\n"
)
BAD = {
    "turned.ini": ("$P_UIFR[1,X,TR]=1\n$P_UIFR[1,Z,RT]=12\n", 2, "turns, mirrors or scales"),
    "turned.var": ("5221 1\n5230 30\n", 2, "turns, mirrors or scales"),
    "g92.var": ("5210 1\n5211 4\n5221 1\n", 1, "G92"),
    "turned.pr": (PRESETS.replace("+0    +0    +0    -", "+0    +0    +12   -"), 4, "turns, mirrors or scales"),
    "twice.csv": ("offset,X_mm\nG54,1\nG54,2\n", 3, "twice"),
    "unit.csv": ("offset,X\nG54,1\n", 1, "unknown column"),
    "word.csv": ("offset,X_mm\nG54,a\n", 2, "not a number"),
    "empty.csv": ("offset,X_mm\nG54,\n", 2, "X_mm is empty"),
    "p9.txt": ("G10 L2 P9 X1.\n", 1, "no such work offset"),
    "text.csv": ("hello\n", None, "not a table of work offsets"),
}


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", OFFSETS)
def test_every_form_of_offsets_gives_the_same(tmp_path: Path, name: str) -> None:
    table = load_offsets(written(tmp_path, name, OFFSETS[name]))
    assert set(table.rows) == {"G54", "G55"}
    wanted = {
        "G54": {"X": -250.5, "Y": 12.25, "Z": -310.0, "B": 0.0, "C": 1.5},
        "G55": {"X": 10.0, "Y": 0.0, "Z": -5.0, "B": 0.0, "C": 0.0},
    }
    for key, row in wanted.items():
        assert {axis: table.rows[key].get(axis, 0.0) for axis in row} == pytest.approx(row), key


def test_presets(tmp_path: Path) -> None:
    table = load_offsets(written(tmp_path, "preset.pr", PRESETS))
    assert table.rows["1"] == {"X": -250.5, "Y": 12.25, "Z": -310.0, "C": 1.5}
    assert table.assumed == ""


@pytest.mark.parametrize("name", TOOLS)
def test_every_form_of_tools_gives_the_same(tmp_path: Path, name: str) -> None:
    table = load_tools(written(tmp_path, name, TOOLS[name]))
    assert table.lengths_mm["1"] == pytest.approx(120.5)
    assert table.lengths_mm["12"] == pytest.approx(80.25)
    if name in ("tools.csv", "toa.ini", "TOOL.T"):
        assert table.lengths_mm["MILL_D10"] == pytest.approx(120.5)
    if name == "toa.ini":
        assert table.lengths_mm["DRILL_D3 D2"] == table.lengths_mm["12 D2"] == 81.0


def test_an_inch_table(tmp_path: Path) -> None:
    table = load_tools(written(tmp_path, "TOOL.T", TOOLS["TOOL.T"].replace(" MM", " INCH")))
    assert table.lengths_mm["1"] == pytest.approx(120.5 * 25.4)


@pytest.mark.parametrize("name", BAD)
def test_a_wrong_table_is_refused_with_its_line(tmp_path: Path, name: str) -> None:
    text, line, words = BAD[name]
    path = written(tmp_path, name, text)
    with pytest.raises(InputError, match=words) as caught:
        load_offsets(path)
    assert caught.value.file == str(path)
    assert caught.value.line == line


def test_an_unknown_tool_and_offset_are_named(tmp_path: Path) -> None:
    tools = load_tools(written(tmp_path, "tools.csv", TOOLS["tools.csv"]))
    with pytest.raises(InputError, match="MILL_D10") as caught:
        tools.of("MILL_D12", "part.nc", 7)
    assert (caught.value.file, caught.value.line, caught.value.value) == ("part.nc", 7, "MILL_D12")
    offsets = load_offsets(written(tmp_path, "offsets.csv", OFFSETS["offsets.csv"]))
    with pytest.raises(InputError, match="G54, G55"):
        offsets.of("G57", "part.nc", 7)
