"""Which of my unknowns can these data determine?

Every unknown is counted in its plausible size and every reading in its standard uncertainty. A singular value of the derivatives is
then a signal-to-noise ratio: below one, the data say less of that direction than was known before. The directions below the tolerance
span the null space; what an unknown has of it (its leverage) says whether it can be determined at all, and with which others it moves.

The leverage does not depend on how the null space happens to be spanned. The independence factors of T. Wen, J. Hu, Y. Zhu and G. Hua
(Multi-axis laser interferometer not affected by installation errors based on nonlinear computation, Appl. Sci. 13 (2023) 10887) do,
and on the units and the truncation besides.

Y. Sun, J. M. Hollerbach: Observability index selection for robot calibration, ICRA 2008, 831-836.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from scipy.optimize import linprog

from twin._common.arrays import locked
from twin._common.errors import InputError

WEAKEST: Final = 1.0
"""Singular values below it, in plausible units, are directions the data do not see."""
UNSEEN: Final = 0.25
"""An unknown whose variance stays above this share of its plausible one has not been determined."""
NAMED: Final = 0.01
"""A direction in words leaves out what alone would change the readings by less than this share of the largest such change."""
MOST_NAMED: Final = 6
"""What one sentence names at most; the rest is counted."""
LARGE: Final = 20_000
"""Entries of a null space beyond which its vector nearest to an unknown is shown, not the one with the fewest moves (seconds each)."""


@final
@dataclass(frozen=True)
class Spectrum:
    """What a whitened matrix of derivatives sees and what it does not, in plausible units.

    Attributes:
        scale: (p,) plausible sizes, in the units of the derivatives.
        values: (f,) singular values of all f directions allowed, descending; zero where there are fewer readings.
        directions: (p, d) orthonormal, those with a singular value above the tolerance.
        silent: (p, f − d) orthonormal, the others.
    """

    scale: np.ndarray
    values: np.ndarray
    directions: np.ndarray
    silent: np.ndarray

    @property
    def strength(self) -> np.ndarray:
        """(d,) singular values of what is seen."""
        return np.asarray(self.values[: self.directions.shape[1]])

    @property
    def rank(self) -> int:
        """How many directions are seen."""
        return self.directions.shape[1]

    def covariance(self, *, silent: bool = True) -> np.ndarray:
        """(p, p) in the units of the derivatives; with the plausible size of what the data do not see, or without."""
        root = self.directions / self.strength
        if silent:
            root = np.concatenate([root, self.silent], axis=1)
        root = root * self.scale[:, None]
        return np.asarray(root @ root.T)

    @property
    def leverage(self) -> np.ndarray:
        """(p,) 0 to 1: how much of each unknown, in plausible units, lies in the null space.

        The diagonal of the projector on it: 0 where no null direction touches the unknown, 1 where the data say nothing of it.
        """
        return np.asarray(np.sum(self.silent**2, axis=1))

    @property
    def reach(self) -> np.ndarray:
        """(p,) how far the null space moves each unknown when it is as large as is plausible, in the units of the derivatives."""
        return np.asarray(np.sqrt(self.leverage) * self.scale)

    @property
    def effect(self) -> np.ndarray:
        """(p,) what each unknown alone, moved by its plausible size, does to the readings: root of the sum of squares, whitened."""
        return np.asarray(np.sqrt(self.directions**2 @ self.strength**2))

    @property
    def unseen(self) -> np.ndarray:
        """(p,) share of each unknown's plausible variance that is left: near one where the data say nothing of it."""
        seen = np.sum(self.directions**2 / (self.strength**2 + 1.0), axis=1)
        return np.asarray(seen + self.leverage)


