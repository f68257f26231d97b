"""Simple blocks: lines with only a block number, a motion word, axis words and a feed.

Most lines of most programs are simple. One regular expression matches such a line and finds its words, several times faster than the
tokenisers of the dialects. Those handle all other lines; a property test compares the two.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_ORDER = "XYZABCUVW"
"""The order in which nearly all programs write their words; other orders go through the tokeniser."""
VALUE = r"[+-]?+(?:\d{1,9}+(?:\.\d*+)?+|\.\d++)"
"""A number in unambiguous form and of plausible size."""
NOTHING = re.compile(r"(?!)")
"""Matches no line."""


class SimpleBlocks(NamedTuple):
    """The pattern of simple blocks on one machine.

    Attributes:
        pattern: to be matched with a whole line. Its groups: two for the text before the words (defined by the dialect), one value
            for each of ``axes``, then of ``others``, then those of the dialect's tail.
        axes: group and index of each axis.
        others: group and name of the words that are not axis words.
        behind: the range of the values of ``others`` among all groups.
    """

    pattern: re.Pattern[str]
    axes: tuple[tuple[int, int], ...]
    others: tuple[tuple[int, str], ...]
    behind: slice = slice(0)


def simple_axis_letters(names: tuple[str, ...]) -> str:
    """Return the axes a simple block can name, in order; none if an axis has a letter with another meaning."""
    letters = [name.upper() for name in names if len(name) == 1]
    return "".join(sorted(letters, key=_ORDER.index)) if all(letter in _ORDER for letter in letters) else ""


def simple_blocks(
    names: tuple[str, ...], head: str, value: str, others: tuple[str, ...], equals: str, tail: str
) -> SimpleBlocks:
    """Return the pattern of simple blocks.

    Args:
        names: axis names.
        head: pattern of the text before the words, with two groups.
        value: pattern of a number.
        others: names of the words that may follow the axis words.
        equals: separator after names of several letters among these.
        tail: pattern of the rest of the line.
    """
    letters = simple_axis_letters(names)
    if not letters:
        return SimpleBlocks(NOTHING, (), ())
    words = "".join(rf"(?:{letter}({value})(?!=)[ \t]*+)?+" for letter in letters)
    more = "".join(rf"(?:{name}{equals if len(name) > 1 else ''}({value})[ \t]*+)?+" for name in others)
    pattern = re.compile(rf"{head}(?=[{letters}]){words}{more}{tail}[\r\n]*+", re.ASCII | re.IGNORECASE)
    index = {name.upper(): i for i, name in enumerate(names)}
    axes = tuple((group, index[letter]) for group, letter in enumerate(letters, 3))
    behind = len(letters) + 2
    return SimpleBlocks(pattern, axes, tuple(enumerate(others, behind + 1)), slice(behind, behind + len(others)))
