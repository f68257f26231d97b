"""Comments at the head of a program, in the comment syntax of its language; every other byte stays as it is.

They stand behind what has to come first: the tape mark and the program number, ``BEGIN PGM``, ``PARTNO``. A comment that stands there
already is not written again, so that a program that is compensated twice says it once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from textwrap import wrap
from typing import Final

from twin.nc.heidenhain_words import HEAD
from twin.nc.text import BOM, ending, lines_in

HEAD_LINES: Final = 50
"""Lines in which the head of a program ends, and its comments show which syntax it uses."""
WIDTH: Final = 72
"""Characters of a comment: older HEIDENHAIN controls take blocks of 100."""
_TAPE: Final = re.compile(
    r"%.*|;\$PATH=.*|PROC\b.*|<[^<>]*>|[O:][ \t]*\d+(?![\w.])(?![ \t]*(?:SUB|CALL|IF|DO|WHILE|REPEAT|RETURN)\b).*",
    re.IGNORECASE,
)
"""Lines of an ISO program before which nothing may stand: tape mark, program number or name, ``PROC``."""
_NUMBER: Final = re.compile(r"[ \t]*(?:/\d?[ \t]*)?(?:N\d+[ \t]*)?", re.IGNORECASE)
_ROUND: Final = re.compile(r"\(([^()]*)\)[ \t]*;?")
_SIEMENS: Final = re.compile(
    r"%_N_|\b(?:TRAORI|TRAFOOF|SUPA|ORIWKS|ORIMKS|FGROUP|CYCLE\d+|PROC|MSG)\b|\$[APSM]\w*_|=[ \t]*(?:AC|IC|DC|ACP|ACN)[ \t]*\(",
    re.IGNORECASE,
)


def with_iso_comments(text: str, comments: Sequence[str]) -> str:
    """Return an ISO program with comments behind its tape mark and program number.

    In round brackets, or behind a semicolon where the program's own comments or words are those of a SINUMERIK.

    Args:
        text: the program; of a long one its first lines are enough.
        comments: a line each; ASCII without brackets.
    """
    lines = first_lines(text)
    at, place = 0, 0
    while place < len(lines) and (_tape(lines[place]) or _iso_content(lines[place]) is not None):
        at = place + 1 if _tape(lines[place]) else at
        place += 1
    semicolon = _uses_semicolon(lines)
    style: Callable[[str], str] = "; {}".format if semicolon else "({})".format
    return inserted(text, lines, at, comments, style, _iso_content)


def with_heidenhain_comments(text: str, comments: Sequence[str]) -> str:
    """Return a plain-language program with comments behind ``BEGIN PGM``; the numbers of later blocks grow by those inserted.

    Args:
        text: the whole program.
        comments: a line each; ASCII.
    """
    lines = first_lines(text)
    at = next((i + 1 for i, line in enumerate(lines) if _body(line).upper().split()[:2] == ["BEGIN", "PGM"]), 0)
    number = None if at == 0 else HEAD.match(lines[at - 1])
    if number is None or number.group(1) is None:
        return inserted(text, lines, at, comments, "; {}".format, _plain_content)
    first = int(number.group(1)[:15]) + 1
    new = _missing(lines[at:], comments, _plain_content)
    return inserted(
        text,
        lines,
        at,
        comments,
        lambda line: f"{first + new.index(line)} ; {line}",
        _plain_content,
        lambda rest: _renumbered(rest, len(new)),
    )


def first_lines(text: str) -> list[str]:
    """The first lines of a program, in which its head ends."""
    return [
        line for line, _ in zip(lines_in(text[: HEAD_LINES * 400].encode("latin-1")), range(HEAD_LINES), strict=False)
    ]


def _tape(line: str) -> bool:
    return _TAPE.match(line.removeprefix(BOM).strip()) is not None


def _iso_content(line: str) -> str | None:
    """The text of a line that is nothing but a comment, or nothing; None of any other."""
    body = line.removeprefix(BOM)
    body = body[_match_end(_NUMBER, body) :].strip()
    if body.startswith(";"):
        return body[1:].strip()
    if not body:
        return ""
    found = _ROUND.fullmatch(body)
    return None if found is None else found.group(1).strip()


def _match_end(pattern: re.Pattern[str], text: str) -> int:
    found = pattern.match(text)
    return 0 if found is None else found.end()


def _uses_semicolon(lines: Sequence[str]) -> bool:
    for line in lines:
        if _SIEMENS.search(line):
            return True
    for line in lines:
        body = line[_match_end(_NUMBER, line) :].strip()
        if body.startswith("("):
            return False
        # A semicolon at the end of a line is the end of a block; with text behind it a comment.
        if body.partition(";")[2].strip():
            return True
    return False


def _body(line: str) -> str:
    return line[_match_end(HEAD, line) :].strip()


def _plain_content(line: str) -> str | None:
    body = _body(line)
    return body[1:].strip() if body.startswith(";") else None if body else ""


def _missing(lines: Sequence[str], comments: Iterable[str], content: Callable[[str], str | None]) -> list[str]:
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
    new = _missing(lines[at:], comments, content)
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


def _renumbered(text: str, by: int) -> str:
    """Numbered blocks with larger numbers; a block that goes on over several lines has one."""
    parts: list[str] = []
    continued = False
    for line in lines_in(text.encode("latin-1")):
        head = HEAD.match(line)
        if not continued and head is not None and head.group(1) is not None:
            old = head.group(1)
            number = str(int(old[:15]) + by)
            parts.append(
                f"{line[: head.start(1)]}{number.zfill(len(old)) if old[0] == '0' else number}{line[head.end(1) :]}"
            )
        else:
            parts.append(line)
        continued = line.strip().endswith("~")
    return "".join(parts)
