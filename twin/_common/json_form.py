"""The form in JSON of what a command found: one rule instead of a dictionary written out for every class."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import fields, is_dataclass
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np

_NONE: Mapping[str, str] = MappingProxyType({})


def json_form(value: Any, *, rename: Mapping[str, str] = _NONE, leave_out: Collection[str] = ()) -> Any:
    """Numbers, text, lists and dictionaries of a value; null for a number that is not finite.

    A dataclass gives its fields in their order; a part that has a `to_dict` of its own is asked for it.

    Args:
        value: a dataclass, mapping, sequence, array, number, text, or None.
        rename: JSON keys of fields of ``value`` that are not called so.
        leave_out: fields of ``value`` that are not written.

    Raises:
        TypeError: a part that has no form in JSON.
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
        return {str(key): _part(one) for key, one in value.items()}
    if isinstance(value, Sequence | Set):
        return [_part(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return json_form(value)
    raise TypeError(f"no form in JSON for {type(value).__name__}")
