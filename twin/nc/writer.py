"""Base of the ISO and Heidenhain writers: blocks rewritten word by word, every other byte kept."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, TypeVar, final

import numpy as np

from twin._common.errors import InputError
from twin.nc.arcs import moved_centre
from twin.nc.blocks import AxisWords, Kind, Move, Rewrite, WordFrame
from twin.nc.modal import AxisWord, Block, Span
from twin.nc.text import Grid, Style, apply_edits, ending, format_number, grid, number, style_of

Vector = tuple[float, float, float]
SAME_NUMBER = 1e-10
"""Numbers closer than this print alike: words have at most 9 decimals."""
_BARE = Style()
_SIGNED = Style(plus=True)


class OutputState:
    """The last value of every axis in the output program, mm and degrees, in program coordinates.

    A value is NaN when unknown (after a reference return, for example) and stale when it may not have been executed (after a block that
    the operator can skip). In both cases the next rewritten block writes the axis again.
    """

    def __init__(self, axes: AxisWords) -> None:
        self.names = axes.names
        self.linear = len(axes.linear)
        self.value: list[float] = [math.nan] * len(self.names)
        self.stale: list[bool] = [False] * len(self.names)
        plain = [grid(axes.increment[name], False) for name in self.names]
        inches = [grid(axes.increment[name], i < self.linear) for i, name in enumerate(self.names)]
        self._grids: tuple[list[Grid], list[Grid]] = (plain, inches)

    def _step(self, axis: int, target: float, inch: bool, incremental: bool) -> tuple[float, int]:
        """Set an axis to a target and return the number to write, with its decimals."""
        step, decimals, unit = self._grids[inch][axis]
        if incremental:
            start = self.value[axis]
            value = round((target - start) / unit / step) * step
            self.value[axis] = start + value * unit
        else:
            value = round(target / unit / step) * step
            self.value[axis] = value * unit
        self.stale[axis] = False
        return value, decimals

    def number_for(self, axis: int, target: float, inch: bool, incremental: bool, style: Style) -> str:
        """Set an axis to a target and return the number to write, formatted."""
        value, decimals = self._step(axis, target, inch, incremental)
        return format_number(value, decimals, style)

    def replace(
        self, axis: int, old: str, number: float, target: float, inch: bool, incremental: bool, style: Style
    ) -> str:
        """As `number_for`, but return the number as written if it already has the target value."""
        value, decimals = self._step(axis, target, inch, incremental)
        if -SAME_NUMBER < number - value < SAME_NUMBER:
            first = old[0]
            if (first != "-" or number != 0.0) and (first in "+-" or not style.plus):
                return old
        return format_number(value, decimals, style)

    def record(self, axis: int, value: float, incremental: bool) -> None:
        """Record a word of a block that passes through (mm, degrees; NaN: unknown)."""
        self.value[axis] = self.value[axis] + value if incremental else value
        self.stale[axis] = False

    def axes_to_write(self, row: Sequence[float], written: int, inch: bool) -> list[int]:
        """Return the axes that need a word to reach their targets (NaN: none); ``written``: axes that have a word already, as bits."""
        grids = self._grids[inch]
        axes_to_write = []
        for axis, target in enumerate(row):
            said = self.value[axis]
            if target != target or written >> axis & 1 or (target == said and not self.stale[axis]):
                continue
            if said == said and not self.stale[axis]:
                scale = grids[axis].step * grids[axis].unit
                if round(target / scale) == round(said / scale):
                    continue
            axes_to_write.append(axis)
        return axes_to_write

    def mark_unknown(self, which: Iterable[int]) -> None:
        """Mark axes as unknown."""
        for axis in which:
            self.value[axis] = math.nan

    def reframe(self, before: WordFrame, after: WordFrame) -> None:
        """Convert the values to another frame; one that then lies between least increments is unknown."""
        for axis, value in enumerate(before.converted(self.value, after)):
            step = self._grids[0][axis].step
            self.value[axis] = value if abs(math.remainder(value, step)) < SAME_NUMBER else math.nan

    def mark_stale(self, which: Iterable[int]) -> None:
        """Mark axes as stale."""
        for axis in which:
            self.stale[axis] = True


def vector_texts(vector: Sequence[float], decimals: int, plus: bool) -> tuple[str, str, str]:
    """Return the formatted components of a tool vector."""
    style = _SIGNED if plus else _BARE
    x, y, z = vector
    return format_number(x, decimals, style), format_number(y, decimals, style), format_number(z, decimals, style)


def length_text(value: float, increment: float, inch: bool, style: Style, *, up: bool = False) -> str:
    """Return a length in mm as a word of a program, rounded to a least increment in mm, ``up`` away from zero."""
    step, decimals, unit = grid(increment, inch)
    steps = value / unit / step
    whole = math.copysign(math.ceil(abs(steps) - 1e-6), steps) if up else round(steps)
    return format_number(whole * step, decimals, style)


# --- Axis words formatted together, with the same text as one by one (`twin.nc.text.format_number`)

LARGEST_STEPS: Final = 1e11
"""Larger values, in least increments, are written one by one: a double no longer holds all their decimals exactly."""
_MINUS, _PLUS, _ZERO, _POINT, _SPACE = b"-+0. "


@final
@dataclass(frozen=True)
class Formatting:
    """Number format at some place of a program, whether words are separated by spaces, whether letters are small."""

    style: Style
    spaced: bool
    lower: bool


@final
class Grids:
    """The steps of the axis words, for writing many together; increments are in mm and degrees."""

    def __init__(self, names: tuple[str, ...], increment: list[float]) -> None:
        grids = [grid(one, False) for one in increment]
        self.step = np.array([one.step for one in grids])
        self.decimals = np.array([one.decimals for one in grids])
        whole = self.step * 10.0**self.decimals
        self.scale = np.round(whole).astype(np.int64)
        self.exact = bool(np.all(np.abs(whole - self.scale) <= 1e-9 * whole))
        self.letters = np.array([ord(name[0].upper()) for name in names], dtype=np.uint8)
        self.own = np.array([ord(name[0]) for name in names], dtype=np.uint8)


def lines_of_words(
    rows: np.ndarray, said: OutputState, formatting: Formatting, grids: Grids, begin: str, ending: str
) -> str | None:
    """Return a line for each position after the first, with words for the axes that move; none for one at which no axis moves.

    ``rows``: (n, axes) positions, mm and degrees, of which the first has been written; NaN for axes without a target. ``said``: last
    values in the output, updated. ``begin``: text at the begin of each line. None (and nothing done) if an axis has a target only now
    and then, a value is too large or not known, or numbers cannot be written together in this format.
    """
    known = np.isfinite(rows)
    own = known[0]
    doubtful = [i for i in np.flatnonzero(own).tolist() if said.stale[i] or said.value[i] != said.value[i]]
    if doubtful or not (known == own).all() or formatting.style.comma or not grids.exact:
        return None
    steps = np.rint(np.where(own, rows, 0.0) / grids.step)
    if np.abs(steps).max(initial=0.0) >= LARGEST_STEPS:
        return None
    steps = steps.astype(np.int64)
    row, axis = np.nonzero(steps[1:] != steps[:-1])
    if not row.size:
        return ""
    opens = np.append(True, row[1:] != row[:-1])
    letters = grids.letters + 32 if formatting.lower else grids.own
    ends = np.zeros((len(row), 2), dtype=np.uint8)
    ends[np.append(opens[1:], True)] = np.frombuffer(ending.encode("latin-1").rjust(2, b"\0"), dtype=np.uint8)
    style = formatting.style
    text, _ = formatted_words(
        steps[1:][row, axis],
        axis,
        (style.point, np.full(len(row), style.min_decimals), style.leading_zero, style.plus),
        grids,
        ~opens & formatting.spaced,
        letters[axis],
        ends,
    )
    for i in set(axis.tolist()):
        said.value[i] = float(steps[-1, i] * grids.step[i])
    lines = text.tobytes().decode("latin-1")
    return begin + lines.replace(ending, ending + begin, int(opens.sum()) - 1) if begin else lines


def formatted_words(
    steps: np.ndarray,
    axis: np.ndarray,
    styles: tuple[np.ndarray | bool, np.ndarray, np.ndarray | bool, np.ndarray | bool],
    grids: Grids,
    spaced: np.ndarray,
    letter: np.ndarray,
    ending: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return words with numbers formatted as by `twin.nc.text.format_number`, concatenated, and the length of each.

    ``steps``: (n,) values in least increments; ``axis``: (n,) of each word; ``styles``: point, minimum decimals, leading zero, plus;
    ``spaced``: (n,) whether a space comes first; ``letter``: (n,) the following letter, ``ending``: (n, 2) characters after the number,
    0 for none.
    """
    point, min_decimals, leading_zero, plus = styles
    places = int(max(grids.decimals.max(initial=0), min_decimals.max(initial=0)))
    size = np.abs(steps) * grids.scale[axis]
    power = (10**grids.decimals)[axis]
    whole = size // power
    fraction = (size - whole * power) * (10 ** (places - grids.decimals))[axis]
    digits = len(str(int(whole.max(initial=0))))
    # One row per character position, for contiguous writes; characters not shown are zero and removed below.
    text = np.empty((digits + places + 6, len(steps)), dtype=np.uint8)
    text[0] = spaced * np.uint8(_SPACE)
    text[1] = letter
    text[2] = np.where(steps < 0, _MINUS, plus * np.uint8(_PLUS))
    _digits(whole, text[3 : 3 + digits])
    text[2 + digits] *= leading_zero | (whole > 0) | (fraction == 0)
    for i in range(1, digits):
        text[2 + digits - i] *= whole >= 10**i
    _digits(fraction, text[4 + digits : -2])
    wanted = np.array(min_decimals)
    for i in range(places):
        wanted[(text[4 + digits + i] != _ZERO) & (wanted <= i)] = i + 1
        # Digits are visited in order, so the last nonzero one decides.
    for i in range(places):
        text[4 + digits + i] *= wanted > i
    text[3 + digits] = ((wanted > 0) | point) * np.uint8(_POINT)
    text[-2:] = ending.T
    shown = np.ascontiguousarray(text.T).tobytes().translate(None, b"\0")
    return np.frombuffer(shown, dtype=np.uint8), np.sum(text != 0, axis=0, dtype=np.uint8).astype(int)


