"""One block of plain language, understood."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

from twin.nc.block import Block


@final
@dataclass(slots=True)
class PathBlock(Block):
    """One block: as `twin.nc.block.Block`, and what only plain language has.

    Attributes:
        numbered: whether it has a number.
        keyword: ``L``, ``LN``, ``C``, ``CR``, or ``""`` for a paraxial block.
        keyword_end: where the keyword ends.
        rapid_text: ``FMAX`` as written, or nothing.
        normal_text: the words ``NX NY NZ`` as written.
        normal: their components, none without them.
        tool: the components of ``TX TY TZ``.
        clockwise: the sense of an arc, None where it has none.
        radius: mm, None where it has none.
        machine: whether its words are machine coordinates.
        retracts: whether it retracts along the tool axis.
    """

    numbered: bool = False
    keyword: str = ""
    keyword_end: int = 0
    rapid_text: str = ""
    normal_text: list[str] = field(default_factory=list)
    normal: list[float] | None = None
    tool: list[float] | None = None
    clockwise: bool | None = None
    radius: float | None = None
    machine: bool = False
    retracts: bool = False
