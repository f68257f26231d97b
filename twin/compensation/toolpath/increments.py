"""Numbers without a decimal point that may count least increments, as on Fanuc controls: ``X100500`` is X 100.5 there."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from twin._common.errors import InputError
from twin.machine.machine import Machine
from twin.nc.dialect import Dialect

INCREMENTS: Final = "increments? (no decimal point, outside the axis's range)"
"""Hint for the user."""
FEWEST_INCREMENTS: Final = 1000.0
"""Least number without a decimal point that is taken for increments: 1 mm in micrometres."""
_WORD: Final = re.compile(r"([XYZABCUVW])[ \t]*=?[ \t]*[+-]?[ \t]*(\d+)(?![\d.,])", re.ASCII | re.IGNORECASE)
"""A word of an axis whose number has no decimal point."""


def numbers_of_increments(text: str) -> list[tuple[str, float]]:
    """Return the axis words of a line that may count increments: letter, and number without its sign."""
    words = _WORD.findall(text.split(";")[0])
    return [(letter.upper(), float(digits)) for letter, digits in words if float(digits) >= FEWEST_INCREMENTS]


@contextmanager
def increments_hinted(machine: Machine, dialect: Dialect, text_of: Callable[[int], str]) -> Iterator[None]:
    """Let an `InputError` at a line say if a number of that line may count increments.

    Args:
        machine: the machine: such a number is larger than the range of its axis.
        dialect: the language of the program.
        text_of: function that returns the text of a line by its number.
    """
    try:
        yield
    except InputError as error:
        if dialect.has_increments and error.line is not None and INCREMENTS not in error.what:
            ranges = {
                axis.name: axis.upper - axis.lower
                for axis in machine.axes
                if axis.lower is not None and axis.upper is not None
            }
            if any(number > ranges.get(name, number) for name, number in numbers_of_increments(text_of(error.line))):
                error.what += f"; {INCREMENTS}"
        raise
