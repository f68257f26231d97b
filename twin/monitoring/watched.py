"""The result of a watch: verdict, history of every error, and whether the calibration is still good.

The memory of a watch: one SQLite file beside the folder, with the checks that were read and the statements that were made.

The file is read whole, changed in memory and replaced atomically, so that a run that is stopped leaves the old file. Where SQLite was
built without `sqlite3_serialize`, its backup to a temporary file gives the same bytes.

    watches     one row a calibration, machine and alarm rate: a watch; each has its own alarm rate
    checks      the checks of a watch, in the order in which they were read: name, SHA-256, date, estimates (JSON)
    statements  what was said after each look: time, number of checks, alarm rate spent, verdict, text
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.errors import InputError
from twin._common.files import check_writable, scratch_folder, write_atomic
from twin._common.provenance import SourceWarning, warning_texts, warnings_to_json
from twin._common.records import json_form
from twin._common.units import count_with_noun
from twin.display import figure, note, readable, table
from twin.display.results import Display, DisplayedResult
from twin.monitoring.change import POSSIBLE_DATES, PRIOR_VARIANCES, Change, WatchedError
from twin.monitoring.check import SECONDS_PER_DAY, Check, from_json, to_json
from twin.monitoring.tool import Remaining

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
    """Identity of a watch: the same machine, calibration, alarm rate and first day."""

    id: str  # digest of all of them
    machine: str
    calibration: str  # name of the calibration's file, or its source
    alarm_rate: float
    since: str  # first day, ISO 8601, or empty


@final
@dataclass(frozen=True)
class WatchStatement:
    """A statement after a look."""

    said_at: str  # ISO 8601
    checks: int  # read until then
    spent: float  # of the alarm rate, until then
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
    """Return the path of a folder's memory: beside it, ``FOLDER.watch.sqlite``; `InputError` for the root folder."""
    whole = folder.resolve()
    if not whole.name:
        raise InputError("the root folder cannot be watched", expected="a folder of checks", file=folder)
    return whole.with_name(f"{whole.name}.watch.sqlite")


def recall(path: Path, key: WatchKey) -> Remembered:
    """Return what the file remembers of a watch; nothing if there is no file; `InputError` if it is no memory or not writable."""
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
    """Add checks and a statement to a watch, and replace the file; `InputError` as `recall`."""
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
    if SERIALIZES:
        memory.deserialize(content)
        return
    with scratch_folder(folder) as scratch:
        copy = scratch / "copy.sqlite"
        copy.write_bytes(content)
        with closing(sqlite3.connect(copy)) as source:
            source.backup(memory)


