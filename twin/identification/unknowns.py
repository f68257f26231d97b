"""The unknowns of the machine: every error motion as a sum of functions, every squareness and location a number.

In an estimate, a curve is a sum of functions that are orthonormal over its domain (mean square one), derived from those of its basis
in their order. A coefficient is then the RMS of its component, orders are uncorrelated, and the choice of the datum is simple:

- a constant belongs to the axis's zero, to a location, or to the places of the targets: curves have none;
- the slope of a straightness belongs to a squareness or to the machine frame, whose x is X's mean line and whose xy-plane contains
  Y's: straightness curves have none. Mean lines are least-squares lines over the axis's range (ISO 230-1, 3.4.12 allows it);
- a shift or tilt of everything that a rotary axis carries (first harmonics of E_X and E_Y, and of E_A and E_B, that rotate with it)
  belongs to the places of these things: pairs of curves have no such component (`Unknowns.datum`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from twin._common.arrays import read_only
from twin._common.units import UM
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.datum.conditions import along, turning_patterns
from twin.model.effects import AxisLocation, Squareness, split_name, unit_of
from twin.model.effects.base import Effect
from twin.model.motion_curve import Curve
from twin.numerics.covariance import Covariance
from twin.numerics.curves import Basis, CurveSpace
from twin.numerics.observability import NOT_DETERMINED


@final
@dataclass(frozen=True)
class UnknownNumber:
    """One unknown parameter.

    Attributes:
        entity: ``E_XX``, ``E_C0Y``, ``E_X0C``.
        index: of the orthonormal function; 0 for a squareness or location.
    """

    entity: str
    index: int


@final
class Unknowns:
    """The unknowns of a machine, in a fixed order of columns.

    Args:
        curves: function spaces of its error motions.
        constants: names of squareness and locations.
        fixed_axes: axes next to a carrier on which all targets' places are known. Nothing else can compensate a constant or a
            rotating pattern there, so their curves have one.
        offsets: names of the curves that do; all of those axes' if None.

    Attributes:
        plausible: (columns,) prior standard deviations, µm or µrad (`Machine.plausible`).
    """

    def __init__(
        self,
        machine: Machine,
        curves: Sequence[CurveSpace],
        constants: Sequence[str],
        fixed_axes: Sequence[str] = (),
        offsets: Sequence[str] | None = None,
    ) -> None:
        self.machine = machine
        self.curves = tuple(curves)
        self.constants = tuple(constants)
        self.fixed_axes = tuple(fixed_axes)
        self.offsets = tuple(
            c.name
            for c in self.curves
            for axis in [split_name(c.name)[2]]
            if axis in self.fixed_axes
            and (offsets is None or c.name in offsets)
            and not (not machine.by_name[axis].linear and f"{c.name[:3]}0{axis}" in self.constants)
        )
        self.columns = tuple(
            [UnknownNumber(c.name, k) for c in self.curves for k in range(c.first, c.count)]
            + [UnknownNumber(name, 0) for name in self.constants]
            + [UnknownNumber(offset_name(name), 0) for name in self.offsets]
        )
        self.index = {column: i for i, column in enumerate(self.columns)}
        self.plausible = read_only(
            np.array([machine.plausible(column.entity) for column in self.columns], dtype=float).reshape(-1)
        )
        self._frames = {(frame.axis, frame.role): i for i, frame in enumerate(machine.frames)}

    @classmethod
    def largest(
        cls, machine: Machine, data: Measurements, *, bases: dict[str, Basis], most: int, wanted: Callable[[str], bool]
    ) -> Unknowns:
        """Return all unknowns that a table's positions can determine; arguments as of `spaces_for`."""
        spaces, constants = spaces_for(machine, data.positions, bases=bases, most=most, wanted=wanted)
        return cls(machine, spaces, constants, axes_with_known_places(machine, data))

    def __len__(self) -> int:
        return len(self.columns)

    def of(self, entity: str) -> list[int]:
        """Return the columns of one curve, squareness or location, lowest order first."""
        return [i for i, column in enumerate(self.columns) if column.entity == entity]

    @property
    def entities(self) -> tuple[str, ...]:
        """Every curve, squareness and location."""
        return (*(curve.name for curve in self.curves), *self.constants)

    def lowest_unseen(self, name: str, unseen: np.ndarray) -> bool:
        """Return whether the lowest order of a curve, or a constant itself, is among the (columns,) that are undetermined."""
        lowest = next((len(c.groups()[0]) for c in self.curves if c.name == name), 1)
        return bool(np.any(unseen[self.of(name)[:lowest]]))

    def without_unseen_offset(self, unseen: np.ndarray) -> Unknowns:
        """Return these without the least determined constant of a curve; the same object if all are determined."""
        name = least_determined_offset(self, unseen)
        if name is None:
            return self
        offsets = [offset for offset in self.offsets if offset != name]
        return Unknowns(self.machine, self.curves, self.constants, self.fixed_axes, offsets)

    def restricted(self, unseen: np.ndarray, dropped: Sequence[str], whole: Sequence[str]) -> Unknowns:
        """Return these without some errors, and each curve below its first undetermined order; the same object if nothing is left out.

        ``unseen``: (columns,) whether a column is undetermined.
        """
        curves = [
            curve if curve.name in whole else curve.below(unseen[self.of(curve.name)])
            for curve in self.curves
            if curve.name not in dropped
        ]
        constants = [name for name in self.constants if name not in dropped]
        if len(constants) == len(self.constants) and list(self.curves) == curves:
            return self
        return Unknowns(self.machine, curves, constants, self.fixed_axes, self.offsets)

    def shapes(self, positions: np.ndarray) -> list[list[tuple[int, np.ndarray]]]:
        """Return the change of the error frames per unit (µm or µrad) of each column.

        ``positions``: (n, axes) mm and degrees.

        Returns:
            A list for each column: (component among 6·frames, (n,) metres or radians).
        """
        by_axis = {axis.name: positions[:, i] for i, axis in enumerate(self.machine.axes)}
        shapes: list[list[tuple[int, np.ndarray]]] = []
        # The six curves of an axis usually have the same functions, which are evaluated once.
        known: dict[tuple[str, Basis, tuple[float, float], int], np.ndarray] = {}
        for curve in self.curves:
            component, _, axis_name = split_name(curve.name)
            key = axis_name, curve.basis, curve.domain, curve.count
            if key not in known:
                axis = self.machine.by_name[axis_name]
                known[key] = curve.functions(wrapped(by_axis[axis_name], axis, curve.domain)) * UM
            values, at = known[key], 6 * self._frames[axis_name, "motion"] + component
            shapes += [[(at, values[:, k])] for k in range(curve.first, curve.count)]
        for name in self.constants:
            effect = self._constant(name, 0.0)
            at = 6 * self._frames[effect.frame.axis, effect.frame.role]
            (shape,) = effect.derivatives(by_axis)
            shapes.append([(at + i, np.asarray(values) * UM) for i, values in shape.items()])
        for name in self.offsets:
            component, _, axis_name = split_name(name)
            at = 6 * self._frames[axis_name, "motion"] + component
            shapes.append([(at, np.full(len(positions), UM))])
        return shapes

    @cached_property
    def datum(self) -> np.ndarray:
        """(conditions, columns): each row is a combination that is zero by the choice of the datum; see the module."""
        rows = []
        spaces = {curve.name: curve for curve in self.curves}
        for axis in self.machine.axes:
            if axis.linear or axis.name in self.fixed_axes:
                continue
            for letters in ("XYZ", "ABC"):
                for pattern in turning_patterns(axis):
                    row = np.zeros(len(self))
                    for letter, part in zip(letters, pattern, strict=True):
                        space = spaces.get(f"E_{letter}{axis.name}")
                        if space is not None:
                            q, w = space.grid()
                            inner = (w * part(q)) @ space.functions(q)
                            for k in range(space.first, space.count):
                                row[self.index[UnknownNumber(space.name, k)]] = inner[k]
                    if np.abs(row).max(initial=0.0) > 1e-9:
                        rows.append(row / np.linalg.norm(row))
        return read_only(np.array(rows).reshape(len(rows), len(self)))

    def calibration(
        self, theta: np.ndarray, kept: Sequence[int], source: str, covariance: np.ndarray | None
    ) -> tuple[Calibration, np.ndarray]:
        """Return the calibration of an estimate.

        ``theta``: (columns,) µm and µrad; ``kept``: columns that are reported; a curve without any is left out; ``covariance``:
        (columns, columns), or None.

        Returns:
            The calibration, and the (parameters, columns) matrix from these unknowns to its parameters.
        """
        reported = set(kept)
        rows: list[np.ndarray] = []
        names: list[str] = []
        curves: dict[str, Curve] = {}
        for space in self.curves:
            orders = [
                k for k in range(space.first, space.count) if self.index[UnknownNumber(space.name, k)] in reported
            ]
            if not orders:
                continue
            count = orders[-1] + 1
            block, written = np.zeros((count, len(self))), space.transform_of(count)
            for k in orders:
                block[:, self.index[UnknownNumber(space.name, k)]] = written[:, k]
            if space.name in self.offsets:
                block[:, self.index[UnknownNumber(offset_name(space.name), 0)]] = written[:, 0]
            unit = unit_of(space.name)
            own = None if covariance is None else read_only(_symmetric(block @ covariance @ block.T))
            values = tuple(float(v) for v in block @ theta)
            curves[space.name] = Curve(space.name, unit, space.domain, space.basis.name, values, own)
            rows += list(block)
            names += [f"{space.name}[{k}]" for k in range(count)]
        constants: dict[str, float] = {}
        for name in self.constants:
            i = self.index[UnknownNumber(name, 0)]
            if i in reported:
                constants[name] = float(theta[i])
                rows.append(np.eye(len(self))[i])
                names.append(name)
        matrix = np.array(rows).reshape(len(rows), len(self))
        joint = (
            None
            if covariance is None
            else Covariance(tuple(names), read_only(_symmetric(matrix @ covariance @ matrix.T)))
        )
        squareness = {name: value for name, value in constants.items() if name in self.machine.squareness_names}
        location = {name: value for name, value in constants.items() if name in self.machine.location_names}
        return Calibration(self.machine, source, curves, squareness, location, joint), matrix

    def _constant(self, name: str, value: float) -> Effect:
        if name in self.machine.squareness_names:
            return Squareness(name, value, self.machine.by_name[split_name(name)[2]])
        return AxisLocation(name, value)


