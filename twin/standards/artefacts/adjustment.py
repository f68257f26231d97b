"""Linear errors of a machine from readings with stated and repeated uncertainty: estimate, budget and coverage interval.

The readings are y = A θ + N n + e with the errors θ, free unknowns n (places, zero of a gauge) and e, the sum of the contributions of
a GUM budget (JCGM 100:2008). θ is the generalised least-squares estimate, which is linear in the readings: θ = G y. A contribution
with the effect v on the readings has the effect G v on θ, so that what is common to all readings cancels where it must. The
interval of 95 % is that of the propagated distributions (JCGM 101:2008): limits are rectangular, repeats have Student's distribution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_sf
from twin._common.messages import Message
from twin.display.numbers import COVERAGE

Shape = Literal["limit", "normal"]
DRAWS: Final = 40_000
SEED: Final = 98
"""A fixed seed gives the same interval for the same readings."""
STEPS: Final = 4
"""Gauss-Newton steps: each leaves the square of the angle, 1e-6 of a milliradian's effect."""
RANK: Final = 1e-9
PRIOR: Final = 0.01
"""Standard uncertainty of every error before the readings, mm per mm: an error that they do not show is in the budget with it."""
DETERMINED: Final = 0.3
"""Share of `PRIOR` below which the standard uncertainty of an error must be for it to count as determined."""
SMALLEST_MM: Final = 1e-6
"""Independent error that is added to every reading, so that weights exist if nothing is stated: a nanometre."""


@final
@dataclass(frozen=True, eq=False)
class BudgetLine:
    """One line of the budget.

    Attributes:
        name: what it is, in words.
        effects: (k, m) effect of k independent quantities, each at its limit or standard uncertainty, on the m readings, mm.
        shape: whether ``effects`` are limits (rectangular distribution) or standard uncertainties (normal distribution).
    """

    name: Message
    effects: np.ndarray
    shape: Shape = "limit"

    @property
    def standard(self) -> np.ndarray:
        """Effects (k, m) of one standard uncertainty."""
        return self.effects / np.sqrt(3.0) if self.shape == "limit" else self.effects

    def drawn(self, rng: np.random.Generator, gain: np.ndarray) -> np.ndarray:
        """Return random errors (draws, p) of the estimates."""
        effects = self.effects @ gain.T
        size = DRAWS, len(effects)
        unit = rng.uniform(-1.0, 1.0, size) if self.shape == "limit" else rng.standard_normal(size)
        return np.asarray(unit @ effects)


@final
@dataclass(frozen=True, eq=False)
class RepeatedReadings:
    """Noise of repeated readings: pooled standard deviation of one reading, its degrees of freedom, and readings per mean (m,)."""

    s_mm: float
    dof: int
    counts: np.ndarray

    @classmethod
    def of(cls, groups: Sequence[np.ndarray], assumed_mm: float) -> RepeatedReadings:
        """Return the noise of groups of readings; without a group of two, ``assumed_mm`` is taken as known."""
        counts = np.array([len(group) for group in groups])
        dof = int(np.sum(counts - 1))
        squares = sum(float(np.sum(np.square(group - group.mean()))) for group in groups)
        return cls(float(np.sqrt(squares / dof)) if dof else assumed_mm, dof, counts)

    @property
    def spread(self) -> np.ndarray:
        """Standard uncertainties (m,) of the means."""
        return np.asarray(self.s_mm / np.sqrt(self.counts))

    def rounding_mm(self, resolution_mm: float) -> float:
        """Return the limit of the rounding error of a mean: half the resolution if all repeats read the same.

        Rounding of readings that differ by more than the resolution is part of their noise (JCGM 100, F.2.2.1 and H.6).
        """
        inside = 12.0 * (self.s_mm / resolution_mm) ** 2 if self.dof and resolution_mm > 0.0 else 0.0
        return 0.5 * resolution_mm * float(np.sqrt(max(0.0, 1.0 - inside)))

    def drawn(self, rng: np.random.Generator, gain: np.ndarray) -> np.ndarray:
        """Return random errors (draws, p) of the estimates."""
        errors = (rng.standard_normal((DRAWS, len(self.counts))) * self.spread) @ gain.T
        return np.asarray(errors * np.sqrt(self.dof / rng.chisquare(self.dof, DRAWS))[:, None] if self.dof else errors)


