"""APT cutter locations (``.cls``, ``.apt``): ``GOTO/x,y,z,i,j,k`` in the work frame."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple, final

from twin.errors import InputError
from twin.nc.blocks import AxisWords, Dialect, Kind, Move, Notice, Program, Reading, Rewrite
from twin.nc.emit import Vector, pieces_of, vector_texts
from twin.nc.text import (
    BOM,
    MM_PER_INCH,
    Style,
    apply_edits,
    ending,
    format_number,
    newline_of,
    number,
    read_lines,
    style_of,
    unit_vector,
)

POSITION_DECIMALS = 5
VECTOR_DECIMALS = 9
_STATEMENT = re.compile(r"[ \t\f\x1a]*+([A-Za-z][A-Za-z0-9_ -]*+)(?:(/)(.*))?", re.ASCII | re.DOTALL)
_FIELD = re.compile(r"[^,]+|(?<=,)(?=,)|(?<=,)$")
_CONTINUED = re.compile(r"\$[ \t]*(?:\r\n|\n|\r)")
_EXPONENT = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)[EeDd][+-]?\d{1,3}", re.ASCII)

_PASSED = frozenset(
    """RAPID FEDRAT SPINDL COOLNT LOADTL TOOLNO PAINT MSYS MULTAX PARTNO MACHIN CUTTER END FINI STOP OPSTOP DELAY HEAD
    SELECTL SELECT TPRINT TMARK LEADER INTOL OUTTOL TOLER PPRINT DISPLY TLDATA TURRET CLAMP AUXFUN PREFUN SEQNO OPTION
    PREGO RETRCT CLEARP LINTOL MCHTOL REWIND INSERT MODE UNITS CUTCOM CYCLE ORIGIN PITCH CLRSRF TOOL SET CHKSUM LOAD
    UNLOAD AIR MCHFIN NOPOST ARCSLP RESET PROGRAM TOOLPATH ENDOFPATH CATPROCESS TLAXIS REMARK BREAK PLABEL ISTOP
    CONTRL DATE TIME VERSION OPERATION PROCESS""".split()
)
_REFUSED: dict[str, tuple[str, str]] = {
    "GODLTA": ("incremental GODLTA", "absolute GOTO statements"),
    **{
        word: (f"curve {word}", "cutter locations linearised by CAM")
        for word in ("CIRCLE", "ARC", "HELIX", "NURBS", "SPLINE", "MOVARC", "CONE", "CYLNDR", "ELLIPS", "POLYGN")
    },
    **{
        word: (f"coordinate transformation {word}", "locations in one work frame")
        for word in ("ROTATE", "TRANS", "COPY", "MIRROR", "MATRIX", "ROTABL", "ROTHED", "TRACUT", "INDEX", "REFSYS")
    },
    **{
        word: (f"contour motion {word}", "GOTO statements written out by CAM")
        for word in ("GOFWD", "GOBACK", "GOLFT", "GORGT", "GOUP", "GODOWN", "GO", "TLON", "TLLFT", "TLRGT", "INDIRV")
    },
    **{
        word: ("control flow", "one program with every statement written out")
        for word in ("CALL", "MACRO", "TERMAC", "LOOPST", "LOOPND", "JUMPTO", "IF", "DO", "TRANTO")
    },
}
_IDENTITY = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]


class Field(NamedTuple):
    """One argument of a statement: its text without spaces around it, and where that stands in the raw text."""

    start: int
    end: int
    text: str


class Statement(NamedTuple):
    """One statement: lines joined over ``$``.

    Attributes:
        line: 0-based index of its first line.
        raw: its lines as they are.
        word: its major word in capitals, spaces removed; empty for comments and blank lines.
        fields: its arguments.
    """

    line: int
    raw: str
    word: str
    fields: tuple[Field, ...]


def statements(program: Program) -> Iterator[Statement]:
    """The statements of a program, in order; together their raw texts are the program."""
    lines = program.lines
    index = 0
    while index < len(lines):
        first = index
        text = lines[index].text
        parts = [text]
        if "$" in text:
            while _continues(text) and index + 1 < len(lines):
                index += 1
                text = lines[index].text
                parts.append(text)
        index += 1
        yield _statement(first, "".join(parts) if len(parts) > 1 else parts[0])


def _continues(text: str) -> bool:
    at = text.find("$")
    return at >= 0 and not text.startswith("$$", at) and not text[at + 1 :].strip()


def _statement(line: int, raw: str) -> Statement:
    text = raw
    begin = len(BOM) if line == 0 and raw.startswith(BOM) else 0
    if begin:
        text = " " * begin + raw[begin:]
    if "$" in text:
        text = _CONTINUED.sub(lambda match: " " * len(match.group()), text)
        text = text.split("$$", 1)[0].rstrip("\r\n\t $")
    found = _STATEMENT.match(text)
    if found is None:
        return Statement(line, raw, text.strip(" \t\r\n\f\x1a%") and "?", ())
    word = found.group(1).upper().replace(" ", "").replace("-", "")
    if found.group(2) is None:
        return Statement(line, raw, word, ())
    at = found.start(3)
    fields = []
    for match in _FIELD.finditer(found.group(3).rstrip()):
        piece = match.group()
        bare = piece.strip()
        start = at + match.start() + (len(piece) - len(piece.lstrip()))
        fields.append(Field(start, start + len(bare), bare))
    return Statement(line, raw, word, tuple(fields))


@final
class Apt(Dialect):
    """APT cutter locations."""

    name = "apt"
    suffixes = (".cls", ".apt")

    def read(self, data: bytes, source: str) -> Program:
        """Split bytes into lines; see `Dialect.read`."""
        return read_lines(data, source, self.name)

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Reading:
        """Interpret a program; see `Dialect.moves`. Cutter locations are tool-tip coordinates whatever ``tcp`` says."""
        reader = _Reader(program.source, axes)
        for statement in statements(program):
            reader.step(statement)
        return Reading(tuple(reader.moves), tuple(reader.notices))

    def rewrite(self, program: Program, axes: AxisWords, reading: Reading, rewrites: Iterable[Rewrite]) -> str:
        """The text with moves replaced; see `Dialect.rewrite`."""
        by_line = pieces_of(reading, rewrites, axes)
        if not by_line:
            return program.text
        newline = newline_of(program)
        reader = _Reader(program.source, axes)
        said: tuple[str, str, str] | None = vector_texts((0.0, 0.0, 1.0), VECTOR_DECIMALS, False)
        out: list[str] = []
        for statement in statements(program):
            before = len(reader.moves)
            reader.step(statement)
            pieces = by_line.get(statement.line)
            if len(reader.moves) == before:
                out.append(statement.raw)
            elif pieces is None:
                out.append(statement.raw)
                if len(statement.fields) >= 6:
                    said = None
            else:
                rewrite, rows = pieces[0]
                said = _rewritten(statement, rewrite, rows, reader.unit, said, newline, out)
        return "".join(out)


def _rewritten(
    statement: Statement,
    rewrite: Rewrite,
    rows: list[list[float]],
    unit: float,
    said: tuple[str, str, str] | None,
    newline: str,
    out: list[str],
) -> tuple[str, str, str] | None:
    """Write the pieces of one location; the vector said last."""
    raw, fields = statement.raw, statement.fields
    end = ending(raw)
    vectors: list[list[float]] | None = None if rewrite.vectors is None else rewrite.vectors.tolist()
    style = Style()
    edits: list[tuple[int, int, str]] = []
    decimals = [POSITION_DECIMALS] * 3
    for index, field in enumerate(fields[:3]):
        value = rows[0][index] / unit
        decimals[index] = max(POSITION_DECIMALS, _decimals(field.text))
        if value == value:
            style = style_of(field.text, style)._replace(keep=decimals[index], comma=False)
            edits.append((field.start, field.end, format_number(value, decimals[index], style)))
    if vectors is not None:
        texts = vector_texts(vectors[0], VECTOR_DECIMALS, False)
        if len(fields) >= 6:
            for field, text in zip(fields[3:6], texts, strict=True):
                edits.append((field.start, field.end, text))
        elif texts != said:
            edits.append((fields[2].end, fields[2].end, "," + ",".join(texts)))
        said = texts
    elif len(fields) >= 6:
        said = None
    first = apply_edits(raw, edits)
    many = len(rows) > 1
    out.append(first if end or not many else first + newline)
    head = raw[: fields[0].start]
    for place in range(1, len(rows)):
        numbers = [
            format_number(rows[place][i] / unit, decimals[i], style._replace(keep=decimals[i])) for i in range(3)
        ]
        if vectors is not None:
            texts = vector_texts(vectors[place], VECTOR_DECIMALS, False)
            if texts != said:
                numbers += texts
            said = texts
        if rewrite.move.kind is Kind.RAPID:
            out.append(f"RAPID{end or newline}")
        goto = head if "$" not in head and statement.word == "GOTO" else "GOTO/"
        out.append(f"{goto}{','.join(numbers)}{end or newline}")
    if not end:
        out[-1] = out[-1].removesuffix(newline)
    return said


def _decimals(text: str) -> int:
    return 0 if _EXPONENT.fullmatch(text) else min(12, len(text.partition(".")[2]))


@final
class _Reader:
    """Interprets statements in order."""

    def __init__(self, source: str, axes: AxisWords) -> None:
        self.source = source
        self.names = frozenset(axes.linear)
        self.rotary = (math.nan,) * len(axes.rotary)
        self.moves: list[Move] = []
        self.notices: list[Notice] = []
        self.unit = 1.0
        self.rapid = False
        self.vector: Vector = (0.0, 0.0, 1.0)
        self._noted: set[str] = set()
        self._line = 0

    def refuse(self, what: str, value: object, expected: str) -> InputError:
        """An error at the present statement."""
        return InputError(what, expected=expected, file=self.source, line=self._line + 1, value=value)

    def note(self, text: str, *, once: bool = False) -> None:
        """A notice at the present statement."""
        if not (once and text in self._noted):
            self._noted.add(text)
            self.notices.append(Notice(self._line, text))

    def step(self, statement: Statement) -> None:
        """Interpret one statement."""
        word = statement.word
        if not word:
            return
        self._line = statement.line
        if word == "GOTO":
            self._goto(statement, self.rapid)
            self.rapid = False
            return
        shown = statement.raw.strip()
        if word == "FROM":
            self._goto(statement, True)
        elif word == "RAPID":
            self.rapid = True
        elif word == "FEDRAT":
            self.rapid = False
        elif word == "UNITS":
            unit = statement.fields[0].text.upper() if statement.fields else ""
            if unit not in ("MM", "INCHES", "INCH"):
                raise self.refuse("a unit that is not one", shown, "UNITS/MM or UNITS/INCHES")
            self.unit = 1.0 if unit == "MM" else MM_PER_INCH
        elif word == "GOHOME":
            self.note("GOHOME passes through uncompensated")
        elif word == "INSERT":
            self.note("INSERT passes text to the control that is not understood here")
        elif word == "MSYS" or word == "ORIGIN":
            values = [number(field.text) for field in statement.fields]
            identity = _IDENTITY[: len(values)] if word == "MSYS" else [0.0] * len(values)
            if values != identity:
                if word == "ORIGIN":
                    raise self.refuse("coordinate transformation ORIGIN", shown, "locations in one work frame")
                self.note("MSYS is not the identity: locations are taken in it, the work frame", once=True)
        elif word in _REFUSED:
            raise self.refuse(_REFUSED[word][0], shown, _REFUSED[word][1])
        elif word == "CYCLE":
            if not statement.fields or statement.fields[0].text.upper() not in ("OFF", "NOMORE"):
                raise self.refuse("canned cycle", shown, "the cycle expanded into GOTO statements")
        elif word == "CUTCOM":
            if any(field.text.upper() in ("LEFT", "RIGHT", "ON") for field in statement.fields):
                raise self.refuse("cutter radius compensation CUTCOM", shown, "CUTCOM/OFF, the tool centre path")
        elif word == "MODE":
            if any(field.text.upper().startswith("INCR") for field in statement.fields):
                raise self.refuse("incremental MODE", shown, "absolute GOTO statements")
        elif word not in _PASSED and not word.startswith(("PARTNO", "PPRINT", "INSERT", "TOOLPATH", "REMARK")):
            self.note(f"a statement that is not understood passes through: {shown[:60]}")

    def _goto(self, statement: Statement, rapid: bool) -> None:
        fields = statement.fields
        shown = statement.raw.strip()
        if len(fields) not in (3, 6):
            raise self.refuse(f"a location with {len(fields)} numbers", shown, "x,y,z or x,y,z,i,j,k")
        values = []
        for field in fields:
            value = number(field.text.replace("D", "E").replace("d", "e"))
            if value != value:
                raise self.refuse("a coordinate that is not a number", field.text or shown, "a number like 12.5")
            values.append(value)
        if len(values) == 6:
            vector, length = unit_vector((values[3], values[4], values[5]))
            if length == 0.0:
                raise self.refuse("tool vector of zero length", shown, "a direction")
            if abs(length - 1.0) > 1e-3:
                self.note(f"tool vector of length {length:.6g} is taken as a direction")
            self.vector = vector
        x, y, z = (value * self.unit for value in values[:3])
        self.moves.append(
            Move(
                line=statement.line,
                kind=Kind.RAPID if rapid else Kind.LINEAR,
                tcp=True,
                position=(x, y, z, *self.rotary),
                named=self.names,
                vector=self.vector,
            )
        )
