"""Plan and evaluate measurements with artefacts: the sheets of one or several artefacts give one set of errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common import families
from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.messages import Message, Number, joined
from twin.display import figure
from twin.display.numbers import COVERAGE_FACTOR
from twin.machine.machine import Machine
from twin.measurement.columns import RowNote
from twin.model.calibration import Calibration
from twin.model.calibration_file import UnidentifiedEntry
from twin.numerics.covariance import Covariance
from twin.standards.artefacts.adjustment import AdjustedErrors, Observed, estimate
from twin.standards.artefacts.artefact import ArtefactKind, LinearModel, linear_model, plane_axes, scale_curve
from twin.standards.artefacts.faces import Straightedge
from twin.standards.artefacts.sheet import ArtefactSheet, read_sheet, sheet_text
from twin.standards.iso230_1 import straightness
from twin.standards.result import (
    ArtefactValue,
    EvaluationResult,
    NotEvaluated,
    StandardTest,
    StandardValue,
    check_limits,
    check_tolerances,
)

CONTRADICTION: Final = 1e-9
"""Probability of residuals below which the readings contradict each other: no evaluation."""
DOUBTFUL: Final = 0.01
SMALLEST_SHARE: Final = 0.05
"""Share of the standard uncertainty from which a line of the budget is named."""
UNCERTAINTY: Final = Message(
    "U (95 %) is propagated from the budget of the sheets (JCGM 101): limits are rectangular, repeats have Student's distribution. "
    "Squareness and scale are those between the positions measured, at the temperature of the machine at that time."
)


@cache
def artefact_named(name: str) -> ArtefactKind:
    """Return the artefact of that name; raise `InputError` if there is none."""
    if name not in families.ARTEFACTS:
        raise InputError("no such artefact", expected=f"one of {' '.join(families.ARTEFACTS)}", value=name)
    found: ArtefactKind = families.member("twin.standards.artefacts", families.ARTEFACTS, name)
    return found


def artefacts() -> tuple[ArtefactKind, ...]:
    """Return all artefacts."""
    return tuple(map(artefact_named, families.ARTEFACTS))


def plan_sheet(machine: Machine, name: str, plane: str, size_mm: Sequence[float] = ()) -> tuple[str, tuple[str, ...]]:
    """Return the text of an empty sheet, and the steps of the measurement.

    Args:
        machine: the machine to be measured.
        name: one of `twin._common.families.ARTEFACTS`.
        plane: two linear axes, as ``XY``.
        size_mm: lengths along both, or of the artefact; empty for 80 % of the ranges.

    Raises:
        InputError: an unknown artefact or plane, or a size that does not fit the ranges.
    """
    own = artefact_named(name)
    plane_axes(plane, linear_model(machine))
    rows, steps = own.rows(machine, plane, tuple(size_mm)), own.steps(plane)
    return sheet_text(name, machine.name, plane, own.statements(tuple(size_mm)), steps, rows, own.repeats), steps


@final
@dataclass(frozen=True)
class SheetData:
    """The sheets of an evaluation, as `twin.standards.result.EvaluatedData`."""

    sheets: tuple[ArtefactSheet, ...]

    @property
    def source(self) -> str:
        """The files."""
        return ", ".join(str(sheet.path) for sheet in self.sheets)

    @property
    def notices(self) -> tuple[Message, ...]:
        """Empty: what is assumed is among the assumptions."""
        return ()

    @property
    def set_aside(self) -> tuple[RowNote, ...]:
        """Rows without a reading."""
        return tuple(note for sheet in self.sheets for note in sheet.set_aside)

    def __len__(self) -> int:
        return sum(len(row.readings) for sheet in self.sheets for row in sheet.rows)


def evaluate_sheets(
    paths: Sequence[Path], machine: Machine, *, tolerances: Mapping[str, float] | None = None
) -> tuple[EvaluationResult, AdjustedErrors]:
    """Evaluate the sheets of artefacts together.

    Args:
        paths: sheets that `plan_sheet` made and that were filled in.
        machine: the machine that was measured.
        tolerances: as for `twin.evaluate`; keys are ``E_C0Y`` … and ``scale``.

    Returns:
        The result, and the estimate of all errors in the order of `linear_model`.

    Raises:
        InputError: a sheet that cannot be read, or readings that contradict each other or the geometry; with line and value.
    """
    check_limits(tolerances or {})
    model = linear_model(machine)
    needs = {one.name: one.quantities for one in artefacts()}
    columns = {one.name: one.all_columns(model.axes) for one in artefacts()}
    sheets = tuple(read_sheet(path, needs, columns) for path in paths)
    for sheet in sheets:
        if sheet.machine != machine.name:
            what = "the sheet of another machine"
            raise InputError(what, expected=f"machine: {machine.name}", file=sheet.path, value=sheet.machine)
        try:
            plane_axes(sheet.plane, model)
        except InputError as error:
            raise InputError(error.what, expected=error.expected, file=sheet.path, value=sheet.plane) from None
    observed = {
        sheet: one for sheet in sheets if (one := artefact_named(sheet.artefact).observed(sheet, machine)) is not None
    }
    count = len(model.names)
    found = estimate(list(observed.values()), count) if observed else _nothing(count)
    _check_contradiction(observed, found)
    tests = [
        *_linear_tests(observed, model, found),
        *(_straight(sheet, machine) for sheet in sheets if sheet not in observed),
    ]
    missing = [
        NotEvaluated(Message("{name}", name=name), Message("the readings do not determine it"))
        for name, value in zip(model.names, found.values, strict=True)
        if np.isnan(value)
    ]
    result = EvaluationResult(
        data=SheetData(sheets),
        machine=machine.name,
        tests=tuple(tests),
        not_evaluated=tuple(missing),
        assumptions=tuple(
            Message("{file}: assumed, not stated: {text}", file=sheet.path.name, text=text)
            for sheet in sheets
            for text in sheet.assumed
        ),
        uncertainty=UNCERTAINTY,
        checks=check_tolerances(tolerances or {}, tests),
        warnings=(),
    )
    return result, found


def _nothing(count: int) -> AdjustedErrors:
    unknown = np.full(count, np.nan)
    return AdjustedErrors(unknown, np.zeros((count, count)), unknown)


def _check_contradiction(observed: Mapping[ArtefactSheet, Observed], found: AdjustedErrors) -> None:
    """Raise `InputError` at the worst reading if the readings contradict each other beyond chance."""
    if not found.p_value < CONTRADICTION:
        return
    places = [(sheet, k) for sheet, one in observed.items() for k in range(len(one.lines))]
    worst = int(np.argmax(np.abs(found.normalised)))
    sheet, k = places[worst]
    one, off = observed[sheet], float(found.residuals[worst])
    raise InputError(
        f"the readings contradict each other: this one lies {abs(off):.3g} mm from what the others say, "
        f"{abs(found.normalised[worst]):.0f} times its standard uncertainty",
        expected="another reading here, or larger limits (machine, marks, instrument) in the sheet",
        file=sheet.path,
        line=one.lines[k],
        value=f"{one.readings[k]:g} mm",
    )


def _linear_tests(
    observed: Mapping[ArtefactSheet, Observed], model: LinearModel, found: AdjustedErrors
) -> Iterable[StandardTest]:
    """Return the tests of squareness and scale."""
    titles = joined("; ", [_place(sheet) for sheet in observed])
    remarks = []
    if found.dof and found.p_value < DOUBTFUL:
        remarks.append(
            Message(
                "the residuals are larger than the budget explains (p = {p:.2g}): the machine has other errors at these positions, "
                "or a limit in the sheet is too small",
                p=found.p_value,
            )
        )
    for k, name in enumerate(model.names):
        if np.isnan(found.values[k]):
            continue
        value, u = (1e6 * float(one) for one in (found.values[k], np.sqrt(found.covariance[k, k])))
        expanded = 1e6 * float(found.expanded[k])
        shares = {what: 1e6 * float(size[k]) for what, size in found.budget.items()}
        large = sorted(((size, what) for what, size in shares.items() if size > SMALLEST_SHARE * u), reverse=True)
        square = name.startswith("E_")
        unit = "urad" if square else "um/m"
        budget = joined(
            "; ",
            [
                Message("{what} {size}", what=what, size=Number(figure(size, "µrad" if square else "µm/m")))
                for size, what in large
            ],
        )
        yield StandardTest(
            kind="squareness" if square else "scale",
            name=name if square else name.split()[1],
            standard=Message("ISO 230-1:2012, with artefacts")
            if square
            else Message("actual per commanded length, with artefacts"),
            axes=_axes_of(name),
            place=titles,
            values=(
                StandardValue(
                    name if square else "scale",
                    name if square else "scale",
                    value,
                    unit,
                    Message("squareness error, right-handed")
                    if square
                    else Message("scale error: positive if the axis moves too far"),
                    u,
                    expanded,
                ),
            ),
            remarks=(Message("budget, standard uncertainties: {budget}", budget=budget), *remarks),
            detail=ArtefactValue(name, value, u, expanded, MappingProxyType(shares)),
        )


def _place(sheet: ArtefactSheet) -> Message:
    return Message("{title}, {plane}", title=artefact_named(sheet.artefact).title, plane=sheet.plane)


def _axes_of(name: str) -> tuple[str, ...]:
    if not name.startswith("E_"):
        return (name.split()[1],)
    return {"C": ("X", "Y"), "B": ("X", "Z"), "A": ("Y", "Z")}[name[2]]


def _straight(sheet: ArtefactSheet, machine: Machine) -> StandardTest:
    """Return the straightness that a reversed straightedge shows."""
    own = artefact_named(sheet.artefact)
    if not isinstance(own, Straightedge):
        raise InputError("no such evaluation", expected="a straightedge", file=sheet.path, value=sheet.artefact)
    at, axis_um, shape_um, u_um = own.separated(sheet, machine)
    name = f"E_{sheet.plane[1]}{sheet.plane[0]}"
    bent = straightness(at, axis_um, name=name)
    shape = straightness(at, shape_um)
    residual = bent.least_squares.residual_um
    line = np.column_stack([np.ones(len(at)), at])
    weights = np.eye(len(at)) - line @ np.linalg.pinv(line)
    difference = weights[int(np.argmax(residual))] - weights[int(np.argmin(residual))]
    u = float(np.sqrt(np.square(difference) @ np.square(u_um)))
    return StandardTest(
        kind="straightness",
        name=name,
        standard=Message("ISO 230-1:2012, test 8.2.2.1"),
        axes=(sheet.plane[0],),
        place=_place(sheet),
        values=(
            StandardValue(
                name, name, bent.least_squares.value_um, "um", Message("straightness error"), u, COVERAGE_FACTOR * u
            ),
        ),
        remarks=(
            Message(
                "shape of the straightedge itself, separated: {size}",
                size=Number(figure(shape.least_squares.value_um, "µm")),
            ),
        ),
        detail=bent,
    )


def calibration_of(
    result: EvaluationResult, found: AdjustedErrors, machine: Machine, simulated: bool = False
) -> Calibration:
    """Return the calibration with the scales and squarenesses that were determined.

    Standard uncertainties in it are U (95 %) divided by the factor of a normal distribution, so that intervals made from them have the
    stated coverage. `InputError` if nothing was determined.
    """
    model = linear_model(machine)
    known = [k for k, value in enumerate(found.values) if not np.isnan(value)]
    if not known:
        what = "neither scale nor squareness was determined: there is no calibration to write"
        raise InputError(what, expected="a sheet of another artefact (twin doc artefacts)", value=result.data.source)
    stretch = np.zeros(len(model.names))
    stretch[known] = found.expanded[known] / COVERAGE_FACTOR / np.sqrt(np.diag(found.covariance)[known])
    covariance = found.covariance * np.outer(stretch, stretch)
    names: list[str] = []
    rows: list[np.ndarray] = []
    curves, squareness = {}, {}
    for k in known:
        name, value, unit = model.names[k], float(found.values[k]), np.eye(len(model.names))[k]
        if name.startswith("E_"):
            squareness[name] = 1e6 * value
            names.append(name)
            rows.append(1e6 * unit)
        else:
            curve = scale_curve(machine.by_name[name.split()[1]], value, float(covariance[k, k]))
            curves[curve.name] = curve
            shape = scale_curve(machine.by_name[name.split()[1]], 1.0).coefficients
            names += [f"{curve.name}[{i}]" for i in range(2)]
            rows += [one * unit for one in shape]
    factor = np.array(rows)
    why = "not measured: the artefacts do not show it"
    unknown = [name for k, name in enumerate(model.names) if k not in known]
    entries = [
        name if name.startswith("E_") else scale_curve(machine.by_name[name.split()[1]], 0.0).name for name in unknown
    ]
    return Calibration(
        machine=machine,
        source=f"artefacts: {result.data.source}. Scale and squareness only; other errors were not measured.",
        curves=MappingProxyType(curves),
        squareness=MappingProxyType(squareness),
        location=MappingProxyType({}),
        joint=Covariance(tuple(names), read_only(factor @ covariance @ factor.T)),
        simulated=simulated,
        not_identifiable=tuple(UnidentifiedEntry(name=name, why=why) for name in entries),
    )
