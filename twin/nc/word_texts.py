"""Axis words formatted together, with the same text as one by one (`twin.nc.text.format_number`)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.nc.emit import OutputState
from twin.nc.text import Style, grid

LARGEST_STEPS: Final = 1e11
"""Larger values, in least increments, are written one by one: a double no longer holds all their decimals exactly."""
_MINUS, _PLUS, _ZERO, _POINT, _SPACE = b"-+0. "


@final
@dataclass(frozen=True)
class Formatting:
    """Formatting of a program at some place.

    Attributes:
        style: number format.
        spaced: whether words are separated by spaces.
        lower: whether letters are small.
    """

    style: Style
    spaced: bool
    lower: bool


@final
class Grids:
    """The steps of the axis words, for writing many together.

    Args:
        names: axis names.
        increment: (axes,) least increments, mm and degrees.
    """

    def __init__(self, names: tuple[str, ...], increment: list[float]) -> None:
        grids = [grid(one, False) for one in increment]
        self.step = np.array([one.step for one in grids])
        self.decimals = np.array([one.decimals for one in grids])
        whole = self.step * 10.0**self.decimals
        self.scale = np.round(whole).astype(np.int64)
        self.exact = bool(np.all(np.abs(whole - self.scale) <= 1e-9 * whole))
        self.letters = np.array([ord(name[0].upper()) for name in names], dtype=np.uint8)
        self.own = np.array([ord(name[0]) for name in names], dtype=np.uint8)


def lines_of_words(
    rows: np.ndarray, said: OutputState, formatting: Formatting, grids: Grids, begin: str, ending: str
) -> str | None:
    """Return a line for each position after the first, with words for the axes that move; none for one at which no axis moves.

    Args:
        rows: (n, axes) positions, mm and degrees, of which the first has been written; NaN for axes without a target.
        said: last values in the output; updated.
        formatting: number format, separation of words and size of letters.
        grids: of the axes.
        begin: text at the begin of each line.
        ending: line ending.

    Returns:
        The text; None (and nothing done) if an axis has a target only now and then, a value is too large or not known, or numbers
        cannot be written together in this format.
    """
    known = np.isfinite(rows)
    own = known[0]
    doubtful = [i for i in np.flatnonzero(own).tolist() if said.stale[i] or said.value[i] != said.value[i]]
    if doubtful or not (known == own).all() or formatting.style.comma or not grids.exact:
        return None
    steps = np.rint(np.where(own, rows, 0.0) / grids.step)
    if np.abs(steps).max(initial=0.0) >= LARGEST_STEPS:
        return None
    steps = steps.astype(np.int64)
    row, axis = np.nonzero(steps[1:] != steps[:-1])
    if not row.size:
        return ""
    opens = np.append(True, row[1:] != row[:-1])
    letters = grids.letters + 32 if formatting.lower else grids.own
    ends = np.zeros((len(row), 2), dtype=np.uint8)
    ends[np.append(opens[1:], True)] = np.frombuffer(ending.encode("latin-1").rjust(2, b"\0"), dtype=np.uint8)
    style = formatting.style
    text, _ = formatted_words(
        steps[1:][row, axis],
        axis,
        (style.point, np.full(len(row), style.min_decimals), style.leading_zero, style.plus),
        grids,
        ~opens & formatting.spaced,
        letters[axis],
        ends,
    )
    for i in set(axis.tolist()):
        said.value[i] = float(steps[-1, i] * grids.step[i])
    lines = text.tobytes().decode("latin-1")
    return begin + lines.replace(ending, ending + begin, int(opens.sum()) - 1) if begin else lines


def formatted_words(
    steps: np.ndarray,
    axis: np.ndarray,
    styles: tuple[np.ndarray | bool, np.ndarray, np.ndarray | bool, np.ndarray | bool],
    grids: Grids,
    spaced: np.ndarray,
    letter: np.ndarray,
    ending: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return words with numbers formatted as by `twin.nc.text.format_number`, concatenated, and the length of each.

    Args:
        steps: (n,) values in least increments.
        axis: (n,) axis of each word.
        styles: style of the numbers: point, minimum decimals, leading zero, plus.
        grids: of the axes.
        spaced: (n,) whether a space comes first.
        letter: (n,) the following letter, 0 for none.
        ending: (n, 2) characters after the number, 0 for none.
    """
    point, min_decimals, leading_zero, plus = styles
    places = int(max(grids.decimals.max(initial=0), min_decimals.max(initial=0)))
    size = np.abs(steps) * grids.scale[axis]
    power = (10**grids.decimals)[axis]
    whole = size // power
    fraction = (size - whole * power) * (10 ** (places - grids.decimals))[axis]
    digits = len(str(int(whole.max(initial=0))))
    # One row per character position, for contiguous writes; characters not shown are zero and removed below.
    text = np.empty((digits + places + 6, len(steps)), dtype=np.uint8)
    text[0] = spaced * np.uint8(_SPACE)
    text[1] = letter
    text[2] = np.where(steps < 0, _MINUS, plus * np.uint8(_PLUS))
    _digits(whole, text[3 : 3 + digits])
    text[2 + digits] *= leading_zero | (whole > 0) | (fraction == 0)
    for i in range(1, digits):
        text[2 + digits - i] *= whole >= 10**i
    _digits(fraction, text[4 + digits : -2])
    wanted = np.array(min_decimals)
    for i in range(places):
        wanted[(text[4 + digits + i] != _ZERO) & (wanted <= i)] = i + 1
        # Digits are visited in order, so the last nonzero one decides.
    for i in range(places):
        text[4 + digits + i] *= wanted > i
    text[3 + digits] = ((wanted > 0) | point) * np.uint8(_POINT)
    text[-2:] = ending.T
    shown = np.ascontiguousarray(text.T).tobytes().translate(None, b"\0")
    return np.frombuffer(shown, dtype=np.uint8), np.sum(text != 0, axis=0, dtype=np.uint8).astype(int)


def _digits(number: np.ndarray, out: np.ndarray) -> None:
    """Write the decimal digits of whole numbers, as characters, into the rows of an array."""
    left = number
    for row in range(len(out) - 1, -1, -1):
        rest = left // 10
        out[row] = left - rest * 10 + _ZERO
        left = rest
