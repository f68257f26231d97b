"""The tests of ISO 230-3 that a drift record allows, with their values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
import scipy

from twin.machine.machine import Machine
from twin.measurement.evaluation.drift import FIRST_S, DriftSeries, drift_series, spread
from twin.standards.drift.record import DriftRecord
from twin.standards.drift.rotary import rotary_test
from twin.standards.readings import NotPossible
from twin.standards.result import StandardTest, StandardValue

STANDARD: Final = "after ISO 230-3:2020 (not verified)"
SAME_POSE: Final = 1.0
"""Difference in mm or degrees up to which positions are one pose: a probe records where the sphere was."""
LEAST_TRAVEL: Final = 5.0
"""Travel in mm or degrees above which an axis counts as moved between target positions."""
SIDEWAYS: Final = 0.3
"""Share of the travel up to which the other axes may move with it, because targets are not exactly in line."""
BESIDE: Final = 0.9
"""The same share where all readings are at two poses: those along the spindle cannot be in line."""
NOT_VERIFIED: Final = (
    "the kinds of test and the name ETVE are those of the public scope of ISO 230-3:2020; figures and symbols were not checked "
    "against its text"
)
NO_SPEED: Final = "the record has no column spindle_rpm: the spindle is taken as stopped"
AT_ONCE: Final = "displacements count from the last reading before the spindle ran, and contain shifts that come at once with the speed"
NO_AMBIENT: Final = "no error per kelvin: the sensor of the ambient temperature is not given"
PAUSE_S: Final = 3600.0
"""Time at rest, s, that ends a period of running."""
PERIODS: Final = (
    "a rest of the spindle of more than 60 min begins a new test; the machine may not have cooled down in it"
)
SHORT: Final = "the spindle ran for less than 60 min: no value of the first 60 min"


def drift_tests(record: DriftRecord, machine: Machine) -> Iterator[StandardTest]:
    """Yield the tests of a record: environment, spindle, linear axes or rotary axes.

    Parts of the record (rounds) are separate tests if several axes move.

    Raises:
        NotPossible: several axes move in one part, or a rotary axis whose errors the record does not show.
    """
    whole = np.arange(len(record))
    try:
        yield from _tests(record, whole, machine)
    except NotPossible:
        parts = list(dict.fromkeys(record.part))
        if len(parts) == 1:
            raise
        for name in parts:
            yield from _tests(record, np.flatnonzero(record.part == name), machine)


def _tests(record: DriftRecord, rows: np.ndarray, machine: Machine) -> list[StandardTest]:
    axis = _moving_axis(record.positions[rows], machine)
    if axis is not None and not machine.axes[axis].linear:
        return [rotary_test(record, rows, STANDARD)]
    if axis is not None:
        return [_axes_test(record, rows, machine, axis)]
    found = []
    for spot in dict.fromkeys(record.spot[rows]):
        own = rows[record.spot[rows] == spot]
        periods = _running_periods(record, own)
        found += [
            _spindle_test(record, period, k, len(periods), str(spot)) for k, period in enumerate(periods, start=1)
        ]
        if not periods:
            found.append(_environment_test(record, own, str(spot)))
    return found


def _moving_axis(positions: np.ndarray, machine: Machine) -> int | None:
    """Return the axis that moves between target positions; None if the pose stays. The linear axes may follow a rotary one.

    Raises:
        NotPossible: several axes move.
    """
    travel = np.ptp(positions, axis=0)
    if travel.max() <= LEAST_TRAVEL:
        return None
    turned = [i for i in machine.rotary if travel[i] > LEAST_TRAVEL]
    if len(turned) == 1:
        return turned[0]
    axis = int(np.argmax(travel))
    others = np.delete(travel, axis)
    two = _target_positions(positions[:, axis])[1]
    still = all(np.ptp(positions[two == k], axis=0).max() <= SAME_POSE for k in (1, 2)) if two.max() == 2 else False
    if others.size and others.max() > max((BESIDE if still else SIDEWAYS) * travel[axis], SAME_POSE):
        raise NotPossible("several axes move: measure one axis after the other, each in its own round")
    return axis


def _running_periods(record: DriftRecord, rows: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each period in which the spindle ran, with those at rest before and after; none if it never ran."""
    if record.speed_rpm is None:
        return []
    time, speed = record.time_s[rows], np.nan_to_num(record.speed_rpm[rows])
    ran = np.flatnonzero(speed > 0.0)
    if not len(ran):
        return []
    last = np.flatnonzero(np.diff(time[ran]) > PAUSE_S)
    starts, ends = ran[np.r_[0, last + 1]], ran[np.r_[last, len(ran) - 1]]
    before, after = np.r_[0, ends[:-1] + 1], np.r_[starts[1:], len(rows)]
    return [rows[first:end] for first, end in zip(before, after, strict=True)]


