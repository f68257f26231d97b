"""Plain lines of an ISO program found and read all at once: bytes in arrays, no line and no word an object of its own.

What is plain here is part of what `twin.nc.plain` calls plain: a block number, ``G0`` or ``G1``, axis words in the usual order and a
feed, every number of at most 15 digits, so that its digits are an exact whole number and dividing it by an exact power of ten rounds
once, as reading it digit by digit does. Every other line is for the general way.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final, final

import numpy as np

from twin.nc.plain import plain_letters

MOST_DIGITS: Final = 15
"""Decimal digits every whole number of which a double holds."""
_WHOLE_DIGITS: Final = 9
"""As of `twin.nc.plain.VALUE`."""
_POWERS: Final = 10.0 ** np.arange(MOST_DIGITS + 1)
_OTHER, _LETTER, _DIGIT, _SIGN, _POINT, _BLANK, _END = range(7)
_FOLLOWS: Final = {
    _LETTER: (_DIGIT, _SIGN, _POINT),
    _DIGIT: (_DIGIT, _POINT, _BLANK, _LETTER, _END),
    _SIGN: (_DIGIT, _POINT),
    _POINT: (_DIGIT, _BLANK, _LETTER, _END),
    _BLANK: (_BLANK, _LETTER, _END),
    _END: (_BLANK, _LETTER, _END),
}
"""Which kinds of character a plain line may have behind one another."""
_NUMBER, _CODE, _FEED = -3, -2, -1
_MINUS, _PLUS, _ZERO = b"-+0"


@final
@dataclass(frozen=True)
class Words:
    """The axis words of plain lines, in the order of the text.

    Attributes:
        line: (n,) which line of the text each is on.
        axis: (n,) index of its axis.
        start, end: (n,) where its value begins and ends.
        value: (n,) as written.
        sign: (n,) the character code of its sign, 0 where it has none.
        whole, fraction: (n,) how many digits stand before and behind the point.
        point: (n,) whether it has one.
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
    """A stretch of a program, whole lines.

    Attributes:
        data: its bytes.
        text: (n,) the same as numbers.
        start, end: (lines,) where each line begins and ends, its own ending included.
        plain: (lines,) whether it is plain.
        blank: (lines,) whether nothing stands on it.
        code: (lines,) the motion code of a plain line, -1 where it has none.
        wide: (lines,) whether that is written in two digits.
        words: of the plain lines.
        first: (lines + 1,) which of the words each line begins with.
    """

    data: bytes
    text: np.ndarray
    start: np.ndarray
    end: np.ndarray
    plain: np.ndarray
    blank: np.ndarray
    code: np.ndarray
    wide: np.ndarray
    words: Words
    first: np.ndarray

    def line(self, index: int) -> str:
        """One line as text."""
        return self.data[self.start[index] : self.end[index]].decode("latin-1")