def _content(memory: sqlite3.Connection, folder: Path) -> bytes:
    if SERIALIZES:
        return memory.serialize()
    with scratch_folder(folder) as scratch:
        copy = scratch / "copy.sqlite"
        with closing(sqlite3.connect(copy)) as target:
            memory.backup(target)
        return copy.read_bytes()


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a copy of a memory, or a new one if there is no file; `InputError` if the file is not a memory of a watch."""
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


SCHEMA: Final = "twin.watch/1"
Verdict = Literal["changed", "undecided", "steady"]


def date_text(day: float) -> str:
    """Return a date in days since 1970 as ``2026-03-02``."""
    return f"{datetime.fromtimestamp(day * SECONDS_PER_DAY, UTC):%Y-%m-%d}"


@final
@dataclass(frozen=True, repr=False)
class Watch(DisplayedResult):
    """The result of a watch."""

    folder: Path  # the folder, and the file beside it that remembers
    memory: Path
    machine: str
    calibration: str  # file of the calibration that the checks are compared with, or its source
    checks: tuple[Check, ...]  # by date
    errors: tuple[WatchedError, ...]  # each that a check determines
    not_determined: tuple[str, ...]  # combinations of constant errors that no check determines, in words
    alarm_rate: float  # probability of any alarm for an unchanged machine, whatever the number of looks
    spent: float  # part of it that belongs to changes until the last check
    errors_watched: int  # number of errors over which it is divided
    limit: float  # logarithm of the evidence from which an error is an alarm
    tolerance_mm: float | None  # largest permitted error at the tool; None if none is given
    remaining: Remaining | None  # error at the tool that the calibration leaves now; None without tolerance
    news: tuple[str, ...]  # what this look found in the folder: files read, changed, vanished; empty if nothing is new
    statements: tuple[WatchStatement, ...]  # what was said after every look, this one included
    notices: tuple[str, ...]
    warnings: tuple[SourceWarning, ...]

    @property
    def verdict(self) -> Verdict:
        """Whether an error of the machine changed; ``undecided`` if a temperature could explain every alarm."""
        verdicts = {error.verdict for error in self.errors}
        return "changed" if "changed" in verdicts else "undecided" if "undecided" in verdicts else "steady"

    @property
    def correlation(self) -> float:
        """Estimated correlation of the deviations from one check to the next, which is allowed for."""
        return self.errors[0].series.correlation if self.errors else 0.0

    @property
    def good(self) -> bool | None:
        """Whether the calibration is still good for the tolerance (ISO 14253-1); None if undecided or not asked."""
        if self.remaining is None or self.tolerance_mm is None:
            return None
        return self.remaining.enough(self.tolerance_mm * 1e3)

    @property
    def met(self) -> bool:
        """Whether there is no alarm and the calibration is not proven to be out of tolerance."""
        return self.verdict == "steady" and self.good is not False

    @property
    def alarms(self) -> tuple[WatchedError, ...]:
        """The findings that are alarms, changes first, then by date."""
        found = [error for error in self.errors if error.alarming]
        return tuple(
            sorted(found, key=lambda one: (one.verdict != "changed", one.change.day if one.change else np.inf))
        )

    @property
    def following(self) -> tuple[WatchedError, ...]:
        """The errors that follow a temperature."""
        return tuple(error for error in self.errors if error.verdict == "follows temperature")

    def named(self, name: str) -> WatchedError:
        """Return the finding of an error; `KeyError` if no check determines it."""
        for error in self.errors:
            if error.series.name == name:
                return error
        raise KeyError(name)

    @property
    def brief(self) -> str:
        """Verdict and the checks that it rests on."""
        alarms = count_with_noun(len(self.alarms), "alarm")
        return f"watch of {self.machine}: {self.verdict}, {alarms} in {count_with_noun(len(self.checks), 'check')} of {self.folder}"

    def to_text(self) -> str:
        """Return the text report."""
        from twin.monitoring.watch_page import watch_text  # imports this module

        return watch_text(self)

    def display(self) -> Display:
        """Return verdict and all errors."""
        rows = [
            (
                error.series.name,
                figure(error.level, readable(error.series.unit)),
                figure(error.repeatability),
                error.verdict,
            )
            for error in self.errors
        ]
        good = {True: "still good", False: "no longer good", None: "undecided"}[self.good]
        facts = [
            ("checks", f"{len(self.checks)}, {self.checks[0].date:%Y-%m-%d} to {self.checks[-1].date:%Y-%m-%d}"),
            ("verdict", self.verdict),
            ("calibration", "" if self.tolerance_mm is None else f"{good} for {figure(self.tolerance_mm * 1e3, 'µm')}"),
            ("not determined", "; ".join(self.not_determined)),
        ]
        warnings = [note(text, loud=True) for text in warning_texts(self.warnings)]
        heads = ("error", "deviation now", "repeatability", "verdict")
        errors = table(heads, rows, right=(1, 2))
        title, small = f"Watch of {self.machine}", str(self.folder)
        return Display(title, facts, above=warnings, below=(errors,), small=small, wrong=not self.met)

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the JSON (``schema: twin.watch/1``)."""
        return {
            "schema": SCHEMA,
            "machine": self.machine,
            "calibration": self.calibration,
            "folder": str(self.folder),
            "warnings": warnings_to_json(self.warnings),
            "verdict": self.verdict,
            "met": self.met,
            "alarm_rate": {
                "whole": self.alarm_rate,
                "spent": self.spent,
                "errors": self.errors_watched,
                "log_evidence_limit": self.limit,
                "dates_of_half": POSSIBLE_DATES,
                "prior_variances": list(PRIOR_VARIANCES),
                "correlation": self.correlation,
            },
            "errors": [_finding(error, self.checks) for error in self.errors],
            "not_determined": list(self.not_determined),
            "tolerance": None
            if self.remaining is None
            else {"mm": self.tolerance_mm, "good": self.good, "remaining": json_form(self.remaining)},
            "checks": [_check(check) for check in self.checks],
            "news": list(self.news),
            "statements": [json_form(statement) for statement in self.statements],
            "notices": list(self.notices),
        }


def _finding(found: WatchedError, checks: tuple[Check, ...]) -> dict[str, Any]:
    change, series = found.change, found.series
    return {
        "name": series.name,
        "unit": series.unit,
        "verdict": found.verdict,
        "alarm": None if found.alarm is None else checks[int(series.checks[found.alarm])].name,
        "change": None if change is None or not found.alarming else _change(change),
        "temperatures": [
            {"sensor": temperature.sensor, "per_kelvin": temperature.per_kelvin, "U95": json_form(temperature.expanded)}
            for temperature in found.temperatures
        ],
        "deviation_now": json_form(found.level),
        "repeatability": json_form(found.repeatability),
        "history": [
            {
                "check": checks[int(i)].name,
                "deviation": float(value),
                "u": float(u),
                "log_evidence": float(plain),
                "log_evidence_apart_from_temperature": json_form(float(apart)),
            }
            for i, value, u, plain, apart in zip(
                series.checks, series.value, series.u, found.log_evidence, found.log_evidence_apart, strict=True
            )
        ],
    }


def _change(change: Change) -> dict[str, Any]:
    return {
        "shape": change.shape,
        "shape_certain": change.sure_shape,
        "date": date_text(change.day),
        "date_95": [date_text(change.earliest_day), date_text(change.latest_day)],
        "size": change.size,
        "U95": json_form(change.expanded),
        "per_30_days": json_form(change.per_month),
    }


def _check(check: Check) -> dict[str, Any]:
    temperatures: Mapping[str, float] = check.temperature_degC
    return {
        "name": check.name,
        "sha256": check.sha256,
        "date": check.date.isoformat(),
        "dated_by": check.dated_by,
        "read_at": check.read_at,
        "instruments": check.instruments,
        "readings": check.rows,
        "errors": list(check.errors),
        "not_determined": list(check.lost),
        "reduced_chi2": json_form(check.reduced_chi2),
        "temperature_degC": dict(temperatures),
        "notices": list(check.notices),
    }
