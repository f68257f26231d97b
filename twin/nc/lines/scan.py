"""Simple lines of an ISO program found and read all at once, with the bytes in arrays and no object per line or word.

The simple lines here are a subset of those of `twin.nc.simple_blocks`: a block number, ``G0`` or ``G1``, axis words in the usual
order and a feed. Numbers have at most 15 digits, so that the digits form an exact whole number and the division by an exact power
of ten rounds once, as a correctly rounded conversion does. All other lines go through the interpreter of blocks.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, final

import numpy as np

from twin.nc.encoded import line_ends
from twin.nc.simple_blocks import simple_axis_letters

MOST_DIGITS: Final = 15
"""Number of decimal digits up to which a double holds every whole number."""
_WHOLE_DIGITS: Final = 9
"""As in `twin.nc.simple_blocks.VALUE`."""
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
NOTE: Final = re.compile(rb"[ \t]*+(?:%[^\r\n]*+|(?:[Nn]\d++[ \t]*+)?+(?:;[^\r\n]*+|\([^()\r\n]*+\)[ \t]*+))[\r\n]*+")
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
        value: as written.
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
        data: its bytes.
        text: (n,) the bytes as numbers.
        start, end: (lines,) range of each line, including its ending.
        simple: (lines,) whether the line is simple.
        blank: (lines,) whether it is empty or a comment.
        code: (lines,) the motion code of a simple line, -1 if it has none.
        wide: (lines,) whether the motion code has two digits.
        words: of the simple lines.
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


def scan(data: bytes, names: tuple[str, ...]) -> Scan:
    """Find and read the simple lines of a chunk of a program.

    Args:
        data: whole lines; only the last line of a program may lack its ending.
        names: axis names.
    """
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
