"""The tests of ISO 230-3 that a drift record allows, with their values.

The test of thermal distortion caused by rotary motion of components: the axis's location, orientation and zero over time.

Readings at the same positions of the axis are repeated while it turns in between. The changes of one cycle of readings since the first
reading at each position are a rigid motion of the axis and a radial expansion of the table or head that it carries, by least squares.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from twin._common.distributions import normal_isf
from twin._common.errors import InputError, require_type
from twin._common.messages import Message, Number, joined
from twin._common.provenance import SIMULATED
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.table import Measurements
from twin.standards.iso230_3 import (
    FIRST_S,
    AxisDesign,
    DriftRecord,
    DriftSeries,
    SensorMap,
    drift_series,
    is_displacement_record,
    load_displacements,
    relative_displacements,
    spread,
    turning_axis,
)
from twin.standards.readings import NotPossible
from twin.standards.result import (
    EvaluationResult,
    NotEvaluated,
    StandardTest,
    StandardValue,
    check_limits,
    check_tolerances,
)

SAME_POSE: Final = 1.0
"""Difference in mm or degrees up to which positions are one pose: a probe records where the sphere was."""
FEWEST_POSES: Final = 3
RANK_TOLERANCE: Final = 1e-3
"""Singular value, relative to the largest, up to which the positions do not separate the quantities."""
DIRECTIONS: Final = "XYZ"
WORDS: Final = {
    "axial": partial(Message, "shift of the carried side along {axis}"),
    "zero": partial(Message, "zero of {axis}"),
    "radial": partial(Message, "radial expansion of the side carried by {axis}"),
}
REMARKS: Final = (
    Message(
        "the public scope of ISO 230-3:2020 names this test; positions, figures and signs are choices of twin, as "
        "is usual in R-tests of thermal errors: the standard's text was not read"
    ),
    Message("locations are those at the level of the sphere along the axis"),
    Message(
        "locations and shifts contain drifts of the spindle and the linear axes; the zero contains a tangential "
        "shift of the sphere"
    ),
)


def rotary_test(record: DriftRecord, rows: np.ndarray, standard: str) -> StandardTest:
    """Evaluate the test of a moving rotary axis."""
    if record.design is None or any(name not in record.displacement for name in DIRECTIONS):
        raise NotPossible(
            Message(
                "a rotary axis moves: its test needs a measurement table of a touch probe or an R-test, with X, Y and Z at"
                " three or more positions of the axis"
            )
        )
    design = record.design.select(rows)
    pose = _poses(record, rows)
    if pose.max() + 1 < FEWEST_POSES:
        raise NotPossible(
            Message(
                "{axis} was read at {count} positions: three or more are needed", axis=design.axis, count=pose.max() + 1
            )
        )
    values = np.stack([record.displacement[name][rows] for name in DIRECTIONS], axis=1)
    cycles = _cycles(pose)
    change, factor, residual, dof = _fitted(design, values, pose, cycles)
    kept = np.flatnonzero(np.isfinite(change[:, 0]))
    if len(kept) < 2:
        raise NotPossible(
            Message("the positions of {axis} were not repeated, or do not separate its errors", axis=design.axis)
        )
    from_residuals = float(np.sqrt(residual / (2.0 * dof))) if dof > 0 else np.nan
    u_um = float(np.fmax(record.u_um, from_residuals))
    time = np.array([record.time_s[rows[cycle]].mean() for cycle in cycles])[kept]
    found = drift_series(
        "rotary axis",
        time,
        {name: change[kept, k] for k, name in enumerate(design.names)},
        units=dict(zip(design.names, design.units, strict=True)),
        temperature_degC={
            name: np.array([values[rows[cycle]].mean() for cycle in cycles])[kept]
            for name, values in record.temperature_degC.items()
        },
    )
    return StandardTest(
        kind="moving rotary axis",
        name=design.axis,
        standard=standard,
        axes=(design.axis,),
        place=Message(
            "{count} positions, {cycles} cycles of readings, sphere {radius_mm:.0f} mm from the axis",
            count=pose.max() + 1,
            cycles=len(kept),
            radius_mm=design.radius_mm,
        ),
        values=tuple(_values(design, change[kept], np.sqrt(2.0) * u_um * factor)),
        remarks=(*REMARKS, *record.remarks, *_noise_remarks(record, from_residuals, len(cycles) - len(kept))),
        detail=found,
    )


def _poses(record: DriftRecord, rows: np.ndarray) -> np.ndarray:
    """Return the number (n,) of the pose of each row, from 0: the same parts at the same positions."""
    seen: list[tuple[str, np.ndarray]] = []
    poses = np.zeros(len(rows), dtype=int)
    for k, row in enumerate(rows):
        spot, at = str(record.spot[row]), record.positions[row]
        same = [n for n, (name, q) in enumerate(seen) if name == spot and np.abs(at - q).max() <= SAME_POSE]
        poses[k] = same[0] if same else len(seen)
        if not same:
            seen.append((spot, at))
    return poses


def _cycles(pose: np.ndarray) -> list[np.ndarray]:
    """Return the rows of each cycle: one ends where a pose is read again."""
    starts, inside = [0], set[int]()
    for k, number in enumerate(pose.tolist()):
        if number in inside:
            starts.append(k)
            inside = set()
        inside.add(number)
    return np.split(np.arange(len(pose)), starts[1:])


def _fitted(
    design: AxisDesign, values_um: np.ndarray, pose: np.ndarray, cycles: list[np.ndarray]
) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Return the changes (cycles, 7), their uncertainty per that of a change of one reading (7,), and the residuals.

    The residuals are their sum of squares and the degrees of freedom.
    """
    first = np.array([values_um[np.flatnonzero(pose == number)[0]] for number in range(pose.max() + 1)])
    since = values_um - first[pose]
    count = len(design.names)
    change, factors = np.full((len(cycles), count), np.nan), []
    residual, dof = 0.0, 0
    for k, rows in enumerate(cycles):
        read = np.isfinite(since[rows]).reshape(-1)
        matrix, change_um = design.matrix[rows].reshape(-1, count)[read], since[rows].reshape(-1)[read]
        size = np.linalg.norm(matrix, axis=0)
        if len(matrix) < count or not np.all(size > 0.0):
            continue
        singular = np.linalg.svd(matrix / size, compute_uv=False)
        if singular[-1] < RANK_TOLERANCE * singular[0]:
            continue
        inverse = np.linalg.pinv(matrix)
        change[k] = inverse @ change_um
        factors.append(np.linalg.norm(inverse, axis=1))
        if k:
            off = change_um - matrix @ change[k]
            residual, dof = residual + float(off @ off), dof + len(matrix) - count
    return change, np.max(factors, axis=0) if factors else np.full(count, np.nan), residual, dof


