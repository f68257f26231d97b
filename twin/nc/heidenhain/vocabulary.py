"""The vocabulary of Heidenhain plain language: beginnings of blocks, path words, and the meaning of statements."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import Final, NamedTuple, final

from twin.nc.lines import simple_axis_letters
from twin.nc.text import line_pattern, number

_VALUE = r"[+-]?+[ \t]*+(?:[\d.,]++|Q[LR]?\d++)"

HEAD = re.compile(r"(?:\xef\xbb\xbf)?+[ \t\f\x1a]*+(?:(\d++)(?![.,\d])|[Nn]\d++(?![.,\d]))?+[ \t]*+", re.ASCII)
"""The text before a block: spaces and its number. One with N (``N10``) is kept as it is: blocks inserted behind it have none."""
KEYWORD = re.compile(r"(?:L[NPT]?|C[CRTP]?|CTP)(?=[ \t\r\n;~]|$)|[A-Za-z]++", re.ASCII)
BLOCK_OF_ISO = re.compile(r"G[ \t]*+\d", re.ASCII | re.IGNORECASE)
SKIPPED = re.compile(r"[ \t]*+(?:\d++[ \t]*+)?+/")
SKIPPED_END = re.compile(
    r"[ \t]*+/[ \t]*+(?:\d++[ \t]*+)?+(?:STOP[ \t]++)?+M0*(?:2|30)(?!\d)[ \t]*+(?:;.*)?", re.ASCII | re.IGNORECASE
)
"""The end of the program in a block that may be skipped."""
TECHNOLOGY = re.compile(
    r"(?:M\d|S[ \t]*[+\d.]|F[ \t]*(?:MAX|AUTO|[+\d.])|R[0LR](?![A-Z\d.,]))", re.ASCII | re.IGNORECASE
)
"""The beginning of a block without a path function: M, S, F or the side of the tool."""
PARAXIAL = re.compile(rf"I?[XYZABCUVW][ \t]*+{_VALUE}", re.ASCII | re.IGNORECASE)

TOKEN = re.compile(
    rf"""[ \t\f\x1a]*+(?:
      (?P<axis>(I?)([XYZABCUVW])[ \t]*+({_VALUE}))
    | (?P<note>;[^\r\n]*+|[\r\n]++)
    | (?P<side>R(?:0(?![\d.,])|[LR](?![A-Z])|[+-](?![\d.,Q])))
    | (?P<feed>F[ \t]*+(?:MAX|AUTO|[ZU]?[ \t]*+{_VALUE}))
    | (?P<sense>DR[ \t]*+[+-])
    | (?P<radius>R[ \t]*+({_VALUE}))
    | (?P<polar>(I?)P([RA])[ \t]*+({_VALUE}))
    | (?P<vector>([NT][XYZ])[ \t]*+({_VALUE}))
    | (?P<retract>MB[ \t]*+(?:MAX|{_VALUE}))
    | (?P<misc>M(\d{{1,9}})(?:\.(?!\d)|(?![\d.])))
    | (?P<speed>S[ \t]*+{_VALUE})
    | (?P<ahead>LA[ \t]*+{_VALUE})
    | (?P<blank>[RFM](?=[ \t\r\n;]|$))
    | (?P<bad>\S)
    )""",
    re.VERBOSE | re.ASCII | re.IGNORECASE,
)

EVIDENCE = line_pattern(
    r"(?:BEGIN|END|CALL|SEL)[ \t]++PGM(?!\w)",
    r"BLK[ \t]++FORM(?!\w)",
    r"TOOL[ \t]++(?:CALL|DEF)(?!\w)",
    r"CYCLE?+[ \t]++(?:DEF|CALL)(?!\w)",
    r"(?:CALL[ \t]++)?+LBL[ \t]++[\d\"Q]",
    r"FN[ \t]*+\d++[ \t]*+:",
    r"PLANE[ \t]++(?:SPATIAL|RESET|PROJECTED|EULER|VECTOR|POINTS|RELATIVE|AXIAL)(?!\w)",
    r"FUNCTION[ \t]++(?:TCPM|RESET|MODE)(?!\w)",
    r"(?:LN?|CC|CR?)[ \t]++I?[A-CU-Z][ \t]*+(?:[+-]|\d|Q)",
    r"L[ \t]++(?:R[0LR]|FMAX|M\d)",
    r"(?:LP|CP)[ \t]++I?P[RA][ \t]*+[-+\dQ]",
)
"""A line of a plain-language program: one of its statements, or a path function with an axis word."""
OPENING = line_pattern(r"BEGIN[ \t]++PGM(?!\w)")
UNIT = re.compile(r"BEGIN[ \t]+PGM[ \t]+(?:.*[ \t])?([^ \t;]+)[ \t]*(?:;.*)?$", re.ASCII | re.IGNORECASE)
TOOL_AXIS = re.compile(
    r"TOOL[ \t]+CALL[ \t]+(?:(?:\"[^\"]*\"|[^ \t\"]+)[ \t]+)?([XYZ])(?![A-Z\d])", re.ASCII | re.IGNORECASE
)
TOOL = re.compile(
    r"TOOL[ \t]+CALL[ \t]+(?:\"([^\"]*)\"|(Q[SLR]?\d+|\d+(?:\.\d+)?))(?:[ \t]|$)", re.ASCII | re.IGNORECASE
)
TOOL_LENGTH = re.compile(rf"(?<![A-Z\d])DL[ \t]*=?[ \t]*({_VALUE})", re.ASCII | re.IGNORECASE)
CYCLE = re.compile(r"CYCLE?[ \t]+DEF[ \t]+(\d{1,9})(?!\d)(?:\.(\d++))?+(.*)", re.ASCII | re.IGNORECASE)
PROGRAM_CALL = re.compile(r"CALL[ \t]++PGM[ \t]++\"?+([^\";]++)", re.ASCII | re.IGNORECASE)
CYCLE_CALL = re.compile(r"CYCLE?[ \t]+CALL(?!\w)")
"""Posts of older controls write CYCLE in full."""
SHIFT = re.compile(rf"(?<![A-Z])(I?)([XYZABCUVW])[ \t]*({_VALUE})", re.ASCII | re.IGNORECASE)
TILT = re.compile(rf"(?<![A-Z])([ABC])[ \t]*({_VALUE})", re.ASCII | re.IGNORECASE)
TILT_REST = re.compile(rf"(?:F[ \t]*{_VALUE}|(?:SETUP|ABST)[ \t]*{_VALUE}|[ \t])*", re.ASCII | re.IGNORECASE)
"""Words of cycle 19: its angles, and with which feed and at which distance the axes are positioned."""
ROTATION = re.compile(rf"(I?)ROT[ \t]*({_VALUE})", re.ASCII | re.IGNORECASE)
FN = re.compile(r"FN[ \t]*+(\d{1,9})(?!\d)[ \t]*+:?(.*)", re.ASCII | re.IGNORECASE)
INCHES = frozenset({"INCH", "IN"})
HARMLESS_CALL = re.compile(r"M0*(?:[3-9]|1[34])", re.ASCII)
"""M functions of ``CYCL CALL``: spindle and coolant."""
PARAMETER = re.compile(r"Q[LRS]?\d++[ \t]*+=", re.ASCII | re.IGNORECASE)
ASSIGNED = re.compile(r"(?<![A-Z\d])(Q[LR]?\d++)[ \t]*+=[ \t]*+([^;\r\n~]*+)", re.ASCII | re.IGNORECASE)
WITH_NUMBERS = frozenset({"CYCL", "CYCLE", "FN", "PLANE", "Q", "QL", "QR", "TOOL"})
QUOTED = re.compile(r"\"[^\"]*+\"")
EXPONENT = re.compile(r"(?<![\\/:.\d])[+-]?(?:\d++[.,]?+\d*+|[.,]\d++)E[+-]?\d+", re.ASCII | re.IGNORECASE)
"""A number with an exponent outside paths, in one of the statements `WITH_NUMBERS`; the control knows none."""
NUMBERS = re.compile(r"[+-]?[\d.,]+", re.ASCII)

REFUSED_PATHS = frozenset("SPLINE CTP LT FL FLT FC FCT FPOL FSELECT".split())
LEAD = re.compile(
    r"(?:(APPR)[ \t]+(P?)(?:LCT|CT|LT|LN)|DEP[ \t]+(?:(P?)LCT|CT|LT|LN))(?![A-Z])", re.ASCII | re.IGNORECASE
)
"""Beginning of a block that leads to the contour or away from it; with P its end is given about the pole."""
LEAD_WORD = re.compile(
    r"(?<![A-Z])(?:LEN|CCA|R(?!0(?![\d.,])))[ \t]*+[+-]?(?:Q[LR]?\d+|[\d.,]+)", re.ASCII | re.IGNORECASE
)
"""A word of its form: length, angle, radius."""
ON_CONTOUR = frozenset({"RND", "CHF", "CT"})
"""Path functions that depend on the blocks beside them, which stay whole."""
SHAPING = re.compile(r"[ \t]*+(?:N?\d++[ \t]*+)?+(?:RND|CHF|CT)(?![A-Z])", re.ASCII | re.IGNORECASE)
PASSED = frozenset("END BLK STOP LBL DECLARE PATTERN GLOBAL OPEN WAIT".split())
HARMLESS_FUNCTIONS = tuple(
    f"FUNCTION {reset}{words}"
    for reset in ("", "RESET ")
    for words in "AFC,COUNT,DWELL,FEED,FILE,LIFTOFF,MODE MILL,S-PULSE,SPINDLE,TCPM,REPORT".split(",")
)
"""Beginnings of functions that act on feed, spindle, files and messages only."""
OTHER_TCPM = re.compile(r"(?<!PATHCTRL )AXIS SPAT|REFPNT (?!TIP-TIP)\S+")
"""Words with which rotary axis words are spatial angles, and positions not those of the tool tip."""
HARMLESS_FN = frozenset({*range(9), 13, 14, 15, 16, 18, 20, 23, 24, 26, 27, 28, 37, 38})
"""Parameter functions that compute, read, wait or write free tables; 17, 19, 25 and 29 write data of the control, a datum, the PLC."""
HARMLESS_CYCLES = frozenset(
    {
        *(1, 2, 3, 4, 5, 9, 13, 14, 17, 18, *range(20, 30), 32, *range(200, 216), 225, *range(230, 234), 240, 241, 247),
        *(*range(251, 259), *range(262, 266), 267, *range(270, 278), 332, 392),
    }
    - {26}
)
"""Cycles that move nothing and shift nothing where they are defined: machining cycles, which a call executes; dwell, tolerance, spindle
orientation, contour, tuning of the drives (332; 392 of DMG MORI). Cycle 247 selects a preset.
"""
HARMLESS_M = frozenset(
    {
        *(
            *range(11),
            13,
            14,
            17,
            19,
            30,
            90,
            91,
            92,
            95,
            97,
            *range(101, 104),
            *range(105, 112),
            116,
            117,
            120,
            122,
            124,
        ),
        *(126, 127, *range(134, 138), 140, 141, 145, *range(148, 151)),
    }
)
"""M functions that leave positions, frame and modes alone, and those that are modelled (91, 92, 140), by HEIDENHAIN's list. M94 does
if the rotary axes are below 360°; M104 and M143 change the datum, M112, M114, M115 and M138 the path or its transformation.
"""
TRANSFORM_CYCLES = {
    7: "datum shift",
    8: "mirror image",
    10: "rotation",
    11: "scaling",
    19: "working plane",
    26: "scaling",
}
BESIDE_CYCLES = frozenset({*range(7, 12), 13, 14, 19, 20, 26, 32, 247})
"""Cycles that act where they are defined; every other one ends the machining cycle in force."""
RUN_AT_ONCE = frozenset({12, 220, 221, 224})
"""Cycles that are executed where they are defined: a program call, hole patterns."""
OF_HEIDENHAIN = frozenset({*range(89, 150), *range(200, 205)})
"""M functions that HEIDENHAIN defines; every other one is the machine builder's (`twin.nc.modal.Interpreter.take_auxiliary`)."""
REFUSED_M = frozenset({98, 118, 130, 144})
CALLING_M = frozenset({89, 99})
END_M = frozenset({2, 30})
"""M functions behind which nothing of a program is executed."""
BEGINNING = re.compile(r"BEGIN[ \t]+PGM\b", re.IGNORECASE)
ENDING = re.compile(r"END[ \t]+PGM\b", re.IGNORECASE)
LAST_M = frozenset({0, 1, 2, 5, 9, 30, 60})

