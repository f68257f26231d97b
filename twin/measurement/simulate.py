"""Simulated measurements: a plan read by an instrument on a machine with known errors, with noise from a seed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, require_type
from twin._common.units import DEG, HOUR, MM, UM
from twin.display.results import Result
from twin.machine.machine import Machine
from twin.measurement.columns import outside_axis_range
from twin.measurement.instruments import SIDES, STANDARD_AIR, Air, Instrument, instrument_named, length_scale
from twin.measurement.observation import Observation
from twin.measurement.set_up import reading_frames
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.numerics.spatial import rotation_exp

STATION_DISTANCE_MM: Final = 1800.0
"""Distance of a station from the base frame where the plan gives no pose."""


@final
@dataclass(frozen=True)
class Station:
    """Pose of an instrument's station. ``rotation_rad``: rotation vector of its frame in the base frame."""

    origin_mm: tuple[float, float, float]
    rotation_rad: tuple[float, float, float]

    @classmethod
    def at(cls, pose: np.ndarray) -> Station:
        """Return the station of a row of `Measurements.station_pose`: (6,) mm and degrees."""
        return cls(three_floats(pose[:3]), three_floats(pose[3:] * DEG))

    @property
    def pose(self) -> np.ndarray:
        """Pose as a row of `Measurements.station_pose`: (6,) mm and degrees."""
        return read_only(np.array([*self.origin_mm, *(angle / DEG for angle in self.rotation_rad)]))

    def to_station_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """Return (n, 3) points of the base frame in the station's frame."""
        return (points_mm - np.array(self.origin_mm)) @ rotation_exp(self.rotation_rad)


