"""Simple lines of an ISO program read and written all at once, with the bytes in arrays and no object per line or word.

Simple lines have a block number, ``G0`` or ``G1``, axis words in the usual order and a feed. Numbers have at most 15 digits, so that
the digits form an exact whole number and the division by an exact power of ten rounds once, as a correctly rounded conversion does. All
other lines go through the interpreter of blocks.

The format of a word depends on the words before it (`twin.nc.text.style_of`): each sets some attributes of the style and keeps the
others. Each attribute at a word is therefore the last value set, which is computed for all words together.
"""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final, final

import numpy as np

from twin.compute.native import compiler
from twin.nc.blocks import AxisWords, line_ends
from twin.nc.text import Style, count_of
from twin.nc.writer import SAME_NUMBER, Formatting, Grids, OutputState, formatted_words

MOST_DIGITS: Final = 15
"""Number of decimal digits up to which a double holds every whole number."""
_WHOLE_DIGITS: Final = 9
"""Number of digits before the point of a number of plausible size."""
_ORDER: Final = "XYZABCUVW"
"""The order in which nearly all programs write their words; other orders go through the tokeniser."""
_OTHER, _LETTER, _DIGIT, _SIGN, _POINT, _BLANK, _END = range(7)
_FOLLOWS: Final = {
    _LETTER: (_DIGIT, _SIGN, _POINT),
    _DIGIT: (_DIGIT, _POINT, _BLANK, _LETTER, _END),
    _SIGN: (_DIGIT, _POINT),
    _POINT: (_DIGIT, _BLANK, _LETTER, _END),
    _BLANK: (_BLANK, _LETTER, _END),
    _END: (_BLANK, _LETTER, _END),
}
"""Kinds of character that may follow each kind in a simple line."""
_NUMBER, _CODE, _FEED = -3, -2, -1
NOTE: Final = re.compile(rb"[ \t]*+(?:[Nn]\d++[ \t]*+)?+(?:;[^\r\n]*+|\([^()\r\n]*+\)[ \t]*+)[\r\n]*+")
"""Comment lines without anything else, among the lines for which `twin.nc.iso.interpreter.Interpreter.step` returns None."""
_MINUS, _PLUS, _ZERO, _SPACE = b"-+0 "


@final
@dataclass(frozen=True)
class Words:
    """The axis words of simple lines, in the order of the text.

    Attributes:
        line: (n,) index of the word's line in the text.
        axis: (n,) index of its axis.
        start, end: (n,) range of its value.
        sign: (n,) the character code of its sign, 0 if there is none.
        whole, fraction: (n,) number of digits before and after the point.
        point: (n,) whether it has a point.
        padded: (n,) whether its last character is a 0.
    """

    line: np.ndarray
    axis: np.ndarray
    start: np.ndarray
    end: np.ndarray
    value: np.ndarray
    sign: np.ndarray
    whole: np.ndarray
    fraction: np.ndarray
    point: np.ndarray
    padded: np.ndarray


@final
@dataclass(frozen=True)
class Scan:
    """A chunk of a program, in whole lines.

    Attributes:
        text: (n,) the bytes as numbers.
        start, end: (lines,) range of each line, including its ending.
        simple: (lines,) whether the line is simple.
        blank: (lines,) whether it is empty or a comment.
        code: (lines,) the motion code of a simple line, -1 if it has none.
        wide: (lines,) whether the motion code has two digits.
        first: (lines + 1,) index of the first word of each line.
    """

    data: bytes
    text: np.ndarray
    start: np.ndarray
    end: np.ndarray
    simple: np.ndarray
    blank: np.ndarray
    code: np.ndarray
    wide: np.ndarray
    words: Words
    first: np.ndarray

    def line(self, index: int) -> str:
        """Return one line as text."""
        return self.data[self.start[index] : self.end[index]].decode("latin-1")


