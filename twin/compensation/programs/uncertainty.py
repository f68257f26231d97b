"""Correction of a program compared with its own uncertainty: which corrections are a proven improvement.

A machine without any error would be given a correction of up to its expanded uncertainty U in 95 % of cases. A correction no larger
than U is therefore not shown to be an improvement. Just above U the error is significant, and removing it reduces it with probability
Φ(U/2u): 84 % if the uncertainty lies along the correction, 92 % if it is equal in all directions; more for larger corrections.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, final

import numpy as np

from twin._common.records import json_form
from twin.display import readable, rounded
from twin.tool.uncertainty import DEFINITION, ToolUncertainty


@final
class CompensationTally:
    """Running sums of squares, and the place at which each quantity is largest.

    ``quantities``: number of quantities; ``squares``: number of sums of squares. ``count``: number of places added; ``largest``:
    (quantities, quantities) all quantities at the place where each is largest; 0 if nothing was added; ``lines``: (quantities,) program
    line of that place.
    """

    def __init__(self, quantities: int, squares: int) -> None:
        self.count = 0
        self.largest = np.zeros((quantities, quantities))
        self.lines = np.zeros(quantities, dtype=int)
        self._squares = np.zeros(squares)

    def add(self, values: np.ndarray, squares: np.ndarray, lines: np.ndarray, count: int | None = None) -> None:
        """Add places.

        ``values``: (quantities, n) values at each place, or only at those at which one of them is largest; ``squares``: (squares,) sums
        of squares over all places; ``lines``: (n,) program line of each place; ``count``: number of all places; n if None.
        """
        if not lines.size:
            return
        at = np.argmax(values, axis=1)
        larger = np.diagonal(values[:, at]) > np.diagonal(self.largest) if self.count else np.full(len(at), True)
        self.largest[larger] = values[:, at[larger]].T
        self.lines[larger] = lines[at[larger]]
        self.count += len(lines) if count is None else count
        self._squares += squares

    @property
    def rms(self) -> list[float]:
        """Root mean squares over all places."""
        return np.sqrt(self._squares / max(self.count, 1)).tolist()


# --- Correction of a program compared with its own uncertainty: which corrections are a proven improvement

BELOW: Final = np.dtype([("line", int), ("correction", float), ("expanded", float)])
NAMED = 8
"""Names without uncertainty that the text prints before it counts the rest; the JSON report has all."""


@final
@dataclass(frozen=True)
class ToolCorrection:
    """Correction of the tool point or of the tool axis at block end points, with its uncertainty."""

    of: str  # ``tool point`` or ``tool axis``
    unit: str  # ``um`` or ``urad``, for every number below
    blocks: int
    rms: float  # rms, max: RMS and largest length of the correction
    max: float
    max_expanded: float  # max_expanded, max_line: U at the largest correction, and its line
    max_line: int
    expanded_rms: float  # RMS of U over the program; NaN if unknown
    expanded_max: float  # expanded_max, expanded_max_line: largest U, and its line
    expanded_max_line: int
    # standard uncertainties (k = 1) along or about x, y, z of the work frame, RMS over the program
    standard_rms: tuple[float, float, float]
    # blocks whose correction is no larger than its own U: ``line``, ``correction`` and ``expanded`` of each, RMS over the end points
    # of its pieces
    below: np.recarray = field(compare=False)
    known: bool  # whether any of the corrected errors has an uncertainty
    without_uncertainty: tuple[str, ...]  # corrected errors without uncertainty; if there are any, U is a lower bound

    @property
    def label(self) -> str:
        """Label in the report."""
        return "correction" if self.unit == "um" else "orientation"

    @property
    def shown(self) -> bool | None:
        """Whether the correction exceeds its uncertainty; None if that uncertainty is unknown, or known only in part."""
        if not self.known:
            return None
        if self.rms <= self.expanded_rms:
            return False
        return None if self.without_uncertainty else True

    @property
    def headline(self) -> str:
        """Summary in one sentence."""
        sign = readable(self.unit)
        if not self.known:
            return f"{self.rms:.1f} {sign} RMS at the block end points, its uncertainty unknown"
        size, expanded = rounded(self.rms, self.expanded_rms)
        least = " at least" if self.without_uncertainty else ""
        if self.shown is False:
            return f"not shown to be an improvement: correction {size} {sign}, its uncertainty U{least} {expanded} {sign} (RMS)"
        if self.shown is None:
            return f"{size} {sign} RMS at the block end points, U at least {expanded} {sign}"
        return f"{size} ± {expanded} {sign} RMS at the block end points (± U, 95 %)"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report; unknown values are null."""
        end = f"_{self.unit}"
        entry = {
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
                dict(zip(("line", "correction" + end, "expanded" + end), block, strict=True))
                for block in self.below.tolist()
            ],
            "without_uncertainty": self.without_uncertainty,
        }
        return dict(json_form(entry))

    def to_text(self, shown: int) -> list[str]:
        """Return the lines of the report below the headline, with at most ``shown`` entries of a list."""
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
                f"    {self.of}: correction not larger than its own uncertainty in {len(self.below)} of {self.blocks} blocks, "
                "which are not shown to be improved:"
            )
            for block in self.below[:shown]:
                size, expanded = rounded(block.correction, block.expanded)
                out.append(f"      line {block.line}: correction {size} {sign}, U {expanded} {sign}")
            if len(self.below) > shown:
                out.append(f"      … and {len(self.below) - shown} more (all in the JSON report)")
        return out


