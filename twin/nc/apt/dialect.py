"""The APT dialect: cutter locations (``.cls``, ``.apt``), ``GOTO/x,y,z,i,j,k`` in the work frame."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from math import nan
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import PROGRAM_SUFFIXES
from twin.compute.native import compiler
from twin.nc.apt.reader import AptReader, Statement, continues, cuts_beside, locations, scan, statement_at
from twin.nc.arcs import moved_centre
from twin.nc.blocks import AxisWords, Kind, Lines, Move, MoveBuilder, MoveColumns, NewPositions, Rewrite, lines_in
from twin.nc.chunks import DELETED_LINE, Chunk, ChunkReader, ChunkWriter, runs
from twin.nc.dialect import NOTHING, Dialect, FeedUnit, LineWords, NewProgram
from twin.nc.lines import ARRAYS, LineCode, Scan
from twin.nc.text import (
    MM_PER_INCH,
    Style,
    apply_edits,
    ending,
    first_lines,
    format_number,
    insert_comments,
    line_pattern,
    newline_of,
    number,
    style_of,
)
from twin.nc.writer import vector_texts

# --- Locations of simple ``GOTO`` statements written together: with Python strings, or the same in compiled code (`locations.cpp`)

POSITION_DECIMALS: Final = 5
VECTOR_DECIMALS: Final = 9
MOST_DECIMALS: Final = 12
"""Decimals of a coordinate that are kept at most."""
_COMPONENT: Final = f"%.{VECTOR_DECIMALS}f"
_LONGEST_LOCATION: Final = 6 * 32
"""Most characters of a location: sign, 16 digits, point, 12 decimals and comma for each number."""
_VECTOR_ROOM: Final = 128
_POINTERS: Final = ctypes.c_void_p
_SCANNED: Final = ("text", "start", "end", "first")
_WORDS: Final = ("start", "end", "fraction")
_SAMPLE: Final = b"    X1.5Y-2Z0.1234567A0B0C1\r\n\n    X1Y2Z3.0000000000001\r\n    X0Y0Z-.5\n%\n    X1Y1Z1A1B0C0\n"
"""In the form of ISO lines, as `twin.nc.apt.reader.scan` makes it of a program."""


@final
@dataclass(frozen=True)
class TogetherJob:
    """Simple ``GOTO`` statements, consecutive except for comments, and their new locations.

    Attributes:
        count: (n,) number of segments of each.
        positions: (segments, axes) their end points in program units.
        vectors: (segments, 3) their tool vectors.
    """

    scan: Scan
    whole: slice
    lines: np.ndarray
    count: np.ndarray
    positions: np.ndarray
    vectors: np.ndarray


Said = tuple[str, ...]
"""Components of the tool vector written last."""
Together = Callable[[TogetherJob, Said | None], tuple[str, Said | None]]
"""Function that returns the statements with their new locations, and the last tool vector in them, given the last one before."""


def written(job: TogetherJob, said: Said | None) -> tuple[str, Said | None]:
    """Write locations with Python strings; see `Together`."""
    scan, whole, lines, count, vectors = job.scan, job.whole, job.lines, job.count, job.vectors
    text, words = scan.data[whole].decode("latin-1"), scan.words
    first, last = scan.first[lines], scan.first[lines + 1] - 1
    places = np.clip(words.fraction[first[:, None] + [0, 1, 2]], POSITION_DECIMALS, MOST_DECIMALS)
    numbers = list(zip(*(_fixed(job.positions[:, i], np.repeat(places[:, i], count)) for i in range(3)), strict=True))
    tools = list(zip(*(_shortest(vectors[:, i]) for i in range(3)), strict=True))
    ranges = (words.start[first], words.end[last], scan.start[lines], scan.end[lines])
    columns = (*((ends - whole.start).tolist() for ends in ranges), (last - first == 5).tolist(), count.tolist())

    def location(row: int, *, again: bool) -> str:
        before = tools[row - 1] if row else said
        return ",".join(numbers[row] + tools[row] if again or tools[row] != before else numbers[row])

    out, at, row = list[str](), 0, 0
    for begin, behind, start, end, tilted, segments in zip(*columns, strict=True):
        out += (text[at:begin], location(row, again=tilted))
        at = behind
        if segments > 1:
            head, newline = text[start:begin], ending(text[start:end])
            out.append(text[behind:end])
            out += (f"{head}{location(row + i, again=False)}{newline}" for i in range(1, segments))
            at = end
        row += segments
    out.append(text[at:])
    return "".join(out), tools[-1] if tools else said


def _fixed(values: np.ndarray, places: np.ndarray) -> list[str]:
    """Return numbers as `format_number` does with these many decimals and no fewer."""
    fixed = list(map("%.*f".__mod__, zip(places.tolist(), values.tolist(), strict=True)))
    for i in np.flatnonzero(np.signbit(values) & (np.abs(values) < 1.0)).tolist():
        fixed[i] = format_number(float(values[i]), int(places[i]), Style(min_decimals=int(places[i])))
    return fixed


def _shortest(values: np.ndarray) -> list[str]:
    """Return the components of tool vectors as `twin.nc.writer.vector_texts` does."""
    shortest = [
        text.rstrip("0").rstrip(".") if text[-1] == "0" else text for text in map(_COMPONENT.__mod__, values.tolist())
    ]
    for i in np.flatnonzero(np.signbit(values) & (np.abs(values) < 10.0**-VECTOR_DECIMALS)).tolist():
        shortest[i] = format_number(float(values[i]), VECTOR_DECIMALS, Style())
    return shortest


class _LocationJob(ctypes.Structure):
    """`Locations` of locations.cpp, field by field."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("begin", "stop", "count_lines", "axes")),
        *((name, _POINTERS) for name in ("text", "lines", "count", "start", "end", "first")),
        *((f"word_{name}", _POINTERS) for name in _WORDS),
        *((name, _POINTERS) for name in ("positions", "vectors", "said")),
        ("said_size", ctypes.c_int64),
        ("out", _POINTERS),
        ("written", ctypes.c_int64),
    )


