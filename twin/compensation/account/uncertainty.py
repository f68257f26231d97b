"""The correction of a program beside its own uncertainty: what may be called an improvement, and what may not.

A correction no larger than its uncertainty U is one that a machine without any error would be given as well, one time in twenty or
more often: it is not shown to be an improvement. Just above U the error is shown to be there, and taking it off makes it smaller with
probability Φ(U/2u): 84 % if what is uncertain lies along the correction, 92 % if it is equal in all directions; more from there on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np

from twin._common.json_form import json_form
from twin.compensation.account.tally import CompensationTally
from twin.display import readable, rounded
from twin.uncertainty.at_tool import DEFINITION, ToolUncertainty

BELOW: Final = np.dtype([("line", int), ("correction", float), ("expanded", float)])
NAMED = 8
"""Names without uncertainty that the text shows before it counts the rest; JSON has them all."""


@final
@dataclass(frozen=True)
class ToolCorrection:
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
        below: blocks whose correction is no larger than its own U: ``line``, ``correction`` and ``expanded`` of each, RMS over the ends
            of its pieces.
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
    below: np.recarray = field(compare=False)
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
        sign = readable(self.unit)
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
        found = {
            "known": self.known,
            "complete": self.known and not self.without_uncertainty,
            "shown": self.shown,
            "headline": self.headline,
            "blocks": self.blocks,
            "correction_rms" + end: self.rms,
            "correction_max" + end: self.max,
            "correction_max_line": self.max_line,
            "expanded_at_correction_max" + end: self.max_expanded,
            "expanded_rms" + end: self.expanded_rms,
            "expanded_max" + end: self.expanded_max,
            "expanded_max_line": self.expanded_max_line if self.known else None,
            "standard_rms" + end: self.standard_rms,
            "below": [
                dict(zip(("line", "correction" + end, "expanded" + end), one, strict=True))
                for one in self.below.tolist()
            ],
            "without_uncertainty": self.without_uncertainty,
        }
        return dict(json_form(found))

    def to_text(self, shown: int) -> list[str]:
        """Lines of the report below the headline; at most ``shown`` of a list."""
        if not self.known:
            return []
        sign = readable(self.unit)
        size, expanded = rounded(self.max, self.max_expanded)
        along = "along" if self.unit == "um" else "about"
        x, y, z, widest = (rounded(value, value)[1] for value in (*self.standard_rms, self.expanded_max))
        out = [
            f"    {self.of:<12}largest {size} ± {expanded} {sign} (line {self.max_line}); largest U {widest} {sign} "
            f"(line {self.expanded_max_line}); u (k = 1) {along} x {x}, y {y}, z {z} {sign}"
        ]
        if len(self.below):
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
    """A `ToolCorrection` in the making: block ends come a stretch of program at a time, those of one block together.

    Args:
        of: ``tool point`` or ``tool axis``.
        unit: ``um`` or ``urad``.
    """

    def __init__(self, of: str, unit: str) -> None:
        self._of, self._unit = of, unit
        self._tally = CompensationTally(2, 5)
        self._blocks = 0
        self._below: list[np.recarray] = []
        self._known = False
        self._without: tuple[str, ...] = ()

    def add(
        self, lines: np.ndarray, blocks: np.ndarray, size: np.ndarray, known: np.ndarray, tool: ToolUncertainty
    ) -> None:
        """Take some ends.

        Args:
            lines: (n,) program lines.
            blocks: (n,) which block each end belongs to, ascending.
            size: (n,) length of the correction, n > 0.
            known: (n, 4) its U, and standard uncertainties; NaN where ``tool`` knows nothing.
            tool: where these come from.
        """
        expanded, standard = known[:, 0], known[:, 1:]
        first = np.flatnonzero(np.append(True, blocks[1:] != blocks[:-1]))
        count = np.diff(np.append(first, len(blocks)))
        of_block, u_of_block = (np.sqrt(np.add.reduceat(one**2, first) / count) for one in (size, expanded))
        below = of_block <= u_of_block
        columns = [lines[first[below]], of_block[below], u_of_block[below]]
        self._below.append(np.rec.fromarrays(columns, dtype=BELOW))
        squares = np.array([np.sum(size**2), np.sum(expanded**2), *np.sum(standard**2, axis=0)])
        self._tally.add(np.stack([size, expanded]), squares, lines)
        self._blocks += len(first)
        self._known, self._without = bool(tool.parameters), tool.without_uncertainty

    def correction(self) -> ToolCorrection | None:
        """Of all that was added; None of nothing."""
        if not self._tally.count:
            return None
        rms, expanded_rms, x, y, z = self._tally.rms
        (size, expanded), (_, widest) = self._tally.largest.tolist()
        line, widest_line = self._tally.lines.tolist()
        return ToolCorrection(
            of=self._of,
            unit=self._unit,
            blocks=self._blocks,
            rms=rms,
            max=size,
            max_expanded=expanded,
            max_line=line,
            expanded_rms=expanded_rms,
            expanded_max=widest,
            expanded_max_line=widest_line,
            standard_rms=(x, y, z),
            below=np.concatenate(self._below).view(np.recarray),
            known=self._known,
            without_uncertainty=self._without,
        )


@final
@dataclass(frozen=True)
class Corrections:
    """Of point and axis; None where the scope does not correct it."""

    point: ToolCorrection | None
    axis: ToolCorrection | None

    def __iter__(self) -> Iterator[ToolCorrection]:
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
        return {"definition": DEFINITION, "unknown": self.unknown, **json_form(self)}
