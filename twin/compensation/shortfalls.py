"""What a compensation could not correct: one entry a reason, with all lines and the worst of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin.display import several

SHOWN: Final = 8
"""Line numbers that a text shows before it counts the rest; JSON has them all."""
SIGNS: Final = {"um": "µm", "urad": "µrad", "mm": "mm", "deg": "°"}

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
        size = f"{self.worst:{'.2f' if self.unit in ('um', 'urad') else '.4g'}} {SIGNS[self.unit]}"
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


class _Entry(NamedTuple):
    lines: list[np.ndarray]
    missed: list[np.ndarray]
    worst: float
    worst_line: int


@final
class ShortfallTally:
    """Shortfalls in the making: blocks come a stretch of program at a time."""

    def __init__(self) -> None:
        self._found: dict[tuple[Kind, str, str], _Entry] = {}

    def add(self, kind: Kind, reason: str, unit: str, lines: np.ndarray, sizes: np.ndarray, missed: np.ndarray) -> None:
        """Add blocks.

        Args:
            kind: as of `Shortfall`.
            reason: likewise.
            unit: likewise.
            lines: (n,) line numbers.
            sizes: (n,) how far off each is, in ``unit``.
            missed: (n,) whether the exit status counts it.
        """
        if not lines.size:
            return
        at = int(np.argmax(sizes))
        before = self._found.get((kind, reason, unit), _Entry([], [], -np.inf, 0))
        worst = (float(sizes[at]), int(lines[at])) if sizes[at] > before.worst else (before.worst, before.worst_line)
        self._found[kind, reason, unit] = _Entry([*before.lines, lines], [*before.missed, lines[missed]], *worst)

    def shortfalls(self) -> tuple[Shortfall, ...]:
        """Return all of them, those with most blocks first."""
        found = [
            Shortfall(kind, reason, _unique(entry.lines), _unique(entry.missed), entry.worst_line, entry.worst, unit)
            for (kind, reason, unit), entry in self._found.items()
        ]
        return tuple(sorted(found, key=lambda one: -len(one.lines)))


def _unique(lines: list[np.ndarray]) -> tuple[int, ...]:
    return tuple(np.unique(np.concatenate(lines)).tolist())


def line_numbers(lines: Sequence[int]) -> str:
    """``line 3``, ``lines 3, 5, 7 … and 1,810 more``."""
    more = f" … and {len(lines) - SHOWN:,} more" if len(lines) > SHOWN else ""
    return f"line{'' if len(lines) == 1 else 's'} {', '.join(str(line) for line in lines[:SHOWN])}{more}"