@final
@dataclass(frozen=True)
class _CompiledLocations:
    """Writing by a compiled library."""

    library: ctypes.CDLL

    def written(self, job: TogetherJob, said: Said | None) -> tuple[str, Said | None]:
        """As `written`, which is called if a number is too large for the compiled code: 2⁵² units of its last decimal."""
        scan, whole = job.scan, job.whole
        given = {
            "lines": np.ascontiguousarray(job.lines, dtype=np.int64),
            "count": np.ascontiguousarray(job.count, dtype=np.int64),
            "positions": np.ascontiguousarray(job.positions, dtype=float),
            "vectors": np.ascontiguousarray(job.vectors, dtype=float),
        }
        given |= {name: getattr(scan, name) for name in _SCANNED}
        given |= {f"word_{name}": getattr(scan.words, name) for name in _WORDS}
        lines, count = given["lines"], given["count"]
        copied = int(count @ (scan.end[lines] - scan.start[lines]))
        room = whole.stop - whole.start + copied + _LONGEST_LOCATION * len(job.positions)
        given["out"] = np.empty(room, dtype=np.uint8)
        before = ",".join(said or ()).encode()
        # A longer vector differs from all that are written here.
        last = ctypes.create_string_buffer(before if len(before) < _VECTOR_ROOM else b"", _VECTOR_ROOM)
        passed = _LocationJob(
            begin=whole.start,
            stop=whole.stop,
            count_lines=len(lines),
            axes=job.positions.shape[1],
            said=ctypes.addressof(last),
            said_size=len(last.value),
        )
        compiler.point_to(passed, given)
        self.library.write_locations(ctypes.byref(passed))
        if passed.written < 0:
            return written(job, said)
        text = str(given["out"][: passed.written].data, "latin-1")
        return text, tuple(last.raw[: passed.said_size].decode().split(",")) if passed.said_size else None


def together_code(lines: int) -> Together:
    """Return compiled code if there is a compiler and the program has enough lines to be worth it, else `written`."""
    found = _compiled() if compiler.worth_compiling(lines) else None
    return written if found is None else found.written


