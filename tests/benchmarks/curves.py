"""Compare bases of error curves: run ``python -m tests.benchmarks.curves`` (half a minute).

Prints three tables: the error of polynomials and cubic splines between the measured positions, with the degree chosen by
cross-validation, for several curves and numbers of positions; the rounding error of one polynomial in five bases and solvers, compared
with exact rational arithmetic; the effect of high relative accuracy on control points from data of different roughness.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import pairwise
from math import comb

import numpy as np
from scipy.interpolate import make_lsq_spline

from twin.numerics.curves import FGBernstein

LENGTH_MM = 500.0
NOISE_UM = 1.0
"""Standard deviation at one position: a tracker's distance at 2 m (at most 0.4 µm + 0.3 µm/m) and the machine's repeatability."""
FOLDS = 5
DRAWS = 20
MOST = 60
IDENTIFIED = 12
"""Highest degree in `twin identify`."""

Curve = Callable[[np.ndarray], np.ndarray]
Fit = Callable[[np.ndarray, np.ndarray, int], Curve]

CURVES: dict[str, Curve] = {
    "smooth": lambda q: 12.0 * np.sin(0.007 * q + 0.3) + 8.0 * (q / LENGTH_MM) ** 2 + 3.0 * np.cos(0.02 * q),
    "waves of 100 mm": lambda q: 10.0 * q / LENGTH_MM + 4.0 * np.sin(2.0 * np.pi * q / 100.0),
    "pitch of 20 mm": lambda q: 10.0 * q / LENGTH_MM + 4.0 * np.sin(2.0 * np.pi * q / 20.0 + 0.4),
    "kinks": lambda q: np.interp(q, [0.0, 130.0, 310.0, 500.0], [0.0, 14.0, -6.0, 9.0]),
    "step": lambda q: 6.0 * q / LENGTH_MM + np.where(q > 265.0, 8.0, 0.0),
}


def chebyshev(q: np.ndarray, y: np.ndarray, degree: int) -> Curve:
    """Fit a polynomial in Chebyshev form."""
    return np.polynomial.Chebyshev.fit(q, y, degree, domain=[0.0, LENGTH_MM])


def spline(q: np.ndarray, y: np.ndarray, intervals: int) -> Curve:
    """Fit a cubic spline by least squares, with equally many positions between knots."""
    inner = np.quantile(q, np.linspace(0.0, 1.0, intervals + 1)[1:-1])
    knots = np.concatenate([[0.0] * 4, inner, [LENGTH_MM] * 4])
    return make_lsq_spline(q, y, knots)  # type: ignore[no-any-return]


def best(fit: Fit, q: np.ndarray, y: np.ndarray, sizes: range) -> tuple[int, Curve]:
    """Return the size with the best cross-validation score on interior positions, and its fit to all positions."""
    fold = np.arange(len(q)) % FOLDS
    fold[[0, -1]] = -1
    scores = {}
    for size in sizes:
        total = 0.0
        try:
            for k in range(FOLDS):
                out = fold == k
                total += float(np.sum((fit(q[~out], y[~out], size)(q[out]) - y[out]) ** 2))
        except (ValueError, np.linalg.LinAlgError):
            continue  # a knot interval without a measured position
        scores[size] = total
    chosen = min(scores, key=lambda size: scores[size])
    return chosen, fit(q, y, chosen)


def held_out() -> None:
    """Print the RMS error on 2000 other positions, over draws of the noise."""
    print(f"error between positions, µm RMS ({DRAWS} draws of {NOISE_UM:g} µm noise; degree or intervals chosen)")
    print(f"  {'curve':16} {'count':>5}  {'degree to 12':>19}  {f'degree to {MOST}':>19}  {'cubic spline':>21}")
    at = np.linspace(0.0, LENGTH_MM, 2001)
    for name, truth in CURVES.items():
        for count in (11, 51, 101):
            q = np.linspace(0.0, LENGTH_MM, count)
            rng = np.random.default_rng(count)
            rows = []
            for _ in range(DRAWS):
                y = truth(q) + NOISE_UM * rng.standard_normal(count)
                most = count * 4 // 5 - 3
                fits = [
                    best(chebyshev, q, y, range(1, min(IDENTIFIED, most) + 1)),
                    best(chebyshev, q, y, range(1, min(MOST, most) + 1)),
                    best(spline, q, y, range(1, most)),
                ]
                rows.append([v for size, f in fits for v in (float(np.sqrt(np.mean((f(at) - truth(at)) ** 2))), size)])
            low, low_degree, p, degree, piecewise, intervals = np.median(rows, axis=0)
            print(
                f"  {name:16} {count:5d}  {low:7.2f} (degree {low_degree:2.0f})  {p:7.2f} (degree {degree:2.0f})"
                f"  {piecewise:6.2f} ({intervals:2.0f} intervals)"
            )


def exact(y: np.ndarray, degree: int) -> list[Fraction]:
    """Return exact control points of the least-squares polynomial at equidistant positions, by Gram polynomials of the index."""
    count = len(y)
    values = [Fraction(float(v)) for v in y]
    numbers = [Fraction(i) for i in range(count)]
    before, now = [Fraction(0)] * count, [Fraction(1)] * count
    coefficients_before, coefficients = [Fraction(0)], [Fraction(1)]
    norm = Fraction(1)
    centre = Fraction(count - 1, 2)
    total = [Fraction(0)] * (degree + 1)
    for k in range(degree + 1):
        fresh = sum(v * v for v in now)
        share = sum(v * p for v, p in zip(values, now, strict=True)) / fresh
        for i, c in enumerate(coefficients):
            total[i] += share * c
        beta = fresh / norm if k else Fraction(0)
        norm = fresh
        longer = [Fraction(0), *coefficients]
        for i, c in enumerate(coefficients):
            longer[i] -= centre * c
        for i, c in enumerate(coefficients_before):
            longer[i] -= beta * c
        coefficients_before, coefficients = coefficients, longer
        before, now = now, [(x - centre) * p - beta * b for x, p, b in zip(numbers, now, before, strict=True)]
    # Convert powers of the index to Bernstein polynomials of x = index/(count − 1).
    scaled = [c * (count - 1) ** i for i, c in enumerate(total)]
    return [
        sum((Fraction(comb(i, k), comb(degree, k)) * scaled[k] for k in range(i + 1)), Fraction(0))
        for i in range(degree + 1)
    ]


def at_exactly(control: list[Fraction], x: Fraction) -> float:
    """Return a point of the curve, by de Casteljau's algorithm in rational arithmetic."""
    row = control
    while len(row) > 1:
        row = [(1 - x) * a + x * b for a, b in pairwise(row)]
    return float(row[0])