def simple_axis_letters(names: tuple[str, ...]) -> str:
    """Return the axes a simple line can name, in order; none if an axis has a letter with another meaning."""
    letters = [name.upper() for name in names if len(name) == 1]
    return "".join(sorted(letters, key=_ORDER.index)) if all(letter in _ORDER for letter in letters) else ""


@lru_cache(maxsize=16)
def tables(names: tuple[str, ...]) -> tuple[bytes, np.ndarray, np.ndarray, bytes]:
    """Return tables by character (kind, rank among the words of a line, axis), and whether each pair of kinds is forbidden."""
    kind, rank, axis = bytearray(256), np.zeros(256, dtype=np.int8), np.full(256, _FEED, dtype=np.int8)
    for characters, which in (
        (b"0123456789", _DIGIT),
        (b"+-", _SIGN),
        (b".", _POINT),
        (b" \t", _BLANK),
        (b"\r\n", _END),
    ):
        for code in characters:
            kind[code] = which
    letters = simple_axis_letters(names)
    places = {"N": (0, _NUMBER), "G": (1, _CODE), "F": (len(letters) + 2, _FEED)}
    places |= {letter: (2 + i, [name.upper() for name in names].index(letter)) for i, letter in enumerate(letters)}
    for letter, (place, which) in places.items() if letters else ():
        for code in (ord(letter), ord(letter.lower())):
            kind[code], rank[code], axis[code] = _LETTER, place, which
    bad = bytearray(b"\1" * 256)
    for before, behind in _FOLLOWS.items():
        for one in behind:
            bad[before << 3 | one] = 0
    return bytes(kind), rank, axis, bytes(bad)


def scan(data: bytes, names: tuple[str, ...]) -> Scan:  # noqa: PLR0915
    """Find and read the simple lines of a chunk of whole lines; only the last line of a program may lack its ending."""
    text = np.frombuffer(data, dtype=np.uint8)
    kind_of, rank_of, axis_of, bad_pair = tables(names)
    end = line_ends(text, data) + 1
    if len(data) and (not end.size or end[-1] < len(data)):
        end = np.append(end, len(data))
    lines = len(end)
    start = np.concatenate([np.zeros(min(lines, 1), dtype=end.dtype), end[:-1]])
    kind = np.frombuffer(data.translate(kind_of), dtype=np.uint8)
    pairs = kind[:-1] << 3
    pairs |= kind[1:]
    bad = np.frombuffer(pairs.tobytes().translate(bad_pair), dtype=bool)
    simple = np.ones(lines, dtype=bool)
    # A pair across a line end belongs to the following line: it checks how that begins.
    simple[np.searchsorted(end, np.flatnonzero(bad) + 1, side="right")] = False
    if lines:
        simple[0] &= not bad_pair[_END << 3 | int(kind[0])]
        simple[-1] &= bool(kind[-1] == _END)
    if not simple.all():
        kind = np.where(np.repeat(simple, end - start), kind, _OTHER)
    # In simple lines every letter is followed by one number, and there are no other numbers.
    lettered = kind == _LETTER
    letters, points = np.flatnonzero(lettered), np.flatnonzero(kind == _POINT)
    of = np.cumsum(lettered, dtype=np.int32).take(points) - 1
    numeric = (kind >= _DIGIT) & (kind <= _POINT)
    stops = np.flatnonzero(numeric[:-1] > numeric[1:]) + 1
    per_line = np.diff(np.searchsorted(letters, end), prepend=0)
    blank = simple & (per_line == 0)
    blank[[i for i in np.flatnonzero(~simple).tolist() if NOTE.fullmatch(data, start[i], end[i])]] = True
    line = np.repeat(np.arange(lines), per_line)
    char = text[letters]
    rank, axis = rank_of.take(char), axis_of.take(char)
    good = np.ones(len(letters), dtype=bool)
    good[1:] = (line[1:] != line[:-1]) | (rank[1:] > rank[:-1])
    begin = letters + 1
    sign = text.take(begin)
    signed = (sign == _MINUS) | (sign == _PLUS)
    sign = np.where(signed, sign, 0)
    good[of[1:][of[1:] == of[:-1]]] = False
    at = stops.copy()
    at[of] = points
    point = at < stops
    whole = at - begin - signed
    fraction = stops - at - point
    number, code = axis == _NUMBER, axis == _CODE
    good &= (whole <= _WHOLE_DIGITS) | number
    good &= (whole + fraction >= 1) & ((whole + fraction <= MOST_DIGITS) | number)
    good &= ~((number | code) & (signed | point))
    codes = np.flatnonzero(code)
    said, width = text[stops[codes] - 1] - _ZERO, whole[codes]
    good[codes] &= (said <= 1) & ((width == 1) | ((width == 2) & (text[begin[codes]] == _ZERO)))
    simple[line[~good]] = False
    known = simple[line]
    which = np.flatnonzero((axis >= 0) & known)
    # The numbers of simple lines, in order, one per letter.
    digits = np.where(numeric & np.repeat(simple, end - start), text, np.uint8(_SPACE)).tobytes()
    values = np.fromstring(digits, sep=" ")[axis[known] >= 0]
    named = np.bincount(line[which], minlength=lines)
    simple &= named > 0
    motion, wide = np.full(lines, -1, dtype=np.int8), np.zeros(lines, dtype=bool)
    motion[line[codes]], wide[line[codes]] = said.astype(np.int8), width > 1
    motion[~simple] = -1
    stops, whole, fraction, sign = stops.take(which), whole.take(which), fraction.take(which), sign.take(which)
    words = Words(
        line=line.take(which).astype(np.int32),
        axis=axis.take(which),
        start=begin.take(which).astype(np.int32),
        end=stops.astype(np.int32),
        value=values,
        sign=sign,
        whole=whole.astype(np.int16),
        fraction=fraction.astype(np.int16),
        point=point.take(which),
        padded=text.take(stops - 1) == _ZERO,
    )
    first = np.concatenate([[0], np.cumsum(np.where(simple, named, 0))])
    return Scan(data, text, start, end, simple, blank, motion, wide, words, first)


