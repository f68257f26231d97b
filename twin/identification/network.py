"""The least-squares problem: the unknowns of the machine, and whitened residuals with their derivatives, in chunks of bounded size.

Every error motion is a sum of functions, every squareness and location a number. The functions of a curve are orthonormal over its
domain (mean square one), derived from those of its basis in their order. A coefficient is then the RMS of its component, orders are
uncorrelated, and the choice of the datum is simple:

- a constant belongs to the axis's zero, to a location, or to the places of the targets: curves have none;
- the slope of a straightness belongs to a squareness or to the machine frame, whose x is X's mean line and whose xy-plane contains
  Y's: straightness curves have none. Mean lines are least-squares lines over the axis's range (ISO 230-1, 3.4.12 allows it);
- a shift or tilt of everything that a rotary axis carries (first harmonics of E_X and E_Y, and of E_A and E_B, that rotate with it)
  belongs to the places of these things: pairs of curves have no such component (`Unknowns.datum`).

One row is one coordinate that was read. Whitening uses the covariance that the instrument's model (or the table) states for the
reading, evaluated at the reading itself, so that it does not change with the estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.units import MM, UM
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.instruments import StationInstruments
from twin.measurement.observation import observation_of, of_angles
from twin.measurement.set_up import StationsAndTargets, reading_frames
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.datum.conditions import along, turning_patterns
from twin.model.effects import AxisLocation, Squareness, split_name, unit_of
from twin.model.effects.base import Effect
from twin.model.motion_curve import Curve
from twin.numerics.covariance import Covariance
from twin.numerics.curves import Basis, CurveSpace
from twin.numerics.functions import Rows
from twin.numerics.observability import NOT_DETERMINED
from twin.numerics.spatial import cross_matrix


@final
@dataclass(frozen=True)
class UnknownNumber:
    """One unknown parameter.

    ``entity``: ``E_XX``, ``E_C0Y``, ``E_X0C``; ``index``: of the orthonormal function; 0 for a squareness or location.
    """

    entity: str
    index: int


@final
class Unknowns:
    """The unknowns of a machine, in a fixed order of columns.

    ``plausible``: (columns,) prior standard deviations, µm or µrad (`Machine.plausible`).

    Args:
        curves: function spaces of its error motions.
        constants: names of squareness and locations.
        fixed_axes: axes next to a carrier on which all targets' places are known. Nothing else can compensate a constant or a
            rotating pattern there, so their curves have one.
        offsets: names of the curves that do; all of those axes' if None.
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
    machine: Machine, positions: np.ndarray, *, bases: Mapping[str, Basis], most: int, wanted: Callable[[str], bool]
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
        distinct = _distinct(np.round(wrapped(positions[:, i], axis, domain), 3))
        if distinct < 2:
            continue
        basis = bases[axis.name]
        # Two functions fewer than positions: one position may be held out, and one degree of freedom remains. The straight line of a
        # travel is its scale, a constant; that of a rotary axis, from three positions, is wrong by its whole size at a fourth.
        count = basis.largest(max(2 if axis.linear else 1, min(most, distinct - 2)))
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


def _distinct(positions: np.ndarray) -> int:
    """Return the number of positions that differ by more than a thousandth of their range: those of probed repeats vary."""
    count, first, gap = 0, -np.inf, 1e-3 * float(np.ptp(positions))
    for position in np.unique(positions).tolist():
        if position > first + gap:
            count, first = count + 1, position
    return count


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


# --- Whitened residuals and derivatives, in chunks of bounded size -------------------------------

CHUNK: Final = 1024
"""Number of points in a chunk."""
VIEW_CHUNK: Final = 8192
"""Number of points in a chunk of a `LinearisedReadings`, whose results are all kept."""


