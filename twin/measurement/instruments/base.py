"""Base class of the instruments: readings, their covariance, and what they ride on.

A new instrument is one file with an `InstrumentSpecification` and one class, and one entry in
`twin.measurement.instruments.INSTRUMENTS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final, final

import numpy as np

SIDES: Final = ("base", "tool", "work")
"""Sides on which a station can ride (column ``station_carrier``): base frame, frame of the spindle nose, or work frame."""


@final
@dataclass(frozen=True)
class InstrumentSpecification:
    """Description of an instrument.

    Attributes:
        name: the name that selects it.
        title: its full name.
        columns: columns of the table that it fills.
        free_start: whether it counts from an unknown zero; an estimate then contains a dead path for each station.
        rides_on: sides on which its station can ride. Readings are of the target in the station's frame.
        effects: instrument errors that a diagnosis may look for (names of effects).
    """

    name: str
    title: str
    columns: tuple[str, ...]
    free_start: bool
    rides_on: tuple[str, ...]
    effects: tuple[str, ...]


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

    @property
    def lengths_only(self) -> bool:
        """Whether it reads a length and no coordinates."""
        return self.specification.columns == ("x_mm",)

    def noise(self, points: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Return (n, 3) a random draw of the readings' noise, metres."""
        values, vectors = np.linalg.eigh(self.covariance(points))
        scale = np.sqrt(np.maximum(values, 0.0))
        return np.einsum("nij,nj->ni", vectors, scale * rng.standard_normal((len(points), 3)))


def along_and_across(points: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return (n, 3, 3) the covariance of points seen from the origin, from standard deviations along and across the beam."""
    beam = points / np.linalg.norm(points, axis=1, keepdims=True)
    outer = beam[:, :, None] * beam[:, None, :]
    return along[:, None, None] ** 2 * outer + across[:, None, None] ** 2 * (np.eye(3) - outer)