def _environment_test(record: DriftRecord, rows: np.ndarray, spot: str) -> StandardTest:
    """Evaluate the environmental temperature variation error."""
    found = _series(record, rows, "environment", np.ones(len(rows), dtype=int))
    remarks = [NOT_VERIFIED, *record.remarks]
    remarks += [NO_SPEED] if record.speed_rpm is None else []
    remarks += [] if record.ambient else [NO_AMBIENT]
    return StandardTest(
        kind="environmental temperature variation",
        name="ETVE",
        standard=STANDARD,
        axes=(),
        place="; ".join(filter(None, [f"machine at rest for {_hours(found.duration_s)}", spot])),
        values=tuple(_environment_values(record, found)),
        remarks=(*remarks, *_noise_remark(record, found), *_temperature_remark(found)),
        detail=found,
    )


def _spindle_test(record: DriftRecord, rows: np.ndarray, number: int, count: int, spot: str) -> StandardTest:
    """Evaluate one period of a rotating spindle."""
    found = _series(record, rows, "spindle", np.ones(len(rows), dtype=int))
    start, end = found.running_s or (0.0, 0.0)
    highest = 0.0 if found.speed_rpm is None else float(np.nanmax(found.speed_rpm))
    return StandardTest(
        kind="rotating spindle",
        name="spindle" if count == 1 else f"spindle{number}",
        standard=STANDARD,
        axes=(),
        place="; ".join(filter(None, [f"running for {_hours(end - start)}, up to {highest:g} rpm", spot])),
        values=tuple(_spindle_values(record, found)),
        remarks=(
            *(NOT_VERIFIED, *record.remarks, AT_ONCE),
            *([SHORT] if end - start < FIRST_S else []),
            *([PERIODS] if count > 1 else []),
            *_noise_remark(record, found),
            *_temperature_remark(found),
        ),
        detail=found,
    )


def _axes_test(record: DriftRecord, rows: np.ndarray, machine: Machine, axis: int) -> StandardTest:
    """Evaluate the test of a moving linear axis: displacements at each target position."""
    name = machine.axes[axis].name
    where = record.positions[rows, axis]
    targets, number = _target_positions(where)
    found = _series(record, rows, "axes", number)
    values = []
    for k, position in enumerate(targets, start=1):
        for one, unit in found.units.items():
            at = f"{one} at {name} {position:g}".replace("-", "−")
            values += [
                _value(record, f"e({one}){k}", f"e_{one}_{k}", found.range(one, target=k), unit, f"range of {at}"),
                _value(record, f"e({one}){k}end", f"e_{one}_{k}_end", found.end(one, target=k), unit, f"{at}, end of test"),
            ]  # fmt: skip
    along = next((one for one in (name, f"{name}1") if one in found.units), "")
    if len(targets) == 2 and along:
        growth = found.end(along, target=2) - found.end(along, target=1)
        words = f"change of the distance of {targets[1] - targets[0]:g} mm between the target positions"
        values.append(_value(record, f"e({name})2−1", f"e_{name}_21", growth, found.units[along], words, 2.0**0.5))
    remarks = [NOT_VERIFIED, *record.remarks, "displacements count from the first reading at each target position"]
    beside = {one.name: float(np.ptp(record.positions[rows, i])) for i, one in enumerate(machine.axes) if i != axis}
    remarks += [
        f"{other} is {away:g} mm apart between the target positions: its drift is in the values"
        for other, away in beside.items()
        if away > SIDEWAYS * np.ptp(where)
    ]
    if len(targets) != 2:
        remarks.append(f"not a full test: {len(targets)} target positions instead of 2")
    return StandardTest(
        kind="moving linear axis",
        name=name,
        standard=STANDARD,
        axes=(name,),
        place=f"targets at {name} {', '.join(f'{one:g}' for one in targets)}, {_hours(found.duration_s)}".replace(
            "-", "−"
        ),
        values=tuple(values),
        remarks=(*remarks, *_noise_remark(record, found), *_temperature_remark(found)),
        detail=found,
    )