@final
@dataclass(frozen=True)
class WhitenedRows:
    """Some points: their rows in the data, and (unknowns + 1, k, 3) whitened derivatives with respect to each unknown, residuals last.

    Zero where nothing was read.
    """

    rows: np.ndarray
    columns: np.ndarray

    @property
    def residual(self) -> np.ndarray:
        """Whitened residuals, (k, 3)."""
        return self.columns[-1]

    @property
    def jacobian(self) -> np.ndarray:
        """Whitened derivatives, (k, 3, unknowns)."""
        return self.columns[:-1].transpose(1, 2, 0)


@final
@dataclass(frozen=True)
class LinearisedReadings:
    """Some points in their stations' frames; metres, derivatives whitened.

    Attributes:
        residual: (k, 3) whitened.
        carried: (k, 3) the targets in the frames on which their stations ride.
        seen: (k, 3) the points in their stations' frames.
        whitening: (k, 3, 3).
        by_seen: (k, 3, 3) derivative of the reading with respect to the point in the station's frame.
        by_ride: (k, 3, 3) with respect to the point in the frame on which the station rides.
        by_error: (k, 3, 6·frames) with respect to every component of every error frame.
        by_place: (k, 3, 3) with respect to the target's place on its carrier.
        ride: (k, 3, 3) rotation in the base frame of the frame on which the station rides.
        ride_origin: (k, 3) origin of that frame in the base frame.
        shown: (k, sides) the sign with which a shift of each side (`CARRIERS`) shows: 1 with the target on it, −1 with the station on
            it, 0 with both or neither. NaN for an angle, which no shift changes.
    """

    rows: np.ndarray
    residual: np.ndarray
    carried: np.ndarray
    seen: np.ndarray
    whitening: np.ndarray
    by_seen: np.ndarray
    by_ride: np.ndarray
    by_error: np.ndarray
    by_place: np.ndarray
    ride: np.ndarray
    ride_origin: np.ndarray
    shown: np.ndarray

    @property
    def by_base(self) -> np.ndarray:
        """(k, 3, 3) with respect to the point in the base frame; zero for an angle."""
        return self.base(slice(None))

    def base(self, some: Rows) -> np.ndarray:
        """Return `by_base` of some points."""
        by_shift = np.where(np.isnan(self.shown[some, :1, None]), 0.0, self.by_ride[some])
        return np.asarray(by_shift @ self.ride[some].transpose(0, 2, 1))

    def base_points(self, some: Rows) -> np.ndarray:
        """Return some targets in the base frame, (m, 3)."""
        return np.asarray(np.einsum("nij,nj->ni", self.ride[some], self.carried[some]) + self.ride_origin[some])

    def side(self, side: str, some: Rows) -> np.ndarray:
        """Return (m, 3, 3) of some points the derivative with respect to a shift of a side along the axes of the base frame."""
        return np.asarray(self.base(some) * self._sign(side, some))

    def side_frame(self, side: str, some: Rows) -> np.ndarray:
        """Return (m, 3, 3) of some points the derivative with respect to a shift of a side along the axes of its own frame."""
        sign = self._sign(side, some)
        return np.where(sign > 0.0, self.by_place[some], np.where(sign < 0.0, -self.by_ride[some], 0.0))

    def _sign(self, side: str, some: Rows) -> np.ndarray:
        return np.nan_to_num(self.shown[some, CARRIERS.index(side), None, None])

    def part(self, some: slice | np.ndarray) -> LinearisedReadings:
        """Return some of these points."""
        return LinearisedReadings(*(own[some] for own in self.arrays()))

    def with_weights(self, factor: float) -> LinearisedReadings:
        """Return the same points with the whitening multiplied by a factor."""
        if factor == 1.0:
            return self
        whitened = "residual", "whitening", "by_seen", "by_ride", "by_error", "by_place"
        return replace(self, **{name: factor * getattr(self, name) for name in whitened})

    def arrays(self) -> list[np.ndarray]:
        """Return all arrays in order."""
        return [getattr(self, field.name) for field in fields(self)]