def _values(design: AxisDesign, change: np.ndarray, u: np.ndarray) -> Iterator[StandardValue]:
    for k, (name, unit) in enumerate(zip(design.names, design.units, strict=True)):
        what = WORDS[name.partition("_")[0]](axis=design.axis) if name[:2] != "E_" else name
        symbol, own, uncertainty = name.replace("_", " ") if name[:2] != "E_" else name, change[:, k], float(u[k])
        yield StandardValue(
            f"Δ({symbol})end",
            f"{name}_end",
            float(own[-1] - own[0]),
            unit,
            Message("change of {what} until the end", what=what),
            uncertainty,
        )
        yield StandardValue(
            f"Δ({symbol})t",
            f"{name}_t",
            float(np.ptp(own)),
            unit,
            Message("range of {what} over the test", what=what),
            uncertainty,
        )


def _noise_remarks(record: DriftRecord, from_residuals: float, incomplete: int) -> Iterator[Message]:
    if np.isfinite(from_residuals):
        within = bool(from_residuals <= record.u_um)
        stated = (
            Message("none is stated")
            if not np.isfinite(record.u_um)
            else Message("within the {u_um:.1f} µm stated", u_um=record.u_um)
            if within
            else Message("larger than the {u_um:.1f} µm stated", u_um=record.u_um)
        )
        used = "" if within else Message(", and gives U")
        yield Message(
            "standard uncertainty of a reading from the residuals: {from_residuals:.2f} µm ({stated}){used}",
            from_residuals=from_residuals,
            stated=stated,
            used=used,
        )
    else:
        yield Message("no degrees of freedom: more positions of the axis would check the rigid motion")
    if incomplete:
        yield Message("{incomplete} cycles without enough positions were not used", incomplete=incomplete)


# --- The tests of ISO 230-3 that a drift record allows, with their values -------------------------

