"""Interpreter of APT statements.

Simple ``GOTO`` statements found all at once, through an image of the text that has the form of ISO lines.

The simple statements here are ``GOTO/x,y,z`` and ``GOTO/x,y,z,i,j,k`` in a line of their own, without blanks before or between their
numbers, and with a tool vector of nearly unit length. The image has the same length, so that the places of its words are those of the
text: ``GOTO/1.5,2,3`` becomes ``····X1.5Y2Z3`` (· is a blank).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin.nc.arcs import PLANES, ArcMisfit, arc_by_centre
from twin.nc.blocks import (
    Arc,
    AxisWords,
    FrameChange,
    Kind,
    LostPositions,
    Move,
    MoveColumns,
    Notice,
    WordFrame,
    fill_forward,
    line_ends,
)
from twin.nc.chunks import DELETED_LINE
from twin.nc.lines import LineCode, Scan
from twin.nc.modal import AUXILIARY, BESIDE, CORRECTION_DEG, SWITCHING_M
from twin.nc.text import BOM, MM_PER_INCH, UNIT_LENGTH, ProgramEnd, number, unit_vector
from twin.nc.writer import Vector

_STATEMENT = re.compile(r"[ \t\f\x1a]*+([A-Za-z][A-Za-z0-9_ -]*+)(?:(/)(.*))?", re.ASCII | re.DOTALL)
_new = tuple.__new__
_CONTINUED = re.compile(r"\$[ \t]*(?:\r\n|\n|\r)")


class AptField(NamedTuple):
    """One argument of a statement: its range in the raw text, without surrounding spaces, and its text."""

    start: int
    end: int
    text: str


class Statement(NamedTuple):
    """One statement: lines joined over ``$``.

    Attributes:
        line: 0-based index of its first line.
        raw: its lines as written.
        word: its major word in capitals, without spaces; empty for comments and blank lines.
        at: start of its arguments in the raw text.
        arguments: the arguments, joined into one line.
    """

    line: int
    raw: str
    word: str
    at: int = 0
    arguments: str = ""

    @property
    def texts(self) -> list[str]:
        """The texts of the arguments."""
        return [field.strip() for field in self._split_arguments()]

    @property
    def fields(self) -> list[AptField]:
        """The arguments with their ranges."""
        fields = []
        at = self.at + (1 if self.arguments.startswith(",") else 0)
        for field in self._split_arguments():
            bare = field.strip()
            start = at + field.find(bare)
            fields.append(_new(AptField, (start, start + len(bare), bare)))
            at += len(field) + 1
        return fields

    def _split_arguments(self) -> list[str]:
        arguments = self.arguments
        return arguments.removeprefix(",").split(",") if arguments else []


def statement_at(texts: Sequence[str], first: int, line: int = 0) -> tuple[Statement, int]:
    """Return the statement that begins at one of some lines, and the index of the line after it; ``line``: index of the first line."""
    raw = text = texts[first]
    index = first + 1
    if "$" in text:
        parts = [text]
        while continues(text) and index < len(texts):
            text = texts[index]
            parts.append(text)
            index += 1
        raw = "".join(parts)
    return _statement(line + first, raw), index


def continues(text: str) -> bool:
    """Return whether the statement of a line goes on in the next one."""
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


# --- Simple ``GOTO`` statements found all at once, through an image of the text that has the form of ISO lines

_NAMES: Final = ("X", "Y", "Z", "A", "B", "C")
NOTED: Final = 1e-3
"""Difference of a tool vector's length from one above which a notice is given."""
_LETTERS: Final = np.frombuffer(b"YZABC", dtype=np.uint8)
"""Letters in place of the commas of a statement."""
_HEAD: Final = np.frombuffer(b"GOTO", dtype=np.uint8)
_NOTE: Final = re.compile(rb"[ \t]*+(?:\$\$[^\r\n]*+)?+[\r\n]*+|" + re.escape(DELETED_LINE.encode()))
"""Comment lines, blank ones and deleted ones."""
_CAPITAL: Final = 0xDF
"""Mask that makes a small letter a capital."""


