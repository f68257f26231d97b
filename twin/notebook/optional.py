"""Packages of the extra ``notebook``, imported when a function needs them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from twin._common.errors import InputError


def optional(package: str) -> Any:
    """Return a package of the extra ``notebook``.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise InputError(
            f"{package} is not installed", expected="the extra notebook: pip install 'twin[notebook]'"
        ) from None
