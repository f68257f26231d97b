"""Observability: which unknowns the data determine, and which are confounded.

Every unknown is scaled by its plausible size (its prior standard deviation) and every reading by its standard uncertainty. A singular
value of the derivatives is then a signal-to-noise ratio: below one, the data add less information on that direction than the prior has.
Directions with singular values below the tolerance span the null space. The leverage of an unknown, its share in the null space, says
whether it is identifiable at all and with which unknowns it is confounded.

The leverage does not depend on the basis of the null space. The independence factors of T. Wen, J. Hu, Y. Zhu and G. Hua
(Multi-axis laser interferometer not affected by installation errors based on nonlinear computation, Appl. Sci. 13 (2023) 10887) do,
and they depend on the units and the truncation too.

Y. Sun, J. M. Hollerbach: Observability index selection for robot calibration, ICRA 2008, 831-836.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.errors import InputError

SINGULAR_VALUE_TOLERANCE: Final = 1.0
"""Directions with smaller singular values, in plausible units, count as not observable."""
NOT_DETERMINED: Final = 0.25
"""An unknown is not determined if more than this share of its prior variance remains."""
LEAST_SHARE_NAMED: Final = 0.01
"""The text of a direction omits unknowns that alone would change the readings by less than this share of the largest change."""
MOST_NAMED: Final = 6
"""Unknowns named in one sentence, at most; the others are counted."""
EARLIER: Final = 1e-3
"""Extra weight of the last unknown against the first: of two directions that change the readings equally, the one of the unknowns that
come first is named. A solver of linear programmes compares to 1e-7."""
LARGE_PROBLEM: Final = 20_000
"""Entries of a null-space basis above which the sparse direction, a linear programme of seconds, is replaced by a projection."""


@final
@dataclass(frozen=True)
class Spectrum:
    """Singular values of whitened derivatives, with the observable directions and the null space, in plausible units."""

    scale: np.ndarray  # (p,) plausible sizes, in the units of the derivatives
    # (f,) singular values of all f allowed directions, descending; zero where there are fewer readings
    values: np.ndarray
    directions: np.ndarray  # (p, d) orthonormal directions with singular values above the tolerance
    null_space: np.ndarray  # (p, f − d) the other directions, orthonormal

    @property
    def singular_values(self) -> np.ndarray:
        """(d,) singular values of the observable directions."""
        return np.asarray(self.values[: self.directions.shape[1]])

    @property
    def rank(self) -> int:
        """Number of observable directions."""
        return self.directions.shape[1]

    def covariance(self, *, null_space: bool = True) -> np.ndarray:
        """Return the covariance (p, p) in the units of the derivatives; the null space has its prior variance, or none."""
        root = self.directions / self.singular_values
        if null_space:
            root = np.concatenate([root, self.null_space], axis=1)
        root = root * self.scale[:, None]
        return np.asarray(root @ root.T)

    @property
    def leverage(self) -> np.ndarray:
        """(p,) share of each unknown, in plausible units, in the null space, 0 to 1.

        It is the diagonal of the projector on the null space: 0 where no null direction contains the unknown, 1 where the data contain
        no information on it.
        """
        return np.asarray(np.sum(self.null_space**2, axis=1))

    @property
    def reach(self) -> np.ndarray:
        """(p,) prior standard deviation of each unknown within the null space, in the units of the derivatives."""
        return np.asarray(np.sqrt(self.leverage) * self.scale)

    @property
    def effect(self) -> np.ndarray:
        """(p,) change of the whitened readings (root of the sum of squares) when each unknown alone changes by its plausible size."""
        return np.asarray(np.sqrt(self.directions**2 @ self.singular_values**2))

    @property
    def remaining_variance(self) -> np.ndarray:
        """(p,) share of each unknown's prior variance that remains: near one where the data contain no information on it."""
        observable = np.sum(self.directions**2 / (self.singular_values**2 + 1.0), axis=1)
        return np.asarray(observable + self.leverage)