def scan(data: bytes, names: tuple[str, ...], code: LineCode) -> Scan:
    """Find and read the simple statements of whole lines of a program; its words are always those of x, y, z, i, j, k."""
    text = np.frombuffer(data, dtype=np.uint8)
    image = text.copy()
    starts = np.concatenate([[0], line_ends(text, data) + 1])
    at = np.flatnonzero(text == ord("/"))
    line = np.searchsorted(starts, at, side="right") - 1
    good = at - starts[line] == len(_HEAD)
    at, line = at[good], line[good]
    good = (text[at[:, None] + np.arange(-len(_HEAD), 0)] & _CAPITAL == _HEAD).all(axis=1)
    at, line = at[good], line[good]
    image[at[:, None] + np.arange(-len(_HEAD), 0)], image[at] = ord(" "), ord("X")
    headed = np.zeros(len(starts), dtype=bool)
    headed[line] = True
    commas = np.flatnonzero(text == ord(","))
    line = np.searchsorted(starts, commas, side="right") - 1
    place = np.arange(len(commas)) - np.searchsorted(commas, starts)[line]
    image[commas] = np.where(headed[line], _LETTERS[np.minimum(place, len(_LETTERS) - 1)], ord(","))
    notes = starts[:-1][text.take(starts[:-1], mode="clip") == ord("$")]
    image[notes[text.take(notes + 1, mode="clip") == ord("$")]] = ord(";")
    scan = code.scan(image.tobytes(), _NAMES)
    count = np.diff(scan.first)
    simple = scan.simple & headed[: len(scan.simple)] & ((count == 3) | (count == 6))
    tilted = np.flatnonzero(simple & (count == 6))
    length = np.linalg.norm(scan.words.value[scan.first[tilted, None] + [3, 4, 5]], axis=1)
    simple[tilted[np.abs(length - 1.0) > 0.5 * NOTED]] = False
    blank = np.zeros(len(simple), dtype=bool)
    blank[[i for i in np.flatnonzero(scan.blank).tolist() if _NOTE.fullmatch(data, scan.start[i], scan.end[i])]] = True
    return replace(scan, data=data, text=text, simple=simple, blank=blank)


def locations(found: Scan, lines: np.ndarray) -> np.ndarray:
    """Return (lines, 6) the numbers of simple statements, NaN where there are only three."""
    numbers = np.full((len(lines), len(_NAMES)), np.nan)
    words = slice(found.first[lines[0]], found.first[lines[-1] + 1])
    row = np.repeat(np.arange(len(lines)), np.diff(found.first)[lines])
    numbers[row, found.words.axis[words]] = found.words.value[words]
    return numbers


# --- Interpreter of APT statements ----------------------------------------------------------------