def spaces_for(
    machine: Machine,
    positions: np.ndarray,
    *,
    bases: Mapping[str, Basis],
    most: int,
    wanted: Callable[[str], bool],
) -> tuple[list[CurveSpace], list[str]]:
    """Return the largest function spaces that these positions can determine, and the constants of the axes that moved.

    ``positions``: (n, axes) commanded, mm and degrees; ``wanted``: whether an error of that name is to be estimated.

    Returns:
        The spaces, and names of squareness and locations.
    """
    curves: list[CurveSpace] = []
    constants: list[str] = []
    for i, axis in enumerate(machine.axes):
        domain = axis.domain
        # Positions that differ by more than a micrometre or a thousandth of a degree.
        distinct = len(np.unique(np.round(wrapped(positions[:, i], axis, domain), 3)))
        if distinct < 2:
            continue
        basis = bases[axis.name]
        # Two functions fewer than positions: one position may be held out, and one degree of freedom remains.
        count = basis.largest(max(2, min(most, distinct - 2)))
        for letter in "XYZABC":
            name = f"E_{letter}{axis.name}"
            straightness = axis.linear and letter in "XYZ" and not along(axis, letter)
            first = 2 if straightness else 1
            if count > first and wanted(name):
                curves.append(CurveSpace(name, basis, domain, first, count))
        constants += [
            name
            for name in (*machine.squareness_names, *machine.location_names)
            if split_name(name)[2] == axis.name and wanted(name)
        ]
    return curves, constants