@lru_cache(maxsize=16)
def _tables(names: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """By character: its kind, its rank among the words of a line, its axis; and whether two kinds may not follow each other."""
    kind, rank, axis = np.zeros(256, dtype=np.uint8), np.zeros(256, dtype=np.int8), np.full(256, _FEED, dtype=np.int8)
    kind[list(b"0123456789")] = _DIGIT
    kind[list(b"+-")], kind[list(b".")], kind[list(b" \t")], kind[list(b"\r\n")] = _SIGN, _POINT, _BLANK, _END
    letters = plain_letters(names)
    places = {"N": (0, _NUMBER), "G": (1, _CODE), "F": (len(letters) + 2, _FEED)}
    places |= {letter: (2 + i, [name.upper() for name in names].index(letter)) for i, letter in enumerate(letters)}
    for letter, (place, which) in places.items() if letters else ():
        for code in (ord(letter), ord(letter.lower())):
            kind[code], rank[code], axis[code] = _LETTER, place, which
    bad = np.ones((8, 8), dtype=bool)
    for before, behind in _FOLLOWS.items():
        bad[before, behind] = False
    return kind, rank, axis, bad.reshape(-1)


def scan(data: bytes, names: tuple[str, ...]) -> Scan:
    """Find and read the plain lines of a stretch of program.

    Args:
        data: whole lines; only the last line of a program may lack its ending.
        names: axis names.
    """
    text = np.frombuffer(data, dtype=np.uint8)
    kind_of, rank_of, axis_of, bad_pair = _tables(names)
    end = line_ends(text, data) + 1
    if len(data) and (not end.size or end[-1] < len(data)):
        end = np.append(end, len(data))
    lines = len(end)
    start = np.concatenate([np.zeros(min(lines, 1), dtype=end.dtype), end[:-1]])
    kind = kind_of[text]
    pairs = kind[:-1] << 3
    pairs |= kind[1:]
    plain = np.ones(lines, dtype=bool)
    # A pair across the end of a line counts for the line behind it: what that may begin with.
    plain[np.searchsorted(end, np.flatnonzero(bad_pair[pairs]) + 1, side="right")] = False
    if lines:
        plain[0] &= not bad_pair[_END * 8 + kind[0]]
        plain[-1] &= bool(kind[-1] == _END)
    letters = np.flatnonzero(kind == _LETTER)
    per_line = np.diff(np.searchsorted(letters, end), prepend=0)
    blank = plain & (per_line == 0)
    keep = np.repeat(plain, per_line)
    letters, line = letters[keep], np.repeat(np.arange(lines), np.where(plain, per_line, 0))
    numeric = (kind >= _DIGIT) & (kind <= _POINT)
    stops = np.flatnonzero(numeric[:-1] & ~numeric[1:]) + 1
    stops = stops[plain[np.searchsorted(end, stops - 1, side="right")]] if not plain.all() else stops
    char = text[letters]
    rank, axis = rank_of[char], axis_of[char]
    good = np.ones(len(letters), dtype=bool)
    good[1:] = (line[1:] != line[:-1]) | (rank[1:] > rank[:-1])
    begin = letters + 1
    sign = text[begin] if letters.size else np.zeros(0, dtype=np.uint8)
    signed = (sign == _MINUS) | (sign == _PLUS)
    sign = np.where(signed, sign, 0)
    begin_digits = begin + signed
    points = np.flatnonzero(kind == _POINT)
    of = np.searchsorted(letters, points) - 1
    inside = (of >= 0) & (points < stops[of]) if letters.size else np.zeros(len(points), dtype=bool)
    of, points = of[inside], points[inside]
    good[of[1:][of[1:] == of[:-1]]] = False
    at = stops.copy()
    at[of] = points
    point = at < stops
    whole = at - begin_digits
    fraction = stops - at - point
    number, code = axis == _NUMBER, axis == _CODE
    good &= (whole <= _WHOLE_DIGITS) | number
    good &= (whole + fraction >= 1) & ((whole + fraction <= MOST_DIGITS) | number)
    good &= ~((number | code) & (signed | point))
    codes = np.flatnonzero(code)
    said, width = text[stops[codes] - 1] - _ZERO, whole[codes]
    good[codes] &= (said <= 1) & ((width == 1) | ((width == 2) & (text[begin[codes]] == _ZERO)))
    plain[line[~good]] = False
    of_axis = (axis >= 0) & plain[line]
    named = np.bincount(line[of_axis], minlength=lines)
    plain &= named > 0
    motion, wide = np.full(lines, -1, dtype=np.int8), np.zeros(lines, dtype=bool)
    motion[line[codes]], wide[line[codes]] = said.astype(np.int8), width > 1
    motion[~plain] = -1
    digits = begin_digits[of_axis], stops[of_axis], fraction[of_axis]
    words = Words(
        line=line[of_axis].astype(np.int32),
        axis=axis[of_axis],
        start=begin[of_axis].astype(np.int32),
        end=stops[of_axis].astype(np.int32),
        value=_values(text, *digits, sign[of_axis] == _MINUS),
        sign=sign[of_axis],
        whole=whole[of_axis].astype(np.int16),
        fraction=fraction[of_axis].astype(np.int16),
        point=point[of_axis],
        padded=text[stops[of_axis] - 1] == _ZERO,
    )
    first = np.concatenate([[0], np.cumsum(np.where(plain, named, 0))])
    return Scan(data, text, start, end, plain, blank, motion, wide, words, first)


def line_ends(text: np.ndarray, data: bytes) -> np.ndarray:
    """Where the last character of every line is that has an ending; a return at the very end is one."""
    ends = text == 10
    if b"\r" in data:
        returns = text == 13
        returns[:-1] &= ~ends[1:]
        ends |= returns
    return np.flatnonzero(ends)


def _values(
    text: np.ndarray, begin: np.ndarray, stop: np.ndarray, fraction: np.ndarray, negative: np.ndarray
) -> np.ndarray:
    """The numbers whose digits begin and stop there, a point among them where they have a fraction."""
    found = np.zeros(len(begin), dtype=np.int64)
    for place in range(int((stop - begin).max(initial=0))):
        at = begin + place
        digit = text[np.minimum(at, len(text) - 1)] - _ZERO  # a point becomes a large number: unsigned
        taken = (at < stop) & (digit < 10)
        np.copyto(found, found * 10 + digit, where=taken)
    values = found / _POWERS[fraction]
    np.negative(values, out=values, where=negative)
    return values