_PASSED = frozenset(
    """SPINDL COOLNT TOOLNO PAINT MSYS MULTAX PARTNO MACHIN CUTTER END FINI STOP OPSTOP DELAY HEAD
    SELECTL SELECT TPRINT TMARK LEADER INTOL OUTTOL TOLER PPRINT DISPLY TLDATA CLAMP SEQNO OPTION
    PREGO RETRCT CLEARP LINTOL MCHTOL REWIND MODE UNITS CUTCOM CYCLE ORIGIN PITCH CLRSRF TOOL SET CHKSUM
    UNLOAD AIR MCHFIN NOPOST ARCSLP RESET PROGRAM TOOLPATH ENDOFPATH CATPROCESS REMARK BREAK PLABEL ISTOP
    CONTRL DATE TIME VERSION OPERATION PROCESS CSI_SET_FLUTE_LENGTH CSI_SET_EXTENSION_LENGTH""".split()
)
_REFUSED: dict[str, tuple[str, str]] = {
    "GODLTA": ("incremental GODLTA", "absolute GOTO statements"),
    **{
        word: (f"curve {word}", "cutter locations linearised by the CAM system")
        for word in ("ARC", "HELIX", "NURBS", "SPLINE", "MOVARC", "CONE", "CYLNDR", "ELLIPS", "POLYGN")
    },
    **{
        word: (f"coordinate transformation {word}", "locations in one work frame")
        for word in ("ROTATE", "TRANS", "COPY", "MIRROR", "MATRIX", "ROTABL", "ROTHED", "TRACUT", "INDEX", "REFSYS")
    },
    **{
        word: (f"contour motion {word}", "GOTO statements from the CAM system")
        for word in ("GOFWD", "GOBACK", "GOLFT", "GORGT", "GOUP", "GODOWN", "GO", "TLON", "TLLFT", "TLRGT", "INDIRV")
    },
    **{
        word: ("control flow", "one program without jumps or calls")
        for word in ("CALL", "MACRO", "TERMAC", "LOOPST", "LOOPND", "JUMPTO", "IF", "DO", "TRANTO")
    },
}
UNKNOWN_FROM_HERE = "is not known: nothing is known of the locations after it"
_AUXILIARY = frozenset({*range(15), 19, 30})
"""Auxiliary functions of DIN 66025: stops, spindle, tool change, coolant, clamps."""
_IDENTITY = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
_CSYS_IDENTITY = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
_IDENTITY_ROWS = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
_ALONG_Z = 1e-4
"""Largest difference of the tool axis from the z of a turned CSYS; both are printed with few decimals."""
_OWN_BLOCK = re.compile(r"[ \t]*(?:(?:/\d?|N\d+)[ \t]*)?[A-Z#$][ \t]*[-+.\d#\[=<]", re.ASCII | re.IGNORECASE)
"""Beginning of a block of a control in the text of ``INSERT``."""
_PARALLEL = 1e-6
"""Largest component of the axis of an arc across a coordinate axis."""


