"""One check: its file, its date, and the deviations of the constant errors from the calibration that it determines."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.csv_tables import read_table
from twin._common.errors import InputError, closest_name
from twin._common.files import folder_entries, read_bytes
from twin._common.resources import Progress, one_blas_thread, silent
from twin._common.units import MM
from twin.compensation.live import errors_while_on
from twin.identification.inputs import prepare
from twin.identification.network import Network, Unknowns
from twin.identification.solve import FitSolution, solve
from twin.identification.unidentified import NEGLIGIBLE, constant_errors, constant_unknowns, scale_unit
from twin.machine.machine import Machine
from twin.measurement.columns import grouped_notes
from twin.measurement.observation import observation_of
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import unit_of
from twin.monitoring.change import WatchedError
from twin.monitoring.record import ControlState, is_record, state_at
from twin.monitoring.tool import JudgedErrors, Remaining
from twin.monitoring.tool import at_tool as change_at_tool

SUFFIX: Final = ".csv"
ISO_DATE: Final = re.compile(r"(?<!\d)(\d{4}-\d\d-\d\d|\d{8})(?:[T_ ](\d\d)[-:.h]?(\d\d)(?:[-:.]?(\d\d))?)?(?!\d)")
"""An ISO 8601 date in a file name, with the time in any separators that a file name may have."""
DATE_COMMENT: Final = re.compile(r"(?:measured|date)\b\s*(?:on|:|=)?\s*(\d{4}-\d\d-\d\d.*)", re.I)
"""A comment of a table that gives the date of the measurement: ``measured 2026-03-02 08:10``, ``date: 2026-03-02``."""
IN_UTC: Final = " (UTC)"
"""End of the words that say where a date comes from, if it gave a time zone."""
WITH_CORRECTION: Final = " with the correction in the control"
WHILE_SWITCHED: Final = " while the correction was switched"
"""Ends of the kind of a check during which the control corrected the errors, or began or ended to."""
SECONDS_PER_DAY: Final = 86400.0


@final
@dataclass(frozen=True)
class CheckFile:
    """A file of the folder: its name, SHA-256 and path."""

    name: str
    sha256: str
    path: Path


@final
@dataclass(frozen=True)
class Check:
    """One check, as the memory keeps it."""

    name: str  # of the file
    sha256: str  # of its content
    date: datetime  # when it was measured, UTC if the file gives a time zone, else the local time of the file
    dated_by: str  # where the date comes from, in words
    instruments: str  # names of the instruments, joined; checks of other instruments have a level of their own
    rows: int  # number of readings used
    errors: tuple[str, ...]  # names of the errors that it determines
    value: np.ndarray  # (k,) their deviations from the calibration, µm, µrad or µm/m
    covariance: np.ndarray  # (k, k) from the instrument's noise
    lost: tuple[str, ...]  # combinations of constant errors that it does not determine, in words
    reduced_chi2: float  # of the residuals; NaN without degrees of freedom
    temperature_degC: Mapping[str, float]  # mean of each sensor
    simulated: bool  # whether readings were simulated
    notices: tuple[str, ...]  # among them the rows set aside
    read_at: str  # when the file was read, ISO 8601

    @property
    def day(self) -> float:
        """Date in days since 1970."""
        return self.date.replace(tzinfo=UTC).timestamp() / SECONDS_PER_DAY


def unit_of_constant(name: str) -> str:
    """Return the unit of a constant error: ``um/m`` of a scale, else ``um`` or ``urad``."""
    return "um/m" if name[3] != "0" else unit_of(name)


def files_of(folder: Path) -> tuple[list[CheckFile], list[Path], list[str]]:
    """Return the measurement tables of a folder by name, the records of its control, and the names of its other files."""
    visible = [path for path in folder_entries(folder, "the folder of checks") if not path.name.startswith(".")]
    tables = [path for path in visible if path.suffix.lower() == SUFFIX and path.is_file()]
    files, records = [], []
    for path in tables:
        content = read_bytes(path)
        if is_record(content):
            records.append(path)
        else:
            files.append(CheckFile(path.name, hashlib.sha256(content).hexdigest(), path))
    return files, records, [path.name for path in visible if path not in tables]


def date_of(file: CheckFile, given: Mapping[str, datetime]) -> tuple[datetime, str]:
    """Return the date of a check, and its source: a date given for the file, a comment of the table, or the file's name.

    The file system's time is never used: copying a file changes it. Raises `InputError`: no date, or a comment that is no date.
    """
    if file.name in given:
        return given[file.name], "given"
    for text in read_table(file.path)[2]:
        match = DATE_COMMENT.match(text)
        if match is not None:
            moment, text = parsed_date(match[1].strip(), file.path), match[1].strip()
            return moment, f"comment of the table{'' if datetime.fromisoformat(text).tzinfo is None else IN_UTC}"
    named = ISO_DATE.search(file.path.stem)
    if named is None:
        raise InputError(
            "no date",
            expected="a comment such as '# measured 2026-03-02 08:10', an ISO date in the file's name, or a date given for the file",
            file=file.path,
        )
    day, *clock = named.groups()
    text = f"{day[:4]}-{day[-4:-2]}-{day[-2:]}" if len(day) == 8 else day
    hours = [part or "00" for part in clock]
    return parsed_date(f"{text}T{':'.join(hours)}", file.path), "file name"


def parsed_date(text: str, file: Path | None = None) -> datetime:
    """Return a date without time zone, converted to UTC if the text gives one; `InputError` if it is not an ISO 8601 date."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        raise InputError(
            "not a date", expected="ISO 8601: 2026-03-02 or 2026-03-02T08:10", file=file, value=text
        ) from None
    return moment if moment.tzinfo is None else moment.astimezone(UTC).replace(tzinfo=None)


