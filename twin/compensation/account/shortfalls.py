"""Blocks that were not corrected: one entry per reason, with all line numbers and the worst case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple, final

import numpy as np

from twin._common.counts import count_with_noun
from twin.display import readable

SHOWN: Final = 8
"""Line numbers printed before the rest is counted; the JSON report has all."""

Kind = Literal["range", "orientation", "tolerance", "unknown"]


@final
@dataclass(frozen=True)
class Shortfall:
    """Blocks that could not be corrected, or not within the tolerance, for one reason.

    Attributes:
            kind: ``range``: an axis would leave its range; ``orientation``, ``tolerance``: the tool axis or the point keeps an error;
                ``unknown``: nothing is known of where the block goes.
        reason: why they were not corrected.
        lines: line numbers of all of them in the input.
        missed: line numbers that affect the exit status: the point of a cutting block is out of tolerance, or an orientation that was
            requested is not reached.
        worst_line: line of the worst case.
        worst: its size, in ``unit``.
        unit: ``um`` or ``urad`` at the tool; ``mm`` or ``deg`` beyond an axis's range; empty if the size is unknown.
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
        """Summary in one line."""
        blocks = f"{count_with_noun(len(self.lines), 'block')} ({line_numbers(self.lines)})"
        if not self.unit:
            return f"{blocks}: {self.reason}"
        size = f"{self.worst:{'.2f' if self.unit in ('um', 'urad') else '.4g'}} {readable(self.unit)}"
        return f"{blocks}: {self.reason}; worst {size} (line {self.worst_line})"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report."""
        return {
            "kind": self.kind,
            "reason": self.reason,
            "blocks": len(self.lines),
            "lines": list(self.lines),
            "missed": list(self.missed),
            "worst": {"value": self.worst if self.unit else None, "unit": self.unit, "line": self.worst_line},
        }


class FoundShortfalls(NamedTuple):
    """Blocks found that could not be corrected, for one reason.

    Attributes:
        kind, reason, unit: as in `Shortfall`.
        lines: (n,) line numbers.
        sizes: (n,) remaining error of each, in ``unit``.
        missed: (n,) whether it affects the exit status.
    """

    kind: Kind
    reason: str
    unit: str
    lines: np.ndarray
    sizes: np.ndarray
    missed: np.ndarray


@final
class ShortfallTally:
    """Collects shortfalls by reason, stretch by stretch."""

    def __init__(self) -> None:
        self._found: dict[tuple[Kind, str, str], list[tuple[np.ndarray, np.ndarray]]] = {}
        self._worst: dict[tuple[Kind, str, str], tuple[float, int]] = {}

    def add(self, found: FoundShortfalls) -> None:
        """Add the blocks found for one reason."""
        if not found.lines.size:
            return
        key = found.kind, found.reason, found.unit
        self._found.setdefault(key, []).append((found.lines, found.lines[found.missed]))
        at = int(np.argmax(found.sizes))
        if key not in self._worst or found.sizes[at] > self._worst[key][0]:
            self._worst[key] = float(found.sizes[at]), int(found.lines[at])

    def shortfalls(self) -> tuple[Shortfall, ...]:
        """Return all of them, the reason with the most blocks first."""
        found = []
        for (kind, reason, unit), parts in self._found.items():
            lines, missed = (tuple(np.unique(np.concatenate(part)).tolist()) for part in zip(*parts, strict=True))
            worst, worst_line = self._worst[kind, reason, unit]
            found.append(Shortfall(kind, reason, lines, missed, worst_line, worst, unit))
        return tuple(sorted(found, key=lambda shortfall: -len(shortfall.lines)))


def line_numbers(lines: Sequence[int]) -> str:
    """Return line numbers as text: ``line 3``; ``lines 3, 5, 7 … and 1,810 more``."""
    more = f" … and {len(lines) - SHOWN:,} more" if len(lines) > SHOWN else ""
    return f"line{'' if len(lines) == 1 else 's'} {', '.join(str(line) for line in lines[:SHOWN])}{more}"
