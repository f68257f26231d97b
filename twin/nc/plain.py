"""Plain blocks: lines of nothing but a block number, a motion word, axis words and a feed.

Most lines of most programs are plain. One regular expression recognises such a line and finds its words, where the
dialects' tokens take several times as long. Whatever else a line says is left to those, and a property test compares the two.
"""

from __future__ import annotations

import re
from typing import NamedTuple

_ORDER = "XYZABCUVW"
"""The order nearly all programs write their words in; other orders are read token by token."""
VALUE = r"[+-]?+(?:\d{1,9}+(?:\.\d*+)?+|\.\d++)"
"""A number that is one beyond doubt, and of a sensible size."""
NOTHING = re.compile(r"(?!)")
"""No line is plain."""


class Plain(NamedTuple):
    """What plain blocks look like on one machine.

    Attributes:
        pattern: to be matched with a whole line. Its groups: two of what stands before the words (the dialect says what), one
            value for each of ``axes``, then of ``others``, then what the dialect has behind them.
        axes: group and index of each axis.
        others: group and name of the words that are no axis words.
        behind: where the values of those stand among all groups.
    """

    pattern: re.Pattern[str]
    axes: tuple[tuple[int, int], ...]
    others: tuple[tuple[int, str], ...]
    behind: slice = slice(0)


def plain_letters(names: tuple[str, ...]) -> str:
    """The axes a plain block can name, in order; none where an axis has the letter of something else."""
    letters = [name.upper() for name in names if len(name) == 1]
    return "".join(sorted(letters, key=_ORDER.index)) if all(letter in _ORDER for letter in letters) else ""


def plain_blocks(
    names: tuple[str, ...], head: str, value: str, others: tuple[str, ...], equals: str, tail: str
) -> Plain:
    """What plain blocks look like.

    Args:
        names: axis names.
        head: pattern of what stands before the words, with two groups.
        value: pattern of a number.
        others: names of the words that may follow the axis words.
        equals: what stands behind the longer ones of those.
        tail: pattern of what follows.
    """
    letters = plain_letters(names)
    if not letters:
        return Plain(NOTHING, (), ())
    words = "".join(rf"(?:{letter}({value})(?!=)[ \t]*+)?+" for letter in letters)
    more = "".join(rf"(?:{name}{equals if len(name) > 1 else ''}({value})[ \t]*+)?+" for name in others)
    pattern = re.compile(rf"{head}(?=[{letters}]){words}{more}{tail}[\r\n]*+", re.ASCII | re.IGNORECASE)
    index = {name.upper(): i for i, name in enumerate(names)}
    axes = tuple((group, index[letter]) for group, letter in enumerate(letters, 3))
    behind = len(letters) + 2
    return Plain(pattern, axes, tuple(enumerate(others, behind + 1)), slice(behind, behind + len(others)))