def check_names_of_dates(files: list[CheckFile], given: Mapping[str, datetime]) -> None:
    """Raise `InputError` if a date is given for a file that is not in the folder."""
    names = [file.name for file in files]
    for name in given:
        if name not in names:
            raise InputError(
                "a date is given for a file that is not in the folder",
                expected="the name of one of its tables",
                value=name,
                nearest=closest_name(name, names),
            )


def read_check(
    file: CheckFile,
    dated: tuple[datetime, str],
    machine: Machine,
    calibration: Calibration,
    read_at: datetime,
    records: Sequence[Path] = (),
) -> Check:
    """Return a check: the deviations of the constant errors that its readings determine, with the set-up estimated anew.

    All scales, squareness errors and locations of the axes that it moves are estimated together with the places of spheres and
    stations, by weighted least squares about the calibration. Those of which more than a fiftieth of the prior variance remains are
    not determined. Temperatures that the table does not give, and whether the control corrected the errors, come from the records of
    the control.
    """
    data = Measurements.load(file.path, machine)
    state = _state_during(data, dated, records)
    calibration, kind, said = _errors_then(calibration, state)
    with one_blas_thread():
        placed = prepare(machine, data, None)
        data = placed.data
        unknowns = constant_unknowns(machine, data.moved(machine))
        if not len(unknowns):
            raise data.error("no axis moved", expected="two or more positions of an axis", row=0)
        network = Network(machine, data, placed.instruments, unknowns, calibration)
        solution = _solved(network, placed.setup, calibration)
        constants = constant_errors(machine, data, placed.instruments, solution.setup)
    if not solution.converged:
        raise data.error("the estimate of the deviations did not converge", expected="more or other positions", row=0)
    count = len(unknowns)
    factor = to_units(unknowns)
    determined = np.flatnonzero(solution.spectrum.remaining_variance[:count] < NEGLIGIBLE)
    labels = [*(curve.name for curve in unknowns.curves), *unknowns.constants]
    covariance = solution.covariance()[:count, :count] * np.outer(factor, factor)
    dof = int(np.count_nonzero(network.read)) - solution.determined
    return Check(
        name=file.name,
        sha256=file.sha256,
        date=dated[0],
        dated_by=dated[1],
        instruments=" and ".join(sorted({one.name for one in placed.instruments.by_station.values()})) + kind,
        rows=len(data),
        errors=tuple(labels[i] for i in determined),
        value=(solution.theta * factor)[determined],
        covariance=covariance[np.ix_(determined, determined)],
        lost=() if constants is None else constants.lost,
        reduced_chi2=solution.chi2 / dof if dof >= 1.0 else np.nan,
        temperature_degC=({} if state is None else dict(state.temperature_degC))
        | {
            name: float(np.mean(values[np.isfinite(values)]))
            for name, values in data.temperature_degC.items()
            if np.isfinite(values).any()
        },
        simulated=data.simulated,
        notices=(*data.notices, *said, *(f"set aside, {text}" for text in grouped_notes(data.set_aside))),
        read_at=read_at.isoformat(timespec="seconds"),
    )


