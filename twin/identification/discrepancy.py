"""Discrepancy: what a model leaves of the readings beyond their noise, as a variance for each target, station and direction.

A tracker is 25 times better along its beam than across. If the model is wrong by more than the noise, weights from the noise alone
fit the error along the beam at the expense of the others. So the covariance that weights the readings is that of the noise and of the
discrepancy, whose variances are estimated by restricted maximum likelihood (Patterson and Thompson 1971; in geodesy, variance
components after Helmert and Förstner): for each component the sum of squared residuals is compared with its expectation, the sum of the
redundancies. A component that its score test does not confirm is zero, so that a model that fits has the weights of its noise.

Tests of consistency do not use it: they compare the residuals with the noise.

H. D. Patterson, R. Thompson: Recovery of inter-block information when block sizes are unequal, Biometrika 58 (1971) 545-554.
W. Förstner: Ein Verfahren zur Schätzung von Varianz- und Kovarianzkomponenten, AVN 86 (1979) 446-453.

Outliers: readings with residuals too large for chance, for a model that may itself be wrong.

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
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_isf, chi2_sf
from twin._common.messages import Message
from twin._common.units import MM
from twin.identification.network import Network
from twin.identification.solve import FitSolution, Spread
from twin.measurement.columns import RowNote
from twin.measurement.observation import repeat_groups
from twin.measurement.table import Measurements

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
OUTLIER: Final = Message("outlier, not used")
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

    ``whitened``: (n, 3) residuals of a robust estimate divided by the stated standard deviations.
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
    separated = np.zeros(len(squares), dtype=bool)
    if np.any(wide):
        separated[order[1 + int(np.argmax(wide)) :]] = True
    return separated


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

    ``squares``: (k, 3) squared whitened residuals along the eigenvectors; ``values``: (k, 3) increase of the variance along each by a
    misfit of one metre; ``median``: (k,) of chi².
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
        text = Message(
            "target {target}, round {round}, station {station}: residual {size:.1f} µm",
            target=data.target[row],
            round=data.round[row],
            station=data.station[row],
            size=size * 1000.0,
        )
        if (
            network.instruments.by_station[data.station[row]].specification.beam
            and np.isfinite(data.point_mm[row]).all()
            and size > 0.0
        ):
            beam = network.readings[row] / np.linalg.norm(network.readings[row])
            along = float(off @ beam) / MM
            text += Message(", {size:.1f} µm of it along the beam", size=abs(along) * 1000.0)
        text += Message(" ({sigmas:.1f} standard deviations)", sigmas=sigmas)
        if len(repeats_of_row):
            others = float(np.median(np.linalg.norm(difference[repeats_of_row], axis=1))) / MM
            text += Message(
                "; median residual of its repeats ({count}): {size:.1f} µm",
                count=len(repeats_of_row),
                size=others * 1000.0,
            )
        notes.append(RowNote(int(data.lines[row]), Message("outlier, not used: {text}", text=text), OUTLIER, sigmas))
    return tuple(notes)


def many_outliers_notice(rows: RowAssessment) -> tuple[Message, ...]:
    """Return a notice if the share of outliers indicates that the model is wrong, not the readings."""
    share = float(np.mean(rows.bad)) if len(rows.bad) else 0.0
    if share <= MANY_OUTLIERS:
        return ()
    text = Message(
        "{bad:,} of {count:,} rows ({share:.1f} %) are outliers: probably the model is incomplete, not the "
        "readings wrong. Run `twin diagnose`",
        bad=int(np.sum(rows.bad)),
        count=len(rows.bad),
        share=100.0 * share,
    )
    largest = max(rows.misfit_um, key=lambda key: rows.misfit_um[key], default=None)
    if largest is None:
        return (text,)
    target, station = largest
    return (
        Message(
            "{text}. Misfit of the other rows of target {target} from station {station}: {misfit:.3g} µm per coordinate",
            text=text,
            target=target,
            station=station,
            misfit=rows.misfit_um[largest],
        ),
    )


# --- Discrepancy: what a model leaves of the readings beyond their noise, as a variance for each target, station and directio

SIGNIFICANCE: Final = 1e-3
"""Level of the score tests of all components together: models that fit get a discrepancy once in a thousand data sets."""
LEAST_REDUNDANCY: Final = 5.0
"""Redundancy of a component below which its variance cannot be estimated; its residuals are mostly fitted away."""
SCORING_STEPS: Final = 60
TOLERANCE: Final = 1e-3
SETTLED: Final = 0.05
"""Relative change of a reading's variance, noise included, up to which the weights need no further estimate."""
GROUPS_AT_ONCE: Final = 256
"""Number of repeated points in a chunk of the covariance."""