# --- Simple lines written together: words replaced as `twin.nc.iso.writer.IsoWriter` does one by one

_UNKNOWN: Final = np.iinfo(np.int64).min


def _with_replacements(
    text: np.ndarray, start: np.ndarray, end: np.ndarray, length: np.ndarray, new: np.ndarray
) -> bytes:
    """Return a text with ranges replaced, (n,) beginnings and ends, by texts of (n,) lengths, concatenated in ``new``.

    They do not overlap, and insertions at one place are in order.
    """
    order = np.argsort(start, kind="stable")
    start, end = start[order], end[order]
    content_at = (np.cumsum(length) - length + len(text))[order]
    begins, lengths = np.empty(2 * len(start) + 1, dtype=np.int64), np.empty(2 * len(start) + 1, dtype=np.int64)
    begins[0], begins[2::2], begins[1::2] = 0, end, content_at
    lengths[1::2] = length[order]
    lengths[0:-1:2] = start - begins[0:-1:2]
    lengths[-1] = len(text) - begins[-1]
    behind = np.cumsum(lengths)
    places = np.repeat((begins - behind + lengths).astype(np.int32), lengths)
    places += np.arange(len(places), dtype=np.int32)
    return np.concatenate([text, new])[places].tobytes()


def rewritten_lines(
    scan: Scan,
    whole: slice,
    lines: np.ndarray,
    count: np.ndarray,
    targets: np.ndarray,
    said: OutputState,
    formatting: Formatting,
    grids: Grids,
) -> tuple[bytes, Formatting]:
    """Return the new text of a range with simple lines, consecutive except for blank ones, and the formatting after the last line.

    ``whole``: the range of the text that contains the lines; ``count``: (lines,) number of segments of each; ``targets``: (segments,
    axes) end positions, mm and degrees, NaN in the columns of axes that are not written; ``said``: last values in the output, updated;
    ``formatting``: before the first of the lines.
    """
    segments = _Segments(scan, lines, count, targets, said, grids)
    of, words = segments.of_word, segments.words
    styles = _Styles(words, formatting.style)
    second = np.diff(scan.first)[lines] > 1
    first = segments.first_word
    letter = words.start[first] - 1
    before = scan.text[
        np.maximum(np.where(second, words.start[np.minimum(first + 1, len(words.start) - 1)] - 1, letter) - 1, 0)
    ]
    shown = second | segments.headed
    spaced = _forward_filled(np.where(shown, (before == _SPACE) | (before == 9), -1), formatting.spaced).astype(bool)
    lower = scan.text[letter] >= ord("a")
    # Words in the text whose value changes.
    steps = segments.steps.take(of * segments.steps.shape[1] + words.axis)
    same = np.abs(words.value - steps * grids.step[words.axis]) < SAME_NUMBER
    same &= ~((words.value == 0.0) & (words.sign == _MINUS)) & ~((words.sign == 0) & styles.plus)
    new = np.flatnonzero(~same)
    # Words that are missing in the text.
    row, axis = np.nonzero(segments.missing)
    line = segments.line[row]
    last_word = segments.last_word[line]
    extra = row != segments.head[line]
    opens = extra & np.append(True, row[1:] != row[:-1])[: len(row)]
    closes = extra & np.append(row[1:] != row[:-1], True)[-len(row) :] if len(row) else extra
    word = np.concatenate([new, last_word])
    letters = np.where(lower[line], grids.letters[axis] + 32, grids.own[axis]).astype(np.uint8)
    text, length = formatted_words(
        np.concatenate([steps[new], segments.steps[row, axis]]),
        np.concatenate([words.axis[new], axis]),
        styles.at(word),
        grids,
        np.concatenate([np.zeros(len(new), dtype=bool), spaced[line] & ~opens]),
        np.concatenate([np.zeros(len(new), dtype=np.uint8), letters]),
        np.concatenate(
            [np.zeros((len(new), 2), dtype=np.uint8), np.where(closes[:, None], _ending(scan, lines)[line], 0)]
        ),
    )
    behind = np.where(extra, scan.end[lines][line], words.end[last_word])
    start, end = np.concatenate([words.start[new], behind]), np.concatenate([words.end[new], behind])
    written = _with_replacements(scan.text[whole], start - whole.start, end - whole.start, length, text)
    for i in range(len(grids.step)):
        if np.any(words.axis == i) or np.any(axis == i):
            said.value[i] = float(segments.steps[-1, i] * grids.step[i])
            said.stale[i] = False
    return written, Formatting(styles.last(), bool(spaced[-1]), bool(lower[-1]))