@cache
def _compiled() -> _CompiledLocations | None:
    """Return the compiled code; None if it cannot be compiled, or differs from `written` on a sample."""
    jobs = {"write_locations": _LocationJob}
    confirmed_library = compiler.confirmed_library(
        "twin.nc.apt", "locations.cpp", jobs, lambda one: _agrees(_CompiledLocations(one))
    )
    return None if confirmed_library is None else _CompiledLocations(confirmed_library)


def _agrees(compiled: _CompiledLocations) -> bool:
    """Return whether a sample is written as by `written`."""
    seen = ARRAYS.scan(_SAMPLE, ("X", "Y", "Z", "A", "B", "C"))
    lines = np.flatnonzero(seen.simple)
    count = 1 + np.arange(len(lines)) % 3
    positions = np.cumsum(np.full((count.sum(), 3), [0.4371, -1e-6, 1 / 3]), axis=0) - [1.5, 0.0, 2.0**-7]
    vectors = np.round(np.sin(positions), 2)
    vectors[1::2] = vectors[: len(vectors) // 2 * 2 : 2]
    job = TogetherJob(seen, slice(0, len(_SAMPLE)), lines, count, positions, vectors)
    return all(compiled.written(job, said) == written(job, said) for said in (None, ("0", "0", "1")))


# --- Feed, spindle speed and dwell ----------------------------------------------------------------

_STATEMENT: Final = re.compile(
    r"[ \t]*(UNITS?|FEDRAT|SPINDL|DELAY|FINI)\b[ \t]*/?([^$\r\n]*)", re.ASCII | re.IGNORECASE
)
_UNITS: Final = {"MMPR": FeedUnit.TURN, "IPR": FeedUnit.TURN, "PERREV": FeedUnit.TURN, "INVERS": FeedUnit.INVERSE}
_SURFACE: Final = frozenset({"SFM", "SMM", "SURF"})


def line_words(text: str) -> LineWords:
    """Return what a line says."""
    match = _STATEMENT.match(text)
    if match is None:
        return NOTHING
    word, arguments = match[1].upper(), [part.strip().upper() for part in match[2].split(",")]
    numbers = [value for value in map(number, arguments) if value == value]
    first = numbers[0] if numbers else nan
    if word in ("UNIT", "UNITS"):
        return LineWords(inch=arguments[0].startswith("INCH"))
    if word == "DELAY":
        return LineWords(dwell_s=first)
    if word == "FEDRAT":
        unit = next((_UNITS[argument] for argument in arguments if argument in _UNITS), FeedUnit.MINUTE)
        inch, metric = (bool(set(arguments) & those) for those in ({"IPM", "IPR"}, {"MMPM", "MMPR"}))
        return LineWords(feed=first * (MM_PER_INCH if inch else 1.0), unit=unit, metric=inch or metric)
    if word == "FINI" or "OFF" in arguments:
        return LineWords(off_after=word == "FINI", turning=None if word == "FINI" else False)
    varying = next((argument for argument in arguments if argument in _SURFACE), None)
    return LineWords(speed_rpm=first if numbers else None, turning=True, varying=varying)


# --- Writer of APT statements: locations replaced, every other byte kept --------------------------

_EXPONENT: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)[EeDd][+-]?\d{1,3}", re.ASCII)


