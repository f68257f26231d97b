"""A plan in, measured data out: the machine with its errors, read by an instrument, with stated noise and seed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
import pinocchio as pin

from twin.arrays import locked
from twin.calibration import Calibration
from twin.instruments import Instrument
from twin.machine import Machine
from twin.measurement import Measurements
from twin.observation import Observation
from twin.units import MM

STATION_DISTANCE_MM: Final = 1800.0
"""How far from the base frame a station stands when nobody says where."""


@final
@dataclass(frozen=True)
class Station:
    """Where an instrument stands.

    Attributes:
        origin_mm: its origin in the base frame.
        turn_rad: rotation vector of its frame in the base frame.
    """

    origin_mm: tuple[float, float, float]
    turn_rad: tuple[float, float, float]

    def to_station_mm(self, points_mm: np.ndarray) -> np.ndarray:
        """(n, 3) points of the base frame in the station's frame."""
        return (points_mm - np.array(self.origin_mm)) @ pin.exp3(np.array(self.turn_rad))


@final
@dataclass(frozen=True)
class Setting:
    """What a simulation knows and an evaluation has to find: stations and reflector places.

    Attributes:
        stations: by name.
        places_mm: place of each target on its carrier, by name.
    """

    stations: Mapping[str, Station]
    places_mm: Mapping[str, tuple[float, float, float]]

    @classmethod
    def drawn(cls, plan: Measurements, rng: np.random.Generator) -> Setting:
        """A plausible one: stations in front of the machine, targets around the spindle nose and on the table."""
        stations = {}
        for k, name in enumerate(dict.fromkeys(plan.station)):
            azimuth = np.radians(-90.0 + 55.0 * ((k + 1) // 2) * (-1) ** k)
            origin = STATION_DISTANCE_MM * np.array([np.cos(azimuth), np.sin(azimuth), 0.15 + 0.25 * k])
            x, y, z = origin + rng.uniform(-100.0, 100.0, 3)
            stations[name] = Station((float(x), float(y), float(z)), (0.0, 0.0, float(rng.uniform(-np.pi, np.pi))))
        places = {}
        counts = {"tool": 0, "work": 0}
        for target in dict.fromkeys(plan.target):
            side = str(plan.carrier[plan.target == target][0])
            azimuth = np.radians(30.0 + 120.0 * counts[side] + rng.uniform(-15.0, 15.0))
            radius, height = (
                (110.0, -40.0 - 35.0 * counts[side]) if side == "tool" else (170.0, 30.0 + 30.0 * counts[side])
            )
            places[target] = (float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth)), height)
            counts[side] += 1
        return cls(stations, places)

    def describe(self) -> str:
        """The lines a simulated file carries, so that nothing about it is hidden."""
        lines = [
            f"station {name}: origin {_numbers(station.origin_mm)} mm, rotation vector {_numbers(station.turn_rad)} rad"
            for name, station in self.stations.items()
        ]
        lines += [f"target {name}: {_numbers(place)} mm on its carrier" for name, place in self.places_mm.items()]
        return "\n".join(lines)


def simulate(
    plan: Measurements,
    machine: Machine,
    calibration: Calibration,
    instrument: Instrument,
    rng: np.random.Generator,
    *,
    setting: Setting | None = None,
    noise: bool = True,
) -> tuple[Measurements, Setting]:
    """Measure a plan.

    Args:
        plan: positions, targets, carriers, stations and rounds; its coordinates are not used.
        machine: the machine.
        calibration: its true errors.
        instrument: what reads.
        rng: the seed's generator.
        setting: stations and places; drawn if None.
        noise: whether the readings err.

    Returns:
        The measurements, with the instrument's standard uncertainties left out (the instrument's model gives them), and the setting.

    Raises:
        InputError: a position no curve covers.
    """
    placed = Setting.drawn(plan, rng) if setting is None else setting
    places = np.array([placed.places_mm[target] for target in plan.target])
    base = Observation(machine, calibration).points_mm(plan.positions, plan.carrier, places)
    readings = np.empty((len(plan), 3))
    for name, station in placed.stations.items():
        rows = plan.station == name
        seen = station.to_station_mm(base[rows]) * MM
        found = instrument.read(seen)
        if noise:
            found = found + instrument.noise(seen, rng)
        readings[rows] = found / MM
    return replace(plan, point_mm=locked(readings), source="simulated", set_aside=(), notices=()), placed


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
