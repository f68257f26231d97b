"""Base of the ISO and Heidenhain writers: blocks rewritten word by word, every other byte kept."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Final, Generic, TypeVar

from twin._common.errors import InputError
from twin.nc.block import AxisWord, Block, Span
from twin.nc.blocks import AxisWords, Kind, Rewrite
from twin.nc.emit import OutputState
from twin.nc.text import Style, apply_edits, ending, number, style_of
from twin.nc.word_texts import Formatting, Grids, lines_of_words

Segments = tuple[Rewrite, list[list[float]]]
"""A rewrite, and its positions as lists."""
Edit = tuple[int, int, str]


MANY: Final = 24
"""Number of segments of a block from which they are written together."""

B = TypeVar("B", bound=Block)


class WordWriter(ABC, Generic[B]):
    """Writer of a program block by block that keeps track of the values written.

    Args:
        source: file name for messages.
        axes: axis words.
        newline: line ending of the program.
        style: its number format.

    Attributes:
        said: the last value written for every axis.
        grids: steps of the axis words.
        lower: whether the program uses small letters.
    """

    separator = " "
    equals = "="
    signed = False
    """Whether every number carries a sign."""

    def __init__(self, source: str, axes: AxisWords, newline: str, style: Style) -> None:
        self.source = source
        self.names = axes.names
        self.linear = len(axes.linear)
        self.newline = newline
        self.style = style
        self.said = OutputState(axes)
        self.grids = Grids(axes.names, [axes.increment[name] for name in axes.names])
        self.lower = False
        self._line = 0
        self._vector_text: tuple[str, str, str] | None = None

    def record(self, block: B) -> None:
        """Record the words of a block whose move is unchanged."""
        move = block.moves[0]
        for word in block.words:
            if move.passes:
                self.said.mark_unknown((word.axis,))
            elif word.form in ("DC", "ACP", "ACN"):
                self.said.record(word.axis, move.position[word.axis], False)
            else:
                self.said.record(word.axis, word.value, word.incremental)
        if block.vector_words or block.axis_bits >> self.linear:
            self._vector_text = None

    def rewritten(self, block: B, segments: Segments) -> list[str]:
        """Return the lines that replace a block.

        Args:
            block: the block; its first move is replaced.
            segments: the segments that replace it.
        """
        rewrite, rows = segments
        many = len(rows) > 1
        vectors = None if rewrite.vectors is None else rewrite.vectors.tolist()
        edits: list[Edit] = []
        begin = self._begin(block, rewrite, edits)
        row = rows[0]
        for word in block.words:
            target = row[word[0]]
            if target != target:
                self.said.record(word.axis, word.value, word.incremental)
            elif word[5]:
                edits.append(self._replaced(block, word, target))
            else:
                edits.append((word[3], word[4], self._number(block, word, target)))
        added = self._missing(block, rows[0], block.axis_bits)
        tool: list[str] = []
        if vectors is not None:
            tool = self._vector(block, vectors[0], edits)
        elif block.vector_words:
            self._vector_text = None
        if rewrite.move.kind is Kind.ARC:
            drop(block, block.arc_words, edits)
        tails = self._tails(block, rewrite, edits) if many else []
        end_m_words = drop(block, block.end_m_words, edits) if many else []
        begin = self._insert(block, begin, added, tool, edits)
        lines = [apply_edits(block.text, edits) if edits else block.text]
        if not many:
            return lines
        end = ending(block.text)
        lines[0] += "" if end else self.newline
        written = None if tails or vectors is not None else self._together(block, rewrite, begin, end or self.newline)
        if written:
            lines.append(written)
        for place in range(1 if written is None else len(rows) - 1, len(rows)):
            words = self._later(block, rows[place], None if vectors is None else vectors[place])
            if words and tails:
                words.append(tails[place])
            if place == len(rows) - 1:
                words += end_m_words
            if words:
                lines.append(f"{begin}{self.separator.join(words)}{end or self.newline}")
        if not end:
            lines[-1] = lines[-1].removesuffix(self.newline)
        return lines

    @abstractmethod
    def _begin(self, block: B, rewrite: Rewrite, edits: list[Edit]) -> str:
        """Turn a block into a straight move and return the text with which each line begins."""

    @abstractmethod
    def _insert(self, block: B, begin: str, added: list[str], tool: list[str], edits: list[Edit]) -> str:
        """Insert the missing words into a block and return the text with which the lines of later segments begin."""

    @abstractmethod
    def _tails(self, block: B, rewrite: Rewrite, edits: list[Edit]) -> list[str]:
        """Return the text at the end of each of several segments, for the first one as an edit; empty if there is none."""

    @abstractmethod
    def _vector_words(self, vector: list[float]) -> tuple[str, str, str]:
        """Return the components of a tool vector as text in the style of the program."""

    @abstractmethod
    def _vector_names(self, block: B) -> Sequence[str]:
        """Return the names of the tool vector's words, none if the block cannot have them."""

    def _later(self, block: B, row: list[float], vector: list[float] | None) -> list[str]:
        """Return the words of a segment after the first."""
        return self._missing(block, row, 0) + ([] if vector is None else self._vector(block, vector, None))

    def _together(self, block: B, rewrite: Rewrite, begin: str, end: str) -> str | None:
        """Return the lines of the segments between the first and the last; None if they must be written one by one."""
        if len(rewrite.positions) < MANY or block.inch or block.incremental:
            return None
        if any(len(name) > 1 for name in self.names) or any(word.form for word in block.words):
            return None
        formatting = Formatting(self.style, self.separator == " ", self.lower)
        return lines_of_words(rewrite.positions[:-1], self.said, formatting, self.grids, begin, end)

    # ------------------------------------------------------------------ words

    def _number(self, block: B, word: AxisWord, target: float) -> str:
        """Return the number of an axis word for a target."""
        axis, _, _, start, end, _, incremental, _ = word
        old = block.text[start:end]
        value = number(old)
        if value == value:
            style = style_of(old, self.style)
            self.style = style if style.plus or not self.signed else style._replace(plus=True)
        if incremental:
            self._check(axis)
        return self.said.replace(axis, old, value, target, block.inch, incremental, self.style)

    def _replaced(self, block: B, word: AxisWord, target: float) -> Edit:
        """Return the edit that gives a word its target."""
        return word.value_start, word.value_end, self._number(block, word, target)

    def _missing(self, block: B, row: list[float], written: int) -> list[str]:
        """Return words for the axes that are not at their target; ``written``: axes that have a word already, as bits."""
        axes = self.said.axes_to_write(row, written, block.inch)
        return [self._added(block, axis, row[axis]) for axis in axes]

    def _added(self, block: B, axis: int, target: float) -> str:
        name = self.names[axis].lower() if self.lower else self.names[axis]
        if block.incremental:
            self._check(axis)
        text = self.said.number_for(axis, target, block.inch, block.incremental, self.style)
        return f"{name}{self.equals if len(name) > 1 else ''}{text}"

    def _check(self, axis: int) -> None:
        if self.said.value[axis] != self.said.value[axis]:
            raise InputError(
                f"incremental {self.names[axis]} while its position is unknown",
                expected="absolute position first",
                file=self.source,
                line=self._line + 1,
                value=self.names[axis],
            )

    def _vector(self, block: B, vector: list[float], edits: list[Edit] | None) -> list[str]:
        """Replace the words of a tool vector that the block has (as edits) and return the others."""
        names = self._vector_names(block)
        if not names:
            if block.vector_words:
                self._vector_text = None
            return []
        texts = self._vector_words(vector)
        written = block.vector_words if edits is not None else {}
        if texts == self._vector_text and not written:
            return []
        self._vector_text = texts
        words = []
        for index, text in enumerate(texts):
            span = written.get(index)
            if span is not None and edits is not None:
                edits.append((span.start, span.end, text))
            elif not written or self.signed or float(text) != 0.0:
                words.append(f"{names[index]}{text}")
        return words


def drop(block: Block, spans: Iterable[Span], edits: list[Edit]) -> list[str]:
    """Delete words from a block, with the spaces before them, and return their texts."""
    text = block.text
    for span in spans:
        begin, end = len(text[: span.start].rstrip(" \t")), span.end
        if not text[:begin]:
            end = len(text) - len(text[end:].lstrip(" \t"))
        edits.append((begin, end, ""))
    return [text[span.start : span.end] for span in spans]
