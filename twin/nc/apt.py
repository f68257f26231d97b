"""APT cutter locations (``.cls``, ``.apt``): ``GOTO/x,y,z,i,j,k`` in the work frame."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple, final

from twin._common.errors import InputError
from twin.nc.blocks import AxisWords, Kind, Move, Notice, Program, Reading, Rewrite
from twin.nc.dialect import TextDialect
from twin.nc.emit import Vector, pieces_of, vector_texts
from twin.nc.header import first_lines, inserted
from twin.nc.plain import NOTHING, VALUE
from twin.nc.text import (
    BLANK,
    BOM,
    MM_PER_INCH,
    Style,
    ending,
    format_number,
    newline_of,
    number,
    style_of,
    unit_vector,
)

POSITION_DECIMALS = 5
VECTOR_DECIMALS = 9
_STATEMENT = re.compile(r"[ \t\f\x1a]*+([A-Za-z][A-Za-z0-9_ -]*+)(?:(/)(.*))?", re.ASCII | re.DOTALL)
_CONTINUED = re.compile(r"\$[ \t]*(?:\r\n|\n|\r)")
_NUMBER = rf"[ \t]*+({VALUE})[ \t]*+"
_THREE = f"{_NUMBER},{_NUMBER},{_NUMBER}"
_PLAIN = re.compile(rf"[ \t]*+GOTO[ \t]*+/{_THREE}(?:,{_THREE})?+[\r\n]*+", re.ASCII | re.IGNORECASE)
"""A location on one line, without exponents."""
_EXPONENT = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)[EeDd][+-]?\d{1,3}", re.ASCII)

_PASSED = frozenset(
    """RAPID FEDRAT SPINDL COOLNT LOADTL TOOLNO PAINT MSYS MULTAX PARTNO MACHIN CUTTER END FINI STOP OPSTOP DELAY HEAD
    SELECTL SELECT TPRINT TMARK LEADER INTOL OUTTOL TOLER PPRINT DISPLY TLDATA TURRET CLAMP AUXFUN PREFUN SEQNO OPTION
    PREGO RETRCT CLEARP LINTOL MCHTOL REWIND INSERT MODE UNITS CUTCOM CYCLE ORIGIN PITCH CLRSRF TOOL SET CHKSUM LOAD
    UNLOAD AIR MCHFIN NOPOST ARCSLP RESET PROGRAM TOOLPATH ENDOFPATH CATPROCESS TLAXIS REMARK BREAK PLABEL ISTOP
    CONTRL DATE TIME VERSION OPERATION PROCESS""".split()
)
_LOOKED_AT = frozenset("RAPID FEDRAT MSYS INSERT UNITS CUTCOM CYCLE ORIGIN MODE".split())
"""Statements that pass, if they say nothing that changes what locations mean."""
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
    """One argument of a statement: where it stands in the raw text, without spaces around it, and its text."""

    start: int
    end: int
    text: str


class Statement(NamedTuple):
    """One statement: lines joined over ``$``.

    Attributes:
        line: 0-based index of its first line.
        raw: its lines as they are.
        word: its major word in capitals, spaces removed; empty for comments and blank lines.
        at: where its arguments begin in the raw text.
        arguments: what they are, joined into one line.
    """

    line: int
    raw: str
    word: str
    at: int = 0
    arguments: str = ""

    @property
    def texts(self) -> list[str]:
        """Its arguments."""
        return [field.strip() for field in self._pieces()]

    @property
    def fields(self) -> list[Field]:
        """Its arguments, with their places."""
        found = []
        at = self.at + (1 if self.arguments.startswith(",") else 0)
        for piece in self._pieces():
            bare = piece.strip()
            start = at + len(piece) - len(piece.lstrip())
            found.append(Field(start, start + len(bare), bare))
            at += len(piece) + 1
        return found

    def _pieces(self) -> list[str]:
        arguments = self.arguments
        return arguments.removeprefix(",").split(",") if arguments else []


def statements(program: Program) -> Iterator[Statement]:
    """The statements of a program, in order; together their raw texts are the program."""
    index = 0
    while index < len(program.texts):
        statement, index = statement_at(program.texts, index)
        yield statement


def statement_at(texts: Sequence[str], first: int) -> tuple[Statement, int]:
    """The statement that begins at a line, and the index of the line after it."""
    raw = text = texts[first]
    index = first + 1
    if "$" in text:
        parts = [text]
        while _continues(text) and index < len(texts):
            text = texts[index]
            parts.append(text)
            index += 1
        raw = "".join(parts)
    return _statement(first, raw), index


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
        return Statement(line, raw, text.strip(" \t\r\n\f\x1a%") and "?")
    word = found.group(1).upper().replace(" ", "").replace("-", "")
    if found.group(2) is None:
        return Statement(line, raw, word)
    return Statement(line, raw, word, found.start(3), found.group(3).rstrip())


@final
class Apt(TextDialect):
    """APT cutter locations."""

    name = "apt"
    suffixes = (".cls", ".apt")

    def commented(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.commented`: behind ``PARTNO``."""
        lines = first_lines(text)
        at = place = 0
        while place < len(lines):
            statement, after = statement_at(lines, place)
            if statement.word == "PARTNO":
                at = after
            elif statement.word:
                break
            place = after
        return inserted(text, lines, at, comments, "$$ {}".format, _comment)

    def _moves(self, program: Program, axes: AxisWords, *, tcp: bool, short_way: bool = True) -> Reading:
        """See `TextDialect._moves`. Cutter locations are tool-tip coordinates whatever ``tcp`` says."""
        reader = _Reader(program.source, axes)
        match = (_PLAIN if short_way else NOTHING).fullmatch
        texts = program.texts
        index = 0
        while index < len(texts):
            text = texts[index]
            found = match(text)
            if found is not None:
                reader.plain(index, found)
                index += 1
            elif text in BLANK:
                index += 1
            else:
                statement, index = statement_at(texts, index)
                reader.step(statement)
        return Reading(tuple(reader.moves), tuple(reader.notices))

    def _rewrite(
        self,
        program: Program,
        axes: AxisWords,
        reading: Reading,
        rewrites: Iterable[Rewrite],
        *,
        short_way: bool = True,
    ) -> str:
        """See `TextDialect._rewrite`."""
        by_line = pieces_of(reading, rewrites, axes)
        if not by_line:
            return program.text
        reader = _Reader(program.source, axes)
        writer = _Writer(newline_of(program))
        match = (_PLAIN if short_way else NOTHING).fullmatch
        texts = program.texts
        index = 0
        while index < len(texts):
            text = texts[index]
            pieces = by_line.get(index)
            found = match(text)
            if found is not None:
                if pieces is None:
                    reader.plain(index, found)
                    writer.keep(text, tilts=found.lastindex == 6)
                else:
                    fields = [Field(*found.span(group), found[group]) for group in range(1, (found.lastindex or 0) + 1)]
                    writer.location(text, "GOTO", fields, *pieces[0], reader.unit)
                    reader.rapid = False
                index += 1
                continue
            before = len(reader.moves)
            statement, index = statement_at(texts, index)
            reader.step(statement)
            if len(reader.moves) == before:
                writer.keep(statement.raw, tilts=False)
            elif pieces is None:
                writer.keep(statement.raw, tilts=len(statement.texts) == 6)
            else:
                writer.location(statement.raw, statement.word, statement.fields, *pieces[0], reader.unit)
        return "".join(writer.out)


