"""What a compensation could not correct: one entry a reason, with all lines and the worst of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin.display import readable, several

SHOWN: Final = 8
"""Line numbers that a text shows before it counts the rest; JSON has them all."""

Kind = Literal["range", "orientation", "tolerance"]


@final
@dataclass(frozen=True)
class Shortfall:
    """Blocks that could not be corrected, or not within the tolerance, for one reason.

    Attributes:
        kind: ``range``: an axis would leave its range; ``orientation``: the tool axis stays off; ``tolerance``: the point does.
        reason: why.
        lines: all of them, line numbers of the input.
        missed: those that the exit status counts: the point of a cutting block is off by more than the tolerance, or an orientation
            that was asked for.
        worst_line: the line where it is worst.
        worst: the size there, in ``unit``.
        unit: ``um`` or ``urad`` at the tool; ``mm`` or ``deg`` beyond an axis's range.
    """

    kind: Kind
    reason: str
    lines: tuple[int, ...]
    missed: tuple[int, ...]
    worst_line: int
    worst: float
    unit: str

    @property
    def text(self) -> str:
        """In one line, for a person."""
        size = f"{self.worst:{'.2f' if self.unit in ('um', 'urad') else '.4g'}} {readable(self.unit)}"
        return f"{several(len(self.lines), 'block')} ({line_numbers(self.lines)}): {self.reason}; worst {size} (line {self.worst_line})"

    def to_dict(self) -> dict[str, Any]:
        """The JSON."""
        return {
            "kind": self.kind,
            "reason": self.reason,
            "blocks": len(self.lines),
            "lines": list(self.lines),
            "missed": list(self.missed),
            "worst": {"value": self.worst, "unit": self.unit, "line": self.worst_line},
        }


class FoundShortfalls(NamedTuple):
    """Blocks that could not be corrected for one reason.

    Attributes:
        kind, reason, unit: as of `Shortfall`.
        lines: (n,) line numbers.
        sizes: (n,) how far off each is, in ``unit``.
        missed: (n,) whether the exit status counts it.
    """

    kind: Kind
    reason: str
    unit: str
    lines: np.ndarray
    sizes: np.ndarray
    missed: np.ndarray


@final
class ShortfallTally:
    """Shortfalls in the making: blocks come a stretch of program at a time."""

    def __init__(self) -> None:
        self._found: dict[tuple[Kind, str, str], list[tuple[np.ndarray, np.ndarray]]] = {}
        self._worst: dict[tuple[Kind, str, str], tuple[float, int]] = {}

    def add(self, found: FoundShortfalls) -> None:
        """Add blocks."""
        if not found.lines.size:
            return
        key = found.kind, found.reason, found.unit
        self._found.setdefault(key, []).append((found.lines, found.lines[found.missed]))
        at = int(np.argmax(found.sizes))
        if key not in self._worst or found.sizes[at] > self._worst[key][0]:
            self._worst[key] = float(found.sizes[at]), int(found.lines[at])

    def shortfalls(self) -> tuple[Shortfall, ...]:
        """Return all of them, those with most blocks first."""
        found = []
        for (kind, reason, unit), parts in self._found.items():
            lines, missed = (tuple(np.unique(np.concatenate(part)).tolist()) for part in zip(*parts, strict=True))
            worst, worst_line = self._worst[kind, reason, unit]
            found.append(Shortfall(kind, reason, lines, missed, worst_line, worst, unit))
        return tuple(sorted(found, key=lambda one: -len(one.lines)))


def line_numbers(lines: Sequence[int]) -> str:
    """``line 3``, ``lines 3, 5, 7 … and 1,810 more``."""
    more = f" … and {len(lines) - SHOWN:,} more" if len(lines) > SHOWN else ""
    return f"line{'' if len(lines) == 1 else 's'} {', '.join(str(line) for line in lines[:SHOWN])}{more}"
