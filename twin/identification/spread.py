"""Noise of the readings: estimates from repeats, and the covariance of an estimate whose model is incomplete."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_sf, f_sf
from twin._common.units import MM
from twin.identification.network import Network
from twin.identification.solve import FitSolution
from twin.identification.start import nominal_carriers
from twin.machine.machine import Machine
from twin.measurement.instruments import StationInstruments
from twin.measurement.state import at_origin
from twin.measurement.table import Measurements

Spread = Literal["stated", "repeats", "between poses", "between rounds"]


@final
@dataclass(frozen=True)
class FitStatistics:
    """Residuals compared with the stated covariance of the readings; nothing is scaled by it.

    Attributes:
        chi2, dof: sum of squared whitened residuals and its degrees of freedom (not an integer: beyond the chosen orders, the readings
            determine a share of each parameter).
        p_value: probability of a chi² at least as large if the stated covariance holds.
        pure_chi2, pure_dof: part of it between repeats of the same point (pure error).
        lack_p_value: p-value of the remainder compared with the repeats (F test of lack of fit); NaN without repeats.
    """

    chi2: float
    dof: float
    p_value: float
    pure_chi2: float
    pure_dof: int
    lack_p_value: float

    @property
    def reduced(self) -> float:
        """chi² per degree of freedom: one if model and stated covariance hold."""
        return self.chi2 / self.dof if self.dof else float("nan")

    @property
    def pure_reduced(self) -> float:
        """The same for repeats alone: one if the stated covariance holds, whatever the model."""
        return self.pure_chi2 / self.pure_dof if self.pure_dof else float("nan")


def misfit(
    whitened: np.ndarray, read: np.ndarray, data: Measurements, determined: float, used: np.ndarray
) -> FitStatistics:
    """Return the misfit of an estimate.

    Args:
        whitened: (n, 3) whitened residuals.
        read: (n, 3) which coordinates were read.
        data: the measurements.
        determined: number of parameters determined by the readings.
        used: (n,) which points were used.
    """
    chi2 = float(np.sum(whitened[used] ** 2))
    dof = float(np.count_nonzero(read[used])) - determined
    group = repeat_groups(data)
    pure_chi2, pure_dof = 0.0, 0
    order = np.flatnonzero(used)
    for pattern in np.unique(read[order], axis=0):
        rows = order[np.all(read[order] == pattern, axis=1)]
        size = np.bincount(group[rows], minlength=group.max() + 1)
        total = np.stack([np.bincount(group[rows], whitened[rows, i], minlength=len(size)) for i in range(3)], axis=1)
        mean = total / np.maximum(size, 1)[:, None]
        pure_chi2 += float(np.sum((whitened[rows] - mean[group[rows]]) ** 2))
        pure_dof += int(np.sum(np.maximum(size - 1, 0)) * np.count_nonzero(pattern))
    lack_dof, lack = dof - pure_dof, chi2 - pure_chi2
    lack_p = float("nan")
    if pure_dof > 0 and lack_dof > 0 and pure_chi2 > 0.0:
        lack_p = float(f_sf((lack / lack_dof) / (pure_chi2 / pure_dof), lack_dof, pure_dof))
    p_value = float(chi2_sf(chi2, dof)) if dof > 0 else float("nan")
    return FitStatistics(chi2, max(dof, 0.0), p_value, pure_chi2, pure_dof, lack_p)


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


def covariance_from_repeats(machine: Machine, data: Measurements, instruments: StationInstruments) -> np.ndarray:
    """Return (n, 3, 3) the covariance of the readings from repeats, m²: each instrument's model, pooled over all its points.

    Args:
        machine: the machine.
        data: the measurements.
        instruments: those of their stations.

    Raises:
        InputError: fewer than ten degrees of freedom of repeats of an instrument.
    """
    points = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    # A probe reads zero: its repeats differ in the axis positions.
    points = np.where(at_origin(data)[:, None], nominal_carriers(machine, data).points, points)
    every = repeat_groups(data)
    found = np.zeros((len(data), 3, 3))
    for instrument, rows in instruments.groups(data.station):
        group, own = every[rows], points[rows]
        size = np.bincount(group)
        dof = int(np.sum(np.maximum(size - 1, 0)))
        if dof < 10:
            raise data.error(
                f"too few repeats to estimate the noise of the {instrument.name}",
                expected="at least ten repeated readings",
                value=dof,
            )
        mean = np.stack([np.bincount(group, own[:, i]) / np.maximum(size, 1) for i in range(3)], axis=1)
        deviations = np.where(size[group, None] > 1, own - mean[group], 0.0)
        found[rows] = instrument.pooled(own, deviations, dof)
    return read_only(found)


def covariance_of(network: Network, solution: FitSolution, weight: np.ndarray, spread: Spread) -> np.ndarray:
    """Return the (p, p) covariance of an estimate, of the machine's unknowns and the set-up's.

    ``between poses`` is for a model that lacks an influence which changes from pose to pose. It holds for independent poses that
    represent those of later use. If neighbouring poses were measured together, their misfits are correlated, and ``between rounds`` is
    valid: the points of a round share the influence (poses near one place, one warm-up).

    Args:
        network: data and model.
        solution: the estimate.
        weight: (n,) weight of each point; zero for one that was not used.
        spread: noise on which it is based.

    Raises:
        InputError: fewer rounds than parameters determined.
    """
    data = network.data
    if spread == "between poses":
        _, group = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    elif spread == "between rounds":
        names, group = np.unique(data.round.astype(str), return_inverse=True)
        if len(names) <= len(solution.spectrum.singular_values):
            raise data.error(
                "too few rounds to estimate their variation",
                expected=f"more than the {len(solution.spectrum.singular_values)} parameters determined",
                value=len(names),
            )
    else:
        return solution.covariance()
    return _sandwich(network, solution, weight, group.reshape(-1))


def _sandwich(network: Network, solution: FitSolution, weight: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return A⁻¹ (Σ g gᵀ) A⁻¹ with one score g per group (Huber 1967; White 1982, eq. 3.2; clusters as Liang and Zeger 1986).

    It holds for any variation between groups, provided that the groups are many and represent those of later use.
    """
    scores = np.zeros((group.max() + 1, len(solution.spectrum.scale)))
    for piece in network.chunks(solution.theta, solution.setup):
        own = np.einsum("nki,nk,n->ni", piece.jacobian, piece.residual, weight[piece.rows])
        np.add.at(scores, group[piece.rows], own)
    count = len(scores)
    return solution.covariance(scores.T @ scores * (count / max(count - 1, 1)))
