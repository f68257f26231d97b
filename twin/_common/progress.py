"""Progress of long work."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Called with the present stage and the fraction done; it may raise to interrupt the work."""


def silent(stage: str, fraction: float) -> None:
    """Report no progress."""
