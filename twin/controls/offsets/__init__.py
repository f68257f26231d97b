"""Tables of work offsets and tools, as controls write them and as CSV."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

from twin._common.errors import InputError
from twin._common.files import read_lines
from twin.controls.offsets.fanuc import Fanuc
from twin.controls.offsets.heidenhain import PresetsAndTools
from twin.controls.offsets.linuxcnc import LinuxCncTables
from twin.controls.offsets.sinumerik import Sinumerik
from twin.controls.offsets.table import CsvForm, OffsetTable, TableForm, ToolTable

FORMS: Final[tuple[TableForm, ...]] = (PresetsAndTools(), Sinumerik(), Fanuc(), LinuxCncTables(), CsvForm())


def load_offsets(path: str | Path) -> OffsetTable:
    r"""Read the work offsets of a machine.

    Args:
        path: CSV (``offset,X_mm,Y_mm,Z_mm,B_deg,C_deg``), LinuxCNC ``.var``, SINUMERIK ``$P_UIFR``, Fanuc ``G10 L2`` or Heidenhain
            ``.pr``.

    Raises:
        InputError: it cannot be read, has none of these forms, or holds an offset that does more than shift the axes.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("offsets.csv").write_text("offset,X_mm,Y_mm,Z_mm\nG54,250,225,-370\nG55,200,180,-360\n")
        >>> offsets = twin.load_offsets("offsets.csv")
        >>> offsets.assumed, sorted(offsets.rows)
        ('G54', ['G54', 'G55'])
        >>> setup = twin.Setup(offsets=offsets)
    """
    path = Path(path)
    lines = read_lines(path)
    for form in FORMS:
        if form.is_offsets(lines):
            rows = form.offsets(path, lines)
            _check(path, [value for row in rows.values() for value in row.values()])
            if rows:
                return OffsetTable(path, rows)
    raise _unknown(path, "work offsets")


def load_tools(path: str | Path) -> ToolTable:
    r"""Read the tool lengths of a machine.

    Args:
        path: CSV (``tool,length_mm``), LinuxCNC ``.tbl``, SINUMERIK ``$TC_DP3``, Fanuc ``G10 L10``, Heidenhain ``.t``.

    Raises:
        InputError: it cannot be read, or has none of these forms.

    Examples:
        >>> from pathlib import Path
        >>> _ = Path("tools.csv").write_text("tool,length_mm\n1,80.25\n2,112.5\n")
        >>> tools = twin.load_tools("tools.csv")
        >>> dict(tools.lengths_mm)
        {'1': 80.25, '2': 112.5}
        >>> setup = twin.Setup(tools=tools)
    """
    path = Path(path)
    lines = read_lines(path)
    for form in FORMS:
        if form.is_tools(lines):
            lengths = form.tools(path, lines)
            _check(path, [*lengths.values()])
            if lengths:
                return ToolTable(path, lengths)
    raise _unknown(path, "tools")


def _check(path: Path, values: list[float]) -> None:
    for value in values:
        if not math.isfinite(value) or abs(value) > 1e6:
            raise InputError("value out of range", expected="mm or degrees below 1,000,000", file=path, value=value)


def _unknown(path: Path, what: str) -> InputError:
    known = "; ".join(form.description for form in FORMS)
    return InputError(f"not a table of {what} in a known form", expected=known, file=path)


__all__ = [
    "OffsetTable",
    "ToolTable",
    "load_offsets",
    "load_tools",
]