def decompose(
    matrix: np.ndarray, scale: np.ndarray, *, free: np.ndarray | None = None, tolerance: float = WEAKEST
) -> tuple[np.ndarray, Spectrum]:
    """Singular values and directions of whitened derivatives.

    Args:
        matrix: (n, p) derivatives of the whitened readings by the unknowns in plausible units.
        scale: (p,) those plausible sizes.
        free: (p, f) orthonormal directions, in plausible units, that are allowed; all if None.
        tolerance: singular values at or below it are not seen.

    Returns:
        (n, d) left singular vectors of what is seen, and the spectrum.
    """
    inside = np.eye(matrix.shape[1]) if free is None else free
    left, values, right = np.linalg.svd(matrix @ inside, full_matrices=True)
    seen = int(np.count_nonzero(values > tolerance))
    every = np.zeros(inside.shape[1])
    every[: len(values)] = values
    return left[:, :seen], Spectrum(
        locked(np.array(scale)), locked(every), locked(inside @ right[:seen].T), locked(inside @ right[seen:].T)
    )


@final
@dataclass(frozen=True)
class Unknown:
    """One unknown number.

    Attributes:
        name: as it is to be read in a sentence.
        unit: it is stated in.
        plausible: how far it may be off before anything is measured, in that unit.
        factor: what one such unit is in the units of the derivatives (1e-3 for mm where these are by metres).
    """

    name: str
    unit: str
    plausible: float
    factor: float = 1.0


@final
@dataclass(frozen=True)
class UnknownMove:
    """What one unknown does along a null direction, in its stated unit."""

    name: str
    value: float
    unit: str

    def __str__(self) -> str:
        digits = np.format_float_positional(self.value, 3, unique=False, fractional=False, trim="-", sign=True)
        shown = digits if 1e-4 < abs(self.value) < 1e7 else f"{self.value:+.3g}"
        unit = self.unit.replace("um", "µm").replace("urad", "µrad")
        return f"{self.name} {shown} {unit}".rstrip()


@final
@dataclass(frozen=True)
class NullDirection:
    """Unknowns that move together and change no reading that could be noticed.

    Attributes:
        moves: first what would change the readings most if it moved alone; before them the one that was asked for, if one was.
        change: what the readings do then, root of the sum of squares in standard uncertainties.
        left_out: how many more move beyond those that one sentence holds.
    """

    moves: tuple[UnknownMove, ...]
    change: float
    left_out: int

    def __str__(self) -> str:
        first, *others = (str(move) for move in self.moves)
        more = f" and {self.left_out} more by less" if self.left_out else ""
        return f"{first} alone{more}" if not others else f"{first} with {', '.join(others)}{more}"

    def shortened(self, count: int) -> NullDirection:
        """The same with at most so many of its moves named."""
        kept = self.moves[:count]
        return NullDirection(kept, self.change, self.left_out + len(self.moves) - len(kept))


@final
@dataclass(frozen=True)
class Observability:
    """Observability indices of robot calibration: larger is better (Sun and Hollerbach 2008, eq. 4 to 8); all zero without full rank.

    Attributes:
        o1: (s₁ s₂ … s_L)^(1/L) / √m, of all directions together (Borm and Menq 1989).
        o2: s_L / s₁, inverse condition number (Driels and Pathre 1990).
        o3: s_L, the worst direction (Nahvi, Hollerbach and Hayward 1994).
        o4: s_L² / s₁, noise amplification index (Nahvi and Hollerbach 1996).
        o5: 1 / (1/s₁ + … + 1/s_L) (Sun and Hollerbach 2008).
    """

    o1: float
    o2: float
    o3: float
    o4: float
    o5: float


def observability(values: np.ndarray, measurements: int) -> Observability:
    """Observability indices of L singular values from m measurements.

    Args:
        values: (L,) singular values.
        measurements: m, how many were taken (poses, where one measurement is a pose).

    Raises:
        InputError: no values, or no measurement.
    """
    if len(values) == 0 or measurements < 1:
        raise InputError(
            "no observability of nothing",
            expected="one singular value and one measurement at least",
            value=f"{len(values)} values, {measurements} measurements",
        )
    largest, smallest = float(np.max(values)), float(np.min(values))
    if smallest <= 0.0:
        return Observability(0.0, 0.0, 0.0, 0.0, 0.0)
    return Observability(
        float(np.exp(np.mean(np.log(values))) / np.sqrt(measurements)),
        smallest / largest,
        smallest,
        smallest**2 / largest,
        float(1.0 / np.sum(1.0 / np.asarray(values))),
    )


