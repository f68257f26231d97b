"""The correction of a program beside its own uncertainty: what may be called an improvement, and what may not.

A correction no larger than its uncertainty U is one that a machine without any error would be given as well, one time in twenty or
more often: it is not shown to be an improvement. Just above U the error is shown to be there, and taking it off makes it smaller with
probability Φ(U/2u): 84 % if what is uncertain lies along the correction, 92 % if it is equal in all directions; more from there on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import floor, isfinite, log10
from typing import Any, final

import numpy as np

from twin.uncertainty import DEFINITION, PoseUncertainty

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
    below: tuple[Below, ...]
    known: bool
    without_uncertainty: tuple[str, ...]

    @classmethod
    def of_point(cls, lines: np.ndarray, blocks: np.ndarray, size_um: np.ndarray, at: PoseUncertainty) -> Correction:
        """Of the tool point.

        Args:
            lines: (n,) program lines.
            blocks: (n,) which block each end belongs to.
            size_um: (n,) length of the correction, n > 0.
            at: uncertainty of the n poses.
        """
        return cls._of("tool point", "um", lines, blocks, size_um, at.expanded_um, at.standard_um, at)

    @classmethod
    def of_axis(cls, lines: np.ndarray, blocks: np.ndarray, size_urad: np.ndarray, at: PoseUncertainty) -> Correction:
        """Of the tool axis, as `of_point`."""
        return cls._of("tool axis", "urad", lines, blocks, size_urad, at.axis_expanded_urad, at.standard_urad, at)

    @classmethod
    def _of(
        cls,
        of: str,
        unit: str,
        lines: np.ndarray,
        blocks: np.ndarray,
        size: np.ndarray,
        expanded: np.ndarray,
        standard: np.ndarray,
        at: PoseUncertainty,
    ) -> Correction:
        _, first, index, count = np.unique(blocks, return_index=True, return_inverse=True, return_counts=True)
        of_block = np.sqrt(np.bincount(index, size**2) / count)
        u_of_block = np.sqrt(np.bincount(index, expanded**2) / count)
        largest = int(np.argmax(size))
        widest = int(np.argmax(expanded))
        x, y, z = np.sqrt(np.mean(standard**2, axis=0))
        return cls(
            of=of,
            unit=unit,
            blocks=len(first),
            rms=_rms(size),
            max=float(size[largest]),
            max_expanded=float(expanded[largest]),
            max_line=int(lines[largest]),
            expanded_rms=_rms(expanded),
            expanded_max=float(expanded[widest]),
            expanded_max_line=int(lines[widest]),
            standard_rms=(float(x), float(y), float(z)),
            below=tuple(
                Below(int(lines[first[i]]), float(of_block[i]), float(u_of_block[i]))
                for i in np.flatnonzero(of_block <= u_of_block)
            ),
            known=at.known,
            without_uncertainty=at.without_uncertainty,
        )

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

        def number(value: float) -> float | None:
            return value if isfinite(value) else None

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
            "expanded_at_correction_max" + end: number(self.max_expanded),
            "expanded_rms" + end: number(self.expanded_rms),
            "expanded_max" + end: number(self.expanded_max),
            "expanded_max_line": self.expanded_max_line if self.known else None,
            "standard_rms" + end: [number(value) for value in self.standard_rms],
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


def rounded(value: float, expanded: float) -> tuple[str, str]:
    """A value and its uncertainty as printed: at most two significant digits (JCGM 100, 7.2.6), the value to the same place."""
    decimals = 1 - floor(log10(expanded)) if expanded > 0.0 else 3
    decimals = min(max(decimals, 0), 3)
    return f"{value:.{decimals}f}", f"{expanded:.{decimals}f}"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
