"""Work offsets and tools of LinuxCNC: the parameter file (``.var``) and the tool table (``.tbl``).

Source: LinuxCNC user manual, "G-code overview: numbered parameters" and "Tool table". The numbers are in the machine's units, which the
files do not state: millimetres are assumed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.controls.offsets.table import TableForm, rotated, value_of

SYSTEMS: Final = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
_AXES: Final = "XYZABCUVW"
_FIRST: Final = 5221
_STEP: Final = 20
_ACTIVE: Final = 5220
"""Parameter with the number of the work offset in force."""
_RETURNS: Final = {"G28": 5161, "G30": 5181}
"""First parameters of the positions of reference returns."""
_ADDED: Final = 5210
"""Parameter that says whether the offset of G92 (the nine parameters after it) is active."""
_PARAMETER: Final = re.compile(r"\s*(\d+)\s+([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*")
_TOOL: Final = re.compile(r"\s*T(\d+)\s+P\d+\b(.*)", re.IGNORECASE)
_LENGTH: Final = re.compile(r"\bZ\s*([+-]?[\d.]+)", re.IGNORECASE)


def parameter_file(
    offsets: Mapping[str, Mapping[str, float]], in_force: str, references: Mapping[str, Mapping[str, float]]
) -> str:
    """Return a parameter file.

    Args:
        offsets: work offsets by name, each by axis, mm and degrees; those that the control does not have are left out.
        in_force: name of the one in force; that of G54 if the control does not have it.
        references: positions of the axes after ``G28`` and ``G30``.
    """
    values: dict[int, float] = {_ACTIVE: SYSTEMS.index(in_force) + 1 if in_force in SYSTEMS else 1}
    rows = [(_FIRST + _STEP * SYSTEMS.index(name), row) for name, row in offsets.items() if name in SYSTEMS]
    rows += [(first, references.get(word, {})) for word, first in _RETURNS.items()]
    for first, row in rows:
        values |= {first + _AXES.index(axis): value for axis, value in row.items() if axis in _AXES}
    return "".join(f"{number} {value:.6f}\n" for number, value in sorted(values.items()))


@final
class LinuxCncTables(TableForm):
    """Parameter file and tool table."""

    description = "LinuxCNC parameter file or tool table"

    def is_offsets(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_offsets`."""
        return any(line.split()[:1] == [str(_FIRST)] for line in lines)

    def is_tools(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_tools`."""
        return any(map(_TOOL.match, lines))

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        values: dict[int, float] = {}
        line_of: dict[int, int] = {}
        for line, text in enumerate(lines, 1):
            match = _PARAMETER.fullmatch(text)
            if match is not None:
                parameter = int(match.group(1))
                values[parameter], line_of[parameter] = value_of(path, line, match.group(2)), line
            elif text.strip():
                raise InputError("not a parameter", expected="5221 12.500000", file=path, line=line, value=text)
        if values.get(_ADDED) and any(values.get(_ADDED + 1 + i) for i in range(len(_AXES))):
            expected = "a parameter file saved after G92.1"
            raise InputError("a further offset (G92) is active", expected=expected, file=path, line=line_of[_ADDED])
        rows: dict[str, dict[str, float]] = {}
        for place, name in enumerate(SYSTEMS):
            first = _FIRST + _STEP * place
            if values.get(first + len(_AXES)):
                raise rotated(path, line_of[first + len(_AXES)], name, values[first + len(_AXES)])
            if first in values:
                rows[name] = {axis: values[first + i] for i, axis in enumerate(_AXES) if first + i in values}
        return rows

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        tools: dict[str, float] = {}
        for line, text in enumerate(lines, 1):
            entry = text.partition(";")[0]
            tool = _TOOL.match(entry)
            if tool is None:
                if entry.strip():
                    raise InputError("not a tool", expected="T1 P1 Z+120.5", file=path, line=line, value=text)
                continue
            length = _LENGTH.search(tool.group(2))
            tools[tool.group(1)] = 0.0 if length is None else value_of(path, line, length.group(1))
        return tools