@final
@dataclass(frozen=True)
class Determinability:
    """What data determine, unknown by unknown.

    Attributes:
        unknowns: p of them.
        spectrum: in plausible units.
        tolerance: singular values at or below it are not seen.
        measurements: how many the observability indices count.
    """

    unknowns: tuple[Unknown, ...]
    spectrum: Spectrum
    tolerance: float
    measurements: int

    @property
    def names(self) -> tuple[str, ...]:
        """Of the unknowns, in their order."""
        return tuple(one.name for one in self.unknowns)

    @property
    def rank(self) -> int:
        """How many directions the data see."""
        return self.spectrum.rank

    @property
    def leverage(self) -> np.ndarray:
        """(p,) of the null space on each unknown, 0 to 1 (`Spectrum.leverage`)."""
        return self.spectrum.leverage

    @property
    def reach(self) -> np.ndarray:
        """(p,) how far the null space moves each unknown, in its stated unit, when it is as large as is plausible."""
        return np.asarray(self.spectrum.reach / np.array([one.factor for one in self.unknowns]))

    @property
    def unseen(self) -> np.ndarray:
        """(p,) share of each unknown's plausible variance that is left (`Spectrum.unseen`)."""
        return self.spectrum.unseen

    @property
    def determined(self) -> np.ndarray:
        """(p,) whether at most `UNSEEN` of the plausible variance is left."""
        return np.asarray(self.unseen <= UNSEEN)

    @property
    def u(self) -> np.ndarray:
        """(p,) standard uncertainties in the stated units, from the data alone; NaN where an unknown is not determined."""
        own = np.sqrt(np.diag(self.spectrum.covariance(silent=False)))
        return np.where(self.determined, own / np.array([one.factor for one in self.unknowns]), np.nan)

    @property
    def observability(self) -> Observability:
        """Of all directions allowed, in plausible units and standard uncertainties; zero where one is not seen at all."""
        return observability(self.spectrum.values, self.measurements)

    @property
    def null_directions(self) -> tuple[NullDirection, ...]:
        """A basis of the null space that is easy to read: each vector has an unknown that none of the others moves.

        Found by elimination with complete pivoting; not orthogonal. Largest move of each: one plausible size.
        """
        return tuple(self._direction(column) for column in _echelon(self.spectrum.silent).T)

    def moving(self, name: str) -> NullDirection | None:
        """The null direction that moves one unknown and of the others as few as can be; None if the null space hardly has it.

        Of all those that move it by one, the one whose moves would each alone change the readings least, summed (a linear programme:
        the least sum of magnitudes has the fewest of them; Chen, Donoho and Saunders 1998). It does not depend on how the null space is
        spanned. Hardly: less than `NAMED` of its plausible size.

        Raises:
            KeyError: no unknown of that name.
        """
        if name not in self.names:
            raise KeyError(name)
        index = self.names.index(name)
        silent = self.spectrum.silent
        if float(np.linalg.norm(silent[index])) < NAMED:
            return None
        if silent.size > LARGE:
            return self._direction(silent @ silent[index], first=index)
        effect = self.spectrum.effect
        # What no reading shows alone may move freely, but not for nothing: the answer is to be one.
        weight = np.maximum(effect, 1e-9 * max(float(effect.max(initial=0.0)), 1.0))
        basis, _ = np.linalg.qr(weight[:, None] * silent)
        p, s = basis.shape
        above = np.concatenate([np.concatenate([basis, -basis]), -np.tile(np.eye(p), (2, 1))], axis=1)
        found = linprog(
            np.concatenate([np.zeros(s), np.ones(p)]),
            A_ub=above,
            b_ub=np.zeros(2 * p),
            A_eq=np.concatenate([basis[index], np.zeros(p)])[None],
            b_eq=[1.0],
            bounds=[(None, None)] * s + [(0.0, None)] * p,
        )
        # Should the solver give up, the axis of the unknown projected on the null space moves it too, with more beside it.
        vector = basis @ found.x[:s] / weight if found.success else silent @ silent[index]
        return self._direction(vector, first=index)

    def _direction(self, vector: np.ndarray, first: int | None = None) -> NullDirection:
        # Not by plausible sizes: a station may stand anywhere within metres, yet its millimetre is what makes up for an error's.
        vector = vector / np.abs(vector).max()
        weight = np.abs(vector) * self.spectrum.effect
        # What alone no reading would notice takes nothing with it.
        weight = weight if weight.max() > self.tolerance * NAMED else np.where(np.abs(vector) == 1.0, 1.0, 0.0)
        share = np.round(weight / weight.max(), 6)
        order = [int(i) for i in np.argsort(-share, kind="stable") if share[i] >= NAMED]
        if first is not None:
            order = [first, *(i for i in order if i != first)]
        vector = vector if vector[order[0]] > 0.0 else -vector
        moves = []
        for i in order[:MOST_NAMED]:
            one = self.unknowns[i]
            moves.append(UnknownMove(one.name, float(vector[i]) * one.plausible, one.unit))
        along = self.spectrum.silent.T @ vector
        change = float(np.linalg.norm(self.spectrum.values[self.rank :] * along))
        return NullDirection(tuple(moves), change, max(len(order) - MOST_NAMED, 0))


