"""Cells of a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin._common.csv_tables import Cells
from twin._common.errors import InputError


def directions(*cells: str) -> np.ndarray:
    return Cells(Path("a.csv"), {"side": 0}, [(2 + i, [cell]) for i, cell in enumerate(cells)]).signs("side")


def test_directions_are_read_and_an_empty_cell_is_none() -> None:
    assert directions("1", "-1", "", "+1", "0").tolist() == [1.0, -1.0, 0.0, 1.0, 0.0]


@pytest.mark.parametrize("wrong", ["2", "0.5", "-3"])
def test_one_wrong_direction_among_others_is_refused_with_its_line(wrong: str) -> None:
    with pytest.raises(InputError) as error:
        directions("1", "-1", wrong, "1")
    assert error.value.line == 4 and error.value.value == float(wrong)
