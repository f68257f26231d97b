"""Versions and hardware that affect the digits of a result: software here and on every worker, processor and compiler."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Final

from twin.compute.native import compiler, loading

PACKAGES: Final = ("numpy", "scipy", "casadi", "pin")
SOURCES: Final = (".py", ".cpp", ".hpp", ".j2")


@cache
def versions() -> dict[str, str]:
    """Return the versions by name: Python, `twin` with the digest of its source, and the numerical packages.

    The version alone would not distinguish two checkouts.
    """
    package = Path(__file__).parents[2]
    digest = hashlib.sha256()
    for path in sorted(path for path in package.rglob("*") if path.suffix in SOURCES):
        digest.update(f"{path.relative_to(package).as_posix()}\0".encode() + path.read_bytes())
    return {
        "python": ".".join(platform.python_version_tuple()[:2]),
        "twin": f"{metadata.version('twin')} ({digest.hexdigest()[:12]})",
        **{name: metadata.version(name) for name in PACKAGES},
    }


@cache
def arithmetic() -> str:
    """Return a digest of the processor, and of the compiler if compiled code may be used; where it differs, last digits may differ."""
    tool = compiler.find_compiler() if loading.enabled() else None
    identity = f"{compiler.processor()}\0{'' if tool is None else tool.identity}"
    return hashlib.sha256(identity.encode()).hexdigest()


def version_differences(here: dict[str, str], there: dict[str, str]) -> str:
    """Return a description of the differences between two sets of versions; empty if there are none."""
    return ", ".join(
        f"{name} {there.get(name, 'none')} instead of {mine}" for name, mine in here.items() if there.get(name) != mine
    )