@final
class CorrectionTally:
    """Collects a `ToolCorrection`; block end points are added stretch by stretch, those of one block together.

    ``of``: ``tool point`` or ``tool axis``; ``unit``: ``um`` or ``urad``.
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
        """Add end points.

        ``lines``: (n,) program lines; ``blocks``: (n,) block of each end point, ascending; ``size``: (n,) length of the correction, n >
        0; ``known``: (n, 4) its U and three standard uncertainties; NaN if ``tool`` knows none.
        """
        expanded = known[:, 0]
        first = np.flatnonzero(np.append(True, blocks[1:] != blocks[:-1]))
        count = np.diff(np.append(first, len(blocks)))
        of_block, u_of_block = size, expanded
        if len(first) < len(blocks):
            of_block, u_of_block = (np.sqrt(np.add.reduceat(values**2, first) / count) for values in (size, expanded))
        below = of_block <= u_of_block
        columns = [lines[first[below]], of_block[below], u_of_block[below]]
        self._below.append(np.rec.fromarrays(columns, dtype=BELOW))
        squares = np.array([np.einsum("i,i", size, size), *np.einsum("ij,ij->j", known, known)])
        self._tally.add(np.stack([size, expanded]), squares, lines)
        self._blocks += len(first)
        self._known, self._without = bool(tool.parameters), tool.without_uncertainty

    def correction(self) -> ToolCorrection | None:
        """Return the correction over everything added; None if nothing was."""
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
class UnknownErrors:
    """Errors that the calibration could not determine: no program corrects them, and they limit how well the result is known."""

    names: tuple[str, ...]  # ISO 230-1 names
    # U of the tool point from their plausible size and the corrected errors together, RMS over the program
    expanded_rms_um: float
    expanded_max_um: float  # expanded_max_um, expanded_max_line: the largest such U, and its line
    expanded_max_line: int

    @property
    def text(self) -> str:
        """The errors and U with them, as a sentence."""
        names = ", ".join(self.names[:NAMED]) + (
            f" and {len(self.names) - NAMED} more" if len(self.names) > NAMED else ""
        )
        return (
            f"{names}: not corrected, because not identified. With their plausible size, U of the tool point is "
            f"{self.expanded_rms_um:.0f} µm RMS, at most {self.expanded_max_um:.0f} µm (line {self.expanded_max_line})"
        )


@final
@dataclass(frozen=True)
class Corrections:
    """Corrections of tool point and tool axis; None for one that is not in scope."""

    point: ToolCorrection | None  # point, axis: the corrections, with the uncertainty of the corrected errors
    axis: ToolCorrection | None
    # errors that the calibration could not determine; None if there are none
    not_identified: UnknownErrors | None = None

    def __iter__(self) -> Iterator[ToolCorrection]:
        """Iterate over those that are in scope."""
        return (correction for correction in (self.point, self.axis) if correction is not None)

    @property
    def unknown(self) -> str | None:
        """Statement of the errors without known uncertainty; None if every uncertainty is known."""
        missing = dict.fromkeys(name for correction in self for name in correction.without_uncertainty)
        if not missing:
            return None
        names = ", ".join(list(missing)[:NAMED]) + (f" and {len(missing) - NAMED} more" if len(missing) > NAMED else "")
        what = "known only in part" if any(correction.known for correction in self) else "unknown"
        return f"uncertainty of the correction: {what} (no covariance in the calibration: {names})"

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON report."""
        return {"definition": DEFINITION, "unknown": self.unknown, **json_form(self)}
