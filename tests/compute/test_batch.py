"""Functions of many rows at once, compared with the same function row by row."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from twin.compute import along as batch
from twin.compute.native import compiler


@pytest.mark.parametrize("rows", [0, 1, 4, 5, 6, 7, 8, 14, 15, 16, 23, 29, 31])
@pytest.mark.parametrize("many", [10, 1000])
def test_rows_do_not_depend_on_chunks(rows: int, many: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Large chunks of seven rows and small ones of three, padded at the end; one input for all rows; a sparse output."""
    monkeypatch.setenv(compiler.SWITCH_VARIABLE, "0")
    monkeypatch.setattr(batch, "CHUNK", 7)
    monkeypatch.setattr(batch, "SMALL_CHUNK", 3)
    monkeypatch.setattr(batch, "MANY", many)
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y", 3)
    outputs = [ca.vertcat(ca.erf(x[0]) + y[2], x[1] * y[0]), ca.SX(1, 1) + x[0] - y[1], ca.vertcat(ca.SX(1, 1), x[0])]
    function = ca.Function("f", [x, y], outputs)
    rng = np.random.default_rng(5)
    at, shared = rng.normal(size=(rows, 2)), rng.normal(size=3)
    found = batch.BatchFunction(function)(at, shared)
    for k, width in enumerate((2, 1, 2)):
        expected = [np.array(function(row, shared)[k]).ravel() for row in at]
        assert found[k] == pytest.approx(np.reshape(expected, (rows, width)), abs=1e-14)
