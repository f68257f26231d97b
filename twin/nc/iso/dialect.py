"""The ISO dialect (G-code)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

import numpy as np

from twin._common.families import PROGRAM_SUFFIXES
from twin.nc.blocks import AxisWords, Interpretation, Program
from twin.nc.columns import MoveColumns, NewPositions, as_columns
from twin.nc.dialect import Dialect, NewProgram, as_comment, points_words
from twin.nc.header import first_lines, insert_comments
from twin.nc.iso import vocabulary
from twin.nc.iso.calls import IsoInliner
from twin.nc.iso.stream import IsoRewriter, iso_reader
from twin.nc.iso.technology import line_words
from twin.nc.lines.chunks import chunks
from twin.nc.lines.compiled import line_code
from twin.nc.technology import LineWords
from twin.nc.text import BOM, Style, newline_of, style_in

_TAPE: Final = re.compile(
    r"%.*|;\$PATH=.*|PROC\b.*|<[^<>]*>|[O:][ \t]*\d+(?![\w.])(?![ \t]*(?:SUB|CALL|IF|DO|WHILE|REPEAT|RETURN)\b).*",
    re.IGNORECASE,
)
"""Lines that must stay first: tape mark, program number or name, ``PROC``."""
_NUMBER: Final = re.compile(r"[ \t]*(?:/\d?[ \t]*)?(?:N\d+[ \t]*)?", re.IGNORECASE)
_ROUND: Final = re.compile(r"\(([^()]*)\)[ \t]*;?")
_SIEMENS: Final = re.compile(
    r"%_N_|\b(?:TRAORI|TRAFOOF|SUPA|ORIWKS|ORIMKS|FGROUP|CYCLE\d+|PROC|MSG)\b|\$[APSM]\w*_|=[ \t]*(?:AC|IC|DC|ACP|ACN)[ \t]*\(",
    re.IGNORECASE,
)
_REMARK: Final = re.compile(
    r"[ \t]*+(?:N\d++[ \t]*+)?+(?:\([^()\r\n]*+\)[ \t]*+)*+(?:;[^\r\n]*+)?+[\r\n]*+", re.ASCII | re.I
)

_NOTE: Final = re.compile(r"\([^()]*\)|;.*")
_TAPS: Final = re.compile(r"G0*(?:74|84)(?![\d.])", re.IGNORECASE)
_RIGID: Final = re.compile(r"M0*29(?!\d)", re.IGNORECASE)


@final
class Iso(Dialect):
    """G-code."""

    name = "iso"
    suffixes = PROGRAM_SUFFIXES["iso"]
    in_chunks = True
    has_increments = True

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Interpretation:
        """See `Dialect.moves`."""
        return iso_reader(program.source, axes, tcp=tcp).whole(chunks(program, axes.names))

    def rewrite(self, program: Program, axes: AxisWords, reading: Interpretation, new: NewPositions) -> str:
        """See `Dialect.rewrite`."""
        moves = as_columns(axes.names, reading.moves)
        if not np.any(new.count):
            return program.text
        expand = _replaces_some(reading.drilled, moves, new)
        rewriter = IsoRewriter(
            program.source,
            axes,
            newline_of(program),
            style_in(program.texts, Style(point=True)),
            # If TCP control is switched before the first move, its initial state does not matter; else the first move has it.
            tcp=bool(moves.tcp[0]),
            expand_cycles=expand,
            rigid_lines=_rigid_lines(program, reading.drilled, moves) if expand else frozenset(),
            code=line_code(len(program.texts)),
        )
        return rewriter.whole(chunks(program, axes.names), moves, new)

    def expanded(self, program: Program, folder: Path | None) -> Program:
        """See `Dialect.expanded`."""
        return IsoInliner(program, folder).expanded()

    def with_comments(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.with_comments`: after tape mark and program number.

        In round brackets, or after a semicolon if the program's comments or words are those of a SINUMERIK.
        """
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

    def is_motion_only(self, text: str, names: tuple[str, ...]) -> bool:
        """See `Dialect.is_motion_only`."""
        found = vocabulary.simple_pattern(names).pattern.fullmatch(text)
        return found is not None and found[found.re.groups] is None

    def line_words(self, text: str) -> LineWords:
        """See `Dialect.line_words`."""
        return line_words(text)

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


def _replaces_some(lines: Sequence[range], moves: MoveColumns, new: NewPositions) -> bool:
    """Return whether a move of these ranges of lines is replaced."""
    at = np.searchsorted(moves.line, [(part.start, part.stop) for part in lines])
    return any(bool(new.count[first:last].any()) for first, last in at.tolist())


def _rigid_lines(program: Program, drilled: Sequence[range], moves: MoveColumns) -> frozenset[int]:
    """Return the lines with M29 that belong to a thread of Fanuc: between the last move before it and its cycle."""
    found = []
    for part in drilled:
        if _TAPS.search(_NOTE.sub(" ", program.texts[part.start])):
            before = int(np.searchsorted(moves.line, part.start))
            first = int(moves.line[before - 1]) + 1 if before else 0
            found += [
                line for line in range(first, part.start + 1) if _RIGID.search(_NOTE.sub(" ", program.texts[line]))
            ]
    return frozenset(found)


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
    found = _ROUND.fullmatch(body)
    return None if found is None else found.group(1).strip()


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