def _state_during(data: Measurements, dated: tuple[datetime, str], records: Sequence[Path]) -> ControlState | None:
    """Return the state of the control during a check; None if no record covers it, or only the day of the check is known."""
    date, source = dated
    if (date.hour, date.minute, date.second) == (0, 0, 0):
        return None
    times = data.time_s[np.isfinite(data.time_s)]
    length = timedelta(seconds=float(np.ptp(times))) if len(times) > 1 else None
    return state_at(records, date, length, utc=source.endswith(IN_UTC))


def _errors_then(calibration: Calibration, state: ControlState | None) -> tuple[Calibration, str, tuple[str, ...]]:
    """Return the errors of the machine during a check, the end of the check's kind, and notices.

    A check of the machine with the correction and one without it have levels of their own.
    """
    live = calibration.corrected_in_control
    if state is None:
        if not live:
            return calibration, "", ()
        text = "no record says whether the correction in the control was on: taken as on"
        return errors_while_on(calibration), WITH_CORRECTION, (text,)
    if state.on < 1.0 and state.off < 1.0:
        text = f"the correction in the control was on in {100 * state.on:.0f} % of the check: repeat it"
        mostly = live and state.on > state.off
        return errors_while_on(calibration) if mostly else calibration, WHILE_SWITCHED, (text,)
    if state.on < 1.0:
        return calibration, "", ()
    said = [] if not state.stale else ["the correction in the control used temperatures that were not new"]
    if not live and calibration.control is None:
        said.append(
            "the correction in the control was on, but the calibration does not know of it: use that of the module"
        )
    return errors_while_on(calibration) if live else calibration, WITH_CORRECTION, tuple(said)


def _solved(network: Network, setup: StationsAndTargets, calibration: Calibration) -> FitSolution:
    """Return the estimate; stations on the tool or the work start parallel to their carrier, and anew if that does not converge.

    An R-test follows the ball, so that its readings hardly show the orientation of its frame: an initial value from them may be
    anything. Its frame is nearly parallel to the table, because its sensors are aligned with the axes.
    """
    zero, weights = np.zeros(len(network.unknowns)), np.ones(len(network.data))
    free = ~setup.station_known & np.array([read.reads == "point" for read in setup.reads])
    if free.any() and not np.any(network.data.station_carrier == "base"):
        solved = solve(network, zero, _parallel(network, setup, calibration, np.flatnonzero(free)), weights)
        if solved.converged:
            return solved
    return solve(network, zero, setup, weights)


def _parallel(
    network: Network, setup: StationsAndTargets, calibration: Calibration, free: np.ndarray
) -> StationsAndTargets:
    data, targets, stations = network.data, list(setup.targets), np.array(setup.stations)
    target = np.array([targets.index(str(name)) for name in data.target])
    points = observation_of(network.machine).points_mm(calibration, data, setup.place[target] / MM)
    origin, rotation = np.array(setup.origin), np.array(setup.rotation)
    for k in free:
        own = data.station.astype(str) == stations[k]
        origin[k] = np.nanmean(points[own] - data.point_mm[own], axis=0) * MM
        rotation[k] = np.eye(3)
    return replace(setup, origin=read_only(origin), rotation=read_only(rotation))


def to_units(unknowns: Unknowns) -> np.ndarray:
    """Return (columns,) the factor from an unknown of `constant_unknowns` to the unit of `unit_of_constant`."""
    return np.array([scale_unit(curve) for curve in unknowns.curves] + [1.0] * len(unknowns.constants))