@final
class AptWriter:
    """Writer of statements that keeps track of the last tool vector."""

    def __init__(self, newline: str, together: Together) -> None:
        self.newline = newline
        self._together = together
        self._said: Said | None = vector_texts((0.0, 0.0, 1.0), VECTOR_DECIMALS, False)

    def unchanged(self, raw: str, *, tilts: bool) -> str:
        """Return a statement unchanged; ``tilts``: whether it has a tool vector."""
        if tilts:
            self._said = None
        return raw

    def location(self, statement: Statement, rewrite: Rewrite, rows: list[list[float]], unit: float) -> str:
        """Return the segments of a location; ``rows``: positions of its replacement as lists, ``unit``: mm per program unit."""
        raw, fields = statement.raw, statement.fields
        style = Style()
        decimals = [max(POSITION_DECIMALS, _decimals(text)) for _, _, text in fields[:3]]
        edits: list[tuple[int, int, str]] = []
        for (start, end, text), places, target in zip(fields, decimals, rows[0], strict=False):
            if target == target:
                style = style_of(text, style)
                if style.min_decimals != places or style.comma:
                    style = style._replace(min_decimals=places, comma=False)
                edits.append((start, end, format_number(target / unit, places, style)))
        vectors: list[list[float] | None] = [None] * len(rows) if rewrite.vectors is None else rewrite.vectors.tolist()
        written = len(fields) == 6
        texts = self._vector(vectors[0], again=written)
        if written:
            edits += [(start, end, text) for (start, end, _), text in zip(fields[3:], texts, strict=False)]
            self._said = self._said if texts else None
        elif texts:
            edits.append((fields[2].end, fields[2].end, f",{','.join(texts)}"))
        end_of_line = ending(raw)
        newline = end_of_line or self.newline
        lines = [apply_edits(raw, edits) + ("" if end_of_line or len(rows) == 1 else newline)]
        head = raw[: fields[0].start]
        goto = head if "$" not in head and statement.word == "GOTO" else "GOTO/"
        rapid = f"RAPID{newline}" if rewrite.move.kind is Kind.RAPID else ""
        for row, vector in zip(rows[1:], vectors[1:], strict=True):
            numbers = [
                format_number(target / unit, places, style._replace(min_decimals=places))
                for target, places in zip(row, decimals, strict=False)
            ]
            lines.append(f"{rapid}{goto}{','.join([*numbers, *self._vector(vector, again=False)])}{newline}")
        if not end_of_line and len(rows) > 1:
            lines[-1] = lines[-1].removesuffix(newline)
        return "".join(lines)

    def together(self, job: TogetherJob) -> str:
        """Return simple ``GOTO`` statements with new locations."""
        text, self._said = self._together(job, self._said)
        return text

    def _vector(self, vector: list[float] | None, *, again: bool) -> tuple[str, ...]:
        """Return the components of a tool vector, none if it is the last one written; ``again``: always."""
        if vector is None:
            return ()
        texts = vector_texts(vector, VECTOR_DECIMALS, False)
        new = again or texts != self._said
        self._said = texts
        return texts if new else ()


def _decimals(text: str) -> int:
    fraction = text.partition(".")[2]
    return min(MOST_DECIMALS, len(fraction)) if fraction.isdigit() or not _EXPONENT.fullmatch(text) else 0


# --- APT programs read and written: runs of simple ``GOTO`` statements together, all other statements one by one


@final
@dataclass(frozen=True)
class _Run:
    """Simple statements to process together: a range of lines with comments in between, and the indices of the statements in it."""

    chunk: Chunk
    begin: int
    end: int
    lines: np.ndarray


@final
class AptChunkReader(ChunkReader):
    """Reader of a program, chunk by chunk."""

    def __init__(self, source: str, axes: AxisWords) -> None:
        self._reader = AptReader(source, axes)
        super().__init__(self._reader)

    def read(self, chunk: Chunk) -> MoveColumns:
        """See `ChunkReader.read`."""
        reader, found = self._reader, MoveBuilder(self._reader.axes.names)
        for part in _parts(chunk, chunk.scan.simple, lambda: reader.alone):
            if isinstance(part, _Run):
                found.extend(reader.run(part.chunk.first + part.lines, locations(part.chunk.scan, part.lines)))
            elif (move := reader.step(part)) is not None:
                found.add(move)
        return found.moves()


