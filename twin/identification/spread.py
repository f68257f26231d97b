"""How far readings scatter: what repeats say of it, and how it carries into an estimate whose model leaves something out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import chi2_sf, f_sf
from twin._common.units import MM
from twin.identification.network import Network
from twin.identification.solve import FitSolution
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements

Spread = Literal["stated", "repeats", "between poses", "between rounds"]


@final
@dataclass(frozen=True)
class FitStatistics:
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


def misfit(
    whitened: np.ndarray, read: np.ndarray, data: Measurements, determined: float, used: np.ndarray
) -> FitStatistics:
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
    return FitStatistics(chi2, max(dof, 0.0), p_value, pure_chi2, pure_dof, lack_p)


def repeats(data: Measurements) -> np.ndarray:
    """(n,) index of the point each row repeats: same command, target, station and directions of approach."""
    keys = np.concatenate([np.round(data.positions, 6), data.approach], axis=1)
    _, pose = np.unique(keys, axis=0, return_inverse=True)
    _, target = np.unique(data.target.astype(str), return_inverse=True)
    _, station = np.unique(data.station.astype(str), return_inverse=True)
    _, group = np.unique(np.stack([pose.reshape(-1), target, station], axis=1), axis=0, return_inverse=True)
    return np.asarray(group.reshape(-1))


def covariance_from_repeats(data: Measurements, instrument: Instrument) -> np.ndarray:
    """(n, 3, 3) covariance of the readings as the repeats scatter, m²: the instrument's model, pooled over all points.

    Args:
        data: the measurements.
        instrument: what read them.

    Raises:
        InputError: fewer than ten degrees of freedom of repeats.
    """
    points = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    group = repeats(data)
    size = np.bincount(group)
    dof = int(np.sum(np.maximum(size - 1, 0)))
    if dof < 10:
        raise data.error(
            "too few repeats to know the scatter from",
            expected="ten or more readings of points that were read before",
            value=dof,
        )
    mean = np.stack([np.bincount(group, points[:, i]) / size for i in range(3)], axis=1)
    scatter = np.where(size[group, None] > 1, points - mean[group], 0.0)
    return locked(instrument.pooled(points, scatter, dof))


def covariance_of(network: Network, solution: FitSolution, weight: np.ndarray, spread: Spread) -> np.ndarray:
    """(p, p) covariance of an estimate, of the machine's unknowns and the set-up's.

    ``between poses`` is for a model that leaves something out that changes from pose to pose. It holds for poses drawn one by one, as
    those the machine will work in. Where neighbours were measured together they miss alike, and ``between rounds`` is the one that
    holds: what is left out is shared by the points of a round (poses about one place, one warming up).

    Args:
        network: data and model.
        solution: the estimate.
        weight: (n,) of each point; zero for one that was not used.
        spread: whose scatter it carries.

    Raises:
        InputError: fewer rounds than numbers determined.
    """
    data = network.data
    if spread == "between poses":
        _, group = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    elif spread == "between rounds":
        names, group = np.unique(data.round.astype(str), return_inverse=True)
        if len(names) <= len(solution.spectrum.singular_values):
            raise data.error(
                "too few rounds to know their scatter from",
                expected=f"more than the {len(solution.spectrum.singular_values)} numbers determined",
                value=len(names),
            )
    else:
        return solution.covariance()
    return _sandwich(network, solution, weight, group.reshape(-1))


def _sandwich(network: Network, solution: FitSolution, weight: np.ndarray, group: np.ndarray) -> np.ndarray:
    """A⁻¹ (Σ g gᵀ) A⁻¹ with one score g a group (Huber 1967; White 1982, eq. 3.2; clusters as Liang and Zeger 1986).

    It holds whatever the scatter between groups is, as long as the groups are many and drawn as those to come.
    """
    scores = np.zeros((group.max() + 1, len(solution.spectrum.scale)))
    for piece in network.pieces(solution.theta, solution.setup):
        own = np.einsum("nki,nk,n->ni", piece.jacobian, piece.residual, weight[piece.rows])
        np.add.at(scores, group[piece.rows], own)
    count = len(scores)
    return solution.covariance(scores.T @ scores * (count / max(count - 1, 1)))
