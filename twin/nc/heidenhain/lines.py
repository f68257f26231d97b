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

from twin.nc.lines.compiled import LineCode
from twin.nc.lines.scan import Scan

_HEAD: Final = re.compile(rb"(?:\A|(?<=[\r\n]))[ \t]*+(?:\d++[ \t]*+)?+(?:L[ \t]|[;*%])")
"""A head without anything that matters before its last characters: of an L block, or of a comment."""
_IMAGE: Final = bytes(
    ord(".") if c == ord(",") else ord("?") if chr(c).islower() or c in b"GN" else c for c in range(256)
)
"""Characters of the image: a point for a decimal comma; for letters that only ISO lines may have, a character that they cannot have."""
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
    image = _HEAD.sub(_head, data.translate(_IMAGE))
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


def _head(match: re.Match[bytes]) -> bytes:
    """Return the image of a head: ``G1`` for an L block, ``%``, which begins a comment line, for a comment."""
    head = match.group()
    mark = b"G1" if head[-2:-1] == b"L" else b"%"
    return mark.rjust(len(head))
