"""Cache of compiled libraries in the user's cache directory.

Loading a library runs its code, so a library is loaded only if this user wrote it and it is complete: folder and file belong
to the user and are not writable by others, and the file has the digest recorded beside it. Otherwise it is built again. If there
is no such folder (a home directory that is read-only or belongs to another user) the library is built in a temporary folder.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from twin._common.files import scratch_folder
from twin.compute.native.compiler import Compiler

try:
    import fcntl
except ImportError:  # no such locks on Windows: two processes then both build the library
    fcntl = None  # type: ignore[assignment]


def folder() -> Path:
    """Return ``$XDG_CACHE_HOME/twin`` or ``~/.cache/twin``, whether or not it exists."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification says that relative paths are ignored.
    return (Path(named) if os.path.isabs(named) else Path(os.path.expanduser("~")) / ".cache") / "twin"


def key(source: str, compiler: Compiler) -> str:
    """Return the cache key of a library: a digest of source, compiler and processor."""
    return hashlib.sha256(f"{compiler.identity}\0{source}".encode()).hexdigest()[:40]


def cached_library(name: str) -> ctypes.CDLL | None:
    """Return the cached library of that key, if it exists and is trusted."""
    place = folder()
    return _loaded(place / f"{name}.so") if _private(place) else None


def library(source: str, compiler: Compiler) -> ctypes.CDLL:
    """Return the compiled library of a source from the cache; build and cache it if necessary.

    Raises:
        CompilerError: it cannot be compiled.
        OSError: it can be stored nowhere, or not be loaded.
    """
    place, name = folder(), key(source, compiler)
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        usable = _private(place) and os.access(place, os.W_OK | os.X_OK)
    except OSError:
        usable = False
    if not usable:
        found = cached_library(name)
        return found if found is not None else _build_temporary(source, compiler)
    target = place / f"{name}.so"
    with _locked(place / f"{name}.lock"):
        found = _loaded(target)
        if found is None:
            try:
                _build(source, compiler, target)
            except OSError:  # a full disc, or a folder that is not writable after all
                return _build_temporary(source, compiler)
            found = _loaded(target)
    return found if found is not None else _build_temporary(source, compiler)


def _build(source: str, compiler: Compiler, target: Path) -> None:
    """Build beside the target; the digest is renamed into place last, and until then the library is not loaded."""
    with scratch_folder(target.parent) as scratch:
        made, noted = scratch / "made.so", scratch / "noted"
        compiler.build(source, made)
        os.chmod(made, 0o600)
        noted.write_text(_digest(made), encoding="ascii")
        os.replace(made, target)
        os.replace(noted, _note(target))


def _build_temporary(source: str, compiler: Compiler) -> ctypes.CDLL:
    with scratch_folder() as scratch:
        made = scratch / "made.so"
        compiler.build(source, made)
        return ctypes.CDLL(str(made))


def _loaded(path: Path) -> ctypes.CDLL | None:
    note = _note(path)
    try:
        if not (_is_private(path, stat.S_ISREG) and _is_private(note, stat.S_ISREG)):
            return None
        if note.read_text(encoding="ascii", errors="replace").strip() != _digest(path):
            return None
        return ctypes.CDLL(str(path))
    except OSError:
        return None


def _note(path: Path) -> Path:
    return path.with_suffix(".sha256")


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _private(place: Path) -> bool:
    try:
        return _is_private(place, stat.S_ISDIR)
    except OSError:
        return False


def _is_private(path: Path, kind: object) -> bool:
    """Return whether a path has the given kind (not a link), belongs to this user and is not writable by others."""
    status = path.lstat()
    mine = not hasattr(os, "geteuid") or (status.st_uid == os.geteuid() and not status.st_mode & 0o022)
    return mine and callable(kind) and bool(kind(status.st_mode))


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock between processes; where files cannot be locked, each process builds its own library."""
    with contextlib.ExitStack() as stack:
        if fcntl is not None:
            with contextlib.suppress(OSError):
                file = stack.enter_context(open(path, "w", encoding="ascii"))
                os.chmod(path, 0o600)
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