EXPANDED_CYCLE = "a cycle expanded into L blocks by the postprocessor"
LINEAR = "a path of L, LN, LP, CC/C, CP and CR blocks from the postprocessor"
ARCS = frozenset({"C", "CP", "CR"})
POLAR = frozenset({"LP", "CP"})
"""Path functions that end on an arc, and those whose end point is given by radius and angle about the pole."""
NO_TRANSFORMATION = "a program without coordinate transformations"
NO_CALLS = "one program without jumps or calls"


def cancels(cycle: int, rest: str) -> bool:
    """Return whether the values of a transformation cycle cancel it."""
    values = [number(text) for text in NUMBERS.findall(rest)]
    if cycle in (11, 26):
        return bool(values) and all(value == 1.0 for value in values)
    if cycle == 8 and not rest:
        return True
    return cycle != 8 and bool(values) and "Q" not in rest.upper() and all(value == 0.0 for value in values)


@final
class SimpleBlocks(NamedTuple):
    """The pattern of simple blocks on one machine: a block number, ``L`` or ``LN``, axis words, vectors and a feed.

    One match finds all words of such a block. Without it, programs of ``LN`` blocks take 1.6 times as long (`TOKEN`).

    Attributes:
        pattern: to be matched with a whole line. Its groups: block number, keyword, one value for each of ``axes``, then of ``others``,
            then the feed.
        axes: group and index of each axis.
        others: group and name of the components of the surface normal and of the tool vector.
        behind: the range of the values of ``others`` among all groups.
    """

    pattern: re.Pattern[str]
    axes: tuple[tuple[int, int], ...] = ()
    others: tuple[tuple[int, str], ...] = ()
    behind: slice = slice(0)


