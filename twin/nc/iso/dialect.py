"""The ISO dialect (G-code)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.families import PROGRAM_SUFFIXES
from twin.nc.blocks import AxisWords, Kind, MoveColumns, NewPositions, Program
from twin.nc.chunks import (
    BlockReader,
    ChunkReader,
    ChunkRewriter,
    ChunkWriter,
    SimpleRun,
    only_places,
    replaces_some,
)
from twin.nc.dialect import NOTHING, Dialect, FeedUnit, LineWords, NewProgram, as_comment, points_words
from twin.nc.inline import Inliner
from twin.nc.iso import vocabulary
from twin.nc.iso.calls import IsoInliner
from twin.nc.iso.interpreter import RIGID, IsoInterpreter
from twin.nc.iso.writer import CODE, IsoWriter
from twin.nc.lines import ARRAYS, LineCode, line_code
from twin.nc.text import BOM, Style, first_lines, insert_comments, newline_of, number, style_in
from twin.nc.writer import Formatting, Segments

_UNITS: Final = {"93": FeedUnit.INVERSE, "94": FeedUnit.MINUTE, "95": FeedUnit.TURN}
_INCH: Final = {"20": True, "70": True, "700": True, "21": False, "71": False, "710": False}
_VARYING: Final = frozenset({"96", "961", "962"})
_SWITCHES: Final = {3: True, 4: True}
_OFF: Final = frozenset({2, 5, 30})
MILLISECONDS: Final = 100.0
"""Least whole number after P of a dwell that counts milliseconds; controls that count seconds do not wait that long."""


def _word(match: re.Match[str]) -> tuple[str, str]:
    """Return letter and value of a word, of ``S1=8000`` too; empty for any other token."""
    kind = match.lastgroup
    name, value = {"word": (2, 3), "given": (6, 8), "late": (14, 15)}.get(kind or "", (0, 0))
    letter = match[name].upper() if name else ""
    return (letter[:1], match[value]) if len(letter) == 1 or letter[1:].isdigit() else ("", "")


_OF_POSITIONS: Final = frozenset({"N", "F", "I", "J", "K", "R", "CR", "TURN", "A3", "B3", "C3"})


def _is_of_position(match: re.Match[str], axes: frozenset[str]) -> bool:
    """Return whether a token is the end of a line, or a word of a path or a feed with a number."""
    if match.lastgroup == "note":
        return not match["note"].strip()
    name, value = (match[2] or match[6] or "").upper(), match[3] or match[8] or ""
    if name == "G":
        return vocabulary.canonical(f"G{value}") in ("G0", "G1", "G2", "G3")
    return (name in axes or name in _OF_POSITIONS) and not math.isnan(number(value))


def _number(values: Mapping[str, str], name: str) -> float | None:
    return number(values[name]) if name in values else None


def _dwell(values: Mapping[str, str]) -> float:
    seconds = next((_number(values, name) for name in "FXU" if name in values), None)
    if seconds is not None:
        return seconds
    pause = _number(values, "P")
    if pause is None:
        return 0.0
    return pause / 1000.0 if "." not in values["P"] and pause >= MILLISECONDS else pause


# --- ISO programs processed in chunks (`twin.nc.chunks`) ------------------------------------

_LINE: Final = re.compile(rb"[^\r\n]*+(?:\r\n|\n|\r)")


@final
class IsoRewriter(ChunkRewriter):
    """Writer of a program, chunk by chunk."""

    def __init__(
        self, source: str, axes: AxisWords, newline: str, style: Style, *, tcp: bool, code: LineCode = ARRAYS
    ) -> None:
        self._interpreter = IsoInterpreter(source, axes, tcp=tcp)
        self._writer = IsoWriter(source, axes, newline, style)
        super().__init__(axes, self._interpreter, self._writer, code)

    def drill(
        self, drilled: Sequence[range], text_of: Callable[[int], str], moves: MoveColumns, new: NewPositions
    ) -> None:
        """See `ChunkWriter.drill`: cycles are expanded into blocks from the first part on in which a move of one is replaced."""
        writer = self._writer
        writer.expand_cycles = writer.expand_cycles or replaces_some(drilled, moves, new)
        writer.rigid_lines = _rigid_lines(text_of, drilled, moves) if writer.expand_cycles else frozenset()

    def line(self, line: int, text: str, segments: Mapping[int, Segments]) -> str:
        """See `ChunkRewriter.line`."""
        block = self._interpreter.step(line, text)
        return text if block is None else self._writer.block(line, block, segments)

    def formatting(self, run: SimpleRun) -> Formatting | None:
        """See `ChunkRewriter.formatting`."""
        writer, scan, lines = self._writer, run.scan, run.lines
        if self._interpreter.feed_mode == "93" or (scan.code[lines[0]] < 0 and writer.motion != run.motion[0]):
            return None
        if self._interpreter.cycle is not None and not self._drills_alike(run):
            return None
        writer.motion = int(run.motion[-1])
        return Formatting(writer.style, writer.spaced, writer.lower)

    def _drills_alike(self, run: SimpleRun) -> bool:
        """Return whether lines, one after the other, name places of holes, and every segment of a stroke moves."""
        writer, scan, lines, text = self._writer, run.scan, run.lines, run.scan.text
        if not writer.expand_cycles or not only_places(scan, lines, writer.linear - 1):
            return False
        first, second = scan.words.start[scan.first[lines]] - 1, scan.first[lines] + 1
        second = second[second < scan.first[lines + 1]]
        spaced = writer.spaced and np.all(text[scan.words.start[second] - 2] <= ord(" "))
        small = text[first] >= ord("a")
        alike = spaced and np.all(small == small[0])
        strokes = self._interpreter.strokes()
        moving = [stroke for stroke in strokes if stroke.height == stroke.height]
        if any(stroke.kept is not None for stroke in strokes):
            return False
        ends = bool(moving) and (moving[-1].kind is Kind.RAPID) == (run.motion[0] == 0)
        consecutive = (
            run.whole == slice(int(scan.start[lines[0]]), int(scan.end[lines[-1]]))
            and len(lines) == lines[-1] - lines[0] + 1
        )
        if not (alike and ends and consecutive and len(run.segments) == len(lines) * (1 + len(moving))):
            return False
        steps = np.rint(np.nan_to_num(run.targets) / self._grids.step)
        moved = (steps[1:] != steps[:-1]).any(axis=1)
        moved[np.cumsum(run.per_line)[:-1] - 1] = True
        return bool(moved.all())

    def written(self, run: SimpleRun, text: bytes, formatting: Formatting) -> bytes:
        """See `ChunkRewriter.written`."""
        self._writer.spaced = formatting.spaced
        coded = run.lines[run.scan.code[run.lines] >= 0]
        if coded.size:
            self._writer.wide = bool(run.scan.wide[coded[-1]])
        return text if self._interpreter.cycle is None else self._with_strokes(run, text)

    def _with_strokes(self, run: SimpleRun, text: bytes) -> bytes:
        """Return lines of holes whose strokes have been written as segments, with their motion words, feeds and blocks behind."""
        out = _LINE.findall(text)
        strokes = self._interpreter.strokes()
        moving = [stroke for stroke in strokes if stroke.height == stroke.height]
        codes = np.tile([int(run.motion[0]), *(CODE[stroke.kind] for stroke in moving)], len(run.lines))
        codes = np.repeat(codes, run.segments)
        for row in (np.flatnonzero(codes[1:] != codes[:-1]) + 1).tolist():
            out[row] = f"{self._writer.g(int(codes[row]))} ".encode("latin-1") + out[row]
        each, behind, place = 1 + len(moving), np.cumsum(run.segments), 0
        for stroke in strokes:
            place += stroke.height == stroke.height
            last = behind[place::each]
            for row in _ranges(last - run.segments[place::each], last) if stroke.feed else ():
                body = out[row].rstrip(b"\r\n")
                out[row] = body + f" {stroke.feed}".encode("latin-1") + out[row][len(body) :]
            for row in (last - 1).tolist() if stroke.after else ():
                end = out[row][len(out[row].rstrip(b"\r\n")) :]
                out[row] += stroke.after.encode("latin-1") + end
        return b"".join(out)


def _ranges(begin: np.ndarray, end: np.ndarray) -> Iterator[int]:
    """Yield the whole numbers of ranges."""
    for first, last in zip(begin.tolist(), end.tolist(), strict=True):
        yield from range(first, last)


_TAPE: Final = re.compile(
    r"%.*|\$[^=%\s]+%|;\$PATH=.*|PROC\b.*|<[^<>]*>|[O:][ \t]*\d+(?![\w.])(?![ \t]*(?:SUB|CALL|IF|DO|WHILE|REPEAT|RETURN)\b).*",
    re.IGNORECASE,
)
"""Lines that must stay first: tape mark, program number or name, ``PROC``."""
_NUMBER: Final = re.compile(r"[ \t]*(?:/\d?[ \t]*)?(?:N\d+[ \t]*)?", re.IGNORECASE)
_ROUND: Final = re.compile(rf"({vocabulary.NOTE})[ \t]*;?", re.ASCII)
_SIEMENS: Final = re.compile(
    r"%_N_|\b(?:TRAORI|TRAFOOF|SUPA|ORIWKS|ORIMKS|FGROUP|CYCLE\d+|PROC|MSG)\b|\$[APSM]\w*_|=[ \t]*(?:AC|IC|DC|ACP|ACN)[ \t]*\(",
    re.IGNORECASE,
)
_REMARK: Final = re.compile(
    rf"[ \t]*+(?:N\d++[ \t]*+)?+(?:{vocabulary.NOTE}[ \t]*+)*+(?:;[^\r\n]*+)?+[\r\n]*+", re.ASCII | re.I
)

_NOTE: Final = re.compile(rf"{vocabulary.NOTE}|;.*")
_TAPS: Final = re.compile(r"G0*(?:74|84)(?![\d.])", re.IGNORECASE)


@final
class Iso(Dialect):
    """G-code."""

    name = "iso"
    suffixes = PROGRAM_SUFFIXES["iso"]
    evidence = vocabulary.EVIDENCE
    has_increments = True

    def reader(self, source: str, axes: AxisWords, *, tcp: bool) -> ChunkReader:
        """See `Dialect.reader`."""
        return BlockReader(IsoInterpreter(source, axes, tcp=tcp))

    def rewriter(self, source: str, texts: Iterable[str], lines: int, axes: AxisWords, *, tcp: bool) -> ChunkWriter:
        """See `Dialect.rewriter`."""
        style, code = style_in(texts, Style(point=True)), line_code(lines)
        return IsoRewriter(source, axes, newline_of(texts), style, tcp=tcp, code=code)

    def inliner(self, program: Program, folders: Sequence[Path]) -> Inliner:
        """See `Dialect.inliner`."""
        return IsoInliner(program, folders)

    def with_comments(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.with_comments`: after tape mark and number, in round brackets, or after a semicolon as of a SINUMERIK."""
        lines = first_lines(text)
        at = place = 0
        while place < len(lines) and (_is_tape(lines[place]) or _comment(lines[place]) is not None):
            at = place + 1 if _is_tape(lines[place]) else at
            place += 1
        style = "; {}" if _uses_semicolon(lines) else "({})"
        return insert_comments(text, lines, at, comments, style.format, _comment)

    def from_points(self, names: Sequence[str], points: np.ndarray, feed: float | None, remark: str, title: str) -> str:
        """See `Dialect.from_points`."""
        first, *others = points_words(names, points, Style(point=True))
        said = "" if feed is None else f" F{feed:g}"
        body = "".join(f"{words}\n" for words in others)
        return f"%\n({remark})\nG21 G90 G94\nG1 {first}{said}\n{body}M30\n%\n"

    def is_comment(self, text: str) -> bool:
        """See `Dialect.is_comment`."""
        return _REMARK.fullmatch(text) is not None

    def follows(self, text: str) -> bool:
        """See `Dialect.follows`."""
        return vocabulary.SHAPING.match(text) is not None or self.is_comment(text)

    def is_motion_only(self, text: str, names: tuple[str, ...]) -> bool:
        """See `Dialect.is_motion_only`."""
        axes = frozenset(name.upper() for name in names)
        return all(_is_of_position(match, axes) for match in vocabulary.TOKEN.finditer(text))

    def line_words(self, text: str) -> LineWords:
        """See `Dialect.line_words`. A dwell (G4) has its time in F, X, U or P; revolutions (S) are not counted."""
        found = [_word(match) for match in vocabulary.TOKEN.finditer(text)]
        codes = [vocabulary.canonical(f"G{value}")[1:] for name, value in found if name == "G"]
        switches = [int(value) for name, value in found if name == "M" and value.isdigit()]
        values = dict(found)
        if "4" in codes:
            return LineWords(dwell_s=_dwell(values))
        words = LineWords(
            feed=_number(values, "F"),
            unit=next((_UNITS[code] for code in codes if code in _UNITS), None),
            inch=next((_INCH[code] for code in codes if code in _INCH), None),
            speed_rpm=_number(values, "S"),
            turning=next((_SWITCHES[code] for code in switches if code in _SWITCHES), None),
            off_after=any(code in _OFF for code in switches),
            varying=next((f"G{code}" for code in codes if code in _VARYING), None),
        )
        return NOTHING if words == NOTHING else words

    def new_program(self, axes: AxisWords) -> NewProgram:
        """See `Dialect.new_program`."""
        return _NewIso(axes, Style(point=True))