@final
class AptChunkWriter(ChunkWriter):
    """Writer of a program with its moves replaced, and every other byte kept, chunk by chunk."""

    def __init__(self, source: str, axes: AxisWords, writer: AptWriter) -> None:
        self._reader = AptReader(source, axes)
        self._writer = writer
        self._circle: list[str] = []
        """An arc and the statements behind it, until the location where it ends."""
        self._record: Statement | None = None
        self._at: list[float] = [nan] * 3
        """The last location in the output, mm."""

    def write(self, chunk: Chunk, moves: MoveColumns, new: NewPositions) -> bytes:
        """See `ChunkWriter.write`."""
        reader, writer, out = self._reader, self._writer, list[str]()
        for part in _parts(chunk, _replaced_together(chunk, moves, new), lambda: False):
            if isinstance(part, _Run):
                lines, scanned = part.lines, part.chunk.scan
                reader.run(part.chunk.first + lines, locations(scanned, lines))
                which = np.searchsorted(moves.line, part.chunk.first + lines)
                rows = new.rows(which)
                whole = slice(int(scanned.start[part.begin]), int(scanned.end[part.end - 1]))
                positions, vectors = new.positions[rows] / reader.unit, new.vectors[rows]
                self._at = new.positions[rows][-1].tolist()
                out.append(writer.together(TogetherJob(scanned, whole, lines, new.count[which], positions, vectors)))
                continue
            moved = reader.step(part) is not None
            index = int(np.searchsorted(moves.line, part.line)) if moved else -1
            rewrite = new.of_move(index, moves[index]) if moved else None
            if moved and self._circle:
                out += self._arc(moves[index], rewrite)
                self._circle.clear()
            if moved:
                self._at = (moves.position[index] if rewrite is None else rewrite.positions[-1]).tolist()
            target = self._circle if part.word == "CIRCLE" or self._circle else out
            self._record = part if part.word == "CIRCLE" else self._record
            if rewrite is None:
                target.append(writer.unchanged(part.raw, tilts=moved and len(part.texts) == 6))
            else:
                out.append(writer.location(part, rewrite, rewrite.positions.tolist(), reader.unit))
        return "".join(out).encode("latin-1")

    def _arc(self, move: Move, rewrite: Rewrite | None) -> list[str]:
        """Return an arc and the statements behind it: as written, as a comment, or with the centre between its new ends."""
        circle, *others = self._circle
        if rewrite is None:
            return self._circle.copy()
        if not move.whole or move.arc is None or self._record is None:
            return [*(f"$$ {line}" for line in lines_in(circle.encode("latin-1"))), *others]
        a, b, c = move.arc.plane
        end = rewrite.positions[-1].tolist()
        here = (move.position[a], move.position[b])
        centre = dict(
            zip((a, b), moved_centre(move.arc, here, (self._at[a], self._at[b]), (end[a], end[b])), strict=True)
        )
        fields = self._record.fields
        centre[c] = number(fields[c].text) * self._reader.unit + end[c] - move.position[c]
        if any(value != value for value in centre.values()):
            what, line = "arc under cutter radius compensation from a position that is not known", self._record.line + 1
            expected, source = "a location before it", self._reader.source
            raise InputError(what, expected=expected, file=source, line=line, value=circle.strip())
        edits = []
        for axis, (start, stop, text) in enumerate(fields[:3]):
            places = max(POSITION_DECIMALS, _decimals(text))
            edits.append(
                (start, stop, format_number(centre[axis] / self._reader.unit, places, style_of(text, Style())))
            )
        return [apply_edits(circle, edits), *others]

    def end(self) -> bytes:
        """See `ChunkWriter.end`."""
        return "".join(self._circle).encode("latin-1")


