"""Nominal length of a ball bar: the comment of a table that states it, and lengths from deviations."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin.measurement.instruments import INSTRUMENTS, SIDES

COMMENT: Final = "ball bar length"
"""First words of the comment of a table that states the length: ``# ball bar length: 150 mm``."""
BARS: Final = tuple(one.name for one in INSTRUMENTS if one.specification.nominal_length)
"""Names of the instruments with a nominal length."""


def stated_length_mm(comments: Sequence[str], path: Path) -> float | None:
    """Return the length that the comments of a table state, mm; None if they state none.

    Raises:
        InputError: a length that cannot be read, or two different lengths.
    """
    found: dict[float, str] = {}
    for text in comments:
        if not text.lower().startswith(COMMENT):
            continue
        match = re.fullmatch(r"\s*:\s*(\d+\.?\d*(?:[eE][+-]?\d+)?)\s*mm\s*", text[len(COMMENT) :])
        value = float(match[1]) if match else 0.0
        if not 0.0 < value < 1e6:
            raise InputError(
                "the length of the ball bar cannot be read", expected=f"{COMMENT}: 150 mm", file=path, value=text
            )
        found[value] = text
    if len(found) > 1:
        raise InputError(
            f"the table states different lengths of the ball bar: {_listed(found)}",
            expected="one length; readings of another bar belong in another table",
            file=path,
        )
    return next(iter(found), None)


def length_comment(bar_mm: np.ndarray) -> list[str]:
    """Return the comment that states the length of a table's ball bar, as a list; empty if it has none.

    Args:
        bar_mm: (n,) nominal lengths, mm; NaN where there is none.

    Raises:
        InputError: rows with different lengths.
    """
    lengths = np.unique(bar_mm[np.isfinite(bar_mm)]).tolist()
    if len(lengths) > 1:
        raise InputError(
            f"ball bars of different lengths: {_listed(lengths)}", expected="one table for each length of the ball bar"
        )
    return [f"{COMMENT}: {length:.12g} mm" for length in lengths]


def with_length(values: Mapping[str, Any], length_mm: float) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the fields of a table that the length of its ball bar changes, and what to note.

    The rows of the ball bar are those that name it, and those without an instrument that read a length alone from a station on the
    tool or work side. Readings below half of the length are deviations from it, to which it is added.

    Args:
        values: the fields ``point_mm``, ``instrument``, ``station_carrier`` and ``bar_mm`` (NaN or absent where no length is known).
        length_mm: the nominal length.

    Raises:
        InputError: a row that already has another length.
    """
    point, names = np.array(values["point_mm"]), np.asarray(values["instrument"]).astype(str)
    alone = np.isnan(point[:, 1:]).all(axis=1) & (values["station_carrier"] != SIDES[0])
    rows = np.isin(names, BARS) | ((names == "") & alone)
    bar = np.array(values.get("bar_mm", np.full(len(point), np.nan)))
    other = bar[rows & np.isfinite(bar) & (bar != length_mm)]
    if len(other):
        raise InputError(
            f"two lengths of the ball bar: {other[0]:.12g} mm in the table, {length_mm:.12g} mm given",
            expected="the length of the table, or no length in the table",
        )
    bar[rows] = length_mm
    deviations = rows & (point[:, 0] < length_mm / 2.0)
    point[deviations, 0] += length_mm
    note = f"lengths near zero count as deviations from the ball bar's length of {length_mm:.12g} mm"
    return {"point_mm": read_only(point), "bar_mm": read_only(bar)}, (note,) if deviations.any() else ()


def _listed(lengths: Sequence[float] | Mapping[float, str]) -> str:
    return " and ".join(f"{length:.12g} mm" for length in lengths)
