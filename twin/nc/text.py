"""Text handling shared by the dialects: splitting bytes into lines, and formatting numbers like the words they replace.

Comments in the header of a program, in the syntax of its language; every other byte is kept.

They follow what must come first: tape mark and program number, ``BEGIN PGM``, ``PARTNO``. A comment already there is not repeated, so
that a program compensated twice has it once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from textwrap import wrap
from typing import Final, NamedTuple, final

import numpy as np

from twin._common.errors import InputError
from twin.nc.blocks import Lines, Program, lines_in

MM_PER_INCH = 25.4
SAME_MM: Final = 1e-6
"""Heights that are closer are the same: an argument in inches has fewer digits than the height that it states."""
LARGEST = 1e9
"""Upper limit of coordinates, feeds and parameters (mm, degrees, mm/min); no real program comes near it."""

_CONTROL = bytes(c for c in range(32) if c not in b"\t\n\r\f\x1a\x11\x12\x13\x14")
_SPACES = re.compile(r"[ \t]+")
UNIT_LENGTH = 1e-15
"""Difference of a vector's length from one below which the vector is not scaled."""
BOM = "\xef\xbb\xbf"
BLANK = frozenset({"\n", "\r\n", "\r"})
"""Blank lines, which are skipped early."""


def line_pattern(*forms: str) -> re.Pattern[bytes]:
    """Return the pattern of a line that begins, after skip mark and block number, with one of some forms (regular expressions)."""
    head = r"(?:\A(?:\xef\xbb\xbf)?|[\r\n])[ \t]*+(?:/\d?[ \t]*+)?+(?:N?+[ \t]*+\d++[ \t]*+)?+"
    return re.compile(f"{head}(?:{'|'.join(forms)})".encode("latin-1"), re.IGNORECASE)


def read_lines(data: bytes, source: str, dialect: str) -> Program:
    """Split bytes into lines, keeping every byte; raise `InputError` for an empty, blank or binary file."""
    check = TextCheck(source)
    check.add(data)
    check.finish()
    return Program(source=source, dialect=dialect, texts=Lines(data))


def count_of(data: bytes, character: int) -> int:
    """Return how often a character occurs; five times as fast as `bytes.count` where it is frequent."""
    return int(np.count_nonzero(np.frombuffer(data, dtype=np.uint8) == character))


class TextCheck:
    """Check that bytes given in chunks are a text program; ``newlines``, ``returns``: numbers of LF and CR characters."""

    def __init__(self, source: str) -> None:
        self._source = source
        self.size = self.newlines = self.returns = self._control = 0
        self._empty = True

    def add(self, data: bytes) -> None:
        """Check the next chunk; raise `InputError` if it is binary."""
        if b"\0" in data:
            line = self.newlines + data.count(b"\n", 0, data.index(b"\0")) + 1
            what = "binary file"
            raise InputError(what, expected="an NC program as text", file=self._source, line=line, value="NUL byte")
        begin = len(BOM) if not self.size and data.startswith(BOM.encode("latin-1")) else 0
        newlines = count_of(data, ord("\n"))
        self.size += len(data)
        self.newlines += newlines
        self._control += count_of(data, 127)
        if np.count_nonzero(np.frombuffer(data, dtype=np.uint8) < 32) > newlines:
            self.returns += count_of(data, ord("\r"))
            self._control += len(data) - len(data.translate(None, _CONTROL))
        self._empty = self._empty and not data[begin:].strip(b" \t\r\n\f\x1a")

    def finish(self) -> None:
        """Check the whole after the last chunk; raise `InputError` if it is empty, blank or binary."""
        if 10 * self._control > self.size:
            what = "binary file"
            raise InputError(what, expected="an NC program as text", file=self._source, value="control characters")
        if self._empty:
            raise InputError("empty program", expected="at least one block", file=self._source)


def ending(text: str) -> str:
    """Return a line's ending, or an empty text."""
    if text.endswith("\r\n"):
        return "\r\n"
    return text[-1:] if text[-1:] in ("\n", "\r") else ""


def newline_of(texts: Iterable[str]) -> str:
    """Return the line ending of a program: that of its first line, LF if that has none."""
    return ending(next(iter(texts))) or "\n"


def number(text: str) -> float:
    """Return the value of a number as programs write it (``-.5``, ``5.``, ``5,5``, ``+ 5``); NaN if it is not of plausible size."""
    try:
        value = float(text)
    except ValueError:
        try:
            value = float(_SPACES.sub("", text).replace(",", "."))
        except ValueError:
            return math.nan
    return value if -LARGEST < value < LARGEST and "_" not in text else math.nan  # Python reads 1_0 as 10


