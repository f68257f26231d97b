"""The watch of a folder: read what is new, compare every error with its history, remember what was said."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError, require_type
from twin._common.provenance import SIMULATED, merge_warnings
from twin._common.resources import Progress, silent
from twin._common.units import count_with_noun
from twin.machine.machine import Machine
from twin.model.calibration import Calibration
from twin.monitoring.change import ErrorSeries, WatchedError, examine, lag_correlation, spent_share
from twin.monitoring.check import (
    Check,
    CheckFile,
    check_names_of_dates,
    date_of,
    files_of,
    read_check,
    remaining_error,
    unit_of_constant,
)
from twin.monitoring.record import ControlRecord
from twin.monitoring.tool import Remaining
from twin.monitoring.watch_page import headline
from twin.monitoring.watched import Remembered, Watch, WatchKey, WatchStatement, memory_path, recall, remember

TESTS: Final = 2
"""Tests of each error that may give an alarm: temperatures ignored, and with a temperature as a possible cause."""


@final
@dataclass(frozen=True)
class WatchSettings:
    """Settings of a watch.

    Attributes:
        alarm_rate: probability of any alarm for an unchanged machine, over the whole watch.
        tolerance_mm: largest permitted error at the tool; None: not asked.
        tool_length_mm: tool length for that error; None for the machine file's.
        dates: dates of checks by file name, where neither a comment nor the name gives one.
        since: earlier checks are not used; None for all. Set it after a repair or a new calibration.

    Examples:
        >>> from datetime import datetime
        >>> settings = twin.WatchSettings(alarm_rate=0.01, tolerance_mm=0.05, since=datetime(2026, 3, 1))
        >>> settings.alarm_rate
        0.01
    """

    alarm_rate: float = 0.05
    tolerance_mm: float | None = None
    tool_length_mm: float | None = None
    dates: Mapping[str, datetime] = field(default_factory=lambda: MappingProxyType({}))
    since: datetime | None = None

    def check(self) -> None:
        """Raise `InputError` for a rate that is no probability or a tolerance that is not positive."""
        if not 0.0 < self.alarm_rate < 1.0:
            raise InputError("the alarm rate is no probability", expected="between 0 and 1", value=self.alarm_rate)
        if self.tolerance_mm is not None and not 0.0 < self.tolerance_mm < np.inf:
            raise InputError("tolerance must be positive", expected="a positive number of mm", value=self.tolerance_mm)


def watch(
    folder: str | Path,
    machine: Machine,
    calibration: Calibration,
    *,
    settings: WatchSettings | None = None,
    now: datetime | None = None,
    progress: Progress = silent,
) -> Watch:
    """Compare the checks in a folder with a calibration: what changed, since when, is it temperature, is the calibration still good.

    Files that were read before are taken from the memory beside the folder; only new ones are read. If there are new ones, the memory
    is extended by them and by the new statement.

    Args:
        folder: the folder; each ``.csv`` file is a measurement table of this machine.
        machine: the machine.
        calibration: the calibration to compare with.
        settings: alarm rate, tolerance, dates.
        now: time of the look; the computer's if None.
        progress: called with the stage and the fraction done.

    Raises:
        InputError: no folder, no checks, a file that is not a measurement of this machine or has no date, a calibration whose estimate
            did not converge, or a memory that cannot be used.

    Examples:
        >>> from pathlib import Path
        >>> machine = twin.Machine.load("dmu50")
        >>> check, probe = twin.measuring_sequence(machine, "probe", "turns").table, twin.instruments.TouchProbe()
        >>> Path("checks").mkdir()
        >>> for day in range(1, 9):  # on the fifth day the C axis is 30 µm off
        ...     real = twin.Calibration(machine, "truth", {}, {}, {"E_X0C": 30.0} if day > 4 else {})
        ...     data, _ = twin.simulate(check, machine, real, probe, np.random.default_rng(day))
        ...     data.save(f"checks/2026-03-0{day}.csv", machine)
        >>> found = twin.watch("checks", machine, twin.Calibration.zero(machine))
        >>> found.verdict, [error.series.name for error in found.alarms]
        ('changed', ['E_X0C'])

    References:
        - H. Robbins: Statistical methods related to the law of the iterated logarithm, Ann. Math. Statist. 41 (1970) 1397-1409.
        - M. F. Pérez-Ortiz, T. Lardy, R. de Heide, P. D. Grünwald: E-statistics, group invariance and anytime-valid testing, Ann.
          Statist. 52 (2024) 1410-1432.
        - B. E. Hansen: Sample splitting and threshold estimation, Econometrica 68 (2000) 575-603 (date of a change).
    """
    require_type("machine", machine, Machine)
    require_type("calibration", calibration, Calibration)
    folder, settings = Path(folder), WatchSettings() if settings is None else settings
    settings.check()
    calibration.check_settled()
    looked = (datetime.now() if now is None else now).isoformat(timespec="seconds")
    key, memory = _key(machine, calibration, settings), memory_path(folder)
    files, records, ignored = files_of(folder)
    check_names_of_dates(files, settings.dates)
    known = recall(memory, key)
    new = _new_checks(files, records, known, machine, calibration, settings, looked, progress)
    checks = tuple(sorted((*known.checks, *new), key=lambda one: (one.date, one.name)))
    if not checks:
        raise InputError("no check in the folder", expected="measurement tables (.csv)", file=folder)
    errors, remaining, watched, limit = _examined(checks, machine, settings, progress)
    found = Watch(
        folder=folder,
        memory=memory,
        machine=machine.name,
        calibration=key.calibration,
        checks=checks,
        errors=errors,
        not_determined=_not_determined(checks),
        alarm_rate=settings.alarm_rate,
        spent=settings.alarm_rate * spent_share(len(checks)),
        errors_watched=watched,
        limit=limit,
        tolerance_mm=settings.tolerance_mm,
        remaining=remaining,
        news=_news(new, known),
        statements=known.statements,
        notices=(*_file_notices(files, ignored, known, new), *_record_notices(records), *_check_notices(checks)),
        warnings=merge_warnings(calibration.warnings, (SIMULATED,) if any(check.simulated for check in checks) else ()),
    )
    return _remembered(found, key, new, looked) if new else found


def _remembered(found: Watch, key: WatchKey, new: Sequence[Check], looked: str) -> Watch:
    """Write what the watch says now into its memory, and return the watch with it."""
    text = f"{headline(found)}.\n{found.to_text()}"
    said = WatchStatement(looked, len(found.checks), found.spent, found.verdict, text)
    remember(found.memory, key, new, said)
    return replace(found, statements=(*found.statements, said))


def _examined(
    checks: Sequence[Check], machine: Machine, settings: WatchSettings, progress: Progress
) -> tuple[tuple[WatchedError, ...], Remaining | None, int, float]:
    """Return every error, in the order in which the checks name them, what remains at the tool, their number, the limit."""
    progress("comparing", 0.8)
    linear = [axis.name for axis in machine.axes if axis.linear]
    watched = len([*linear, *machine.squareness_names, *machine.location_names])
    every = [series_of(name, checks) for name in dict.fromkeys(name for check in checks for name in check.errors)]
    correlation = lag_correlation(every)
    limit = float(np.log(TESTS * watched / settings.alarm_rate))
    errors = tuple(examine(replace(one, correlation=correlation), limit) for one in every)
    if settings.tolerance_mm is None or not errors:
        return errors, None, watched, limit
    length = settings.tool_length_mm
    remaining = remaining_error(machine, errors, checks, tool_length_mm=length, progress=progress)
    return errors, remaining, watched, limit


def _not_determined(checks: Sequence[Check]) -> tuple[str, ...]:
    seen = {name for check in checks for name in check.errors}
    return tuple(text for text in checks[0].lost if text not in seen and all(text in check.lost for check in checks))


def _key(machine: Machine, calibration: Calibration, settings: WatchSettings) -> WatchKey:
    since = "" if settings.since is None else settings.since.isoformat()
    name = calibration.source if calibration.path is None else str(calibration.path)
    parts = (machine.name, calibration.to_yaml(), repr(settings.alarm_rate), since)
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()
    return WatchKey(digest, machine.name, name, settings.alarm_rate, since)


def _new_checks(
    files: Sequence[CheckFile],
    records: Sequence[Path],
    known: Remembered,
    machine: Machine,
    calibration: Calibration,
    settings: WatchSettings,
    looked: str,
    progress: Progress,
) -> list[Check]:
    """Return the checks that were not read before; copies of others are left out."""
    names, digests = {check.name for check in known.checks}, {check.sha256 for check in known.checks}
    unread = [file for file in files if file.name not in names]
    new_checks: list[Check] = []
    for i, file in enumerate(unread):
        progress("reading", 0.8 * i / len(unread))
        if file.sha256 in digests:
            continue
        dated = date_of(file, settings.dates)
        if settings.since is not None and dated[0] < settings.since:
            continue
        new_checks.append(read_check(file, dated, machine, calibration, datetime.fromisoformat(looked), records))
        digests.add(file.sha256)
    return new_checks


def series_of(name: str, checks: Sequence[Check]) -> ErrorSeries:
    """Return the series of one error over the checks that determine it."""
    own = [i for i, check in enumerate(checks) if name in check.errors]
    some = [checks[i] for i in own]
    at = [check.errors.index(name) for check in some]
    sensors = list(dict.fromkeys(sensor for check in some for sensor in check.temperature_degC))
    return ErrorSeries(
        name=name,
        unit=unit_of_constant(name),
        checks=read_only(np.array(own, dtype=int)),
        days=read_only(np.array([check.day for check in some])),
        value=read_only(np.array([check.value[i] for check, i in zip(some, at, strict=True)])),
        u=read_only(np.sqrt([check.covariance[i, i] for check, i in zip(some, at, strict=True)])),
        kind=read_only(np.array([check.instruments for check in some], dtype=object)),
        temperature_degC=MappingProxyType(
            {s: read_only(np.array([check.temperature_degC.get(s, np.nan) for check in some])) for s in sensors}
        ),
    )


def _news(new: Sequence[Check], known: Remembered) -> tuple[str, ...]:
    if not new:
        return ()
    late = [one.name for one in new if known.checks and one.date < max(old.date for old in known.checks)]
    news = [f"read: {count_with_noun(len(new), 'new file')}"]
    if late:
        news.append(
            f"older than checks that were read before: {', '.join(late)}; the history was computed anew with them"
        )
    return tuple(news)


def _file_notices(
    files: Sequence[CheckFile], ignored: Sequence[str], known: Remembered, new: Sequence[Check]
) -> list[str]:
    """Return what is unusual about the files: changed, vanished, copied or ignored, and watches with other settings."""
    by_name = {file.name: file.sha256 for file in files}
    file_notices = []
    for check in known.checks:
        if check.name not in by_name:
            file_notices.append(
                f"{check.name} is no longer in the folder since it was read on {check.read_at}; what was read is still used"
            )
        elif by_name[check.name] != check.sha256:
            file_notices.append(
                f"{check.name} CHANGED since it was read on {check.read_at}; what was read then is still used. To use the new content, "
                "save it under another name and date, or remove the memory file and begin a new watch"
            )
    read = {one.name: one.sha256 for one in (*known.checks, *new)}
    owner = {digest: name for name, digest in read.items()}
    copies = [
        f"{name} (of {owner[digest]})" for name, digest in by_name.items() if name not in read and digest in owner
    ]
    if copies:
        file_notices.append(f"copies of other files, not counted twice: {', '.join(copies)}")
    if ignored:
        file_notices.append(f"not measurement tables (.csv), ignored: {count_with_noun(len(ignored), 'file')}")
    if known.others:
        file_notices.append(
            f"the memory holds {count_with_noun(known.others, 'other watch')[: None if known.others == 1 else -1]}"
            f"{'' if known.others == 1 else 'es'} of this folder, with another calibration, first day or alarm rate; each watch has an "
            "alarm rate of its own"
        )
    return file_notices


def _record_notices(records: Sequence[Path]) -> list[str]:
    if not records:
        return []
    last = max(map(ControlRecord.load, records[-2:]), key=lambda one: one.begin)
    state = "no rows" if last.whole is None else last.whole.text
    return [f"{count_with_noun(len(records), 'record')} of the control; {last.path.name}: {state}"]


def _check_notices(checks: Sequence[Check]) -> list[str]:
    """Return the notices of the checks, each once, with the number of checks that give it."""
    given: dict[str, list[str]] = {}
    for check in checks:
        for text in check.notices:
            given.setdefault(text, []).append(check.name)
    found = [
        f"{names[0] if len(names) == 1 else count_with_noun(len(names), 'check')}: {text}"
        for text, names in given.items()
    ]
    by_source: dict[str, int] = {}
    for check in checks:
        by_source[check.dated_by] = by_source.get(check.dated_by, 0) + 1
    dated = ", ".join(f"{source} ({count_with_noun(count, 'check')})" for source, count in by_source.items())
    return [f"dates: {dated}", *found]
