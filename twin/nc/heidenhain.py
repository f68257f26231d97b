"""Heidenhain plain language (``.h``)."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Sequence
from typing import final

from twin.nc.blocks import AxisWords, Kind, Move, Program, Reading, Rewrite
from twin.nc.dialect import TextDialect
from twin.nc.emit import Said, pieces_of, vector_texts
from twin.nc.header import with_heidenhain_comments
from twin.nc.heidenhain_state import Interpreter, PathBlock
from twin.nc.heidenhain_words import HEAD
from twin.nc.iso_block import AxisWord
from twin.nc.plain import NOTHING, kept, other_places, places, plain_language, replaced
from twin.nc.text import BLANK, Style, apply_edits, ending, newline_of, number, style_in, style_of

VECTOR_DECIMALS = 7
Pieces = tuple[Rewrite, list[list[float]]]


@final
class Heidenhain(TextDialect):
    """Heidenhain plain language."""

    name = "heidenhain"
    suffixes = (".h",)

    def commented(self, text: str, comments: Sequence[str]) -> str:
        """See `Dialect.commented`."""
        return with_heidenhain_comments(text, comments) if comments else text

    def _moves(self, program: Program, axes: AxisWords, *, tcp: bool, short_way: bool = True) -> Reading:
        """See `TextDialect._moves`."""
        interpreter = Interpreter(program.source, axes, tcp=tcp)
        match = (plain_language(axes.names).pattern if short_way else NOTHING).fullmatch
        plain, step = interpreter.plain, interpreter.step
        moves: list[Move] = []
        for index, text in enumerate(program.texts):
            if text in BLANK and not interpreter.continued:
                continue
            found = match(text)
            move = None if found is None else plain(index, found)
            if move is None:
                move = step(index, text).move
            if move is not None:
                moves.append(move)
        return Reading(tuple(moves), tuple(interpreter.notices), tuple(interpreter.left))

    def _rewrite(
        self,
        program: Program,
        axes: AxisWords,
        reading: Reading,
        rewrites: Iterable[Rewrite],
        *,
        short_way: bool = True,
    ) -> str:
        """See `TextDialect._rewrite`."""
        by_line = pieces_of(reading, rewrites, axes)
        if not by_line:
            return program.text
        interpreter = Interpreter(program.source, axes, tcp=reading.moves[0].tcp)
        writer = _Writer(axes, newline_of(program), style_in(program.texts, Style(plus=True)))
        match = (plain_language(axes.names).pattern if short_way else NOTHING).fullmatch
        for index, text in enumerate(program.texts):
            pieces = by_line.get(index)
            found = match(text)
            if found is None or not writer.plain(index, found, interpreter, pieces):
                writer.block(interpreter.step(index, text), pieces)
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
        self._plain = plain_language(self.names)
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

    def plain(self, line: int, match: re.Match[str], state: Interpreter, pieces: dict[int, Pieces] | None) -> bool:
        """Write a plain block as `block` does; false (and nothing done) where only `block` will do.

        Args:
            line: 0-based index of its line.
            match: of `plain_language`.
            state: before the block; afterwards it is behind it.
            pieces: what replaces its move.
        """
        inch = state.inch
        text = match.string
        words = places(match, self._plain)
        head = match[1]
        numbered = head[0].isdigit()
        if pieces is None:
            if state.plain(line, match) is None:
                return False
            rotary = kept(text, words, self.said, inch=inch, incremental=False)
            if rotary or any(which >= 3 for which, _, _ in other_places(match, self._plain)):
                self._vector_text = None
            self._put(text, numbered)
            return True
        rewrite, rows = pieces[0]
        others = other_places(match, self._plain)
        tool = [place for place in others if place[0] >= 3]
        many = len(rows) > 1
        if (others and many) or len(tool) != (0 if rewrite.vectors is None else 3):
            return False
        if rewrite.move.kind is Kind.ARC or (others and head[-1] not in "nN"):
            return False
        if not state.follow(rewrite.move):
            return False
        self.lower = text[words[-1][1] - 1].islower()
        new, self.style = replaced(
            text, words, rows[0], self.said, self.style, inch=inch, incremental=False, signed=True
        )
        if len(words) < len(self.names):
            for word in self._words(rows[0], [axis for axis, _, _ in words], inch):
                new += f" {word}"
        end = ending(text) or self.newline
        at = words[-1][2]
        if rewrite.vectors is not None:
            texts = self._printed(rewrite.vectors[0].tolist())
            self._vector_text = texts
            for which, start, stop in tool:
                new += text[at:start] + texts[which - 3]
                at = stop
        new += text[at:]
        self._put(new if ending(text) or not many else new + end, numbered)
        if many:
            feed = match.group(match.re.groups)
            rapid = [feed] if feed is not None and feed[-1] in "xX" else []
            for row in rows[1:]:
                added = self._words(row, (), inch)
                if added:
                    self._put(f"{text[: match.end(1)]} {' '.join(added + rapid)}{end}", numbered)
                    self.inserted = True
            if not ending(text):
                self.out[-1] = self.out[-1].removesuffix(end)
        return True

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
        added = self._words(row, written, block.inch)
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
            words = self._words(rows[place], (), block.inch)
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

    def _words(self, row: list[float], written: Container[int], inch: bool) -> list[str]:
        """Words for the axes that are not where they should be."""
        words = []
        for axis in self.said.missing(row, written, inch):
            name = self.names[axis].lower() if self.lower else self.names[axis]
            words.append(f"{name}{self.said.say(axis, row[axis], inch, False, self.style)}")
        return words

    def _replaced(self, block: PathBlock, word: AxisWord, target: float) -> str:
        old = block.text[word.value_start : word.value_end]
        value = number(old)
        if value == value:
            self.style = style_of(old, self.style)._replace(plus=True)
        if word.incremental and self.said.value[word.axis] != self.said.value[word.axis]:
            raise ValueError("an incremental word of an axis whose position is unknown")  # the reader refuses these
        return self.said.replace(word.axis, old, target, block.inch, word.incremental, self.style)

    def _printed(self, vector: list[float]) -> tuple[str, str, str]:
        """The components of a tool vector as this program writes them."""
        x, y, z = vector_texts(vector, VECTOR_DECIMALS, True)
        return (x.replace(".", ","), y.replace(".", ","), z.replace(".", ",")) if self.style.comma else (x, y, z)

    def _vector(self, block: PathBlock, vector: list[float], edits: list[tuple[int, int, str]] | None) -> list[str]:
        """Words of a tool vector: replaced where the block has them (edits), the others returned."""
        texts = self._printed(vector)
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
