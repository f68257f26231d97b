"""What every instrument is: a prediction of its reading of a point, and the covariance of that reading."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np


class Instrument(ABC):
    """An instrument that stands somewhere and reads reflectors.

    Points are in the station's own frame, metres, the station's origin at zero. A reading goes into the measurement table's
    ``x_mm, y_mm, z_mm``; what the instrument does not read stays empty (NaN).
    """

    name: str

    @abstractmethod
    def read(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) noise-free readings of (n, 3) points, metres; NaN in the columns it does not read."""

    @abstractmethod
    def jacobian(self, points: np.ndarray) -> np.ndarray:
        """(n, 3, 3) derivative of the reading by the point; zero rows where nothing is read."""

    @abstractmethod
    def covariance(self, points: np.ndarray) -> np.ndarray:
        """(n, 3, 3) covariance of the readings, m²; zero rows and columns where nothing is read."""

    @property
    def lengths_only(self) -> bool:
        """Whether it reads a length and no coordinates."""
        return bool(np.isnan(self.read(np.ones((1, 3)))[0, 1]))

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
