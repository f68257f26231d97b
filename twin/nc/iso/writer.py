"""Writer of ISO programs: moves replaced in their blocks, every other byte kept."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Final, final

from twin.nc.arcs import ABSOLUTE, FROM_START
from twin.nc.blocks import AxisWords, Kind, Move, Rewrite
from twin.nc.dialect import as_comment
from twin.nc.iso.cycles import Drilling, Kept
from twin.nc.iso.frame import IsoBlock
from twin.nc.iso.vocabulary import DIRECTION_FORMS, POLAR, SHAPED
from twin.nc.modal import AxisWord, Span
from twin.nc.text import MM_PER_INCH, Style, apply_edits, ending, format_number, number, style_of
from twin.nc.writer import SAME_NUMBER, Edit, Segments, WordWriter, drop, length_text, vector_texts

VECTOR_DECIMALS: Final = 7
CODE: Final = {Kind.RAPID: 0, Kind.LINEAR: 1, Kind.ARC: 1}
"""Motion code of a rewritten move."""
_ARC_HEAD: Final = re.compile(r"[A-Za-z]+[ \t]*=?[ \t]*(?:(?P<form>[AaIi][Cc])[ \t]*\([ \t]*)?")
"""The text of a centre or radius before its number."""


@final
class IsoWriter(WordWriter[IsoBlock]):
    """Writer of an ISO program block by block that keeps track of the values written.

    Args:
        expand_cycles: whether drilling cycles are expanded into blocks; if not, none of their moves may be replaced.
        rigid_lines: 0-based indices of the lines that make threads rigid (M29 of Fanuc) which are expanded.

    Attributes:
        motion: motion code in force in the output (None: before the first, or uncertain).
        spaced: whether words are separated by spaces.
        wide: whether motion words have two digits.
    """

    def __init__(
        self,
        source: str,
        axes: AxisWords,
        newline: str,
        style: Style,
        *,
        expand_cycles: bool = False,
        rigid_lines: frozenset[int] = frozenset(),
    ) -> None:
        super().__init__(source, axes, newline, style)
        self.expand_cycles, self.rigid_lines = expand_cycles, rigid_lines
        self.motion: int | None = None
        self.spaced = True
        self.wide = False
        self._rigid = ""

    @property
    def separator(self) -> str:  # type: ignore[override]
        """The separator of words."""
        return " " if self.spaced else ""

    def block(self, line: int, block: IsoBlock, segments: Mapping[int, Segments] | None) -> str:
        """Return the output for one block (0-based line); ``segments``: replacements of its moves, by the index in the block."""
        self._line = line
        if block.tcp_switched or block.unknown_axes:
            self.said.mark_unknown(block.unknown_axes)
            if block.tcp_switched:
                self._vector_text = None
        declared = self._declared(block)
        if block.reframed is not None:
            self.said.reframe(*block.reframed)
        moves = block.moves
        if line in self.rigid_lines:
            return self._take_rigid(block)
        self._follow_codes(block)
        if block.positions and segments and 0 in segments:
            self._observe_format(block)
            text = "".join(self.rewritten(block, segments[0]))
        elif moves and block.positions:
            text = self._unchanged_block(block)
        else:
            text = apply_edits(block.text, declared)
            if block.motion_word is not None:
                self.motion = block.motion
            if block.cycle_word is not None and self.expand_cycles:
                at = block.cycle_word.start
                text = f"{text[:at]};{text[at:]}"
            if block.cycle_words and self.expand_cycles and block.drilling is None:
                text = self._without_cycle(block, text)
        self._mark_stale(block)
        return text if block.drilling is None else self._drilled(block, block.drilling, segments or {}, text)

    def _declared(self, block: IsoBlock) -> list[Edit]:
        """Return the edits by which words declare the output's present position, so that the coordinates are those of the program."""
        edits: list[Edit] = []
        for word, at in block.declared:
            said = self.said.value[word.axis]
            if said != said:
                name = self.names[word.axis]
                what = f"the present position of {name} is declared anew, but unknown in the output"
                raise self._error(block, what, f"a move to a position of {name} before it")
            if abs(said - at) > SAME_NUMBER:
                unit = MM_PER_INCH if block.inch and word.axis < self.linear else 1.0
                text = format_number((word.value + said - at) / unit, 9, self.style)
                edits.append((word.value_start, word.value_end, text))
        return edits

    def _follow_codes(self, block: IsoBlock) -> None:
        """Take over the effect of G words on the motion code in force and on rigid tapping."""
        ends = any(span.name == "80" for span in block.codes)
        if ends or block.motion_word is not None:
            self._rigid = ""
        if ends:
            self.motion = None  # LinuxCNC has no motion code in force after it
        if block.cycle_words and not self.expand_cycles:
            self.motion = block.motion  # a cycle of Fanuc is in force

    def _take_rigid(self, block: IsoBlock) -> str:
        """Take over rigid tapping for the threads after a block, and return the block as a comment, followed by its feed unit.

        The control refuses a move between it and the thread, and a motion word ends its effect. So it is written again before every
        thread, not where it stood.
        """
        others = [item for item in block.others if item.name != "S"]
        codes = [span for span in block.codes if span.name not in ("94", "95")]
        if any((block.skip, block.m_words[1:], others, block.items, codes, block.names)):
            raise self._error(block, "rigid tapping M29", "a block of its own (M29 S…) before G84 or G74")
        self._rigid = " ".join(["M29", *(block.text[item.start : item.end].strip() for item in block.others)])
        end = ending(block.text) or self.newline
        kept = "".join(f"{block.text[span.start : span.end]}{end}" for span in block.codes)
        return f"({as_comment(block.text, '()')}){end}{kept}"

    def _drilled(self, block: IsoBlock, drilling: Drilling, segments: Mapping[int, Segments], text: str) -> str:
        """Return a block that drills, with its strokes or, not changed, recorded where it ends; ``text``: its positioning."""
        if self.expand_cycles:
            text = self._without_cycle(block, text)
            return text + self._strokes(block, drilling, segments, text)
        last = block.moves[-1].position if block.moves else ()
        height = drilling.level if drilling.level == drilling.level or not last else last[block.drilling_axis]
        if height == height:
            self.said.record(block.drilling_axis, height, False)
        places = block.pattern[-1] if block.pattern else dict(enumerate(last[:2])) if block.polar_step else {}
        for axis, value in places.items():
            self.said.record(axis, value, False)
        for word in block.words if block.repeats > 1 else ():
            if word.incremental and not block.polar_step:
                self.said.record(word.axis, (block.repeats - 1) * word.value, True)
        return text

    def _mark_stale(self, block: IsoBlock) -> None:
        """Mark everything as uncertain after a block that the operator can skip."""
        if block.skip:
            self.said.mark_stale(range(len(self.names)))
            self._vector_text = None
            self.motion = None

    def _unchanged_block(self, block: IsoBlock) -> str:
        """Return a block whose move is unchanged; its motion word is added if the modal state of the output differs."""
        text, edits, move = block.text, list[Edit](), block.moves[0]
        polar = [word for word in block.words if word.form == POLAR and not move.passes]
        if polar and block.repeats > 1 and block.polar_step and not self.expand_cycles:
            self._check_polar_start(block, polar)
        else:
            edits += [self._replaced(block, word, move.position[word.axis]) for word in polar]
        reached = {word.axis: self.said.value[word.axis] for word in polar}
        self.record(block)
        for axis, value in reached.items():
            self.said.record(axis, value, False)
        if self.expand_cycles:
            drop(block, block.cycle_words, edits)
        stale = self.motion is None and block.drilling is not None and not self.expand_cycles
        if block.motion_word is None and block.motion is not None and self.motion != block.motion and not stale:
            starts = [word.start for word in block.words] + [word.start for word in block.arc_words]
            at = min(starts, default=block.head_end)
            separator = " " if self.spaced or not text[at - 1 : at].isspace() else ""
            edits.append((at, at, f"{self.g(block.motion)}{separator}"))
        if block.motion is not None:
            self.motion = block.motion
        return apply_edits(text, edits) if edits else text

    def _check_polar_start(self, block: IsoBlock, polar: list[AxisWord]) -> None:
        """Raise `InputError` for holes by angles from a place that has been corrected, in a cycle that is not expanded."""
        for word in polar:
            start = block.moves[0].position[word.axis] - word.value
            if abs(self.said.value[word.axis] - start) > SAME_NUMBER:
                raise self._error(block, "holes by polar increments from a corrected place", "polar words in G90")
            self.said.record(word.axis, block.moves[0].position[word.axis], False)

    def _without_cycle(self, block: IsoBlock, text: str) -> str:
        """Return the positioning of a block that states a cycle, with the original block in a comment before it."""
        if not block.cycle_words:
            return text
        if not block.positions or block.drilling is None:
            edits: list[Edit] = []
            drop(block, block.cycle_words, edits)
            text = apply_edits(text, edits)
        return f"({as_comment(block.text, '()')}){ending(block.text) or self.newline}{text}"

    def _strokes(self, block: IsoBlock, drilling: Drilling, segments: Mapping[int, Segments], text: str) -> str:
        """Return the strokes of a drilling cycle as blocks."""
        end = ending(block.text) or self.newline
        out = [] if ending(text) else [end]
        place = 1 if block.positions else 0
        for stroke in drilling.strokes:
            if stroke.height == stroke.height:
                move = block.moves[place]
                for row in segments[place][1] if place in segments else [list(move.position)]:
                    words = self._missing(block, row, 0) or self._again(block, row)
                    code = CODE[move.kind]
                    if words and self.motion != code:
                        words.insert(0, self.g(code))
                        self.motion = code
                    if words:
                        out.append(block.skip + " ".join([*words, *([stroke.feed] if stroke.feed else [])]) + end)
                place += 1
            if stroke.kept is not None:
                rigid = [self._rigid] if self._rigid and stroke.kept.thread else []
                out += [f"{block.skip}{text}{end}" for text in (*rigid, self._own(block, drilling, stroke.kept))]
            if stroke.after:
                out.append(block.skip + stroke.after + end)
        self._mark_stale(block)
        return "".join(out)

    def _again(self, block: IsoBlock, row: list[float]) -> list[str]:
        """Return the word of the drilling axis for a stroke to where it stands, unless unknown: rounding may have left no way to it."""
        height = row[block.drilling_axis]
        return [self._added(block, block.drilling_axis, height)] if math.isfinite(height) else []

    def _own(self, block: IsoBlock, drilling: Drilling, kept: Kept) -> str:
        """Return the control's own cycle at the height reached, its heights shifted by the correction there."""
        axis = block.drilling_axis
        reached = self.said.value[axis]
        parts = kept.parts if kept.relative is None or not block.incremental else kept.relative
        shift = reached - kept.top if parts is kept.parts else 0.0
        texts: list[str] = []
        for place, part in enumerate(parts):
            if isinstance(part, str):
                texts.append(part)
            elif place == kept.exact:
                texts.append(format_number((part + shift) / (MM_PER_INCH if block.inch else 1.0), 9, self.style))
            else:
                texts.append(self.said.number_for(axis, part + shift, block.inch, False, self.style))
                if part == drilling.level:
                    reached = self.said.value[axis]
        self.said.record(axis, reached, False)
        self.motion = None  # the control's own cycle is in force
        return "".join(texts)

    # ------------------------------------------------------------------ one block

    def _observe_format(self, block: IsoBlock) -> None:
        """Record how the program separates words and whether its letters are small."""
        words, text = [word for word in block.words if word.form != POLAR], block.text
        if words:
            first = words[0].start
            if len(words) > 1:
                self.spaced = text[words[1].start - 1] in " \t"
            elif first > 0 and (block.motion_word is not None or block.head_end > 0):
                self.spaced = text[first - 1] in " \t"
            self.lower = text[first].islower()
        elif block.motion_word is not None:
            self.lower = text[block.motion_word.start] == "g"

    def record(self, block: IsoBlock) -> None:
        """See `WordWriter.record`: words in place of an end point, too, say where it ends."""
        super().record(block)
        move = block.moves[0]
        for axis, name in enumerate(self.names if block.path_words and not move.passes else ()):
            if name in move.named and not block.axis_bits >> axis & 1:
                self.said.record(axis, move.position[axis], False)

    def _begin(self, block: IsoBlock, rewrite: Rewrite, edits: list[Edit]) -> str:
        """Change the motion word to a straight move; return the motion word to insert, if one is needed."""
        if self.expand_cycles:
            drop(block, block.cycle_words, edits)
        drop(block, block.path_words, edits)
        code = CODE[rewrite.move.kind] if block.motion is not None else None
        if rewrite.move.arc is not None and rewrite.move.whole:
            code = 2 if rewrite.move.arc.angle_rad < 0.0 else 3
        before, self.motion = self.motion, self.motion if code is None else code
        span = block.motion_word
        if span is not None:
            self.motion = code
            if span.name == "CIP":
                edits.append((span.start, span.end, self.g(code or 0)))
            elif span.name in SHAPED:
                return ""
            self.wide = span.name != "CIP" and len(block.text[span.start + 1 : span.end].strip()) > 1
            if block.motion != code and span.name != "CIP":
                repeated = [one for one in block.codes if one.name == str(block.motion)]
                edits += ((one.end - 1, one.end, str(code)) for one in repeated or [span])
            return ""
        return "" if code is None or before == code else self.g(code)

    def _bent(self, block: IsoBlock, move: Move, start: list[float], end: list[float], edits: list[Edit]) -> list[str]:
        a, b, _ = move.arc.plane  # type: ignore[union-attr]  # asked for arcs only
        centre = dict(zip((a, b), self._new_centre(block, move, start, end), strict=True))
        by_radius = any(span.name in ("R", "CR") for span in block.arc_words)
        written: set[int] = set()
        for span in block.arc_words:
            head = _ARC_HEAD.match(block.text, span.start, span.end)
            if head is None or span.name in ("P", "TURN"):
                continue
            if by_radius:
                radius = math.hypot(start[a] - centre[a], start[b] - centre[b])
                # A radius is written negative for more than half a circle.
                over = abs(move.arc.angle_rad) > math.pi + 1e-9  # type: ignore[union-attr]
                value = -radius if over else radius
            else:
                axis = "IJK".index(span.name)
                if axis not in centre:
                    continue
                written.add(axis)
                wrapped = ABSOLUTE if (head["form"] or "").upper() == "AC" else FROM_START
                value = (wrapped if head["form"] else block.centres).word(start[axis], centre[axis])
            number = self._length(value, block, a, up=by_radius)
            edits.append((span.start, span.end, f"{head[0]}{number}{')' if head['form'] else ''}"))
        if by_radius:
            return []
        missing = [axis for axis in (a, b) if axis not in written]
        words = [(axis, block.centres.word(start[axis], centre[axis])) for axis in missing]
        texts = [("ijk" if self.lower else "IJK")[axis] + self._length(value, block, a) for axis, value in words]
        absolute = block.centres is ABSOLUTE
        return [text for text, (_, value) in zip(texts, words, strict=True) if absolute or abs(value) > 1e-9]

    def _length(self, value: float, block: IsoBlock, axis: int, *, up: bool = False) -> str:
        """Return a length in the format of the program, rounded to the increment of an axis, ``up`` away from zero."""
        return length_text(value, float(self.grids.step[axis]), block.inch, self.style, up=up)

    def _insert(self, block: IsoBlock, begin: str, added: list[str], tool: list[str], edits: list[Edit]) -> str:
        text, separator = block.text, self.separator
        words = added + tool
        if begin and block.words:
            first = min(word.start for word in block.words)
            edits.append((first, first, f"{begin}{separator}"))
        elif begin:
            words = [begin, *words]
        if not words:
            return block.skip
        joined = separator.join(words)
        if block.words or block.motion_word is not None:
            at = max([word.end for word in block.words] or [block.motion_word.end if block.motion_word else 0])
            glue = separator or (" " if not text[at - 1].isdigit() and text[at - 1] != "." else "")
            edits.append((at, at, f"{glue}{joined}"))
            return block.skip
        at = block.head_end
        before = separator if at > 0 and text[at - 1 : at].isalnum() else ""
        after = separator if text[at:].strip() and not text[at : at + 1].isspace() else ""
        edits.append((at, at, f"{before}{joined}{after}"))
        return block.skip

    def _tails(self, block: IsoBlock, rewrite: Rewrite, edits: list[Edit]) -> list[str]:
        """Return the inverse time feed of each segment."""
        if not block.inverse_time or block.motion is None or CODE[rewrite.move.kind] != 1:
            return []
        span, rows = block.feed, len(rewrite.positions)
        if span is None:
            what = "block with inverse time feed (G93) but without F cannot be split"
            raise self._error(block, what, "an F word in every block with G93")
        factors = [float(rows)] * rows if rewrite.shares is None else (1.0 / rewrite.shares).tolist()
        feeds = [self._segment_feed(block, span, factor) for factor in factors]
        edits.append((span.start, span.end, feeds[0]))
        letter = block.text[span.start - 1]
        return [f"{letter if letter.upper() == 'F' else 'F'}{feed}" for feed in feeds]

    def _segment_feed(self, block: IsoBlock, span: Span, factor: float) -> str:
        """Return the inverse time feed of one of several segments."""
        old = block.text[span.start : span.end]
        value = number(old)
        decimals = max(4, len(old.partition(".")[2]))
        return format_number((value if math.isfinite(value) else 0.0) * factor, decimals, style_of(old, self.style))

    # ------------------------------------------------------------------ words

    def g(self, code: int) -> str:
        """Return a motion word in the format of the program."""
        return f"{'g' if self.lower else 'G'}{'0' if self.wide else ''}{code}"

    def _number(self, block: IsoBlock, word: AxisWord, target: float) -> str:
        if word.form not in DIRECTION_FORMS:
            return super()._number(block, word, target)
        old = block.text[word.value_start : word.value_end]
        value = number(old)
        self.style = style_of(old, self.style) if value == value else self.style
        self.said.number_for(word.axis, target, block.inch, False, self.style)
        turn = self.said.value[word.axis] % 360.0
        return format_number(turn, 9, self.style._replace(min_decimals=0)) if turn < 359.9999999995 else "0"

    def _replaced(self, block: IsoBlock, word: AxisWord, target: float) -> Edit:
        if word.form == POLAR:
            between = self.separator if word.start > block.head_end and block.text[word.start - 1] in "@^" else ""
            return word.start, word.end, between + self._added(block, word.axis, target)
        head = self._head(block, word, target)
        start, end, new = super()._replaced(block, word, target)
        return (word.start, end, head + new) if head else (start, end, new)

    def _head(self, block: IsoBlock, word: AxisWord, target: float) -> str:
        """Return the text before the value of a word with ``ACP`` or ``ACN``; ``DC`` replaces a direction that is no longer needed.

        ``C=ACP(30)`` from 30 does not move, but ``C=ACP(29.999)`` would make a full turn.
        """
        if word.form not in ("ACP", "ACN"):
            return ""
        head = block.text[word.start : word.value_start]
        if abs(target - self.said.value[word.axis]) > 180.0:
            return head
        at = head.upper().rindex(word.form)
        return f"{head[:at]}{'DC' if head[at].isupper() else 'dc'}{head[at + 3 :]}"

    def _later(self, block: IsoBlock, row: list[float], vector: list[float] | None) -> list[str]:
        forms = {word.axis: word for word in block.words if word.form not in ("", POLAR)}
        if not forms:
            return super()._later(block, row, vector)
        words = []
        for axis in self.said.axes_to_write(row, 0, block.inch):
            word = forms.get(axis)
            if word is None:
                words.append(self._added(block, axis, row[axis]))
            else:
                before = self._head(block, word, row[axis]) or block.text[word.start : word.value_start]
                after = block.text[word.value_end : word.end]
                words.append(f"{before}{self._number(block, word, row[axis])}{after}")
        return words + ([] if vector is None else self._vector(block, vector, None))

    def _vector_words(self, vector: list[float]) -> tuple[str, str, str]:
        return vector_texts(vector, VECTOR_DECIMALS, False)

    def _vector_names(self, block: IsoBlock) -> tuple[str, ...]:
        names = block.vector_names or ()
        return tuple(name.lower() for name in names) if self.lower else names
