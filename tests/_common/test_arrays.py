"""Array helpers against the plain comparison of every value."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin._common.arrays import WIDE, all_within, largest_first, outside_bounds


@given(
    rows=st.integers(0, 3 * WIDE),
    columns=st.integers(1, 6),
    seed=st.integers(0, 2**32 - 1),
    odd=st.sampled_from([None, np.nan, np.inf, -np.inf, 1.5, -1.5]),
    by_columns=st.booleans(),
)
def test_values_within_bounds(*, rows: int, columns: int, seed: int, odd: float | None, by_columns: bool) -> None:
    rng = np.random.default_rng(seed)
    lower, upper = np.sort(rng.uniform(-1.0, 1.0, (2, columns)), axis=0)
    values = rng.uniform(lower, upper, (rows, columns))
    if by_columns:
        values = np.asfortranarray(values)
    if odd is not None and rows:
        values[rng.integers(rows), rng.integers(columns)] = odd
    inside = (values >= lower) & (values <= upper)
    assert all_within(values, lower, upper) == inside.all()
    np.testing.assert_array_equal(outside_bounds(values, lower, upper), (values < lower) | (values > upper))


def test_a_bound_that_is_reached_is_within() -> None:
    values = np.tile([[0.0, 5.0], [1.0, 6.0]], (WIDE, 1))
    assert all_within(values, np.array([0.0, 5.0]), np.array([1.0, 6.0]))
    assert not all_within(values, np.array([0.0, 5.0]), np.array([1.0, 5.9]))
    assert not all_within(values, np.array([0.1, 5.0]), np.array([1.0, 6.0]))


def test_values_equal_up_to_rounding_keep_their_order() -> None:
    rng = np.random.default_rng(1)
    values = rng.integers(0, 5, 200) / 3.0
    last = values * (1.0 + np.finfo(float).eps * rng.choice([-2.0, 0.0, 2.0], 200))
    expected = sorted(range(200), key=lambda i: (-values[i], i))
    assert largest_first(values).tolist() == largest_first(last).tolist() == expected
    assert largest_first(np.array([-np.inf, 1.0, np.inf, -np.inf, 2.0])).tolist() == [2, 4, 1, 0, 3]
    assert largest_first(np.zeros(0)).tolist() == []