def offset_name(name: str) -> str:
    """Return the name of the unknown that is the constant of a curve."""
    return f"{name} constant"


def least_determined_offset(unknowns: Unknowns, unseen: np.ndarray) -> str | None:
    """Return the curve whose constant is determined least, or None if all are determined.

    Stations, locations or another constant can compensate it. One at a time: of two confounded constants, one may stay.

    ``unseen``: (columns and more,) share of each unknown's prior variance that remains (`Spectrum.unseen`).
    """
    of = {name: float(unseen[unknowns.index[UnknownNumber(offset_name(name), 0)]]) for name in unknowns.offsets}
    worst = max(of, key=lambda name: round(of[name], 6), default=None)
    return worst if worst is not None and of[worst] > NOT_DETERMINED else None


def axes_with_known_places(machine: Machine, data: Measurements) -> tuple[str, ...]:
    """Return the axes next to a carrier on which every target's place and every station's pose is given."""
    axes_with_known_places = []
    for side in CARRIERS:
        of, stations = data.carrier == side, data.station_carrier == side
        axes = [axis.name for axis in machine.axes if axis.side == side]
        given = np.all(np.isfinite(data.place_mm[of])) and np.all(np.isfinite(data.station_pose[stations]))
        if np.any(of | stations) and given and axes:
            frame = machine.tool_frame if side == "tool" else machine.work_frame
            chain = machine.model.supports[machine.model.frames[frame].parentJoint].tolist()
            joints = dict(zip(machine.names, machine.axis_joints, strict=True))
            axes_with_known_places.append(max(axes, key=lambda name: chain.index(joints[name])))
    return tuple(axes_with_known_places)


def wrapped(q: np.ndarray, axis: Axis, domain: tuple[float, float]) -> np.ndarray:
    """Return positions of an unlimited axis within one turn; those of other axes unchanged."""
    return q if axis.lower is not None else domain[0] + np.mod(q - domain[0], domain[1] - domain[0])


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.T) / 2.0
