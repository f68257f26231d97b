"""Plain blocks: lines of nothing but a block number, a motion word, axis words and a feed.

Most lines of most programs are plain. One regular expression recognises such a line and finds its words, where the
general way (the dialects' tokens, then everything a token can mean) takes ten times as long. A plain block is read and
written exactly as the general way would: whatever needs more than is here is left to the general way, and a property
test compares the two.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import NamedTuple

from twin.nc.emit import Said
from twin.nc.text import Style, style_of

_ORDER = "XYZABCUVW"
"""The order nearly all programs write their words in; other orders are read the general way."""
VALUE = r"[+-]?+(?:\d{1,9}+(?:\.\d*+)?+|\.\d++)"
"""A number that is one beyond doubt, and of a sensible size."""
_COMMA_VALUE = r"[+-]?+\d{1,9}+(?:[.,]\d*+)?+"
NOTHING = re.compile(r"(?!)")
"""No line is plain."""
ISO_WORDS = ("I", "J", "K", "R", "CR", "TURN", "A3", "B3", "C3")
"""The words an ISO block may have beside its axes: a centre or a tool vector, a radius, full turns, a tool vector."""
VECTOR_WORDS = ("NX", "NY", "NZ", "TX", "TY", "TZ")
"""Those of plain language: surface normal and tool vector."""


class Plain(NamedTuple):
    """What plain blocks look like on one machine.

    Attributes:
        pattern: to be matched with a whole line. Its groups: the motion word's digits (ISO), or the block number and
            keyword (plain language); one value for each of ``axes``, then of ``others``; the feed word (plain
            language).
        axes: indices of the axes, in the order of the groups.
        others: names of the words that are no axis words.
    """

    pattern: re.Pattern[str]
    axes: tuple[int, ...]
    others: tuple[str, ...]


def plain_letters(names: tuple[str, ...]) -> str:
    """The axes a plain block can name, in order; none where an axis has the letter of something else."""
    letters = [name.upper() for name in names if len(name) == 1]
    return "".join(sorted(letters, key=_ORDER.index)) if all(letter in _ORDER for letter in letters) else ""


def _compiled(names: tuple[str, ...], head: str, value: str, others: tuple[str, ...], equals: str, tail: str) -> Plain:
    letters = plain_letters(names)
    if not letters:
        return Plain(NOTHING, (), others)
    words = "".join(rf"(?:{letter}({value})(?!=)[ \t]*+)?+" for letter in letters)
    more = "".join(rf"(?:{name}{equals if len(name) > 1 else ''}({value})[ \t]*+)?+" for name in others)
    pattern = re.compile(rf"{head}(?=[{letters}]){words}{more}{tail}[\r\n]*+", re.ASCII | re.IGNORECASE)
    index = {name.upper(): i for i, name in enumerate(names)}
    return Plain(pattern, tuple(index[letter] for letter in letters), others)


@lru_cache(maxsize=16)
def iso_plain(names: tuple[str, ...]) -> Plain:
    """Plain blocks of an ISO program: ``N10 G1 X1.5 Y-2. F500``, arcs and tool vectors included."""
    head = r"[ \t]*+(?:N\d++[ \t]*+)?+(?:G(0?[0-3])[ \t]*+)?+"
    return _compiled(names, head, VALUE, ISO_WORDS, "=", rf"(?:F{VALUE}[ \t]*+)?+")


@lru_cache(maxsize=16)
def plain_language(names: tuple[str, ...]) -> Plain:
    """Plain blocks of plain language: ``10 L X+1,5 Y-2 R0 F500``, and ``LN`` with its vectors."""
    head = r"[ \t]*+((?:\d++[ \t]*+)?+LN?+)[ \t]++"
    feed = r"(?:(F[ \t]*+MAX|F\d++(?:[.,]\d*+)?+)[ \t]*+)?+"
    return _compiled(names, head, _COMMA_VALUE, VECTOR_WORDS, "", rf"(?:R0[ \t]*+)?+{feed}")


Place = tuple[int, int, int]
"""A word of a plain block: which axis it is of (or which of `Plain.others`), and where its value begins and ends."""


def other_places(match: re.Match[str], plain: Plain) -> list[Place]:
    """The words of a plain block that are no axis words."""
    first = len(plain.axes) + 2
    if (match.lastindex or 0) < first:
        return []
    found = []
    for which in range(len(plain.others)):
        start, end = match.span(first + which)
        if end >= 0:
            found.append((which, start, end))
    return found


def places(match: re.Match[str], plain: Plain) -> list[Place]:
    """The axis words of a plain block."""
    found = []
    for group, axis in enumerate(plain.axes, start=2):
        start, end = match.span(group)
        if end >= 0:
            found.append((axis, start, end))
    return found


def replaced(
    text: str,
    words: list[Place],
    row: list[float],
    said: Said,
    style: Style,
    *,
    inch: bool,
    incremental: bool,
    signed: bool,
) -> tuple[str, Style]:
    """The text of a plain block up to the end of its last axis word, with new values, and the style after it.

    Args:
        text: of the line.
        words: its axis words.
        row: the axes' targets, NaN where a word stays as it is.
        said: what the output said so far.
        style: of the numbers so far.
        inch: whether the program is in inches.
        incremental: whether the words are.
        signed: whether every number carries its sign.
    """
    parts = []
    at = 0
    for axis, start, end in words:
        target = row[axis]
        old = text[start:end]
        if target == target:
            style = style_of(old, style)
            if signed and not style.plus:
                style = style._replace(plus=True)
            parts.append(text[at:start])
            parts.append(said.replace(axis, old, target, inch, incremental, style))
        else:
            parts.append(text[at:end])
            said.heard(axis, said.value_of(axis, old, inch), incremental)
        at = end
    return "".join(parts), style


def kept(text: str, words: list[Place], said: Said, *, inch: bool, incremental: bool) -> bool:
    """Hear the words of a plain block that stays as it is; whether one is of a rotary axis."""
    rotary = False
    for axis, start, end in words:
        said.heard(axis, said.value_of(axis, text[start:end], inch), incremental)
        rotary = rotary or axis >= said.linear
    return rotary