Linearised = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Deviations (m,) of the readings from the model at given errors, and its derivatives by errors (m, p) and free unknowns (m, r)."""


@final
@dataclass(frozen=True, eq=False)
class Observed:
    """Readings of one sheet as equations in mm; errors are dimensionless (rad, mm per mm)."""

    at: Callable[[np.ndarray], Linearised]  # the model at given errors (p,)
    lines: tuple[int, ...]  # line of the sheet of every equation
    readings: np.ndarray  # (m,) what was read, mm, for messages
    contributions: tuple[BudgetLine, ...]
    repeats: RepeatedReadings


@final
@dataclass(frozen=True, eq=False)
class AdjustedErrors:
    """Errors with their budget.

    Attributes:
        values: (p,) estimates, NaN where the readings do not determine one.
        covariance: (p, p) of standard uncertainties.
        expanded: (p,) half widths of the 95 % intervals.
        budget: by contribution, the standard uncertainty (p,) that it causes.
        dof: degrees of freedom of the residuals.
        p_value: probability of residuals at least as large if the budget is right; NaN without degrees of freedom.
        residuals: (m,) mm.
        normalised: (m,) residuals divided by their standard uncertainty.
    """

    values: np.ndarray
    covariance: np.ndarray
    expanded: np.ndarray
    budget: dict[str, np.ndarray] = field(default_factory=dict)
    dof: int = 0
    p_value: float = float("nan")
    residuals: np.ndarray = field(default_factory=lambda: np.zeros(0))
    normalised: np.ndarray = field(default_factory=lambda: np.zeros(0))


def estimate(sheets: Sequence[Observed], count: int) -> AdjustedErrors:
    """Return the ``count`` errors that the readings of all sheets determine together."""
    measured = sum(len(sheet.lines) for sheet in sheets)
    sheets = [*sheets, _before(count)]
    sizes = [len(sheet.lines) for sheet in sheets]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    whole = int(starts[-1])
    spread = np.concatenate([sheet.repeats.spread for sheet in sheets])
    placed = [
        BudgetLine(one.name, _padded(one.effects, int(start), whole), one.shape)
        for sheet, start in zip(sheets, starts, strict=False)
        for one in sheet.contributions
    ]
    v = np.diag(np.square(spread) + SMALLEST_MM**2)
    for one in placed:
        v += one.standard.T @ one.standard
    root = np.linalg.cholesky(v)
    errors = np.zeros(count)
    for _ in range(STEPS):
        y, a, n = _stacked(sheets, errors, starts)
        y, a, n = (np.linalg.solve(root, part) for part in (y, a, n))
        free = _left_null(n)
        left, sizes_a, right = np.linalg.svd(free @ a, full_matrices=False)
        rank = int(np.sum(sizes_a > RANK * max(float(sizes_a.max(initial=0.0)), 1e-300)))
        gain = (right[:rank].T / sizes_a[:rank]) @ left[:, :rank].T @ free
        errors = errors + gain @ y
    y, a, n = _stacked(sheets, errors, starts)
    whitened = np.linalg.solve(root, y)
    rest = free @ whitened
    gain = gain @ np.linalg.inv(root)
    covariance = gain @ v @ gain.T
    unknown = np.sqrt(np.diag(covariance)) > DETERMINED * PRIOR
    dof = len(free) - count - int(np.sum(~unknown))
    residual_spread = np.sqrt(np.maximum(np.diag(_residual_cofactor(free, left[:, :rank])), 0.0))
    part = free.T @ rest
    residuals = root @ part
    normalised = np.divide(part, residual_spread, out=np.zeros(whole), where=residual_spread > 1e-6)
    rng = np.random.default_rng(SEED)
    total, budget = np.zeros((DRAWS, count)), dict[str, np.ndarray]()
    for one in placed:
        total += one.drawn(rng, gain)
        own = np.sum(np.square(one.standard @ gain.T), axis=0)
        budget[one.name] = np.sqrt(np.square(budget.get(one.name, np.zeros(count))) + own)
    repeats = np.zeros(count)
    for sheet, start in zip(sheets, starts, strict=False):
        own_gain = gain[:, int(start) : int(start) + len(sheet.lines)]
        total += sheet.repeats.drawn(rng, own_gain)
        repeats += np.sum(np.square(own_gain * sheet.repeats.spread), axis=1)
    budget[Message("repeat")] = np.sqrt(repeats)
    expanded = np.quantile(np.abs(total), COVERAGE, axis=0)
    hidden = np.where(unknown, np.nan, 0.0)
    return AdjustedErrors(
        values=read_only(errors + hidden),
        covariance=read_only(covariance),
        expanded=read_only(expanded + hidden),
        budget={name: read_only(value + hidden) for name, value in budget.items()},
        dof=dof,
        p_value=float(chi2_sf(float(rest @ rest), dof)) if dof > 0 else float("nan"),
        residuals=read_only(residuals[:measured]),
        normalised=read_only(normalised[:measured]),
    )


def _before(count: int) -> Observed:
    """Return what is known of the errors before the readings, as readings of zero."""

    def at(errors: np.ndarray) -> Linearised:
        return -errors, np.eye(count), np.zeros((count, 0))

    known = BudgetLine(Message("errors not shown"), PRIOR * np.eye(count), "normal")
    return Observed(at, (0,) * count, np.zeros(count), (known,), RepeatedReadings(0.0, 0, np.ones(count)))


def _padded(effects: np.ndarray, start: int, whole: int) -> np.ndarray:
    padded = np.zeros((len(effects), whole))
    padded[:, start : start + effects.shape[1]] = effects
    return padded


def _stacked(sheets: Sequence[Observed], errors: np.ndarray, starts: np.ndarray) -> Linearised:
    parts = [sheet.at(errors) for sheet in sheets]
    free = sum(n.shape[1] for _, _, n in parts)
    n, column = np.zeros((int(starts[-1]), free)), 0
    for (_, _, own), start in zip(parts, starts, strict=False):
        n[int(start) : int(start) + len(own), column : column + own.shape[1]] = own
        column += own.shape[1]
    return np.concatenate([y for y, _, _ in parts]), np.concatenate([a for _, a, _ in parts]), n


def _left_null(n: np.ndarray) -> np.ndarray:
    """Return (m − rank, m) orthonormal rows that the free unknowns do not reach."""
    left, sizes, _ = np.linalg.svd(n, full_matrices=True)
    rank = int(np.sum(sizes > RANK * max(float(sizes.max(initial=0.0)), 1e-300)))
    return np.asarray(left[:, rank:].T)


def _residual_cofactor(free: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """Return the covariance (m, m) of the whitened residuals."""
    kept = np.eye(len(free)) - fitted @ fitted.T
    return np.asarray(free.T @ kept @ free)
