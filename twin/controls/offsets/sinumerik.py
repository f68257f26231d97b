"""Work offsets and tools of a SINUMERIK 840D: archives with ``$P_UIFR`` and ``$TC_`` variables.

Source: SINUMERIK 840D sl, Programming Manual Job Planning (frames), and Parameter Manual System Variables. ``$P_UIFR[n, axis, TR]``
is the translation and ``FI`` the fine offset of settable work offset n (1 to 4: G54 to G57; 5 and higher: G505 and higher).
``$TC_DP3[t, d]`` is length 1 of edge d of tool t, ``$TC_DP12`` its wear, ``$TC_TP2[t]`` the tool's name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.controls.offsets.table import TableForm, rotated, value_of

_NUMBER: Final = r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
_SHIFT: Final = re.compile(
    rf"(?:N\d+\s+)?\$P_(?:CH)?UIFR\[\s*(\d+)\s*,\s*([A-Z]\w*)\s*,\s*([A-Z]+)\s*\]\s*=\s*{_NUMBER}\s*(?:;.*)?",
    re.IGNORECASE,
)
_WHOLE: Final = re.compile(r"(?:N\d+\s+)?\$P_(?:CH)?UIFR\[\s*(\d+)\s*\]\s*=\s*(.*?)\s*(?:;.*)?", re.IGNORECASE)
_PARTS: Final = re.compile(r"(C[A-Z]+)\(([^()]*)\)", re.IGNORECASE)
_TOOL: Final = re.compile(
    rf"(?:N\d+\s+)?\$TC_(DP3|DP12)\[\s*(\d+)\s*,\s*(\d+)\s*\]\s*=\s*{_NUMBER}\s*(?:;.*)?", re.IGNORECASE
)
_NAME: Final = re.compile(r"(?:N\d+\s+)?\$TC_TP2\[\s*(\d+)\s*\]\s*=\s*\"([^\"]*)\"\s*(?:;.*)?", re.IGNORECASE)


@final
class Sinumerik(TableForm):
    """Variables of an archive."""

    description = "SINUMERIK archive with $P_UIFR or $TC_DP3"

    def is_offsets(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_offsets`."""
        return any("UIFR[" in line.upper() for line in lines)

    def is_tools(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_tools`."""
        return any("$TC_DP3[" in line.upper() for line in lines)

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        rows: dict[str, dict[str, float]] = {}
        for line, text in enumerate(lines, 1):
            shift, whole = _SHIFT.fullmatch(text.strip()), _WHOLE.fullmatch(text.strip())
            if shift is not None:
                parts = [(shift.group(3).upper(), shift.group(2), shift.group(4))]
                name = _offset_name(int(shift.group(1)))
            elif whole is not None:
                name, parts = _offset_name(int(whole.group(1))), _parts(path, line, whole.group(2))
            elif "UIFR[" in text.upper():
                raise InputError("not a work offset", expected="$P_UIFR[1,X,TR]=12.5", file=path, line=line, value=text)
            else:
                continue
            row = rows.setdefault(name, {})
            for kind, axis, number in parts:
                if kind not in ("TR", "FI"):
                    if value_of(path, line, number) != (1.0 if kind == "SC" else 0.0):
                        raise rotated(path, line, name, text.strip())
                    continue
                row[axis.upper()] = row.get(axis.upper(), 0.0) + value_of(path, line, number)
        return rows

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        lengths: dict[tuple[str, str], float] = {}
        names: dict[str, str] = {}
        for line, text in enumerate(map(str.strip, lines), 1):
            tool, named = _TOOL.fullmatch(text), _NAME.fullmatch(text)
            if tool is not None:
                key = tool.group(2), tool.group(3)
                lengths[key] = lengths.get(key, 0.0) + value_of(path, line, tool.group(4))
            elif named is not None:
                names[named.group(1)] = named.group(2)
        tools: dict[str, float] = {}
        for (number, edge), length in lengths.items():
            for tool_name in {number, names.get(number, number)}:
                tools[tool_name if edge == "1" else f"{tool_name} D{edge}"] = length
        return tools


def _offset_name(index: int) -> str:
    return "G500" if index == 0 else f"G{53 + index}" if index <= 4 else f"G{500 + index}"


def _parts(path: Path, line: int, text: str) -> list[tuple[str, str, str]]:
    """Return the parts of a frame written as ``CTRANS(X,1.5,Y,2):CFINE(..)``: kind, axis and number of each."""
    parts = []
    for function, arguments in _PARTS.findall(text):
        cells = [cell.strip() for cell in arguments.split(",")] if arguments.strip() else []
        kind = {"CTRANS": "TR", "CFINE": "FI", "CSCALE": "SC"}.get(function.upper(), "RT")
        if len(cells) % 2:
            expected = 'an axis and a number each: "CTRANS(X,1.5,Y,2)"'
            raise InputError("not a frame", expected=expected, file=path, line=line, value=text)
        parts += [(kind, axis, number) for axis, number in zip(cells[::2], cells[1::2], strict=True)]
    return parts