@final
class _Segments:
    """The segments of some lines, and which words they need in addition to those in the text."""

    def __init__(
        self, scan: Scan, lines: np.ndarray, count: np.ndarray, targets: np.ndarray, said: OutputState, grids: Grids
    ) -> None:
        begin, end = scan.first[lines[0]], scan.first[lines[-1] + 1]
        all_words = scan.words
        self.words = Words(**{name: getattr(all_words, name)[begin:end] for name in Words.__dataclass_fields__})
        self.first_word = scan.first[lines] - begin
        self.last_word = scan.first[lines + 1] - begin - 1
        self.head = np.cumsum(count) - count
        self.line = np.repeat(np.arange(len(lines)), count)
        self.of_word = np.repeat(self.head, self.last_word - self.first_word + 1)
        known = np.isfinite(targets[0])
        with np.errstate(invalid="ignore"):
            self.steps = np.where(known, np.rint(targets / grids.step), 0.0).astype(np.int64)
        begins = [
            _UNKNOWN if said.stale[i] or value != value else int(np.rint(value / grids.step[i]))
            for i, value in enumerate(said.value)
        ]
        self.missing = np.empty(self.steps.shape, dtype=bool)
        self.missing[0] = self.steps[0] != begins
        np.not_equal(self.steps[1:], self.steps[:-1], out=self.missing[1:])
        self.missing &= known
        self.missing[self.of_word, self.words.axis] = False
        # Whether any word stands before the first axis word.
        letter = self.words.start[self.first_word] - 1
        start = scan.start[lines]
        self.headed = np.zeros(len(lines), dtype=bool)
        at = start.copy()
        for _ in range(int((letter - start).max(initial=0))):
            within = at < letter
            self.headed |= within & (scan.text[at] > _SPACE)
            at += within
            if np.all(self.headed | (at >= letter)):
                break


