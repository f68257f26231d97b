"""fg-Bernstein bases, and curves through or near points with high relative accuracy.

Mainar and Peña (Numer. Linear Algebra Appl. 25, 2018) call u_k = C(n,k) f^k g^(n−k), k = 0…n, the fg-Bernstein basis of degree n;
Díaz Pérez et al. (2019), eq. 10, give the bidiagonal factors of its collocation matrix A = (u_k(t_i)) as products and quotients of
differences of the data alone: each is accurate to rounding for any condition number of A.

Here f = φ(x), g = φ(1 − x), x = (t − a)/(b − a): φ(x) = x gives the Bernstein polynomials, φ(x) = sin(Δx)/sin Δ the trigonometric
ones of the paper (f = sin((Δ + s)/2), g = sin((Δ − s)/2), s from −Δ to Δ), but for the sin Δ, with which a curve starts and ends at its
control points. In both, f(x)g(y) − f(y)g(x) = φ(x − y): the differences that eq. 10 needs. Only the polynomials sum to one (the others
to (f + g)^n, up to 2^(n/2) at Δ = π/2), and trigonometric ones of odd degree do not contain a constant.

The rounding error of a curve's value is a small multiple of Σ |c_k| u_k: where the control points are far larger than the curve (a
smooth one over many points, above degree 60 or so) its values are inaccurate although the control points are accurate.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sin
from typing import Any, Final, Literal, final

import numpy as np
import scipy

from twin._common.arrays import read_only
from twin._common.errors import InputError

MOST_DEGREE: Final = 250
"""Largest degree; above it the numbers of eq. 10 may overflow."""
MOST_HALF_ANGLE_RAD: Final = 3.0
"""Largest Δ: at π, f/g is no longer increasing; at 3 rad the middle function of MOST_DEGREE is 1e286."""
PAPER_HALF_ANGLE_RAD: Final = 1.57
"""The paper's Δ."""


@final
@dataclass(frozen=True)
class _Bidiagonal:
    """The factors of a collocation matrix: A = F_{m−1} … F_1 D G_1 … G_n (eq. 3 and 9; m rows, n + 1 columns, rows before columns)."""

    lower: np.ndarray  # (m, n+1) multipliers of the Neville elimination of A below the diagonal, zero elsewhere
    pivots: np.ndarray  # (n+1,) its diagonal pivots
    upper: np.ndarray  # (n+1, n+1) multipliers of the elimination of Aᵀ, below the diagonal, zero elsewhere

    def solve(self, values: np.ndarray) -> np.ndarray:
        """Solve A c = values (n+1, d) for c, A square, in O(n²).

        The inverse of every factor has a checkerboard sign pattern, so that the only cancellation is that of the data: the error of c
        is at most about n roundings of |A⁻¹| |values|, high relative accuracy of each c_k if the values alternate in sign (Koev 2007).
        """
        solution = np.array(values, dtype=float)
        n = len(solution) - 1
        for j in range(n):
            solution[j + 1 :] -= self.lower[j + 1 :, j, None] * solution[j:-1]
        solution /= self.pivots[:, None]
        for j in reversed(range(n)):
            solution[j:-1] -= self.upper[j + 1 :, j, None] * solution[j + 1 :]
        return solution


