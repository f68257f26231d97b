"""What every instrument states: what it reads, how well, from where, and which numbers of its own have to be found.

A further instrument is one file with a `InstrumentSpecification` and one class, and one entry in
`twin.measurement.instruments.INSTRUMENTS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Final, final

import numpy as np

SIDES: Final = ("base", "tool", "work")
"""What a station can ride on (column ``station_carrier``): the base frame, the frame of the spindle nose, or the work frame."""


@final
@dataclass(frozen=True)
class InstrumentSpecification:
    """What describes an instrument.

    Attributes:
        name: the name that selects it.
        title: in words.
        columns: columns of the table that it fills.
        free_start: whether it counts from an unknown zero; an estimate then finds a dead path for each station.
        rides_on: sides its station can ride on. The readings are of the target in the station's frame, whatever that rides on.
        effects: effects of its own that a diagnosis may look for (names of contract §5).
    """

    name: str
    title: str
    columns: tuple[str, ...]
    free_start: bool
    rides_on: tuple[str, ...]
    effects: tuple[str, ...]


class Instrument(ABC):
    """An instrument that stands somewhere and reads reflectors.

    Points are in the station's own frame, metres, the station's origin at zero. A reading goes into the measurement table's
    ``x_mm, y_mm, z_mm``; what the instrument does not read stays empty (NaN).

    Attributes:
        specification: what describes it.
    """

    specification: InstrumentSpecification

    @abstractmethod
    def read(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) noise-free readings of (n, 3) points, metres; NaN in the columns it does not read."""

    @abstractmethod
    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """(n, 3, 3) derivative of the reading by the point; zero rows where nothing is read."""

    @abstractmethod
    def covariance(self, points: np.ndarray) -> np.ndarray:
        """(n, 3, 3) covariance of the readings, m²; zero rows and columns where nothing is read."""

    @abstractmethod
    def pooled(self, readings: np.ndarray, scatter: np.ndarray, dof: int) -> np.ndarray:
        """(n, 3, 3) covariance of the readings from their scatter about the means of repeats, m².

        Args:
            readings: (n, 3) metres; zero where nothing was read.
            scatter: (n, 3) readings less the mean of their repeats; zero where nothing was repeated.
            dof: degrees of freedom of the scatter of one coordinate.
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
        """(n, 3) one draw of the reading's error, metres."""
        values, vectors = np.linalg.eigh(self.covariance(points))
        scale = np.sqrt(np.maximum(values, 0.0))
        return np.einsum("nij,nj->ni", vectors, scale * rng.standard_normal((len(points), 3)))


def along_and_across(points: np.ndarray, along: np.ndarray, across: np.ndarray) -> np.ndarray:
    """(n, 3, 3) covariance of points seen from the origin: one standard deviation along the beam, another across it."""
    beam = points / np.linalg.norm(points, axis=1, keepdims=True)
    outer = beam[:, :, None] * beam[:, None, :]
    return along[:, None, None] ** 2 * outer + across[:, None, None] ** 2 * (np.eye(3) - outer)