@final
class _Styles:
    """The style in force after every word (`twin.nc.text.style_of`)."""

    def __init__(self, words: Words, style: Style) -> None:
        zero = words.value == 0.0
        tells = words.fraction > 0
        round_ = ~tells & (words.point | ~zero)
        point = np.where(round_, words.point, -1)
        min_decimals = np.where(round_, 0, -1)
        padded = tells & words.padded
        point[padded], min_decimals[padded] = 0, words.fraction[padded]
        leading_zero = np.where(words.point & (words.whole == 0), 0, -1)
        leading_zero[tells & (words.whole == 1) & (np.abs(words.value) < 1.0) & ~zero] = 1
        plus = np.where(words.sign == _PLUS, 1, np.where(words.sign == _MINUS, -1, 0))
        self.point = _forward_filled(point, style.point)
        self.min_decimals = _forward_filled(min_decimals, style.min_decimals)
        self.leading_zero = _forward_filled(leading_zero, style.leading_zero)
        self.plus = _forward_filled(plus, style.plus).astype(bool)

    def at(self, word: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return point, minimum decimals, leading zero and plus after some words."""
        point, leading_zero = self.point[word].astype(bool), self.leading_zero[word].astype(bool)
        return point, self.min_decimals[word], leading_zero, self.plus[word]

    def last(self) -> Style:
        """Return the style after the last word."""
        return Style(
            bool(self.point[-1]), int(self.min_decimals[-1]), bool(self.leading_zero[-1]), bool(self.plus[-1]), False
        )


def _forward_filled(values: np.ndarray, before: int) -> np.ndarray:
    """Return (n,) each value, or the last one before it that is not -1."""
    says = values >= 0
    if says.all():
        return values
    if not says.any():
        return np.full(len(values), before)
    at = np.flatnonzero(says)
    return np.repeat(np.append(before, values[at]), np.diff(at, prepend=0, append=len(values)))


def _ending(scan: Scan, lines: np.ndarray) -> np.ndarray:
    """Return (lines, 2) the characters that end each line, 0 for none."""
    end = scan.end[lines]
    two = (scan.text[end - 1] == 10) & (scan.text[np.maximum(end - 2, 0)] == 13)
    return np.stack([np.where(two, 13, 0), scan.text[end - 1]], axis=1).astype(np.uint8)


# --- The same in compiled code (`lines.cpp`) ------------------------------------------------------
# The arrays serve without a compiler and are the reference. Compiled code reads a line in 0.12 µs instead of 2.1, and `twin compensate`
# of 500,000 five-axis blocks takes 4.2 s of processor instead of 7.1 (60,000: 2.5 instead of 3.0).

_POINTERS: Final = ctypes.c_void_p
_TABLES: Final = ("text", "kind", "rank", "axis")
_LINES: Final = {
    "start": np.int64,
    "end": np.int64,
    "simple": np.bool_,
    "blank": np.uint8,
    "wide": np.bool_,
    "code": np.int8,
    "first": np.int64,
}
_WORDS: Final = {
    "word_line": np.int32,
    "word_axis": np.int8,
    "word_start": np.int32,
    "word_end": np.int32,
    "value": np.float64,
    "sign": np.uint8,
    "whole": np.int16,
    "fraction": np.int16,
    "point": np.bool_,
    "padded": np.bool_,
}
_READ: Final = tuple(name for name in _WORDS if name != "word_line")
_STYLE: Final = tuple(
    f"{'style_' if i < 4 else ''}{name}"
    for i, name in enumerate(("point", "min_decimals", "leading_zero", "plus", "spaced", "lower"))
)
_LONGEST_WORD: Final = 48
"""Most characters of a word: blank, letter, sign, 20 digits, point, `MOST_DIGITS` decimals."""
_SAMPLE: Final = b"%\nN10 G01 X-1.50 y+.25 Z3 B-0. C12 F100\r\n(note)\rX1 X2\nG2 X1\nX 1\n\nG1\nC.5"
_PLAIN: Final = Formatting(Style(), True, False)
_MAYBE_NOTE: Final = 2
"""Mark of a line that the compiled code leaves to the pattern of comments."""


class _Job(ctypes.Structure):
    """`Scanned` of lines.cpp, field by field."""

    _fields_ = (
        ("size", ctypes.c_int64),
        *((name, _POINTERS) for name in (*_TABLES, *_LINES, *_WORDS)),
        ("lines", ctypes.c_int64),
        ("words", ctypes.c_int64),
    )


class _RewriteJob(ctypes.Structure):
    """`Rewritten` of lines.cpp, field by field."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("begin", "stop", "lines", "axes")),
        ("text", _POINTERS),
        *((name, _POINTERS) for name in ("line", "start", "end", "first")),
        *((name, _POINTERS) for name in _READ),
        *((name, _POINTERS) for name in ("count", "targets", "step", "decimals", "scale", "letters", "own")),
        ("same_number", ctypes.c_double),
        *((name, _POINTERS) for name in ("said", "stale")),
        *((name, ctypes.c_int64) for name in _STYLE),
        ("out", _POINTERS),
        ("written", ctypes.c_int64),
    )


