"""Work offsets and tools that a program uses, as the report lists them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from twin.compensation.toolpath import Section


@final
@dataclass(frozen=True)
class FrameUse:
    """Work offset and tool from a line on.

    Attributes:
        line: the line's number.
        offset: name of the work offset; empty if there is no table of them.
        assumed: whether the program has not selected it.
        tool: number or name of the tool; empty if the program has called none.
        tool_length_mm: its length.
        work_offset: what is added to the words of each axis, mm and degrees; the tool length is included where the control adds it.
        work_origin_mm: the program's zero in the work frame, for tool-tip coordinates.
        tilted_deg: positions of the rotary axes in a tilted plane; empty if there is none.
    """

    line: int
    offset: str
    assumed: bool
    tool: str
    tool_length_mm: float
    work_offset: Mapping[str, float]
    work_origin_mm: tuple[float, float, float]
    tilted_deg: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """Statement in the report."""
        tool = f"tool {self.tool}, {self.tool_length_mm:g} mm" if self.tool else f"tool of {self.tool_length_mm:g} mm"
        name = (
            f"{self.offset}{' (assumed: none selected yet)' if self.assumed else ''}" if self.offset else "work offset"
        )
        added = " ".join(f"{axis} {value:.6g}" for axis, value in self.work_offset.items())
        at = " ".join(f"{axis} {value:.6g}°" for axis, value in self.tilted_deg.items())
        tilted = f"; tilted plane, rotary axes as the control positions them ({at}), not corrected" if at else ""
        return f"from line {self.line}: {tool}; {name} with tool length: {added or 'none'}{tilted}"


def offset_name(section: Section) -> str:
    """Return the name of a section's work offset; empty if there is no table of them."""
    return section.frame.offset or section.assumed_offset


def frame_uses(sections: Sequence[Section], numbers: np.ndarray) -> tuple[FrameUse, ...]:
    """Return the work offsets and tools of a program's sections; empty if the program has no tables of them.

    Args:
        sections: the sections.
        numbers: (lines,) number of every line.
    """
    return tuple(
        FrameUse(
            int(numbers[section.line]),
            offset_name(section),
            not section.frame.offset,
            section.frame.length or section.frame.tool,
            section.space.nominal.tool_length_mm,
            section.space.setup.work_offset,
            section.space.setup.work_origin_mm,
            {}
            if section.space.tilt is None
            else dict(zip(section.space.axes.rotary, section.space.tilt.rotary_deg.tolist(), strict=True)),
        )
        for section in sections
        if section.from_tables
    )
