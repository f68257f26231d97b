"""Simple lines of plain language found all at once, through an image of the text that has the form of ISO lines.

The simple lines here are a subset of those of `twin.nc.heidenhain.vocabulary.simple_pattern`: a block number, ``L`` in capitals, signed
axis words in the usual order, each after a blank, ``R0``, and a feed or ``FMAX``. The image has the same length, so that the places of
its words are those of the text: ``12 L X+1,5 R0 F500`` becomes ``··G1·X+1.5····F500`` (· is a blank).
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Final

import numpy as np

from twin.nc.encoded import line_ends
from twin.nc.lines.compiled import LineCode
from twin.nc.lines.scan import Scan

_IMAGE: Final = bytes(
    ord(".") if c == ord(",") else ord("?") if chr(c).islower() or c in b"GN" else c for c in range(256)
)
"""Characters of the image: a point for a decimal comma; for letters that only ISO lines may have, a character that they cannot have."""
_BLANK, _DIGIT, _OTHER, _KEYWORD, _COMMENT = range(5)
_KINDS: Final = bytes(
    _BLANK
    if c in b" \t"
    else _DIGIT
    if c in b"0123456789"
    else _KEYWORD
    if c == ord("L")
    else _COMMENT
    if c in b";*%"
    else _OTHER
    for c in range(256)
)
LONGEST_HEAD: Final = 32
"""Most characters before the keyword of a simple line: blanks and the block number."""
_RAPID: Final = re.compile(rb"[ \t]FMAX(?=[ \t\r\n])")


def scan(data: bytes, names: tuple[str, ...], code: LineCode) -> Scan:
    """Find and read the simple lines of whole lines of a program.

    Args:
        data: the lines.
        names: axis names.
        code: how ISO lines are read.

    Returns:
        The simple lines, of motion code 0 with ``FMAX`` and 1 without.
    """
    image = _with_iso_heads(data)
    if b"R0" in image:
        for end in (b" ", b"\r", b"\n"):
            image = image.replace(b" R0" + end, b"   " + end)
    rapids: list[int] = []
    if b"FMAX" in image:
        rapids = [match.start() for match in _RAPID.finditer(image)]
        image = _RAPID.sub(b"     ", image)
    found = code.scan(image, names)
    text, words = np.frombuffer(data, dtype=np.uint8), found.words
    before = text[words.start - 2]
    simple = found.simple & (found.code == 1)
    simple[words.line[(words.sign == 0) | ~((before == ord(" ")) | (before == ord("\t")))]] = False
    motion = np.where(simple, found.code, np.int8(-1))
    with_fmax = np.searchsorted(found.end, np.array(rapids, dtype=int), side="right")
    motion[with_fmax[simple[with_fmax]]] = 0
    return replace(found, data=data, text=text, simple=simple, code=motion)


def _with_iso_heads(data: bytes) -> bytes:
    """Return the image of a text in which the head of an L block ends in ``G1``, and that of a comment in ``%``."""
    image = np.frombuffer(bytearray(data.translate(_IMAGE)), dtype=np.uint8)
    text, kind = (np.frombuffer(one, dtype=np.uint8) for one in (data, data.translate(_KINDS)))
    starts = np.concatenate([[0], line_ends(text, data) + 1])
    at = np.flatnonzero(kind >= _KEYWORD)
    start = starts[np.searchsorted(starts, at, side="right") - 1]
    good = at - start <= LONGEST_HEAD
    good &= (kind[at] == _COMMENT) | (kind.take(at + 1, mode="clip") == _BLANK)
    at, start = at[good], start[good]
    numbers, within = np.zeros(len(at), dtype=int), np.zeros(len(at), dtype=bool)
    good = np.ones(len(at), dtype=bool)
    longest = int((at - start).max(initial=0))
    for i in range(longest):
        here = np.where(start + i < at, kind.take(start + i, mode="clip"), _BLANK)
        good &= here <= _DIGIT
        numbers += (here == _DIGIT) & ~within
        within = here == _DIGIT
    good &= numbers <= 1
    at, start = at[good], start[good]
    for i in range(longest):
        image[start[start + i < at] + i] = ord(" ")
    moves = at[kind[at] == _KEYWORD]
    image[at], image[moves], image[moves + 1] = ord("%"), ord("G"), ord("1")
    return image.tobytes()