@final
class _NewIso(NewProgram):
    _code = -1

    def start(self, source: str) -> None:
        """See `NewProgram.start`."""
        self.out.append("%\n")
        self.comment(f"axis positions from cutter locations of {source}")
        self.out.append("G21 G90 G94\n")

    def comment(self, text: str) -> None:
        """See `NewProgram.comment`."""
        self.out.append(f"({as_comment(text, '()')})\n")

    def finish(self) -> None:
        """See `NewProgram.finish`."""
        self.out.append("M30\n%\n")

    def _block(self, words: list[str], rapid: bool, feed: str) -> None:
        code = 0 if rapid else 1
        head = [f"G{code}"] if code != self._code else []
        self._code = code
        self.out.append(" ".join([*head, *words, *([f"F{feed}"] if feed else [])]) + "\n")


def _rigid_lines(text_of: Callable[[int], str], drilled: Sequence[range], moves: MoveColumns) -> frozenset[int]:
    """Return the lines with M29 that belong to a thread of Fanuc: between the last move before it and its cycle."""
    rigid_lines = []
    for part in drilled:
        if _TAPS.search(_NOTE.sub(" ", text_of(part.start))):
            before = int(np.searchsorted(moves.line, part.start))
            first = int(moves.line[before - 1]) + 1 if before else 0
            rigid_lines += [
                line for line in range(first, part.start + 1) if RIGID.search(_NOTE.sub(" ", text_of(line)))
            ]
    return frozenset(rigid_lines)


def _is_tape(line: str) -> bool:
    return _TAPE.match(line.removeprefix(BOM).strip()) is not None


def _bare(line: str) -> str:
    """Return a line without its skip mark and number."""
    return line[_NUMBER.match(line).end() :].strip()  # type: ignore[union-attr]  # it matches anything


def _comment(line: str) -> str | None:
    """Return the text of a line that is a comment or blank; None for any other line."""
    body = _bare(line.removeprefix(BOM))
    if body.startswith(";"):
        return body[1:].strip()
    if not body:
        return ""
    match = _ROUND.fullmatch(body)
    return None if match is None else match.group(1)[1:-1].strip()


def _uses_semicolon(lines: Sequence[str]) -> bool:
    if any(map(_SIEMENS.search, lines)):
        return True
    for body in map(_bare, lines):
        if body.startswith("("):
            return False
        # A semicolon at the end of a line ends a block; followed by text, it begins a comment.
        if body.partition(";")[2].strip():
            return True
    return False