@final
class AptReader:
    """Interpreter of statements in order."""

    def __init__(self, source: str, axes: AxisWords) -> None:
        self.source = source
        self.axes = axes
        self.names = frozenset(axes.linear)
        self.rotary = (math.nan,) * len(axes.rotary)
        self.notices: list[Notice] = []
        self.late_notices: list[Notice] = []
        self.lost_positions: list[LostPositions] = []
        self.frames: list[FrameChange] = []
        self.drilled: list[range] = []
        self.unit = 1.0
        self.rapid = False
        self.unknown = ""
        self._tool = self._used_tool = ""
        self._tool_line = 0
        self.vector: Vector = (0.0, 0.0, 1.0)
        self.cycle = False
        self._side = self._on_contour = False
        self._at: tuple[float, ...] = (math.nan,) * 3
        self._csys: list[float] | None = None
        self._turned: tuple[float, float, float] | None = None
        """Direction of z of a turned CSYS, which is the tool axis of its locations if they are in the world's coordinates."""
        self._in_world = False
        self._circle: tuple[Statement, list[float]] | None = None
        self.end = ProgramEnd()
        self._noted: set[str] = set()
        self._line = 0

    @property
    def alone(self) -> bool:
        """Whether the next location must be read alone: rapid, hole, beside the contour, end of an arc, unknown, or after the end."""
        beside = self._side or self._on_contour
        other = beside or self._turned is not None or self._circle is not None
        return self.rapid or self.cycle or other or bool(self.unknown or self.end.word)

    def error(self, what: str, value: object, expected: str) -> InputError:
        """Return an error at the current statement."""
        return InputError(what, expected=expected, file=self.source, line=self._line + 1, value=value)

    def note(self, text: str, *, once: bool = False) -> None:
        """Add a notice at the current statement; ``once``: only if there is no such notice yet."""
        if not (once and text in self._noted):
            self._noted.add(text)
            self.notices.append(Notice(self._line, text))

    def step(self, statement: Statement) -> Move | None:
        """Interpret one statement and return its move, if any; raise `InputError` for anything that must not pass uncompensated."""
        word = statement.word
        if not word:
            return None
        self._line = statement.line
        if self.end.word:
            self.note(self.end.notice, once=True)
            return None
        if word == "FINI":
            self.end.reached(word, self._line)
        if word in _MEANINGS:
            return _MEANINGS[word](self, statement)
        if word in _REFUSED:
            what, expected = _REFUSED[word]
            raise self.error(what, statement.raw.strip(), expected)
        if word not in _PASSED and not word.startswith(("PARTNO", "PPRINT", "TOOLPATH", "REMARK")):
            self._lose(statement)
        return None

    def _lose(self, statement: Statement) -> None:
        """Make all that follows unknown: locations have no absolute form that does not depend on the statements before.

        A statement whose word the machine file names as harmless has no effect.
        """
        shown = " ".join(statement.raw.split())[:60]
        if statement.word in self.axes.harmless:
            return
        self.note(f"the effect of {shown} {UNKNOWN_FROM_HERE}")
        self.unknown = self.unknown or f"the effect of {shown} is not known"

    def run(self, lines: np.ndarray, numbers: np.ndarray) -> MoveColumns:
        """Interpret simple ``GOTO`` statements together, none of them a rapid; numbers are (n, 6), NaN for no tool vector."""
        self.use_tool()
        vector, width = numbers[:, 3:].copy(), len(self.axes.names)
        said = np.isfinite(vector)
        length = np.sqrt(vector[:, 0] ** 2 + vector[:, 1] ** 2 + vector[:, 2] ** 2)[:, None]
        vector = np.where(np.abs(length - 1.0) < UNIT_LENGTH, vector, vector / length)
        fill_forward(vector, said, self.vector)
        self.vector = tuple(vector[-1].tolist())
        self._at = tuple((numbers[-1, :3] * self.unit).tolist())
        position = np.full((len(lines), width), np.nan)
        position[:, :3] = numbers[:, :3] * self.unit
        feed, tcp, named = np.zeros(len(lines), dtype=bool), np.ones(len(lines), dtype=bool), np.full(len(lines), 0b111)
        return MoveColumns(self.axes.names, lines, feed, tcp, named, position, vector, {})

    def _rapid(self, statement: Statement) -> None:
        self.rapid = statement.word == "RAPID"

    def _units(self, statement: Statement) -> None:
        unit = statement.texts[0].upper() if statement.arguments else ""
        if unit not in ("MM", "INCHES", "INCH"):
            raise self.error("unknown unit", statement.raw.strip(), "UNITS/MM or UNITS/INCHES")
        self.unit = 1.0 if unit == "MM" else MM_PER_INCH

    def _home(self, statement: Statement) -> None:
        self.note("GOHOME passed through uncompensated")

    def _auxiliary(self, statement: Statement) -> None:
        code = number(statement.texts[0]) if statement.arguments else math.nan
        if code != code or code in SWITCHING_M:
            self._lose(statement)
        elif code not in _AUXILIARY:
            self.note(f"AUXFUN/{code:g} {AUXILIARY}")

    def _load(self, statement: Statement) -> None:
        texts = [text for text in statement.texts if text.upper() != "TOOL"]
        self._tool, self._tool_line = (texts[0] if texts else ""), statement.line
        if self.axes.tools_known and self._tool:
            value = number(self._tool)
            name = f"{value:g}" if value == value else self._tool.strip("'\"")
            self.frames.append(FrameChange(self._line, WordFrame(tool=name, length=name)))

    def _frame(self, statement: Statement) -> None:
        if [number(text) for text in statement.texts] != _IDENTITY[: len(statement.texts)]:
            self.note("MSYS is not the identity: its frame is assumed to be the work frame", once=True)

    def _coordinates(self, statement: Statement) -> None:
        """Take the coordinate system of the set-up: the same one for all locations is the work frame, wherever its zero is.

        A turned one behind ``TRNTYP/WORLD`` turns nothing: every location must show it, by a tool axis along its z.
        """
        values = [number(text) for text in statement.texts]
        self._turned = None
        shifted = self._csys is None and values[:3] + values[4:7] + values[8:11] == _IDENTITY_ROWS and len(values) == 12
        if shifted and values != _CSYS_IDENTITY and self._at[0] != self._at[0]:
            self.note("CSYS is shifted: the locations are taken to be in its coordinates, the work frame", once=True)
            self._csys = values
        elif values == (self._csys or _CSYS_IDENTITY):
            return
        elif self._in_world and self._csys is None and _turns_z(values):
            self.note(
                "CSYS is turned: the locations, whose tool axis is its z, are taken to be in the world's coordinates",
                once=True,
            )
            self._turned = values[2], values[6], values[10]
        else:
            self._lose(statement)

    def _transformation(self, statement: Statement) -> None:
        if statement.texts[:1] != ["WORLD"] or any(number(text) != 0.0 for text in statement.texts[1:]):
            self._lose(statement)
        self._in_world = statement.texts[:1] == ["WORLD"]

    def _insert(self, statement: Statement) -> None:
        if _OWN_BLOCK.match(statement.arguments):
            self._lose(statement)
        else:
            self.note("INSERT passed through: its text is taken to be a remark for the postprocessor", once=True)

    def _origin(self, statement: Statement) -> None:
        if any(number(text) != 0.0 for text in statement.texts):
            shown = statement.raw.strip()
            raise self.error("coordinate transformation ORIGIN", shown, "locations in one work frame")

    def _cycle(self, statement: Statement) -> None:
        """Begin or end a cycle of the postprocessor, which makes a hole at every location."""
        first = statement.texts[0].upper() if statement.arguments else ""
        if first == "ON":
            raise self.error("canned cycle", statement.raw.strip(), "CYCLE with its values")
        self.cycle = first not in ("OFF", "NOMORE", "INIT")
        if self.cycle:
            self.note("CYCLE is left to the postprocessor: its depths have the correction of the location", once=True)

    def _circle_record(self, statement: Statement) -> None:
        values = [number(text) for text in statement.texts]
        if len(values) not in (6, 7, 11) or any(value != value for value in values):
            expected = "CIRCLE/x,y,z,i,j,k,radius before the end point, without TIMES"
            raise self.error("curve CIRCLE", statement.raw.strip(), expected)
        if self._circle is not None:
            raise self.error("arc without its end point", self._circle[0].raw.strip(), "GOTO behind it")
        if self.cycle:
            raise self.error("arc within a cycle", statement.raw.strip(), "CYCLE/OFF before it")
        self._circle = (statement, values)

    def _arc(self, end: Sequence[float], vector: Vector) -> Arc | None:
        """Return the arc of the ``CIRCLE`` before a location, right-handed about its axis; None if there is none."""
        if self._circle is None:
            return None
        statement, values = self._circle
        self._circle = None
        shown = statement.raw.strip()
        axis, length = unit_vector((values[3], values[4], values[5]))
        along = max(range(3), key=lambda place: abs(axis[place]))
        if length == 0.0 or any(abs(axis[place]) > _PARALLEL for place in range(3) if place != along):
            raise self.error("arc in an oblique plane", shown, "cutter locations linearised by the CAM system")
        if _turns(vector, self.vector):
            raise self.error("arc with a tool that turns", shown, "cutter locations linearised by the CAM system")
        plane = a, b, _ = PLANES[(19, 18, 17)[along]]
        centre = (values[a] * self.unit, values[b] * self.unit)
        start = (self._at[a], self._at[b])
        found = arc_by_centre(plane, start, (end[a], end[b]), centre, axis[along] < 0.0)
        if isinstance(found, ArcMisfit):
            raise self.error(found.what, shown, found.expected)
        return found

    def _cutcom(self, statement: Statement) -> None:
        self._side = cuts_beside(statement)
        if self._side:
            self.note(BESIDE, once=True)

    def _mode(self, statement: Statement) -> None:
        if any(text.upper().startswith("INCR") for text in statement.texts):
            raise self.error("incremental MODE", statement.raw.strip(), "absolute GOTO statements")

    def _goto(self, statement: Statement) -> Move:
        texts = statement.texts
        shown = statement.raw.strip()
        if len(texts) not in (3, 6):
            raise self.error(f"location with {len(texts)} numbers", shown, "x,y,z or x,y,z,i,j,k")
        values = []
        for text in texts:
            value = number(text)
            if value != value and (value := number(text.replace("D", "E").replace("d", "e"))) != value:
                raise self.error("coordinate that is not a number", text or shown, "a number such as 12.5")
            values.append(value)
        if len(values) == 6:
            vector, length = unit_vector((values[3], values[4], values[5]))
            if length == 0.0:
                raise self.error("tool vector of zero length", shown, "a direction")
            if abs(length - 1.0) > NOTED:
                self.note(f"tool vector of length {length:.6g} normalised")
        else:
            vector = self.vector
        if self._turned is not None and (len(values) == 3 or math.dist(vector, self._turned) > _ALONG_Z):
            raise self.error(
                "location in a turned CSYS without its z as tool axis",
                shown,
                "x,y,z,i,j,k in the world's coordinates",
            )
        unit = self.unit
        position = (values[0] * unit, values[1] * unit, values[2] * unit, *self.rotary)
        kind = Kind.RAPID if statement.word == "FROM" or self.rapid or self.cycle else Kind.LINEAR
        self.rapid = self.rapid and statement.word == "FROM"
        self._circle = None if self.unknown else self._circle
        arc = self._arc(position, vector)
        whole = self._side or self._on_contour
        if whole and _turns(vector, self.vector):
            what = "cutter radius compensation CUTCOM with a tool that turns"
            raise self.error(what, shown, "CUTCOM/OFF, the tool centre path")
        self._on_contour = self._side
        self.vector, self._at = vector, position[:3]
        if self.unknown:
            nowhere = (math.nan,) * len(self.axes.names)
            return Move(self._line, kind, True, nowhere, self.names, unknown=self.unknown)
        self.use_tool()
        kind = kind if arc is None else Kind.ARC
        return Move(self._line, kind, True, position, self.names, vector=vector, arc=arc, whole=whole)

    def use_tool(self) -> None:
        """Record that a location uses the tool that is loaded; raise `InputError` for a second one of unknown length."""
        lengths_unknown = self.axes.one_tool and not self.axes.tools_known
        if lengths_unknown and self._used_tool and self._tool not in ("", self._used_tool):
            self._line = self._tool_line
            expected = self._tool
            shown = f"one tool per program (locations before use {self._used_tool}), or the table of tools"
            raise self.error("second tool", expected, shown)
        self._used_tool = self._tool or self._used_tool


