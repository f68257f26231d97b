"""File formats: machine, calibration, measurement table, reports; how they are read and written.

Manual: `twin doc files`.
"""

from __future__ import annotations

import io
import json
import math
import os
import platform
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, BinaryIO, Final, final

from twin._common.errors import InputError
from twin._common.resources import OutputLocks, is_readable_device, read_pipe

MAX_TEXT_BYTES: Final = 2**28
"""Largest text file in bytes; a table of a million rows needs a third of it."""
TEMPORARY_PREFIX: Final = ".twin-"
"""Prefix of the names of all temporary files and folders; process id, random part and computer name follow."""


def register_input(path: Path) -> None:
    """Register a file as an input of the running command; raise `InputError` if that is going to write it."""
    tracker = _COMMAND.get()
    if tracker is not None:
        tracker.add_input(path)


def folder_entries(folder: Path, what: str) -> list[Path]:
    """Return the paths in a folder by name; raise `InputError`, with ``what`` it is in words, if it cannot be read."""
    try:
        return sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{what} cannot be read", expected="a folder", file=folder, value=error.strerror) from error


def names_beside(path: Path) -> list[str]:
    """Return the names of the files in the same folder; empty if there is no such folder."""
    try:
        return [file.name for file in path.parent.iterdir() if file.is_file()]
    except OSError:
        return []


def read_bytes(path: Path, *, most_bytes: int | None = None) -> bytes:
    """Return the content of a file; `InputError` if it cannot be read, exceeds ``most_bytes``, or the command is to write it."""
    try:
        with open_input(path) as stream:
            data = stream.read(-1 if most_bytes is None else most_bytes + 1)
    except InputError:
        raise
    except (OSError, ValueError) as error:
        value = error.strerror if isinstance(error, OSError) else error
        raise InputError("cannot be read", expected="a readable file", file=path, value=value) from error
    if most_bytes is not None and len(data) > most_bytes:
        raise InputError("too large", expected=f"at most {most_bytes >> 20} MB of text", file=path)
    return data


def open_input(path: Path) -> BinaryIO:
    """Open an input file: a regular file, a terminal, or a pipe that another program writes, such as ``<(…)`` of a shell.

    Raises `InputError` for a device, a socket, a pipe without a writer, or what the running command is going to write; `OSError` if
    it cannot be read.
    """
    register_input(path)
    mode = path.stat().st_mode
    if stat.S_ISFIFO(mode):
        return io.BytesIO(read_pipe(path, MAX_TEXT_BYTES))
    if stat.S_ISSOCK(mode) or stat.S_ISBLK(mode) or (stat.S_ISCHR(mode) and not is_readable_device(path)):
        raise InputError("a device or a socket", expected="a file, or a pipe that another program writes", file=path)
    return path.open("rb")


