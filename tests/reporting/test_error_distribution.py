"""The distribution of the tool's error over drawn machines, machine by machine."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from twin.reporting import compensation
from twin.reporting.compensation import _Deviations


@pytest.mark.parametrize("at_once", [7, 1000])
def test_errors_of_drawn_machines_one_by_one(at_once: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """64 machines at four poses: RMS and maximum of each, their mean and 95 % interval, and every other magnitude."""
    monkeypatch.setattr(compensation, "MACHINES", 64)
    monkeypatch.setattr(compensation, "MACHINES_A_STEP", at_once)
    monkeypatch.setattr(compensation, "SIZES", 128)
    rng = np.random.default_rng(6)
    rates, drawn, error = rng.normal(size=(4, 3, 4)), rng.normal(size=(4, 64)), rng.normal(size=(4, 3))
    tool = SimpleNamespace(
        parameters=("a", "b", "c", "d"), point_rates=lambda q, sides: rates, draw=lambda rng, count: drawn[:, :count]
    )
    found = _Deviations(tool, np.zeros((4, 5)), np.zeros((4, 5)), 1).distribution("one", error)  # type: ignore[arg-type]
    sizes = np.array([[np.linalg.norm(error[i] + rates[i] @ drawn[:, k]) for i in range(4)] for k in range(64)])
    for spread, each in zip(found.machines or (), (np.sqrt((sizes**2).mean(axis=1)), sizes.max(axis=1)), strict=True):
        expected = (each.mean(), np.quantile(each, 0.025), np.quantile(each, 0.975), each.max())
        assert (spread.mean, spread.low, spread.high, spread.largest) == pytest.approx(expected)
    # 256 magnitudes, of which 128 are kept, each the upper one of a pair.
    assert found.size_um == pytest.approx(np.sort(sizes.ravel())[1::2])
    assert found.max_um == pytest.approx(sizes.max(axis=1).mean())