@final
@dataclass(frozen=True)
class DiscrepancyPart:
    """The discrepancy of one direction of some targets and stations.

    Attributes:
        of: (target, station) pairs.
        direction: ``along the beam``, ``across the beam``, or ``per coordinate``.
        size_um: standard deviation of one coordinate in this direction.
        redundancy: number of readings less what the model takes up of them.
    """

    of: tuple[tuple[str, str], ...]
    direction: str
    size_um: float
    redundancy: float


@final
@dataclass(frozen=True)
class Discrepancy:
    """The discrepancy of a model.

    ``parts``: the components that are not zero; ``root``: (n, 3, 3) symmetric square root of each reading's covariance by it, metres;
    zero where nothing was read.
    """

    parts: tuple[DiscrepancyPart, ...]
    root: np.ndarray

    def to_dict(self) -> list[dict[str, Any]]:
        """Return the components as JSON data."""
        return [
            {
                "of": [{"target": target, "station": station} for target, station in part.of],
                "direction": part.direction,
                "size_um": part.size_um,
                "redundancy": part.redundancy,
            }
            for part in self.parts
        ]

    @property
    def text(self) -> str:
        """Return the sizes by direction, in words; empty if there is none."""
        sizes: dict[str, list[float]] = {}
        for part in self.parts:
            sizes.setdefault(part.direction, []).append(part.size_um)
        return ", ".join(
            f"{min(own):.3g} µm {direction}" if len(own) == 1 else f"{min(own):.3g} to {max(own):.3g} µm {direction}"
            for direction, own in sizes.items()
        )


def isotropic(network: Network, size_m: np.ndarray) -> Discrepancy:
    """Return the same discrepancy in all directions, (n,) standard deviations per coordinate, metres; it has no named parts."""
    return Discrepancy((), read_only(size_m[:, None, None] * np.eye(3) * network.read[:, None, :]))


def no_discrepancy(network: Network) -> Discrepancy:
    """Return the discrepancy of a model that fits."""
    return Discrepancy((), read_only(np.zeros((len(network.data), 3, 3))))


@final
@dataclass(frozen=True)
class _Group:
    """Rows that share their variances: one for each direction.

    ``of``: their (target, station) pairs; ``rows``: (k,) their numbers; ``projections``: (directions, k, 3, 3) projection of a reading
    on each.
    """

    of: tuple[tuple[str, str], ...]
    rows: np.ndarray
    directions: tuple[str, ...]
    projections: np.ndarray


def _groups(network: Network) -> Iterator[_Group]:
    """Yield the groups: along and across the beam of an instrument that has one and reads points, else all coordinates alike."""
    numbers, names = row_groups(network)
    read = network.read
    for instrument, of_instrument in network.instruments.groups(network.data.station):
        for k in np.unique(numbers[of_instrument]).tolist():
            rows = of_instrument[(numbers[of_instrument] == k) & read[of_instrument].any(axis=1)]
            if not len(rows):
                continue
            pairs = tuple(name for name in names[k] if network.instruments.by_station[name[1]] is instrument)
            every = np.eye(3) * read[rows][:, None, :]
            if not (instrument.specification.beam and read[rows].all()):
                yield _Group(pairs, rows, ("per coordinate",), every[None])
                continue
            beam = network.readings[rows] / np.linalg.norm(network.readings[rows], axis=1, keepdims=True)
            along = beam[:, :, None] * beam[:, None, :]
            yield _Group(pairs, rows, ("along the beam", "across the beam"), np.stack([along, every - along]))


