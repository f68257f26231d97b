"""Memory of this computer that a process may use."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]

SYSTEM_ROOT = Path("/")
"""Folder that ``proc`` and ``sys`` are in; Linux."""


def memory_bytes() -> float:
    """Return the physical memory, or the limit of this process or of its control groups if that is lower; infinite if none is known."""
    try:
        most = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        most = math.inf
    if resource is not None:
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        most = most if limit == resource.RLIM_INFINITY else min(most, float(limit))
    return min([most if most > 0.0 else math.inf, *_group_limits(SYSTEM_ROOT)])


def _group_limits(root: Path) -> Iterator[float]:
    """Yield the limits of the control groups that this process is in, and of those above them (cgroups(7), versions 1 and 2)."""
    try:
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        return
    for line in lines:
        _, _, rest = line.partition(":")
        kinds, _, group = rest.partition(":")
        if kinds and "memory" not in kinds.split(","):
            continue
        mount, name = ("memory", "memory.limit_in_bytes") if kinds else ("", "memory.max")
        top = root / "sys/fs/cgroup" / mount
        # In a container the group may be named from outside, and its limits then stand in the topmost folder.
        folder = top / group.lstrip("/")
        for one in dict.fromkeys((folder, *(above for above in folder.parents if above.is_relative_to(top)), top)):
            try:
                yield float((one / name).read_text(encoding="ascii"))
            except (OSError, ValueError):  # no such group; "max"
                continue
