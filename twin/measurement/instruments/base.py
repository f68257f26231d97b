"""Base class of the instruments: readings, their covariance, and what they ride on.

A new instrument is one file with an `InstrumentSpecification` and one class, and one entry in
`twin._common.families.INSTRUMENTS`.

Refractive index of air, and its influence on a measured length.

Birch and Downs (1994), "Correction to the updated Edlén equation for the refractive index of air", Metrologia 31, 315-316, with the
saturation pressure of water vapour by the Magnus formula (WMO-No. 8, annex 4.B).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Final, Literal, final

import numpy as np

from twin._common.errors import InputError
from twin._common.units import UM
from twin.numerics.covariance import symmetric_root

SIDES: Final = ("base", "tool", "work")
"""Sides on which a station can ride (column ``station_carrier``): base frame, frame of the spindle nose, or work frame."""
Reads = Literal["point", "length", "coordinate", "null", "angle"]
"""Kinds of reading of a target in its station's frame: coordinates; the distance from the station's origin; the coordinate
along its x; nothing, because the axis positions in the row are those at which the target was at the station's origin; the end of a
line of 1 m that turns with the target about the station's origin."""


@final
@dataclass(frozen=True)
class SetUpWords:
    """Words for the parts of an instrument's set-up: the columns ``station`` and ``target`` of the table name them.

    ``station``, ``target``: what precedes the name of a station or target; ``station_place``: what to enter so that the station's place
    is known; empty if that is not practical; ``target_place``: what to enter so that the targets' places are known.
    """

    station: str = "station"
    target: str = "target"
    station_place: str = ""
    target_place: str = "the targets' places (place_x_mm …)"


@final
@dataclass(frozen=True)
class InstrumentSpecification:
    """Description of an instrument.

    Attributes:
        name: the name that selects it.
        title: its full name.
        columns: columns of the table that it fills.
        reads: what it reads of a target.
        free_start: whether it counts from an unknown zero; an estimate then contains a dead path for each station.
        rides_on: sides on which its station can ride. Readings are of the target in the station's frame.
        range_mm: largest reading.
        beam: whether it measures along and across a beam, with different uncertainties.
        aligned: whether its frame is nearly the one on which it rides, as that of a part.
        nominal_length: whether it has a nominal length, from which its readings may be deviations.
        set_up: words for the parts of its set-up.
        source: where its default uncertainty comes from.
        effects: instrument errors that a diagnosis may look for (names of effects).
    """

    name: str
    title: str
    columns: tuple[str, ...]
    reads: Reads
    free_start: bool
    rides_on: tuple[str, ...]
    effects: tuple[str, ...]
    source: str
    range_mm: float = np.inf
    beam: bool = True
    aligned: bool = False
    nominal_length: bool = False
    set_up: SetUpWords = SetUpWords()

    @property
    def turns(self) -> bool:
        """Whether a reading depends on the rotation of the station."""
        return self.reads in ("point", "coordinate")