@final
class AptPoster(ChunkWriter):
    """Writer of cutter locations as axis words of another language, chunk by chunk.

    It raises `ValueError` if a move has no new position or an unknown axis position (errors of the caller).
    """

    def __init__(self, source: str, program: NewProgram) -> None:
        self._source, self._program = source, program
        self._unit = 1.0
        program.start(source)

    def write(self, chunk: Chunk, moves: MoveColumns, new: NewPositions) -> bytes:
        """See `ChunkWriter.write`; raise `InputError` for an unknown location."""
        index_of = {line: index for index, line in enumerate(moves.line.tolist())}
        texts, at, writer = _texts(chunk), 0, self._program
        while at < len(texts):
            statement, at = statement_at(texts, at, chunk.first)
            if statement.line in index_of:
                index = index_of[statement.line]
                self._write_location(statement, moves[index], new.of_move(index, moves[index]))
            elif statement.word in ("UNIT", "UNITS"):
                inches = statement.arguments and statement.texts[0].upper().startswith("INCH")
                self._unit = MM_PER_INCH if inches else 1.0
            elif statement.word == "FEDRAT":
                words = line_words(f"FEDRAT/{statement.arguments}")
                writer.feed = _feed(words, self._unit, writer.feed)
                if words.unit is not FeedUnit.MINUTE:
                    writer.comment(" ".join(statement.raw.split()))
            elif statement.word in ("CIRCLE", "CUTCOM", "CYCLE") and _acts(statement):
                expected = "cutter locations of the tool centre, linearised by the CAM system, without cycles"
                raise self._error(statement, f"{statement.word} cannot be written as axis positions", expected)
            elif statement.word and statement.word not in ("RAPID", "FROM", "GOTO", "?"):
                writer.comment(" ".join(statement.raw.split()))
        return writer.taken()

    def _error(self, statement: Statement, what: str, expected: str) -> InputError:
        shown = statement.raw.strip()
        return InputError(what, expected=expected, file=self._source, line=statement.line + 1, value=shown)

    def _write_location(self, statement: Statement, move: Move, rewrite: Rewrite | None) -> None:
        if move.unknown:
            what = f"a location that cannot be posted: {move.unknown}"
            raise self._error(statement, what, "statements whose effect on the locations is known")
        if rewrite is None:
            raise ValueError(f"the move of line {move.line + 1} has no position")
        if not np.all(np.isfinite(rewrite.positions)):
            raise ValueError(f"the move of line {move.line + 1} has an unknown axis position")
        for row in rewrite.positions.tolist():
            self._program.move(row, rapid=move.kind is Kind.RAPID)

    def end(self) -> bytes:
        """See `ChunkWriter.end`."""
        self._program.finish()
        return self._program.taken()


def _acts(statement: Statement) -> bool:
    """Return whether a statement is an arc, or begins a cycle or cutter radius compensation."""
    if statement.word == "CUTCOM":
        return cuts_beside(statement)
    return not (statement.arguments and statement.texts[0].upper() in ("OFF", "NOMORE", "INIT"))


def _texts(chunk: Chunk) -> Sequence[str]:
    """Return the lines of a chunk, empty where they are deleted."""
    lines = Lines(chunk.scan.data)
    deleted = DELETED_LINE.encode("latin-1") in chunk.scan.data
    return [line.replace(DELETED_LINE, "") for line in lines] if deleted else lines


def _parts(chunk: Chunk, able: np.ndarray, alone: Callable[[], bool]) -> Iterator[_Run | Statement]:
    """Yield runs of statements to process together, and single statements, in order.

    ``able``: (lines,) which can be processed together; ``alone``: whether the next statement must be processed alone.
    """
    texts, at = _texts(chunk), 0
    for begin, end, long in runs(able, chunk.scan.blank):
        at = max(begin, at)
        lines = begin + np.flatnonzero(able[begin:end]) if long else np.zeros(0, dtype=int)
        while at < end:
            if lines.size and lines[-1] >= at and not alone():
                yield _Run(chunk, at, end, lines[lines >= at])
                at = end
            else:
                statement, at = statement_at(texts, at, chunk.first)
                yield statement


def _replaced_together(chunk: Chunk, moves: MoveColumns, new: NewPositions) -> np.ndarray:
    """Return (lines,) which statements of a chunk can be replaced together: feed moves in plain numbers, with a tool vector."""
    scanned, words = chunk.scan, chunk.scan.words
    part = slice(*np.searchsorted(moves.line, [chunk.first, chunk.first + len(chunk)]))
    able, straight = np.zeros(len(chunk), dtype=bool), np.ones(len(moves), dtype=bool)
    straight[list(moves.special)] = False
    able[moves.line[part] - chunk.first] = (new.count[part] > 0) & ~moves.rapid[part] & straight[part]
    rows = new.rows(np.arange(part.start, part.stop))
    if not (np.isfinite(new.positions[rows, :3]).all() and np.isfinite(new.vectors[rows]).all()):
        return np.zeros(len(chunk), dtype=bool)
    able[words.line[(words.axis < 3) & ((words.sign == ord("+")) | (words.whole == 0))]] = False
    return able & scanned.simple


