"""Memory, threads, locks and pipes of this computer.

Advisory locks on output files: of two runs of one user that write the same files at the same time, all files that remain are of one
run. They are held from the first output that is complete to the end of the command, so that a run never waits for the work of another.
"""

from __future__ import annotations

import hashlib
import math
import os
import select
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from threading import RLock
from time import monotonic, sleep
from types import ModuleType
from typing import Final, ParamSpec, TypeVar, final

from threadpoolctl import ThreadpoolController

from twin._common.errors import InputError

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


# --- Threads: linear algebra on one, and work on a list of items divided over two -----------------

_Given = ParamSpec("_Given")
_Made = TypeVar("_Made")
_expressions = RLock()


def builds_expressions(function: Callable[_Given, _Made]) -> Callable[_Given, _Made]:
    """Let one thread at a time run functions that build expressions of CasADi.

    CasADi releases Python's lock, but counts the references to nodes that all expressions share (such as 0 and 1) without any lock: two
    threads that build at the same time can end the process (segmentation fault). A property that is cached takes a lock of its own
    first, so that no such function may use a cached property that is decorated too.
    """

    @wraps(function)
    def built(*args: _Given.args, **kwargs: _Given.kwargs) -> _Made:
        with _expressions:
            return function(*args, **kwargs)

    return built


SHARES: Final = 2
"""Number of parts in which sums over chunks are formed: threads for each cost a tenth of the processor time and gained no time."""

Piece = TypeVar("Piece")
Part = TypeVar("Part")


def map_chunks(pieces: Sequence[Piece], work: Callable[[Sequence[Piece]], Part]) -> list[Part]:
    """Apply a function to `SHARES` parts of a list in turn: the first part has its first item and every `SHARES`-th after it."""
    return [work(pieces[i::SHARES]) for i in range(max(min(SHARES, len(pieces)), 1))]


def one_blas_thread(*, scipy: bool = True) -> AbstractContextManager[object]:
    """Limit linear algebra to one thread from now on, or inside the context if the result is used as a context manager.

    Results then do not depend on the number of cores, and many small factorisations do not wait for threads. The library of ``scipy``
    is not NumPy's, and takes 0.15 s to load where nothing else needs it.
    """
    if scipy:
        import_module("scipy.linalg")  # Only libraries that are loaded are limited.
    limiter: AbstractContextManager[object] = _libraries("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas")
    return limiter


@cache
def _libraries(scipy: bool) -> ThreadpoolController:
    """Return the loaded libraries, with that of scipy or before it is loaded; cached, because finding them takes a millisecond."""
    return ThreadpoolController()


# --- Progress of long work ------------------------------------------------------------------------

Progress = Callable[[str, float], None]
"""Called with the present stage and the fraction done; it may raise to interrupt the work."""


def silent(stage: str, fraction: float) -> None:
    """Report no progress."""


# --- Advisory locks on output files: of two runs that write the same files at the same time, all files that remain are of one

try:
    import fcntl as _fcntl
except ImportError:  # Windows
    _fcntl = None  # type: ignore[assignment]
_LOCKING: Final[ModuleType | None] = _fcntl
WAIT_S: Final = 60.0
"""Time to wait for another run that writes the same files, s."""


@final
class OutputLocks:
    """The locks of one command."""

    def __init__(self) -> None:
        self._held: dict[Path, int] = {}
        self._process = os.getpid()

    def acquire(self, files: Iterable[Path]) -> None:
        """Wait until no other run writes these files (resolved paths), and keep others from it; `InputError` after `WAIT_S`.

        In sorted order, so that two runs do not wait for each other.
        """
        # A worker forked from the command writes into the command's scratch folder; the command itself moves the files into place.
        if _LOCKING is None or os.getpid() != self._process:
            return
        for path in sorted({*files} - self._held.keys()):
            descriptor = _lock_file(path)
            if descriptor is None:
                continue
            self._held[path] = descriptor
            deadline = monotonic() + WAIT_S
            while True:
                with suppress(BlockingIOError):
                    _LOCKING.flock(descriptor, _LOCKING.LOCK_EX | _LOCKING.LOCK_NB)
                    break
                if monotonic() > deadline:
                    raise InputError("another run of twin writes it", expected="one run at a time", file=path)
                sleep(0.02)

    def release(self) -> None:
        """Let other runs write the files."""
        for descriptor in self._held.values():
            if _LOCKING is not None:
                # Explicitly: a process that was forked may still hold the descriptor.
                _LOCKING.flock(descriptor, _LOCKING.LOCK_UN)
            os.close(descriptor)
        self._held = {}


def _lock_file(path: Path) -> int | None:
    """Return the descriptor of the lock of a file, in a folder of the user for temporary files; None if there can be none."""
    folder = Path(tempfile.gettempdir()) / f"twin-locks-{os.getuid()}"
    name = hashlib.sha256(os.fsencode(path)).hexdigest()[:32]
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        return os.open(folder / name, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError:
        return None


# --- Inputs that are no regular files: pipes that another program writes, and devices -------------

WRITER_S: Final = 5.0
"""Time to wait for a program that writes to a pipe, s."""


def is_readable_device(path: Path) -> bool:
    """Return whether a character device ends: a terminal, or the empty device."""
    if os.path.samefile(path, os.devnull):
        return True
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        return os.isatty(descriptor)
    finally:
        os.close(descriptor)


def read_pipe(path: Path, most_bytes: int) -> bytes:
    """Return all that other programs write to a pipe; wait without limit for what they write, but not for one that writes.

    Raises `InputError` if no program writes to it, or more than ``most_bytes``; `OSError` if it cannot be read.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    data, deadline, seen = bytearray(), monotonic() + WRITER_S, False
    try:
        while len(data) <= most_bytes:
            try:
                block = os.read(descriptor, 1 << 20)
            except BlockingIOError:  # a program has it open and has written nothing yet
                seen = True
                select.select([descriptor], [], [], 1.0)
                continue
            data += block
            seen = seen or bool(block)
            if not block and (seen or monotonic() > deadline):
                break
            if not block:  # no program has it open yet
                sleep(0.02)
    finally:
        os.close(descriptor)
    if not seen:
        raise InputError("a pipe to which no program writes", expected="a file, or a pipe with a writer", file=path)
    if len(data) > most_bytes:
        raise InputError("too large", expected=f"at most {most_bytes >> 20} MB", file=path)
    return bytes(data)
