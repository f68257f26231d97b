"""Tests of `json_form`, which makes the data of every `--json` file."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest

from twin._common.records import json_form


@dataclass(frozen=True)
class _Inner:
    size: float


@dataclass(frozen=True)
class _Outer:
    name: str
    sizes: np.ndarray
    inner: tuple[_Inner, ...]
    hidden: object
    count: np.int64


def test_fields_are_written_in_order_and_renamed() -> None:
    outer = _Outer("a", np.array([1.0, np.nan]), (_Inner(np.inf),), object(), np.int64(3))
    form = json_form(outer, rename={"inner": "parts"}, leave_out=("hidden",))
    assert json.dumps(form) == '{"name": "a", "sizes": [1.0, null], "parts": [{"size": null}], "count": 3}'


def test_what_has_no_form_is_refused() -> None:
    with pytest.raises(TypeError, match="cannot convert object to JSON"):
        json_form({"a": object()})