def ways(q: np.ndarray, y: np.ndarray, degree: int, at: np.ndarray) -> dict[str, np.ndarray]:
    """Return the least-squares polynomial at some positions, in five bases and solvers."""
    basis = FGBernstein(degree, (0.0, LENGTH_MM))
    found = {}
    for name, matrix in (
        ("power in mm", lambda t: np.vander(t, degree + 1, increasing=True)),
        ("power in u", lambda t: np.vander(2.0 * t / LENGTH_MM - 1.0, degree + 1, increasing=True)),
        ("Chebyshev", lambda t: np.polynomial.chebyshev.chebvander(2.0 * t / LENGTH_MM - 1.0, degree)),
        ("Bernstein", basis.collocation),
    ):
        orthogonal, triangle = np.linalg.qr(matrix(q))
        found[name] = matrix(at) @ np.linalg.solve(triangle, orthogonal.T @ y)
    found["Bernstein, HRA"] = (basis.collocation(at) @ basis.least_squares(q, y[:, None]))[:, 0]
    return found


def rounding() -> None:
    """Print the largest rounding error of the same polynomial at the positions."""
    print("\nrounding error of one least-squares polynomial (waves of 100 mm and noise), largest, nm")
    header = ("power in mm", "power in u", "Chebyshev", "Bernstein", "Bernstein, HRA")
    print(f"  {'count':>5} {'degree':>6}  " + "  ".join(f"{name:>14}" for name in header))
    for count, degree in ((11, 8), (51, 12), (51, 20), (51, 30), (101, 20), (101, 30), (101, 40), (101, 50)):
        q = np.linspace(0.0, LENGTH_MM, count)
        rng = np.random.default_rng(count + degree)
        y = CURVES["waves of 100 mm"](q) + NOISE_UM * rng.standard_normal(count)
        control = exact(y, degree)
        numbers = [Fraction(i, count - 1) for i in range(0, count, 5)]
        truth = np.array([at_exactly(control, x) for x in numbers])
        found = ways(q, y, degree, q[::5])
        errors = [1e3 * np.abs(found[name] - truth).max() for name in header]
        print(f"  {count:5d} {degree:6d}  " + "  ".join(f"{e:14.1e}" for e in errors))


def control_points() -> None:
    """Print the relative error of control points by QR and with high relative accuracy, by roughness of the data."""
    print("\ncontrol points: relative error (largest control point / largest datum in brackets)")
    print(f"  {'data':24} {'count':>5} {'degree':>6}  {'ordinary':>9}  {'HRA':>9}  {'size':>9}")
    for count, degree in ((11, 10), (21, 20), (51, 20), (51, 50), (101, 40)):
        q = np.linspace(0.0, LENGTH_MM, count)
        rng = np.random.default_rng(count)
        smooth = CURVES["smooth"](q)
        for name, y in (
            ("smooth", smooth),
            ("smooth and noise", smooth + NOISE_UM * rng.standard_normal(count)),
            ("random", rng.standard_normal(count)),
            ("alternating", (-1.0) ** np.arange(count) * (1.0 + rng.uniform(size=count))),
        ):
            basis = FGBernstein(degree, (0.0, LENGTH_MM))
            truth = np.array([float(c) for c in exact(y, degree)])
            accurate = basis.least_squares(q, y[:, None])[:, 0]
            orthogonal, triangle = np.linalg.qr(basis.collocation(q))
            ordinary = np.linalg.solve(triangle, orthogonal.T @ y)
            size = np.linalg.norm(truth)
            errors = [np.linalg.norm(c - truth) / size for c in (ordinary, accurate)]
            print(
                f"  {name:24} {count:5d} {degree:6d}  {errors[0]:9.1e}  {errors[1]:9.1e}  "
                f"{np.abs(truth).max() / np.abs(y).max():9.1e}"
            )


def main() -> None:
    """Print all tables."""
    held_out()
    rounding()
    control_points()


if __name__ == "__main__":
    main()
