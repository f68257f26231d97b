"""The Heidenhain plain-language dialect."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import nan
from pathlib import Path
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.families import PROGRAM_SUFFIXES
from twin.nc.blocks import AxisWords, Kind, Move, MoveColumns, NewPositions, Program, Rewrite
from twin.nc.chunks import BlockReader, Chunk, ChunkReader, ChunkRewriter, ChunkWriter, SimpleRun
from twin.nc.dialect import NOTHING, Dialect, FeedUnit, LineWords, NewProgram, as_comment, points_words
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.calls import HeidenhainInliner, scan
from twin.nc.heidenhain.interpreter import HeidenhainInterpreter
from twin.nc.heidenhain.modal import Cycle, CycleCall, PathBlock
from twin.nc.heidenhain.vocabulary import HEAD, UNNUMBERED, numbered_as, renumbered, with_continued_marked
from twin.nc.inline import Inliner
from twin.nc.lines import LineCode, line_code
from twin.nc.text import (
    MM_PER_INCH,
    SAME_MM,
    Style,
    apply_edits,
    ending,
    first_lines,
    format_number,
    insert_comments,
    missing_comments,
    newline_of,
    number,
    style_in,
)
from twin.nc.writer import Edit, Formatting, Segments, WordWriter, drop, length_text, vector_texts

_ASIDE: Final = re.compile(r"\"[^\"]*\"|;.*", re.ASCII)
_VALUE: Final = r"[+-]?[ \t]*[\d.,]+"
_FEED: Final = re.compile(rf"(?<![A-Z\d])F[ \t]*(?:MAX|(U)?[ \t]*({_VALUE})|([A-Z]))", re.ASCII | re.IGNORECASE)
_MISC: Final = re.compile(r"(?<![A-Z\d])M(\d+)", re.ASCII | re.IGNORECASE)
_TOOL: Final = re.compile(rf"TOOL[ \t]+CALL\b.*?[ \t]S[ \t]*(?:({_VALUE})|([A-Z]))", re.ASCII | re.IGNORECASE)
_DWELL: Final = re.compile(rf"CYCLE?[ \t]+DEF[ \t]+9\.1[ \t]+\D*({_VALUE})", re.ASCII | re.IGNORECASE)
_SPEED: Final = re.compile(
    rf"[ \t]*(?:N?\d+[ \t]*)?(?:LN?|CR?|M\d+\.?|I?[A-CU-Z][ \t]*{_VALUE})[ \t].*?(?<![A-Z\d])S[ \t]*({_VALUE})",
    re.ASCII | re.IGNORECASE,
)
_UNIT: Final = re.compile(r"BEGIN[ \t]+PGM\b.*[ \t](MM|INCH|IN)[ \t]*[\r\n]*$", re.ASCII | re.IGNORECASE)
_TURNING: Final = frozenset({3, 4, 13, 14})
_OFF: Final = frozenset({2, 5, 30})
_UNITS: Final = {136: FeedUnit.TURN, 137: FeedUnit.MINUTE}


# --- Writer of Heidenhain blocks: moves replaced, every other byte kept ---------------------------

VECTOR_DECIMALS = 7
_BARE: Final = re.compile(
    r"[ \t]*(?:L\b)?(?:[ \t]*(?:R0|F[ \t]*MAX))*[ \t]*(?:;[^\r\n]*)?[\r\n]*", re.ASCII | re.IGNORECASE
)
"""A block without an effect of its own."""
_LEADS_ABOUT_POLE: Final = re.compile(r"(?<=[ \t])[Pp](?=[A-Za-z])")
_M_WORD: Final = re.compile(r"(?<![A-Z\d])M\d+", re.ASCII | re.IGNORECASE)


@final
class HeidenhainWriter(WordWriter[PathBlock]):
    """Writer of a program block by block that keeps track of the values written.

    ``inserted``: whether lines have been inserted among numbered blocks; ``own_calls``: whether calls of cycles are written out, each
    with its approach; if not, none of their moves may be replaced.
    """

    equals = ""
    signed = True
    inserted = False
    own_calls = False
    _defined: tuple[Cycle | None, Mapping[str, str]] = (None, MappingProxyType({}))
    """The cycle defined last in the output, and its heights where they differ from the program's."""

    def block(self, block: PathBlock, segments: Mapping[int, Segments]) -> str:
        """Return the output for one block; ``segments``: replacements of its moves, by the index of the move in the block."""
        if block.unknown_axes:
            self.said.mark_unknown(block.unknown_axes)
        if block.tcp_switched:
            self._vector_text = None
        lines = self._positioned(block, segments.get(0)) if block.moves and block.positions else None
        if block.places:
            called = self._called(block, segments)
            lines = [self._without_call(block)] if lines is None else lines
            after = block.positions or block.calls or block.pattern
            lines = [*lines, *called] if after else [*called, *lines]
            if not ending(lines[0]) and len(lines) > 1:
                lines[0] += self.newline
        elif block.replaced and self.own_calls:
            lines = [self._without_call(block)]
        lines = [block.text] if lines is None else lines
        self.inserted |= bool(block.numbered or block.head.strip()) and len(lines) > 1
        return "".join(lines)

    def _positioned(self, block: PathBlock, segments: Segments | None) -> list[str]:
        """Return the lines for a block with its own move, which is replaced if there are segments for it."""
        if segments is None:
            self.record(block)
            return [self._without_call(block)]
        if block.words:
            self.lower = block.text[block.words[-1].value_start - 1].islower()
        self._pole: list[str] = []
        if block.polar:  # both axes are written, also where the block moves nothing
            arc = segments[0].move.arc
            self.said.mark_stale(range(self.linear) if arc is None else arc.plane[:2])
        lines = self.rewritten(block, segments)
        if block.unknown_axes and not block.tcp_switched:
            self.said.mark_unknown(block.unknown_axes)
        return [*self._pole, *lines]

    def _without_call(self, block: PathBlock) -> str:
        """Return a block without the words that call a cycle, if calls are written out; one with nothing else as a comment."""
        if self.own_calls and block.replaced:
            return self._as_remark(block)
        if not (self.own_calls and block.call_words):
            return block.text
        edits: list[Edit] = []
        drop(block, block.call_words, edits)
        text, head = apply_edits(block.text, edits), block.text[: block.head_end]
        if block.words or not _BARE.fullmatch(text[len(head.rstrip()) :]):
            return text
        return f"{head}; {block.text[block.head_end :].strip()}{ending(text)}"

    def _as_remark(self, block: PathBlock) -> str:
        """Return a line whose calls are written out as a comment, followed by its M functions."""
        head, body = block.text[: block.head_end], block.text[block.head_end :].strip()
        end = ending(block.text) or self.newline
        words = (
            _M_WORD.findall(body.partition(";")[0])
            if block.pattern and vocabulary.CYCLE_CALL.match(body.upper())
            else []
        )
        lines = [f"{head}; {as_comment(body, '~')}", *([f"{block.indent}{' '.join(words)}"] if words else [])]
        return end.join(lines) + ending(block.text)

    def _called(self, block: PathBlock, segments: Mapping[int, Segments]) -> list[str]:
        """Return for each call its approach, its definition if the surface has a new correction, and the call; nothing if they stay."""
        last = block.places[-1]
        if not self.own_calls:
            if block.pattern:
                for axis, value in enumerate(block.moves[-1].position):
                    self.said.record(axis, value, False)
            self.said.record(last.axis, last.level, False)
            return []
        end = ending(block.text) or self.newline
        indent, lines = block.indent, list[str]()
        place = 1 if block.positions else 0
        for call in block.places:
            for at in range(place, call.moves):
                for row in segments[at][1] if at in segments else [list(block.moves[at].position)]:
                    # Rounding may have left no way to go.
                    words = self._missing(block, row, 0) or [self._added(block, call.axis, row[call.axis])]
                    lines.append(f"{indent}L {' '.join(words)} R0 FMAX{end}")
            place = max(place, call.moves)
            shift = self.said.value[call.axis] - call.top
            level = call.level + shift
            if call.surface == call.surface:
                self.said.number_for(call.axis, level, block.inch, False, self.style)
                level = self.said.value[call.axis] if call.level > call.top else level
                lines += self._definition(block, call, shift, level, indent, end)
            self.said.record(call.axis, level, False)
            if block.positions or block.calls or block.pattern:
                lines.append(f"{indent}CYCL CALL{end}")
        return lines

    def _definition(
        self, block: PathBlock, call: CycleCall, shift: float, level: float, indent: str, end: str
    ) -> list[str]:
        """Return the definition of a cycle with the surface shifted, none if it is in force; ``level``: the height at which it ends."""
        unit, surface = MM_PER_INCH if block.inch else 1.0, call.surface + shift
        # The surface is not rounded, so that it is the clearance below the height reached.
        new = {"Q203": format_number(surface / unit, 9, self.style)} if abs(surface - call.defined) > 1e-9 else {}
        if abs(call.level + shift - level) > SAME_MM:
            new["Q204"] = format_number((level - surface) / unit, 9, self.style)
        values = {**dict(call.texts), **new}
        cycle, before = self._defined
        if values == (before if cycle is call.cycle else {}):
            return []
        self._defined = call.cycle, values
        first, *others = call.cycle.lines(values)
        return [f"{indent}{first}{end}", *(f"{UNNUMBERED}  {line}{end}" for line in others)]

    def _begin(self, block: PathBlock, rewrite: Rewrite, edits: list[Edit]) -> str:
        keyword = block.text[block.head_end : block.keyword_end]
        if self.own_calls:
            drop(block, block.call_words, edits)
        drop(block, block.polar_words, edits)
        if block.polar and block.leads:
            keyword = _LEADS_ABOUT_POLE.sub("", keyword)
        elif block.polar and rewrite.move.kind is Kind.ARC and rewrite.move.whole:
            keyword = "c" if keyword.islower() else "C"
        elif block.polar or (rewrite.move.kind is Kind.ARC and not rewrite.move.whole):
            keyword = "l" if keyword.islower() else "L"
        return keyword

    def _insert(self, block: PathBlock, begin: str, added: list[str], tool: list[str], edits: list[Edit]) -> str:
        text = block.text
        if tool and begin.upper() == "L":  # only LN blocks take a vector
            begin = "ln" if begin.islower() else "LN"
        if block.keyword and begin != text[block.head_end : block.keyword_end]:
            edits.append((block.head_end, block.keyword_end, begin))
        words = " ".join(added + tool)
        if words:
            at = max((word.end for word in block.words), default=block.keyword_end)
            if block.keyword or block.words:
                edits.append((at, at, f" {words}"))
            else:
                edits.append((at, at, f"L {words} "))
            if not block.keyword and block.words:
                edits.append((block.head_end, block.head_end, "L "))  # a paraxial block moves one axis only
        return f"{block.indent}{begin if block.keyword else 'L'} "

    def record(self, block: PathBlock) -> None:
        """See `WordWriter.record`: a block about the pole, too, says where it ends."""
        super().record(block)
        move = block.moves[0]
        for axis, name in enumerate(self.names if block.polar and not move.passes else ()):
            if name in move.named and not block.axis_bits >> axis & 1:
                self.said.record(axis, move.position[axis], False)

    def _bent(self, block: PathBlock, move: Move, start: list[float], end: list[float], edits: list[Edit]) -> list[str]:
        """Give ``CR`` its new radius; write the new pole before ``C``, and ``CP``, which becomes one."""
        a, b, _ = move.arc.plane  # type: ignore[union-attr]  # asked for arcs only
        centre = self._new_centre(block, move, start, end)
        if block.keyword == "CR":
            radius = math.hypot(start[a] - centre[0], start[b] - centre[1])
            over = abs(move.arc.angle_rad) > math.pi + 1e-9  # type: ignore[union-attr]
            span = next(span for span in block.arc_words if "D" not in block.text[span.start : span.end].upper())
            text = self._length(-radius if over else radius, block, a, up=True)
            edits.append((span.start, span.end, f"R{text}"))
            return []
        end_of_line = ending(block.text) or self.newline
        indent = block.indent
        words = [
            self.names[axis] + self._length(value, block, axis) for axis, value in zip((a, b), centre, strict=True)
        ]
        self._pole = [f"{indent}CC {' '.join(words)}{end_of_line}"]
        return []

    def _length(self, value: float, block: PathBlock, axis: int, *, up: bool = False) -> str:
        """Return a length in the format of the program, rounded to the increment of an axis, ``up`` away from zero."""
        return length_text(value, float(self.grids.step[axis]), block.inch, self.style._replace(plus=True), up=up)

    def _tails(self, block: PathBlock, rewrite: Rewrite, edits: list[Edit]) -> list[str]:
        return [block.rapid_text] * len(rewrite.positions) if block.rapid_text else []

    def _later(self, block: PathBlock, row: list[float], vector: list[float] | None) -> list[str]:
        words = self._missing(block, row, 0)
        if vector is not None:
            before = self._vector_text
            if block.keyword == "LN":
                self._vector_text = None  # an LN block has its vectors in full
            tool = self._vector(block, vector, None)
            if words or self._vector_text != before:
                words += [*block.normal_text, *tool]
        return words

    def _vector_words(self, vector: list[float]) -> tuple[str, str, str]:
        x, y, z = vector_texts(vector, VECTOR_DECIMALS, True)
        return (x.replace(".", ","), y.replace(".", ","), z.replace(".", ",")) if self.style.comma else (x, y, z)

    def _vector_names(self, block: PathBlock) -> tuple[str, ...]:
        return ("TX", "TY", "TZ")