@final
@dataclass(frozen=True)
class _Compiled:
    """Reading and writing by a compiled library."""

    library: ctypes.CDLL

    def scan(self, data: bytes, names: tuple[str, ...]) -> Scan:
        """As `twin.nc.lines.scan`."""
        text = np.frombuffer(data, dtype=np.uint8)
        kind, rank, axis, _ = tables(names)
        given = dict(zip(_TABLES, (text, np.frombuffer(kind, np.uint8), rank, axis), strict=True))
        job = _Job(size=len(data))
        # Upper bounds: memory that is not written is not taken.
        lines = count_of(data, ord("\n")) + count_of(data, ord("\r")) + 2
        words = len(data) // 2 + 1
        room: dict[str, np.ndarray] = {
            name: np.empty(size, dtype=kind_)
            for names_, size in ((_LINES, lines), (_WORDS, words))
            for name, kind_ in names_.items()
        }
        compiler.point_to(job, given | room)
        self.library.scan(ctypes.byref(job))
        made = {name: room[name][: job.lines + (name == "first")] for name in _LINES}
        found = Words(**{name.removeprefix("word_"): room[name][: job.words] for name in _WORDS})
        blank = made["blank"] == 1
        for i in np.flatnonzero(made["blank"] == _MAYBE_NOTE).tolist():
            blank[i] = NOTE.fullmatch(data, made["start"][i], made["end"][i]) is not None
        return Scan(
            data,
            text,
            made["start"],
            made["end"],
            made["simple"],
            blank,
            made["code"],
            made["wide"],
            found,
            made["first"],
        )

    def rewritten_lines(
        self,
        scan: Scan,
        whole: slice,
        lines: np.ndarray,
        count: np.ndarray,
        targets: np.ndarray,
        said: OutputState,
        formatting: Formatting,
        grids: Grids,
    ) -> tuple[bytes, Formatting]:
        """As `twin.nc.lines.rewritten_lines`."""
        axes = targets.shape[1]
        own = {
            "line": np.ascontiguousarray(lines, dtype=np.int64),
            "count": np.ascontiguousarray(count, dtype=np.int64),
            "targets": np.ascontiguousarray(targets, dtype=float),
            "said": np.array(said.value, dtype=float),
            "stale": np.array(said.stale, dtype=np.uint8),
            "step": grids.step,
            "decimals": np.asarray(grids.decimals, dtype=np.int64),
            "scale": grids.scale,
            "letters": grids.letters,
            "own": grids.own,
        }
        own |= {name: getattr(scan, name) for name in ("text", "start", "end", "first")}
        own |= {name: getattr(scan.words, name.removeprefix("word_")) for name in _READ}
        words = int(scan.first[lines[-1] + 1] - scan.first[lines[0]])
        room = whole.stop - whole.start + _LONGEST_WORD * (words + targets.size + axes) + 2 * len(targets)
        own["out"] = np.empty(room, dtype=np.uint8)
        style = formatting.style
        before = (style.point, style.min_decimals, style.leading_zero, style.plus, formatting.spaced, formatting.lower)
        job = _RewriteJob(begin=whole.start, stop=whole.stop, lines=len(lines), axes=axes, same_number=SAME_NUMBER)
        for name, value in zip(_STYLE, before, strict=True):
            setattr(job, name, int(value))
        compiler.point_to(job, own)
        self.library.rewrite(ctypes.byref(job))
        said.value[:], said.stale[:] = own["said"].tolist(), own["stale"].astype(bool).tolist()
        point, least, zero, plus, spaced, lower = (int(getattr(job, name)) for name in _STYLE)
        after = Formatting(Style(bool(point), least, bool(zero), bool(plus), False), bool(spaced), bool(lower))
        return own["out"][: job.written].tobytes(), after


