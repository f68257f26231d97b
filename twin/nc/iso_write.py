"""The writer of ISO programs: moves replaced in their blocks, every other byte kept."""

from __future__ import annotations

import math
from typing import final

from twin.errors import InputError
from twin.nc.blocks import AxisWords, Kind, Move, Rewrite
from twin.nc.emit import Said, vector_texts
from twin.nc.iso_block import AxisWord, Block, Span
from twin.nc.text import Style, apply_edits, ending, format_number, number, style_of

VECTOR_DECIMALS = 7
SAME = 1e-10
"""Numbers closer than this are the same number as printed: words have at most 9 decimals."""
Pieces = tuple[Rewrite, list[list[float]]]
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
        self._vector_text: tuple[str, str, str] | None = None
        self._in_cycle = False

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
        added = [
            self._added(line, block, axis, row[axis])
            for axis in range(len(row))
            if axis not in by_axis and row[axis] == row[axis] and self.said.differs(axis, row[axis], block.inch)
        ]
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
        factor = len(rows) if many and block.inverse_time and code == 1 else 1
        feed = ""
        if factor > 1:
            if block.feed is None:
                raise InputError(
                    "an inverse time block without F cannot be split",
                    expected="an F word in every block of G93",
                    file=self.source,
                    line=line + 1,
                    value=block.text.strip(),
                )
            feed = self._faster(block, block.feed, factor)
            edits.append((block.feed.start, block.feed.end, feed))
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
        f_word = block.text[block.feed.start - 1] if block.feed is not None and feed else "F"
        for place in range(1, len(rows)):
            words = self._later(line, block, rows[place], move)
            if vectors is not None and block.vector_names is not None:
                words += self._vector(block, vectors[place], None)
            if feed and words:
                words.append(f"{f_word if f_word.upper() == 'F' else 'F'}{feed}")
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
        for axis, value in enumerate(row):
            if value == value and self.said.differs(axis, value, block.inch):
                word = forms.get(axis)
                if word is None:
                    words.append(self._added(line, block, axis, value))
                else:
                    before = self._head(block, word, value)
                    after = block.text[word.value_end : word.end]
                    words.append(f"{before}{self._replaced(line, block, word, value)}{after}")
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
                words = [
                    self._added(line, block, a, v) for a, v in enumerate(row) if self.said.differs(a, v, block.inch)
                ]
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
        text = block.text
        if len(words) > 1:
            self.spaced = text[words[1].start - 1] in " \t"
        elif words and words[0].start > 0 and (block.motion_word is not None or block.head):
            self.spaced = text[words[0].start - 1] in " \t"
        if words:
            self.lower = text[words[0].start].islower()
        elif block.motion_word is not None:
            self.lower = text[block.motion_word.start] == "g"

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
        new = self._say(line, axis, target, block.inch, word.incremental)
        return old if abs(value - self.said.last) < SAME and (value != 0.0 or old[0] != "-") else new

    def _head(self, block: Block, word: AxisWord, target: float) -> str:
        """What stands before an axis word's value; a way round that is no longer needed becomes the short way.

        ``C=ACP(30)`` from 30 stays there, but ``C=ACP(29.999)`` would go round once.
        """
        head = block.text[word.start : word.value_start]
        if word.form in ("ACP", "ACN") and abs(target - self.said.value[word.axis]) <= 180.0:
            at = head.upper().rindex(word.form)
            return f"{head[:at]}{'DC' if head[at].isupper() else 'dc'}{head[at + 3 :]}"
        return head

    def _added(self, line: int, block: Block, axis: int, target: float) -> str:
        name = self.names[axis].lower() if self.lower else self.names[axis]
        separator = "=" if len(name) > 1 else ""
        return f"{name}{separator}{self._say(line, axis, target, block.inch, block.incremental)}"

    def _say(self, line: int, axis: int, target: float, inch: bool, incremental: bool) -> str:
        if incremental and self.said.value[axis] != self.said.value[axis]:
            raise InputError(
                f"{self.names[axis]} is incremental where its position is unknown",
                expected="absolute position first",
                file=self.source,
                line=line + 1,
                value=self.names[axis],
            )
        inch = inch and axis < self.linear
        return self.said.say(axis, target, inch, incremental, self.style)

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

    def _faster(self, block: Block, span: Span, factor: int) -> str:
        """An inverse time feed for one of several pieces."""
        old = block.text[span.start : span.end]
        value = number(old)
        decimals = len(old.partition(".")[2])
        if not math.isfinite(value):
            value = 0.0
        return format_number(value * factor, max(4, decimals), style_of(old, self.style))
