"""The causes that are tried: every row of the contract's table of effects, wherever on this machine it can sit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

import numpy as np

from twin._common.units import UM
from twin.diagnosis.affine import affine_errors
from twin.diagnosis.bounds import LONGEST_PERIOD, largest
from twin.diagnosis.drift import STRAIGHT, Drift, of_machine, of_station
from twin.diagnosis.flaws import ITSELF, STOPS, of_curve, without_constant
from twin.diagnosis.functions import Functions, Rows, given
from twin.diagnosis.loads import free_payload, payloads_of, yielding
from twin.diagnosis.reversals import VARYING, lost_motion
from twin.diagnosis.signatures import (
    LARGEST,
    Column,
    Field,
    Part,
    along_command,
    first_component,
    of_components,
    of_effect,
    of_values,
)
from twin.diagnosis.velocity import time_skews
from twin.diagnosis.waves import highest_frequency, highest_order, waves
from twin.identification.unknowns import CurveSpace
from twin.machine.calibration import Calibration
from twin.machine.effects import (
    AxisLocation,
    CrossAxis,
    Effect,
    ErrorMotion,
    GravityCompliance,
    Harmonic,
    PitchError,
    Reversal,
    ReversalCurve,
    Squareness,
    TableLoad,
    ThermalDrift,
    ThermalExpansion,
    ThermalGrowth,
    ZeroOffset,
    split_name,
    unit_of,
)
from twin.machine.effects.registry import PAYLOAD, at_rest, base_vector, gravity_compliance, loads_of, tool_base_frame
from twin.machine.machine import DIRECTIONS, Axis, Machine
from twin.measurement.table import Measurements, state_of
from twin.numerics.curves import POWER, conversion

CUBIC: Final = 3
"""Degree of what is added to a curve that is no polynomial."""
DEGREES: Final = 8
"""Largest degree of a curve that is tried."""
ORDERS: Final = 30
"""Harmonics of an error motion that are tried."""
TEETH: Final = 200
"""Of a rotary axis's own angle error, which gears and encoders make: as far as the positions measured can tell them from lower ones."""

Build = Callable[[np.ndarray], tuple[Effect, ...]]


@final
@dataclass(frozen=True)
class Cell:
    """One form a candidate can take: some columns, some fixed non-linear parameters.

    Attributes:
        columns: their signatures.
        fixed: non-linear parameters by name.
    """

    columns: tuple[Column, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)


@final
@dataclass(frozen=True)
class Candidate:
    """One cause at one place.

    Attributes:
        effect: contract §5.
        where: contract §5.
        origin: ``machine`` or ``instrument``.
        names: (name, unit) of its linear parameters, the first of as many as a cell has.
        cells: the forms it can take.
        tests: how many independent ones that is, for the price of the search.
        space: the functions a curve's columns are, if it is one.
        largest: magnitude its linear parameters can have on a real machine, in their unit.
        drift: its columns at any time constant, if it is one.
        build: linear parameters and fixed ones → the effects that extend the model; None for the instrument's.
    """

    effect: str
    where: str
    origin: str
    names: tuple[tuple[str, str], ...]
    cells: tuple[Cell, ...]
    tests: float
    build: Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]] | None = None
    space: CurveSpace | None = None
    largest: float = np.inf
    drift: Drift | None = None

    @property
    def key(self) -> tuple[str, str]:
        """Effect and where."""
        return self.effect, self.where


@final
@dataclass(frozen=True)
class Catalogue:
    """What can be tried on these data, and what cannot.

    Attributes:
        candidates: tried.
        not_evaluated: (effect, where, what is missing).
    """

    candidates: tuple[Candidate, ...]
    not_evaluated: tuple[tuple[str, str, str], ...]


