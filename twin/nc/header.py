"""Comments in the header of a program, in the syntax of its language; every other byte is kept.

They follow what must come first: tape mark and program number, ``BEGIN PGM``, ``PARTNO``. A comment already there is not repeated, so
that a program compensated twice has it once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from textwrap import wrap
from typing import Final

from twin.nc.encoded import lines_in
from twin.nc.text import BOM, ending

HEAD_LINES: Final = 50
"""Number of lines within which the header ends and the comment syntax of the program shows."""
WIDTH: Final = 72
"""Characters per comment line; older HEIDENHAIN controls accept blocks of up to 100 characters."""


def first_lines(text: str) -> list[str]:
    """Return the first lines of a program, which contain its header."""
    return [
        line for line, _ in zip(lines_in(text[: HEAD_LINES * 400].encode("latin-1")), range(HEAD_LINES), strict=False)
    ]


def missing_comments(lines: Sequence[str], comments: Iterable[str], content: Callable[[str], str | None]) -> list[str]:
    """Return the lines of those comments that are not among the comments at the beginning of some lines."""
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


def insert_comments(
    text: str,
    lines: Sequence[str],
    at: int,
    comments: Iterable[str],
    style: Callable[[str], str],
    content: Callable[[str], str | None],
    rest: Callable[[str], str] = lambda text: text,
) -> str:
    """Return the text with comments inserted before one of its first lines.

    Args:
        text: the text.
        lines: its first lines.
        at: index of the line.
        comments: texts of the comments.
        style: function that makes a comment line of a text.
        content: function that returns the text of a comment line, None for any other line.
        rest: function applied to the text after the comments.
    """
    new = missing_comments(lines[at:], comments, content)
    if not new:
        return text
    begin = sum(len(line) for line in lines[:at])
    if at == 0 and text.startswith(BOM):
        begin = len(BOM)
    before = text[:begin]
    newline = next((ending(line) for line in lines if ending(line)), "\n")
    if at and not ending(lines[at - 1]):
        before += newline
    small = any(line != line.upper() for line in lines)
    written = (style(line) for line in new)
    return before + "".join(f"{line if small else line.upper()}{newline}" for line in written) + rest(text[begin:])