def _digits(number: np.ndarray, out: np.ndarray) -> None:
    """Write the decimal digits of whole numbers, as characters, into the rows of an array."""
    left = number
    for row in range(len(out) - 1, -1, -1):
        rest = left // 10
        out[row] = left - rest * 10 + _ZERO
        left = rest


# --- Base of the ISO and Heidenhain writers: blocks rewritten word by word, every other byte kept -

Segments = tuple[Rewrite, list[list[float]]]
"""A rewrite, and its positions as lists."""
Edit = tuple[int, int, str]


MANY: Final = 24
"""Number of segments of a block from which they are written together."""

B = TypeVar("B", bound=Block)


class WordWriter(ABC, Generic[B]):
    """Writer of a program block by block that keeps track of the values written (`said`).

    ``lower``: whether the program uses small letters.
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

    def rewritten(self, block: B, segments: Segments) -> list[str]:  # noqa: C901, PLR0912
        """Return the lines that replace a block, whose first move the segments replace."""
        rewrite, rows = segments
        many, start = len(rows) > 1, list(self.said.value)
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
        if rewrite.move.arc is not None and rewrite.move.whole:
            added += self._bent(block, rewrite.move, start, rows[0], edits)
        elif rewrite.move.kind is Kind.ARC:
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

    def _bent(self, block: B, move: Move, start: list[float], end: list[float], edits: list[Edit]) -> list[str]:
        """Give an arc that stays an arc its new centre or radius, as edits, and return the words that are missing.

        ``start``, ``end``: values of the axes before and behind the block. Languages without such arcs refuse it.
        """
        raise self._error(block, "arc under cutter radius compensation", "the tool centre path from the CAM system")

    def _error(self, block: B, what: str, expected: str) -> InputError:
        """Return an error at the current block."""
        return InputError(what, expected=expected, file=self.source, line=self._line + 1, value=block.text.strip())

    def _new_centre(self, block: B, move: Move, start: list[float], end: list[float]) -> tuple[float, float]:
        """Return the centre of an arc between new ends; raise `InputError` if the start is unknown."""
        a, b, _ = move.arc.plane  # type: ignore[union-attr]  # asked for arcs only
        if any(start[axis] != start[axis] or self.said.stale[axis] for axis in (a, b)):
            what = "arc under cutter radius compensation from a position that is not certain"
            raise self._error(block, what, "a block with both axes of the plane before it")
        here = (move.position[a], move.position[b])
        return moved_centre(move.arc, here, (start[a], start[b]), (end[a], end[b]))  # type: ignore[arg-type]

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
            what, name = f"incremental {self.names[axis]} while its position is unknown", self.names[axis]
            expected = "absolute position first"
            raise InputError(what, expected=expected, file=self.source, line=self._line + 1, value=name)

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