def catalogue(machine: Machine, data: Measurements, calibration: Calibration) -> Catalogue:
    """Every effect of contract §5 that this machine can have, on data that have the columns for it.

    Args:
        machine: the machine.
        data: the measurements.
        calibration: the model that is judged: a rotary axis's curve can be wrong as a whole only where it has a polynomial.
    """
    state = state_of(data, machine)
    found: list[Candidate] = []
    missing: list[tuple[str, str, str]] = []
    linear = [axis for axis in machine.axes if axis.linear]
    for axis in machine.axes:
        unit = "um" if axis.linear else "urad"
        if f"approach_{axis.name}" in state:
            found.append(
                _single("reversal", axis.name, Reversal(axis, 1.0), machine, state, ("size", unit), _re(Reversal, axis))
            )
        else:
            missing.append(("reversal", axis.name, f"approach_{axis.name}"))
        found.append(
            _single(
                "zero_offset", axis.name, ZeroOffset(axis, 1.0), machine, state, ("offset", unit), _re(ZeroOffset, axis)
            )
        )
    for axis in linear:
        pitch = _pitch(axis, machine, state)
        if pitch.cells:
            found.append(pitch)
        else:
            missing.append(("pitch_error", axis.name, f"positions of {axis.name} closer together"))
        if f"T_{axis.name}_degC" in state:
            found.append(
                _single(
                    "thermal_expansion",
                    axis.name,
                    ThermalExpansion(axis, 1.0),
                    machine,
                    state,
                    ("coefficient", "um/(m.K)"),
                    _re(ThermalExpansion, axis),
                )
            )
        else:
            missing.append(("thermal_expansion", axis.name, f"T_{axis.name}_degC"))
    found += _reversal_curves(machine, state)
    found += _constants(machine, state)
    found += _curves(machine, state, calibration)
    found += _harmonics(machine, data, state)
    found += _coupled(machine, state)
    found += _base_side(machine, state, missing)
    found += _loads(machine, state, calibration)
    found += _instrument(machine, data, state, missing)
    return Catalogue(tuple(replace(one, largest=largest(one.effect, one.names)) for one in found), tuple(missing))


def _single(
    effect: str,
    where: str,
    unit_effect: Effect,
    machine: Machine,
    state: Mapping[str, Any],
    name: tuple[str, str],
    build: Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]],
) -> Candidate:
    columns = tuple(of_effect(unit_effect, machine, state))
    return Candidate(effect, where, "machine", (name,), (Cell(columns),), 1.0, build)


def _re(kind: Callable[..., Effect], *first: Any) -> Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]]:
    """The effect with its one linear parameter as found."""
    return lambda values, fixed: (kind(*first, float(values[0])),)


def _reversal_curves(machine: Machine, state: Mapping[str, Any]) -> list[Candidate]:
    """Reversals that change along the travel, of axes of limited range whose approach is known."""
    found = []
    for axis in machine.axes:
        curve = lost_motion(machine, axis, state)
        if curve is None:
            continue
        space, columns = curve

        def build(
            values: np.ndarray, fixed: Mapping[str, float], axis: Axis = axis, space: CurveSpace = space
        ) -> tuple[Effect, ...]:
            n = len(values)
            return (ReversalCurve(axis, tuple(float(v) for v in space.transform[:n, :n] @ values)),)

        cells = tuple(Cell(tuple(columns[: degree + 1])) for degree in range(1, space.count))
        names = tuple((f"g{k}", "um" if axis.linear else "urad") for k in range(space.count))
        tests = float(space.count - 1)
        found.append(Candidate(VARYING, axis.name, "machine", names, cells, tests, build, space))
    return found


def _turned(name: str, axis: Axis) -> Callable[[np.ndarray, Mapping[str, float]], tuple[Effect, ...]]:
    return lambda values, fixed: (Squareness(name, float(values[0]), axis),)


def _pitch(axis: Axis, machine: Machine, state: Mapping[str, Any]) -> Candidate:
    q = state[axis.name]
    span = max(float(np.ptp(q)), 1e-9)
    # Half the resolution of the span a step; the best is refined afterwards.
    lowest = 1.0 / (LONGEST_PERIOD * span)
    # Of an axis that did not move one is enough to say so.
    highest = highest_frequency(q, span) if np.ptp(q) > 0.0 else lowest
    frequencies = np.arange(lowest, highest + 1e-9 / span, 0.5 / span)
    # As `PitchError` has it, for all periods at once.
    count = len(frequencies)
    functions = waves(q, 2.0 * np.pi * lowest, np.pi / span, count)
    along = along_command(machine, axis)
    cells = [
        Cell(
            tuple(of_components([(i, functions, n, part) for i, part in along]) for n in (k, count + k)),
            {"period": float(1.0 / f)},
        )
        for k, f in enumerate(frequencies)
    ]

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        return (PitchError(axis, float(np.hypot(*values)), fixed["period"], float(np.arctan2(values[1], values[0]))),)

    names = (("sin", "um"), ("cos", "um"))
    return Candidate("pitch_error", axis.name, "machine", names, tuple(cells), max(len(cells), 1.0), build)