@final
class _Writer:
    """Writes statements, remembering the vector said last."""

    def __init__(self, newline: str) -> None:
        self.newline = newline
        self.out: list[str] = []
        self._said: tuple[str, str, str] | None = vector_texts((0.0, 0.0, 1.0), VECTOR_DECIMALS, False)

    def keep(self, raw: str, *, tilts: bool) -> None:
        """A statement that stays as it is; ``tilts``: it says a tool vector."""
        self.out.append(raw)
        if tilts:
            self._said = None

    def location(
        self, raw: str, word: str, fields: list[Field], rewrite: Rewrite, rows: list[list[float]], unit: float
    ) -> None:
        """The pieces of a location.

        Args:
            raw: the statement's text.
            word: its major word.
            fields: its numbers, three or six.
            rewrite: what replaces it.
            rows: its positions, as lists.
            unit: mm per program unit.
        """
        end = ending(raw)
        vectors: list[list[float]] | None = None if rewrite.vectors is None else rewrite.vectors.tolist()
        style = Style()
        decimals = [POSITION_DECIMALS] * 3
        parts = []
        at = 0
        for index in range(3):
            start, stop, text = fields[index]
            decimals[index] = max(POSITION_DECIMALS, _decimals(text))
            value = rows[0][index] / unit
            if value == value:
                style = style_of(text, style)
                if style.keep != decimals[index] or style.comma:
                    style = style._replace(keep=decimals[index], comma=False)
                parts.append(raw[at:start])
                parts.append(format_number(value, decimals[index], style))
                at = stop
        if vectors is not None:
            texts = vector_texts(vectors[0], VECTOR_DECIMALS, False)
            if len(fields) == 6:
                for (start, stop, _), text in zip(fields[3:], texts, strict=True):
                    parts.append(raw[at:start])
                    parts.append(text)
                    at = stop
            elif texts != self._said:
                parts.append(f"{raw[at : fields[2].end]},{','.join(texts)}")
                at = fields[2].end
            self._said = texts
        elif len(fields) == 6:
            self._said = None
        parts.append(raw[at:])
        if len(rows) > 1 and not end:
            parts.append(self.newline)
        self.out += parts
        head = raw[: fields[0].start]
        goto = head if "$" not in head and word == "GOTO" else "GOTO/"
        for place in range(1, len(rows)):
            numbers = [
                format_number(rows[place][i] / unit, decimals[i], style._replace(keep=decimals[i])) for i in range(3)
            ]
            if vectors is not None:
                texts = vector_texts(vectors[place], VECTOR_DECIMALS, False)
                if texts != self._said:
                    numbers += texts
                self._said = texts
            if rewrite.move.kind is Kind.RAPID:
                self.out.append(f"RAPID{end or self.newline}")
            self.out.append(f"{goto}{','.join(numbers)}{end or self.newline}")
        if not end:
            self.out[-1] = self.out[-1].removesuffix(self.newline)


