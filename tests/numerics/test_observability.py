"""Observability, compared with null spaces in exact rationals, ordinary least squares and closed forms."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import scipy.linalg
import statsmodels.api as sm

from tests.numerics.independence import independence_factors
from twin._common.errors import InputError
from twin.numerics.observability import (
    Determinability,
    Observability,
    Unknown,
    decompose,
    determinability,
    observability,
)


def plain(count: int, plausible: float = 1.0) -> list[Unknown]:
    return [Unknown(f"p{i}", "mm", plausible) for i in range(count)]


def deficient(rng: np.random.Generator, rows: int, columns: int, rank: int) -> np.ndarray:
    return rng.standard_normal((rows, rank)) @ rng.standard_normal((rank, columns)) * 1e3


def exact_null_space(matrix: list[list[int]]) -> list[list[Fraction]]:
    """Return the null space by Gauss-Jordan elimination in rationals: one vector for each column without a pivot."""
    rows = [[Fraction(v) for v in row] for row in matrix]
    pivots: list[int] = []
    for column in range(len(rows[0])):
        at = next((i for i in range(len(pivots), len(rows)) if rows[i][column] != 0), None)
        if at is None:
            continue
        k = len(pivots)
        rows[k], rows[at] = rows[at], rows[k]
        rows[k] = [v / rows[k][column] for v in rows[k]]
        for i, row in enumerate(rows):
            if i != k and row[column] != 0:
                rows[i] = [a - row[column] * b for a, b in zip(row, rows[k], strict=True)]
        pivots.append(column)
    found = []
    for column in range(len(rows[0])):
        if column not in pivots:
            vector = [Fraction(0)] * len(rows[0])
            vector[column] = Fraction(1)
            for i, pivot in enumerate(pivots):
                vector[pivot] = -rows[i][column]
            found.append(vector)
    return found


@pytest.mark.parametrize(("rows", "columns", "rank"), [(40, 12, 9), (12, 12, 12), (7, 12, 7), (200, 30, 22)])
def test_rank_and_leverage_are_those_of_the_null_space(rows: int, columns: int, rank: int) -> None:
    jacobian = deficient(np.random.default_rng(rows), rows, columns, rank)
    found = determinability(jacobian, plain(columns))
    null = scipy.linalg.null_space(jacobian)
    assert found.spectrum.rank == rank == columns - null.shape[1]
    # Two factorisations in double precision of a matrix whose condition is a few hundred.
    assert np.abs(found.spectrum.leverage - np.sum(null**2, axis=1)).max() < 1e-12


def test_an_unknown_of_no_leverage_is_one_whose_column_carries_rank() -> None:
    """Theorem 2 of Wen et al., column by column: x_n is unique if its column is independent of the others."""
    rng = np.random.default_rng(7)
    jacobian = np.hstack([rng.standard_normal((30, 4)), deficient(rng, 30, 5, 3) / 1e3]) * 1e3
    found = determinability(jacobian, plain(9))
    alone = [np.linalg.matrix_rank(np.delete(jacobian, i, axis=1)) < np.linalg.matrix_rank(jacobian) for i in range(9)]
    assert [bool(v < 1e-12) for v in found.spectrum.leverage] == alone
    assert alone == [True] * 4 + [False] * 5


def test_null_directions_solve_the_exact_equations() -> None:
    matrix = [[1, 2, 0, -1, 3], [0, 1, 1, 0, -2], [1, 3, 1, -1, 1]]
    found = determinability(np.array(matrix, dtype=float) * 1e6, plain(5))
    assert found.spectrum.rank == 2
    exact = np.array([[float(v) for v in vector] for vector in exact_null_space(matrix)])
    for name in found.names:
        direction = found.null_direction_of(name)
        assert direction is not None
        moves = dict.fromkeys(found.names, 0.0) | {move.name: move.value for move in direction.moves}
        vector = np.array([moves[name] for name in found.names])
        left = vector - np.linalg.lstsq(exact.T, vector, rcond=None)[0] @ exact
        assert np.abs(left).max() < 1e-9  # a solver of linear programmes gave it
        assert np.abs(vector).max() == pytest.approx(1.0)
        assert direction.change < 1e-3


def test_words_name_what_moves_together_with_sign_and_unit() -> None:
    """A station's x in mm and an axis's place in µm read as one sum."""
    jacobian = np.array([[1e6, 1.0, 0.0], [2e6, 2.0, 0.0], [0.0, 0.0, 1.0]])
    unknowns = [Unknown("station 1 x", "mm", 1.0, 1e-3), Unknown("E_X0C", "um", 1000.0), Unknown("E_A0C", "urad", 9.0)]
    found = determinability(jacobian, unknowns)
    assert str(found.null_direction_of("station 1 x")) == "station 1 x +1 mm with E_X0C -1000 µm"
    assert str(found.null_direction_of("E_X0C")) == "E_X0C +1000 µm with station 1 x -1 mm"
    assert found.null_direction_of("E_A0C") is None
    assert np.allclose(found.spectrum.leverage, [0.5, 0.5, 0.0])
    assert np.allclose(found.spectrum.reach, [1e-3 * np.sqrt(0.5), 1000.0 * np.sqrt(0.5), 0.0])
    assert standard_uncertainties(found)[2] == pytest.approx(1.0)


def test_an_unknown_without_readings_is_named_alone() -> None:
    found = determinability(np.array([[5.0, 0.0]]), [Unknown("a", "um", 1.0), Unknown("b", "um", 3.0)])
    assert (found.null_direction_of("a"), str(found.null_direction_of("b"))) == (None, "b +3 µm alone")
    assert np.allclose(found.remaining_variance, [1.0 / 26.0, 1.0])


def test_of_all_directions_that_move_an_unknown_the_one_with_the_fewest_others_is_named() -> None:
    """Ten pairs of which only the sums are observable, in an arbitrary basis of the null space: each is named with its partner only."""
    rng = np.random.default_rng(19)
    pairs = np.repeat(np.eye(10), 2, axis=1)
    jacobian = rng.standard_normal((40, 10)) @ pairs * rng.uniform(1.0, 1e4, 20)
    found = determinability(jacobian, plain(20, 1e3))
    assert found.spectrum.rank == 10
    for i in range(20):
        direction = found.null_direction_of(f"p{i}")
        assert direction is not None
        assert [move.name for move in direction.moves] == [f"p{i}", f"p{i + 1 - 2 * (i % 2)}"]
        assert direction.change < 1e-5


def test_a_small_part_of_a_large_plausible_size_is_named() -> None:
    """A station is known to metres only; its movement by a millimetre, which compensates an error, is named all the same."""
    unknowns = [Unknown("E_X0B", "um", 1000.0), Unknown("station 1 x", "mm", 1e4, 1e3)]
    found = determinability(np.array([[1.0, -1.0]]), unknowns)
    assert str(found.null_direction_of("E_X0B")) == "E_X0B +1000 µm with station 1 x +1 mm"
    assert found.spectrum.leverage[1] < 1e-7 < 0.99 < found.spectrum.leverage[0]


def test_a_long_direction_is_cut_and_counted() -> None:
    jacobian = np.eye(12) * 1e3
    jacobian -= jacobian.mean(axis=1, keepdims=True)
    only = determinability(jacobian, plain(12)).null_direction_of("p0")
    assert only is not None
    assert (len(only.moves), only.left_out) == (6, 6)
    assert str(only).endswith("and 6 more by less")


def standard_uncertainties(found: Determinability) -> np.ndarray:
    return np.sqrt(np.diag(found.spectrum.covariance(null_space=False)))


def test_standard_uncertainties_are_those_of_ordinary_least_squares() -> None:
    rng = np.random.default_rng(3)
    jacobian = rng.standard_normal((50, 6)) * [1.0, 10.0, 0.1, 1.0, 3.0, 2.0]
    sigma = rng.uniform(0.5, 2.0, 50)
    # Plausible sizes so large that they say nothing.
    found = determinability(jacobian / sigma[:, None], plain(6, 1e4))
    answer = sm.WLS(rng.standard_normal(50), jacobian, weights=1.0 / sigma**2).fit()
    assert np.allclose(standard_uncertainties(found), np.sqrt(np.diag(answer.normalized_cov_params)), rtol=1e-10)
    with_prior = np.linalg.inv(np.eye(6) + jacobian.T @ (jacobian / sigma[:, None] ** 2) * 1e8)
    assert np.allclose(found.remaining_variance, np.diag(with_prior), rtol=1e-6)


def test_units_change_nothing_but_the_stated_numbers() -> None:
    """Millimetres and milliradians, or metres and radians, give the same result."""
    rng = np.random.default_rng(11)
    jacobian = deficient(rng, 30, 8, 6)
    factor = 10.0 ** rng.integers(-6, 7, 8)
    found = determinability(jacobian, plain(8, 2.0))
    other = determinability(jacobian * factor, [Unknown(f"p{i}", "mm", 2.0, 1.0 / f) for i, f in enumerate(factor)])
    third = determinability(jacobian * factor, [Unknown(f"p{i}", "?", 2.0 / f) for i, f in enumerate(factor)])
    for one in (other, third):
        assert np.allclose(one.spectrum.leverage, found.spectrum.leverage, atol=1e-10)
        assert np.allclose(one.spectrum.values, found.spectrum.values, rtol=1e-10, atol=1e-7)
    assert np.allclose(third.spectrum.reach * factor, found.spectrum.reach)
    # The independence factors do not survive it.
    gap = 1.0
    before = independence_factors(jacobian, threshold=gap).factors
    assert np.abs(independence_factors(jacobian * factor, threshold=gap).factors - before).max() > 0.1


def test_a_triangular_factor_serves_as_well() -> None:
    jacobian = deficient(np.random.default_rng(5), 60, 7, 5)
    whole = determinability(jacobian, plain(7))
    factor = determinability(np.linalg.qr(jacobian, mode="r"), plain(7), measurements=60)
    assert np.allclose(factor.spectrum.leverage, whole.spectrum.leverage, atol=1e-12)
    assert factor.spectrum.rank == whole.spectrum.rank
    assert factor.measurements == whole.measurements


def test_constraints_reduce_the_null_space() -> None:
    """Heights known only by their differences are determined if their sum is fixed."""
    heights = np.eye(5) - np.roll(np.eye(5), 1, axis=1)
    free = scipy.linalg.null_space(np.ones((1, 5)))
    assert determinability(heights * 1e3, plain(5)).spectrum.rank == 4
    held = determinability(heights * 1e3, plain(5), free=free)
    assert (held.spectrum.rank, [held.null_direction_of(name) for name in held.names]) == (4, [None] * 5)
    assert np.abs(held.spectrum.leverage).max() == 0.0


def test_a_direction_weaker_than_the_prior_is_not_observable() -> None:
    """At tolerance one, a reading that determines an unknown to 1.25 µm adds less than its prior of 1 µm."""
    weak = determinability(np.array([[0.8]]), plain(1))
    direction = weak.null_direction_of("p0")
    assert direction is not None and direction.change == pytest.approx(0.8)
    assert (weak.spectrum.rank, weak.remaining_variance[0]) == (0, 1.0)
    assert determinability(np.array([[0.8]]), plain(1), tolerance=0.5).spectrum.rank == 1
    strong = determinability(np.array([[4.0]]), plain(1))
    assert strong.remaining_variance[0] == pytest.approx(1.0 / 17.0)


def indices(jacobian: np.ndarray, measurements: int) -> Observability:
    return observability(determinability(jacobian, plain(jacobian.shape[1])).spectrum.values, measurements)


def test_observability_indices_are_those_of_the_definition() -> None:
    """Compare with determinants, eigenvalues and norms instead of singular values."""
    jacobian = np.random.default_rng(13).standard_normal((24, 5)) * 30.0
    normal = jacobian.T @ jacobian
    found = indices(jacobian, 8)
    low, high = np.sqrt(np.linalg.eigvalsh(normal)[[0, -1]])
    assert found.o1 == pytest.approx(np.linalg.det(normal) ** 0.1 / np.sqrt(8.0))
    assert found.o2 == pytest.approx(1.0 / np.linalg.cond(jacobian))
    assert found.o3 == pytest.approx(1.0 / np.linalg.norm(np.linalg.pinv(jacobian), 2))
    assert found.o4 == pytest.approx(low**2 / high)
    assert found.o5 == pytest.approx(1.0 / np.trace(scipy.linalg.sqrtm(np.linalg.inv(normal)).real))
    assert indices(deficient(np.random.default_rng(1), 9, 4, 2), 9).o2 < 1e-12
    assert indices(np.ones((2, 4)), 2).o1 == 0.0


def test_independence_factors_follow_the_printed_steps() -> None:
    """Algorithm 1, lines 2 to 8, through the eigenvectors of the covariance itself."""
    jacobian = np.random.default_rng(17).standard_normal((40, 6)) * [5.0, 3.0, 2.0, 1.0, 0.5, 0.2]
    covariance = np.cov(jacobian, rowvar=False, bias=True)
    values, vectors = np.linalg.eigh(covariance)
    found = independence_factors(jacobian, threshold=0.6)
    kept = values > 0.6
    assert found.rank == np.count_nonzero(kept)
    assert np.allclose(found.eigenvalues, values[::-1])
    assert np.allclose(found.factors, np.abs(vectors[:, kept]).max(axis=1))


@pytest.mark.parametrize(
    ("jacobian", "unknowns", "tolerance", "said"),
    [
        (np.eye(3), plain(2), 1.0, "2 columns"),
        (np.array([[np.nan, 1.0]]), plain(2), 1.0, "'p0'"),
        (np.eye(2), [Unknown("a", "um", 1.0)] * 2, 1.0, "each name once"),
        (np.eye(1), [Unknown("a", "um", 0.0)], 1.0, "a size in um"),
        (np.eye(1), plain(1), 0.0, "above zero"),
    ],
)
def test_invalid_arguments(jacobian: np.ndarray, unknowns: list[Unknown], tolerance: float, said: str) -> None:
    with pytest.raises(InputError, match=said):
        determinability(jacobian, unknowns, tolerance=tolerance)


def test_observability_without_singular_values() -> None:
    with pytest.raises(InputError, match="needs singular values"):
        observability(np.zeros(0), 3)


def test_unknown_name() -> None:
    found: Determinability = determinability(np.eye(1), plain(1))
    with pytest.raises(KeyError):
        found.null_direction_of("p7")


def test_a_signal_as_large_as_the_noise_is_not_observable() -> None:
    """Singular values at the tolerance count as zero, those above it do not."""
    _, spectrum = decompose(np.diag([2.0, 1.0, 1.0 + 1e-9]), np.ones(3))
    assert spectrum.rank == 2 and spectrum.null_space.shape == (3, 1)
    assert abs(spectrum.null_space[1, 0]) == pytest.approx(1.0)
