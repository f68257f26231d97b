"""Advisory locks on output files: of two runs that write the same files at the same time, all files that remain are of one run.

The locks are for the runs of one user on one computer. They are held from the first output that is complete to the end of the command,
so that a run never waits for the work of another one.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from types import ModuleType
from typing import Final, final

from twin._common.errors import InputError

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
        """Wait until no other run writes these files, and keep others from it.

        Args:
            files: resolved paths; those locked already are skipped. In sorted order, so that two runs do not wait for each other.

        Raises:
            InputError: another run has not finished within `WAIT_S`.
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
