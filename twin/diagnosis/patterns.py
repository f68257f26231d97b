"""Unnamed patterns: functions of each column of the table and of each pair of columns, on each side of the machine; and their scores.

A pattern shifts the targets and stations of one side along the axes of the base frame, or of the frame of that side. Its functions are
those of `twin.model.effects.harmonic`: half waves over the range of a column, harmonics of a rotary axis that made a whole turn, the
approach direction of an axis; for a pair, their products. They can represent what low polynomials cannot: short waves, steps, and a
reversal that depends on the position. Their inner products with the residual, of all patterns of a side at once, are those of the
columns' functions with each other, weighted by the residual.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, combinations
from typing import Final, final

import numpy as np

from twin._common.records import APPROACH
from twin._common.units import UM
from twin.diagnosis.candidates.candidate import Column, ReadingDerivatives, SignatureTerm
from twin.diagnosis.forms import Form
from twin.diagnosis.problem import Problem
from twin.diagnosis.signature_products import PointBlock, Signatures, side_by_side
from twin.machine.machine import Axis, Machine
from twin.measurement.columns import CARRIERS
from twin.measurement.instruments import SIDES
from twin.measurement.observation import machine_state
from twin.measurement.table import Measurements
from twin.model.effects.harmonic import Waves
from twin.model.effects.harmonic import terms as products_of
from twin.numerics.functions import Functions, Rows, pieces

ORDER_ALONE: Final = 32  # highest order of a single column
ORDER_IN_PAIRS: Final = 8  # highest order of an axis in a pair
ORDER_OF_SLOW_COLUMNS: Final = 4  # the same of a slowly changing column: time, temperatures, rounds, other channels
ORDERS_TESTED: Final = (2, 4, 8, 16, 32)  # orders up to which the functions of a pattern are tested together
PERIODIC_RANGE_DEG: Final = 300.0  # range of a rotary axis, degrees, from which on its functions are periodic


@final
@dataclass(frozen=True, eq=False)
class Channel:
    """One column that patterns may depend on."""

    waves: Waves  # functions of the column
    # (n,) values; those of the functions are computed where they are needed: they would take much memory
    column: np.ndarray
    paired: int  # highest order in a pair

    @property
    def name(self) -> str:
        """Return the name in the table (``X_mm``, ``T_bed_degC``, ``approach_X``)."""
        return self.waves.column

    @property
    def direction(self) -> bool:
        """Return whether it is an approach direction, a sign and no position."""
        return self.waves.kind == "direction"


@final
@dataclass(frozen=True, eq=False)
class Pattern:
    """Functions of one or two columns, on one side of the machine."""

    side: str  # ``tool`` or ``work``
    field: str  # along the axes of the ``base`` frame, or of that side's own (``place``)
    channels: tuple[Channel, ...]  # one or two
    own: np.ndarray  # (n,) which readings a shift of that side changes
    highest: int  # order of the functions

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of its columns of the table."""
        return tuple(channel.name for channel in self.channels)

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Side and columns."""
        return self.side, self.names

    @property
    def derivative(self) -> str:
        """Return which derivative of the readings it multiplies (`twin.diagnosis.candidates.candidate.ReadingDerivatives`)."""
        return f"{self.side} {self.field}"

    @cached_property
    def levels(self) -> tuple[int, ...]:
        """Return the orders up to which it is tested; each adds functions to the previous one."""
        orders = self.order
        found: list[int] = []
        for level in ORDERS_TESTED:
            if level <= self.highest and (not found or np.any((orders > found[-1]) & (orders <= level))):
                found.append(level)
        return tuple(found) or (int(orders.max()),)

    @cached_property
    def order(self) -> np.ndarray:
        """Return (m,) the higher of the two orders of each function."""
        own = [np.array([0, *waves.half_waves]) for waves in self.waves(self.highest)]
        return np.max([orders[i] for orders, i in zip(own, self.terms.T, strict=True)], axis=0)

    def waves(self, level: int) -> tuple[Waves, ...]:
        """Return the functions of its columns up to an order."""
        most = min(level, self.highest)
        if len(self.channels) == 1:
            return (self.channels[0].waves.up_to(most),)
        return tuple(channel.waves.up_to(min(channel.paired, most)) for channel in self.channels)

    @cached_property
    def terms(self) -> np.ndarray:
        """Return (m, columns) for each function the number of each column's function, from 1; 0 for the constant."""
        return np.array(products_of(self.waves(self.highest)))

    def at(self, rows: Rows) -> np.ndarray:
        """Return (rows, m) values of its functions, zero on the other side."""
        own = self.own[rows, None]
        first, *others = (
            np.stack(waves.values(channel.column[rows]), axis=1)
            for channel, waves in zip(self.channels, self.waves(self.highest), strict=True)
        )
        if not others:
            return np.asarray(first * own)
        one = np.ones((len(first), 1))
        pair = [np.concatenate([one, values], axis=1) for values in (first, others[0])]
        return np.asarray(pair[0][:, self.terms[:, 0]] * pair[1][:, self.terms[:, 1]] * own)

    def columns(self, level: int, directions: Sequence[int]) -> list[Column]:
        """Return the signatures, µm per unit, of the functions up to an order along some directions, sorted by direction."""
        chosen = np.flatnonzero(self.order <= level).tolist()
        return [self._columns[i][k] for i in directions for k in chosen]

    def family(self, level: int) -> tuple[Column, ...]:
        """Return the columns to evaluate for those up to an order: for one column of the table all, since all its levels are tried."""
        return tuple(self.columns(self.highest if len(self.channels) == 1 else level, range(3)))

    @cached_property
    def _columns(self) -> list[list[Column]]:
        """Columns by direction and function: always the same objects, so that their inner products are found again."""
        functions = Functions(len(self.own), len(self.order), self.at, self.own)
        return [
            [Column((SignatureTerm((self.derivative, i), functions, k, UM),), 1.0) for k in range(functions.count)]
            for i in range(3)
        ]