def updated(
    network: Network, discrepancy: Discrepancy, residual: np.ndarray, taken_up: np.ndarray, used: np.ndarray
) -> Discrepancy:
    """Return the discrepancy that the residuals of an estimate show.

    ``network``: data and model, with their noise alone; ``discrepancy``: the discrepancy with which the estimate was weighted;
    ``residual``: (n, 3) residuals of the estimate, metres; zero where nothing was read; ``taken_up``: (n, 3, 3) covariance that the
    estimate takes up of each reading, m²; ``used``: (n,) the points that were used.
    """
    weighted = network.with_discrepancy(discrepancy.root)
    every = list(_groups(network))
    level = SIGNIFICANCE / max(sum(len(group.directions) for group in every), 1)
    parts: list[DiscrepancyPart] = []
    root = np.zeros((len(used), 3, 3))
    for group in every:
        kept = used[group.rows]
        rows, projections = group.rows[kept], group.projections[:, kept]
        if not len(rows):
            continue
        unread = np.eye(3) * ~network.read[rows][:, None, :]
        scores = _Scores.of(
            network.covariance[rows] + unread,
            projections,
            residual[rows],
            taken_up[rows],
            weighted.covariance[rows] + unread,
        )
        count = np.einsum("knii->k", projections)
        redundancy = scores.share * count
        before = np.einsum("nij,knji->k", discrepancy.root[rows], projections) / count
        variance = scores.most_likely(before**2)
        for k in range(len(variance)):
            if redundancy[k] < LEAST_REDUNDANCY or scores.p_value(variance, k) > level:
                variance[k] = 0.0
        for k in np.flatnonzero(variance).tolist():
            size = float(np.sqrt(variance[k]))
            root[group.rows] += size * group.projections[k]
            parts.append(DiscrepancyPart(group.of, group.directions[k], size * 1e6, float(redundancy[k])))
    return Discrepancy(tuple(parts), read_only(root))


def settled(network: Network, before: Discrepancy, after: Discrepancy) -> bool:
    """Return whether an estimate with the first discrepancy needs no other with the second."""
    if bool(before.parts) != bool(after.parts):
        return False
    total = [np.einsum("nii->n", network.with_discrepancy(one.root).covariance) for one in (before, after)]
    return float(np.max(np.abs(total[1] / total[0] - 1.0), initial=0.0)) <= SETTLED


def residuals_of_estimate(network: Network, solution: FitSolution) -> tuple[np.ndarray, np.ndarray]:
    """Return (n, 3) residuals, metres, and (n, 3, 3) the covariance that the estimate takes up of each reading, m²."""
    residual = np.zeros((len(network.data), 3))
    taken_up = np.zeros((len(network.data), 3, 3))
    root = solution.basis * solution.spectrum.scale[:, None] / np.sqrt(solution.stiffness)
    for piece in network.chunks(solution.theta, solution.setup):
        rows = piece.rows
        safe = network.whitening[rows] + np.eye(3) * ~network.read[rows][:, None, :]
        residual[rows] = np.linalg.solve(safe, piece.residual[:, :, None])[:, :, 0]
        taken = np.linalg.solve(safe, piece.jacobian @ root)
        taken_up[rows] = taken @ taken.transpose(0, 2, 1)
    return residual, taken_up


