"""Decision whether to compile a C++ source, and the compiled libraries; shared by all modules with C++ code."""

from __future__ import annotations

import ctypes
import os
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Final, TypeVar

from twin.compute.native import compiler, store
from twin.compute.native.compiler import CompilerError

SWITCH_VARIABLE: Final = "TWIN_NATIVE"
"""Environment variable: 0 switches the compiled code off."""
WORTH_COMPILING: Final = 50_000
"""Number of rows in one call from which compiled code is used, after compiling it if necessary.

NumPy takes a fifth of a second for this number, the compiler one or two seconds, once. Only the rows of the call count, or those of
the work that it is a portion of (`equal_portions`), neither earlier calls nor cached libraries, so that the same work gives the same
digits the first time and later.
"""
PORTION: Final = 32_768
"""Rows per chunk of a thread."""
ROW_THREADS: Final = "rows"
"""First part of the names of these threads."""

Part = TypeVar("Part")

_HERE: Final = Path(__file__).parent
_portions: ContextVar[float] = ContextVar("portions", default=1.0)
_failed: dict[str, str] = {}
"""Sources that are no longer used, with the reason."""
_loaded: dict[str, ctypes.CDLL] = {}


def cpp_text(name: str) -> str:
    """Return the text of a C++ file in this package."""
    return (_HERE / name).read_text(encoding="utf-8")


def enabled() -> bool:
    """Return whether compiled code may be used."""
    return os.environ.get(SWITCH_VARIABLE, "") != "0"


def worth_compiling(rows: int) -> bool:
    """Return whether compiled code may be used and is worth its time for this number of rows in one call (see `equal_portions`)."""
    return rows * _portions.get() >= WORTH_COMPILING and enabled()


@contextmanager
def equal_portions(portions: float) -> Iterator[None]:
    """Mark the calls within as one of a number of equal portions of the same work; holds for the current context.

    Nested, the numbers are multiplied: parts of a program that is one of many.
    """
    token = _portions.set(_portions.get() * portions)
    try:
        yield
    finally:
        _portions.reset(token)


def library(source: str) -> ctypes.CDLL | None:
    """Return the compiled library of a source: loaded before, from the cache, or compiled now; None if that fails."""
    tool = compiler.find_compiler()
    if tool is None or source in _failed:
        return None
    name = store.key(source, tool)
    if name not in _loaded:
        try:
            _loaded[name] = store.library(source, tool)
        except (CompilerError, OSError) as error:
            disable(source, str(error))
            return None
    return _loaded[name]


def confirmed_library(
    package: str, file: str, jobs: Mapping[str, type[ctypes.Structure]], agrees: Callable[[ctypes.CDLL], bool]
) -> ctypes.CDLL | None:
    """Return the compiled library of a C++ file; None if it cannot be compiled, or its results are wrong.

    Args:
        package: the package of the file.
        file: its name.
        jobs: the structure that each of its functions takes a pointer to, by the function's name.
        agrees: whether the library gives the same results as Python on a sample.
    """
    source = resources.files(package).joinpath(file).read_text(encoding="utf-8")
    found = library(source)
    if found is None:
        return None
    for name, job in jobs.items():
        function = getattr(found, name)
        function.argtypes, function.restype = (ctypes.POINTER(job),), None
    if not agrees(found):
        disable(source, f"{file} does not agree with Python")
        return None
    return found


def disable(source: str, why: str) -> None:
    """Stop using the compiled code of a source; only the first failure is reported."""
    if not _failed:
        warnings.warn(f"solving without compiled code: {why}", RuntimeWarning, stacklevel=2)
    _failed[source] = why


@cache
def _lanes(tool: compiler.Compiler) -> int:
    return int(store.library(cpp_text("simd.hpp") + '\nextern "C" int lanes() { return W; }\n', tool).lanes())


def map_row_chunks(rows: int, work: Callable[[slice], Part]) -> list[Part]:
    """Apply a function to chunks of rows in threads and return the results; ctypes releases the GIL during the calls."""
    return map_parts([slice(start, min(start + PORTION, rows)) for start in range(0, rows, PORTION)], work)


def map_parts(parts: list[slice], work: Callable[[slice], Part]) -> list[Part]:
    """The same for parts given."""
    if len(parts) <= 1:
        return [work(part) for part in parts]
    return list(_pool(os.getpid()).map(work, parts))


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Return the threads of a process, which are started once: starting them for every call takes longer than many a call."""
    return ThreadPoolExecutor(os.cpu_count() or 1, thread_name_prefix=f"{ROW_THREADS}-{process}")


def only_idle_threads() -> bool:
    """Return whether this process has no other threads than this one and those of `map_parts`, which then wait for work."""
    here = threading.current_thread()
    return all(one is here or one.name.startswith(ROW_THREADS) for one in threading.enumerate())


def solver_description() -> str:
    """Return a description of the solver for large batches; compiles a few lines to find out."""
    if not enabled():
        return f"NumPy ({SWITCH_VARIABLE}=0)"
    tool = compiler.find_compiler()
    if tool is None:
        return "NumPy (no C++ compiler found)"
    try:
        lanes = _lanes(tool)
    except (CompilerError, OSError) as error:
        return f"NumPy ({error})"
    return f"compiled from {WORTH_COMPILING:,} poses on: {lanes} per instruction, {tool.version}, cached in {store.folder()}"