def _target_positions(where: np.ndarray) -> tuple[list[float], np.ndarray]:
    """Return the target positions, ascending, and the number (n,) of that of each row, from 1."""
    order = np.sort(where)
    starts = order[np.r_[True, np.diff(order) > SAME_POSE]]
    number = np.searchsorted(starts, where, side="right")
    return [round(float(np.median(where[number == k + 1])), 3) for k in range(len(starts))], number


def _series(record: DriftRecord, rows: np.ndarray, kind: str, target: np.ndarray) -> DriftSeries:
    if len(rows) < 2:
        raise NotPossible("fewer than two readings")
    time = record.time_s[rows]
    if np.any(np.diff(time) <= 0.0):
        raise NotPossible("readings at the same time: give time_s of every reading")
    return drift_series(
        kind,  # type: ignore[arg-type]
        time,
        {name: values[rows] for name, values in record.displacement.items()},
        units=record.units,
        temperature_degC={name: values[rows] for name, values in record.temperature_degC.items()},
        speed_rpm=None if record.speed_rpm is None else record.speed_rpm[rows],
        target=target,
    )


def _environment_values(record: DriftRecord, found: DriftSeries) -> Iterator[StandardValue]:
    change = spread(found.temperature_degC[record.ambient]) if record.ambient in found.temperature_degC else np.nan
    for name, unit in found.units.items():
        value = found.range(name)
        yield _value(record, f"ETVE({name})", f"ETVE_{name}", value, unit, f"range of {name} over the test")
        if change > 0.0:
            words = f"range of {name} divided by that of the ambient temperature"
            yield _value(
                record, f"ETVE({name})/ΔT", f"ETVE_{name}_per_K", value / change, f"{unit}/K", words, 1.0 / change
            )
    if np.isfinite(change):
        yield StandardValue("ΔT", "T_ambient", change, "K", "range of the ambient temperature")


def _spindle_values(record: DriftRecord, found: DriftSeries) -> Iterator[StandardValue]:
    start, end = found.running_s or (0.0, 0.0)
    for name, unit in found.units.items():
        noun = "tilt" if unit == "urad" else "displacement"
        first = found.range(name, until_s=FIRST_S) if end - start >= FIRST_S else float("nan")
        rows = (
            (f"d({name})end", f"d_{name}_end", found.end(name), f"{noun} {name} at the end of running"),
            (f"d({name})60", f"d_{name}_60", first, f"range of {name} in the first 60 min of running"),
            (f"d({name})t", f"d_{name}_t", found.range(name), f"range of {name} over the period of running"),
        )
        for symbol, key, value, words in rows:
            yield _value(record, symbol, key, value, unit, words)


def _value(
    record: DriftRecord, symbol: str, key: str, value: float, unit: str, words: str, factor: float = 1.0
) -> StandardValue:
    """Return a value that is a difference of two readings; u is unknown for tilts."""
    u = float(np.sqrt(2.0)) * record.u_um * factor if unit.startswith("um") else float("nan")
    return StandardValue(symbol, key, value, unit, words, u)


def _temperature_remark(found: DriftSeries) -> list[str]:
    ranges = {name: spread(values) for name, values in found.temperature_degC.items()}
    known = [f"{name} {value:.1f} K" for name, value in ranges.items() if np.isfinite(value)]
    return [f"ranges of temperature: {', '.join(known)}"] if known else ["no temperatures were recorded"]


def _noise_remark(record: DriftRecord, found: DriftSeries) -> list[str]:
    """Return the range that noise alone gives: expected normal extremes after Blom (1958)."""
    n = int(np.count_nonzero(found.target == 1))
    if not (np.isfinite(record.u_um) and n > 1):
        return []
    expected = 2.0 * float(scipy.stats.norm.ppf((n - 0.375) / (n + 0.25))) * record.u_um
    return [
        f"noise alone gives a range of about {expected:.1f} µm over {n} readings; U of a range does not contain this"
    ]


def _hours(seconds: float) -> str:
    return f"{seconds / 3600.0:.1f} h" if seconds >= 7200.0 else f"{seconds / 60.0:.0f} min"
