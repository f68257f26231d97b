"""Conversion of results to JSON data by one rule for all dataclasses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np

_NONE: Mapping[str, str] = MappingProxyType({})


def json_form(value: Any, *, rename: Mapping[str, str] = _NONE, leave_out: Collection[str] = ()) -> Any:
    """Return a value as numbers, text, lists and dictionaries; null for a number that is not finite.

    A dataclass becomes a dictionary of its fields in their order; a part with a method `to_dict` becomes what that returns.

    Args:
        value: a dataclass, mapping, sequence, array, number, text, or None.
        rename: JSON keys of those fields of ``value`` whose key is not the field name.
        leave_out: fields of ``value`` to omit.

    Raises:
        TypeError: a part cannot be converted to JSON.
    """
    if is_dataclass(value) and not isinstance(value, type):
        kept = [field.name for field in fields(value) if field.name not in leave_out]
        return {rename.get(name, name): _part(getattr(value, name)) for name in kept}
    return _part(value)


def _part(value: Any) -> Any:
    if hasattr(value, "to_dict"):
        return value.to_dict()
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _part(item) for key, item in value.items()}
    if isinstance(value, Sequence | Set):
        return [_part(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return json_form(value)
    raise TypeError(f"cannot convert {type(value).__name__} to JSON")
