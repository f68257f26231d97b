"""Evaluate all standard tests that a measurement table allows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from twin._common.errors import InputError, require_type
from twin._common.messages import Message
from twin._common.provenance import SIMULATED
from twin.machine.machine import Machine
from twin.measurement.instruments import Instrument
from twin.measurement.observation import of_angles
from twin.measurement.table import Measurements, with_length
from twin.standards.iso230_1 import Straightness
from twin.standards.linear_axes import angular_tests, linear_positioning, squareness_tests, straightness_tests
from twin.standards.readings import (
    MeasuredRun,
    NotPossible,
    TableRuns,
    directions,
    find_runs,
    place_of,
    reading_uncertainty_mm,
    station_frame,
)
from twin.standards.result import KINDS, EvaluationResult, NotEvaluated, StandardTest, check_limits, check_tolerances
from twin.standards.rotary_axes import circle_test, kinematic_test, rotary_tests

NO_RUN: Final = {
    "positioning": Message("no run in which one axis alone moves to at least three targets, or repeatedly to two"),
    Message("angular error"): Message(
        "no run of angles in which one axis alone moves to at least three positions, or repeatedly to two"
    ),
    "circular": Message("no run in which two linear axes move on a circle, over more than half a turn"),
    "squareness": Message("no two linear axes measured across their travel from one station"),
    "kinematic": Message("no run of linear and rotary axes in which the nominal point of the target stands still"),
}
"""Reason why a test is missing if the table has no run for it."""
Uncertainties = Callable[[MeasuredRun], np.ndarray]


def evaluate(
    data: Measurements,
    machine: Machine,
    *,
    tolerances: Mapping[str, float] | None = None,
    instrument: Instrument | None = None,
    length_mm: float | None = None,
) -> EvaluationResult:
    """Evaluate all tests of ISO 230-1, 230-2, 230-4, 230-7 and ISO 10791-6 for which a table has the runs.

    Args:
        data: the measured points.
        machine: the machine that was measured.
        tolerances: largest permitted values, µm or µrad, by key of the value (``A``, ``H``) or name of the test and key (``X:A``).
        instrument: instrument whose noise model gives the uncertainty of readings for which the table states none.
        length_mm: nominal length of a ball bar, from which its radial deviations count; None for that of the table, else the radius of
            the commands.

    Raises:
        InputError: a tolerance that is negative or not finite; a length that is not positive, or differs from that of the table.
        TypeError: arguments of another type.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> plan, truth = twin.thesis_plan.plan(machine), twin.Calibration.default(machine)
        >>> data, _ = twin.simulate(plan, machine, truth, twin.instruments.LaserTracker(), np.random.default_rng(1))
        >>> evaluation = twin.evaluate(data, machine, tolerances={"X:R_forward": 50.0})
        >>> test = evaluation.named("X", "positioning")[0]
        >>> test.standard, {value.key: round(value.value) for value in test.main_values}  # µm
        ('ISO 230-2:2014, clause 3 (tests: 4.3)', {'A_forward': 141, 'E_forward': 80, 'R_forward': 102})
        >>> evaluation.met
        False

    References:
        - ISO 230-1:2012, clause 3.4 and test 8.2 (straightness), squareness, angular errors.
        - ISO 230-2:2014, clause 3 (positioning).
        - ISO 230-4:2005 and 2022 (circular tests).
        - ISO 230-7:2015, clause 3 (error motions of rotary axes).
        - ISO 10791-6:2014 (kinematic tests).
        - ISO 14253-1 (conformity with a tolerance).
    """
    require_type("data", data, Measurements)
    require_type("machine", machine, Machine)
    check_limits(tolerances or {})
    if length_mm is not None:
        if not (np.isfinite(length_mm) and length_mm > 0.0):
            raise InputError("the length of the ball bar must be positive", expected="mm, above 0", value=length_mm)
        changed, notes = with_length(data.arrays(), length_mm)
        data = replace(data, **changed, notices=(*data.notices, *notes))
    angles = of_angles(data)
    runs = find_runs(data.select(~angles), machine)

    def uncertainty_mm(run: MeasuredRun) -> np.ndarray:
        fitting = instrument is not None and (instrument.specification.reads == "angle") == bool(of_angles(run.data)[0])
        return reading_uncertainty_mm(run.data, instrument if fitting else None)

    tests: list[StandardTest] = []
    missing: list[NotEvaluated] = []
    _single_axes(runs, machine, uncertainty_mm, tests, missing)
    if angles.any():
        _angles(data.select(angles), machine, uncertainty_mm, tests, missing)
    for run in runs.circles:
        _attempt(_title("circular", run, machine), tests, missing, circle_test, run, machine, uncertainty_mm(run))
    for run in runs.mixed:
        _attempt(_title("kinematic", run, machine), tests, missing, kinematic_test, run, machine, uncertainty_mm(run))
    return EvaluationResult(
        data=data,
        machine=machine.name,
        tests=tuple(tests),
        not_evaluated=(*_without_duplicates(missing), *_absent(tests, missing, machine)),
        assumptions=_assumptions(runs, tests, machine),
        uncertainty=_budget(data, instrument),
        checks=check_tolerances(tolerances or {}, tests),
        warnings=(SIMULATED,) if data.simulated else (),
    )


def _single_axes(
    runs: TableRuns,
    machine: Machine,
    uncertainty_mm: Uncertainties,
    tests: list[StandardTest],
    missing: list[NotEvaluated],
) -> None:
    """Add the tests of single axes, and of pairs of them."""
    lines: list[tuple[MeasuredRun, Straightness]] = []
    bent: list[StandardTest] = []
    linear = [run for run in runs.single if machine.axes[run.axes[0]].linear]
    frames = {
        station: station_frame([run for run in linear if run.station == station], machine)
        for station in dict.fromkeys(run.station for run in linear)
    }
    for run in linear:
        u = uncertainty_mm(run)
        _attempt(_title("positioning", run, machine), tests, missing, linear_positioning, run, machine, u)
        straight: list[StandardTest] = []
        place = _title("straightness", run, machine)
        _attempt(place, straight, missing, straightness_tests, run, machine, frames[run.station], u)
        lines += [(run, test.detail) for test in straight if isinstance(test.detail, Straightness)]
        bent += straight
    tests += bent
    tests += squareness_tests(lines, machine)
    for run in runs.single:
        if not machine.axes[run.axes[0]].linear:
            _attempt(_title("rotary", run, machine), tests, missing, rotary_tests, run, machine, uncertainty_mm(run))


def _angles(
    data: Measurements,
    machine: Machine,
    uncertainty_mm: Uncertainties,
    tests: list[StandardTest],
    missing: list[NotEvaluated],
) -> None:
    """Add the angular errors of linear axes."""
    runs = find_runs(data, machine).single
    if not runs:
        missing.append(NotEvaluated(KINDS["angular error"], NO_RUN["angular error"]))
    for run in runs:
        _attempt(
            _title("angular error", run, machine), tests, missing, angular_tests, run, machine, uncertainty_mm(run)
        )


def _attempt(
    title: Message,
    tests: list[StandardTest],
    missing: list[NotEvaluated],
    function: Callable[..., Iterator[StandardTest] | StandardTest | None],
    *arguments: object,
) -> None:
    """Add the tests that a function returns for some arguments, or the reason why they are not possible."""
    try:
        found = function(*arguments)
        if isinstance(found, StandardTest):
            tests.append(found)
        elif found is not None:
            tests.extend(found)
    except NotPossible as reason:
        missing.append(NotEvaluated(title, reason.why))


def _budget(data: Measurements, instrument: Instrument | None) -> Message:
    """Return where the uncertainty of the readings comes from; empty if it is unknown."""
    if np.isfinite(data.u_mm).any():
        source = Message("in the table")
    elif instrument is not None:
        source = Message("of the instrument ({title})", title=instrument.specification.title)
    else:
        return Message("")
    return Message(
        "U (95 %) is propagated from the standard uncertainties {source}, taken as independent. It does not contain the scale error of "
        "the instrument, temperature and set-up, which the standards' own budgets add.",
        source=source,
    )


def _title(kind: str, run: MeasuredRun, machine: Machine) -> Message:
    """Return the test with its place, which is the argument ``place``."""
    names = "".join(machine.axes[i].name for i in run.axes)
    words = Message("positioning and error motions") if kind == "rotary" else KINDS[kind]
    return Message("{test} ({place})", test=Message("{name}: {kind}", name=names, kind=words), place=place_of(run))


def _without_duplicates(missing: Iterable[NotEvaluated]) -> list[NotEvaluated]:
    """Return one entry for each test and reason, whatever the place; the number of runs is given."""
    groups: dict[tuple[Message, Message], list[NotEvaluated]] = {}
    for one in missing:
        groups.setdefault((one.test.arguments.get("test", one.test), one.why), []).append(one)
    return [
        found[0] if len(found) == 1 else NotEvaluated(Message("{test}, {count} runs", test=test, count=len(found)), why)
        for (test, why), found in groups.items()
    ]


def _absent(tests: Iterable[StandardTest], missing: Iterable[NotEvaluated], machine: Machine) -> list[NotEvaluated]:
    """Return the tests for which the table has no run at all."""
    done = {(test.kind, name) for test in tests for name in test.axes}
    tried = {one.test.partition(":")[0] for one in missing}
    kinds = {kind for kind, _ in done}
    idle = [axis.name for axis in machine.axes if ("positioning", axis.name) not in done and axis.name not in tried]
    absent = (
        [
            NotEvaluated(
                Message("{name}: {kind}", name=", ".join(idle), kind=KINDS["positioning"]), NO_RUN["positioning"]
            )
        ]
        if idle
        else []
    )
    if len(machine.linear) >= 2:
        for kind in ("squareness", "circular"):
            if kind not in kinds:
                absent.append(NotEvaluated(KINDS[kind], NO_RUN[kind]))
    if machine.linear and machine.rotary and "kinematic" not in kinds:
        absent.append(NotEvaluated(Message("kinematic (ISO 10791-6)"), NO_RUN["kinematic"]))
    return absent


def _assumptions(runs: TableRuns, tests: Iterable[StandardTest], machine: Machine) -> tuple[Message, ...]:
    order = "time_s" if runs.ordered_by_time else Message("the rows of each round")
    evaluated = {name for test in tests if test.kind == "positioning" for name in test.axes}
    derived = [
        name
        for name in dict.fromkeys(machine.axes[run.axes[0]].name for run in runs.single if directions(run)[1])
        if name in evaluated
    ]
    assumptions = []
    if derived:
        assumptions.append(
            Message(
                "direction of approach of {names} from the order of {order}: the table has no column {columns}",
                names=", ".join(derived),
                order=order,
                columns=", ".join(f"approach_{name}" for name in derived),
            )
        )
    if runs.circles:
        assumptions.append(Message("direction of travel on circles from the order of {order}", order=order))
    return tuple(assumptions)
