"""What a language of NC programs is: everything that the rest of the package asks of one."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence

import numpy as np

from twin.nc.blocks import AxisWords, Program, Reading, Rewrite
from twin.nc.emit import Said
from twin.nc.text import Style, format_number, read_lines


class Dialect(ABC):
    """One language of NC programs, text on both sides of `twin.nc.blocks`.

    A language is one file (or folder) with a class like this, and a line in `twin.nc.DIALECTS`.

    Attributes:
        name: its name in messages and reports.
        suffixes: endings of the names of its files, in small letters with the dot.
        shared_suffixes: endings that another language has too; a program with one is of this language if it begins as
        begins: says.
        vector_decimals: decimals of a tool vector (7: 0.1 µrad).
        linear_increment_mm: least increment of the linear words, None for that of the machine's axes.
        cutter_locations: whether its programs say where the tool is, for any language with axis words to take over.
        in_stretches: whether `twin.nc.iso.stream` can work through its programs part by part.
    """

    name: str
    suffixes: tuple[str, ...]
    shared_suffixes: tuple[str, ...] = ()
    begins: re.Pattern[bytes] = re.compile(rb"(?!)")
    vector_decimals: int = 7
    linear_increment_mm: float | None = None
    cutter_locations: bool = False
    in_stretches: bool = False

    @abstractmethod
    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Reading:
        """Interpret a program; ``tcp``: whether the control's kinematics are on from the start.

        Raises:
            InputError: with file, line and value, on whatever cannot be understood or must not pass uncompensated.
        """

    @abstractmethod
    def rewrite(self, program: Program, axes: AxisWords, reading: Reading, rewrites: Iterable[Rewrite]) -> str:
        """The text with the given moves replaced and every other byte kept.

        Moves without a rewrite keep their text. A rewritten block carries every axis word whose value differs from
        what the output program last said of that axis, whether or not the original wrote it.
        """

    @abstractmethod
    def commented(self, text: str, comments: Sequence[str]) -> str:
        """The text with comments at its head, in this language's syntax; those that stand there already are not repeated.

        Args:
            text: the program; where lines are not numbered, its first part is enough.
            comments: ASCII without brackets.
        """

    @abstractmethod
    def from_points(self, names: Sequence[str], points: np.ndarray, feed: float | None, remark: str, title: str) -> str:
        """A new program through points, in a straight block each.

        Args:
            names: axis names of the columns; fewer than the columns where the last three are a tool vector.
            points: (n, columns) mm, degrees and tool vectors.
            feed: mm/min, or None: no feed is said.
            remark: a comment at its head, ASCII without brackets.
            title: the name of the program, for languages in which it has one.
        """

    @abstractmethod
    def is_remark(self, text: str) -> bool:
        """Whether a line means nothing to the control."""

    @abstractmethod
    def only_moves(self, text: str, names: tuple[str, ...]) -> bool:
        """Whether a line says nothing but where to go, and how fast; ``names``: the axes."""

    def feed_said(self, text: str) -> tuple[str, bool | None]:
        """The feed a line says (empty: none), and whether feeds are times from there on (None: not said)."""
        return "", None

    def read(self, data: bytes, source: str) -> Program:
        """Split bytes into lines.

        Raises:
            InputError: empty, or not text.
        """
        return read_lines(data, source, self.name)

    def renumbered(self, program: Program, text: str) -> str:
        """The text with its blocks numbered one by one, where the program's are."""
        return text

    def becomes(self, other: Dialect) -> bool:
        """Whether programs can be written in another language."""
        return other.name == self.name or self.cutter_locations

    def posted(
        self, program: Program, reading: Reading, rewrites: Iterable[Rewrite], axes: AxisWords, into: Dialect
    ) -> str:
        """The program in axis words of another language.

        Args:
            program: the program, of cutter locations.
            reading: its moves.
            rewrites: one for every move: positions of all axes, ``vectors`` None.
            axes: the machine's axis words.
            into: the other language.

        Raises:
            ValueError: a move without a rewrite, or with an axis position that is not known, or a program that has axis words
                already (the caller's error).
        """
        raise ValueError(f"{self.name} programs cannot be written in {into.name}")

    def new_program(self, axes: AxisWords) -> NewProgram:
        """A new program in axis words, empty so far.

        Raises:
            ValueError: the language has no axis words (the caller's error).
        """
        raise ValueError(f"{self.name} has no axis words")


class NewProgram(ABC):
    """A program in axis words that is written from its beginning.

    Args:
        axes: axis words.
        style: of its numbers.

    Attributes:
        feed: mm/min of the moves to come; 0: none.
        out: what is written.
    """

    def __init__(self, axes: AxisWords, style: Style) -> None:
        self.feed = 0.0
        self.out: list[str] = []
        self._names = axes.names
        self._said = Said(axes)
        self._style = style
        self._feed_said = -1.0

    def move(self, row: Sequence[float], *, rapid: bool) -> None:
        """A move to a position of all axes, mm and degrees; nothing where they are there."""
        words = [
            word_text(self._names[axis], self._said.say(axis, row[axis], False, False, self._style))
            for axis in self._said.missing(row, 0, False)
        ]
        if words:
            new = not rapid and self.feed > 0 and self.feed != self._feed_said
            self._block(words, rapid, format_number(self.feed, 3, self._style._replace(plus=False)) if new else "")
            self._feed_said = self.feed if new else self._feed_said

    @abstractmethod
    def start(self, source: str) -> None:
        """The head of the program, made from another one."""

    @abstractmethod
    def comment(self, text: str) -> None:
        """A comment."""

    @abstractmethod
    def finish(self) -> None:
        """The end of the program."""

    @abstractmethod
    def _block(self, words: list[str], rapid: bool, feed: str) -> None:
        """A block that moves; ``feed``: a number, or nothing."""


def word_text(name: str, number: str) -> str:
    """An axis word: its name and its number, with ``=`` between where the name has several letters."""
    return f"{name}{'=' if len(name) > 1 else ''}{number}"


def points_words(names: Sequence[str], points: np.ndarray, style: Style) -> list[str]:
    """The axis words of each point, mm and degrees with nine decimals."""
    return [
        " ".join(word_text(name, format_number(value, 9, style)) for name, value in zip(names, row, strict=True))
        for row in points.tolist()
    ]


def as_comment(text: str, without: str) -> str:
    """A text as a comment can hold it: one line, no control characters, none of the characters that end it."""
    return "".join(" " if c in without or not c.isprintable() else c for c in text).strip()
