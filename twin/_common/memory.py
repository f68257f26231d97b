"""Memory of this computer that a process may use."""

from __future__ import annotations

import math
import os

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]


def memory_bytes() -> float:
    """Return the physical memory, or the limit of this process if that is lower; infinite if the system does not say."""
    try:
        most = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        most = math.inf
    if resource is not None:
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        most = most if limit == resource.RLIM_INFINITY else min(most, float(limit))
    return most if most > 0.0 else math.inf