@final
class Network:
    """Data, instrument and model of a least-squares problem.

    Args:
        instruments: those of its stations; their covariance is used where the table gives no uncertainties.
        unknowns: unknowns of the machine.
        base: errors that are known; none if None.
        covariance: (n, 3, 3) of the readings, m²; that of the table and the instrument if None.
        check: whether positions outside the domain of a curve of ``base`` are refused.
    """

    def __init__(
        self,
        machine: Machine,
        data: Measurements,
        instruments: StationInstruments,
        unknowns: Unknowns,
        base: Calibration | None = None,
        covariance: np.ndarray | None = None,
        *,
        check: bool = True,
    ) -> None:
        self.machine = machine
        self.data = data
        self.instruments = instruments
        self.unknowns = unknowns
        self.read = read_only(np.isfinite(data.point_mm))
        self.readings = read_only(np.where(self.read, data.point_mm, 0.0) * MM)
        self.covariance = stated_covariance(data, instruments) if covariance is None else covariance
        self.whitening = read_only(_whitening(self.covariance, self.read))
        self._observation = observation_of(machine)
        self._angles = of_angles(data)
        self._frames = reading_frames(data) if np.isfinite(data.along).any() else None
        self._q = np.asarray(data.positions) * machine.scale
        known = Calibration.zero(machine) if base is None else base
        self._base = self._observation.errors(known, data, check=check)
        self._shapes = unknowns.shapes(data.positions)
        self._orders: dict[tuple[tuple[str, ...], tuple[str, ...]], tuple[np.ndarray, np.ndarray]] = {}

    def with_variance_factor(self, factor: float) -> Network:
        """Return the same problem with all variances of the readings multiplied by a factor."""
        other = copy(self)
        other.covariance = read_only(self.covariance * factor)
        other.whitening = read_only(self.whitening / np.sqrt(factor))
        return other

    def with_discrepancy(self, root: np.ndarray) -> Network:
        """Return the same problem weighted by noise and discrepancy.

        ``root``: (n, 3, 3) symmetric square root of the covariance by the discrepancy, metres; zero where nothing was read.
        """
        if not np.any(root):
            return self
        other = copy(self)
        other.covariance = read_only(self.covariance + root @ root)
        other.whitening = read_only(_whitening(other.covariance, self.read))
        return other

    def _order(self, setup: StationsAndTargets) -> tuple[np.ndarray, np.ndarray]:
        """Return (n,) station and (n,) target of each row as indices of a set-up, which may come from other rows."""
        names = setup.stations, setup.targets
        if names not in self._orders:
            self._orders[names] = setup.indices(self.data)
        return self._orders[names]

    def errors(self, theta: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return (k, 6·frames) the error frames of an estimate at some points."""
        errors = np.array(self._base[rows])
        for value, shapes in zip(theta, self._shapes, strict=True):
            if value != 0.0:
                for at, values in shapes:
                    errors[:, at] += value * values[rows]
        return errors

    def chunks(self, theta: np.ndarray, setup: StationsAndTargets) -> Iterator[WhitenedRows]:
        """Yield residuals and derivatives of all points in chunks, the machine's columns first, then the set-up's."""
        return (self.chunk(theta, setup, rows) for rows in self.row_chunks)

    @cached_property
    def row_chunks(self) -> list[np.ndarray]:
        """All rows, in chunks of `CHUNK`."""
        points = len(self.data)
        return [np.arange(start, min(start + CHUNK, points)) for start in range(0, points, CHUNK)]

    def residual(self, theta: np.ndarray, setup: StationsAndTargets) -> np.ndarray:
        """Return (n, 3) whitened residuals, zero where nothing was read."""
        residual = np.zeros((len(self.data), 3))
        for rows in self.row_chunks:
            residual[rows] = np.einsum("nij,nj->ni", self.whitening[rows], self.residuals_m(theta, setup, rows))
        return residual

    def residuals_m(self, theta: np.ndarray, setup: StationsAndTargets, rows: np.ndarray) -> np.ndarray:
        """Return (k, 3) measured minus predicted, metres, in each station's frame; zero where nothing was read."""
        q, errors = self._q[rows], self.errors(theta, rows)
        place = setup.place[self._order(setup)[1][rows]]
        points = self._observation.points(
            q, errors, self.data.carrier[rows], place, self.data.station_carrier[rows], self._angles[rows]
        )
        seen = self._seen(points, setup, rows)
        return self._residuals(seen, setup, rows)

    def _seen(self, points: np.ndarray, setup: StationsAndTargets, rows: np.ndarray) -> np.ndarray:
        """Return points of the base frame in the frame of the station that read them."""
        station = self._order(setup)[0][rows]
        return np.einsum("nji,nj->ni", setup.rotation[station], points - setup.origin[station])

    def _along(self, seen: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Return points of a station's frame by their coordinates along the directions of the readings."""
        return seen if self._frames is None else np.einsum("nij,nj->ni", self._frames[rows], seen)

    def _residuals(self, seen: np.ndarray, setup: StationsAndTargets, rows: np.ndarray) -> np.ndarray:
        predicted = np.empty_like(seen)
        for instrument, some in self.instruments.groups(self.data.station[rows]):
            predicted[some] = np.nan_to_num(instrument.read(self._along(seen[some], rows[some])), nan=0.0)
        predicted[:, 0] -= setup.dead[self._order(setup)[0][rows]]
        if setup.tools:
            predicted[:, 0] += setup.tool_offset(self.data, rows)
        return np.where(self.read[rows], self.readings[rows] - predicted, 0.0)

    def view(self, theta: np.ndarray, setup: StationsAndTargets, rows: np.ndarray) -> LinearisedReadings:
        """Return some points in their stations' frames, with every derivative an effect may need."""
        first = self._view(theta, setup, rows[:VIEW_CHUNK])
        if len(rows) <= VIEW_CHUNK:
            return first
        # In chunks, because the intermediate results need more memory than the result.
        view = LinearisedReadings(*(np.empty((len(rows), *own.shape[1:]), own.dtype) for own in first.arrays()))
        for start in range(0, len(rows), VIEW_CHUNK):
            some = slice(start, start + VIEW_CHUNK)
            part = first if start == 0 else self._view(theta, setup, rows[some])
            for whole, own in zip(view.arrays(), part.arrays(), strict=True):
                whole[some] = own
        return view

    def _view(self, theta: np.ndarray, setup: StationsAndTargets, rows: np.ndarray) -> LinearisedReadings:
        station, target = (of[rows] for of in self._order(setup))
        carried = self._observation.carried(
            self._q[rows],
            self.errors(theta, rows),
            self.data.carrier[rows],
            setup.place[target],
            self.data.station_carrier[rows],
            self._angles[rows],
        )
        seen = self._seen(carried.points, setup, rows)
        whitening = self.whitening[rows]
        by_seen = np.empty_like(whitening)
        for instrument, some in self.instruments.groups(self.data.station[rows]):
            by_seen[some] = whitening[some] @ instrument.jacobian(self._along(seen[some], rows[some]))
            if self._frames is not None:
                by_seen[some] = by_seen[some] @ self._frames[rows[some]]
        by_ride = by_seen @ setup.rotation[station].transpose(0, 2, 1)
        on, rides = (
            np.stack([of[rows] == side for side in CARRIERS], axis=1)
            for of in (self.data.carrier, self.data.station_carrier)
        )
        return LinearisedReadings(
            rows=rows,
            residual=np.einsum("nij,nj->ni", whitening, self._residuals(seen, setup, rows)),
            carried=carried.points,
            seen=seen,
            whitening=whitening,
            by_seen=by_seen,
            by_ride=by_ride,
            by_error=by_ride @ carried.by_error,
            by_place=by_ride @ carried.rotation,
            ride=carried.ride,
            ride_origin=carried.ride_origin,
            shown=np.where(self._angles[rows, None], np.nan, 1.0 * on - rides),
        )

    def chunk(self, theta: np.ndarray, setup: StationsAndTargets, rows: np.ndarray) -> WhitenedRows:
        """Return residuals and derivatives of some points."""
        view = self.view(theta, setup, rows)
        machine = len(self._shapes)
        # One row for each unknown, so that it is contiguous in memory when it is written and factorised.
        by_error = np.ascontiguousarray(view.by_error.transpose(2, 0, 1))
        columns = np.zeros((machine + len(setup) + 1, len(rows), 3))
        columns[-1] = view.residual
        for column, shapes in zip(columns, self._shapes, strict=False):
            for at, values in shapes:
                column += by_error[at] * values[rows, None]
        self.fill_setup_columns(view, setup, columns[machine:-1].transpose(1, 2, 0))
        return WhitenedRows(rows, columns)

    def certified(self, setup: StationsAndTargets) -> np.ndarray:
        """Return (k, unknowns + 1) whitened [J | r] of the k statements of certificates about the targets' places."""
        machine, rows = len(self._shapes), []
        slots = {i: at for kind, i, at in setup.slots if kind == "place"}
        for artefact in self.data.artefacts:
            known = artefact.among(setup.targets)
            if known is None:
                continue
            targets = [setup.targets.index(name) for name in known.targets]
            contrasts = known.rows(setup.place[targets])
            both = np.zeros((len(contrasts.residual), machine + len(setup) + 1))
            both[:, -1] = contrasts.residual
            for k, target in enumerate(targets):
                if target in slots:
                    at = slots[target]
                    both[:, machine + at.start : machine + at.stop] = contrasts.derivative[:, k]
            rows.append(both)
        return np.concatenate([np.zeros((0, machine + len(setup) + 1)), *rows])

    def fill_setup_columns(self, view: LinearisedReadings, setup: StationsAndTargets, into: np.ndarray) -> None:
        """Write the derivatives with respect to the set-up's unknowns into (k, 3, unknowns) of zeros."""
        station, target = (of[view.rows] for of in self._order(setup))
        for kind, i, at in setup.slots:
            if kind == "tool":
                into[:, :, at] = view.whitening[:, :, :1] * setup.by_tool(self.data, i)[view.rows, None]
                continue
            of = np.flatnonzero((target if kind == "place" else station) == i)
            # y = Rᵀ(p − o); R → R·Exp(φ): dy = y × φ.
            if kind == "turn":
                into[of, :, at] = (view.by_seen[of] @ cross_matrix(view.seen[of]))[:, :, setup.acts(kind, i)]
            elif kind == "origin":
                into[of, :, at] = -view.by_ride[of][:, :, setup.acts(kind, i)]
            elif kind == "dead path":
                into[of, :, at] = -view.whitening[of][:, :, :1]
            else:
                into[of, :, at] = view.by_place[of, :, : at.stop - at.start]


def stated_covariance(data: Measurements, instruments: StationInstruments) -> np.ndarray:
    """Return (n, 3, 3) m²: from the table's standard uncertainties if all of a row are given, else from the instruments' models."""
    read = np.isfinite(data.point_mm)
    points = np.where(read, data.point_mm, 0.0) * MM
    away = np.where(np.linalg.norm(points, axis=1, keepdims=True) > 0, points, 1e-3)
    stated_covariance = np.array(instruments.covariance(away, data.station))
    given = np.all(np.isfinite(data.u_mm) | ~read, axis=1) & read.any(axis=1)
    stated_covariance[given] = 0.0
    for i in range(3):
        stated_covariance[given, i, i] = (np.nan_to_num(data.u_mm[given, i], nan=0.0) * MM) ** 2
    return read_only(stated_covariance)


def _whitening(covariance: np.ndarray, read: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) W with W C Wᵀ = 1 on the coordinates that were read, zero on the others."""
    whitening = np.zeros_like(covariance)
    for pattern in np.unique(read, axis=0):
        rows = np.flatnonzero(np.all(read == pattern, axis=1))
        kept = np.flatnonzero(pattern)
        inside = np.ix_(rows, kept, kept)
        whitening[inside] = np.linalg.inv(np.linalg.cholesky(covariance[inside]))
    return whitening
