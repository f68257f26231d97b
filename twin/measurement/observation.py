"""Positions of the reflectors on a machine with errors, and the state of the machine at each reading.

The reflector is on the tool side or the work side. The frame is the base frame or, for a station that moves with the machine, the
frame of the spindle nose or the work frame. Simulating, identifying and diagnosing share this prediction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import product
from typing import Final, final

import casadi as ca
import numpy as np

from twin._common.units import MM
from twin.compute.along import BatchFunction
from twin.machine.chain import Pose, frame_pose
from twin.machine.machine import Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.instruments import INSTRUMENTS, SIDES
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import assemble
from twin.model.effects.empirical import check_ranges

FEWEST_REPEATS: Final = 10
"""Degrees of freedom of repeats below which they do not decide on the noise."""
ANGLES: Final = tuple(one.name for one in INSTRUMENTS if one.specification.reads == "angle")
"""Names of the instruments that read angles."""


def machine_state(data: Measurements, machine: Machine) -> dict[str, np.ndarray]:
    """Return the positions and every channel that has no gaps, by name: ``approach_X``, ``time_s``, ``T_X_degC``, ``spindle_rpm``."""
    state = {axis.name: np.asarray(data.positions[:, i]) for i, axis in enumerate(machine.axes)}
    for i, axis in enumerate(machine.axes):
        if np.any(data.approach[:, i]):
            state[f"approach_{axis.name}"] = np.asarray(data.approach[:, i], dtype=float)
    if has_times(data):
        state["time_s"] = np.asarray(data.time_s)
    for name, values in data.temperature_degC.items():
        if np.all(np.isfinite(values)):
            state[f"T_{name}_degC"] = np.asarray(values)
    return state | {name: np.asarray(values) for name, values in data.channels.items() if np.all(np.isfinite(values))}


def has_times(data: Measurements) -> bool:
    """Return whether every row has a time."""
    return bool(np.all(np.isfinite(data.time_s)))


def order_in_time(data: Measurements) -> np.ndarray:
    """Return (n,) the rows in the order of time if every row has one, else in that of the table."""
    return np.argsort(data.time_s, kind="stable") if has_times(data) else np.arange(len(data))


def of_angles(data: Measurements) -> np.ndarray:
    """Return (n,) whether a row is of an instrument that reads angles."""
    return np.isin(data.instrument.astype(str), ANGLES)


def at_origin(data: Measurements) -> np.ndarray:
    """Return (n,) whether a target was read at its station's origin: a probe's tip at the centre of a sphere."""
    probed = (data.station_carrier != SIDES[0]) & ~of_angles(data)
    return np.asarray(probed & (np.nan_to_num(data.point_mm, nan=1.0) == 0.0).all(axis=1))


def repeat_groups(data: Measurements) -> np.ndarray:
    """Return (n,) the index of the point that each row repeats: same command, target, station and directions of approach.

    A probe finds the same point again at slightly other positions of the axes.
    """
    positions = np.where(at_origin(data)[:, None], np.round(data.positions, 0), np.round(data.positions, 6))
    keys = np.concatenate([positions, data.approach], axis=1)
    _, pose = np.unique(keys, axis=0, return_inverse=True)
    _, target = np.unique(data.target.astype(str), return_inverse=True)
    _, station = np.unique(data.station.astype(str), return_inverse=True)
    _, group = np.unique(np.stack([pose.reshape(-1), target, station], axis=1), axis=0, return_inverse=True)
    return np.asarray(group.reshape(-1))


def repeats_dof(data: Measurements) -> int:
    """Return the degrees of freedom of repeats, per coordinate."""
    return int(np.sum(np.maximum(np.bincount(repeat_groups(data)) - 1, 0)))


# --- Positions of the reflectors on a machine with errors, in the frame on which their station rides


@final
@dataclass(frozen=True)
class CarriedTargets:
    """Reflectors in the frames on which their stations ride, and their derivatives; metres and radians.

    Attributes:
        points: (n, 3).
        by_error: (n, 3, 6·frames) derivative with respect to every component of every error frame.
        rotation: (n, 3, 3) of the carrier, which is the derivative with respect to the place on the carrier.
        ride: (n, 3, 3) rotation in the base frame of the frame on which the station rides.
        ride_origin: (n, 3) origin of that frame in the base frame.
    """

    points: np.ndarray
    by_error: np.ndarray
    rotation: np.ndarray
    ride: np.ndarray
    ride_origin: np.ndarray

    def select(self, rows: np.ndarray) -> CarriedTargets:
        """Return some rows (indices or a mask)."""
        return CarriedTargets(*(getattr(self, part.name)[rows] for part in fields(self)))

    def at(self, place: np.ndarray) -> np.ndarray:
        """Return (n, 3) the targets, at (n, 3) places on the carriers from the points in `points`, metres."""
        return np.asarray(self.points + np.einsum("nij,nj->ni", self.rotation, place))

    def least_motion(self, place_mm: np.ndarray) -> np.ndarray:
        """Return (n, 3) the deviation of one target from its mean, m; if its place is NaN, at the place that moves least."""
        if np.isfinite(place_mm).all():
            points = self.points + self.rotation @ (place_mm * MM)
            return np.asarray(points - points.mean(axis=0))
        turn = (self.rotation - self.rotation.mean(axis=0)).reshape(-1, 3)
        deviation = (self.points - self.points.mean(axis=0)).reshape(-1)
        place = np.linalg.lstsq(turn, -deviation, rcond=1e-9)[0]
        return np.asarray((deviation + turn @ place).reshape(-1, 3))


@final
class Observation:
    """Forward model of the reflectors on one machine.

    A place on the tool side is in the frame of the spindle nose (no tool length), on the work side in the work frame.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self._compiled: dict[tuple[str, str, bool, bool], BatchFunction] = {}

    def points_mm(self, calibration: Calibration, data: Measurements, places_mm: np.ndarray) -> np.ndarray:
        """Return the reflectors in the frames on which their stations ride.

        ``data``: commands, carriers, and every channel an effect needs; its coordinates are not used; ``places_mm``: (n, 3) place of
        each reflector on its carrier.

        Returns:
            (n, 3) mm.

        Raises:
            InputError: a position outside the domain of a curve, or a channel that an effect needs and the table lacks.
        """
        q, errors = np.asarray(data.positions) * self.machine.scale, self.errors(calibration, data)
        return self.points(q, errors, data.carrier, places_mm * MM, data.station_carrier, of_angles(data)) / MM

    def errors(self, calibration: Calibration, data: Measurements, *, check: bool = True) -> np.ndarray:
        """Return (n, 6·frames) all error frames at the rows of a table, metres and radians.

        ``check``: whether a position outside the domain of a curve is refused; otherwise the curve is extrapolated (overtravel).

        Raises `InputError`: as `points_mm`.
        """
        state = machine_state(data, self.machine)
        if check:
            check_ranges(calibration.bounded, state, data.lines, data.source)
            calibration.check(data.positions)
        rows = assemble(calibration.effects, self.machine.frames, state)
        errors = [np.broadcast_to(np.asarray(v, dtype=float), len(data)) for row in rows for v in row]
        return np.stack(errors, axis=1)

    def points(
        self,
        q: np.ndarray,
        errors: np.ndarray,
        carrier: np.ndarray,
        places: np.ndarray,
        station_carrier: np.ndarray | None = None,
        angles: np.ndarray | None = None,
    ) -> np.ndarray:
        """Return (n, 3) the reflectors in the frames on which their stations ride, unchecked; arguments as `carried`."""
        points = np.empty((len(q), 3))
        for function, rows in self._functions(carrier, station_carrier, angles, derivatives=False):
            (points[rows],) = function(q[rows], errors[rows], places[rows])
        return points

    def carried(
        self,
        q: np.ndarray,
        errors: np.ndarray,
        carrier: np.ndarray,
        places: np.ndarray,
        station_carrier: np.ndarray | None = None,
        angles: np.ndarray | None = None,
    ) -> CarriedTargets:
        """Return the reflectors and their derivatives, unchecked, in metres and radians.

        ``q``: (n, axes) metres and radians; ``errors``: (n, 6·frames) all error frames, metres and radians; ``carrier``: (n,) ``tool``
        or ``work``: the side on which each reflector sits; ``places``: (n, 3) metres; ``station_carrier``: (n,) ``base``, ``tool`` or
        ``work``: side of the station, in whose frame the result is; base if None; ``angles``: (n,) rows of angles: the place is a line
        that only turns with its carrier; none if None.
        """
        n = len(q)
        points, by_error, rotation = np.empty((n, 3)), np.empty((n, errors.shape[1], 3)), np.empty((n, 3, 3))
        ride, ride_origin = np.tile(np.eye(3), (n, 1, 1)), np.zeros((n, 3))
        for function, rows in self._functions(carrier, station_carrier, angles, derivatives=True):
            found = function(q[rows], errors[rows], places[rows])
            points[rows] = found[0]
            by_error[rows] = found[1].reshape(-1, errors.shape[1], 3)
            rotation[rows] = found[2].reshape(-1, 3, 3)
            if len(found) > 3:
                ride[rows], ride_origin[rows] = found[3].reshape(-1, 3, 3).transpose(0, 2, 1), found[4]
        return CarriedTargets(points, by_error.transpose(0, 2, 1), rotation.transpose(0, 2, 1), ride, ride_origin)

    def _functions(
        self, carrier: np.ndarray, station_carrier: np.ndarray | None, angles: np.ndarray | None, *, derivatives: bool
    ) -> Iterator[tuple[BatchFunction, np.ndarray]]:
        """Yield the compiled function of each pair of sides that occurs, of points and of angles, and its rows."""
        turned = np.zeros(len(carrier), dtype=bool) if angles is None else angles
        for side, station, turns in product(CARRIERS, SIDES, (False, True)):
            on = station == SIDES[0] if station_carrier is None else station_carrier == station
            rows = np.flatnonzero((carrier == side) & on & (turned == turns))
            if len(rows):
                key = side, station, turns, derivatives
                if key not in self._compiled:
                    self._compiled[key] = BatchFunction(self._function(*key))
                yield self._compiled[key], rows

    def _function(self, side: str, station: str, turns: bool, derivatives: bool) -> ca.Function:
        frames = {"tool": self.machine.tool_frame, "work": self.machine.work_frame}
        q = ca.SX.sym("q", len(self.machine.axes))
        e = ca.SX.sym("e", 6 * len(self.machine.frames))
        place = ca.SX.sym("place", 3)
        pose = frame_pose(self.machine, frames[side], q, e)
        ride = frame_pose(self.machine, frames[station], q, e) if station in frames else None
        if ride is not None:
            pose = ride.inverse().then(pose)
        point = pose.rotation @ place if turns else pose.then(Pose(ca.SX.eye(3), place)).translation
        outputs = [point, ca.jacobian(point, e), pose.rotation] if derivatives else [point]
        if derivatives and ride is not None:
            outputs += [ride.rotation, ride.translation]
        return ca.Function("carried", [q, e, place], outputs)


@lru_cache(maxsize=2)
def observation_of(machine: Machine) -> Observation:
    """Return the forward model of a machine, cached: building its graph takes longer than evaluating some hundred rows."""
    return Observation(machine)


VERTICAL_M: Final = (0.0, 0.0, 1.0)
"""The line that turns with a level, metres."""


def nominal_carriers(machine: Machine, data: Measurements) -> CarriedTargets:
    """Return origin and rotation of each row's carrier on the nominal machine, in the frame on which its station rides; metres."""
    q = np.asarray(data.positions) * machine.scale
    errors, places = np.zeros((len(q), 6 * len(machine.frames))), np.zeros((len(q), 3))
    angles = of_angles(data)
    places[angles] = VERTICAL_M
    return observation_of(machine).carried(q, errors, data.carrier, places, data.station_carrier, angles)