@final
@dataclass(frozen=True)
class _Scores:
    """Scores of the variances of one group in the restricted likelihood.

    Attributes:
        noise: (k, 3, 3) covariance of the readings, m²; one on the diagonal for coordinates that were not read.
        projections: (directions, k, 3, 3) projections on the directions.
        residual: (k, 3) metres.
        share: (directions,) redundancy: share of the weighted readings that the estimate does not take up.
    """

    noise: np.ndarray
    projections: np.ndarray
    residual: np.ndarray
    share: np.ndarray

    @classmethod
    def of(
        cls,
        noise: np.ndarray,
        projections: np.ndarray,
        residual: np.ndarray,
        taken_up: np.ndarray,
        weighted: np.ndarray,
    ) -> _Scores:
        """Return the scores at an estimate.

        ``taken_up``: (k, 3, 3) covariance that the estimate takes up of each reading, m²; ``weighted``: (k, 3, 3) covariance of the
        readings in the weights of the estimate, m².
        """
        weight = np.linalg.inv(weighted)
        both = projections @ weight
        taken = np.einsum("knij,nji->k", weight @ both, taken_up) / np.einsum("knii->k", both)
        return cls(noise, projections, residual, np.clip(1.0 - taken, 0.0, 1.0))

    def most_likely(self, variance: np.ndarray) -> np.ndarray:
        """Return the variances (directions,), m², by Fisher scoring from an initial value; none is negative."""
        variance = np.array(variance)
        for _ in range(SCORING_STEPS):
            before = variance.copy()
            for k in range(len(variance)):
                square, expected, information = self._score(variance, k)
                if information > 0.0:
                    variance[k] = max(0.0, variance[k] + (square - expected) / information)
            if np.all(np.abs(variance - before) <= TOLERANCE * variance):
                break
        return variance

    def p_value(self, variance: np.ndarray, k: int) -> float:
        """Return the p-value of the residuals if one of the variances were zero (score test; Satterthwaite's degrees of freedom)."""
        square, expected, information = self._score(np.where(np.arange(len(variance)) == k, 0.0, variance), k)
        if information <= 0.0:
            return 1.0
        return float(chi2_sf(square * expected / information, expected**2 / information))

    def _score(self, variance: np.ndarray, k: int) -> tuple[float, float, float]:
        """Return the sum of squares rᵀWPWr, its expectation, and the derivative of the expectation by the variance."""
        weight = np.linalg.inv(self.noise + np.einsum("k,knij->nij", variance, self.projections))
        both = self.projections[k] @ weight
        along = np.einsum("nij,nj->ni", both, self.residual)
        square = float(np.sum(along**2))
        expected = float(np.einsum("nii->", both)) * self.share[k]
        return square, expected, float(np.einsum("nij,nji->", both, both)) * self.share[k]


def _shared_score(network: Network, discrepancy: Discrepancy, solution: FitSolution, weight: np.ndarray) -> np.ndarray:
    """Return the (p, p) covariance of the normal equations' right side, by noise and discrepancy.

    All readings of a pose share its discrepancy (one vector in the machine's frame), so that repeats and targets do not average it.

    ``network``: data and model with the weights of the estimate, discrepancy included; ``weight``: (n,) weight of each point; zero for
    one that was not used.
    """
    j = solution.triangle[:, :-1]
    shared_score = j.T @ j
    if not np.any(discrepancy.root):
        return shared_score
    group = _pose_of(network.data)
    rotation = solution.setup.rotation[[solution.setup.stations.index(name) for name in network.data.station]]
    size = np.bincount(group[weight > 0.0], minlength=group.max() + 1)
    order = np.argsort(group, kind="stable")
    order = order[(size[group[order]] > 1) & (weight[order] > 0.0)]
    starts = np.flatnonzero(np.diff(group[order], prepend=-1))
    for first in range(0, len(starts), GROUPS_AT_ONCE):
        some = starts[first : first + GROUPS_AT_ONCE]
        end = starts[first + GROUPS_AT_ONCE] if first + GROUPS_AT_ONCE < len(starts) else len(order)
        rows = order[some[0] : end]
        piece = network.chunk(solution.theta, solution.setup, rows)
        root = network.whitening[rows] @ discrepancy.root[rows] @ rotation[rows].transpose(0, 2, 1)
        each = np.einsum("nki,nkj->nji", piece.jacobian, root)
        summed = np.add.reduceat(each, some - some[0], axis=0).reshape(-1, each.shape[2])
        each = each.reshape(-1, each.shape[2])
        shared_score += summed.T @ summed - each.T @ each
    return np.asarray(shared_score)


LEAST_LEVER_M: Final = 1e-3
"""Standard uncertainty of a direction of the targets' places, m, from which its products with the machine's angles count."""
SMALL_TURN: Final = 0.1
"""Turn of a station, rad, above which a direction of places that comes with it is left out: the expansion does not hold."""


