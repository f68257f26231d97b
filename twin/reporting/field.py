"""Error of the tool point, and its U, as a field over the linear axes at fixed rotary positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.json_form import json_form
from twin.kinematics.forward import Kinematics
from twin.reporting.contributions import nominal_machine
from twin.reporting.readings import curve_ranges
from twin.uncertainty.at_tool import ToolUncertainty
from twin.uncertainty.budget import volume

COUNTS: Final = {1: 101, 2: 25, 3: 13}
"""Grid positions per axis, by the number of linear axes; odd, to include the middle."""
DRAWN: Final = 7
"""Largest number of arrows per axis."""
POSES: Final = 300
"""Number of poses for a machine without linear axes."""


@final
@dataclass(frozen=True)
class Slice:
    """One plane of the error field.

    Attributes:
        horizontal, vertical: names of the two axes that span the plane.
        fixed: positions of the other axes, mm and degrees.
        across, up: (a,), (b,) positions of the two axes, mm.
        error_um: (b, a) magnitude of the error of the tool point.
        u_um: (b, a) U of the tool point; NaN if unknown.
    """

    horizontal: str
    vertical: str
    fixed: dict[str, float]
    across: np.ndarray
    up: np.ndarray
    error_um: np.ndarray
    u_um: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(self, rename={"u_um": "U_um"})


@final
@dataclass(frozen=True)
class Field:
    """Error of the tool point at the nodes of a grid.

    Attributes:
        axes: names of all axes, in the order of the columns of ``positions``.
        spread: names of the axes that vary: the linear ones, or all if there is none.
        positions: (n, axes) commands, mm and degrees; on a grid over the linear axes, or random if there is none.
        counts: number of grid positions of every axis of ``spread``; empty without a grid.
        point_mm: (n, 3) nominal tool points in the work frame.
        error_um: (n, 3) error of the tool point, mean of both directions of approach.
        u_um: (n,) U of the tool point; NaN if unknown.
        complete: whether all errors have an uncertainty; if not, a known U is a lower bound.
    """

    axes: tuple[str, ...]
    spread: tuple[str, ...]
    positions: np.ndarray
    counts: tuple[int, ...]
    point_mm: np.ndarray
    error_um: np.ndarray
    u_um: np.ndarray
    complete: bool

    @property
    def standing(self) -> dict[str, float]:
        """Positions of the fixed axes."""
        return {name: float(self.positions[0, i]) for i, name in enumerate(self.axes) if name not in self.spread}

    @property
    def size_um(self) -> np.ndarray:
        """(n,) magnitude of the error."""
        return np.asarray(np.linalg.norm(self.error_um, axis=1))

    @property
    def mean_um(self) -> np.ndarray:
        """(3,) mean error, which setting the workpiece zero removes."""
        return np.asarray(self.error_um.mean(axis=0))

    @property
    def rms_um(self) -> float:
        """Root mean square of the error."""
        return float(np.sqrt(np.mean(self.size_um**2)))

    @property
    def rms_about_mean_um(self) -> float:
        """Root mean square of the error minus its mean."""
        return float(np.sqrt(np.mean(np.sum((self.error_um - self.mean_um) ** 2, axis=1))))

    @property
    def steps_mm(self) -> dict[str, float]:
        """Grid spacing by axis."""
        columns = [self.positions[:, self.axes.index(name)] for name in self.spread]
        ways = zip(self.spread, self.counts, columns, strict=True)
        return {name: float(np.ptp(column)) / max(count - 1, 1) for name, count, column in ways}

    @property
    def known(self) -> bool:
        """Whether U is known at all positions."""
        return bool(np.all(np.isfinite(self.u_um)))

    @property
    def drawn(self) -> np.ndarray:
        """Indices of the positions drawn as arrows, on a coarser grid with its ends."""
        if not self.counts:
            return np.arange(len(self.positions))
        thin = [np.unique(np.round(np.linspace(0, count - 1, min(count, DRAWN))).astype(int)) for count in self.counts]
        return np.asarray(np.ravel_multi_index(np.meshgrid(*thin, indexing="ij"), self.counts).reshape(-1))

    @cached_property
    def slices(self) -> tuple[Slice, ...]:
        """Planes: for three axes, three per direction at both ends and in the middle; for two axes one; for one axis none."""
        places = [np.unique(self.positions[:, self.axes.index(name)]) for name in self.spread]
        if len(self.counts) == 2:
            return (self._slice(places, {}),)
        if len(self.counts) < 2:
            return ()
        levels = [(axis, level) for axis in (2, 1, 0) for level in (0, self.counts[axis] // 2, self.counts[axis] - 1)]
        return tuple(self._slice(places, {axis: level}) for axis, level in levels)

    def _slice(self, places: list[np.ndarray], at: Mapping[int, int]) -> Slice:
        """Return the plane at the given grid level of the fixed axes."""
        across, up = (i for i in range(len(places)) if i not in at)
        levels = tuple(at.get(i, slice(None)) for i in range(len(places)))
        error, u = (read_only(values.reshape(self.counts)[levels].T.copy()) for values in (self.size_um, self.u_um))
        fixed = {self.spread[i]: float(places[i][level]) for i, level in at.items()}
        return Slice(
            self.spread[across], self.spread[up], fixed, read_only(places[across]), read_only(places[up]), error, u
        )

    def edges(self) -> tuple[tuple[str, np.ndarray, np.ndarray], ...]:
        """Return the edges of the grid's box, each with a label and its end points, mm; one edge per axis has a label."""
        if not self.counts:
            return ()
        found = []
        for i, name in enumerate(self.spread):
            others = [(0, count - 1) for k, count in enumerate(self.counts) if k != i]
            for first, corner in enumerate(product(*others)):
                ends = []
                for end in (0, self.counts[i] - 1):
                    at = [*corner[:i], end, *corner[i:]]
                    ends.append(int(np.ravel_multi_index(at, self.counts)))
                low, high = (self.positions[end, self.axes.index(name)] for end in ends)
                text = "" if first else f"{name} {low:g} … {high:g} mm".replace("-", "−")
                found.append((text, self.point_mm[ends[0]], self.point_mm[ends[1]]))
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """Return the content for JSON."""
        return json_form(
            {
                "axes": self.axes,
                "spread": self.spread,
                "standing": self.standing,
                "rms_um": self.rms_um,
                "max_um": self.size_um.max(),
                "mean_um": self.mean_um,
                "U_known": self.known,
                "U_complete": self.known and self.complete,
                "positions": self.positions,
                "point_mm": self.point_mm,
                "error_um": self.error_um,
                "U_um": self.u_um,
                "slices": self.slices,
            }
        )