@final
@dataclass(frozen=True, repr=False)
class Placement(Result):
    """Stations and places of the reflectors: known in a simulation, to be identified in an evaluation.

    Attributes:
        stations: by name.
        places_mm: place of each target on its carrier, by name.

    Examples:
        >>> plan = twin.thesis_plan.plan(twin.Machine.load("dmu50"))
        >>> placement = twin.Placement.draw(plan, np.random.default_rng(1))
        >>> tuple(placement.stations), tuple(placement.places_mm)
        (('1',), ('K', 'P', 'Q', 'KT', 'PT', 'QT'))
    """

    stations: Mapping[str, Station]
    places_mm: Mapping[str, tuple[float, float, float]]

    @classmethod
    def draw(cls, plan: Measurements, rng: np.random.Generator) -> Placement:
        """Return the stations and places that the plan gives, with a plausible random draw of the others.

        Stations stand in front of the machine; targets sit around the spindle nose and on the table.
        """
        stations = {}
        for k, name in enumerate(dict.fromkeys(plan.station)):
            pose = plan.station_pose[plan.station == name][0]
            if np.isfinite(pose).all():
                stations[name] = Station.at(pose)
                continue
            if np.isfinite(plan.along[plan.station == name]).any():  # a part: where its program says
                stations[name] = Station((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
                continue
            azimuth = np.radians(-90.0 + 55.0 * ((k + 1) // 2) * (-1) ** k)
            origin = STATION_DISTANCE_MM * np.array([np.cos(azimuth), np.sin(azimuth), 0.15 + 0.25 * k])
            x, y, z = origin + rng.uniform(-100.0, 100.0, 3)
            stations[name] = Station((float(x), float(y), float(z)), (0.0, 0.0, float(rng.uniform(-np.pi, np.pi))))
        places = {}
        counts = {"tool": 0, "work": 0}
        for target in dict.fromkeys(plan.target):
            side = str(plan.carrier[plan.target == target][0])
            place = plan.place_mm[plan.target == target][0]
            if np.isfinite(place).all():
                places[target] = three_floats(place)
                continue
            azimuth = np.radians(30.0 + 120.0 * counts[side] + rng.uniform(-15.0, 15.0))
            radius, height = (
                (110.0, -40.0 - 35.0 * counts[side]) if side == "tool" else (170.0, 30.0 + 30.0 * counts[side])
            )
            places[target] = (float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth)), height)
            counts[side] += 1
        return cls(stations, places)

    @property
    def brief(self) -> str:
        """Names of stations and targets."""
        return f"stations {', '.join(self.stations)}; targets {', '.join(self.places_mm)}"

    def describe(self) -> str:
        """Return the comment lines of a simulated file that state the stations and places."""
        lines = [
            f"station {name}: origin {_numbers(station.origin_mm)} mm, rotation vector {_numbers(station.rotation_rad)} rad"
            for name, station in self.stations.items()
        ]
        lines += [f"target {name}: {_numbers(place)} mm on its carrier" for name, place in self.places_mm.items()]
        return "\n".join(lines)


@final
@dataclass(frozen=True)
class Environment:
    """Ambient influences on the readings; none by default.

    Attributes:
        air: the air along the beam, for an instrument that corrects for standard air (`STANDARD_AIR`); None where the instrument
            measures its air.
        drift_um_per_h: by station, drift of its frame along the axes of the base frame, from the plan's first ``time_s`` on.
    """

    air: Air | None = None
    drift_um_per_h: Mapping[str, tuple[float, float, float]] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def scale(self) -> float:
        """Factor on every length that is read."""
        return 1.0 if self.air is None else length_scale(self.air, STANDARD_AIR)

    def drift_mm(self, plan: Measurements, station: str) -> np.ndarray:
        """Return (n, 3) the drift of a station at each of its rows, in the base frame.

        Raises:
            InputError: a row without ``time_s``.
        """
        rows = plan.station == station
        time = plan.time_s[rows]
        if not np.isfinite(time).all():
            line = int(plan.lines[rows][~np.isfinite(time)][0])
            raise InputError(
                "a station drifts, but a row has no time", expected="time_s in every row", file=plan.source, line=line
            )
        hours = (time - np.nanmin(plan.time_s)) / HOUR
        return np.asarray(np.outer(hours, self.drift_um_per_h[station]) * (UM / MM))

    def check(self, plan: Measurements) -> None:
        """Raise `InputError` if a drift is given for a station that is not in the plan."""
        stations = dict.fromkeys(plan.station)
        for name in self.drift_um_per_h:
            if name not in stations:
                raise InputError("drift of an unknown station", expected=f"one of {', '.join(stations)}", value=name)

    def describe(self) -> str:
        """Return the comment lines of a simulated file that state the ambient influences; empty if there are none."""
        lines = []
        if self.air is not None:
            lines.append(
                f"air along the beam {_air(self.air)}, instrument set to {_air(STANDARD_AIR)}: "
                f"lengths read {(self.scale - 1.0) / UM:+.3f} um/m"
            )
        for name, rate in self.drift_um_per_h.items():
            lines.append(
                f"station {name} drifts {_numbers(rate)} um/h along the base frame's axes, from the first time_s on"
            )
        return "\n".join(lines)


def simulate(
    plan: Measurements,
    machine: Machine,
    calibration: Calibration,
    instrument: Instrument,
    rng: np.random.Generator,
    *,
    setting: Placement | None = None,
    noise: bool = True,
    surroundings: Environment | None = None,
) -> tuple[Measurements, Placement]:
    """Simulate the measurement of a plan.

    Args:
        plan: positions, targets, carriers, stations and rounds; its coordinates are not used.
        machine: the machine.
        calibration: its true errors.
        instrument: the instrument of the stations whose instrument the plan does not name. For a probe, the positions of the linear
            axes become those at which its tip is at the centre of the sphere.
        rng: random generator.
        setting: stations and places; if None, those of the plan, with the others drawn.
        noise: whether measurement noise is added.
        surroundings: air and drift; none if None.

    Returns:
        The measurements, without standard uncertainties, places and station poses, and the stations and places.

    Raises:
        InputError: a position outside the domain of a curve; a drift of an unknown station, or without ``time_s``; a sphere that the
            probe cannot reach.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan = twin.thesis_plan.plan(machine)
        >>> tracker = twin.instruments.LaserTracker()
        >>> data, placement = twin.simulate(plan, machine, twin.Calibration.default(machine), tracker, np.random.default_rng(1))
        >>> data.simulated, data.point_mm.shape
        (True, (840, 3))

    References:
        - K. P. Birch, M. J. Downs: Correction to the updated Edlén equation for the refractive index of air, Metrologia 31 (1994)
          315-316.
    """
    require_type("instrument", instrument, Instrument)
    around = Environment() if surroundings is None else surroundings
    around.check(plan)
    placed = Placement.draw(plan, rng) if setting is None else setting
    own = dict(zip(plan.station.tolist(), plan.instrument.tolist(), strict=True))
    named = {station: instrument_named(name) if name else instrument for station, name in own.items()}
    plan = _probed(machine, calibration, plan, placed, named, rng if noise else None)
    places = np.array([placed.places_mm[target] for target in plan.target])
    base = Observation(machine).points_mm(calibration, plan, places)
    readings, frames = np.empty((len(plan), 3)), reading_frames(plan)
    for name, station in placed.stations.items():
        rows, reader = plan.station == name, named.get(name, instrument)
        drift = around.drift_mm(plan, name) if name in around.drift_um_per_h else 0.0
        seen = station.to_station_mm(base[rows] - drift) * MM
        # In constant air the dead path of an interferometer is never counted: the factor applies to the reading, not the distance.
        seen = np.einsum("nij,nj->ni", frames[rows], seen)
        found = reader.read(seen) * (around.scale if "refraction_scale" in reader.specification.effects else 1.0)
        found += reader.noise(seen, rng) if noise else 0.0
        readings[rows] = 0.0 if reader.specification.reads == "null" else found / MM
    measured = replace(
        plan,
        point_mm=read_only(readings),
        place_mm=read_only(np.where(np.isfinite(plan.along), plan.place_mm, np.nan)),
        station_pose=read_only(np.full((len(plan), 6), np.nan)),
        source="simulated",
        set_aside=(),
        notices=(),
        simulated=True,
    )
    return measured, placed


def _probed(
    machine: Machine,
    calibration: Calibration,
    plan: Measurements,
    setting: Placement,
    named: Mapping[str, Instrument],
    rng: np.random.Generator | None,
) -> Measurements:
    """Return a plan with the positions that its probes find, with noise from a generator; unchanged without a probe."""
    probed = np.array([named[name].specification.reads == "null" for name in plan.station.astype(str)])
    if not np.any(probed):
        return plan
    off = np.zeros((len(plan), 3))
    if rng is not None:
        for name in dict.fromkeys(plan.station[probed].astype(str)):
            of = plan.station == name
            off[of] = named[name].noise(np.zeros((int(np.count_nonzero(of)), 3)), rng) / MM
    return at_centres(machine, calibration, plan, setting, off, probed)


def at_centres(
    machine: Machine,
    calibration: Calibration,
    plan: Measurements,
    setting: Placement,
    off_mm: np.ndarray,
    rows: np.ndarray,
) -> Measurements:
    """Return a plan with the positions of the linear axes at which the tips of probes are at the centres of their spheres.

    ``plan``: the plan; its linear positions are the initial values; ``setting``: tips (the stations' origins) and spheres (the places);
    ``off_mm``: (n, 3) position of the sphere in the frame of the tip that counts as its centre (noise); ``rows``: (n,) which rows are
    probed; the others remain unchanged.

    Raises `InputError`: a sphere that the axes do not reach, or that is on the side of the probe.
    """
    wrong = np.flatnonzero(rows & ((plan.station_carrier == plan.carrier) | (plan.station_carrier == SIDES[0])))
    if len(wrong):
        raise plan.error(
            "a probe rides on the side opposite to its sphere",
            expected="station_carrier tool and carrier work",
            row=int(wrong[0]),
            value=f"station_carrier {plan.station_carrier[wrong[0]]}, carrier {plan.carrier[wrong[0]]}",
        )
    linear = [i for i, axis in enumerate(machine.axes) if axis.linear]
    places = np.array([setting.places_mm[target] for target in plan.target])
    observation, zero = Observation(machine), np.where(rows[:, None], off_mm, 0.0)

    def seen(positions: np.ndarray, errors: Calibration) -> np.ndarray:
        at = replace(plan, positions=read_only(positions.copy()))
        points, found = observation.points_mm(errors, at, places), np.zeros((len(plan), 3))
        for name, station in setting.stations.items():
            of = plan.station == name
            found[of] = station.to_station_mm(points[of])
        return np.asarray(found - zero)

    positions, nominal = np.array(plan.positions, dtype=float), Calibration.zero(machine)
    for errors in (nominal, nominal, calibration, calibration):
        here = seen(positions, errors)
        step = np.stack([seen(positions + np.eye(len(machine.axes))[i], errors) - here for i in linear], axis=2)
        positions[np.ix_(np.flatnonzero(rows), np.array(linear))] -= np.linalg.solve(step[rows], here[rows, :, None])[
            :, :, 0
        ]
    for i in linear:
        beyond = np.flatnonzero(rows & outside_axis_range(machine.axes[i], positions[:, i]))
        if len(beyond):
            raise plan.error(
                f"sphere {plan.target[beyond[0]]} is beyond the range of {machine.axes[i].name}",
                expected=f"{machine.axes[i].lower:g} to {machine.axes[i].upper:g} mm",
                row=int(beyond[0]),
                value=f"{positions[beyond[0], i]:.3f}",
            )
    return replace(plan, positions=read_only(positions.copy()))


def three_floats(values: Iterable[float]) -> tuple[float, float, float]:
    """Return three numbers as Python floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def _air(air: Air) -> str:
    return f"{air.temperature_degC:g} degC {air.pressure_hPa:g} hPa {100.0 * air.humidity:g} %"


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
