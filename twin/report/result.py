"""A machine's calibration, worked out for a report: every number of the page, and its JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.json_form import json_form
from twin._common.provenance import SIMULATED, SourceWarning, merged, to_json
from twin.display.numbers import COVERAGE_FACTOR
from twin.kinematics.forward import Kinematics
from twin.machine.calibration import Calibration
from twin.machine.conditions import Conditions
from twin.machine.control import ControlSection
from twin.machine.datum import MEAN_LINES, MEANING
from twin.machine.display import uncertainty_of
from twin.machine.effects import split_name, unit_of
from twin.machine.machine import Axis, Machine
from twin.measurement.table import Measurements
from twin.report.advice import MachineAdvice, advise
from twin.report.after import After, after
from twin.report.contributions import Budget, budget
from twin.report.field import Field, field
from twin.report.identified import Identified
from twin.report.motions import Motion, motions
from twin.report.readings import Checked, checked
from twin.report.sources import Sources, sources
from twin.report.tables import TablesLeft, tables_left
from twin.report.words import named
from twin.uncertainty.at_tool import DEFINITION
from twin.uncertainty.budget import known_at

SCHEMA: Final = "twin.report/1"
SEED: Final = 0
Say = Callable[[str, float], None]


@final
@dataclass(frozen=True)
class Constant:
    """A squareness, or where a rotary axis lies.

    Attributes:
        name: ISO 230-1 name.
        words: the same in words.
        unit: ``um`` or ``urad``.
        value: in that.
        half: half width of its 95 % interval; NaN where it is not known.
        axis: whose it is.
        to: of a squareness the axis, or direction of the base, the other should be square to; else empty.
        leans: which way a positive squareness leans the axis's own positive direction: towards ``to`` (1) or away from it (−1); 0 of
            a location.
        travel_mm: of the linear axis whose line it tilts; None of a location.
        rms_um: what it alone makes at the tool, over the volume.
    """

    name: str
    words: str
    unit: str
    value: float
    half: float
    axis: str
    to: str
    leans: float
    travel_mm: float | None
    rms_um: float

    @property
    def known(self) -> bool:
        """Whether its uncertainty is."""
        return bool(np.isfinite(self.half))

    @property
    def over_travel_um(self) -> float | None:
        """By how much a squareness displaces the end of the travel, µm; None of a location."""
        return None if self.travel_mm is None else self.value * self.travel_mm * 1e-3

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        told = json_form(self, rename={"half": "half_95"}, leave_out=("axis", "to", "leans", "travel_mm", "rms_um"))
        return told | {"over_travel_um": self.over_travel_um, "rms_um": self.rms_um}


@final
@dataclass(frozen=True)
class Gaps:
    """What the numbers do not hold.

    Attributes:
        absent: error motions, squareness and locations the machine has and the calibration does not name: counted as zero.
        without_uncertainty: what has a value and no uncertainty.
        left_out: effects that need a channel nobody gave, by channel.
        unused: channels that were given and nothing needs.
    """

    absent: tuple[str, ...]
    without_uncertainty: tuple[str, ...]
    left_out: Mapping[str, tuple[str, ...]]
    unused: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return json_form(self, rename={"absent": "absent_counted_as_zero"})


@final
@dataclass(frozen=True)
class MachineReport:
    """Everything a page about a machine says.

    Attributes:
        machine: the machine.
        calibration: in mean lines, where it can be converted.
        datum: the sentence that says which datum the numbers are in.
        kinematics: with the errors that could be worked out under the conditions.
        budget, motions, constants, field, after: as their classes say.
        identified: what `identify` said, or None.
        checked: measured points against this calibration, one for each table.
        gaps: what is not in it.
        tables: what tables in the control would leave, format by format.
        advice: what follows, in words.
        sources: what it was made of.
    """

    machine: Machine
    calibration: Calibration
    datum: str
    kinematics: Kinematics
    budget: Budget
    motions: tuple[Motion, ...]
    constants: tuple[Constant, ...]
    field: Field
    after: After
    identified: Identified | None
    checked: tuple[Checked, ...]
    gaps: Gaps
    tables: tuple[TablesLeft, ...]
    advice: MachineAdvice
    sources: Sources

    @property
    def control(self) -> ControlSection | None:
        """What the calibration says of the machine's control."""
        return self.calibration.control

    @property
    def illustrative(self) -> tuple[str, ...]:
        """Names of error motions that are drawn, not measured."""
        return tuple(curve.name for curve in self.calibration.curves.values() if curve.illustrative)

    @property
    def simulated(self) -> bool:
        """Whether a file it was made of, or is shown against, says that its readings were simulated."""
        told = () if self.identified is None else self.identified.file.notices
        said = (*told, *(text for one in self.checked for text in one.notices))
        return self.calibration.simulated or any("simulated" in notice for notice in said)

    @property
    def warnings(self) -> tuple[SourceWarning, ...]:
        """Warnings of where the numbers come from: those of the calibration and of the readings it is shown against."""
        return merged(self.calibration.warnings, (SIMULATED,) if self.simulated else ())

    @property
    def unmet(self) -> tuple[str, ...]:
        """What was asked for and could not be shown, in words."""
        found = [f"{', '.join(names)} left out: it needs {channel}" for channel, names in self.gaps.left_out.items()]
        if self.identified is not None and self.identified.others:
            found.append(
                f"{self.identified.path.name} gives other numbers than the calibration for {', '.join(self.identified.others)}"
            )
        return (
            *found,
            *(f"{Path(one.source).name}: {len(one.rows)} rows set aside" for one in self.checked if one.rows),
        )

    def to_dict(self) -> dict[str, Any]:
        """For JSON (``schema: twin.report/1``); null for what is not known."""
        control, calibration = self.control, self.calibration
        return json_form(
            {
                "schema": SCHEMA,
                "machine": self.machine.name,
                "calibration": {
                    "path": None if calibration.path is None else str(calibration.path),
                    "source": calibration.source,
                    "datum": calibration.datum,
                    "illustrative": self.illustrative,
                    "simulated_readings": self.simulated,
                    "warnings": to_json(self.warnings),
                },
                "tool_length_mm": self.kinematics.tool_length_mm,
                "conditions": self.kinematics.conditions.channels,
                "control": control
                and {
                    "errors_are": control.errors_are,
                    "tables": [{"file": str(one.file), "classes": one.classes} for one in control.tables],
                },
                "definition_of_U": DEFINITION,
                "summary": self.advice,
                "budget": {
                    "poses": len(self.budget.positions),
                    "total": self.budget.total,
                    "worst_at": self.budget.worst,
                    "errors": self.budget.errors,
                    "classes": self.budget.classes,
                },
                "motions": self.motions,
                "constants": self.constants,
                "field": self.field,
                "compensation": self.after,
                "control_tables": self.tables,
                "identification": self.identified,
                "measured": self.checked,
                "gaps": self.gaps,
                "unmet": self.unmet,
                "sources": self.sources,
            }
        )