@final
@dataclass(frozen=True)
class FGBernstein:
    """An fg-Bernstein basis. Raises `InputError`: an empty domain; a degree below 0 or above MOST_DEGREE; an angle out of range."""

    degree: int  # n; there are n + 1 functions
    domain: tuple[float, float] = (0.0, 1.0)  # (a, b) of the parameter, in its own unit
    kind: Literal["polynomial", "trigonometric"] = "polynomial"
    # Δ of the trigonometric kind, more than 0, at most 3: the parameter spans an angle of 2Δ. Not used for polynomials.
    half_angle_rad: float = PAPER_HALF_ANGLE_RAD

    def __post_init__(self) -> None:
        if not 0 <= self.degree <= MOST_DEGREE:
            raise InputError("degree of a curve out of range", expected=f"0 to {MOST_DEGREE}", value=self.degree)
        a, b = self.domain
        if not (a < b and np.isfinite(b - a)):
            raise InputError(
                "the domain is empty or not finite", expected="(a, b) with a < b, both finite", value=self.domain
            )
        if self.kind not in ("polynomial", "trigonometric"):
            raise InputError("unknown kind of curve", expected="polynomial or trigonometric", value=self.kind)
        if self.kind == "trigonometric" and not 0.0 < self.half_angle_rad <= MOST_HALF_ANGLE_RAD:
            raise InputError(
                "half angle out of range",
                expected=f"more than 0, at most {MOST_HALF_ANGLE_RAD:g} rad",
                value=self.half_angle_rad,
            )

    def collocation(self, t: np.ndarray) -> np.ndarray:
        """Return the values (m, n+1) of the functions at parameters (m,) in any order, each accurate to rounding."""
        return read_only(self._values(self._inside(t), self.degree))

    def derivative(self, control: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return the first derivative (m, d) at parameters (m,) of control points (n+1, d), n Σ_k (f' c_{k+1} + g' c_k) u_k^{n−1}."""
        points, inside, n = _points(control, self.degree + 1), self._inside(t), self.degree
        if n == 0:
            return read_only(np.zeros((len(inside), points.shape[1])))
        forward, back = self._slopes(inside)
        lower = self._values(inside, n - 1)
        return read_only(n * (forward * (lower @ points[1:]) + back * (lower @ points[:-1])))

    def least_squares(self, t: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Return the control points (n+1, d) of the least-squares curve through points (m, d) at (m,) increasing parameters.

        A = B A_τ, where τ are n + 1 of the parameters and B holds the values of their Lagrange functions; these are products and so
        accurate to rounding. With well-spaced τ, B is well-conditioned (it contains the identity, so no singular value is below one).
        An ordinary QR fits B to the points, which yields the curve's values at τ; eq. 10 converts these to control points. The error
        is some roundings of |A⁺| |points|, as with the QR factorisation (Marco and Martínez 2010) that the paper uses, in O(m n²)
        operations on whole arrays.

        Raises:
            InputError: parameters outside the domain, not increasing, or fewer than n + 1; wrong number of points, or not finite.
        """
        nodes = self._increasing(t)
        values = _points(points, len(nodes))
        chosen = self._spread(nodes)
        q, triangle = np.linalg.qr(self._lagrange(nodes, chosen))
        return read_only(self._factors(nodes[chosen]).solve(scipy.linalg.solve_triangular(triangle, q.T @ values)))

    def _factors(self, t: np.ndarray) -> _Bidiagonal:
        """Return the factors of the collocation matrix at (m,) increasing parameters, m ≥ n + 1 (eq. 10), each accurate to rounding.

        The paper requires 0 < t_1 and t_m < 1; both ends of the domain are allowed here, since no quotient has a zero divisor there.
        """
        n, m = self.degree, len(t)
        f, g = self._sides(t)
        lower, pivots, upper = np.zeros((m, n + 1)), np.ones(n + 1), np.zeros((n + 1, n + 1))
        product = np.ones(m)
        for j in range(min(n + 1, m - 1)):
            # Rows and columns count from 0. Each column adds one pair of differences to the quotient of products.
            lower[j + 1 :, j] = (g[j + 1 :] / g[j:-1]) ** (n - j) * (g[: m - 1 - j] / g[j:-1]) * product[j + 1 :]
            product[j + 2 :] *= self._difference(t[j + 2 :], t[1 : m - 1 - j])
            product[j + 2 :] /= self._difference(t[j + 1 : -1], t[: m - 2 - j])
        for i in range(n + 1):
            pivots[i] = scipy.special.comb(n, i) * g[i] ** (n - i) * np.prod(self._difference(t[i], t[:i]) / g[:i])
        for i in range(1, n + 1):
            upper[i, :i] = (n - i + 1) / i * (f[:i] / g[:i])
        if not (np.all(pivots > np.finfo(float).tiny) and np.all(np.isfinite(lower)) and np.all(np.isfinite(upper))):
            raise InputError(
                f"parameters too close together for degree {n}",
                expected="a lower degree, or parameters spread over the domain",
                value=f"{t[0]:g} to {t[n]:g}",
            )
        return _Bidiagonal(read_only(lower), read_only(pivots), read_only(upper))

    def _lagrange(self, t: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return the values (m, n+1) at t of the Lagrange functions: one at one chosen parameter, zero at the others."""
        own = (chosen, np.arange(len(chosen)))
        apart = self._difference(t[:, None], t[chosen])
        apart[own] = 1.0
        # Numerator and denominator have the same number of differences: the scale cancels and prevents overflow.
        apart /= np.exp(np.mean(np.log(np.abs(apart[chosen]))))
        apart[own] = 1.0
        lagrange = np.prod(apart, axis=1)[:, None] / apart / np.prod(apart[chosen], axis=1)
        lagrange[chosen] = np.eye(len(chosen))
        return lagrange

    def _spread(self, t: np.ndarray) -> np.ndarray:
        """Return indices of n + 1 well-spaced parameters, increasing (Leja points).

        The determinant of A at them is ∏ φ(x_i − x_j) times a constant; each point maximises its product with those before.
        """
        chosen = [0]
        far = np.zeros(len(t))
        for _ in range(self.degree):
            with np.errstate(divide="ignore"):
                far += np.log(np.abs(self._difference(t, t[chosen[-1]])))
            chosen.append(int(np.argmax(far)))
        return np.sort(chosen)

    def _values(self, t: np.ndarray, degree: int) -> np.ndarray:
        f, g = self._sides(t)
        k = np.arange(degree + 1)
        return np.asarray(scipy.special.comb(degree, k) * f[:, None] ** k * g[:, None] ** (degree - k))

    def _phi(self, x: np.ndarray) -> np.ndarray:
        return x if self.kind == "polynomial" else np.sin(self.half_angle_rad * x) / sin(self.half_angle_rad)

    def _sides(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return f and g, each computed from the end of the domain where it is small."""
        a, b = self.domain
        return self._phi((t - a) / (b - a)), self._phi((b - t) / (b - a))

    def _slopes(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives (m, 1) of f and g by the parameter."""
        a, b = self.domain
        if self.kind == "polynomial":
            slope = np.full((len(t), 1), 1.0 / (b - a))
            return slope, -slope
        rate = self.half_angle_rad / (b - a)
        size = rate / sin(self.half_angle_rad)
        return size * np.cos(rate * (t - a))[:, None], -size * np.cos(rate * (b - t))[:, None]

    def _difference(self, t: Any, s: Any) -> np.ndarray:
        """Return φ(x − y) = f(t)g(s) − f(s)g(t)."""
        a, b = self.domain
        return self._phi((t - s) / (b - a))

    def _inside(self, t: np.ndarray) -> np.ndarray:
        parameters = np.atleast_1d(np.asarray(t, dtype=float))
        a, b = self.domain
        if parameters.ndim != 1:
            raise InputError("wrong shape of the parameters", expected="a list of numbers", value=parameters.shape)
        # Allow for rounding of sums such as k·(b/n).
        slack = 4.0 * np.finfo(float).eps * max(abs(a), abs(b))
        outside = ~((parameters >= a - slack) & (parameters <= b + slack))
        if np.any(outside):
            raise InputError(
                "a parameter is outside the domain", expected=f"{a:g} to {b:g}", value=float(parameters[outside][0])
            )
        return np.clip(parameters, a, b)

    def _increasing(self, t: np.ndarray) -> np.ndarray:
        nodes = self._inside(t)
        wrong = np.flatnonzero(np.diff(nodes) <= 0.0)
        if len(wrong):
            i = int(wrong[0])
            raise InputError(
                "parameters must increase", expected=f"more than {nodes[i]:g} after it", value=float(nodes[i + 1])
            )
        if len(nodes) < self.degree + 1:
            raise InputError(
                f"too few points for a curve of degree {self.degree}",
                expected=f"{self.degree + 1} or more",
                value=len(nodes),
            )
        return nodes


def _points(points: np.ndarray, count: int) -> np.ndarray:
    found = np.asarray(points, dtype=float)
    if found.ndim != 2 or len(found) != count:
        raise InputError("wrong number of points", expected=f"an array of {count} rows", value=found.shape)
    if not np.all(np.isfinite(found)):
        raise InputError("a point is not finite", expected="finite coordinates")
    return found