def _comment(line: str) -> str | None:
    """The text of a line that is a comment, or nothing; None of any other."""
    body = line.strip()
    return body[2:].strip() if body.startswith("$$") else None if body else ""


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
        if word in _PASSED and word not in _LOOKED_AT:
            return
        shown = statement.raw.strip()
        if word == "FROM":
            self._goto(statement, True)
        elif word == "RAPID":
            self.rapid = True
        elif word == "FEDRAT":
            self.rapid = False
        elif word == "UNITS":
            unit = statement.texts[0].upper() if statement.arguments else ""
            if unit not in ("MM", "INCHES", "INCH"):
                raise self.refuse("a unit that is not one", shown, "UNITS/MM or UNITS/INCHES")
            self.unit = 1.0 if unit == "MM" else MM_PER_INCH
        elif word == "GOHOME":
            self.note("GOHOME passes through uncompensated")
        elif word == "INSERT":
            self.note("INSERT passes text to the control that is not understood here")
        elif word == "MSYS" or word == "ORIGIN":
            values = [number(text) for text in statement.texts]
            identity = _IDENTITY[: len(values)] if word == "MSYS" else [0.0] * len(values)
            if values != identity:
                if word == "ORIGIN":
                    raise self.refuse("coordinate transformation ORIGIN", shown, "locations in one work frame")
                self.note("MSYS is not the identity: locations are taken in it, the work frame", once=True)
        elif word in _REFUSED:
            raise self.refuse(_REFUSED[word][0], shown, _REFUSED[word][1])
        elif word == "CYCLE":
            if not statement.arguments or statement.texts[0].upper() not in ("OFF", "NOMORE"):
                raise self.refuse("canned cycle", shown, "the cycle expanded into GOTO statements")
        elif word == "CUTCOM":
            if any(text.upper() in ("LEFT", "RIGHT", "ON") for text in statement.texts):
                raise self.refuse("cutter radius compensation CUTCOM", shown, "CUTCOM/OFF, the tool centre path")
        elif word == "MODE":
            if any(text.upper().startswith("INCR") for text in statement.texts):
                raise self.refuse("incremental MODE", shown, "absolute GOTO statements")
        elif word not in _PASSED and not word.startswith(("PARTNO", "PPRINT", "INSERT", "TOOLPATH", "REMARK")):
            self.note(f"a statement that is not understood passes through: {shown[:60]}")

    def plain(self, line: int, match: re.Match[str]) -> None:
        """Take a location on one line, as `step` does."""
        self._line = line
        values = [float(text) for text in match.groups() if text is not None]
        self._location(values, self.rapid, match.string)
        self.rapid = False

    def _goto(self, statement: Statement, rapid: bool) -> None:
        texts = statement.texts
        shown = statement.raw.strip()
        if len(texts) not in (3, 6):
            raise self.refuse(f"a location with {len(texts)} numbers", shown, "x,y,z or x,y,z,i,j,k")
        values = []
        for text in texts:
            value = number(text.replace("D", "E").replace("d", "e"))
            if value != value:
                raise self.refuse("a coordinate that is not a number", text or shown, "a number like 12.5")
            values.append(value)
        self._location(values, rapid, shown)

    def _location(self, values: list[float], rapid: bool, shown: str) -> None:
        if len(values) == 6:
            vector, length = unit_vector((values[3], values[4], values[5]))
            if length == 0.0:
                raise self.refuse("tool vector of zero length", shown.strip(), "a direction")
            if abs(length - 1.0) > 1e-3:
                self.note(f"tool vector of length {length:.6g} is taken as a direction")
            self.vector = vector
        unit = self.unit
        position = (values[0] * unit, values[1] * unit, values[2] * unit, *self.rotary)
        self.moves.append(
            Move(
                line=self._line,
                kind=Kind.RAPID if rapid else Kind.LINEAR,
                tcp=True,
                position=position,
                named=self.names,
                vector=self.vector,
            )
        )