def read_text(path: Path, *, most_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the content of a UTF-8 text file; raise `InputError` as `read_bytes`, or if it is not UTF-8 text."""
    data = read_bytes(path, most_bytes=most_bytes)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        if data.startswith(b"PK"):
            expected = "UTF-8 text (`twin import` reads spreadsheets)"
            raise InputError("a spreadsheet or zip file, not a text file", expected=expected, file=path) from error
        line = data.count(b"\n", 0, error.start) + 1
        is_table = path.suffix.lower() in (".csv", ".txt", ".tsv")
        expected = "UTF-8 text" + (" (`twin import` reads tables in other encodings)" if is_table else "")
        raise InputError("not a text file", expected=expected, file=path, line=line, value=error.reason) from error
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputError("not a text file", expected="UTF-8 text without NUL", file=path, line=line)
    return text


def read_lines(path: Path) -> list[str]:
    """Return the lines of a UTF-8 text file, split at LF, CR LF and CR only."""
    lines = read_text(path).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return lines[:-1] if lines[-1] == "" else lines


def read_json(path: Path, expected: str) -> Any:
    """Return the data of a JSON file; raise `InputError`, with what was ``expected``, if it is not JSON or nested too deeply."""
    text = read_text(path)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError("not JSON", expected=expected, file=path, line=error.lineno, value=error.msg) from None
    except (RecursionError, ValueError):
        raise InputError("lists nested too deeply or numbers too long", expected=expected, file=path) from None


@final
class CommandFiles:
    """The files that one command reads and writes, by their resolved paths; a file cannot be both."""

    def __init__(self) -> None:
        self.read: set[Path] = set()
        self.outputs: set[Path] = set()
        self.written: set[Path] = set()  # complete outputs, which may be read back
        self._identities: set[tuple[int, int]] = set()
        self.locks = OutputLocks()

    def add_input(self, path: Path) -> None:
        """Register an input file; raise `InputError` if the command is going to write it."""
        file = _resolved(path)
        if file in self.outputs - self.written:
            raise _input_conflict(path)
        self.read.add(file)
        self._identities |= _identity(file)

    def add_output(self, path: Path, file: Path) -> None:
        """Register an output file, ``path`` resolved; raise `InputError` if the command has read it, under this name or another one."""
        if file in self.written:
            return
        if file in self.read or _identity(file) & self._identities:
            raise _input_conflict(path)
        self.outputs.add(file)


_COMMAND: Final[ContextVar[CommandFiles | None]] = ContextVar("files of the running command", default=None)


@contextmanager
def tracked_files() -> Iterator[CommandFiles]:
    """Track all files read and written inside the context, so that no input is overwritten; nested, return the outer tracker.

    Without it (in a notebook or a script) a file may be read, changed and saved under its own name.
    """
    outer = _COMMAND.get()
    if outer is not None:
        yield outer
        return
    files = CommandFiles()
    token = _COMMAND.set(files)
    try:
        yield files
    finally:
        _COMMAND.reset(token)
        files.locks.release()


def _input_conflict(path: Path) -> InputError:
    return InputError("output file is also an input", expected="another file", file=path)


def _identity(file: Path) -> set[tuple[int, int]]:
    """Return device and number of a file, which all its names share; empty if there is no such file."""
    try:
        found = file.stat()
    except (OSError, ValueError):
        return set()
    return {(found.st_dev, found.st_ino)}


def _resolved(path: Path) -> Path:
    """Return the path without symbolic links; raise `InputError` if the operating system rejects it."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError("not a path", expected="the path of a file", file=path, value=error) from error


def check_writable(paths: Sequence[Path]) -> None:
    """Check that every output can be written, before the work starts, and remove what killed runs left in their folders.

    Raises `InputError`: no writable folder; an output is an input, not a regular file, or read-only; two outputs are the same file.
    """
    tracker = _COMMAND.get()
    seen: set[Path] = set() if tracker is None else set(tracker.outputs)
    for path in paths:
        file = _resolved(path)
        if file in seen:
            raise InputError("two outputs are the same file", expected="different files", file=path)
        seen.add(file)
        check_folder(_target(path).parent, path)


def check_folder(folder: Path, path: Path) -> None:
    """Raise `InputError`, about the output ``path``, unless a folder is writable; remove what killed runs left there."""
    _remove_leftovers(folder)
    try:
        os.unlink(_new_temporary(folder))
    except OSError as error:
        raise InputError("cannot be written", expected="a writable folder", file=path, value=error.strerror) from error


def _target(path: Path) -> Path:
    """Return the file that writing to a path replaces, following symbolic links; raise `InputError` as `check_writable`."""
    file = _resolved(path)
    tracker = _COMMAND.get()
    if tracker is not None:
        tracker.add_output(path, file)
    try:
        mode = path.stat().st_mode if path.exists() else None
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=path, value=error.strerror) from error
    if mode is not None and not stat.S_ISREG(mode):
        expected = "a file, not a folder" if stat.S_ISDIR(mode) else "a regular file, not a device or a pipe"
        raise InputError("cannot be written", expected=expected, file=path)
    if mode is not None and not (mode & 0o222 and os.access(file, os.W_OK)):
        raise InputError("cannot be written", expected="a file that is not read-only", file=path)
    if not file.parent.is_dir():
        expected = f"an existing folder: create {path.parent} first"
        raise InputError("cannot be written: its folder does not exist", expected=expected, file=path)
    return file


def write_atomic(path: Path, content: str | bytes, *, check: Callable[[Path], object] | None = None) -> None:
    """Write a file atomically: at every moment the path holds the old content or the new one.

    ``check`` reads the complete file, under a temporary name in the same folder, before it replaces the path. If it raises an
    `InputError`, the path keeps its old content.
    """
    with atomic_file(path, check) as stream:
        stream.write(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)


def write_json(path: Path, data: Any, *, check: Callable[[Path], object] | None = None) -> None:
    """Write JSON atomically, as `write_atomic`; a number that is not finite is written as null, meaning unknown."""
    write_atomic(path, json.dumps(_finite(data), indent=1, allow_nan=False) + "\n", check=check)


def _finite(data: Any) -> Any:
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    return [_finite(value) for value in data] if isinstance(data, list | tuple) else data