# --- Heidenhain programs written in chunks (`twin.nc.chunks`), with blocks renumbered where lines were inserted

_SPLIT: Final = re.compile(
    rb"(?:\A|(?<=[\r\n]))([ \t]*+(?:\d++[ \t]*+)?+L)([ \t][^\r\n]*+)(\r\n|\n|\r)((?:[A-CU-Za-cu-z][^\r\n]*+(?:\r\n|\n|\r))++)"
)
"""An L block followed by the words of further segments, each in a line that begins with an axis."""
_RAPID: Final = re.compile(rb"[ \t]FMAX(?=[ \t]|\Z)")
_SEGMENT: Final = re.compile(rb"([^\r\n]++)([\r\n]++)")


@final
class HeidenhainRewriter(ChunkRewriter):
    """Writer of a program, chunk by chunk."""

    def __init__(self, source: str, axes: AxisWords, newline: str, style: Style, *, tcp: bool, code: LineCode) -> None:
        self._interpreter = HeidenhainInterpreter(source, axes, tcp=tcp)
        self._writer = HeidenhainWriter(source, axes, newline, style)
        self._comma = False
        super().__init__(axes, self._interpreter, self._writer, code)

    def drill(
        self, drilled: Sequence[range], text_of: Callable[[int], str], moves: MoveColumns, new: NewPositions
    ) -> None:
        """See `ChunkWriter.drill`: calls of cycles are written out from the first part with one on in which a move is replaced."""
        self._writer.own_calls |= bool(drilled) and bool(new.count.any())

    def finished(self, text: str) -> str:
        """See `ChunkWriter.finished`."""
        if not self._writer.inserted:
            return text.replace(UNNUMBERED, "")
        return renumbered(text, lambda old: itertools.count(int(old[0][:15])) if old else ())

    def line(self, line: int, text: str, segments: Mapping[int, Segments]) -> str:
        """See `ChunkRewriter.line`."""
        continued = self._interpreter.continued
        move: Move | None = segments[0][0].move if segments else None
        written = self._writer.block(self._interpreter.step(line, text, move), segments)
        return f"{UNNUMBERED}{written}" if continued else written

    def formatting(self, run: SimpleRun) -> Formatting | None:
        """See `ChunkRewriter.formatting`. Lines with decimal commas are written as if with points: None if both occur."""
        data, style = run.scan.data[run.whole], self._writer.style
        if (b"." if style.comma else b",") in data:
            return None
        self._comma = style.comma
        return Formatting(style, True, False)

    def written(self, run: SimpleRun, text: bytes, formatting: Formatting) -> bytes:
        """See `ChunkRewriter.written`."""
        if run.per_line.max() > 1:
            text = _SPLIT.sub(self._segments, text)
        if self._comma:
            text = text.replace(b".", b",")
            self._writer.style = formatting.style._replace(comma=True)
        return text

    def _segments(self, match: re.Match[bytes]) -> bytes:
        """Return the blocks of a move with the beginning of the first one repeated in the others, and so ``FMAX``."""
        head, words, end, others = match.groups()
        self._writer.inserted |= head.strip() != b"L"
        tail = rb" FMAX\2" if _RAPID.search(words) else rb"\2"
        return head + words + end + _SEGMENT.sub(head + rb" \1" + tail, others)


