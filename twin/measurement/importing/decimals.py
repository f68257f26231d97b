"""Numbers of table cells: the decimal sign from the content, and exact decimal values."""

from __future__ import annotations

import re
from collections.abc import Iterable
from decimal import Decimal
from typing import Final, NamedTuple

POINT: Final = "."
COMMA: Final = ","
SIGNS: Final = {POINT: "point", COMMA: "comma"}
"""Decimal signs with their names in a mapping file."""
MINUS: Final = str.maketrans({"−": "-", "–": "-", "\u00a0": " ", "\u202f": " ", "’": "'"})
_EXPONENT: Final = r"(?:[eE][-+]?\d{1,2})?"
_NUMBER: Final = {
    sign: re.compile(
        rf"[-+]?(?:\d+|\d{{1,3}}(?:['{other} ]\d{{3}})+)?(?:{re.escape(sign)}\d*)?{_EXPONENT}(?<=[\d{re.escape(sign)}])",
        re.ASCII,
    )
    for sign, other in ((POINT, COMMA), (COMMA, POINT))
}
_EITHER: Final = re.compile(r"[-+]?[\d.,' ]*\d[\d.,' ]*(?:[eE][-+]?\d+)?", re.ASCII)
_GROUPED: Final = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}", re.ASCII)
"""A number whose only sign may be a decimal sign or a sign of thousands."""


class DecimalSign(NamedTuple):
    """Decimal sign of a file.

    Attributes:
        sign: the sign.
        ambiguous: a cell with a sign that could be a decimal sign or a sign of thousands; empty if there is none.
        contrary: a cell that is clear and has the other sign; empty otherwise.
    """

    sign: str
    ambiguous: str = ""
    contrary: str = ""


def looks_like_number(cell: str) -> bool:
    """Return whether a cell is a number with whatever decimal sign."""
    text = cell.translate(MINUS)
    return len(text) < 60 and bool(_EITHER.fullmatch(text)) and any(p.fullmatch(text) for p in _NUMBER.values())


def decimal_value(cell: str, sign: str) -> Decimal | None:
    """Return the exact number in a cell; None if it is not a number with this decimal sign.

    Thousands may be separated by the other sign, an apostrophe or a blank.
    """
    text = cell.translate(MINUS)
    if len(text) > 60 or not re.search("[0-9]", text) or not _NUMBER[sign].fullmatch(text):
        return None
    other = COMMA if sign == POINT else POINT
    value = Decimal(text.replace(other, "").replace("'", "").replace(" ", "").replace(sign, POINT))
    return value if abs(value.adjusted()) < 40 else None


def decimal_text(value: Decimal) -> str:
    """Return a number as a cell of a measurement table, in full and without digits lost."""
    return format(value, "f") if value else "0"


def decimal_sign(cells: Iterable[str]) -> DecimalSign:
    """Return the decimal sign of cells: the one that a clear cell has; a sign followed by three digits alone is ambiguous.

    Args:
        cells: cells of the rows that hold measured points.
    """
    clear: dict[str, str] = {}
    unclear: dict[str, str] = {}
    for cell in cells:
        text = cell.translate(MINUS)
        if not _EITHER.fullmatch(text) or len(text) > 60:
            continue
        signs = [sign for sign in text if sign in SIGNS]
        if not signs:
            continue
        last = signs[-1]
        if not _NUMBER[last].fullmatch(text):
            continue
        if _GROUPED.fullmatch(text):
            unclear.setdefault(last, cell)
        else:
            clear.setdefault(last, cell)
    if len(clear) == 1:
        (sign,) = clear
        return DecimalSign(sign, ambiguous=unclear.get(COMMA if sign == POINT else POINT, ""))
    if clear:
        return DecimalSign(COMMA, contrary=clear[POINT])
    if len(unclear) == 1:
        sign, cell = next(iter(unclear.items()))
        return DecimalSign(sign, ambiguous=cell)
    return DecimalSign(POINT, ambiguous=unclear.get(COMMA, ""))
