"""Outliers: readings with residuals too large for chance, for a model that may itself be wrong.

A row is assessed by its residual and its stated covariance. If the residuals of its target from its station are larger than that, the
misfit of the model is added: an isotropic standard deviation in space, one for each target and station, that makes the median of the
squared distances equal to the median of chi². So a target with a wrong model, or a robot that is not calibrated yet, has a misfit and
not thousands of outliers. A misfit is a smooth function of the positions, not normal noise, and may be largest at the ends of a range:
its limit is wider (`TAIL`), and an outlier is separated from the other rows by a gap (`GAP`). Its robust weights are those of a convex
loss (Huber 1964): with a redescending loss (Geman and McClure 1985) the estimate could fit some of the readings and treat the others as
outliers.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.counts import count_with_noun
from twin._common.distributions import chi2_isf
from twin._common.units import MM
from twin.identification.network import Network
from twin.measurement.checks import RowNote
from twin.measurement.state import repeat_groups

FALSE_ALARM: Final = 0.01
"""Probability that a data set without any outlier has a point classified as one."""
TAIL: Final = 1.5
"""Factor on that limit if all of the deviation is the model's misfit."""
GAP: Final = 2.0
"""Ratio of the distance of an outlier to that of the next row below, if most of the deviation is the model's misfit."""
MISFIT_SHARE: Final = 0.5
"""Share of the misfit in the variance above which a row's deviation is mostly the model's."""
GROUP_ROWS: Final = 30
"""Number of rows of one target from one station, or of one station, from which on it has its own misfit; smaller groups share one."""
HUBER: Final = 2.0
"""Distance, in standard deviations of a coordinate, above which a row's influence no longer increases if the model has a misfit."""
NOISE_OF_FIT: Final = 1.1
"""Size of the whitened residuals up to which the model is taken to fit, in view of their random variation for some hundred readings."""
OUTLIER: Final = "outlier, not used"
MANY_OUTLIERS: Final = 0.02
"""Share of the rows above which outliers indicate that the model is wrong."""


@final
@dataclass(frozen=True)
class RowAssessment:
    """Assessment of the rows by their residuals.

    Attributes:
        bad: (n,) outliers.
        beyond: (n,) rows beyond the limit: outliers, and rows that no gap separates from the others of a misfitting model.
        weight: (n,) robust weights: one for a good point.
        noise: size of the whitened residuals of most rows, root of the mean over the groups of their squares; one if the model fits.
        size_m: (n,) standard deviation of the misfit per coordinate; zero if the model fits.
        misfit_um: by target and station, standard deviation of the model's misfit per coordinate; only if it is not zero.
    """

    bad: np.ndarray
    beyond: np.ndarray
    weight: np.ndarray
    noise: float
    size_m: np.ndarray
    misfit_um: dict[tuple[str, str], float]


def outliers(network: Network, whitened: np.ndarray) -> np.ndarray:
    """Return (n,) which points are outliers, as `assess_rows`."""
    return assess_rows(network, whitened).bad


def assess_rows(network: Network, whitened: np.ndarray) -> RowAssessment:
    """Assess all rows by the residuals of an estimate.

    Args:
        network: data and model.
        whitened: (n, 3) residuals of a robust estimate divided by the stated standard deviations.
    """
    count = np.count_nonzero(network.read, axis=1)
    median = np.array([chi2_isf(0.5, k) if k else 1.0 for k in range(4)])[count]
    # In the eigenvectors of W Wᵀ an isotropic misfit of size t adds t²·λ to a variance of one.
    values, vectors = np.linalg.eigh(network.whitening @ network.whitening.transpose(0, 2, 1))
    squares = np.einsum("nij,ni->nj", vectors, whitened) ** 2
    groups, names = row_groups(network)
    size = np.zeros(len(count))
    noise = np.ones(len(count))
    misfit: dict[tuple[str, str], float] = {}
    for k, members in enumerate(names):
        of = (groups == k) & (count > 0)
        if not np.any(of):
            continue
        size[of] = _misfit(squares[of], values[of], median[of])
        noise[of] = np.median(np.sum(squares[of], axis=1) / median[of])
        misfit |= {name: float(size[of][0]) * 1e6 for name in members if size[of][0] > 0.0}
    spread = 1.0 + size[:, None] ** 2 * values
    distance = np.sum(squares / spread, axis=1)
    share = np.sum(np.where(values > 0.0, 1.0 - 1.0 / spread, 0.0), axis=1) / np.maximum(count, 1)
    limit = np.array([chi2_isf(FALSE_ALARM / len(count), k) if k else np.inf for k in range(4)])[count]
    each = distance / np.maximum(count, 1)
    redescending, convex = (1.0 + each / 9.0) ** -2, np.minimum(1.0, HUBER / np.sqrt(np.maximum(each, 1e-12)))
    overall = float(np.sqrt(np.mean(noise)))
    beyond = distance > limit * (1.0 + (TAIL**2 - 1.0) * share)
    return RowAssessment(
        bad=read_only(beyond & (_separated(distance, beyond) | (share < MISFIT_SHARE))),
        beyond=read_only(beyond),
        weight=read_only((1.0 - share) * redescending + share * convex),
        noise=overall if overall > NOISE_OF_FIT else 1.0,
        size_m=read_only(size if overall > NOISE_OF_FIT else np.zeros_like(size)),
        misfit_um=misfit,
    )


