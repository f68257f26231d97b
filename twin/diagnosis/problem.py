"""The readings after everything the set-up and the fitted geometry can absorb has been projected out.

Whitened residual r and signatures S are judged by what remains of them beside the set-up's derivatives B (and the calibration's own
uncertainty, as directions with unit prior variance): xᵀMy = xᵀy − (Qᵀx)ᵀ(Qᵀy), Q the part in the readings of an orthonormal basis of
[B, J·L; 0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Final, final

import numpy as np

from twin.calibration import Calibration
from twin.diagnosis.signatures import Column, of_effect
from twin.identification.network import Network, View
from twin.identification.setup import SetUp
from twin.measurement import state_of

TOLD_APART: Final = 1e-9
"""Relative size of a set-up direction below which it is no direction of its own."""


@final
class Problem:
    """Readings, set-up and calibration of one data set, linearised at the fitted set-up.

    Args:
        network: data and calibration (as ``base``), no unknowns.
        setup: the fitted set-up.
        calibration: whose covariance counts as uncertainty; none if None.
    """

    def __init__(self, network: Network, setup: SetUp, calibration: Calibration | None) -> None:
        self.network = network
        self.setup = setup
        n = len(network.data)
        self.view: View = network.view(np.zeros(0), setup, np.arange(n))
        self.residual = self.view.residual.reshape(-1)
        by_setup = np.zeros((n, 3, len(setup)))
        network.by_setup(self.view, setup, by_setup)
        raw = by_setup.reshape(3 * n, -1) * setup.plausible
        own = self._uncertain(calibration)
        self.nuisance = np.concatenate([raw, own], axis=1)
        self.prior = np.concatenate([np.zeros((own.shape[1], raw.shape[1])), np.eye(own.shape[1])], axis=1)
        self.basis = _basis(self.nuisance, self.prior)
        self.held: np.ndarray = np.zeros(0, dtype=int)
        self.absorbed = self.basis.shape[1] - own.shape[1]
        self.judge(self.residual)
        self.readings = int(np.count_nonzero(network.read))

    def without(self, held: np.ndarray) -> Problem | None:
        """The same with some rows taken out (zero); None if a station or target would be lost.

        Args:
            held: (3n,) rows to take out.
        """
        part = copy(self)
        keep = np.where(held, 0.0, 1.0)
        part.held = np.flatnonzero(held)
        part.nuisance = self.nuisance * keep[:, None]
        if np.any((np.linalg.norm(part.nuisance, axis=0) == 0.0) & (np.linalg.norm(self.nuisance, axis=0) > 0.0)):
            return None
        part.basis = _basis(part.nuisance, self.prior)
        part.judge(self.residual * keep)
        return part

    def judge(self, residual: np.ndarray) -> None:
        """Another (3n,) whitened residual at the same set-up."""
        self.residual = residual
        self.projected = self.project(residual)
        self.chi2 = float(residual @ self.projected)

    def project(self, residual: np.ndarray) -> np.ndarray:
        """A (3n,) residual beside the set-up and the calibration's doubt; rows that are held out are zero."""
        residual = self._kept(residual)
        return np.asarray(residual - self.basis @ (self.basis.T @ residual))

    def following(self, residual: np.ndarray, counted: np.ndarray) -> np.ndarray:
        """A (3n,) residual once the set-up has been fitted to some of its rows.

        Args:
            residual: whitened.
            counted: (3n,) rows that the set-up follows.
        """
        train = np.concatenate([self.nuisance[counted], self.prior])
        right = np.concatenate([residual[counted], np.zeros(len(self.prior))])
        scale = np.maximum(np.linalg.norm(train, axis=0), 1e-300)
        solved = np.linalg.lstsq(train / scale, right, rcond=1e-9)[0] / scale
        return np.asarray(residual - self.nuisance @ solved)

    def _kept(self, rows: np.ndarray) -> np.ndarray:
        if len(self.held) == 0:
            return rows
        found = np.array(rows)
        found[self.held] = 0.0
        return found

    @property
    def dof(self) -> int:
        """Readings that the set-up does not settle."""
        return self.readings - self.absorbed

    def signature(self, columns: Sequence[Column]) -> np.ndarray:
        """(3n, columns) whitened, in plausible sizes; each column in one piece."""
        found = np.empty((len(columns), len(self.residual)))
        for k, column in enumerate(columns):
            np.multiply(column.reading(self.view).reshape(-1), column.scale, out=found[k])
        return found.T

    def inner(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """aᵀMb of signatures."""
        a = self._kept(a)
        return np.asarray(a.T @ b - (self.basis.T @ a).T @ (self.basis.T @ b))

    def along(self, a: np.ndarray, residual: np.ndarray | None = None) -> np.ndarray:
        """aᵀMr; the data's residual, or another that is projected already."""
        return np.asarray(a.T @ (self.projected if residual is None else residual))

    def _uncertain(self, calibration: Calibration | None) -> np.ndarray:
        """(3n, k) what one standard deviation of each direction of the calibration's covariance does."""
        n = len(self.network.data)
        if calibration is None or not calibration.covariance.names:
            return np.zeros((3 * n, 0))
        covariance = calibration.covariance
        known = set(covariance.names)
        machine = self.network.machine
        state = state_of(self.network.data, machine)
        found: dict[str, np.ndarray] = {}
        for effect in calibration.effects:
            names = [parameter.name for parameter in effect.parameters]
            if names[0] in known:
                for name, column in zip(names, of_effect(effect, machine, state), strict=True):
                    found[name] = column.reading(self.view).reshape(-1)
        values, vectors = np.linalg.eigh(covariance.matrix)
        strong = values > 1e-12 * max(float(values[-1]), 1e-300)
        root = vectors[:, strong] * np.sqrt(values[strong])
        return np.asarray(np.stack([found[name] for name in covariance.names], axis=1) @ root)


def _basis(nuisance: np.ndarray, prior: np.ndarray) -> np.ndarray:
    """The readings' part of an orthonormal basis of what the set-up and the calibration's doubt can do."""
    u, values, _ = np.linalg.svd(np.concatenate([nuisance, prior]), full_matrices=False)
    kept = values > TOLD_APART * values[0] if len(values) else np.zeros(0, dtype=bool)
    return np.asarray(u[: len(nuisance), kept])