def determinability(
    jacobian: np.ndarray,
    unknowns: Sequence[Unknown],
    *,
    tolerance: float = WEAKEST,
    free: np.ndarray | None = None,
    measurements: int | None = None,
) -> Determinability:
    """What data with these derivatives determine.

    Args:
        jacobian: (n, p) derivatives of the readings, each divided by its standard uncertainty (or multiplied by the inverse root of
            the readings' covariance), by the unknowns in their own units; or a triangular factor of it.
        unknowns: p of them, in the order of the columns.
        tolerance: singular values at or below it, in plausible units, are not seen. One is where the data say less than was known
            before; to count the rank of the equations themselves, a value above rounding, n·eps·s₁.
        free: (p, f) orthonormal directions in plausible units that are allowed; all if None.
        measurements: for the observability indices; the rows of the Jacobian if None.

    Raises:
        InputError: columns that do not match, a derivative that is not finite, a plausible size or tolerance that is not positive, a
            name twice.
    """
    names = [one.name for one in unknowns]
    matrix = np.asarray(jacobian, dtype=float)
    if matrix.ndim != 2 or matrix.shape[1] != len(names):
        raise InputError(
            "derivatives and unknowns do not match", expected=f"{len(names)} columns", value=f"shape {matrix.shape}"
        )
    if not np.all(np.isfinite(matrix)):
        bad = names[int(np.argmax(np.any(~np.isfinite(matrix), axis=0)))]
        raise InputError("a derivative is not finite", expected="finite numbers", value=bad)
    if len(set(names)) < len(names):
        raise InputError(
            "two unknowns of one name",
            expected="each name once",
            value=next(name for name in names if names.count(name) > 1),
        )
    if not tolerance > 0.0:
        raise InputError("tolerance not positive", expected="a singular value above zero", value=tolerance)
    for one in unknowns:
        if not (0.0 < one.plausible < np.inf and 0.0 < one.factor < np.inf):
            raise InputError(
                f"plausible size of {one.name} not positive", expected=f"a size in {one.unit}", value=one.plausible
            )
    scale = np.array([one.plausible * one.factor for one in unknowns])
    scaled = matrix * scale
    if len(scaled) > scaled.shape[1]:
        scaled = np.linalg.qr(scaled, mode="r")
    _, spectrum = decompose(scaled, scale, free=free, tolerance=tolerance)
    return Determinability(tuple(unknowns), spectrum, tolerance, measurements or len(matrix))


def _echelon(basis: np.ndarray) -> np.ndarray:
    """(p, s) the same space, spanned so that each vector is one on a row of its own where the others are zero."""
    found = np.array(basis)
    count = found.shape[1]
    rows = np.zeros(len(found), dtype=bool)
    for k in range(count):
        size = np.where(rows[:, None], 0.0, np.abs(found[:, k:]))
        row, column = np.unravel_index(int(np.argmax(size)), size.shape)
        found[:, [k, k + int(column)]] = found[:, [k + int(column), k]]
        found[:, k] /= found[row, k]
        others = np.arange(count) != k
        found[:, others] -= np.outer(found[:, k], found[row, others])
        rows[row] = True
    return found
