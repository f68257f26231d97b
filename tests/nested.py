"""Comparison of reports as JSON data."""

from __future__ import annotations

from typing import Any

import pytest


def alike(one: Any, other: Any, *, rel: float, least: float, texts: bool = True, place: str = "") -> None:
    """Assert that reports agree, numbers to a relative and an absolute tolerance.

    Args:
        one: JSON data.
        other: JSON data.
        rel: relative tolerance.
        least: absolute tolerance.
        texts: whether texts, which may contain rounded numbers, are compared too.
        place: where in the report they stand.
    """
    if isinstance(one, dict):
        assert one.keys() == other.keys(), place
        for key in one:
            alike(one[key], other[key], rel=rel, least=least, texts=texts, place=f"{place}.{key}")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), place
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            alike(a, b, rel=rel, least=least, texts=texts, place=f"{place}[{i}]")
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=rel, abs=least, nan_ok=True), place
    elif texts or not isinstance(one, str):
        assert one == other, place
