"""Readings too far off to be chance, where the model itself may be what is far off.

A row is judged by its residual against the covariance that is stated for it. Where the readings of its target from its station miss by
more than that, the model's misfit is added: an isotropic standard deviation in space, one for each target and station, that makes the
median of the squared distances the median of chi². So a target whose model is wrong, or a robot that is not calibrated yet, has a
misfit and not thousands of outliers. A misfit is a smooth function of the positions and no normal noise, so its limit is wider
(`TAIL`). Its robust weights are those of a convex loss (Huber 1964): a loss that lets far rows go (Geman and McClure 1985) would let
the estimate settle on some of the readings and call the others outliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import chi2_isf
from twin._common.units import MM
from twin.identification.network import Network
from twin.identification.spread import repeats
from twin.measurement.checks import RowNote

FALSE_ALARM: Final = 0.01
"""Chance that a data set without any outlier has a point called one."""
TAIL: Final = 1.5
"""Times that limit where all of the spread is the model's misfit."""
GROUP: Final = 30
"""Rows of one target from one station from which a misfit of their own is known; smaller groups have one together."""
HUBER: Final = 2.0
"""Distance, in standard deviations of a coordinate, from which a row of a model that is far off pulls no harder."""
FITS: Final = 1.1
"""Size of the whitened residuals up to which the model is taken to fit: what chance makes of some hundred readings."""
OUTLIER: Final = "outlier, not used"
MANY: Final = 0.02
"""Share of the rows beyond which outliers are a sign that the model is wrong."""


@final
@dataclass(frozen=True)
class JudgedRows:
    """Rows judged by their residuals.

    Attributes:
        bad: (n,) too far off to be chance.
        weight: (n,) robust weights: one for a good point.
        noise: size of the whitened residuals of most rows, root of the mean over the groups of their squares; one where the model fits.
        misfit_um: by target and station, standard deviation of the model's misfit a coordinate; only where it is not zero.
    """

    bad: np.ndarray
    weight: np.ndarray
    noise: float
    misfit_um: dict[tuple[str, str], float]


def outliers(network: Network, whitened: np.ndarray) -> np.ndarray:
    """(n,) points too far off to be chance: `judged`."""
    return judged(network, whitened).bad


def judged(network: Network, whitened: np.ndarray) -> JudgedRows:
    """Judge all rows by the residuals of an estimate.

    Args:
        network: data and model.
        whitened: (n, 3) residuals of a robust estimate, over the standard deviations that are stated.
    """
    count = np.count_nonzero(network.read, axis=1)
    median = np.array([chi2_isf(0.5, k) if k else 1.0 for k in range(4)])[count]
    # In the eigenvectors of W Wᵀ an isotropic misfit of size t adds t²·λ to a variance of one.
    values, vectors = np.linalg.eigh(network.whitening @ network.whitening.transpose(0, 2, 1))
    squares = np.einsum("nij,ni->nj", vectors, whitened) ** 2
    groups, names = _groups(network)
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
    whole = float(np.sqrt(np.mean(noise)))
    return JudgedRows(
        bad=locked(distance > limit * (1.0 + (TAIL**2 - 1.0) * share)),
        weight=locked((1.0 - share) * redescending + share * convex),
        noise=whole if whole > FITS else 1.0,
        misfit_um=misfit,
    )


def _groups(network: Network) -> tuple[np.ndarray, list[list[tuple[str, str]]]]:
    """(n,) group of each row, and the targets and stations in each: one of each with rows enough, one of all others."""
    keys = list(zip(network.data.target.tolist(), network.data.station.tolist(), strict=True))
    count: dict[tuple[str, str], int] = {}
    for key in keys:
        count[key] = count.get(key, 0) + 1
    large = [key for key, number in count.items() if number >= GROUP]
    place = {key: k for k, key in enumerate(large)}
    small = [key for key in count if key not in place]
    return np.array([place.get(key, len(large)) for key in keys]), [[key] for key in large] + [small]


def _misfit(squares: np.ndarray, values: np.ndarray, median: np.ndarray) -> float:
    """The size of an isotropic misfit, metres, that makes the median of squared distances what chance makes it; zero if none does.

    Args:
        squares: (k, 3) of the whitened residuals along the eigenvectors.
        values: (k, 3) what a misfit of one metre adds to the variance along each.
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


def explained(network: Network, difference: np.ndarray, whitened: np.ndarray, bad: np.ndarray) -> tuple[RowNote, ...]:
    """Each outlier in words: how far, in which direction, and what the repeats of the same point say."""
    data = network.data
    group = repeats(data)
    notes = []
    for row in np.flatnonzero(bad):
        off = difference[row]
        size = float(np.linalg.norm(off)) / MM
        sigmas = float(np.linalg.norm(whitened[row]))
        mates = np.flatnonzero((group == group[row]) & ~bad)
        text = (
            f"target {data.target[row]}, round {data.round[row]}, station {data.station[row]}: {size * 1e3:.1f} µm off"
        )
        if not network.instrument.lengths_only and size > 0.0:
            beam = network.readings[row] / np.linalg.norm(network.readings[row])
            along = float(off @ beam) / MM
            text += f", {abs(along) * 1e3:.1f} of it along the beam"
        text += f" ({sigmas:.1f} standard deviations)"
        if len(mates):
            others = float(np.median(np.linalg.norm(difference[mates], axis=1))) / MM
            text += f"; its {len(mates)} repeats are {others * 1e3:.1f} µm off"
        notes.append(RowNote(int(data.lines[row]), f"outlier, not used: {text}", OUTLIER, sigmas))
    return tuple(notes)


def model_is_wrong(rows: JudgedRows) -> tuple[str, ...]:
    """Return a sentence for the reader where so many rows are outliers that the model is what is wrong, and not the readings."""
    share = float(np.mean(rows.bad)) if len(rows.bad) else 0.0
    if share <= MANY:
        return ()
    text = (
        f"{int(np.sum(rows.bad)):,} of {len(rows.bad):,} rows ({100.0 * share:.1f} %) are outliers of this model. "
        "So many are rarely bad readings: suspect the model (`twin diagnose`)"
    )
    far = max(rows.misfit_um, key=lambda key: rows.misfit_um[key], default=None)
    if far is None:
        return (text,)
    target, station = far
    return (
        f"{text}. The other rows of target {target} from station {station} miss by {rows.misfit_um[far]:.3g} µm a coordinate",
    )
