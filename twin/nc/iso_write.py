"""The writer of ISO programs: moves replaced in their blocks, every other byte kept."""

from __future__ import annotations

import math
import re
from collections.abc import Container
from typing import final

from twin._common.errors import InputError
from twin.nc.blocks import AxisWords, Kind, Move, Rewrite
from twin.nc.emit import Said, vector_texts
from twin.nc.iso_block import AxisWord, Block, Span
from twin.nc.iso_plain import MOTION, PlainInterpreter
from twin.nc.plain import ISO_WORDS, iso_plain, kept, other_places, places, replaced
from twin.nc.text import Style, apply_edits, ending, format_number, number, style_of

VECTOR_DECIMALS = 7
Pieces = tuple[Rewrite, list[list[float]]]
_COMPONENT = {ISO_WORDS.index(name): i % 3 for i, name in enumerate(("I", "J", "K", "A3", "B3", "C3"))}
_CODE = {Kind.RAPID: 0, Kind.LINEAR: 1, Kind.ARC: 1}


@final
class Writer:
    """Writes an ISO program block by block, remembering what the output said.

    Attributes:
        said: what the output last said of every axis.
        motion: motion code in force in the output (None: before the first, or uncertain).
    """

    def __init__(self, source: str, axes: AxisWords, newline: str, style: Style, *, expand_cycles: bool) -> None:
        self.source = source
        self.names = axes.names
        self.linear = len(axes.linear)
        self.newline = newline
        self.expand_cycles = expand_cycles
        self.said = Said(axes)
        self.motion: int | None = None
        self.style = style
        self.spaced = True
        self.lower = False
        self.wide = False
        self._plain = iso_plain(self.names)
        self._vector_text: tuple[str, str, str] | None = None

    def block(self, line: int, block: Block, pieces: dict[int, Pieces] | None) -> str:
        """The output for one block.

        Args:
            line: 0-based index of its line.
            block: as interpreted.
            pieces: what replaces its moves, by the move's place in the block.
        """
        if block.switched or block.forgets:
            self.said.forget(block.forgets)
            if block.switched:
                self._vector_text = None
        moves = block.moves
        strokes = len(moves) > 1 and self.expand_cycles
        if pieces and 0 in pieces:
            text = self._rewritten(line, block, pieces[0])
        elif block.text and moves:
            text = self._kept(block)
        else:
            text = block.text
            if block.motion_word is not None:
                self.motion = block.motion
            if block.cycle_word is not None and self.expand_cycles:
                at = block.cycle_word.start
                text = f"{text[:at]};{text[at:]}"
        if block.skip:
            self.said.doubt(range(len(self.names)))
            self._vector_text = None
            self.motion = None
        if strokes:
            text += self._strokes(line, block, pieces or {}, text)
        elif len(moves) > 1:
            self.said.heard(2, moves[-1].position[2], False)
        return text

    # ------------------------------------------------------------------ plain

    def plain(
        self, line: int, match: re.Match[str], state: PlainInterpreter, pieces: dict[int, Pieces] | None
    ) -> str | None:
        """The output for a plain block, as `block` writes it; None (and nothing done) where only `block` will do.

        Args:
            line: 0-based index of its line.
            match: of `iso_plain`.
            state: before the block; afterwards it is behind it.
            pieces: what replaces its move.
        """
        code = match.group(1)
        motion = state.motion if code is None else MOTION[code]
        inch, incremental = state.inch, state.incremental
        text = match.string
        if pieces is None:
            if motion is None or (code is None and self.motion != motion) or state.plain(line, match) is None:
                return None
            self.motion = motion
            others = other_places(match, self._plain)
            rotary = kept(text, places(match, self._plain), self.said, inch=inch, incremental=incremental)
            if rotary or (others and motion < 2):
                self._vector_text = None
            return text
        if motion is None or len(pieces) > 1 or 0 not in pieces:
            return None
        rewrite, rows = pieces[0]
        move = rewrite.move
        many = len(rows) > 1
        written = min(motion, 1)
        if (code is None and self.motion != written) or _CODE[move.kind] != written:
            return None
        if (move.kind is Kind.ARC) != (motion > 1) or (many and state.feed_mode == "93"):
            return None
        if incremental and not self.said.knows_all():
            return None
        others = other_places(match, self._plain)
        if rewrite.vectors is None:
            if others and motion < 2:
                return None
        elif many or motion > 1 or len(others) != 3 or not all(which in _COMPONENT for which, _, _ in others):
            return None  # a vector written in part, or in a block that has none
        if not state.follow(move, motion):
            return None
        self.motion = written
        if code is not None:
            self.wide = len(code) > 1
            if motion > 1:
                at = match.end(1)
                text = f"{text[: at - 1]}1{text[at:]}"
        words = places(match, self._plain)
        first = words[0][1] - 1
        second = words[1][1] - 1 if len(words) > 1 else -1
        self._see(text, first, second, code is not None or text[:first].strip() != "")
        new, self.style = replaced(
            text, words, rows[0], self.said, self.style, inch=inch, incremental=incremental, signed=False
        )
        separator = " " if self.spaced else ""
        if len(words) < len(self.names):
            for word in self._missing(line, rows[0], [axis for axis, _, _ in words], inch, incremental):
                new += separator + word
        at = words[-1][2]
        if rewrite.vectors is not None:
            self._vector_text = texts = vector_texts(rewrite.vectors[0].tolist(), VECTOR_DECIMALS, False)
            for which, start, stop in others:
                new += text[at:start] + texts[_COMPONENT[which]]
                at = stop
        elif others:
            at = others[-1][2]
        new += text[at:]
        if not many:
            return new
        end = ending(text) or self.newline
        out = [new if ending(text) else new + end]
        for row in rows[1:]:
            added = self._missing(line, row, (), inch, incremental)
            if added:
                out.append(separator.join(added) + end)
        if not ending(text):
            out[-1] = out[-1].removesuffix(end)
        return "".join(out)

    # ------------------------------------------------------------------ kept

    def _kept(self, block: Block) -> str:
        """A block whose move stays: its text, with the motion word it relied on where the output's differs."""
        text = block.text
        move = block.moves[0]
        for word in block.words:
            if move.machine:
                self.said.forget((word.axis,))
            elif word.form in ("DC", "ACP", "ACN"):
                self.said.heard(word.axis, move.position[word.axis], False)
            else:
                self.said.heard(word.axis, word.value, word.incremental)
        if block.vector_words or any(word.axis >= self.linear for word in block.words):
            self._vector_text = None
        if block.motion_word is not None:
            self.motion = block.motion
        elif block.motion is not None and self.motion != block.motion:
            at = min([w.start for w in block.words] + [w.start for w in block.arc_words], default=block.head)
            self.motion = block.motion
            separator = " " if self.spaced or not text[at - 1 : at].isspace() else ""
            text = f"{text[:at]}{self._g(block.motion)}{separator}{text[at:]}"
        return text

    # ------------------------------------------------------------------ rewritten

    def _rewritten(self, line: int, block: Block, pieces: Pieces) -> str:
        rewrite, rows = pieces
        move = rewrite.move
        vectors: list[list[float]] | None = None if rewrite.vectors is None else rewrite.vectors.tolist()
        self._habits(block)
        many = len(rows) > 1
        edits: list[tuple[int, int, str]] = []
        code = _CODE[move.kind] if block.motion is not None else None
        insert = self._motion_edit(block, edits, code)
        by_axis = {word.axis: word for word in block.words}
        row = rows[0]
        for word in block.words:
            if row[word.axis] == row[word.axis]:
                head = self._head(block, word, row[word.axis]) if word.form in ("ACP", "ACN") else None
                start = word.value_start if head is None else word.start
                new = self._replaced(line, block, word, row[word.axis])
                edits.append((start, word.value_end, new if head is None else head + new))
            else:
                self.said.heard(word.axis, word.value, word.incremental)
        added = self._missing(line, row, by_axis, block.inch, block.incremental)
        if vectors is not None and block.vector_names is not None:
            added += self._vector(block, vectors[0], edits)
        elif block.vector_words:
            self._vector_text = None
        if move.kind is Kind.ARC:
            for span in block.arc_words:
                start = span.start
                while start > 0 and block.text[start - 1] in " \t":
                    start -= 1
                edits.append((start, span.end, ""))
        feeds: list[str] = []
        if many and block.inverse_time and code == 1:
            if block.feed is None:
                raise InputError(
                    "an inverse time block without F cannot be split",
                    expected="an F word in every block of G93",
                    file=self.source,
                    line=line + 1,
                    value=block.text.strip(),
                )
            factors = [float(len(rows))] * len(rows) if rewrite.shares is None else (1.0 / rewrite.shares).tolist()
            feeds = [self._faster(block, block.feed, factor) for factor in factors]
            edits.append((block.feed.start, block.feed.end, feeds[0]))
        last_m: list[str] = []
        if many:
            for span in block.last_m:
                start = span.start
                while start > 0 and block.text[start - 1] in " \t":
                    start -= 1
                edits.append((start, span.end, ""))
                last_m.append(block.text[span.start : span.end])
        if insert or added:
            self._insert(block, edits, insert, added)
        text = apply_edits(block.text, edits)
        if not many:
            return text
        end = ending(block.text)
        out = [text if end else text + self.newline]
        f_word = block.text[block.feed.start - 1] if block.feed is not None and feeds else "F"
        for place in range(1, len(rows)):
            words = self._later(line, block, rows[place], move)
            if vectors is not None and block.vector_names is not None:
                words += self._vector(block, vectors[place], None)
            if feeds and words:
                words.append(f"{f_word if f_word.upper() == 'F' else 'F'}{feeds[place]}")
            if place == len(rows) - 1:
                words += last_m
            if words:
                out.append(block.skip + (" " if self.spaced else "").join(words) + (end or self.newline))
        if not end:
            out[-1] = out[-1].removesuffix(self.newline)
        return "".join(out)

    def _later(self, line: int, block: Block, row: list[float], move: Move) -> list[str]:
        forms = {word.axis: word for word in block.words if word.form}
        words = []
        for axis in self.said.missing(row, (), block.inch):
            word = forms.get(axis)
            if word is None:
                words.append(self._added(line, axis, row[axis], block.inch, block.incremental))
            else:
                before = self._head(block, word, row[axis])
                after = block.text[word.value_end : word.end]
                words.append(f"{before}{self._replaced(line, block, word, row[axis])}{after}")
        return words

    def _strokes(self, line: int, block: Block, pieces: dict[int, Pieces], text: str) -> str:
        """The strokes of a drilling cycle, written out as blocks."""
        end = ending(block.text) or self.newline
        out = [] if ending(text) else [end]
        for place in range(1, len(block.moves)):
            move = block.moves[place]
            given = pieces.get(place)
            rows = [list(move.position)] if given is None else given[1]
            for row in rows:
                words = self._missing(line, row, (), block.inch, block.incremental)
                code = _CODE[move.kind]
                if words and self.motion != code:
                    words.insert(0, self._g(code))
                    self.motion = code
                if words:
                    out.append(block.skip + " ".join(words) + end)
            if place == 2 and block.dwell:
                out.append(block.skip + block.dwell + end)
        if block.skip:
            self.said.doubt(range(len(self.names)))
            self.motion = None
        return "".join(out)

    # ------------------------------------------------------------------ words

    def _habits(self, block: Block) -> None:
        """How this program spaces words and writes letters."""
        words = block.words
        if words:
            second = words[1].start if len(words) > 1 else -1
            self._see(block.text, words[0].start, second, block.motion_word is not None or block.head > 0)
        elif block.motion_word is not None:
            self.lower = block.text[block.motion_word.start] == "g"

    def _see(self, text: str, first: int, second: int, headed: bool) -> None:
        """Habits from the axis words of a block.

        Args:
            text: of the line.
            first: where the first axis word begins,
            second: where the next one does (-1: there is none).
            headed: whether another word stands before the first.
        """
        if second >= 0:
            self.spaced = text[second - 1] in " \t"
        elif first > 0 and headed:
            self.spaced = text[first - 1] in " \t"
        self.lower = text[first].islower()

    def _g(self, code: int) -> str:
        return f"{'g' if self.lower else 'G'}{'0' if self.wide else ''}{code}"

    def _motion_edit(self, block: Block, edits: list[tuple[int, int, str]], code: int | None) -> str:
        """Make the motion word say the code; the word to insert, if one is needed."""
        span = block.motion_word
        if span is not None:
            digits = block.text[span.start + 1 : span.end].strip()
            self.wide = len(digits) > 1
            if block.motion != code:
                edits.append((span.end - 1, span.end, str(code)))
            self.motion = code
            return ""
        if code is None or self.motion == code:
            return ""
        self.motion = code
        return self._g(code)

    def _replaced(self, line: int, block: Block, word: AxisWord, target: float) -> str:
        """The value of an axis word for a target."""
        old = block.text[word.value_start : word.value_end]
        value = number(old)
        if value == value:
            self.style = style_of(old, self.style)
        axis = word.axis
        if word.form in ("DC", "ACP", "ACN"):
            self.said.say(axis, target, block.inch, False, self.style)
            turn = self.said.value[axis] % 360.0
            return format_number(turn, 9, self.style._replace(keep=0)) if turn < 359.9999999995 else "0"
        self._check(line, axis, word.incremental)
        return self.said.replace(axis, old, target, block.inch, word.incremental, self.style)

    def _head(self, block: Block, word: AxisWord, target: float) -> str:
        """What stands before an axis word's value; a way round that is no longer needed becomes the short way.

        ``C=ACP(30)`` from 30 stays there, but ``C=ACP(29.999)`` would go round once.
        """
        head = block.text[word.start : word.value_start]
        if word.form in ("ACP", "ACN") and abs(target - self.said.value[word.axis]) <= 180.0:
            at = head.upper().rindex(word.form)
            return f"{head[:at]}{'DC' if head[at].isupper() else 'dc'}{head[at + 3 :]}"
        return head

    def _missing(
        self, line: int, row: list[float], written: Container[int], inch: bool, incremental: bool
    ) -> list[str]:
        """Words for the axes that are not where they should be."""
        axes = self.said.missing(row, written, inch)
        return [self._added(line, axis, row[axis], inch, incremental) for axis in axes]

    def _added(self, line: int, axis: int, target: float, inch: bool, incremental: bool) -> str:
        name = self.names[axis].lower() if self.lower else self.names[axis]
        separator = "=" if len(name) > 1 else ""
        self._check(line, axis, incremental)
        return f"{name}{separator}{self.said.say(axis, target, inch, incremental, self.style)}"

    def _check(self, line: int, axis: int, incremental: bool) -> None:
        if incremental and self.said.value[axis] != self.said.value[axis]:
            raise InputError(
                f"{self.names[axis]} is incremental where its position is unknown",
                expected="absolute position first",
                file=self.source,
                line=line + 1,
                value=self.names[axis],
            )

    def _vector(self, block: Block, vector: list[float], edits: list[tuple[int, int, str]] | None) -> list[str]:
        """Words of a tool vector: replaced where the block has them (edits), the others returned."""
        names = block.vector_names or ("", "", "")
        texts = vector_texts(vector, VECTOR_DECIMALS, False)
        written = block.vector_words if edits is not None else {}
        if texts == self._vector_text and not written:
            return []
        self._vector_text = texts
        words = []
        for index, text in enumerate(texts):
            span = written.get(index)
            if span is not None and edits is not None:
                edits.append((span.start, span.end, text))
            elif not written or float(text) != 0.0:
                name = names[index]
                words.append(f"{name.lower() if self.lower else name}{text}")
        return words

    def _insert(self, block: Block, edits: list[tuple[int, int, str]], motion: str, added: list[str]) -> None:
        """Put a motion word and added words where they belong."""
        text = block.text
        separator = " " if self.spaced else ""
        anchors = [word.end for word in block.words]
        if motion:
            first = min((word.start for word in block.words), default=-1)
            if first >= 0:
                edits.append((first, first, f"{motion}{separator}"))
            else:
                added = [motion, *added]
        if not added:
            return
        if not anchors and block.motion_word is not None:
            anchors = [block.motion_word.end]
        joined = separator.join(added)
        if anchors:
            at = max(anchors)
            glue = separator or (" " if not text[at - 1].isdigit() and text[at - 1] != "." else "")
            edits.append((at, at, f"{glue}{joined}"))
            return
        at = block.head
        rest = text[at:].strip()
        before = separator if at > 0 and text[at - 1 : at].isalnum() else ""
        after = separator if rest and not text[at : at + 1].isspace() else ""
        edits.append((at, at, f"{before}{joined}{after}"))

    def _faster(self, block: Block, span: Span, factor: float) -> str:
        """An inverse time feed for one of several pieces."""
        old = block.text[span.start : span.end]
        value = number(old)
        decimals = len(old.partition(".")[2])
        if not math.isfinite(value):
            value = 0.0
        return format_number(value * factor, max(4, decimals), style_of(old, self.style))