@contextmanager
def atomic_file(path: Path, check: Callable[[Path], object] | None = None) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces the path when it is complete; after an error nothing remains. ``check`` as in `write_atomic`.

    An existing file keeps its mode and, if permitted, its owner; a symbolic link is kept and its target replaced.
    """
    target = _target(path)
    try:
        temporary = _new_temporary(target.parent)
        try:
            with temporary.open("wb") as stream:
                yield stream
                stream.flush()
                os.fsync(stream.fileno())
            if check is not None:
                _check_written(temporary, path, check)
            _replace(temporary, target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        raise InputError("cannot be written", expected="a writable file", file=path, value=error.strerror) from error


def _check_written(temporary: Path, path: Path, check: Callable[[Path], object]) -> None:
    """Read a file before it replaces the path, without registering its temporary name as an input of the command."""
    token = _COMMAND.set(None)
    try:
        check(temporary)
    except InputError as error:
        raise InputError(
            f"not written, because it would not be read back: {error.what}",
            expected=error.expected,
            file=path,
            value=error.value,
        ) from error
    finally:
        _COMMAND.reset(token)


def move_into_place(made: Path, path: Path) -> None:
    """Replace an output with a complete file on the same file system."""
    _replace(made, _target(path))


def _replace(made: Path, target: Path) -> None:
    tracker = _COMMAND.get()
    if tracker is not None:
        tracker.locks.acquire({*tracker.outputs, target})
    if target.exists():
        old = target.stat()
        with suppress(PermissionError):
            os.chown(made, old.st_uid, old.st_gid)
        os.chmod(made, stat.S_IMODE(old.st_mode))
    os.replace(made, target)
    if tracker is not None:
        tracker.written.add(target)


@contextmanager
def scratch_folder(parent: Path | None = None) -> Iterator[Path]:
    """Make a folder for temporary files, in TMPDIR unless a parent is given, and remove it afterwards.

    Folders left by a killed run are removed by the next run that makes a folder or writes a file in the same place.
    """
    place = Path(tempfile.gettempdir()) if parent is None else parent
    _remove_leftovers(place)
    folder = place / _temporary_name()
    os.mkdir(folder, 0o700)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _new_temporary(folder: Path) -> Path:
    """Create an empty temporary file with the mode of a new file and return its path."""
    path = folder / _temporary_name()
    os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    return path


def _temporary_name() -> str:
    return f"{TEMPORARY_PREFIX}{os.getpid()}-{secrets.token_hex(6)}-{platform.node()}"


def _remove_leftovers(folder: Path) -> None:
    """Remove this user's temporary files and folders whose process, on this computer, no longer runs."""
    try:
        candidates = [Path(entry.path) for entry in os.scandir(folder) if entry.name.startswith(TEMPORARY_PREFIX)]
    except OSError:
        return
    for path in candidates:
        pid, _, rest = path.name.removeprefix(TEMPORARY_PREFIX).partition("-")
        with suppress(OSError):
            ours = path.lstat().st_uid == os.geteuid() and rest.partition("-")[2] == platform.node()
            if not (ours and pid.isdecimal()) or _is_running(int(pid)):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


# --- Kinds of files, recognised by their beginning, to name a file that was given in place of another

_BEGINNING: Final = 4000
"""Number of characters that are looked at."""

_MOTION: Final = r"(?:N\d+\s|(?:N\d+)?(?:G\d+|M\d+|T\d+|O\d{2,}|[XYZ][-+.\d]+)(?!\w*\s*[:,;]))"

_KINDS: Final = (
    (re.compile(r"\s*PK\x03\x04"), "a spreadsheet or zip file"),
    (re.compile(r"\s*(<!doctype html|<html)", re.IGNORECASE), "an HTML page"),
    (re.compile(r"\s*(<\?xml[^>]*>\s*)?(<!--.*?-->\s*)*<robot\b", re.DOTALL), "a URDF"),
    (re.compile(r"\s*<\?xml\b"), "an XML file"),
    (re.compile(r"(.*\n)*?schema: twin\.calibration/"), "a calibration"),
    (re.compile(r"(.*\n)*?schema: twin\.machine/"), "a machine file"),
    (re.compile(r"(.*\n)*?schema: twin\.[\w-]+/"), "another file of twin"),
    (re.compile(r'\s*\{\s*"'), "a JSON file"),
    (re.compile(r"(\s*#.*\n)*.*\btarget\b.*\bcarrier\b.*\bx_mm\b"), "a measurement table"),
    (re.compile(r"(\s*#.*\n)*.*\btarget\b.*\bcarrier\b"), "a plan"),
    (re.compile(r"\s*\d*\s*BEGIN\s+PGM\s", re.IGNORECASE), "an NC program"),
    (re.compile(r"(\$\$.*\n|\s*\n)*\s*(PARTNO|GOTO|UNITS|MULTAX)\b", re.IGNORECASE), "an NC program"),
    (re.compile(rf"\s*(%[^\n]*\n)?(\s*[(;][^\n]*\n|\s*\n)*\s*{_MOTION}"), "an NC program"),
)


def kind_of_text(text: str) -> str | None:
    """Return the kind of file that a text, or its beginning, is, with its article (``an NC program``); None if it is not recognised."""
    beginning = text[:_BEGINNING].removeprefix("\ufeff")
    return next((kind for pattern, kind in _KINDS if pattern.match(beginning)), None)


def other_kind(text: str, *allowed: str) -> str | None:
    """Return the kind of file that a text is, unless it is one of those allowed or not recognised."""
    kind = kind_of_text(text)
    return None if kind in allowed else kind