class Instrument(ABC):
    """An instrument at a station that reads the positions of reflectors.

    Points are in the station's own frame, metres, with the station's origin at zero. A reading fills ``x_mm, y_mm, z_mm`` of the
    measurement table; what the instrument does not read stays empty (NaN).

    Attributes:
        specification: its description.
    """

    specification: InstrumentSpecification

    @abstractmethod
    def read(self, points: np.ndarray) -> np.ndarray:
        """Return (n, 3) noise-free readings of (n, 3) points, metres; NaN in the columns it does not read."""

    @abstractmethod
    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """Return (n, 3, 3) the derivative of the reading with respect to the point; zero rows where nothing is read."""

    @abstractmethod
    def covariance(self, points: np.ndarray) -> np.ndarray:
        """Return (n, 3, 3) the covariance of the readings, m²; zero rows and columns where nothing is read."""

    @abstractmethod
    def pooled(self, readings: np.ndarray, deviations: np.ndarray, dof: int) -> np.ndarray:
        """Return (n, 3, 3) the covariance of the readings estimated from repeats, m².

        Args:
            readings: (n, 3) metres; zero where nothing was read.
            deviations: (n, 3) readings minus the mean of their repeats; zero where nothing was repeated.
            dof: degrees of freedom of the deviations of one coordinate.
        """

    @property
    def name(self) -> str:
        """The name that selects it."""
        return self.specification.name

    def noise(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return (n, 3) a random draw of the readings' noise, metres; from one seed the same on every processor, up to rounding."""
        return np.einsum("nij,nj->ni", symmetric_root(self.covariance(points)), rng.standard_normal((len(points), 3)))


class LengthReading(Instrument):
    """An instrument that reads the distance from its station's origin, in the table's ``x_mm``; y and z stay empty."""

    @abstractmethod
    def sigma_m(self, points: np.ndarray) -> np.ndarray:
        """Return (n,) the standard uncertainty of the lengths to (n, 3) points, metres."""

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        readings = np.full((len(points), 3), np.nan)
        readings[:, 0] = np.linalg.norm(points, axis=1)
        return readings

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.jacobian`."""
        rows = np.zeros((len(points), 3, 3))
        rows[:, 0, :] = points / np.linalg.norm(points, axis=1, keepdims=True)
        return rows

    def covariance(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.covariance`."""
        return _first_only(self.sigma_m(points) ** 2)

    def pooled(self, readings: np.ndarray, deviations: np.ndarray, dof: int) -> np.ndarray:
        """See `Instrument.pooled`: one variance for all lengths."""
        return _first_only(np.full(len(readings), np.sum(deviations[:, 0] ** 2) / dof))


class IsotropicNoise(Instrument):
    """An instrument whose coordinates have the same, independent uncertainty. ``sees``: which coordinates it reads."""

    sigma_um: float
    sees: ClassVar[tuple[bool, bool, bool]] = (True, True, True)

    def read(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.read`."""
        return np.where(self.sees, points, np.nan)

    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.jacobian`."""
        return self._diagonal(points, 1.0)

    def covariance(self, points: np.ndarray) -> np.ndarray:
        """See `Instrument.covariance`."""
        return self._diagonal(points, (self.sigma_um * UM) ** 2)

    def pooled(self, readings: np.ndarray, deviations: np.ndarray, dof: int) -> np.ndarray:
        """See `Instrument.pooled`: one variance for all coordinates."""
        return self._diagonal(readings, float(np.sum(deviations[:, self.sees] ** 2)) / (sum(self.sees) * dof))

    def _diagonal(self, points: np.ndarray, value: float) -> np.ndarray:
        """Return (n, 3, 3) with a value on the diagonal of the coordinates that it reads."""
        return np.broadcast_to(value * np.diag(np.array(self.sees, dtype=float)), (len(points), 3, 3))


@final
@dataclass(frozen=True, eq=False)
class StationInstruments:
    """The instruments of the stations of a table. ``by_station``: the instrument of each station, by name."""

    by_station: Mapping[str, Instrument]

    @classmethod
    def same(cls, instrument: Instrument, stations: np.ndarray) -> StationInstruments:
        """Return one instrument for all of the stations (n,)."""
        return cls(dict.fromkeys(stations.tolist(), instrument))

    @cached_property
    def every(self) -> tuple[Instrument, ...]:
        """The different instruments."""
        return tuple(dict.fromkeys(self.by_station.values()))

    @property
    def name(self) -> str:
        """Names of the instruments, in words."""
        return " and ".join(one.name for one in self.every)

    def groups(self, stations: np.ndarray) -> Iterator[tuple[Instrument, np.ndarray]]:
        """Yield each instrument with the indices of its rows, from the station (n,) of each row."""
        if len(self.every) == 1:
            yield self.every[0], np.arange(len(stations))
            return
        number = {name: self.every.index(one) for name, one in self.by_station.items()}
        which = np.array([number[name] for name in stations], dtype=int)
        for i, instrument in enumerate(self.every):
            rows = np.flatnonzero(which == i)
            if len(rows):
                yield instrument, rows

    def covariance(self, points: np.ndarray, stations: np.ndarray) -> np.ndarray:
        """Return (n, 3, 3) the covariance of the readings of (n, 3) points by the instruments of (n,) stations, m²."""
        covariance = np.empty((len(points), 3, 3))
        for instrument, rows in self.groups(stations):
            covariance[rows] = instrument.covariance(points[rows])
        return covariance


def _first_only(variance: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) covariances of readings of one number, from (n,) variances."""
    first_only = np.zeros((len(variance), 3, 3))
    first_only[:, 0, 0] = variance
    return first_only


def along_and_across(points: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) the covariance of points seen from the origin, from standard deviations along and across the beam."""
    beam = points / np.linalg.norm(points, axis=1, keepdims=True)
    outer = beam[:, :, None] * beam[:, None, :]
    return along[:, None, None] ** 2 * outer + across[:, None, None] ** 2 * (np.eye(3) - outer)


# --- Refractive index of air, and its influence on a measured length ------------------------------

HELIUM_NEON_UM: Final = 0.6329908
"""Vacuum wavelength of a helium-neon laser, µm."""


@final
@dataclass(frozen=True)
class Air:
    """State of the air along the beam.

    ``humidity``: relative, 0 to 1.

    Raises:
        InputError: a value that does not occur in a workshop.
    """

    temperature_degC: float = 20.0
    pressure_hPa: float = 1013.25
    humidity: float = 0.5

    def __post_init__(self) -> None:
        for what, value, low, high, unit in (
            ("air temperature", self.temperature_degC, -20.0, 60.0, " °C"),
            ("air pressure", self.pressure_hPa, 500.0, 1200.0, " hPa"),
            ("relative humidity", self.humidity, 0.0, 1.0, ""),
        ):
            if not low <= value <= high:
                raise InputError(f"{what} out of range", expected=f"{low:g} to {high:g}{unit}", value=value)


STANDARD_AIR: Final = Air()
"""20 °C, 1013.25 hPa, 50 %: the air assumed by an instrument without its own sensors."""


def refractive_index(air: Air, wavelength_um: float = HELIUM_NEON_UM) -> float:
    """Return the phase refractive index of air; ``wavelength_um``: vacuum wavelength, µm (visible)."""
    t, p = air.temperature_degC, air.pressure_hPa * 100.0
    s = 1.0 / wavelength_um**2
    standard = 1e-8 * (8342.54 + 2406147.0 / (130.0 - s) + 15998.0 / (38.9 - s))
    density = (1.0 + 1e-8 * (0.601 - 0.00972 * t) * p) / (1.0 + 0.003661 * t)
    vapour = air.humidity * 611.2 * float(np.exp(17.62 * t / (243.12 + t)))
    dry = 1.0 + p * standard * density / 96095.43
    return dry - 1e-10 * vapour * (292.75 / (t + 273.15)) * (3.7345 - 0.0401 * s)


def length_scale(actual: Air, assumed: Air, wavelength_um: float = HELIUM_NEON_UM) -> float:
    """Return the factor on every length read if the instrument corrects for ``assumed`` air and the beam passes ``actual`` air."""
    return refractive_index(actual, wavelength_um) / refractive_index(assumed, wavelength_um)