def _constants(machine: Machine, state: Mapping[str, Any]) -> list[Candidate]:
    found = []
    for name in machine.squareness_names:
        axis = machine.by_name[split_name(name)[2]]
        one = Squareness(name, 1.0, axis)
        found.append(
            _single(
                "squareness",
                name,
                one,
                machine,
                state,
                ("angle", "urad"),
                _turned(name, axis),
            )
        )
    for name in machine.location_names:
        unit = unit_of(name)
        found.append(
            _single(
                "axis_location",
                name,
                AxisLocation(name, 1.0),
                machine,
                state,
                ("offset", unit),
                _re(AxisLocation, name),
            )
        )
    return found


def _curves(machine: Machine, state: Mapping[str, Any], calibration: Calibration) -> list[Candidate]:
    """Curves in orthonormal functions, written as powers: of the linear axes, and of rotary ones that have polynomials."""
    found = []
    for axis in machine.axes:
        q, along = state[axis.name], int(np.argmax(np.abs(axis.direction)))
        for component, letter in enumerate(DIRECTIONS):
            name = f"E_{letter}{axis.name}"
            given = calibration.curves.get(name)
            curve = None if given is None else given.in_powers()
            if curve is not None:
                domain, degrees = curve.domain, max(DEGREES, len(curve.coefficients) - 1)
            elif given is not None:
                # Of another kind: no more than can be added to it.
                domain, degrees = given.domain, CUBIC
                if conversion(POWER, given.family, CUBIC + 1, len(given.coefficients)) is None:
                    continue
            elif axis.linear and axis.lower is not None and axis.upper is not None:
                domain, degrees = (axis.lower, axis.upper), DEGREES
            else:
                continue
            at = np.clip(q if axis.lower is not None else domain[0] + np.mod(q - domain[0], 360.0), *domain)
            count = min(degrees, len(np.unique(np.round(at, 3))) - 1) + 1
            space = CurveSpace(name, POWER, domain, 0, max(count, 1))
            effect = (
                "error_motion"
                if not axis.linear
                else "angular_error_motion"
                if component >= 3
                else "positioning"
                if component == along
                else "straightness"
            )
            wrapped = axis.lower is None
            # What one mistake did to the calibration's polynomial is one number, not as many as the polynomial has.
            shapes: dict[float, np.ndarray | None] = {}
            if curve is not None:
                shapes = {float(n): without_constant(space, len(curve.coefficients) - 1, n) for n in STOPS}
                shapes[ITSELF] = of_curve(space, curve)
            patterns = {stops: shape for stops, shape in shapes.items() if shape is not None}
            functions = _shaped(space, at, tuple(patterns.values()))
            at_frame = first_component(machine, axis.name) + component
            columns = tuple(of_components([(at_frame, functions, k, 1.0)]) for k in range(functions.count))

            def build(
                values: np.ndarray,
                fixed: Mapping[str, float],
                space: CurveSpace = space,
                wrapped: bool = wrapped,
                patterns: Mapping[float, np.ndarray] = patterns,
            ) -> tuple[Effect, ...]:
                if "stops" in fixed:
                    values = values[0] * patterns[fixed["stops"]]
                first = round(fixed.get("first", 0.0))
                n = first + len(values)
                coefficients = tuple(float(v) for v in space.transform[:n, first:n] @ values)
                return (ErrorMotion(space.name, space.basis, space.domain, coefficients, wrapped=wrapped),)

            # What the datum leaves a curve (`twin.identification.unknowns`): no constant, and a straightness no slope.
            own = 2 if effect == "straightness" else 1
            cells = tuple(
                Cell(columns[first : degree + 1], {"first": float(first)})
                for degree in range(own, count)
                for first in (0, own)
            )
            if cells:
                short = tuple(Cell((columns[space.count + k],), {"stops": stops}) for k, stops in enumerate(patterns))
                tests = float(count - own + min(len(short), 2))
                names = tuple((f"g{k}", "um" if component < 3 else "urad") for k in range(count))
                found.append(Candidate(effect, name, "machine", names, (*cells, *short), tests, build, space))
    return found


def _shaped(space: CurveSpace, at: np.ndarray, patterns: Sequence[np.ndarray]) -> Functions:
    """A curve's orthonormal functions, and after them sums of these.

    Args:
        space: the functions.
        at: (n,) positions.
        patterns: (count,) coefficients of each sum.
    """
    sums = np.stack(patterns, axis=1) if patterns else np.zeros((space.count, 0))

    def values(rows: Rows) -> np.ndarray:
        found = space.functions(at[rows])
        return np.concatenate([found, found @ sums], axis=1)

    return Functions(len(at), space.count + sums.shape[1], values)


