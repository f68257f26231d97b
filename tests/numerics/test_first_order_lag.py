"""The recursion of the lag by cumulative products, against the loop that defines it."""

from __future__ import annotations

import numpy as np
import pytest

from twin.numerics.functions import _recursion


@pytest.mark.parametrize("fastest", [0.0, 1e-9, 0.5, 0.999])
def test_the_recursion_by_blocks_is_that_of_a_loop(fastest: float) -> None:
    """Also with decays that underflow together or alone, and without any."""
    rng = np.random.default_rng(3)
    decay = rng.uniform(fastest, 1.0, 2000)
    decay[rng.integers(0, 2000, 50)] = fastest
    driven = rng.standard_normal(2000)
    truth, last = [], 1.7
    for share, more in zip(decay.tolist(), driven.tolist(), strict=True):
        last = share * last + more
        truth.append(last)
    np.testing.assert_allclose(_recursion(decay, driven, 1.7), truth, rtol=0.0, atol=1e-11)
    assert len(_recursion(decay[:0], driven[:0], 1.7)) == 0
