"""Residuals and repeats compared with the noise that is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_isf, chi2_sf, f_sf
from twin._common.units import MM
from twin.identification.start import nominal_carriers
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument, StationInstruments
from twin.measurement.state import FEWEST_REPEATS, at_origin, repeat_groups
from twin.measurement.table import Measurements

SIGNIFICANCE: Final = 1e-3
"""Level at which repeats contradict the stated noise."""
FALSE_ALARM: Final = 0.01
"""Probability that repeats without any outlier contain a reading that is left out."""
ITERATIONS: Final = 6
"""Repetitions of the search for outliers among the repeats, at most."""
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


@final
@dataclass(frozen=True, eq=False)
class Repeats:
    """Repeated readings of one instrument, without outliers.

    Attributes:
        instrument: the instrument.
        rows: (k,) its rows in the data.
        covariance: (k, 3, 3) of all its readings, from the repeats, m²: the instrument's model, pooled.
        dof: degrees of freedom of one coordinate.
        reduced_chi2: mean square of the repeats in units of the stated covariance.
        p_value: probability of one at least as large if the stated covariance holds.
    """

    instrument: Instrument
    rows: np.ndarray
    covariance: np.ndarray
    dof: int
    reduced_chi2: float
    p_value: float

    @property
    def decide(self) -> bool:
        """Whether the repeats are enough to test the stated covariance."""
        return self.dof >= FEWEST_REPEATS

    @property
    def contradict(self) -> bool:
        """Whether the repeats vary more than the stated covariance allows."""
        return self.decide and self.p_value < SIGNIFICANCE


def noise_text(instrument: Instrument, readings: np.ndarray, covariance: np.ndarray) -> str:
    """Return the median standard deviations of an instrument's readings in words.

    Args:
        instrument: the instrument.
        readings: (k, 3) metres; NaN where nothing was read.
        covariance: (k, 3, 3) of them, m².
    """
    read = np.isfinite(readings)
    variance = np.where(read, np.einsum("nii->ni", covariance), 0.0)
    if instrument.specification.beam and read.all():
        beam = readings / np.linalg.norm(readings, axis=1, keepdims=True)
        along = np.einsum("ni,nij,nj->n", beam, covariance, beam)
        across = (variance.sum(axis=1) - along) / 2.0
        sizes = [f"{1e6 * np.sqrt(np.median(own)):.2g} µm" for own in (along, across)]
        return f"{sizes[0]} along the beam, {sizes[1]} across"
    each = variance.sum(axis=1)[read.any(axis=1)] / np.count_nonzero(read[read.any(axis=1)], axis=1)
    return f"{1e6 * np.sqrt(np.median(each)):.2g} µm"


def repeats_of(
    machine: Machine, data: Measurements, instruments: StationInstruments, stated: np.ndarray
) -> tuple[Repeats, ...]:
    """Return the repeats of each instrument that has any.

    Args:
        machine: the machine.
        data: the measurements.
        instruments: those of their stations.
        stated: (n, 3, 3) stated covariance of the readings, m².
    """
    points = np.where(np.isfinite(data.point_mm), data.point_mm, 0.0) * MM
    # A probe reads zero: its repeats differ in the axis positions.
    points = np.where(at_origin(data)[:, None], nominal_carriers(machine, data).points, points)
    every, read = repeat_groups(data), np.isfinite(data.point_mm)
    found = []
    for instrument, rows in instruments.groups(data.station):
        group, own = every[rows], points[rows]
        kept = np.ones(len(rows), dtype=bool)
        for _ in range(ITERATIONS):
            size = np.bincount(group[kept], minlength=group.max() + 1)
            again = kept & (size[group] > 1)
            dof = int(np.sum(np.maximum(size - 1, 0)))
            if dof == 0:
                break
            total = np.stack([np.bincount(group[kept], own[kept, i], minlength=len(size)) for i in range(3)], axis=1)
            deviations = np.where(again[:, None], own - (total / np.maximum(size, 1)[:, None])[group], 0.0)
            pooled = instrument.pooled(own, deviations, dof)
            each = deviations / np.sqrt(1.0 - 1.0 / np.maximum(size, 2))[group, None]
            square, count = _squares(pooled, each, read[rows]), np.count_nonzero(read[rows], axis=1)
            if not np.any(square[again] > 0.0):
                break
            median = np.array([chi2_isf(0.5, k) if k else 1.0 for k in range(4)])[count]
            limit = np.array([chi2_isf(FALSE_ALARM / len(rows), k) if k else np.inf for k in range(4)])[count]
            wrong = again & (square > limit * float(np.median(square[again] / median[again])))
            if not np.any(wrong):
                break
            kept &= ~wrong
        if dof > 0:
            chi2 = float(np.sum(_squares(stated[rows], deviations, read[rows])))
            free = dof * int(np.count_nonzero(read[rows].any(axis=0)))
            found.append(Repeats(instrument, rows, pooled, dof, chi2 / free, float(chi2_sf(chi2, free))))
    return tuple(found)


def _squares(covariance: np.ndarray, deviations: np.ndarray, read: np.ndarray) -> np.ndarray:
    """Return (k,) squared deviations in units of their covariance, over the coordinates that were read."""
    both = read[:, :, None] & read[:, None, :]
    safe = np.where(both, covariance, 0.0) + np.eye(3) * ~read[:, None, :]
    if not np.all(np.linalg.eigvalsh(safe)[:, 0] > 0.0):
        return np.zeros(len(read))
    kept = np.where(read, deviations, 0.0)
    return np.asarray(np.einsum("ni,ni->n", kept, np.linalg.solve(safe, kept[:, :, None])[:, :, 0]))


def covariance_from_repeats(
    data: Measurements, instruments: StationInstruments, repeats: Sequence[Repeats]
) -> np.ndarray:
    """Return (n, 3, 3) the covariance of the readings from repeats, m²: each instrument's model, pooled over all its points.

    Args:
        data: the measurements.
        instruments: those of their stations.
        repeats: their repeats.

    Raises:
        InputError: fewer than ten degrees of freedom of repeats of an instrument.
    """
    found = np.zeros((len(data), 3, 3))
    by_instrument = {id(one.instrument): one for one in repeats}
    for instrument, rows in instruments.groups(data.station):
        own = by_instrument.get(id(instrument))
        if own is None or own.dof < FEWEST_REPEATS:
            raise data.error(
                f"too few repeats to estimate the noise of the {instrument.name}",
                expected="at least ten repeated readings",
                value=0 if own is None else own.dof,
            )
        found[rows] = own.covariance
    return read_only(found)