@final
@dataclass(frozen=True)
class LineCode:
    """Reader and writer of simple lines: `scan` and `rewritten_lines` with arrays, or the same in compiled code."""

    scan: Callable[[bytes, tuple[str, ...]], Scan]
    rewritten_lines: Callable[..., tuple[bytes, Formatting]]


ARRAYS: Final = LineCode(scan, rewritten_lines)


def line_code(lines: int) -> LineCode:
    """Return compiled code if there is a compiler and the program has enough lines to be worth it, else `ARRAYS`."""
    found = _compiled() if compiler.worth_compiling(lines) else None
    return ARRAYS if found is None else LineCode(found.scan, found.rewritten_lines)


@cache
def _compiled() -> _Compiled | None:
    """Return the compiled code; None if it cannot be compiled, or differs from the arrays on a sample."""
    jobs = {"scan": _Job, "rewrite": _RewriteJob}
    confirmed_library = compiler.confirmed_library("twin.nc", "lines.cpp", jobs, lambda one: _agrees(_Compiled(one)))
    return None if confirmed_library is None else _Compiled(confirmed_library)


def _agrees(compiled: _Compiled) -> bool:
    """Return whether a sample is read and written as by the arrays."""
    names = ("X", "Y", "Z", "B", "C")
    seen = [read(_SAMPLE, names) for read in (scan, compiled.scan)]
    columns = [
        [getattr(one, name).tobytes() for name in _LINES]
        + [getattr(one.words, name.removeprefix("word_")).tobytes() for name in _WORDS]
        for one in seen
    ]
    if columns[0] != columns[1]:
        return False
    lines, grids = np.flatnonzero(seen[0].simple), Grids(names, [0.001] * len(names))
    targets = np.cumsum(np.full((2 * len(lines), len(names)), 0.4371), axis=0) - 1.5
    written = []
    for write in (rewritten_lines, compiled.rewritten_lines):
        state = OutputState(AxisWords(names[:3], names[3:], dict.fromkeys(names, 0.001)))
        whole = slice(0, len(_SAMPLE))
        count = np.full(len(lines), 2)
        written.append((*write(seen[0], whole, lines, count, targets, state, _PLAIN, grids), state.value, state.stale))
    return bool(written[0] == written[1])
