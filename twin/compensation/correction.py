"""The correction of a program beside its own uncertainty: what may be called an improvement, and what may not.

A correction no larger than its uncertainty U is one that a machine without any error would be given as well, one time in twenty or
more often: it is not shown to be an improvement. Just above U the error is shown to be there, and taking it off makes it smaller with
probability Φ(U/2u): 84 % if what is uncertain lies along the correction, 92 % if it is equal in all directions; more from there on.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, final, overload

import numpy as np

from twin.display import finite, rounded
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty

NAMED = 8
"""Names without uncertainty that the text shows before it counts the rest; JSON has them all."""


@final
@dataclass(frozen=True)
class Below:
    """A block whose correction is no larger than its uncertainty, RMS over the ends of its pieces."""

    line: int
    correction: float
    expanded: float


@final
class Belows(Sequence[Below]):
    """Blocks whose correction is no larger than its uncertainty, in columns: they may be all of a long program.

    Args:
        line: (n,) program lines.
        correction: (n,) of each.
        expanded: (n,) U of each.
    """

    def __init__(self, line: np.ndarray, correction: np.ndarray, expanded: np.ndarray) -> None:
        self._columns = (line, correction, expanded)

    def __len__(self) -> int:
        return len(self._columns[0])

    @overload
    def __getitem__(self, index: int) -> Below: ...
    @overload
    def __getitem__(self, index: slice) -> list[Below]: ...
    def __getitem__(self, index: int | slice) -> Below | list[Below]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        line, correction, expanded = (column[index] for column in self._columns)
        return Below(int(line), float(correction), float(expanded))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    def __hash__(self) -> int:
        return hash(tuple(self))


@final
@dataclass(frozen=True)
class Correction:
    """What was corrected at the block ends, of the tool point or of the tool axis.

    Attributes:
        of: ``tool point`` or ``tool axis``.
        unit: ``um`` or ``urad``; of every number below.
        blocks: how many blocks.
        rms, max: length of the correction.
        max_expanded, max_line: U there, and the line.
        expanded_rms: U over the program; NaN if unknown.
        expanded_max, expanded_max_line: the largest.
        standard_rms: standard uncertainties (k = 1) along or about x, y, z of the work frame, RMS over the program.
        below: blocks whose correction is no larger than its own U.
        known: whether anything that was corrected has an uncertainty.
        without_uncertainty: what of it has none: if some has, U is a lower bound.
    """

    of: str
    unit: str
    blocks: int
    rms: float
    max: float
    max_expanded: float
    max_line: int
    expanded_rms: float
    expanded_max: float
    expanded_max_line: int
    standard_rms: tuple[float, float, float]
    below: Sequence[Below]
    known: bool
    without_uncertainty: tuple[str, ...]

    @property
    def label(self) -> str:
        """As the report calls it."""
        return "correction" if self.unit == "um" else "orientation"

    @property
    def shown(self) -> bool | None:
        """Whether it is shown to be an improvement; None where its uncertainty is not known, or only in part."""
        if not self.known:
            return None
        if self.rms <= self.expanded_rms:
            return False
        return None if self.without_uncertainty else True

    @property
    def headline(self) -> str:
        """The one sentence about it."""
        sign = "µm" if self.unit == "um" else "µrad"
        if not self.known:
            return f"{self.rms:.1f} {sign} RMS at the block ends, its uncertainty unknown"
        size, expanded = rounded(self.rms, self.expanded_rms)
        least = " at least" if self.without_uncertainty else ""
        if self.shown is False:
            return f"not shown to be an improvement: correction {size} {sign}, its uncertainty U{least} {expanded} {sign} (RMS)"
        if self.shown is None:
            return f"{size} {sign} RMS at the block ends, U at least {expanded} {sign}"
        return f"{size} ± {expanded} {sign} RMS at the block ends (± U, 95 %)"

    def to_dict(self) -> dict[str, Any]:
        """For JSON; null where it is not known."""
        end = f"_{self.unit}"
        return {
            "known": self.known,
            "complete": self.known and not self.without_uncertainty,
            "shown": self.shown,
            "headline": self.headline,
            "blocks": self.blocks,
            "correction_rms" + end: self.rms,
            "correction_max" + end: self.max,
            "correction_max_line": self.max_line,
            "expanded_at_correction_max" + end: finite(self.max_expanded),
            "expanded_rms" + end: finite(self.expanded_rms),
            "expanded_max" + end: finite(self.expanded_max),
            "expanded_max_line": self.expanded_max_line if self.known else None,
            "standard_rms" + end: [finite(value) for value in self.standard_rms],
            "below": [
                {"line": one.line, "correction" + end: one.correction, "expanded" + end: one.expanded}
                for one in self.below
            ],
            "without_uncertainty": list(self.without_uncertainty),
        }

    def to_text(self, shown: int) -> list[str]:
        """Lines of the report below the headline; at most ``shown`` of a list."""
        if not self.known:
            return []
        sign = "µm" if self.unit == "um" else "µrad"
        size, expanded = rounded(self.max, self.max_expanded)
        along = "along" if self.unit == "um" else "about"
        standard = ", ".join(
            f"{axis} {rounded(value, value)[1]}" for axis, value in zip("xyz", self.standard_rms, strict=True)
        )
        widest = rounded(self.expanded_max, self.expanded_max)[1]
        out = [
            f"    {self.of:<12}largest {size} ± {expanded} {sign} (line {self.max_line}); largest U {widest} {sign} "
            f"(line {self.expanded_max_line}); u (k = 1) {along} {standard} {sign}"
        ]
        if self.below:
            out.append(
                f"    {self.of}: correction no larger than its own uncertainty in {len(self.below)} of {self.blocks} blocks; "
                "not shown to be improved:"
            )
            for one in self.below[:shown]:
                size, expanded = rounded(one.correction, one.expanded)
                out.append(f"      line {one.line}: correction {size} {sign}, U {expanded} {sign}")
            if len(self.below) > shown:
                out.append(f"      … and {len(self.below) - shown} more (all in the JSON report)")
        return out


@final
class CorrectionTally:
    """A `Correction` in the making: block ends come a stretch of program at a time, those of one block together.

    Args:
        of: ``tool point`` or ``tool axis``.
        unit: ``um`` or ``urad``.
    """

    def __init__(self, of: str, unit: str) -> None:
        self._of, self._unit = of, unit
        self._ends = self._blocks = 0
        self._squares, self._standard = np.zeros(2), np.zeros(3)
        self._largest = (-1.0, 0.0, 0)
        self._widest = (-np.inf, 0)
        self._below: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        self._known = False
        self._without: tuple[str, ...] = ()

    def add(
        self,
        lines: np.ndarray,
        blocks: np.ndarray,
        size: np.ndarray,
        expanded: np.ndarray,
        standard: np.ndarray,
        tool: ToolUncertainty,
    ) -> None:
        """Take some ends.

        Args:
            lines: (n,) program lines.
            blocks: (n,) which block each end belongs to, ascending.
            size: (n,) length of the correction, n > 0.
            expanded: (n,) its U.
            standard: (n, 3) standard uncertainties.
            tool: where these come from; NaN where it knows nothing.
        """
        first = np.flatnonzero(np.append(True, blocks[1:] != blocks[:-1]))
        count = np.diff(np.append(first, len(blocks)))
        of_block = np.sqrt(np.add.reduceat(size**2, first) / count)
        u_of_block = np.sqrt(np.add.reduceat(expanded**2, first) / count)
        below = of_block <= u_of_block
        self._below.append((lines[first[below]], of_block[below], u_of_block[below]))
        largest, widest = int(np.argmax(size)), int(np.argmax(expanded))
        if size[largest] > self._largest[0]:
            self._largest = float(size[largest]), float(expanded[largest]), int(lines[largest])
        if not self._ends or expanded[widest] > self._widest[0]:
            self._widest = float(expanded[widest]), int(lines[widest])
        self._ends += len(size)
        self._blocks += len(first)
        self._squares += [np.sum(size**2), np.sum(expanded**2)]
        self._standard += np.sum(standard**2, axis=0)
        self._known, self._without = bool(tool.parameters), tool.without_uncertainty

    def correction(self) -> Correction | None:
        """Of all that was added; None of nothing."""
        if not self._ends:
            return None
        rms, expanded_rms = np.sqrt(self._squares / self._ends).tolist()
        x, y, z = np.sqrt(self._standard / self._ends).tolist()
        return Correction(
            of=self._of,
            unit=self._unit,
            blocks=self._blocks,
            rms=rms,
            max=self._largest[0],
            max_expanded=self._largest[1],
            max_line=self._largest[2],
            expanded_rms=expanded_rms,
            expanded_max=self._widest[0],
            expanded_max_line=self._widest[1],
            standard_rms=(x, y, z),
            below=Belows(*(np.concatenate(columns) for columns in zip(*self._below, strict=True))),
            known=self._known,
            without_uncertainty=self._without,
        )


@final
@dataclass(frozen=True)
class Corrections:
    """Of point and axis; None where the scope does not correct it."""

    point: Correction | None
    axis: Correction | None

    def __iter__(self) -> Iterator[Correction]:
        """Those there are."""
        return (one for one in (self.point, self.axis) if one is not None)

    @property
    def unknown(self) -> str | None:
        """What is not known of their uncertainty; None if all of it is."""
        missing = dict.fromkeys(name for one in self for name in one.without_uncertainty)
        if not missing:
            return None
        names = ", ".join(list(missing)[:NAMED]) + (f" and {len(missing) - NAMED} more" if len(missing) > NAMED else "")
        what = "known in part" if any(one.known for one in self) else "unknown"
        return f"uncertainty of the correction: {what} (no covariance in the calibration: {names})"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "definition": DEFINITION,
            "unknown": self.unknown,
            "point": None if self.point is None else self.point.to_dict(),
            "axis": None if self.axis is None else self.axis.to_dict(),
        }
