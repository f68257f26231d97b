"""What the digits of a result depend on beside its inputs: the programs here and on every worker, and the arithmetic."""

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
    """By name: Python, `twin` with the digest of its own text, and the packages that calculate.

    The version alone would not tell two checkouts apart.
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
    """Digest of the processor, and of the compiler if compiled code may be used: where these differ, last digits may."""
    tool = compiler.found() if loading.enabled() else None
    told = f"{compiler.processor()}\0{'' if tool is None else tool.identity}"
    return hashlib.sha256(told.encode()).hexdigest()


def apart(here: dict[str, str], there: dict[str, str]) -> str:
    """How other versions differ from ours, in words; empty if they do not."""
    return ", ".join(
        f"{name} {there.get(name, 'none')} instead of {mine}" for name, mine in here.items() if there.get(name) != mine
    )
