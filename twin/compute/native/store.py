"""Compiled code kept between runs, in the user's cache directory.

Loading a library runs what is in it, so only what this user wrote is loaded, and only if it is whole: the folder and the file belong
to the user and nobody else may write them, and the file's digest is the one noted beside it. Anything else is built anew. Where there
is no such folder (a home that cannot be written, or is somebody else's) the library is built in a private place, gone afterwards.
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
except ImportError:  # no such locks on Windows: two processes then build the same thing, each for itself
    fcntl = None  # type: ignore[assignment]


def folder() -> Path:
    """``$XDG_CACHE_HOME/twin`` or ``~/.cache/twin``, whether or not it exists."""
    named = os.environ.get("XDG_CACHE_HOME", "")
    # The specification has relative paths ignored.
    return (Path(named) if os.path.isabs(named) else Path(os.path.expanduser("~")) / ".cache") / "twin"


def key(source: str, compiler: Compiler) -> str:
    """Name of the library: what it is made from, by what and for what processor."""
    return hashlib.sha256(f"{compiler.identity}\0{source}".encode()).hexdigest()[:40]


def kept(name: str) -> ctypes.CDLL | None:
    """The library of that name, if it is there and to be trusted."""
    place = folder()
    return _loaded(place / f"{name}.so") if _private(place) else None


def library(source: str, compiler: Compiler) -> ctypes.CDLL:
    """The compiled source: from the folder, else built and put there.

    Raises:
        CompilerError: it cannot be compiled.
        OSError: it can be put nowhere, or not be loaded.
    """
    place, name = folder(), key(source, compiler)
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        usable = _private(place) and os.access(place, os.W_OK | os.X_OK)
    except OSError:
        usable = False
    if not usable:
        found = kept(name)
        return found if found is not None else _for_once(source, compiler)
    target = place / f"{name}.so"
    with _alone(place / f"{name}.lock"):
        found = _loaded(target)
        if found is None:
            try:
                _build(source, compiler, target)
            except OSError:  # a full disc, a folder that is not what it says
                return _for_once(source, compiler)
            found = _loaded(target)
    return found if found is not None else _for_once(source, compiler)


def _build(source: str, compiler: Compiler, target: Path) -> None:
    """Build beside the target; both files appear by renaming, the note last: until then the library is not loaded."""
    with scratch_folder(target.parent) as room:
        made, noted = room / "made.so", room / "noted"
        compiler.build(source, made)
        os.chmod(made, 0o600)
        noted.write_text(_digest(made), encoding="ascii")
        os.replace(made, target)
        os.replace(noted, _note(target))


def _for_once(source: str, compiler: Compiler) -> ctypes.CDLL:
    with scratch_folder() as room:
        made = room / "made.so"
        compiler.build(source, made)
        return ctypes.CDLL(str(made))


def _loaded(path: Path) -> ctypes.CDLL | None:
    note = _note(path)
    try:
        if not (_own(path, stat.S_ISREG) and _own(note, stat.S_ISREG)):
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
        return _own(place, stat.S_ISDIR)
    except OSError:
        return False


def _own(path: Path, kind: object) -> bool:
    """Whether it is of that kind (no link), this user's, and writeable by nobody else."""
    told = path.lstat()
    mine = not hasattr(os, "geteuid") or (told.st_uid == os.geteuid() and not told.st_mode & 0o022)
    return mine and callable(kind) and bool(kind(told.st_mode))


@contextlib.contextmanager
def _alone(path: Path) -> Iterator[None]:
    """One process at a time; where files cannot be locked, several, each of which builds its own."""
    with contextlib.ExitStack() as stack:
        if fcntl is not None:
            with contextlib.suppress(OSError):
                file = stack.enter_context(open(path, "w", encoding="ascii"))
                os.chmod(path, 0o600)
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