def covariance_of(
    network: Network, solution: FitSolution, weight: np.ndarray, spread: Spread, discrepancy: Discrepancy | None = None
) -> np.ndarray:
    """Return the (p, p) covariance of an estimate, of the machine's unknowns and the set-up's.

    By default that of the noise and of the discrepancy, which counts as random from point to point.
    ``between poses`` is for a model that lacks an influence which changes from pose to pose. It holds for independent poses that
    represent those of later use. If neighbouring poses were measured together, their misfits are correlated, and ``between rounds`` is
    valid: the points of a round share the influence (poses near one place, one warm-up).

    ``network``: data and model, with the weights of the estimate; ``weight``: (n,) weight of each point; zero for one that was not
    used; ``discrepancy``: the discrepancy in these weights; none if None.

    Raises `InputError`: fewer rounds than parameters determined.
    """
    data = network.data
    if spread == "between poses":
        group = _pose_of(data)
    elif spread == "between rounds":
        names, group = np.unique(data.round.astype(str), return_inverse=True)
        if len(names) <= len(solution.spectrum.singular_values):
            raise data.error(
                "too few rounds to estimate their variation",
                expected=f"more than the {len(solution.spectrum.singular_values)} parameters determined",
                value=len(names),
            )
    else:
        covariance = solution.covariance(
            None if discrepancy is None else _shared_score(network, discrepancy, solution, weight)
        )
        return covariance + _second_order(network, solution, weight, covariance)
    covariance = _sandwich(network, solution, weight, group.reshape(-1))
    return covariance + _second_order(network, solution, weight, covariance)


def _second_order(network: Network, solution: FitSolution, weight: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return (p, p) what the products of uncertain lever arms and uncertain angles add to a covariance.

    A place of the targets that only priors determine (0.2 m) turns the angles of an axis into translations of its reference point. The
    first order counts the estimated angles; where these are small, their own uncertainty, times the lever, is larger. Terms of second
    order (JCGM 100:2008, 5.1.2, note) of each such direction of the places with the machine's unknowns, the estimate following the
    changed derivatives.

    ``covariance``: (p, p) of first order.
    """
    machine = len(network.unknowns)
    places, turns = (
        [i for kind, _, at in solution.setup.slots if kind == wanted for i in range(at.start, at.stop)]
        for wanted in ("place", "turn")
    )
    of_setup = covariance[machine:, machine:]
    variance, directions = np.linalg.eigh(of_setup[np.ix_(places, places)])
    levers = []
    for size, direction in zip(np.sqrt(np.maximum(variance, 0.0)), directions.T, strict=True):
        if size > LEAST_LEVER_M:
            # The stations follow as they are correlated with the places.
            lever = of_setup[:, places] @ direction / size
            if np.abs(lever[turns]).max(initial=0.0) < SMALL_TURN:
                levers.append(lever)
    added = np.zeros_like(covariance)
    if not levers:
        return added
    root = solution.basis * solution.spectrum.scale[:, None] / np.sqrt(solution.stiffness)
    products = np.zeros((len(levers), len(covariance), machine))
    for rows in network.row_chunks:
        here = network.chunk(solution.theta, solution.setup, rows).jacobian
        weighted = (here * weight[rows, None, None]).reshape(-1, len(covariance)).T
        for product, lever in zip(products, levers, strict=True):
            moved = network.chunk(solution.theta, solution.setup.moved(lever), rows).jacobian
            product += weighted @ (moved - here)[:, :, :machine].reshape(-1, machine)
    for product in products:
        following = root @ (root.T @ product)
        added += following @ covariance[:machine, :machine] @ following.T
    return added


def _pose_of(data: Measurements) -> np.ndarray:
    """Return (n,) the number of each row's pose."""
    return np.asarray(np.unique(np.round(data.positions, 3), axis=0, return_inverse=True)[1].reshape(-1))


def _sandwich(network: Network, solution: FitSolution, weight: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Return A⁻¹ (Σ g gᵀ) A⁻¹ with one score g per group (Huber 1967; White 1982, eq. 3.2; clusters as Liang and Zeger 1986).

    It holds for any variation between groups, provided that the groups are many and represent those of later use.
    """
    scores = np.zeros((group.max() + 1, len(solution.spectrum.scale)))
    for piece in network.chunks(solution.theta, solution.setup):
        own = np.einsum("nki,nk,n->ni", piece.jacobian, piece.residual, weight[piece.rows])
        np.add.at(scores, group[piece.rows], own)
    count, certified = len(scores), network.certified(solution.setup)[:, :-1]
    return solution.covariance(scores.T @ scores * (count / max(count - 1, 1)) + certified.T @ certified)
