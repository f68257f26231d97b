"""Whether a piece of C++ is worth compiling, and what became of it: one place for all who have some."""

from __future__ import annotations

import ctypes
import os
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Final, TypeVar

from twin.compute.native import compiler, store
from twin.compute.native.compiler import CompilerError

SWITCH: Final = "TWIN_NATIVE"
"""Environment variable: 0 switches the compiled code off."""
WORTH_COMPILING: Final = 50_000
"""Rows in one call from which compiled code is used, compiled first if need be.

NumPy takes a fifth of a second for as many, the compiler one or two, once. Only the rows of the call count, not what was asked before
or is kept already: the same call gives the same digits, the first time and the second.
"""
PORTION: Final = 32_768
"""Rows a thread takes at a time."""

Part = TypeVar("Part")

_HERE: Final = Path(__file__).parent
_failed: dict[str, str] = {}
"""Why the compiled code of a source is not in use."""
_loaded: dict[str, ctypes.CDLL] = {}


def text(name: str) -> str:
    """A piece of C++ of this room."""
    return (_HERE / name).read_text(encoding="utf-8")


def enabled() -> bool:
    """Whether compiled code may be used."""
    return os.environ.get(SWITCH, "") != "0"


def library(source: str) -> ctypes.CDLL | None:
    """The compiled source: at hand, kept from an earlier run, or compiled now; None if that is not to be had."""
    tool = compiler.found()
    if tool is None or source in _failed:
        return None
    name = store.key(source, tool)
    if name not in _loaded:
        try:
            _loaded[name] = store.library(source, tool)
        except (CompilerError, OSError) as error:
            give_up(source, str(error))
            return None
    return _loaded[name]


def give_up(source: str, why: str) -> None:
    """Use that source no more; said once, whatever fails after it."""
    if not _failed:
        warnings.warn(f"solving without compiled code: {why}", RuntimeWarning, stacklevel=2)
    _failed[source] = why


@cache
def _lanes(tool: compiler.Compiler) -> int:
    return int(store.library(text("simd.hpp") + '\nextern "C" int lanes() { return W; }\n', tool).lanes())


def in_portions(rows: int, work: Callable[[slice], Part]) -> list[Part]:
    """What each portion of some rows gave, in threads: ctypes lets go of Python while it is in there."""
    parts = [slice(start, min(start + PORTION, rows)) for start in range(0, rows, PORTION)]
    if len(parts) <= 1:
        return [work(part) for part in parts]
    with ThreadPoolExecutor(min(os.cpu_count() or 1, len(parts))) as pool:
        return list(pool.map(work, parts))


def in_use() -> str:
    """How large batches are solved here, in words; compiles a few lines to find out."""
    if not enabled():
        return f"NumPy ({SWITCH}=0)"
    tool = compiler.found()
    if tool is None:
        return "NumPy (no C++ compiler found)"
    try:
        lanes = _lanes(tool)
    except (CompilerError, OSError) as error:
        return f"NumPy ({error})"
    return (
        f"compiled from {WORTH_COMPILING:,} poses on: {lanes} an instruction, {tool.version}, kept in {store.folder()}"
    )