def _separated(squares: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """Return (n,) which rows are above the lowest gap between a bad row and the row below it, by their squared distances."""
    order = np.argsort(squares)
    wide = bad[order[1:]] & (squares[order[1:]] >= GAP**2 * squares[order[:-1]])
    found = np.zeros(len(squares), dtype=bool)
    if np.any(wide):
        found[order[1 + int(np.argmax(wide)) :]] = True
    return found


def row_groups(network: Network) -> tuple[np.ndarray, list[list[tuple[str, str]]]]:
    """Return (n,) the group of each row, and its targets and stations.

    A pair of target and station with enough rows is a group; the other rows of a station are one, if they are enough, and all that then
    remain are one.
    """
    keys = list(zip(network.data.target.tolist(), network.data.station.tolist(), strict=True))
    count = Counter(keys)
    small = Counter(station for target, station in keys if count[target, station] < GROUP_ROWS)

    def group_of(key: tuple[str, str]) -> tuple[str, ...]:
        if count[key] >= GROUP_ROWS:
            return key
        return (key[1],) if small[key[1]] >= GROUP_ROWS else ()

    members: dict[tuple[str, ...], list[tuple[str, str]]] = {}
    for key in count:
        members.setdefault(group_of(key), []).append(key)
    place = {key: k for k, own in enumerate(members.values()) for key in own}
    return np.array([place[key] for key in keys]), list(members.values())


def _misfit(squares: np.ndarray, values: np.ndarray, median: np.ndarray) -> float:
    """Return the isotropic misfit, metres, that makes the median of squared distances equal to that of chi²; zero if none is needed.

    Args:
        squares: (k, 3) squared whitened residuals along the eigenvectors.
        values: (k, 3) increase of the variance along each by a misfit of one metre.
        median: (k,) of chi².
    """

    def excess(size: float) -> float:
        return float(np.median(np.sum(squares / (1.0 + size**2 * values), axis=1) / median)) - 1.0

    if excess(0.0) <= 0.0:
        return 0.0
    low, high = -9.0, 1.0
    for _ in range(40):
        middle = (low + high) / 2.0
        low, high = (middle, high) if excess(10.0**middle) > 0.0 else (low, middle)
    return float(10.0**high)


def outlier_notes(
    network: Network, difference: np.ndarray, whitened: np.ndarray, bad: np.ndarray
) -> tuple[RowNote, ...]:
    """Return a note for each outlier: its size and direction, and the residuals of repeats of the same point."""
    data = network.data
    group = repeat_groups(data)
    notes = []
    for row in np.flatnonzero(bad):
        off = difference[row]
        size = float(np.linalg.norm(off)) / MM
        sigmas = float(np.linalg.norm(whitened[row]))
        repeats_of_row = np.flatnonzero((group == group[row]) & ~bad)
        text = f"target {data.target[row]}, round {data.round[row]}, station {data.station[row]}: residual {size * 1e3:.1f} µm"
        if (
            network.instruments.by_station[data.station[row]].specification.beam
            and np.isfinite(data.point_mm[row]).all()
            and size > 0.0
        ):
            beam = network.readings[row] / np.linalg.norm(network.readings[row])
            along = float(off @ beam) / MM
            text += f", {abs(along) * 1e3:.1f} µm of it along the beam"
        text += f" ({sigmas:.1f} standard deviations)"
        if len(repeats_of_row):
            others = float(np.median(np.linalg.norm(difference[repeats_of_row], axis=1))) / MM
            text += f"; median residual of its {count_with_noun(len(repeats_of_row), 'repeat')}: {others * 1e3:.1f} µm"
        notes.append(RowNote(int(data.lines[row]), f"outlier, not used: {text}", OUTLIER, sigmas))
    return tuple(notes)


def many_outliers_notice(rows: RowAssessment) -> tuple[str, ...]:
    """Return a notice if the share of outliers indicates that the model is wrong, not the readings."""
    share = float(np.mean(rows.bad)) if len(rows.bad) else 0.0
    if share <= MANY_OUTLIERS:
        return ()
    text = (
        f"{int(np.sum(rows.bad)):,} of {len(rows.bad):,} rows ({100.0 * share:.1f} %) are outliers: probably the model is incomplete, "
        "not the readings wrong. Run `twin diagnose`"
    )
    largest = max(rows.misfit_um, key=lambda key: rows.misfit_um[key], default=None)
    if largest is None:
        return (text,)
    target, station = largest
    return (
        f"{text}. Misfit of the other rows of target {target} from station {station}: {rows.misfit_um[largest]:.3g} µm per coordinate",
    )