STANDARD: Final = "after ISO 230-3:2020 (not verified)"
LEAST_TRAVEL: Final = 5.0
"""Travel in mm or degrees above which an axis counts as moved between target positions."""
SIDEWAYS: Final = 0.3
"""Share of the travel up to which the other axes may move with it, because targets are not exactly in line."""
BESIDE: Final = 0.9
"""The same share where all readings are at two poses: those along the spindle cannot be in line."""
NOT_VERIFIED: Final = Message(
    "the kinds of test and the name ETVE are those of the public scope of ISO 230-3:2020; figures and symbols "
    "were not checked against its text"
)
NO_SPEED: Final = Message("the record has no column spindle_rpm: the spindle is taken as stopped")
AT_ONCE: Final = Message(
    "displacements count from the last reading before the spindle ran, and contain shifts that come at once "
    "with the speed"
)
NO_AMBIENT: Final = Message("no error per kelvin: the sensor of the ambient temperature is not given")
PAUSE_S: Final = 3600.0
"""Time at rest, s, that ends a period of running."""
PERIODS: Final = Message(
    "a rest of the spindle of more than 60 min begins a new test; the machine may not have cooled down in it"
)
SHORT: Final = Message("the spindle ran for less than 60 min: no value of the first 60 min")


def drift_tests(record: DriftRecord, machine: Machine) -> Iterator[StandardTest]:
    """Yield the tests of a record: environment, spindle, linear axes or rotary axes.

    Parts of the record (rounds) are separate tests if several axes move.
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
    tests = []
    for spot in dict.fromkeys(record.spot[rows]):
        own = rows[record.spot[rows] == spot]
        periods = _running_periods(record, own)
        tests += [
            _spindle_test(record, period, k, len(periods), str(spot)) for k, period in enumerate(periods, start=1)
        ]
        if not periods:
            tests.append(_environment_test(record, own, str(spot)))
    return tests


def _moving_axis(positions: np.ndarray, machine: Machine) -> int | None:
    """Return the axis that moves between target positions; None if the pose stays. The linear axes may follow a rotary one."""
    travel = np.ptp(positions, axis=0)
    if travel.max() <= LEAST_TRAVEL:
        return None
    turned = turning_axis(positions, machine)
    if turned is not None:
        return machine.names.index(turned.name)
    axis = int(np.argmax(travel))
    others = np.delete(travel, axis)
    two = _target_positions(positions[:, axis])[1]
    still = all(np.ptp(positions[two == k], axis=0).max() <= SAME_POSE for k in (1, 2)) if two.max() == 2 else False
    if others.size and others.max() > max((BESIDE if still else SIDEWAYS) * travel[axis], SAME_POSE):
        raise NotPossible(Message("several axes move: measure one axis after the other, each in its own round"))
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
    series = _series(record, rows, "environment", np.ones(len(rows), dtype=int))
    remarks = [NOT_VERIFIED, *record.remarks]
    remarks += [NO_SPEED] if record.speed_rpm is None else []
    remarks += [] if record.ambient else [NO_AMBIENT]
    return StandardTest(
        kind="environmental temperature variation",
        name="ETVE",
        standard=STANDARD,
        axes=(),
        place=joined(
            "; ",
            [Message("machine at rest for {duration}", duration=_hours(series.duration_s)), *([spot] if spot else [])],
        ),
        values=tuple(_environment_values(record, series)),
        remarks=(*remarks, *_noise_remark(record, series), *_temperature_remark(series)),
        detail=series,
    )


def _spindle_test(record: DriftRecord, rows: np.ndarray, number: int, count: int, spot: str) -> StandardTest:
    """Evaluate one period of a rotating spindle."""
    series = _series(record, rows, "spindle", np.ones(len(rows), dtype=int))
    start, end = series.running_s or (0.0, 0.0)
    highest = 0.0 if series.speed_rpm is None else float(np.nanmax(series.speed_rpm))
    return StandardTest(
        kind="rotating spindle",
        name="spindle" if count == 1 else f"spindle{number}",
        standard=STANDARD,
        axes=(),
        place=joined(
            "; ",
            [
                Message("running for {duration}, up to {highest:g} rpm", duration=_hours(end - start), highest=highest),
                *([spot] if spot else []),
            ],
        ),
        values=tuple(_spindle_values(record, series)),
        remarks=(
            *(NOT_VERIFIED, *record.remarks, AT_ONCE),
            *([SHORT] if end - start < FIRST_S else []),
            *([PERIODS] if count > 1 else []),
            *_noise_remark(record, series),
            *_temperature_remark(series),
        ),
        detail=series,
    )


def _axes_test(record: DriftRecord, rows: np.ndarray, machine: Machine, axis: int) -> StandardTest:
    """Evaluate the test of a moving linear axis: displacements at each target position."""
    name = machine.axes[axis].name
    where = record.positions[rows, axis]
    targets, number = _target_positions(where)
    series = _series(record, rows, "axes", number)
    values = []
    for k, position in enumerate(targets, start=1):
        for one, unit in series.units.items():
            at = Message("{one} at {name} {position}", one=one, name=name, position=f"{position:g}".replace("-", "−"))
            values += [
                _value(record, f"e({one}){k}", f"e_{one}_{k}", series.range(one, target=k), unit,
                       Message("range of {what}", what=at)),
                _value(record, f"e({one}){k}end", f"e_{one}_{k}_end", series.end(one, target=k), unit,
                       Message("{what}, end of test", what=at)),
            ]  # fmt: skip
    along = next((one for one in (name, f"{name}1") if one in series.units), "")
    if len(targets) == 2 and along:
        growth = series.end(along, target=2) - series.end(along, target=1)
        words = Message(
            "change of the distance of {distance:g} mm between the target positions", distance=targets[1] - targets[0]
        )
        values.append(_value(record, f"e({name})2−1", f"e_{name}_21", growth, series.units[along], words, 2.0**0.5))
    remarks = [
        NOT_VERIFIED,
        *record.remarks,
        Message("displacements count from the first reading at each target position"),
    ]
    beside = {one.name: float(np.ptp(record.positions[rows, i])) for i, one in enumerate(machine.axes) if i != axis}
    remarks += [
        Message(
            "{other} is {away:g} mm apart between the target positions: its drift is in the values",
            other=other,
            away=away,
        )
        for other, away in beside.items()
        if away > SIDEWAYS * np.ptp(where)
    ]
    if len(targets) != 2:
        remarks.append(Message("not a full test: {count} target positions instead of 2", count=len(targets)))
    return StandardTest(
        kind="moving linear axis",
        name=name,
        standard=STANDARD,
        axes=(name,),
        place=Message(
            "targets at {name} {targets}, {duration}",
            name=name,
            targets=", ".join(f"{target:g}" for target in targets).replace("-", "−"),
            duration=_hours(series.duration_s),
        ),
        values=tuple(values),
        remarks=(*remarks, *_noise_remark(record, series), *_temperature_remark(series)),
        detail=series,
    )


def _target_positions(where: np.ndarray) -> tuple[list[float], np.ndarray]:
    """Return the target positions, ascending, and the number (n,) of that of each row, from 1."""
    order = np.sort(where)
    starts = order[np.r_[True, np.diff(order) > SAME_POSE]]
    number = np.searchsorted(starts, where, side="right")
    return [round(float(np.median(where[number == k + 1])), 3) for k in range(len(starts))], number


def _series(record: DriftRecord, rows: np.ndarray, kind: str, target: np.ndarray) -> DriftSeries:
    if len(rows) < 2:
        raise NotPossible(Message("fewer than two readings"))
    time = record.time_s[rows]
    if np.any(np.diff(time) <= 0.0):
        raise NotPossible(Message("readings at the same time: give time_s of every reading"))
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
        yield _value(
            record, f"ETVE({name})", f"ETVE_{name}", value, unit, Message("range of {name} over the test", name=name)
        )
        if change > 0.0:
            words = Message("range of {name} divided by that of the ambient temperature", name=name)
            yield _value(
                record, f"ETVE({name})/ΔT", f"ETVE_{name}_per_K", value / change, f"{unit}/K", words, 1.0 / change
            )
    if np.isfinite(change):
        yield StandardValue("ΔT", "T_ambient", change, "K", Message("range of the ambient temperature"))


def _spindle_values(record: DriftRecord, found: DriftSeries) -> Iterator[StandardValue]:
    start, end = found.running_s or (0.0, 0.0)
    for name, unit in found.units.items():
        noun = Message("tilt") if unit == "urad" else Message("displacement")
        first = found.range(name, until_s=FIRST_S) if end - start >= FIRST_S else float("nan")
        rows = (
            (
                f"d({name})end",
                f"d_{name}_end",
                found.end(name),
                Message("{noun} {name} at the end of running", noun=noun, name=name),
            ),
            (
                f"d({name})60",
                f"d_{name}_60",
                first,
                Message("range of {name} in the first 60 min of running", name=name),
            ),
            (
                f"d({name})t",
                f"d_{name}_t",
                found.range(name),
                Message("range of {name} over the period of running", name=name),
            ),
        )
        for symbol, key, value, words in rows:
            yield _value(record, symbol, key, value, unit, words)


def _value(
    record: DriftRecord, symbol: str, key: str, value: float, unit: str, words: str, factor: float = 1.0
) -> StandardValue:
    """Return a value that is a difference of two readings; u is unknown for tilts."""
    u = float(np.sqrt(2.0)) * record.u_um * factor if unit.startswith("um") else float("nan")
    return StandardValue(symbol, key, value, unit, words, u)


def _temperature_remark(found: DriftSeries) -> list[Message]:
    ranges = {name: spread(values) for name, values in found.temperature_degC.items()}
    known = [f"{name} {value:.1f} K" for name, value in ranges.items() if np.isfinite(value)]
    return (
        [Message("ranges of temperature: {ranges}", ranges=Number(", ".join(known)))]
        if known
        else [Message("no temperatures were recorded")]
    )


def _noise_remark(record: DriftRecord, found: DriftSeries) -> list[Message]:
    """Return the range that noise alone gives: expected normal extremes after Blom (1958)."""
    n = int(np.count_nonzero(found.target == 1))
    if not (np.isfinite(record.u_um) and n > 1):
        return []
    expected = 2.0 * float(normal_isf(0.625 / (n + 0.25))) * record.u_um
    return [
        Message(
            "noise alone gives a range of about {expected:.1f} µm over {n} readings; U of a range does not contain "
            "this",
            expected=expected,
            n=n,
        )
    ]


def _hours(seconds: float) -> Number:
    return Number(f"{seconds / 3600.0:.1f} h" if seconds >= 7200.0 else f"{seconds / 60.0:.0f} min")


TITLE: Final = Message("thermal tests (ISO 230-3)")
BUDGET: Final = Message(
    "U (95 %) contains the noise of two readings only: no drift of the instrument, no expansion of mandrel or fixture."
)


def evaluate_drift(
    path: str | Path,
    machine: Machine,
    *,
    tolerances: Mapping[str, float] | None = None,
    instrument: Instrument | None = None,
    sensors: Sequence[str] = (),
) -> EvaluationResult:
    """Evaluate the tests of ISO 230-3: environment, rotating spindle, moving linear axes.

    Args:
        path: a record of displacement sensors (``time_s``, ``<name>_um``), or a measurement table with ``time_s``.
        machine: the machine that was measured.
        tolerances: largest permitted values by key (``d_Z_t``) or name of the test and key (``spindle:d_Z_t``); µm, µrad.
        instrument: instrument whose noise model gives the uncertainty of a table's readings.
        sensors: directions of displacement sensors (``d1=X1``), distances (``X1-X2=76``), ambient sensor (``t5=ambient``).

    Raises:
        InputError: a file that is neither, directions that cannot be read, a negative tolerance.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> time_s = np.arange(0.0, 14400.1, 300.0)
        >>> growth_um = 20.0 * (1.0 - np.exp(-time_s / 3600.0))
        >>> rows = np.column_stack([time_s, np.full_like(time_s, 8000.0), growth_um])
        >>> np.savetxt("spindle.csv", rows, delimiter=",", header="time_s,spindle_rpm,d1_um", comments="")
        >>> (test,) = twin.evaluate_drift("spindle.csv", machine, sensors=["d1=Z"]).tests
        >>> {value.key: round(value.value, 1) for value in test.main_values}  # µm
        {'d_Z_end': 19.6, 'd_Z_60': 12.6, 'd_Z_t': 19.6}

    References:
        - ISO 230-3:2020, Determination of thermal effects.
    """
    require_type("machine", machine, Machine)
    check_limits(tolerances or {})
    directions = SensorMap.parse(sensors)
    record = _record(path, machine, directions, instrument)
    tests: list[StandardTest] = []
    missing: list[NotEvaluated] = []
    try:
        tests += drift_tests(record, machine)
    except NotPossible as reason:
        missing.append(NotEvaluated(TITLE, reason.why))
    return EvaluationResult(
        data=record,
        machine=machine.name,
        tests=tuple(tests),
        not_evaluated=tuple(missing),
        assumptions=(),
        uncertainty=BUDGET if np.isfinite(record.u_um) else Message(""),
        checks=check_tolerances(tolerances or {}, tests),
        warnings=(SIMULATED,) if record.simulated else (),
    )


def _record(path: str | Path, machine: Machine, directions: SensorMap, instrument: Instrument | None) -> DriftRecord:
    if is_displacement_record(path):
        if instrument is not None:
            raise InputError(
                "a record of displacement sensors has no noise model", expected="no instrument", value=instrument.name
            )
        return load_displacements(path, machine, directions)
    if directions.sensor or directions.distance_mm:
        raise InputError(
            "directions of sensors are for records with columns <name>_um", expected="such a record", file=Path(path)
        )
    data = Measurements.load(path, machine)
    if directions.ambient:
        directions.check([], list(data.temperature_degC))
    return relative_displacements(data, machine, instrument, directions.ambient_of(data.temperature_degC))