@lru_cache(maxsize=16)
def simple_pattern(names: tuple[str, ...]) -> SimpleBlocks:
    """Return the pattern of simple blocks: ``10 L X+1,5 Y-2 R0 F500``, ``LN`` with vectors; ``names``: the axes."""
    letters = simple_axis_letters(names)
    if not letters:
        return SimpleBlocks(re.compile(r"(?!)"))
    components = ("NX", "NY", "NZ", "TX", "TY", "TZ")
    value = r"([+-]?+\d{1,9}+(?:[.,]\d*+)?+)"
    words = "".join(
        rf"(?:{name}{value}{'' if name in components else '(?!=)'}[ \t]*+)?+" for name in (*letters, *components)
    )
    feed = r"(?:(F[ \t]*+MAX|F\d++(?:[.,]\d*+)?+)[ \t]*+)?+"
    head = rf"[ \t]*+(?:(\d++)[ \t]*+)?+(LN?+)[ \t]++(?=[{letters}])"
    pattern = re.compile(rf"{head}{words}(?:R0[ \t]*+)?+{feed}[\r\n]*+", re.ASCII | re.IGNORECASE)
    index = {name.upper(): i for i, name in enumerate(names)}
    axes = tuple((group, index[letter]) for group, letter in enumerate(letters, 3))
    behind = len(letters) + 2
    others = tuple(enumerate(components, behind + 1))
    return SimpleBlocks(pattern, axes, others, slice(behind, behind + len(others)))


