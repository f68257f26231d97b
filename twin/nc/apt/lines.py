"""Simple ``GOTO`` statements found all at once, through an image of the text that has the form of ISO lines.

The simple statements here are ``GOTO/x,y,z`` and ``GOTO/x,y,z,i,j,k`` in a line of their own, without blanks before or between their
numbers, and with a tool vector of nearly unit length. The image has the same length, so that the places of its words are those of the
text: ``GOTO/1.5,2,3`` becomes ``····X1.5Y2Z3`` (· is a blank).
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Final

import numpy as np

from twin.nc.encoded import line_ends
from twin.nc.lines.chunks import DELETED_LINE
from twin.nc.lines.compiled import LineCode
from twin.nc.lines.scan import Scan

_NAMES: Final = ("X", "Y", "Z", "A", "B", "C")
NOTED: Final = 1e-3
"""Difference of a tool vector's length from one above which a notice is given."""
_LETTERS: Final = np.frombuffer(b"YZABC", dtype=np.uint8)
"""Letters in place of the commas of a statement."""
_HEAD: Final = np.frombuffer(b"GOTO", dtype=np.uint8)
_NOTE: Final = re.compile(rb"[ \t]*+(?:\$\$[^\r\n]*+)?+[\r\n]*+|" + re.escape(DELETED_LINE.encode()))
"""Comment lines, blank ones and deleted ones."""
_CAPITAL: Final = 0xDF
"""Mask that makes a small letter a capital."""


def scan(data: bytes, names: tuple[str, ...], code: LineCode) -> Scan:
    """Find and read the simple statements of whole lines of a program.

    Args:
        data: the lines.
        names: axis names of the machine; the words of the result are always those of x, y, z, i, j, k.
        code: how ISO lines are read.
    """
    text = np.frombuffer(data, dtype=np.uint8)
    image = text.copy()
    starts = np.concatenate([[0], line_ends(text, data) + 1])
    at = np.flatnonzero(text == ord("/"))
    line = np.searchsorted(starts, at, side="right") - 1
    good = at - starts[line] == len(_HEAD)
    at, line = at[good], line[good]
    good = (text[at[:, None] + np.arange(-len(_HEAD), 0)] & _CAPITAL == _HEAD).all(axis=1)
    at, line = at[good], line[good]
    image[at[:, None] + np.arange(-len(_HEAD), 0)], image[at] = ord(" "), ord("X")
    headed = np.zeros(len(starts), dtype=bool)
    headed[line] = True
    commas = np.flatnonzero(text == ord(","))
    line = np.searchsorted(starts, commas, side="right") - 1
    place = np.arange(len(commas)) - np.searchsorted(commas, starts)[line]
    image[commas] = np.where(headed[line], _LETTERS[np.minimum(place, len(_LETTERS) - 1)], ord(","))
    notes = starts[:-1][text.take(starts[:-1], mode="clip") == ord("$")]
    image[notes[text.take(notes + 1, mode="clip") == ord("$")]] = ord("%")
    found = code.scan(image.tobytes(), _NAMES)
    count = np.diff(found.first)
    simple = found.simple & headed[: len(found.simple)] & ((count == 3) | (count == 6))
    tilted = np.flatnonzero(simple & (count == 6))
    length = np.linalg.norm(found.words.value[found.first[tilted, None] + [3, 4, 5]], axis=1)
    simple[tilted[np.abs(length - 1.0) > 0.5 * NOTED]] = False
    blank = np.zeros(len(simple), dtype=bool)
    blank[[i for i in np.flatnonzero(found.blank).tolist() if _NOTE.fullmatch(data, found.start[i], found.end[i])]] = (
        True
    )
    return replace(found, data=data, text=text, simple=simple, blank=blank)


def locations(found: Scan, lines: np.ndarray) -> np.ndarray:
    """Return (lines, 6) the numbers of simple statements, NaN where there are only three."""
    numbers = np.full((len(lines), len(_NAMES)), np.nan)
    words = slice(found.first[lines[0]], found.first[lines[-1] + 1])
    row = np.repeat(np.arange(len(lines)), np.diff(found.first)[lines])
    numbers[row, found.words.axis[words]] = found.words.value[words]
    return numbers
