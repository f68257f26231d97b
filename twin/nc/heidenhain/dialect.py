"""The Heidenhain plain-language dialect."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import PROGRAM_SUFFIXES
from twin.nc.blocks import AxisWords, Interpretation, Notice, Program
from twin.nc.columns import NewPositions, as_columns
from twin.nc.dialect import Dialect, NewProgram, as_comment, points_words
from twin.nc.header import first_lines, insert_comments, missing_comments
from twin.nc.heidenhain import vocabulary
from twin.nc.heidenhain.calls import HeidenhainInliner
from twin.nc.heidenhain.interpreter import HeidenhainInterpreter
from twin.nc.heidenhain.lines import scan
from twin.nc.heidenhain.rewriter import HeidenhainRewriter
from twin.nc.heidenhain.technology import line_words
from twin.nc.heidenhain.vocabulary import HEAD, numbered_as, renumbered, with_continued_marked
from twin.nc.lines.chunks import ChunkReader, chunks
from twin.nc.lines.compiled import line_code
from twin.nc.technology import LineWords
from twin.nc.text import Style, newline_of, style_in

_REMARK: Final = re.compile(r"[ \t]*+(?:\d++[ \t]*+)?+(?:[;*][^\r\n~]*+)?+[\r\n]*+", re.ASCII)


LONGEST_TURN_DEG: Final = 180.5
"""Turn of a rotary axis up to which its shortest way is that of its words; a correction may turn half a turn a little further."""


@final
class Heidenhain(Dialect):
    """Heidenhain plain language."""

    name = "heidenhain"
    suffixes = PROGRAM_SUFFIXES["heidenhain"]
    shared_suffixes = (".txt",)
    begins = re.compile(rb"\s*\d*\s*BEGIN\s+PGM\s", re.IGNORECASE)

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Interpretation:
        """See `Dialect.moves`."""
        interpreter = HeidenhainInterpreter(program.source, axes, tcp=tcp)
        reading = ChunkReader(interpreter).whole(chunks(program, axes.names, scan))
        return _without_long_ways(program, axes, reading, interpreter.shortest_way)

    def rewrite(self, program: Program, axes: AxisWords, reading: Interpretation, new: NewPositions) -> str:
        """See `Dialect.rewrite`."""
        moves = as_columns(axes.names, reading.moves)
        if not np.any(new.count):
            return program.text
        style = style_in(program.texts, Style(plus=True))
        code = line_code(len(program.texts))
        newline, tcp = newline_of(program), bool(moves.tcp[0])
        rewriter = HeidenhainRewriter(program.source, axes, newline, style, tcp=tcp, code=code)
        return rewriter.whole(chunks(program, axes.names, scan), moves, new)

    def expanded(self, program: Program, folder: Path | None) -> Program:
        """See `Dialect.expanded`. Consecutive block numbers are renewed."""
        found = HeidenhainInliner(program, folder).expanded()
        if found is program:
            return program
        first = _first_number(program)
        return found if first is None else replace(found, texts=tuple(_consecutive(found.texts, first)))

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

    def is_motion_only(self, text: str, names: tuple[str, ...]) -> bool:
        """See `Dialect.is_motion_only`."""
        return vocabulary.simple_pattern(names).pattern.fullmatch(text) is not None

    def line_words(self, text: str) -> LineWords:
        """See `Dialect.line_words`."""
        return line_words(text)

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
        self.out.append(f"{len(self.out)} {text}\n")


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


def _without_long_ways(
    program: Program, axes: AxisWords, reading: Interpretation, shortest_way: Sequence[tuple[int, bool]]
) -> Interpretation:
    """Return a reading with a notice on rapids on which ``M126`` turns a rotary axis in the opposite direction.

    Args:
        program: the program.
        axes: axis words.
        reading: its moves.
        shortest_way: lines of ``M126`` (True) and ``M127``, in order.

    Raises:
        InputError: a feed that it turns so: the blocks that it is split into would turn the axis the long way.
    """
    if not shortest_way:
        return reading
    moves, linear = as_columns(axes.names, reading.moves), len(axes.linear)
    lines, on = (np.array(column) for column in zip(*shortest_way, strict=True))
    last = np.searchsorted(lines, moves.line, side="right") - 1
    in_force = (last >= 0) & on[last]
    turn = np.abs(np.diff(moves.position[:, linear:], axis=0, prepend=np.nan))
    far = np.flatnonzero((turn > LONGEST_TURN_DEG).any(axis=1) & in_force)
    fed = far[~moves.rapid[far]]
    if fed.size:
        raise InputError(
            "a rotary axis turns by more than half a turn, or in the opposite direction (M126)",
            expected="M127, or positions within half a turn of each other, such as C+370 after C+350",
            file=program.source,
            line=int(moves.line[fed[0]]) + 1,
            value=program.texts[moves.line[fed[0]]].strip(),
        )
    text = "M126: a rotary axis turns in the opposite direction on this rapid; its end point is the same"
    notices = [Notice(int(line), text) for line in moves.line[far]]
    return replace(reading, notices=(*reading.notices, *notices))