def to_json(check: Check) -> dict[str, Any]:
    """Return a check as JSON data, from which `from_json` makes the same check."""
    entry = dict(vars(check))
    return entry | {
        "date": check.date.isoformat(),
        "value": check.value.tolist(),
        "covariance": check.covariance.tolist(),
        "reduced_chi2": check.reduced_chi2 if np.isfinite(check.reduced_chi2) else None,
        "temperature_degC": dict(check.temperature_degC),
    }


def from_json(data: Mapping[str, Any]) -> Check:
    """Return the check that `to_json` wrote."""
    chi2 = data["reduced_chi2"]
    listed = {name: tuple(data[name]) for name in ("errors", "lost", "notices")}
    count = len(listed["errors"])
    return Check(
        **dict(data)
        | listed
        | {
            "date": datetime.fromisoformat(data["date"]),
            "value": np.array(data["value"], dtype=float),
            "covariance": np.array(data["covariance"], dtype=float).reshape(count, count),
            "reduced_chi2": np.nan if chi2 is None else chi2,
        }
    )


# --- Whether the calibration is still good: the error that its present deviations cause at the tool, over the volume

FALSE_ALARM_SHARE: Final = 0.05
"""For the test of the comparison, which the watch does not use."""


def levels(findings: Sequence[WatchedError], checks: Sequence[Check]) -> tuple[np.ndarray, np.ndarray]:
    """Return the (k,) deviations of the errors at the last check, and their (k, k) covariance, µm, µrad and µm/m.

    The instrument's uncertainty of one check may be common to all checks, so it is not reduced by their number. The standard
    deviation between checks beyond it is.
    """
    value = np.array([finding.level for finding in findings])
    shifts = np.zeros((len(findings), len(findings)))
    for i, one in enumerate(findings):
        for j, other in enumerate(findings):
            common = [
                checks[c].covariance[checks[c].errors.index(one.series.name), checks[c].errors.index(other.series.name)]
                for c in np.intersect1d(one.series.checks, other.series.checks)
            ]
            shifts[i, j] = float(np.mean(common)) if common else 0.0
        own = float(np.mean(one.series.u**2))
        between = max(one.repeatability**2 - own, 0.0) if np.isfinite(one.repeatability) else 0.0
        apart = np.abs(np.subtract.outer(np.arange(len(one.weights)), np.arange(len(one.weights))))
        shifts[i, i] += between * float(one.weights @ one.series.correlation**apart @ one.weights)
    return value, _positive(shifts)


def remaining_error(
    machine: Machine,
    findings: Sequence[WatchedError],
    checks: Sequence[Check],
    *,
    tool_length_mm: float | None,
    progress: Progress = silent,
) -> Remaining:
    """Return the error at the tool due to the deviations that the checks determine now, if the calibration compensates."""
    value, covariance = levels(findings, checks)
    after = deviations(machine, {one.series.name: v for one, v in zip(findings, value, strict=True)}, covariance)
    names = [effect.name for effect in after.effects]
    judged = JudgedErrors(dict.fromkeys(names, "deviations"), names, FALSE_ALARM_SHARE, {}, True)
    before = Calibration.zero(machine)
    return change_at_tool(before, after, judged, tool_length_mm=tool_length_mm, progress=progress).left


def deviations(machine: Machine, by_name: Mapping[str, float], covariance: np.ndarray) -> Calibration:
    """Return deviations of constant errors (µm, µrad and µm/m of a scale) with their (k, k) covariance as a calibration."""
    unknowns = constant_unknowns(machine, machine.names)
    labels = [*(curve.name for curve in unknowns.curves), *unknowns.constants]
    at = [labels.index(name) for name in by_name]
    rate = np.zeros((len(unknowns), len(at)))
    rate[at, range(len(at))] = 1.0 / to_units(unknowns)[at]
    theta = rate @ np.array(list(by_name.values()))
    return unknowns.calibration(theta, at, "deviations", read_only(rate @ covariance @ rate.T))[0]


def _positive(matrix: np.ndarray) -> np.ndarray:
    """Return the nearest covariance without negative eigenvalues; checks of different kinds may leave some."""
    size = np.sqrt(np.diag(matrix))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T * np.outer(size, size))