def _harmonics(machine: Machine, data: Measurements, state: Mapping[str, Any]) -> list[Candidate]:
    found = []
    for axis in machine.axes:
        distinct = np.unique(np.round(np.mod(state[axis.name], 360.0), 3))
        if axis.linear or len(distinct) < 4:
            continue
        most = min(ORDERS, (len(distinct) - 1) // 2 if len(distinct) < 60 else ORDERS)
        teeth = max(highest_order(distinct, TEETH), most)
        functions, at = waves(np.radians(state[axis.name]), 1.0, 1.0, teeth), first_component(machine, axis.name)
        own = 3 + int(np.argmax(np.abs(axis.direction)))
        for component, letter in enumerate(DIRECTIONS):
            name = f"E_{letter}{axis.name}"
            unit = unit_of(name)
            cells = tuple(
                Cell(
                    tuple(of_components([(at + component, functions, k, 1.0)]) for k in (teeth + n - 1, n - 1)),
                    {"order": float(n)},
                )
                for n in range(1, (teeth if component == own else most) + 1)
            )

            def build(values: np.ndarray, fixed: Mapping[str, float], name: str = name) -> tuple[Effect, ...]:
                return (Harmonic(name, round(fixed["order"]), float(values[0]), float(values[1])),)

            names = (("cos", unit), ("sin", unit))
            found.append(Candidate("harmonic", name, "machine", names, cells, float(len(cells)), build))
    return found


def _coupled(machine: Machine, state: Mapping[str, Any]) -> list[Candidate]:
    found = []
    linear = [axis for axis in machine.axes if axis.linear]
    for axis in linear:
        for by in linear:
            if by is axis:
                continue
            for letter in "XYZABC":
                name = f"E_{letter}{axis.name}"
                unit = "um/m2" if letter in "XYZ" else "urad/m"
                found.append(
                    _single(
                        "cross_axis",
                        f"{name} by {by.name}",
                        CrossAxis(name, by.name, 1.0),
                        machine,
                        state,
                        ("coefficient", unit),
                        _re(CrossAxis, name, by.name),
                    )
                )
    return found


def _base_side(machine: Machine, state: Mapping[str, Any], missing: list[tuple[str, str, str]]) -> list[Candidate]:
    nearest = tool_base_frame(machine)
    if nearest is None:
        return []
    frame, turn = nearest
    found = []
    sensors = [name[2:-5] for name in state if name.startswith("T_")]
    if not sensors:
        missing.append(("thermal_growth", "X, Y, Z", "T_<sensor>_degC"))
    for direction in "XYZ":
        vector = base_vector(turn, direction)
        for sensor in sensors:
            found.append(
                _single(
                    "thermal_growth",
                    f"{direction} by {sensor}",
                    ThermalGrowth(frame, direction, vector, sensor, 1.0),
                    machine,
                    state,
                    ("coefficient", "um/K"),
                    _re(ThermalGrowth, frame, direction, vector, sensor),
                )
            )
        if "time_s" not in state:
            missing.append(("thermal_drift", direction, "time_s"))
            continue
        creep = ThermalDrift(frame, direction, vector, 1.0, 1.0)
        drift = of_machine(creep, machine, state)

        def build(values: np.ndarray, fixed: Mapping[str, float], creep: ThermalDrift = creep) -> tuple[Effect, ...]:
            if "time_constant" in fixed:
                return (creep.changed(float(values[0]), fixed["time_constant"]),)
            return (creep.steady(float(values[0])),)

        names = (("amplitude", "um"),)
        cells = _drifting(drift)
        found.append(Candidate("thermal_drift", direction, "machine", names, cells, 3.0, build, drift=drift))
    return found


def _drifting(drift: Drift) -> tuple[Cell, ...]:
    """A straight line, and exponentials."""
    bent = (Cell(drift.columns(constant), {"time_constant": constant}) for constant in drift.constants)
    return (Cell(drift.columns(STRAIGHT)), *bent)


def _loads(machine: Machine, state: Mapping[str, Any], calibration: Calibration) -> list[Candidate]:
    found = []
    loads = loads_of(machine)(state)
    for axis in machine.axes:
        if not axis.linear and axis.side != "tool":
            joint = next(f.joint for f in machine.frames if f.axis == axis.name and f.role == "motion")
            turn = at_rest(machine, joint)
            # An axis that stands upright turns nothing against gravity.
            if abs(float((turn @ np.array(axis.direction))[2])) < 1.0 - 1e-9:
                one = TableLoad(axis.name, base_vector(turn, "X"), 1.0)
                build = _re(TableLoad, axis.name, base_vector(turn, "X"))
                found.append(_single("table_load", axis.name, one, machine, state, ("tilt", "urad"), build))
        found.append(_yielding(machine, axis, np.stack(loads[axis.name], axis=1), calibration))
    return found


def _yielding(machine: Machine, axis: Axis, load: np.ndarray, calibration: Calibration) -> Candidate:
    """A joint that gives way: under its own weight and the payload that the calibration has, or, if it has none, under any."""
    told = [effect for effect in calibration.extra if isinstance(effect, GravityCompliance)]
    known = tuple(dict.fromkeys(payload for effect in told for payload in effect.payloads))
    own, free = yielding(machine, axis, load, known)
    cells = (Cell((own,)), *([Cell(free, {PAYLOAD: 1.0})] if free and not told else []))

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        carried = free_payload(machine, axis, values) if PAYLOAD in fixed else payloads_of(axis, fixed) or known
        return (gravity_compliance(machine, axis.name, float(values[0]), carried),)

    unit = "um/N" if axis.linear else "urad/(N.m)"
    names = tuple((name, unit) for name in ("compliance", "by mass", "by x", "by y", "by z"))
    return Candidate("gravity_compliance", axis.name, "machine", names, cells, float(len(cells)), build)


def _instrument(
    machine: Machine, data: Measurements, state: Mapping[str, Any], missing: list[tuple[str, str, str]]
) -> list[Candidate]:
    found = []
    n = len(data)

    def reading(fields: Sequence[Field], mask: np.ndarray, weight: float, scale: float = LARGEST) -> tuple[Column, ...]:
        function = given(mask[:, None].astype(float))
        return tuple(Column((Part(field, function, 0, weight),), scale) for field in fields)

    frame: list[Field] = [(name, i) for name in ("station", "station turn") for i in range(3)]
    six = tuple([(f"shift_{a}", "um") for a in "xyz"] + [(f"turn_{a}", "urad") for a in "xyz"])
    rounds = list(dict.fromkeys(data.round))
    stations = list(dict.fromkeys(data.station))
    number = np.array([rounds.index(name) for name in data.round])
    three = six[:3]
    for k in range(1, len(rounds)):
        later = (number >= k).astype(float)
        if len(stations) == 1:
            columns = reading(frame, later, UM)
            found.append(Candidate("frame_shift", f"round {rounds[k]}", "instrument", six, (Cell(columns),), 1.0))
        else:
            for name in stations:
                mask = later * (data.station == name)
                if 0 < mask.sum() < np.count_nonzero(data.station == name):
                    where = f"station {name} from round {rounds[k]}"
                    columns = reading(frame, mask, UM)
                    found.append(Candidate("frame_shift", where, "instrument", six, (Cell(columns),), 1.0))
        for target in dict.fromkeys(data.target):
            of = data.target == target
            mask = later * of
            if 0 < mask.sum() < np.count_nonzero(of):
                where = f"{target} from round {rounds[k]}"
                columns = reading([("place", i) for i in range(3)], mask, UM)
                found.append(Candidate("target_shift", where, "instrument", three, (Cell(columns),), 1.0))
    columns = reading([("length", 0)], np.ones(n), 1e-6, 100.0)
    found.append(Candidate("refraction_scale", "—", "instrument", (("scale", "ppm"),), (Cell(columns),), 1.0))
    for one in affine_errors(data):
        cells = tuple(Cell(form) for form in one.forms)
        found.append(Candidate("affine_scale", one.where, "instrument", one.names, cells, float(len(cells))))
    if "time_s" in state:
        for name in stations:
            drift = of_station(state["time_s"], data.station == name)
            names = tuple((f"rate_{a}", "um/h") for a in "xyz")
            found.append(Candidate("station_drift", name, "instrument", names, _drifting(drift), 3.0, drift=drift))
    else:
        missing.append(("station_drift", ", ".join(stations), "time_s"))
    for name, column in time_skews(data, machine, missing):
        cells = (Cell((column,)),)
        found.append(Candidate("time_skew", name, "instrument", (("delay", "s"),), cells, 1.0))
    for i, axis in enumerate(machine.axes):
        reported = data.readback[:, i]
        if np.all(np.isnan(reported)):
            missing.append(("read_back", axis.name, f"readback_{axis.name}_{axis.unit}"))
            continue
        off = np.where(np.isfinite(reported), (reported - data.positions[:, i]) * axis.scale / UM, 0.0)
        if np.abs(off).max() < 1e-3:
            continue
        parts = {i: off * part for i, part in along_command(machine, axis)}
        found.append(
            Candidate("following_error", axis.name, "machine", (("share", "1"),), (Cell((of_values(parts),)),), 1.0)
        )
    return found
