"""Positions of the reflectors on a machine with errors, in the frame on which their station rides.

The reflector is on the tool side or the work side. The frame is the base frame or, for a station that moves with the machine, the
frame of the spindle nose or the work frame. Simulating, identifying and diagnosing share this prediction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import final

import casadi as ca
import numpy as np

from twin._common.units import MM
from twin.compute.batch import BatchFunction
from twin.machine.calibration import Calibration
from twin.machine.chain import Pose, frame_pose
from twin.machine.effects import assemble
from twin.machine.effects.empirical import check_ranges
from twin.machine.machine import Machine
from twin.measurement.instruments.base import SIDES
from twin.measurement.state import machine_state, of_angles
from twin.measurement.table import CARRIERS, Measurements


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


@final
class Observation:
    """Forward model of the reflectors on one machine.

    Args:
        machine: the machine.

    A place on the tool side is in the frame of the spindle nose (no tool length), on the work side in the work frame.
    """

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        self._compiled: dict[tuple[str, str, bool, bool], BatchFunction] = {}

    def points_mm(self, calibration: Calibration, data: Measurements, places_mm: np.ndarray) -> np.ndarray:
        """Return the reflectors in the frames on which their stations ride.

        Args:
            calibration: the machine's errors.
            data: commands, carriers, and every channel an effect needs; its coordinates are not used.
            places_mm: (n, 3) place of each reflector on its carrier.

        Returns:
            (n, 3) mm.

        Raises:
            InputError: a position outside the domain of a curve, or a channel that an effect needs and the table lacks.
        """
        q, errors = np.asarray(data.positions) * self.machine.scale, self.errors(calibration, data)
        return self.points(q, errors, data.carrier, places_mm * MM, data.station_carrier, of_angles(data)) / MM

    def errors(self, calibration: Calibration, data: Measurements, *, check: bool = True) -> np.ndarray:
        """Return (n, 6·frames) all error frames at the rows of a table, metres and radians.

        Args:
            calibration: the machine's errors.
            data: commands and channels.
            check: whether a position outside the domain of a curve is refused; otherwise the curve is extrapolated (overtravel).

        Raises:
            InputError: as `points_mm`.
        """
        state = machine_state(data, self.machine)
        if check:
            check_ranges(calibration.empirical, state, data.lines, data.source)
            calibration.check(data.positions)
        rows = assemble(calibration.effects, self.machine.frames, state)
        found = [np.broadcast_to(np.asarray(v, dtype=float), len(data)) for row in rows for v in row]
        return np.stack(found, axis=1)

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
        found = np.empty((len(q), 3))
        for function, rows in self._functions(carrier, station_carrier, angles, derivatives=False):
            (found[rows],) = function(q[rows], errors[rows], places[rows])
        return found

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

        Args:
            q: (n, axes) metres and radians.
            errors: (n, 6·frames) all error frames, metres and radians.
            carrier: (n,) ``tool`` or ``work``: the side on which each reflector sits.
            places: (n, 3) metres.
            station_carrier: (n,) ``base``, ``tool`` or ``work``: side of the station, in whose frame the result is; base if None.
            angles: (n,) rows of angles: the place is a line that only turns with its carrier; none if None.
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
        self,
        carrier: np.ndarray,
        station_carrier: np.ndarray | None,
        angles: np.ndarray | None,
        *,
        derivatives: bool,
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
        found = [point, ca.jacobian(point, e), pose.rotation] if derivatives else [point]
        if derivatives and ride is not None:
            found += [ride.rotation, ride.translation]
        return ca.Function("carried", [q, e, place], found)


@lru_cache(maxsize=2)
def observation_of(machine: Machine) -> Observation:
    """Return the forward model of a machine, cached: building its graph takes longer than evaluating some hundred rows."""
    return Observation(machine)
