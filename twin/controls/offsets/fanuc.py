"""Work offsets and tools of a Fanuc control, as it punches them out: programs of ``G10`` blocks.

Source: Fanuc Series 30i operator's manual, "Setting of data by G10": ``G10 L2 P1`` to ``P6`` are G54 to G59, ``P0`` is the external
offset that is added to all, ``G10 L20 P1`` to ``P300`` are G54.1 P1 to P300; ``G10 L10 P R`` is the geometry and ``L11`` the wear of
length offset P.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin.controls.offsets.table import TableForm, value_of

_WORD: Final = re.compile(r"([A-Z])\s*([+-]?(?:\d+\.?\d*|\.\d+))", re.IGNORECASE)
_COMMENT: Final = re.compile(r"\([^()]*\)|;.*")
_G10: Final = re.compile(r"G10\s*L(2|20|10|11)(?!\d)", re.IGNORECASE)
_NOT_AXES: Final = frozenset("GLPRN")


@final
class Fanuc(TableForm):
    """``G10`` blocks."""

    description = "Fanuc offsets as G10 L2 or G10 L10 blocks"

    def is_offsets(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_offsets`."""
        return any(found.group(1) in ("2", "20") for found in map(_G10.search, lines) if found is not None)

    def is_tools(self, lines: Sequence[str]) -> bool:
        """See `TableForm.is_tools`."""
        return any(found.group(1) in ("10", "11") for found in map(_G10.search, lines) if found is not None)

    def offsets(self, path: Path, lines: Sequence[str]) -> dict[str, dict[str, float]]:
        """See `TableForm.offsets`."""
        rows: dict[str, dict[str, float]] = {}
        external: dict[str, float] = {}
        for line, words in _blocks(path, lines, ("2", "20")):
            row = {axis: value for axis, value in words.items() if axis not in _NOT_AXES}
            place = int(words["P"])
            if words["L"] == 20:
                rows[f"G54.1 P{place}"] = row
            elif place == 0:
                external = row
            elif place <= 6:
                rows[f"G{53 + place}"] = row
            else:
                raise InputError("no such work offset", expected="P0 to P6", file=path, line=line, value=f"P{place}")
        return {
            name: {axis: row.get(axis, 0.0) + external.get(axis, 0.0) for axis in {**row, **external}}
            for name, row in rows.items()
        }

    def tools(self, path: Path, lines: Sequence[str]) -> dict[str, float]:
        """See `TableForm.tools`."""
        tools: dict[str, float] = {}
        for line, words in _blocks(path, lines, ("10", "11")):
            if "R" not in words:
                raise InputError("length offset without a value", expected="G10 L10 P1 R120.5", file=path, line=line)
            name = str(int(words["P"]))
            tools[name] = tools.get(name, 0.0) + words["R"]
        return tools


def _blocks(path: Path, lines: Sequence[str], wanted: Sequence[str]) -> list[tuple[int, dict[str, float]]]:
    """Return line number and words of every ``G10`` block of some kinds."""
    blocks = []
    for line, text in enumerate(lines, 1):
        bare = _COMMENT.sub("", text)
        block = _G10.search(bare)
        if block is None or block.group(1) not in wanted:
            continue
        words = {letter.upper(): value_of(path, line, value) for letter, value in _WORD.findall(bare)}
        if "P" not in words:
            raise InputError("G10 without P", expected="G10 L2 P1 X… Y… Z…", file=path, line=line, value=text.strip())
        blocks.append((line, words))
    return blocks
