"""Heidenhain plain language (``.h``)."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

from twin.nc.blocks import AxisWords, Dialect, Kind, Move, Program, Reading, Rewrite
from twin.nc.emit import Said, pieces_of, vector_texts
from twin.nc.heidenhain_state import Interpreter, PathBlock
from twin.nc.heidenhain_words import HEAD
from twin.nc.iso_block import AxisWord
from twin.nc.text import Style, apply_edits, ending, newline_of, number, read_lines, style_in, style_of

VECTOR_DECIMALS = 7
SAME = 1e-10
"""Numbers closer than this are the same number as printed: words have at most 9 decimals."""
Pieces = tuple[Rewrite, list[list[float]]]


@final
class Heidenhain(Dialect):
    """Heidenhain plain language."""

    name = "heidenhain"
    suffixes = (".h",)

    def read(self, data: bytes, source: str) -> Program:
        """Split bytes into lines; see `Dialect.read`."""
        return read_lines(data, source, self.name)

    def moves(self, program: Program, axes: AxisWords, *, tcp: bool) -> Reading:
        """Interpret a program; see `Dialect.moves`."""
        interpreter = Interpreter(program.source, axes, tcp=tcp)
        moves: list[Move] = []
        for index, line in enumerate(program.lines):
            block = interpreter.step(index, line.text)
            if block.move is not None:
                moves.append(block.move)
        return Reading(tuple(moves), tuple(interpreter.notices))

    def rewrite(self, program: Program, axes: AxisWords, reading: Reading, rewrites: Iterable[Rewrite]) -> str:
        """The text with moves replaced; see `Dialect.rewrite`."""
        by_line = pieces_of(reading, rewrites, axes)
        if not by_line:
            return program.text
        interpreter = Interpreter(program.source, axes, tcp=reading.moves[0].tcp)
        writer = _Writer(axes, newline_of(program), style_in(program, Style(plus=True)))
        for index, line in enumerate(program.lines):
            writer.block(interpreter.step(index, line.text), by_line.get(index))
        return writer.text()


@final
class _Writer:
    """Writes a program block by block, remembering what the output said."""

    def __init__(self, axes: AxisWords, newline: str, style: Style) -> None:
        self.names = axes.names
        self.linear = len(axes.linear)
        self.newline = newline
        self.said = Said(axes)
        self.style = style
        self.lower = False
        self.out: list[str] = []
        self.numbered: list[bool] = []
        self.inserted = False
        self._vector_text: tuple[str, str, str] | None = None

    def text(self) -> str:
        """The whole output, blocks renumbered where lines were inserted among numbered ones."""
        if not self.inserted or not any(self.numbered):
            return "".join(self.out)
        parts = []
        following = -1
        for text, numbered in zip(self.out, self.numbered, strict=True):
            head = HEAD.match(text) if numbered else None
            if head is None or head.group(1) is None:
                parts.append(text)
                continue
            old = head.group(1)
            following = int(old[:15]) if following < 0 else following + 1
            new = str(following).zfill(len(old)) if old[0] == "0" else str(following)
            parts.append(f"{text[: head.start(1)]}{new}{text[head.end(1) :]}")
        return "".join(parts)

    def block(self, block: PathBlock, pieces: dict[int, Pieces] | None) -> None:
        """Write one block, its move replaced if there are pieces."""
        if block.forgets:
            self.said.forget(block.forgets)
        if block.switched:
            self._vector_text = None
        if pieces is not None and block.move is not None:
            self._rewritten(block, *pieces[0])
            if not block.switched:
                self.said.forget(block.forgets)
            return
        if block.move is not None:
            for word in block.words:
                if block.move.machine:
                    self.said.forget((word.axis,))
                else:
                    self.said.heard(word.axis, word.value, word.incremental)
            if block.vector_words or any(word.axis >= self.linear for word in block.words):
                self._vector_text = None
        self._put(block.text, block.numbered)

    def _put(self, text: str, numbered: bool) -> None:
        self.out.append(text)
        self.numbered.append(numbered)

    def _rewritten(self, block: PathBlock, rewrite: Rewrite, rows: list[list[float]]) -> None:
        text = block.text
        many = len(rows) > 1
        vectors: list[list[float]] | None = None if rewrite.vectors is None else rewrite.vectors.tolist()
        edits: list[tuple[int, int, str]] = []
        if block.words:
            self.lower = text[block.words[-1].value_start - 1].islower()
        keyword = text[block.head : block.keyword_end]
        if rewrite.move.kind is Kind.ARC:
            keyword = "l" if keyword.islower() else "L"
            edits.append((block.head, block.keyword_end, keyword))
            edits += [(_before(text, span.start), span.end, "") for span in block.arc_words]
        written = set()
        row = rows[0]
        for word in block.words:
            written.add(word.axis)
            value = row[word.axis]
            if value == value:
                edits.append((word.value_start, word.value_end, self._replaced(block, word, value)))
            else:
                self.said.heard(word.axis, word.value, word.incremental)
        added = self._words(block, row, written)
        if vectors is not None:
            tool = self._vector(block, vectors[0], edits)
            if tool and keyword.upper() == "L":  # only LN blocks take a vector
                keyword = "ln" if keyword.islower() else "LN"
                edits = [edit for edit in edits if edit[:2] != (block.head, block.keyword_end)]
                edits.append((block.head, block.keyword_end, keyword))
            added += tool
        elif block.vector_words:
            self._vector_text = None
        if added:
            at = max((word.end for word in block.words), default=block.keyword_end)
            if not block.keyword and not block.words:
                edits.append((at, at, "L " + " ".join(added) + " "))
            elif not block.keyword and block.words:
                edits.append((block.head, block.head, "L "))  # a paraxial block moves one axis only
                edits.append((at, at, " " + " ".join(added)))
            else:
                edits.append((at, at, " " + " ".join(added)))
        last_m: list[str] = []
        if many:
            for span in block.last_m:
                edits.append((_before(text, span.start), span.end, ""))
                last_m.append(text[span.start : span.end])
        first = apply_edits(text, edits)
        end = ending(text)
        self._put(first if end or not many else first + self.newline, block.numbered)
        if not many:
            return
        indent = text[: block.head] if block.numbered or not text[: block.head].strip() else ""
        for place in range(1, len(rows)):
            words = self._words(block, rows[place], set())
            if vectors is not None:
                before = self._vector_text
                if block.keyword == "LN":
                    self._vector_text = None  # an LN block says its vectors in full
                tool = self._vector(block, vectors[place], None)
                if words or self._vector_text != before:
                    words += [*block.normal_text, *tool]
            is_last = place == len(rows) - 1
            if words and block.rapid_text:
                words.append(block.rapid_text)
            if is_last:
                words += last_m
            if words:
                start = keyword if block.keyword else "L"
                self._put(f"{indent}{start} {' '.join(words)}{end or self.newline}", block.numbered)
                self.inserted = True
        if not end:
            self.out[-1] = self.out[-1].removesuffix(self.newline)

    def _words(self, block: PathBlock, row: list[float], written: set[int]) -> list[str]:
        """Words for the axes that are not where they should be."""
        words = []
        for axis, value in enumerate(row):
            if axis in written or value != value or not self.said.differs(axis, value, block.inch):
                continue
            name = self.names[axis].lower() if self.lower else self.names[axis]
            words.append(f"{name}{self._say(block, axis, value, False)}")
        return words

    def _replaced(self, block: PathBlock, word: AxisWord, target: float) -> str:
        old = block.text[word.value_start : word.value_end]
        value = number(old)
        if value == value:
            self.style = style_of(old, self.style)._replace(plus=True)
        new = self._say(block, word.axis, target, word.incremental)
        same = abs(value - self.said.last) < SAME and old[0] in "+-" and (value != 0.0 or old[0] != "-")
        return old if same else new

    def _say(self, block: PathBlock, axis: int, target: float, incremental: bool) -> str:
        inch = block.inch and axis < self.linear
        if incremental and self.said.value[axis] != self.said.value[axis]:
            raise ValueError("an incremental word of an axis whose position is unknown")  # the reader refuses these
        return self.said.say(axis, target, inch, incremental, self.style)

    def _vector(self, block: PathBlock, vector: list[float], edits: list[tuple[int, int, str]] | None) -> list[str]:
        """Words of a tool vector: replaced where the block has them (edits), the others returned."""
        x, y, z = vector_texts(vector, VECTOR_DECIMALS, True)
        texts = (x, y, z) if not self.style.comma else (x.replace(".", ","), y.replace(".", ","), z.replace(".", ","))
        written = block.vector_words if edits is not None else {}
        if texts == self._vector_text and not written:
            return []
        self._vector_text = texts
        words = []
        for index, text in enumerate(texts):
            span = written.get(index)
            if span is not None and edits is not None:
                edits.append((span.start, span.end, text))
            else:
                words.append(f"T{'XYZ'[index]}{text}")
        return words


def _before(text: str, start: int) -> int:
    """The start of a word, with the spaces before it."""
    while start > 0 and text[start - 1] in " \t":
        start -= 1
    return start