class Style(NamedTuple):
    """Number format of a program.

    Attributes:
        point: whether a whole number ends in a decimal point (``5.``).
        min_decimals: minimum number of decimals (``5.0`` has 1, ``5.120`` has 3).
        leading_zero: whether there is a zero before the decimal point (``0.5``).
        plus: whether positive numbers carry a sign.
        comma: whether the decimal separator is a comma.
    """

    point: bool = False
    min_decimals: int = 0
    leading_zero: bool = True
    plus: bool = False
    comma: bool = False


_NEUTRAL_DIGITS = frozenset("123456789")
"""First and last digits of numbers such as 12.5, which do not determine the style."""


def style_of(text: str, base: Style) -> Style:
    """Return the style of one written number; what the number does not determine comes from ``base``."""
    first = text[:1]
    if text[-1:] in _NEUTRAL_DIGITS and "." in text and not base.comma:
        if first in _NEUTRAL_DIGITS:
            if not base.plus:
                return base
        elif text[1:2] in _NEUTRAL_DIGITS and "," not in text and (first == "-" or (first == "+" and base.plus)):
            return base
    plus = True if first == "+" else base.plus if first == "-" else False
    comma = "," in text
    whole, separator, fraction = text.partition("," if comma else ".")
    if not separator:
        if not whole.strip("+- \t0"):  # a bare zero is written like that in any style
            return Style(base.point, base.min_decimals, base.leading_zero, plus, base.comma)
        return Style(False, 0, base.leading_zero, plus, base.comma)
    digits = whole.lstrip("+- \t")
    if not fraction:
        return Style(True, 0, base.leading_zero if digits else False, plus, comma)
    leading_zero = False if not digits else True if digits == "0" and fraction.strip("0") else base.leading_zero
    if fraction[-1] == "0":
        return Style(False, len(fraction), leading_zero, plus, comma)
    return Style(base.point, base.min_decimals, leading_zero, plus, comma)


_AXIS_NUMBER = re.compile(r"[XYZABCUVW][ \t]*=?[ \t]*([+-]?\d*[.,]?\d*)", re.ASCII | re.IGNORECASE)


def style_in(lines: Iterable[str], base: Style) -> Style:
    """Return the style of a program's axis words, from the first ones in its lines."""
    style = base
    seen = 0
    for line in lines:
        for text in _AXIS_NUMBER.findall(line):
            if text.strip("+-.,"):
                style = style_of(text, style)
                seen += 1
        if seen > 100:
            break
    return style._replace(plus=base.plus)


@lru_cache(maxsize=256)
def decimals_of(increment: float) -> int:
    """Return the decimals that a least increment needs (0.001 -> 3, 0.005 -> 3, 0.00025 -> 5), at most 9."""
    for decimals in range(9):
        scaled = increment * 10**decimals
        if abs(scaled - round(scaled)) <= 1e-6 * scaled and round(scaled) >= 1:
            return decimals
    return 9


class Grid(NamedTuple):
    """The values an axis word can have: multiples of a step, with decimals written; step in program units, unit in mm or degrees."""

    step: float
    decimals: int
    unit: float


@lru_cache(maxsize=1024)
def grid(increment: float, inch: bool) -> Grid:
    """Return the grid of an axis with a least increment in mm or degrees; ``inch``: a linear axis of an inch program."""
    decimals = decimals_of(increment)
    if inch:
        decimals = max(5, decimals + 2)
        return Grid(10.0**-decimals, decimals, MM_PER_INCH)
    return Grid(increment, decimals, 1.0)


def printed(value: float, increment: float, *, inch: bool = False) -> float:
    """Return the value, mm or degrees, that a program holds after ``value`` has been formatted and read back; NaN stays NaN.

    ``inch``: whether the program is in inches and the axis linear.
    """
    if value != value:
        return value
    step, decimals, unit = grid(increment, inch)
    return (round(round(value / unit / step) * step, decimals) + 0.0) * unit


_BARE = tuple(f"%.{decimals}f" for decimals in range(16))
_SIGNED = tuple(f"%+.{decimals}f" for decimals in range(16))


def format_number(value: float, decimals: int, style: Style) -> str:
    """Return a number as text in a style, rounded to some decimals; never ``-0``."""
    point, min_decimals, leading_zero, plus, comma = style
    text = (_SIGNED if plus else _BARE)[decimals] % value
    if text[0] == "-" and text[1] == "0" and not text.strip("-0."):
        text = f"+{text[1:]}" if plus else text[1:]
    if decimals > min_decimals:
        if text[-1] == "0":
            text = text.rstrip("0")
            if min_decimals:
                text = text.ljust(text.index(".") + 1 + min_decimals, "0")
            elif text[-1] == "." and not point:
                text = text[:-1]
    elif min_decimals > decimals:
        text = f"{text if decimals else text + '.'}{'0' * (min_decimals - decimals)}"
    elif not decimals and point:
        text += "."
    if not leading_zero:
        at = 1 if text[0] in "+-" else 0
        if text[at : at + 2] == "0." and text[at:].strip("0."):
            text = text[:at] + text[at + 1 :]
    return text.replace(".", ",") if comma else text


