"""The memory of a watch: one SQLite file beside the folder, with the checks that were read and the statements that were made.

The file is read whole, changed in memory and replaced atomically, so that a run that is stopped leaves the old file. Where SQLite was
built without `sqlite3_serialize`, its backup to a temporary file gives the same bytes.

    watches     one row a calibration, machine and alarm rate: a watch; each has its own alarm rate
    checks      the checks of a watch, in the order in which they were read: name, SHA-256, date, estimates (JSON)
    statements  what was said after each look: time, number of checks, alarm rate spent, verdict, text
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from twin._common.errors import InputError
from twin._common.files import check_writable, scratch_folder, write_atomic
from twin.watching.check import Check, from_json, to_json

APPLICATION_ID: Final = 0x74776174
"""Identifier of the file format in SQLite's header."""
VERSION: Final = 1
SERIALIZES: Final = hasattr(sqlite3.Connection, "serialize")
"""Whether this SQLite turns a database in memory into bytes by itself."""
MAGIC: Final = b"SQLite format 3\0"
"""First bytes of every SQLite file."""
TABLES: Final = """
CREATE TABLE watches (id TEXT PRIMARY KEY, machine TEXT, calibration TEXT, alarm_rate REAL, since TEXT, begun_at TEXT);
CREATE TABLE checks (watch TEXT, name TEXT, sha256 TEXT, date TEXT, read_at TEXT, data TEXT, PRIMARY KEY (watch, name));
CREATE TABLE statements (watch TEXT, said_at TEXT, checks INTEGER, spent REAL, verdict TEXT, text TEXT);
"""


@final
@dataclass(frozen=True)
class WatchKey:
    """Identity of a watch: the same machine, calibration, alarm rate and first day.

    Attributes:
        id: digest of all of them.
        machine: name of the machine.
        calibration: name of the calibration's file, or its source.
        alarm_rate: probability of an alarm for an unchanged machine.
        since: first day, ISO 8601, or empty.
    """

    id: str
    machine: str
    calibration: str
    alarm_rate: float
    since: str


@final
@dataclass(frozen=True)
class WatchStatement:
    """A statement after a look.

    Attributes:
        said_at: ISO 8601.
        checks: number of checks read until then.
        spent: alarm rate spent until then.
        verdict: verdict in one word.
        text: the words.
    """

    said_at: str
    checks: int
    spent: float
    verdict: str
    text: str


@final
@dataclass(frozen=True)
class Remembered:
    """The memory of one watch, and how many other watches the file holds."""

    checks: tuple[Check, ...]
    statements: tuple[WatchStatement, ...]
    others: int


def memory_path(folder: Path) -> Path:
    """Return the path of a folder's memory: beside it, ``FOLDER.watch.sqlite``.

    Raises:
        InputError: the root folder, beside which nothing is.
    """
    whole = folder.resolve()
    if not whole.name:
        raise InputError("the root folder cannot be watched", expected="a folder of checks", file=folder)
    return whole.with_name(f"{whole.name}.watch.sqlite")


def recall(path: Path, key: WatchKey) -> Remembered:
    """Return what the file remembers of a watch; nothing if there is no file.

    Raises:
        InputError: the file is not a memory of a watch, or cannot be written.
    """
    check_writable([path])
    return _read(path, key)


def _read(path: Path, key: WatchKey) -> Remembered:
    """Return what the file remembers of a watch, as `recall`."""
    with _opened(path) as memory:
        rows = memory.execute("SELECT data FROM checks WHERE watch = ? ORDER BY rowid", (key.id,)).fetchall()
        said = memory.execute(
            "SELECT said_at, checks, spent, verdict, text FROM statements WHERE watch = ? ORDER BY rowid", (key.id,)
        ).fetchall()
        (others,) = memory.execute("SELECT count(*) FROM watches WHERE id != ?", (key.id,)).fetchone()
        try:
            checks = tuple(from_json(json.loads(data)) for (data,) in rows)
        except (ValueError, KeyError, TypeError) as error:
            raise _not_a_memory(path, str(error)) from None
    return Remembered(checks, tuple(WatchStatement(*row) for row in said), int(others))


def remember(path: Path, key: WatchKey, new: Sequence[Check], said: WatchStatement) -> None:
    """Add checks and a statement to a watch, and replace the file.

    Raises:
        InputError: the file is not a memory of a watch, or cannot be written.
    """
    with _opened(path) as memory:
        memory.execute(
            "INSERT OR IGNORE INTO watches VALUES (?, ?, ?, ?, ?, ?)",
            (key.id, key.machine, key.calibration, key.alarm_rate, key.since, said.said_at),
        )
        memory.executemany(
            "INSERT INTO checks VALUES (?, ?, ?, ?, ?, ?)",
            [(key.id, c.name, c.sha256, c.date.isoformat(), c.read_at, json.dumps(to_json(c))) for c in new],
        )
        memory.execute(
            "INSERT INTO statements VALUES (?, ?, ?, ?, ?, ?)",
            (key.id, said.said_at, said.checks, said.spent, said.verdict, said.text),
        )
        memory.commit()
        content = _content(memory, path.parent)
    write_atomic(path, content, check=lambda written: _read(written, key))


def _load(memory: sqlite3.Connection, content: bytes, folder: Path) -> None:
    """Fill a database in memory with the content of a file."""
    if SERIALIZES:
        memory.deserialize(content)
        return
    with scratch_folder(folder) as scratch:
        copy = scratch / "copy.sqlite"
        copy.write_bytes(content)
        with closing(sqlite3.connect(copy)) as source:
            source.backup(memory)


def _content(memory: sqlite3.Connection, folder: Path) -> bytes:
    """Return the content of the file of a database in memory."""
    if SERIALIZES:
        return memory.serialize()
    with scratch_folder(folder) as scratch:
        copy = scratch / "copy.sqlite"
        with closing(sqlite3.connect(copy)) as target:
            memory.backup(target)
        return copy.read_bytes()


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a copy of a memory, or a new one if there is no file.

    Raises:
        InputError: the file is not a memory of a watch.
    """
    memory = sqlite3.connect(":memory:")
    try:
        try:
            if path.exists():
                content = path.read_bytes()
                if not content.startswith(MAGIC):
                    raise _not_a_memory(path, "another kind of file")
                _load(memory, content, path.parent)
                (identifier,), (version,) = (
                    memory.execute(f"PRAGMA {name}").fetchone() for name in ("application_id", "user_version")
                )
                if (identifier, version) != (APPLICATION_ID, VERSION):
                    raise _not_a_memory(path, "another kind of file")
            else:
                memory.executescript(
                    f"{TABLES} PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {VERSION};"
                )
            yield memory
        except (sqlite3.Error, OverflowError) as error:
            raise _not_a_memory(path, str(error)) from None
        except OSError as error:
            raise _not_a_memory(path, error.strerror or str(error)) from None
    finally:
        memory.close()


def _not_a_memory(path: Path, why: str) -> InputError:
    return InputError(
        "not a memory of a watch",
        expected="the file that an earlier watch of this folder wrote, or no file of that name",
        file=path,
        value=why,
    )