@final
class ChannelFunctions:
    """The m functions of several patterns of one side, made from those of their columns."""

    def __init__(self, patterns: Sequence[Pattern]) -> None:
        self._channels = list(dict.fromkeys(channel for pattern in patterns for channel in pattern.channels))
        starts = np.cumsum([0, *(len(channel.waves.half_waves) for channel in self._channels)]).tolist()
        start = dict(zip(self._channels, starts[:-1], strict=True))
        factors: list[np.ndarray] = []
        self.own: dict[Pattern, slice] = {}
        self.count = 0
        for pattern in patterns:
            # Function 0 is the constant.
            numbers = np.zeros((len(pattern.order), 2), dtype=int)
            for k, channel in enumerate(pattern.channels):
                numbers[:, k] = np.where(pattern.terms[:, k] > 0, start[channel] + pattern.terms[:, k], 0)
            factors.append(numbers)
            self.own[pattern] = slice(self.count, self.count + len(numbers))
            self.count += len(numbers)
        self._first, self._second = np.concatenate(factors).T
        # Functions of the highest orders are in no pair: only the others are multiplied with each other.
        paired = (self._first > 0) & (self._second > 0)
        self._pairs = np.flatnonzero(paired)
        self._in_pairs, at = np.unique([self._first[paired], self._second[paired]], return_inverse=True)
        self._pair_at = at.reshape(2, -1)

    def at(self, rows: np.ndarray) -> np.ndarray:
        """Return (rows, m) values of all functions at readings of the side."""
        factors = self._factors(rows)
        return np.asarray((factors[self._first] * factors[self._second]).T)

    def with_vectors(self, rows: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return inner products (r, m) of all functions with (r, rows) vectors at readings of the side."""
        factors = self._factors(rows)
        # The constant is the first factor.
        along = (vectors @ factors.T)[:, np.maximum(self._first, self._second)]
        some = factors[self._in_pairs]
        along[:, self._pairs] = ((vectors[:, None] * some) @ some.T)[:, self._pair_at[0], self._pair_at[1]]
        return np.asarray(along)

    def _factors(self, rows: np.ndarray) -> np.ndarray:
        """Return (factors, rows) values of the functions that the others are products of."""
        of_channels = (channel.waves.values(channel.column[rows]) for channel in self._channels)
        return np.stack([np.ones(len(rows)), *chain.from_iterable(of_channels)])


def patterns(machine: Machine, data: Measurements) -> list[Pattern]:
    """Return the patterns of every column and pair, for every side with targets, in every frame that turns differently."""
    patterns = []
    for side in _sides(machine, data):
        own = (data.carrier == side) != (data.station_carrier == side)
        channels = _channels(machine, data, own)
        turning = any(not axis.linear and axis.side == side for axis in machine.axes)
        for field in ("base", "place") if turning else ("base",):
            patterns += [Pattern(side, field, (channel,), own, ORDER_ALONE) for channel in channels]
            for a, b in combinations(channels, 2):
                if not b.direction:
                    patterns.append(Pattern(side, field, (a, b), own, ORDER_IN_PAIRS))
                elif not a.direction:
                    patterns.append(Pattern(side, field, (b, a), own, ORDER_IN_PAIRS))
    return patterns


def _sides(machine: Machine, data: Measurements) -> list[str]:
    """Return the sides whose shifts the readings show; of two that only move relative to each other, those that axes move."""
    sides = [side for side in CARRIERS if np.any((data.carrier == side) != (data.station_carrier == side))]
    if np.any(data.station_carrier == SIDES[0]):
        return sides
    return [side for side in sides if any(axis.side == side for axis in machine.axes)] or sides


def _channels(machine: Machine, data: Measurements, own: np.ndarray) -> list[Channel]:
    """Return the columns that change in the readings ``own`` (n,) of a side: no other carries a pattern of it."""
    state = dict(machine_state(data, machine))
    if len(set(data.round)) > 2:
        rounds = list(dict.fromkeys(data.round))
        state["round"] = np.array([float(rounds.index(name)) for name in data.round])
    channels = []
    for name, values in state.items():
        axis = machine.by_name.get(name)
        distinct = len(np.unique(np.round(values[own], 6)))
        if distinct < 2:
            continue
        waves = _waves(name, axis, values[own], distinct)
        paired = 1 if waves.kind == "direction" else ORDER_IN_PAIRS if axis is not None else ORDER_OF_SLOW_COLUMNS
        channels.append(Channel(waves, values, paired))
    return channels


def _waves(name: str, axis: Axis | None, values: np.ndarray, distinct: int) -> Waves:
    """Return the functions of a column, as many as its distinct values allow, at most `ORDER_ALONE` half waves."""
    if name.startswith(APPROACH):
        return Waves(name, "direction", 1)
    column = name if axis is None else f"{axis.name}_{axis.unit}"
    if axis is not None and not axis.linear and np.ptp(values) >= PERIODIC_RANGE_DEG:
        return Waves(column, "whole_turns", min(ORDER_ALONE // 2, max((distinct - 1) // 2, 1)))
    span = float(values.min()), float(values.max())
    wrapped = axis is not None and axis.lower is None
    return Waves(column, "half_waves", min(ORDER_ALONE, distinct - 1), span, wrapped)


READINGS_SAMPLED: Final = 2048
"""Readings of a side from which the distribution of its scores for noise alone is estimated, where there are more: enough to find the
most significant tests. The scores themselves are those of all readings.
"""
SEED: Final = 4712
ZERO_SHARE: Final = 1e-10
"""Share of the largest eigenvalue below which a direction counts as zero, and share of the largest square of a pattern's functions that
the projection must leave of each: what is less is rounding. So is all of a direction that was not read."""
TESTED_NONCENTRALITY: Final = 100.0
"""Noncentrality along a direction for which the test is most powerful: the score is taken at that variance, not at zero."""
READINGS_AT_ONCE: Final = 512  # readings at which the functions of all patterns of a side are evaluated at once


@final
@dataclass(frozen=True)
class _Side:
    """Inner products of all patterns of one side and frame with a total of m functions."""

    own: dict[Pattern, slice]  # functions of each pattern among all
    slope: np.ndarray  # (3, m) inner products with the residual along each direction
    lost: np.ndarray  # (3, m, k) inner products with an orthonormal basis of nuisance and causes, over the sample
    # (3, own, own) of each pattern over the sample, or one (1, own, own) if they are equal
    grams: dict[Pattern, np.ndarray]
    share: float  # of the side's readings in the sample


@final
class PatternScores:
    """Scores of patterns with set-up and causes projected out."""

    def __init__(self, problem: Problem, forms: Sequence[Form], tried: Sequence[Pattern]) -> None:
        n = len(problem.view.rows)
        self._problem, self._view = problem, problem.view
        self._kept = np.ones(n, dtype=bool)
        self._kept[problem.held_out] = False
        self._columns = [column for form in forms for column in form.variant.columns]
        columns = problem.zero_held_out(problem.signature(self._columns))
        on_basis = problem.nuisances.along(columns)
        projected = problem.zero_held_out(columns - problem.fitted(on_basis))
        gram = columns.T @ projected
        values, vectors = np.linalg.eigh((gram + gram.T) / 2.0)
        seen = values > ZERO_SHARE * values.max(initial=0.0)
        # Coefficients of an orthonormal basis in the projected columns.
        root = vectors[:, seen] / np.sqrt(values[seen])
        self._causes = projected @ root
        # Coefficients of the orthonormal basis of nuisance and causes in the nuisance derivatives and the columns of the causes.
        change, absorbed = problem.nuisances.change @ problem.root, problem.root.T @ on_basis @ root
        self._change = np.block([[change, -change @ absorbed], [np.zeros((len(root), change.shape[1])), root]])
        # With the calibration's uncertainty the projection is not idempotent: the causes are fitted to the residual itself.
        left = problem.projected - self._causes @ (self._causes.T @ problem.residual)
        self._left = left.reshape(n, 3)
        self._nuisance = problem.nuisances
        self._by_side: dict[str, list[Pattern]] = {}
        for pattern in tried:
            self._by_side.setdefault(pattern.derivative, []).append(pattern)
        self._latest: tuple[str, _Side] | None = None

    def of(self, pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
        """Return (3, m) φᵀMr and (3, m, m) φᵀMφ along each direction; only the latest side is kept."""
        if self._latest is None or self._latest[0] != pattern.derivative:
            self._latest = None
            self._latest = pattern.derivative, self._side(self._by_side[pattern.derivative])
        side = self._latest[1]
        own = side.own[pattern]
        lost, whole = side.lost[:, own], side.grams[pattern]
        gram = (whole - lost @ lost.transpose(0, 2, 1)) / side.share
        seen = _seen(gram, whole / side.share)
        return side.slope[:, own] * seen, gram * (seen[:, :, None] & seen[:, None, :])

    def _side(self, alike: Sequence[Pattern]) -> _Side:
        """Return the inner products of all patterns of one side and frame."""
        functions = ChannelFunctions(alike)
        own = rows = np.flatnonzero(alike[0].own & self._kept)
        if len(own) > READINGS_SAMPLED:
            rows = np.sort(np.random.default_rng(SEED).choice(own, READINGS_SAMPLED, replace=False))
        slope = np.zeros((3, functions.count))
        for some in pieces(len(own)):
            along = np.einsum("nki,nk->in", self._fields(alike[0], own[some]), self._left[own[some]])
            slope += functions.with_vectors(own[some], along)
        by_vectors, grams, whole, used = self._sampled(functions, alike, rows)
        scale = self._nuisance.scale
        in_setup = np.arange(len(self._change)) < self._nuisance.setup_count
        root = self._sample_root(whole, (np.where(in_setup, 1.0, scale)[:, None] * self._change)[used], len(own))
        lost = by_vectors.transpose(0, 2, 1) @ (scale * root)
        scaled = {pattern: gram * scale**2 for pattern, gram in grams.items()}
        return _Side(functions.own, slope, lost, scaled, len(rows) / max(len(own), 1))

    def _sampled(
        self, functions: ChannelFunctions, alike: Sequence[Pattern], rows: np.ndarray
    ) -> tuple[np.ndarray, dict[Pattern, np.ndarray], np.ndarray, np.ndarray]:
        """Return the inner products of functions over the sample, with the weights of the base.

        Those with nuisance derivatives and causes are the same in every test of these patterns on these readings and are kept.

        Returns:
            (3, used, m) with the nuisance derivatives and columns of causes that are not zero; Gram matrices (3, own, own), or one if
            they are equal; (rows, 3, used) these derivatives and columns; and their numbers.
        """
        base = self._nuisance.base
        view, block = base.signatures.view, PointBlock(base.signatures.view, rows)
        fields = ReadingDerivatives(view, rows).of(alike[0].derivative) * UM
        raw = base.raw(block)
        acting = np.flatnonzero(raw.any(axis=(0, 1)))
        key: Hashable = ("sample", tuple(alike), rows.tobytes())
        if key not in base.known:
            weight = np.einsum("nki,nki->ni", fields, fields)
            directions = 1 if np.ptp(weight) <= 1e-9 * weight.max() else 3
            grams = {pattern: np.zeros((directions, len(pattern.order), len(pattern.order))) for pattern in alike}
            for some in pieces(len(rows), READINGS_AT_ONCE):
                made = functions.at(rows[some])
                for pattern, own in functions.own.items():
                    for i in range(directions):
                        grams[pattern][i] += made[:, own].T @ (made[:, own] * weight[some, i, None])
            base.known[key] = _along_functions(functions, rows, fields, raw[:, :, acting]), grams, {}
        by_raw, grams, known = base.known[key]
        columns = [*self._nuisance.signatures.columns[len(base.signatures.columns) :], *self._columns]
        beside = Signatures(view, columns).at(block)
        fresh = [i for i, column in enumerate(columns) if column not in known]
        for i, own in zip(
            fresh, _along_functions(functions, rows, fields, beside[:, :, fresh]).transpose(1, 0, 2), strict=True
        ):
            known[columns[i]] = own.copy()
        by_beside = np.stack([known[column] for column in columns], axis=1) if columns else by_raw[:, :0]
        used = np.concatenate([acting, base.raw_count + np.arange(len(columns))])
        return np.concatenate([by_raw, by_beside], axis=1), grams, side_by_side(raw[:, :, acting], beside), used

    def distributions(self, tests: Sequence[tuple[Pattern, int, tuple[int, ...]]]) -> list[tuple[np.ndarray, float]]:
        """Return of each test (pattern, level, directions) the weights of χ² whose sum its score is for noise alone, and the score."""
        every = list(dict.fromkeys(c for pattern, level, where in tests for c in pattern.columns(level, where)))
        if not every:
            return []
        at = {column: i for i, column in enumerate(every)}
        rows = np.flatnonzero(self._kept) if len(self._problem.held_out) else None
        lost, slope = self._along_every(every, rows)
        distributions = []
        for pattern, level, directions in tests:
            own = [at[column] for column in pattern.columns(level, directions)]
            whole = self._gram(pattern, level, directions)
            gram = whole - lost[own] @ lost[own].T
            seen = _seen(gram, whole)
            gram *= seen[:, None] & seen
            size = np.diag(gram).reshape(len(directions), -1).sum(axis=1)
            deviation = np.repeat(
                np.sqrt(TESTED_NONCENTRALITY / np.where(size > 0.0, size, np.inf)), len(own) // len(directions)
            )
            values, vectors = np.linalg.eigh(gram * np.outer(deviation, deviation))
            values = np.maximum(values, 0.0)
            score = float(np.sum((vectors.T @ (slope[own] * seen * deviation)) ** 2 / (1.0 + values)))
            distributions.append((values / (1.0 + values), score))
        return distributions

    def _along_every(self, columns: Sequence[Column], rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Return inner products (columns, k) with the orthonormal basis of nuisance and causes, and (columns,) with the residual."""
        problem, base, nuisance = self._problem, self._nuisance.base, self._nuisance
        causes = self._causes.reshape(len(self._kept), 3, -1)
        random_effects = range(len(base.signatures.columns), len(nuisance.signatures.columns))

        def vectors(block: PointBlock) -> np.ndarray:
            by_random_effects = nuisance.signatures.at(block, random_effects)
            return side_by_side(by_random_effects, causes[block.rows], self._left[block.rows, :, None])

        keys = [("exact", column, problem.held_out.tobytes()) for column in columns]
        fresh = [column for key, column in zip(keys, columns, strict=True) if key not in base.known]
        if fresh:
            signatures = Signatures(base.signatures.view, fresh)
            for column, own in zip(fresh, signatures.along(base.raw, rows)[0], strict=True):
                base.known["exact", column, problem.held_out.tobytes()] = own
        beside = Signatures(self._view, columns).along(vectors, rows)[0]
        more, own, slope = np.split(beside, [nuisance.raw_count - base.raw_count, beside.shape[1] - 1], axis=1)
        # The set-up's part of the derivatives is orthonormal with any weights.
        in_setup = np.arange(base.raw_count) < base.setup_count
        raw_scale = np.where(in_setup, nuisance.scale, nuisance.scale**2)
        by_raw = np.concatenate([np.stack([base.known[key] for key in keys]) * raw_scale, more], axis=1)
        return np.concatenate(
            [by_raw @ self._change[: nuisance.raw_count, : problem.root.shape[1]], own], axis=1
        ), slope[:, 0]

    def _gram(self, pattern: Pattern, level: int, directions: tuple[int, ...]) -> np.ndarray:
        """Return φᵀφ of the functions up to an order along some directions, without projection; kept."""
        known = self._nuisance.base.known
        key = "gram", pattern, level, directions, self._problem.held_out.tobytes()
        if key not in known:
            rows, chosen = np.flatnonzero(pattern.own & self._kept), pattern.order <= level
            count = len(directions)
            gram = np.zeros((count, int(chosen.sum()), count, int(chosen.sum())))
            for some in pieces(len(rows)):
                here = rows[some]
                fields = self._fields(pattern, here)[:, :, list(directions)] / self._nuisance.scale
                weights = np.einsum("nki,nkj->nij", fields, fields)
                made = pattern.at(here)[:, chosen]
                for i in range(count):
                    for j in range(i + 1):
                        gram[i, :, j] += made.T @ (made * weights[:, i, j, None])
            for i in range(count):
                for j in range(i):
                    gram[j, :, i] = gram[i, :, j].T
            known[key] = gram.reshape(count * gram.shape[1], -1)
        return known[key] * self._nuisance.scale**2

    def _sample_root(self, whole: np.ndarray, change: np.ndarray, count: int) -> np.ndarray:
        """Return a root R (used, k) of the projection on nuisance and causes, VRRᵀVᵀ, such that a sample stands for all ``count`` rows.

        ``whole``: vectors V (r, 3, used) there; ``change``: coefficients (used, directions) of an orthonormal basis over all rows.
        """
        root = np.asarray(np.linalg.qr(change.T, mode="r")).T
        if len(whole) == count:
            return root
        root = root * np.sqrt(count / len(whole))
        flat = whole.reshape(3 * len(whole), -1) @ root
        # Over all rows no direction is longer than one; over a sample it may seem to be.
        values, vectors = np.linalg.eigh(flat.T @ flat)
        return np.asarray(root @ (vectors / np.sqrt(np.maximum(values, 1.0))))

    def _fields(self, pattern: Pattern, rows: Rows) -> np.ndarray:
        return ReadingDerivatives(self._view, rows).of(pattern.derivative) * UM


def _seen(gram: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """Return (…, m) which functions of a pattern the projection leaves, from Gram matrices (…, m, m) with and without it."""
    largest = float(np.diagonal(whole, axis1=-2, axis2=-1).max(initial=0.0))
    return np.asarray(np.diagonal(gram, axis1=-2, axis2=-1) > ZERO_SHARE * largest)


def _along_functions(
    functions: ChannelFunctions, rows: np.ndarray, fields: np.ndarray, vectors: np.ndarray
) -> np.ndarray:
    """Return inner products (3, q, m) over some rows of functions along each direction of (n, 3, 3) fields with (n, 3, q) vectors."""
    along_functions = np.zeros((3, vectors.shape[2], functions.count))
    for some in pieces(len(rows) if vectors.size else 0, READINGS_AT_ONCE):
        along = np.stack([sum(fields[some, k, i, None] * vectors[some, k] for k in range(3)) for i in range(3)])
        along_functions += along.transpose(0, 2, 1) @ functions.at(rows[some])
    return along_functions
