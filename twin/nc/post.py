"""A new axis-mode program from cutter locations, once somebody has solved them into axis positions."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Literal

import numpy as np

from twin.nc.apt import Statement, statements
from twin.nc.blocks import AxisWords, Kind, Program, Reading, Rewrite
from twin.nc.emit import Said, pieces_of
from twin.nc.text import MM_PER_INCH, Style, format_number, number


def post(
    program: Program,
    reading: Reading,
    rewrites: Iterable[Rewrite],
    axes: AxisWords,
    to: Literal["iso", "heidenhain"],
) -> str:
    """Write APT moves as a program of axis positions.

    Args:
        program: the APT program.
        reading: its moves.
        rewrites: one for every move: positions of all axes, ``vectors`` None.
        axes: the machine's axis words.
        to: language of the new program.

    Raises:
        ValueError: a move without a rewrite, or with an axis position that is not known (the caller's error).
    """
    by_line = pieces_of(reading, rewrites, axes)
    writer = _Iso(axes) if to == "iso" else _Heidenhain(axes)
    writer.start(program.source)
    count = 0
    unit = 1.0
    by_index = {move.line: move for move in reading.moves}
    for statement in statements(program):
        move = by_index.get(statement.line)
        if move is not None:
            if statement.line not in by_line:
                raise ValueError(f"the move of line {statement.line + 1} has no position")
            rewrite, rows = by_line[statement.line][0]
            if not np.all(np.isfinite(rewrite.positions)):
                raise ValueError(f"the move of line {statement.line + 1} has an unknown axis position")
            for row in rows:
                writer.move(row, move.kind is Kind.RAPID)
                count += 1
        elif statement.word == "UNITS":
            unit = MM_PER_INCH if statement.arguments and statement.texts[0].upper().startswith("INCH") else 1.0
        elif statement.word == "FEDRAT":
            writer.feed = _feed(statement, unit, writer.feed)
            if not writer.feed_is_per_minute(statement):
                writer.comment(_shown(statement))
        elif statement.word and statement.word not in ("RAPID", "FROM", "GOTO", "?"):
            writer.comment(_shown(statement))
    writer.finish()
    return "".join(writer.out)


def _shown(statement: Statement) -> str:
    return " ".join(statement.raw.split())


def _feed(statement: Statement, unit: float, last: float) -> float:
    """The feed of a ``FEDRAT`` in mm/min; what is not per minute leaves the last one."""
    words = {text.upper() for text in statement.texts}
    values = [v for v in (number(text) for text in statement.texts) if math.isfinite(v) and v > 0]
    if not values or words & {"MMPR", "IPR", "PERREV", "INVERS"}:
        return last
    if "IPM" in words:
        return values[0] * MM_PER_INCH
    return values[0] * (1.0 if "MMPM" in words else unit)


class _Writer(ABC):
    """What both languages share: which words a block needs."""

    def __init__(self, axes: AxisWords, style: Style) -> None:
        self.names = axes.names
        self.said = Said(axes)
        self.style = style
        self.feed = 0.0
        self.feed_said = -1.0
        self.out: list[str] = []

    def feed_is_per_minute(self, statement: Statement) -> bool:
        """Whether a ``FEDRAT`` could be taken over."""
        words = {text.upper() for text in statement.texts}
        return not words & {"MMPR", "IPR", "PERREV", "INVERS"}

    def words(self, row: list[float]) -> list[str]:
        """Axis words of the axes that change."""
        words = []
        for axis in self.said.missing(row, (), False):
            name = self.names[axis]
            number_text = self.said.say(axis, row[axis], False, False, self.style)
            words.append(f"{name}{'=' if len(name) > 1 else ''}{number_text}")
        return words

    @abstractmethod
    def start(self, source: str) -> None:
        """The head of the program."""

    @abstractmethod
    def comment(self, text: str) -> None:
        """A comment."""

    @abstractmethod
    def move(self, row: list[float], rapid: bool) -> None:
        """A move to a position."""

    @abstractmethod
    def finish(self) -> None:
        """The end of the program."""


class _Iso(_Writer):
    def __init__(self, axes: AxisWords) -> None:
        super().__init__(axes, Style(point=True))
        self.code = -1

    def start(self, source: str) -> None:
        self.out.append("%\n")
        self.comment(f"axis positions from cutter locations of {source}")
        self.out.append("G21 G90 G94\n")

    def comment(self, text: str) -> None:
        self.out.append(f"({_plain(text, '()')})\n")

    def move(self, row: list[float], rapid: bool) -> None:
        words = self.words(row)
        if not words:
            return
        code = 0 if rapid else 1
        if code != self.code:
            words.insert(0, f"G{code}")
            self.code = code
        if not rapid and self.feed > 0 and self.feed != self.feed_said:
            words.append(f"F{format_number(self.feed, 3, self.style)}")
            self.feed_said = self.feed
        self.out.append(" ".join(words) + "\n")

    def finish(self) -> None:
        self.out.append("M30\n%\n")


class _Heidenhain(_Writer):
    def __init__(self, axes: AxisWords) -> None:
        super().__init__(axes, Style(plus=True))
        self.title = "PROGRAM"
        self.number = 0

    def _block(self, text: str) -> None:
        self.out.append(f"{self.number} {text}\n")
        self.number += 1

    def start(self, source: str) -> None:
        stem = source.replace("\\", "/").rpartition("/")[2].partition(".")[0]
        self.title = "".join(c if c.isascii() and (c.isalnum() or c == "_") else "_" for c in stem).upper() or "PROGRAM"
        self._block(f"BEGIN PGM {self.title} MM")
        self.comment(f"axis positions from cutter locations of {source}")

    def comment(self, text: str) -> None:
        self._block(f"; {_plain(text, '~')}")

    def move(self, row: list[float], rapid: bool) -> None:
        words = self.words(row)
        if not words:
            return
        if rapid:
            words += ["R0", "FMAX"]
        elif self.feed > 0 and self.feed != self.feed_said:
            words += ["R0", f"F{format_number(self.feed, 3, Style())}"]
            self.feed_said = self.feed
        self._block("L " + " ".join(words))

    def finish(self) -> None:
        self._block("M30")
        self._block(f"END PGM {self.title} MM")


def _plain(text: str, without: str) -> str:
    """A text as a comment can hold it: one line, no control characters, none of the characters that end it."""
    return "".join(" " if c in without or not c.isprintable() else c for c in text).strip()