def machine_report(
    machine: Machine,
    calibration: Calibration,
    *,
    made: datetime,
    tool_length_mm: float | None = None,
    conditions: Conditions | None = None,
    identified: Path | None = None,
    measured: Sequence[tuple[Path, Measurements]] = (),
    seed: int = SEED,
    say: Say | None = None,
) -> MachineReport:
    """Work out everything a report of a machine says.

    Args:
        machine: the machine.
        calibration: its errors.
        made: when, for the page.
        tool_length_mm: None for the machine file's own.
        conditions: temperatures and time; effects whose channel they do not give are left out, and listed.
        identified: JSON that ``twin identify`` wrote beside the calibration.
        measured: tables with their files: points of the same machine, to be shown against this calibration.
        seed: of the draws of what is not known.
        say: told what is being done and how far it is.

    Raises:
        InputError: a temperature of nothing the calibration knows; files that do not fit; no pose inside all curves.
    """
    tell = say or (lambda stage, part: None)
    at = Conditions() if conditions is None else conditions
    at.check(calibration)
    told = None if identified is None else Identified.load(identified, calibration)
    calibration, datum = _in_mean_lines(calibration)
    origin = sources(calibration, identified, [path for path, _ in measured], seed, made)
    known, left_out = known_at(at, calibration)
    real = Kinematics(machine, known, tool_length_mm=tool_length_mm, conditions=at)
    shares, curves, over, outcome = _over_the_volume(real, seed, tell)
    found = tuple(_checked(measured, known, tell))
    gaps = Gaps(_absent(known), shares.without_uncertainty, left_out, at.unused(calibration))
    tell("control's tables", 0.9)
    tables = tables_left(real, calibration, left_out)
    tell("words", 0.95)
    return MachineReport(
        machine=machine,
        calibration=calibration,
        datum=datum,
        kinematics=real,
        budget=shares,
        motions=curves,
        constants=_constants(real, shares),
        field=over,
        after=outcome,
        identified=told,
        checked=found,
        gaps=gaps,
        tables=tables,
        advice=advise(calibration, shares, outcome, told, left_out, found, tables),
        sources=origin,
    )


