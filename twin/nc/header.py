"""Comments at the head of a program, in the comment syntax of its language; every other byte stays as it is.

They stand behind what has to come first: the tape mark and the program number, ``BEGIN PGM``, ``PARTNO``. A comment that stands there
already is not written again, so that a program that is compensated twice says it once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from textwrap import wrap
from typing import Final

from twin.nc.text import BOM, ending, lines_in

HEAD_LINES: Final = 50
"""Lines in which the head of a program ends, and its comments show which syntax it uses."""
WIDTH: Final = 72
"""Characters of a comment: older HEIDENHAIN controls take blocks of 100."""
REMARK: Final = re.compile(r"\([^()]*\)|;.*")
FEED: Final = re.compile(r"(?<![A-Z])F[ \t]*(\d*[.,]?\d*)", re.ASCII | re.IGNORECASE)
"""Comments and feeds of languages of words."""


def first_lines(text: str) -> list[str]:
    """The first lines of a program, in which its head ends."""
    return [
        line for line, _ in zip(lines_in(text[: HEAD_LINES * 400].encode("latin-1")), range(HEAD_LINES), strict=False)
    ]


def missing(lines: Sequence[str], comments: Iterable[str], content: Callable[[str], str | None]) -> list[str]:
    """Lines of those comments that do not stand at the beginning of some lines already."""
    there: set[str] = set()
    for line in lines:
        said = content(line)
        if said is None:
            break
        there.add(said.casefold())
    new: list[str] = []
    for comment in comments:
        wrapped = wrap(comment, WIDTH)
        if not all(line.casefold() in there for line in wrapped):
            new += [line for line in wrapped if line not in new]
    return new


def inserted(
    text: str,
    lines: Sequence[str],
    at: int,
    comments: Iterable[str],
    style: Callable[[str], str],
    content: Callable[[str], str | None],
    rest: Callable[[str], str] = lambda text: text,
) -> str:
    """The text with comments before one of its first lines.

    Args:
        text: the text.
        lines: its first lines.
        at: index of the line.
        comments: what to say.
        style: a comment's line of its text.
        content: the text of a line that is a comment.
        rest: what becomes of the text behind.
    """
    new = missing(lines[at:], comments, content)
    if not new:
        return text
    begin = sum(len(line) for line in lines[:at])
    if at == 0 and text.startswith(BOM):
        begin = len(BOM)
    before = text[:begin]
    newline = next((ending(line) for line in lines if ending(line)), "\n")
    if at and not ending(lines[at - 1]):
        before += newline
    small = any(char.islower() for line in lines for char in line)
    written = (style(line) for line in new)
    return before + "".join(f"{line if small else line.upper()}{newline}" for line in written) + rest(text[begin:])
