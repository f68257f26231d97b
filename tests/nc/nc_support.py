"""Machines, program generators and modal interpreters that share no code with `twin.nc`."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

import numpy as np
from hypothesis import strategies as st

from twin.nc.blocks import AxisWords, Interpretation, Move, NewPositions
from twin.nc.dialect import Dialect

AXES = AxisWords(
    linear=("X", "Y", "Z"),
    rotary=("B", "C"),
    increment={"X": 0.001, "Y": 0.001, "Z": 0.001, "B": 0.001, "C": 0.001},
    tcp_on=("M428",),
    tcp_off=("M429",),
)
NAMES = AXES.names


def read_moves(dialect: Dialect, text: str, *, tcp: bool = False) -> Interpretation:
    return dialect.moves(dialect.read(text.encode("latin-1"), "test"), AXES, tcp=tcp)


def rewritten(
    dialect: Dialect,
    text: str,
    rows: Callable[[Move, np.ndarray, np.ndarray], np.ndarray],
    *,
    tcp: bool = False,
    vectors: Callable[[Move, int], np.ndarray] | None = None,
) -> tuple[str, list[np.ndarray]]:
    """Return the output with every move replaced by ``rows(move, start, end)``, and all those rows in order."""
    program = dialect.read(text.encode("latin-1"), "test")
    reading = dialect.moves(program, AXES, tcp=tcp)
    new = {}
    intended = []
    last = np.full(len(NAMES), np.nan)
    for index, move in enumerate(reading.moves):
        end = np.array(move.position)
        if not move.machine:
            segments = rows(move, last, end)
            tool = None if vectors is None or move.vector is None else vectors(move, len(segments))
            new[index] = (segments, tool)
            intended.extend(segments)
        last = end
    return dialect.rewrite(program, AXES, reading, new_positions(reading, new)), intended


def new_positions(
    reading: Interpretation, new: Mapping[int, tuple[np.ndarray, np.ndarray | None]], width: int = len(NAMES)
) -> NewPositions:
    """Return replacements by the index of the move: positions, and tool vectors or None."""
    return NewPositions.of(len(reading.moves), width, new)


def distinct(rows: list[np.ndarray]) -> list[tuple[float, ...]]:
    """Return rows without repetitions, as tuples of text, so that unknown values compare equal."""
    result: list[tuple[float, ...]] = []
    for row in rows:
        key = tuple("?" if math.isnan(v) else round(float(v), 6) + 0.0 for v in row)
        if not result or result[-1] != key:
            result.append(key)
    return result


# -------------------------------------------------------------------- independent interpreters

_ISO_WORD = re.compile(r"([A-Z]) *=? *([+-]? *[0-9.]+)")


def iso_positions(text: str) -> list[tuple[int, list[float]]]:
    """Return (motion code, position) of every block with axis words of a simple G-code program, by a minimal interpreter."""
    where = dict.fromkeys(NAMES, math.nan)
    motion, absolute, unit = 0, True, 1.0
    result = []
    for line in re.split(r"\r\n|\n|\r", text):
        while "(" in line and ")" in line.partition("(")[2]:
            line = re.sub(r"\([^()]*\)", " ", line)
        line = line.split(";")[0].upper().replace("/", " ")
        words = [(letter, float(value.replace(" ", ""))) for letter, value in _ISO_WORD.findall(line)]
        for letter, value in words:
            if letter == "G" and value in (0, 1, 2, 3):
                motion = int(value)
            elif letter == "G" and value in (90, 91):
                absolute = value == 90
            elif letter == "G" and value in (20, 21):
                unit = 25.4 if value == 20 else 1.0
        moved = False
        for letter, value in words:
            if letter in where:
                moved = True
                size = value * (unit if letter in "XYZ" else 1.0)
                where[letter] = size if absolute else where[letter] + size
        if moved:
            result.append((motion, [where[name] for name in NAMES]))
    return result


_PLAIN_WORD = re.compile(r"(?<![A-Z])(I?)([XYZBC])([+-]?[0-9.,]+)")


def plain_positions(text: str) -> list[list[float]]:
    """Return the positions of every L, LN, C, CR block of a plain-language program."""
    where = dict.fromkeys(NAMES, math.nan)
    unit = 25.4 if re.search(r"BEGIN PGM .* IN", text) else 1.0
    result = []
    for line in re.split(r"\r\n|\n|\r", text):
        body = re.sub(r"^\s*N?\d*\s*", "", line.split(";")[0].upper())
        if not re.match(r"(L|LN|C|CR)\s", body):
            continue
        words = _PLAIN_WORD.findall(body)
        for prefix, name, value in words:
            size = float(value.replace(",", ".")) * (unit if name in "XYZ" else 1.0)
            where[name] = where[name] + size if prefix else size
        if words:
            result.append([where[name] for name in NAMES])
    return result


# -------------------------------------------------------------------- generators


def decimal_text(draw: st.DrawFn, value: int, *, comma: bool = False, plus: bool | None = None) -> str:
    """Return a number of thousandths as text in one of the styles that programs use."""
    style = draw(st.sampled_from(["fixed", "trim", "point", "short"]))
    text = f"{abs(value) / 1000:.3f}"
    if style != "fixed":
        text = text.rstrip("0")
        if text.endswith(".") and style == "trim":
            text = text[:-1]
        if text.startswith("0.") and style == "short" and len(text) > 2:
            text = text[1:]
    signed = draw(st.booleans()) if plus is None else plus
    sign = "-" if value < 0 else "+" if signed else ""
    return sign + (text.replace(".", ",") if comma else text)


_EOL = st.sampled_from(["\n", "\r\n", "\r"])
_COMMENT = st.text(st.sampled_from("abc XYZ019.-+G ü"), max_size=12)


@st.composite
def iso_program(draw: st.DrawFn, *, arcs: bool = False) -> str:
    """Draw a simple G-code program: first a block with every axis, then modal blocks."""
    eol = draw(_EOL)
    space = draw(st.sampled_from(["", " ", "\t", "  "]))
    numbered = draw(st.booleans())
    lower = draw(st.booleans())
    units = draw(st.sampled_from(["G21", "G20"]))
    lines = ["%", "O1234 (demo)", f"G90{space}{units}{space}G17{space}G94", "G0 X0 Y0 Z0 B0 C0"]
    incremental = False
    for _ in range(draw(st.integers(0, 14))):
        words = []
        switch = draw(st.sampled_from(["", "", "", "G90", "G91"]))
        if switch:
            incremental = switch == "G91"
            words.append(switch)
        words.append(draw(st.sampled_from(["", "", "G0", "G1", "G01", "G00"])))
        for name in draw(st.lists(st.sampled_from(NAMES), max_size=5, unique=True)):
            size = 2000 if incremental else 200000
            number = decimal_text(draw, draw(st.integers(-size, size)))
            words.append(name + draw(st.sampled_from(["", " "] if space else [""])) + number)
        words.append(draw(st.sampled_from(["", "", "F100", "F12.5", "S500 M3", "M8"])))
        text = space.join(word for word in words if word)
        if draw(st.booleans()) and text:
            within = draw(st.sampled_from(["", "", "", "({}) END", "({}) ({})"])).format(*[draw(_COMMENT)] * 2)
            text += f" ({draw(_COMMENT)}{within})" if draw(st.booleans()) else f" ;{draw(_COMMENT)}"
        lines.append(text.lower() if lower else text)
    if numbered:
        lines = [f"N{10 * i}{' ' if space else ''}{text}" if i > 1 else text for i, text in enumerate(lines)]
    lines.append("M30")
    return eol.join(lines) + draw(st.sampled_from([eol, ""]))


@st.composite
def plain_program(draw: st.DrawFn) -> str:
    """A Heidenhain plain-language program."""
    eol = draw(_EOL)
    comma = draw(st.booleans())
    number = draw(st.sampled_from(["", "{} ", "N{} ", "N{}0 "]))
    unit = draw(st.sampled_from(["MM", "INCH", "IN"]))
    lines = [f"BEGIN PGM demo {unit}", "TOOL CALL 3 Z S4000", "L X+0 Y+0 Z+0 B+0 C+0 R0 FMAX M3"]
    tcp = False
    for _ in range(draw(st.integers(0, 14))):
        kind = draw(st.sampled_from(["L", "L", "L", "L", "M", "LN", ";", "CYCL"]))
        if kind == "L":
            words = ["L"]
            for name in draw(st.lists(st.sampled_from(NAMES), max_size=5, unique=True)):
                prefix = "" if tcp else draw(st.sampled_from(["", "", "I"]))
                size = 2000 if prefix else 200000
                value = draw(st.integers(-size, size))
                words.append(f"{prefix}{name}{decimal_text(draw, value, comma=comma, plus=True)}")
            words.append(
                draw(
                    st.sampled_from(
                        ["", "R0 FMAX", "F500", "F AUTO", "FMAX M8", "R0 F MAX M3", "F1000. S6000", "S500. M13."]
                    )
                )
            )
            lines.append(" ".join(word for word in words if word))
        elif kind == "LN" and tcp:
            lines.append("LN X+1 Y+2 Z+3 NX+0 NY+0 NZ+1 TX+0 TY+0.6 TZ+0.8 F100")
            lines.append("L X+1 Y+2 Z+3 B+10 C+20 F100")
        elif kind == "M":
            tcp = not tcp
            on, off = draw(
                st.sampled_from(
                    [
                        ("M128", "M129"),
                        ("M128. F10000.", "M129."),
                        ("FUNCTION TCPM F TCP AXIS POS", "FUNCTION RESET TCPM"),
                    ]
                )
            )
            lines.append(on if tcp else off)
            lines.append("L X+5 Y+5 Z+5")
        elif kind == "CYCL":
            lines += ["CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1 T0.02"]
        else:
            lines.append(f"; {draw(_COMMENT)}")
    lines += ["L M30", "END PGM demo " + unit]
    lines = [f"{number.format(i)}{text}" for i, text in enumerate(lines)]
    return eol.join(lines) + draw(st.sampled_from([eol, ""]))


@st.composite
def apt_program(draw: st.DrawFn) -> str:
    """An APT cutter location file."""
    eol = draw(_EOL)
    lines = ["TOOL PATH/FINISH,TOOL,BALL", "UNITS/MM", "$$ comment, GOTO/1,2,3", "MULTAX/ON"]
    for _ in range(draw(st.integers(0, 12))):
        kind = draw(st.sampled_from(["GOTO", "GOTO", "GOTO", "RAPID", "FEDRAT/MMPM,500.0", "PAINT/COLOR,1", "long"]))
        x, y, z = (decimal_text(draw, draw(st.integers(-99999, 99999)), plus=False) for _ in range(3))
        if kind == "GOTO":
            tail = draw(st.sampled_from(["", ",0.0,0.6,0.8", ",0,0,1.000000"]))
            lines.append(f"GOTO/{x},{y},{z}{tail}{draw(st.sampled_from(['', ' $$ here']))}")
        elif kind == "long":
            lines.append(f"GOTO / {x}, {y},${eol}   {z},0.6,0.0,0.8")
        else:
            lines.append(kind)
    lines.append("END-OF-PATH")
    return eol.join(lines) + draw(st.sampled_from([eol, ""]))