def unit_vector(vector: tuple[float, float, float]) -> tuple[tuple[float, float, float], float]:
    """Return a vector at unit length, and its original length (a zero vector is returned unchanged)."""
    length = math.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
    if length == 0.0 or abs(length - 1.0) < UNIT_LENGTH:
        return vector, length
    return (vector[0] / length, vector[1] / length, vector[2] / length), length


def apply_edits(text: str, edits: list[tuple[int, int, str]]) -> str:
    """Return a text with some ranges replaced; ranges must not overlap, nor two insertions be at the same place."""
    if len(edits) > 1:
        edits.sort()
    parts = []
    at = 0
    for start, end, new in edits:
        parts.append(text[at:start])
        parts.append(new)
        at = end
    parts.append(text[at:])
    return "".join(parts)


# --- Comments in the header of a program, in the syntax of its language; every other byte is kept -

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
    """Return the text with comments inserted before one of its first lines (index ``at``).

    ``style`` makes a comment line of a text, ``content`` returns the text of a comment line, None for any other line, and ``rest`` is
    applied to the text after the comments.
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


@final
class ProgramEnd:
    """End of a program by a word, empty before it. No control executes what is behind it: it stays as it is."""

    def __init__(self) -> None:
        self.word = ""
        self._line, self._skipped, self._another = 0, False, ""

    def reached(self, word: str, line: int, *, skipped: bool = False) -> None:
        """Take note of the end; ``line``: its 0-based index, ``skipped``: whether a switch of the control decides on it."""
        self.word, self._line, self._skipped = word, line, skipped

    def begins(self, what: str) -> None:
        """Take note of the beginning of another program behind the end."""
        self._another = self._another or what

    def refusal(self) -> tuple[str, str] | None:
        """Return what is wrong with a block behind the end that moves axes, and what is expected; None if it can stay."""
        where = f"behind the end of the program ({self.word} in line {self._line + 1})"
        if self._another:
            expected = "one program in a file, and subprograms that it calls"
            return f"another program {where}, which begins with {self._another}", expected
        if self._skipped:
            return f"a block {where}, which the control's switch for block skip turns off", "an end without /"
        return None

    @property
    def notice(self) -> str:
        """Notice on the first block behind the end."""
        return (
            f"not executed and left as it is, with all that follows: behind the end of the program ({self.word} in line "
            f"{self._line + 1})"
        )


# --- Axes that programs name and the model of the machine does not have: a quill, a pallet, a tailstock -----

NOT_IN_MODEL: Final = (
    "is not in the model of the machine: its words are left as written, and it stands still in all feeds; a shift of tool or "
    "workpiece by it must be in the work offset or the tool length"
)
"""End of the notice on an auxiliary axis."""


@final
class AuxiliaryAxes:
    """Positions of the auxiliary axes of a program, which must be the same in all feeds: they may move tool or workpiece.

    Attributes:
        names: their names in capitals.
        moved: whether one of them has moved since the last feed.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self.names = frozenset(names)
        self.moved = False
        self._at: dict[str, object] = {}
        """Positions of the axes; another object for each one that is not known."""
        self._fed: dict[str, object] | None = None
        """Positions at the feeds so far."""

    def move(self, name: str, value: float | str, *, incremental: bool) -> bool:
        """Take a word and return whether it moves the axis; ``value``: NaN if unknown, a text for a fixed place of the machine."""
        before = self._at.get(name)
        if incremental and not isinstance(value, str):
            if value == 0.0:
                return False
            value = before + value if isinstance(before, float) else math.nan
        new = value if value == value else object()
        if new == before:
            return False
        self._at, self.moved = {**self._at, name: new}, True
        return True

    def feed(self) -> str:
        """Take note of a feed and return what is wrong with it: which axis stood elsewhere at feeds before; empty if nothing."""
        self.moved = False
        if self._fed is None or self._fed == self._at:
            self._fed = self._at
            return ""
        fed = self._fed
        name = next(name for name, position in self._at.items() if fed.get(name) != position)
        return f"feed with {name} at {_shown(self._at[name])}, after feeds with it at {_shown(fed.get(name))}"


def _shown(position: object) -> str:
    if isinstance(position, str):
        return position
    return f"{position:g}" if isinstance(position, float) else "an unknown position"