_NUMBERS: Final = re.compile(r"([\r\n](?:\xef\xbb\xbf)?+[ \t\f\x1a]*+)(\d++)(?![.,\d])", re.ASCII)
_CONTINUES: Final = re.compile(r"~[^\S\r\n]*+(?:\r\n|\n|\r)")
UNNUMBERED: Final = "\0"
"""Mark, which no program has, before a line that continues a block and so has no number."""


def renumbered(text: str, numbers: Callable[[list[str]], Iterable[int]]) -> str:
    """Return lines with new block numbers, which ``numbers`` makes of the old ones, and without the marks `UNNUMBERED`.

    An old number that begins with a zero keeps its width.
    """
    parts = _NUMBERS.split(f"\n{text}")
    old = parts[2::3]
    parts[2::3] = [
        str(new).zfill(len(before)) if before[0] == "0" else str(new)
        for before, new in zip(old, numbers(old), strict=False)
    ]
    return "".join(parts)[1:].replace(UNNUMBERED, "")


def with_continued_marked(text: str) -> str:
    """Return lines with `UNNUMBERED` before each that follows a ``~``."""
    return _CONTINUES.sub(lambda match: match.group() + UNNUMBERED, text)


def numbered_as(text: str, head: re.Match[str], number: int) -> str:
    """Return a block with another number, padded to the old width if the old number begins with a zero (``head``: of `HEAD`)."""
    old = head.group(1)
    new = str(number).zfill(len(old)) if old[0] == "0" else str(number)
    return f"{text[: head.start(1)]}{new}{text[head.end(1) :]}"