def decompose(
    matrix: np.ndarray,
    scale: np.ndarray,
    *,
    free: np.ndarray | None = None,
    tolerance: float = SINGULAR_VALUE_TOLERANCE,
) -> tuple[np.ndarray, Spectrum]:
    """Decompose derivatives (n, p) of whitened readings by unknowns in plausible units into observable directions and null space.

    ``scale`` (p,) are the plausible sizes, ``free`` (p, f) the orthonormal directions in which the unknowns may vary; all if None.
    Singular values at or below the tolerance count as zero. Returns (n, d) left singular vectors of the observable directions, and the
    spectrum.
    """
    allowed = np.eye(matrix.shape[1]) if free is None else free
    left, values, right = np.linalg.svd(matrix @ allowed, full_matrices=True)
    observable = int(np.count_nonzero(values > tolerance))
    all_values = np.zeros(allowed.shape[1])
    all_values[: len(values)] = values
    return left[:, :observable], Spectrum(
        read_only(np.array(scale)),
        read_only(all_values),
        read_only(allowed @ right[:observable].T),
        read_only(allowed @ right[observable:].T),
    )


@final
@dataclass(frozen=True)
class Unknown:
    """One unknown parameter."""

    name: str
    unit: str
    plausible: float  # prior standard deviation, in that unit
    factor: float = 1.0  # one such unit in the units of the derivatives (1e-3 for mm where these are per metre)


@final
@dataclass(frozen=True)
class UnknownMove:
    """Change of one unknown along a null direction, in its stated unit."""

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
    """A combination of changes of unknowns that does not change the readings noticeably."""

    # the changes, in descending order of the change of the readings due to each alone; a requested unknown comes first
    moves: tuple[UnknownMove, ...]
    change: float  # change of the readings due to all of them, root of the sum of squares in standard uncertainties
    left_out: int  # number of further unknowns that are not in ``moves``

    def __str__(self) -> str:
        first, *others = (str(move) for move in self.moves)
        more = f" and {self.left_out} more by less" if self.left_out else ""
        return f"{first} alone{more}" if not others else f"{first} with {', '.join(others)}{more}"

    def shortened(self, count: int) -> NullDirection:
        """Return the direction with at most ``count`` moves named."""
        kept = self.moves[:count]
        return NullDirection(kept, self.change, self.left_out + len(self.moves) - len(kept))


@final
@dataclass(frozen=True)
class Observability:
    """Observability indices of robot calibration, larger is better (Sun and Hollerbach 2008, eq. 4 to 8); zero without full rank."""

    o1: float  # (s₁ s₂ … s_L)^(1/L) / √m, the geometric mean over all directions (Borm and Menq 1989)
    o2: float  # s_L / s₁, inverse condition number (Driels and Pathre 1990)
    o3: float  # s_L, the worst direction (Nahvi, Hollerbach and Hayward 1994)
    o4: float  # s_L² / s₁, noise amplification index (Nahvi and Hollerbach 1996)
    o5: float  # 1 / (1/s₁ + … + 1/s_L) (Sun and Hollerbach 2008)