_REMARK: Final = re.compile(r"[ \t]*+(?:\d++[ \t]*+)?+(?:[;*][^\r\n~]*+)?+[\r\n]*+", re.ASCII)


@final
class Heidenhain(Dialect):
    """Heidenhain plain language."""

    name = "heidenhain"
    suffixes = PROGRAM_SUFFIXES["heidenhain"]
    evidence = vocabulary.EVIDENCE
    opening = vocabulary.OPENING
    numbers_lines = True

    def chunk(self, data: bytes, first: int, names: tuple[str, ...], code: LineCode) -> Chunk:
        """See `Dialect.chunk`."""
        return Chunk(data, first, names, code, scan)

    def reader(self, source: str, axes: AxisWords, *, tcp: bool) -> ChunkReader:
        """See `Dialect.reader`."""
        return BlockReader(HeidenhainInterpreter(source, axes, tcp=tcp))

    def rewriter(self, source: str, texts: Iterable[str], lines: int, axes: AxisWords, *, tcp: bool) -> ChunkWriter:
        """See `Dialect.rewriter`."""
        style, code = style_in(texts, Style(plus=True)), line_code(lines)
        return HeidenhainRewriter(source, axes, newline_of(texts), style, tcp=tcp, code=code)

    def inliner(self, program: Program, folders: Sequence[Path]) -> Inliner:
        """See `Dialect.inliner`."""
        return HeidenhainInliner(program, folders)

    def expanded(self, program: Program, folders: Sequence[Path]) -> Program:
        """See `Dialect.expanded`. Consecutive block numbers are renewed."""
        expanded = super().expanded(program, folders)
        if expanded is program:
            return program
        first = _first_number(program)
        return expanded if first is None else replace(expanded, texts=tuple(_consecutive(expanded.texts, first)))

    def with_comments(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.with_comments`: after ``BEGIN PGM``; the numbers of later blocks increase by the number of comments."""
        lines = first_lines(text)
        at = next((i + 1 for i, line in enumerate(lines) if _body(line).upper().split()[:2] == ["BEGIN", "PGM"]), 0)
        number = None if at == 0 else HEAD.match(lines[at - 1])
        if number is None or number.group(1) is None:
            return insert_comments(text, lines, at, comments, "; {}".format, _comment)
        first = int(number.group(1)[:15]) + 1
        new = missing_comments(lines[at:], comments, _comment)
        return insert_comments(
            text,
            lines,
            at,
            comments,
            lambda line: f"{first + new.index(line)} ; {line}",
            _comment,
            lambda rest: renumbered(
                with_continued_marked(rest), lambda old: [int(number[:15]) + len(new) for number in old]
            ),
        )

    def from_points(self, names: Sequence[str], points: np.ndarray, feed: float | None, remark: str, title: str) -> str:
        """See `Dialect.from_points`."""
        program = re.sub(r"\W", "_", title, flags=re.ASCII).upper() or "POINTS"
        rows = [f"L {words}" for words in points_words(names, points, Style(plus=True))]
        rows[0] += "" if feed is None else f" R0 F{feed:g}"
        lines = [f"BEGIN PGM {program} MM", f"; {remark}", *rows, "M30", f"END PGM {program} MM"]
        return "".join(f"{i} {line}\n" for i, line in enumerate(lines))

    def is_comment(self, text: str) -> bool:
        """See `Dialect.is_comment`."""
        return _REMARK.fullmatch(text) is not None

    def follows(self, text: str) -> bool:
        """See `Dialect.follows`."""
        return vocabulary.SHAPING.match(text) is not None or self.is_comment(text)

    def is_motion_only(self, text: str, names: tuple[str, ...]) -> bool:
        """See `Dialect.is_motion_only`."""
        return vocabulary.simple_pattern(names).pattern.fullmatch(text) is not None

    def line_words(self, text: str) -> LineWords:
        """See `Dialect.line_words`. A feed per tooth, an automatic feed and a Q parameter are not a number."""
        bare = _ASIDE.sub(" ", text)
        if (dwell := _DWELL.search(bare)) is not None:
            return LineWords(dwell_s=number(dwell[1]))
        if (unit := _UNIT.search(bare)) is not None:
            return LineWords(inch=unit[1].upper() in vocabulary.INCHES)
        codes = [int(code) for code in _MISC.findall(bare)]
        feed = next((match for match in _FEED.finditer(bare) if match[2] or match[3]), None)
        tool = _TOOL.search(bare) or _SPEED.match(bare)
        words = LineWords(
            feed=None if feed is None else number(feed[2]) if feed[2] else nan,
            unit=FeedUnit.TURN
            if feed is not None and feed[1]
            else next((_UNITS[code] for code in codes if code in _UNITS), None),
            speed_rpm=None if tool is None else number(tool[1]) if tool[1] else nan,
            turning=True if _TURNING & set(codes) else None,
            off_after=bool(_OFF & set(codes)),
        )
        return NOTHING if words == NOTHING else words

    def renumbered(self, program: Program, text: str) -> str:
        """See `Dialect.renumbered`."""
        first = _first_number(program)
        if first is None:
            return text
        return "".join(_consecutive(self.read(text.encode("latin-1"), program.source).texts, first))

    def new_program(self, axes: AxisWords) -> NewProgram:
        """See `Dialect.new_program`."""
        return _NewHeidenhain(axes, Style(plus=True))


@final
class _NewHeidenhain(NewProgram):
    _title = "PROGRAM"
    _number = 0

    def start(self, source: str) -> None:
        """See `NewProgram.start`."""
        stem = source.replace("\\", "/").rpartition("/")[2].partition(".")[0]
        title = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in stem).upper()
        self._title = title or self._title
        self._line(f"BEGIN PGM {self._title} MM")
        self.comment(f"axis positions from cutter locations of {source}")

    def comment(self, text: str) -> None:
        """See `NewProgram.comment`."""
        self._line(f"; {as_comment(text, '~')}")

    def finish(self) -> None:
        """See `NewProgram.finish`."""
        self._line("M30")
        self._line(f"END PGM {self._title} MM")

    def _block(self, words: list[str], rapid: bool, feed: str) -> None:
        end = ["R0", "FMAX"] if rapid else ["R0", f"F{feed}"] if feed else []
        self._line(" ".join(["L", *words, *end]))

    def _line(self, text: str) -> None:
        self.out.append(f"{self._number} {text}\n")
        self._number += 1


def _consecutive(lines: Iterable[str], first: int) -> Iterator[str]:
    """Yield lines with their blocks numbered consecutively."""
    for line in lines:
        head = HEAD.match(line)
        if head is not None and head[1]:
            line = numbered_as(line, head, first)
            first += 1
        yield line


def _body(line: str) -> str:
    head = HEAD.match(line)
    return line[0 if head is None else head.end() :].strip()


def _comment(line: str) -> str | None:
    """Return the text of a line that is a comment or blank; None for any other line."""
    body = _body(line)
    return body[1:].strip() if body.startswith(";") else None if body else ""


def _first_number(program: Program) -> int | None:
    """Return the first block number of a program, None if its numbers are not consecutive."""
    numbers = [int(head[1][:15]) for head in map(HEAD.match, program.texts) if head is not None and head[1]]
    consecutive = bool(numbers) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    return numbers[0] if consecutive else None
