"""Residuals at held-out poses, in micrometres: how far off the written calibration is where nothing was measured.

Every fold leaves out some of the poses with all their readings. Near the estimate the problem is linear, so that the estimate without
a fold follows from the normal equations (leave-group-out residuals; Cook and Weisberg 1982, section 2.2). Outliers, priors and weights
are those of the whole estimate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin.identification.network import Network
from twin.identification.solve import FitSolution

FOLDS: Final = 5
"""Number of folds: every fifth pose is left out together."""


@final
@dataclass(frozen=True)
class HeldOutResiduals:
    """Residuals at held-out poses.

    Attributes:
        rms_um: RMS per coordinate.
        folds: number of folds.
        poses: number of different poses.
        readings: number of coordinates that were held out.
    """

    rms_um: float
    folds: int
    poses: int
    readings: int

    @property
    def text(self) -> str:
        """One line."""
        return f"{self.rms_um:.3g} µm RMS per coordinate ({self.poses:,} poses in {self.folds} folds, each predicted from the others)"


def held_out_residuals(network: Network, solution: FitSolution, used: np.ndarray) -> HeldOutResiduals | None:
    """Return the residuals at held-out poses; None with fewer than two poses, or if the rest determines no station and target.

    Args:
        network: data and model, with the weights of the estimate.
        solution: the estimate.
        used: (n,) the points that were used.
    """
    data = network.data
    poses, pose = np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)
    folds = min(FOLDS, len(poses))
    if folds < 2:
        return None
    fold = pose.reshape(-1) % folds
    tested = used & _determined_by_others(data.station, fold, used) & _determined_by_others(data.target, fold, used)
    if not np.any(network.read[tested]):
        return None
    basis = solution.basis * solution.spectrum.scale[:, None]
    normal = np.zeros((folds, basis.shape[1], basis.shape[1]))
    right = np.zeros((folds, basis.shape[1]))
    for piece in network.chunks(solution.theta, solution.setup):
        along = piece.jacobian @ basis
        for k in np.unique(fold[piece.rows]).tolist():
            rows = (fold[piece.rows] == k) & used[piece.rows]
            flat = along[rows].reshape(-1, basis.shape[1])
            normal[k] += flat.T @ flat
            right[k] += flat.T @ piece.residual[rows].reshape(-1)
    # What the rest does not determine falls back to its prior; at the estimate the prior's pull is in balance only where it acts.
    free = (solution.stiffness <= solution.spectrum.values**2).astype(float)
    pull = free * (solution.basis.T @ solution.deviation)
    steps = np.stack(
        [
            basis @ np.linalg.solve(np.diag(solution.stiffness + free) - own, -of_fold - pull)
            for own, of_fold in zip(normal, right, strict=True)
        ]
    )
    square = 0.0
    for piece in network.chunks(solution.theta, solution.setup):
        safe = network.whitening[piece.rows] + np.eye(3) * ~network.read[piece.rows][:, None, :]
        off = piece.residual - np.einsum("nki,ni->nk", piece.jacobian, steps[fold[piece.rows]])
        off = np.linalg.solve(safe, off[:, :, None])[:, :, 0]
        square += float(np.sum(off[tested[piece.rows]] ** 2))
    readings = int(np.count_nonzero(network.read[tested]))
    return HeldOutResiduals(float(np.sqrt(square / readings)) * 1e6, folds, len(poses), readings)


def _determined_by_others(names: np.ndarray, fold: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Return (n,) whether a station or target is in another fold too."""
    found = np.zeros(len(names), dtype=bool)
    for name in dict.fromkeys(names.tolist()):
        own = names == name
        folds = np.unique(fold[own & used])
        found |= own & (np.isin(fold, folds[:1], invert=True) if len(folds) == 1 else len(folds) > 1)
    return found