def observability(values: np.ndarray, measurements: int) -> Observability:
    """Return the observability indices of (L,) singular values from m measurements (of poses, where one measurement is a pose)."""
    if len(values) == 0 or measurements < 1:
        raise InputError(
            "observability needs singular values and measurements",
            expected="at least one singular value and one measurement",
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
    """Whether and how well the data determine each unknown."""

    unknowns: tuple[Unknown, ...]
    spectrum: Spectrum
    tolerance: float  # singular values at or below it count as zero
    measurements: int  # number of measurements for the observability indices

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, in their order."""
        return tuple(unknown.name for unknown in self.unknowns)

    @property
    def remaining_variance(self) -> np.ndarray:
        """(p,) share of each unknown's prior variance that remains (`Spectrum.remaining_variance`)."""
        return self.spectrum.remaining_variance

    def null_direction_of(self, name: str) -> NullDirection | None:
        """Return the null direction that contains an unknown and the fewest others; None if the unknown is hardly in the null space.

        Among all null directions with a unit change of the unknown, it minimises the sum of the changes of the readings that each move
        alone would cause. This linear programme yields a sparse direction (Chen, Donoho and Saunders 1998), whatever the basis of the
        null space. Hardly: by less than `LEAST_SHARE_NAMED` of its plausible size.

        Raises:
            KeyError: there is no unknown of that name.
        """
        if name not in self.names:
            raise KeyError(name)
        index = self.names.index(name)
        null_space = self.spectrum.null_space
        if float(np.linalg.norm(null_space[index])) < LEAST_SHARE_NAMED:
            return None
        if null_space.shape[1] == 1 or null_space.size > LARGE_PROBLEM:
            return self._direction(null_space @ null_space[index], first=index)
        effect = self.spectrum.effect
        # A small positive weight for unknowns without effect on the readings makes the solution unique.
        weight = np.maximum(effect, 1e-9 * max(float(effect.max(initial=0.0)), 1.0))
        basis, _ = np.linalg.qr(weight[:, None] * null_space)
        p, s = basis.shape
        above = np.concatenate([np.concatenate([basis, -basis]), -np.tile(np.eye(p), (2, 1))], axis=1)
        solution = scipy.optimize.linprog(
            np.concatenate([np.zeros(s), np.linspace(1.0, 1.0 + EARLIER, p)]),
            A_ub=above,
            b_ub=np.zeros(2 * p),
            A_eq=np.concatenate([basis[index], np.zeros(p)])[None],
            b_eq=[1.0],
            bounds=[(None, None)] * s + [(0.0, None)] * p,
        )
        # If the solver fails, use the projection of the unknown on the null space, which contains more unknowns.
        vector = basis @ solution.x[:s] / weight if solution.success else null_space @ null_space[index]
        return self._direction(vector, first=index)

    def _direction(self, vector: np.ndarray, first: int | None = None) -> NullDirection:
        # Weighted by effect, not by plausible size: a station is known to metres only, yet millimetres of it compensate an error.
        vector = vector / np.abs(vector).max()
        weight = np.abs(vector) * self.spectrum.effect
        # If no unknown alone has a noticeable effect, only the largest is named.
        weight = (
            weight if weight.max() > self.tolerance * LEAST_SHARE_NAMED else np.where(np.abs(vector) == 1.0, 1.0, 0.0)
        )
        share = np.round(weight / weight.max(), 6)
        order = [int(i) for i in np.argsort(-share, kind="stable") if share[i] >= LEAST_SHARE_NAMED]
        if first is not None:
            order = [first, *(i for i in order if i != first)]
        vector = vector if vector[order[0]] > 0.0 else -vector
        moves = []
        for i in order[:MOST_NAMED]:
            one = self.unknowns[i]
            moves.append(UnknownMove(one.name, float(vector[i]) * one.plausible, one.unit))
        along = self.spectrum.null_space.T @ vector
        change = float(np.linalg.norm(self.spectrum.values[self.spectrum.rank :] * along))
        return NullDirection(tuple(moves), change, max(len(order) - MOST_NAMED, 0))


def determinability(
    jacobian: np.ndarray,
    unknowns: Sequence[Unknown],
    *,
    tolerance: float = SINGULAR_VALUE_TOLERANCE,
    free: np.ndarray | None = None,
    measurements: int | None = None,
) -> Determinability:
    """Return what data with these derivatives (n, p) by the unknowns, in their own units, determine.

    The derivatives of the readings are divided by their standard uncertainties (or multiplied by the inverse root of the readings'
    covariance), or are a triangular factor of these. Singular values at or below the tolerance, in plausible units, count as zero: at
    one, the data and the prior have the same information; for the rank of the equations themselves, use a value above rounding,
    n·eps·s₁. ``free`` is as for `decompose`; ``measurements`` is that of the observability indices, the rows of the Jacobian if None.

    Raises:
        InputError: columns that do not match, a derivative that is not finite, a plausible size or tolerance that is not positive, a
            name twice.
    """
    names = [unknown.name for unknown in unknowns]
    matrix = np.asarray(jacobian, dtype=float)
    if matrix.ndim != 2 or matrix.shape[1] != len(names):
        raise InputError(
            "number of columns and unknowns differ", expected=f"{len(names)} columns", value=f"shape {matrix.shape}"
        )
    if not np.all(np.isfinite(matrix)):
        bad = names[int(np.argmax(np.any(~np.isfinite(matrix), axis=0)))]
        raise InputError("a derivative is not finite", expected="finite numbers", value=bad)
    if len(set(names)) < len(names):
        raise InputError(
            "two unknowns have the same name",
            expected="each name once",
            value=next(name for name in names if names.count(name) > 1),
        )
    if not tolerance > 0.0:
        raise InputError("tolerance must be positive", expected="a singular value above zero", value=tolerance)
    for unknown in unknowns:
        if not (0.0 < unknown.plausible < np.inf and 0.0 < unknown.factor < np.inf):
            raise InputError(
                f"plausible size of {unknown.name} must be positive",
                expected=f"a size in {unknown.unit}",
                value=unknown.plausible,
            )
    scale = np.array([unknown.plausible * unknown.factor for unknown in unknowns])
    scaled = matrix * scale
    if len(scaled) > scaled.shape[1]:
        scaled = np.linalg.qr(scaled, mode="r")
    _, spectrum = decompose(scaled, scale, free=free, tolerance=tolerance)
    return Determinability(tuple(unknowns), spectrum, tolerance, measurements or len(matrix))