def _turns_z(values: list[float]) -> bool:
    """Return whether the twelve numbers of CSYS, rows of axes and origin, have right-handed axes, z other than that of the world."""
    if len(values) != 12 or not all(map(math.isfinite, values)):
        return False
    axes = np.array(values).reshape(3, 4)[:, :3]
    right = np.abs(axes.T @ axes - np.eye(3)).max() < _ALONG_Z and np.linalg.det(axes) > 0.0
    return bool(right and np.abs(axes[:, 2] - [0.0, 0.0, 1.0]).max() > 10.0 * _ALONG_Z)


def _turns(one: Vector, other: Vector) -> bool:
    """Return whether the tool turns by more than a correction."""
    return math.dist(one, other) > math.radians(CORRECTION_DEG)


def cuts_beside(statement: Statement) -> bool:
    """Return whether a ``CUTCOM`` selects a side of the contour."""
    return any(text.upper() in ("LEFT", "RIGHT", "ON") for text in statement.texts)


_MEANINGS: Final[Mapping[str, Callable[[AptReader, Statement], Move | None]]] = {
    "AUXFUN": AptReader._auxiliary,
    "CIRCLE": AptReader._circle_record,
    "CSYS": AptReader._coordinates,
    "CUTCOM": AptReader._cutcom,
    "CYCLE": AptReader._cycle,
    "FEDRAT": AptReader._rapid,
    "FROM": AptReader._goto,
    "GOHOME": AptReader._home,
    "GOTO": AptReader._goto,
    "INSERT": AptReader._insert,
    "LOAD": AptReader._load,
    "LOADTL": AptReader._load,
    "MODE": AptReader._mode,
    "MSYS": AptReader._frame,
    "ORIGIN": AptReader._origin,
    "RAPID": AptReader._rapid,
    "TRNTYP": AptReader._transformation,
    "TURRET": AptReader._load,
    "UNIT": AptReader._units,
    "UNITS": AptReader._units,
}
"""Handlers of statements that may change the meaning of locations, by their major word."""