_REMARK: Final = re.compile(r"[ \t]*+(?:\$\$[^\r\n]*+)?+[\r\n]*+", re.ASCII)
_LOCATION: Final = re.compile(r"[ \t]*+GOTO[ \t]*+/[ \t\d.,+-]++[\r\n]*+", re.ASCII | re.IGNORECASE)


_EVIDENCE: Final = line_pattern(
    r"(?:GOTO|FROM|GODLTA|CUTTER|LOADTL|LOAD|SPINDL|FEDRAT|COOLNT|UNITS|MULTAX|CUTCOM|PPRINT|PAINT|TLDATA|TOOL[ \t]++PATH|MSYS|MACHIN"
    r"|INTOL|OUTTOL|CYCLE|CIRCLE)[ \t]*+/",
    r"(?:PARTNO|FINI|END-OF-PATH)(?![\w/])",
    r"RAPID[ \t]*+(?:[\r\n]|\Z)",
    r"\$\$",
)
"""A statement of a program of cutter locations."""


@final
class Apt(Dialect):
    """APT cutter locations: tool-tip coordinates and tool vectors, independent of the machine's kinematics."""

    name = "apt"
    suffixes = PROGRAM_SUFFIXES["apt"]
    evidence = _EVIDENCE
    vector_decimals = VECTOR_DECIMALS
    linear_increment_mm = 1e-5
    cutter_locations = True

    def continues(self, text: str) -> bool:
        """See `Dialect.continues`."""
        return continues(text)

    def chunk(self, data: bytes, first: int, names: tuple[str, ...], code: LineCode) -> Chunk:
        """See `Dialect.chunk`."""
        return Chunk(data, first, names, code, scan)

    def reader(self, source: str, axes: AxisWords, *, tcp: bool) -> ChunkReader:
        """See `Dialect.reader`. Cutter locations are tool-tip coordinates whatever ``tcp`` says."""
        return AptChunkReader(source, axes)

    def rewriter(self, source: str, texts: Iterable[str], lines: int, axes: AxisWords, *, tcp: bool) -> ChunkWriter:
        """See `Dialect.rewriter`."""
        return AptChunkWriter(source, axes, AptWriter(newline_of(texts), together_code(lines)))

    def poster(self, source: str, axes: AxisWords, into: Dialect) -> ChunkWriter:
        """See `Dialect.poster`."""
        return AptPoster(source, into.new_program(axes))

    def with_comments(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.with_comments`: after ``PARTNO``."""
        lines = first_lines(text)
        at = place = 0
        while place < len(lines):
            statement, after = statement_at(lines, place)
            if statement.word == "PARTNO":
                at = after
            elif statement.word:
                break
            place = after
        return insert_comments(text, lines, at, comments, "$$ {}".format, _comment)

    def from_points(self, names: Sequence[str], points: np.ndarray, feed: float | None, remark: str, title: str) -> str:
        """See `Dialect.from_points`."""
        said = "" if feed is None else f"FEDRAT/{feed:g},MMPM\n"
        style = Style(min_decimals=5)
        rows = [",".join(format_number(value, 9, style) for value in row) for row in points.tolist()]
        return f"$$ {remark}\nUNITS/MM\n{said}" + "".join(f"GOTO/{row}\n" for row in rows) + "FINI\n"

    def line_words(self, text: str) -> LineWords:
        """See `Dialect.line_words`."""
        return line_words(text)

    def is_comment(self, text: str) -> bool:
        """See `Dialect.is_comment`."""
        return _REMARK.fullmatch(text) is not None

    def is_motion_only(self, text: str, names: tuple[str, ...]) -> bool:
        """See `Dialect.is_motion_only`."""
        return _LOCATION.fullmatch(text) is not None


def _feed(words: LineWords, unit: float, last: float) -> float:
    """Return the feed of a ``FEDRAT`` in mm/min; the last feed if it is not per minute, or no positive number."""
    if words.unit is not FeedUnit.MINUTE or words.feed is None or not words.feed > 0.0:
        return last
    return words.feed * (1.0 if words.metric else unit)


def _comment(line: str) -> str | None:
    """Return the text of a line that is a comment or blank; None for any other line."""
    body = line.strip()
    return body[2:].strip() if body.startswith("$$") else None if body else ""