def _over_the_volume(real: Kinematics, seed: int, tell: Say) -> tuple[Budget, tuple[Motion, ...], Field, After]:
    tell("budget", 0.05)
    shares = budget(real)
    tell("curves", 0.3)
    curves = motions(real)
    tell("field", 0.35)
    over = field(real)
    tell("after", 0.4)
    return shares, curves, over, after(shares, seed)


def _checked(measured: Sequence[tuple[Path, Measurements]], known: Calibration, tell: Say) -> Iterator[Checked]:
    for i, (path, data) in enumerate(measured):
        tell("measured", 0.5 + 0.35 * i / len(measured))
        yield checked(data, known.machine, known, path)


def _in_mean_lines(calibration: Calibration) -> tuple[Calibration, str]:
    """The calibration in mean lines as far as the errors it names can take it, and one line about the datum.

    Errors that it does not name stay unnamed: nothing is known of their uncertainty.
    """
    given = calibration.datum
    named = {*calibration.curves, *calibration.squareness, *calibration.location}
    try:
        found = calibration.in_datum(MEAN_LINES, named)
    except InputError as error:
        return calibration, f"{MEANING[given]}; not converted: {error.what}"
    if found is calibration:
        return calibration, MEANING[given]
    return replace(found, path=calibration.path), f"{MEANING[MEAN_LINES]}; converted from: {given}"


def _constants(real: Kinematics, shares: Budget) -> tuple[Constant, ...]:
    calibration, machine = real.calibration, real.machine
    made = {one.name: one.rms_um for one in shares.errors}
    found = []
    for name, value in (*calibration.squareness.items(), *calibration.location.items()):
        half = COVERAGE_FACTOR * uncertainty_of(name, calibration.covariance)
        component, _, letter = split_name(name)
        axis = machine.by_name[letter]
        to, leans, travel = "", 0.0, None
        if name in calibration.squareness:
            to, leans = _square_to(machine, axis, component - 3)
            travel = axis.domain[1] - axis.domain[0]
        found.append(
            Constant(name, named(name, machine), unit_of(name), value, half, letter, to, leans, travel, made[name])
        )
    return tuple(found)


def _square_to(machine: Machine, axis: Axis, about: int) -> tuple[str, float]:
    """The linear axis that a turn about x, y or z leans this one towards or away from, and which."""
    towards = np.cross(np.eye(3)[about], axis.machine_direction)
    others = [one for one in machine.axes if one.linear and one.name != axis.name]
    best = max(others, key=lambda one: abs(float(towards @ one.machine_direction)), default=None)
    if best is None or abs(float(towards @ best.machine_direction)) < 0.5:
        along = int(np.argmax(np.abs(towards)))
        return "xyz"[along], float(np.sign(towards[along]))
    return best.name, float(np.sign(towards @ best.machine_direction))


def _absent(calibration: Calibration) -> tuple[str, ...]:
    machine = calibration.machine
    named_ = {effect.name for effect in calibration.effects}
    every = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    return tuple(name for name in every if name not in named_)