def field(kinematics: Kinematics) -> Field:
    """Return the error field of a machine, with the rotary axes at zero or at the end of their range nearest to zero.

    Args:
        kinematics: machine, errors, tool, conditions.
    """
    machine = kinematics.machine
    bounds = curve_ranges(kinematics)
    linear = machine.linear[:3]
    if linear:
        counts = tuple(COUNTS[len(linear)] for _ in linear)
        steps = [
            np.linspace(low, high, counts[linear.index(i)])
            if i in linear
            else np.array([(low + high) / 2.0 if axis.linear else float(np.clip(0.0, low, high))])
            for i, (axis, (low, high)) in enumerate(zip(machine.axes, bounds, strict=True))
        ]
        q = np.array(list(product(*steps)))
        # Linear and rotary axes may alternate in command order; a rotary axis has one position.
        spread = tuple(machine.names[i] for i in linear)
    else:
        counts, spread = (), machine.names
        q = volume(machine, POSES)
        q = q[~kinematics.outside_domain(q).any(axis=1)]
    meant, reached = nominal_machine(kinematics).forward(q), kinematics.forward(q)
    error = (reached.point_mm - meant.point_mm) * 1e3
    u = ToolUncertainty(kinematics).at(q)
    return Field(
        axes=machine.names,
        spread=spread,
        positions=read_only(q),
        counts=counts,
        point_mm=meant.point_mm,
        error_um=read_only(error),
        u_um=u.expanded_um,
        complete=u.complete,
    )
