"""How far readings scatter: what repeats say of it, and how it carries into an estimate whose model leaves something out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import chi2_sf, f_sf
from twin._common.errors import InputError
from twin._common.units import MM
from twin.identification.network import Network
from twin.identification.solve import Solution
from twin.measurement.instruments import Instrument
from twin.measurement.instruments.base import along_and_across
from twin.measurement.table import Measurements


@final
@dataclass(frozen=True)
class Misfit:
    """What is left beside what the readings' covariance allows; nothing is rescaled by it.

    Attributes:
        chi2, dof: sum of squared whitened residuals, and how many readings are free of the estimate (no whole number: beyond
            the chosen orders the readings settle a share of each number).
        p_value: of a chi² that large or larger if the stated covariance holds.
        pure_chi2, pure_dof: the part that is scatter between repeats of the same point.
        lack_p_value: of the rest against the repeats (F test of lack of fit); NaN without repeats.
    """

    chi2: float
    dof: float
    p_value: float
    pure_chi2: float
    pure_dof: int
    lack_p_value: float

    @property
    def reduced(self) -> float:
        """chi² a degree of freedom: one where model and stated covariance hold."""
        return self.chi2 / self.dof if self.dof else float("nan")

    @property
    def pure_reduced(self) -> float:
        """The same of repeats alone: one where the stated covariance holds, whatever the model."""
        return self.pure_chi2 / self.pure_dof if self.pure_dof else float("nan")


def misfit(whitened: np.ndarray, read: np.ndarray, data: Measurements, determined: float, used: np.ndarray) -> Misfit:
    """Misfit of an estimate.

    Args:
        whitened: (n, 3) whitened residuals.
        read: (n, 3) which coordinates were read.
        data: the measurements.
        determined: how many numbers the readings settled.
        used: (n,) which points were used.
    """
    chi2 = float(np.sum(whitened[used] ** 2))
    dof = float(np.count_nonzero(read[used])) - determined
    group = repeats(data)
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
    return Misfit(chi2, max(dof, 0.0), p_value, pure_chi2, pure_dof, lack_p)


def repeats(data: Measurements) -> np.ndarray:
    """(n,) index of the point each row repeats: same command, target, station and directions of approach."""
    keys = np.concatenate([np.round(data.positions, 6), data.approach], axis=1)
    _, pose = np.unique(keys, axis=0, return_inverse=True)
    _, target = np.unique(data.target.astype(str), return_inverse=True)
    _, station = np.unique(data.station.astype(str), return_inverse=True)
    _, group = np.unique(np.stack([pose.reshape(-1), target, station], axis=1), axis=0, return_inverse=True)
    return np.asarray(group.reshape(-1))


def covariance_from_repeats(data: Measurements, instrument: Instrument) -> tuple[np.ndarray, int]:
    """Covariance of the readings as the repeats scatter: one variance along the beam, one across, pooled over all points.

    Args:
        data: the measurements.
        instrument: only asked whether it reads lengths alone.

    Returns:
        (n, 3, 3) m², and the degrees of freedom along the beam.

    Raises:
        InputError: fewer than ten degrees of freedom of repeats.
    """
    read = np.isfinite(data.point_mm)
    points = np.where(read, data.point_mm, 0.0) * MM
    group = repeats(data)
    size = np.bincount(group)
    if np.sum(np.maximum(size - 1, 0)) < 10:
        raise InputError(
            "too few repeats to know the scatter from",
            expected="ten or more readings of points that were read before",
            file=data.source,
            value=int(np.sum(np.maximum(size - 1, 0))),
        )
    mean = np.stack([np.bincount(group, points[:, i]) / size for i in range(3)], axis=1)
    off = np.where(size[group, None] > 1, points - mean[group], 0.0)
    free = int(np.sum(np.maximum(size - 1, 0)))
    if instrument.lengths_only:
        found = np.zeros((len(points), 3, 3))
        found[:, 0, 0] = np.sum(off[:, 0] ** 2) / free
        return locked(found), free
    beam = points / np.linalg.norm(points, axis=1, keepdims=True)
    along = np.sum(off * beam, axis=1)
    across = np.sum(off**2) - np.sum(along**2)
    n = len(points)
    return locked(
        along_and_across(
            points, np.full(n, np.sqrt(np.sum(along**2) / free)), np.full(n, np.sqrt(across / (2.0 * free)))
        )
    ), free


def between_poses(network: Network, solution: Solution, weight: np.ndarray) -> np.ndarray:
    """Covariance of an estimate whose model leaves something out that changes from pose to pose.

    Holds for poses drawn one by one, as those the machine will work in. Where neighbours were measured together they miss alike, and
    `between_rounds` is the one that holds.

    Args:
        network: data and model.
        solution: the estimate.
        weight: (n,) of each point.
    """
    _, pose = np.unique(np.round(network.data.positions, 3), axis=0, return_inverse=True)
    return _sandwich(network, solution, weight, pose.reshape(-1))


def between_rounds(network: Network, solution: Solution, weight: np.ndarray) -> np.ndarray:
    """The same where what is left out is shared by the points of a round: poses about one place, one warming up.

    Args:
        network: data and model.
        solution: the estimate.
        weight: (n,) of each point.

    Raises:
        InputError: fewer rounds than numbers determined.
    """
    names, group = np.unique(network.data.round.astype(str), return_inverse=True)
    if len(names) <= len(solution.spectrum.strength):
        raise InputError(
            "too few rounds to know their scatter from",
            expected=f"more than the {len(solution.spectrum.strength)} numbers determined",
            file=network.data.source,
            value=len(names),
        )
    return _sandwich(network, solution, weight, group.reshape(-1))


def _sandwich(network: Network, solution: Solution, weight: np.ndarray, group: np.ndarray) -> np.ndarray:
    """A⁻¹ (Σ g gᵀ) A⁻¹ with one score g a group (Huber 1967; White 1982, eq. 3.2; clusters as Liang and Zeger 1986).

    It holds whatever the scatter between groups is, as long as the groups are many and drawn as those to come.
    """
    scores = np.zeros((group.max() + 1, len(solution.spectrum.scale)))
    for piece in network.pieces(solution.theta, solution.setup):
        own = np.einsum("nki,nk,n->ni", piece.jacobian, piece.residual, weight[piece.rows])
        np.add.at(scores, group[piece.rows], own)
    count = len(scores)
    return solution.covariance(scores.T @ scores * (count / max(count - 1, 1)))
