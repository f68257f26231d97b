"""Make the files of a control from a calibration, read them back and compare them with the model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.provenance import warning_texts
from twin.control.axis_tables import AxisTables
from twin.control.component_errors import ComponentErrors
from twin.control.design import CHECKS, SEED, Design, Table, Unproven
from twin.control.request import Request
from twin.control.required import RequiredCorrections
from twin.control.spatial_grid import GridDesign
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, values_in_words
from twin.machine.control import Correction, TableFormat, TableSummary
from twin.machine.machine import Machine
from twin.uncertainty.budget import volume

DESIGNS: Final[tuple[Design[Any], ...]] = (AxisTables(), ComponentErrors(), GridDesign())


def design_of(form: TableFormat[Any]) -> Design[Any]:
    """Return the class that computes the tables of a format."""
    return next(one for one in DESIGNS if one.correction is form.correction)


@final
@dataclass(frozen=True)
class ControlTables:
    """Tables for a control, as files and as read back from them.

    Attributes:
        required: the required corrections they were made from.
        request: format and settings.
        files: text by file name, as the control reads it.
        increment: text by file name of the new part alone if tables were added to old ones; else empty.
        correction: corrections of the control with these files, as read back.
        tables: every table compared with the model.
        left_out: tables left out because the control has too few.
        unproven: tables that are not shown to be an improvement: not written, or written on request.
        largest: largest correction by axis, over the volume and both directions, as read back: µm, µrad.
    """

    required: RequiredCorrections
    request: Request
    files: Mapping[str, str]
    increment: Mapping[str, str]
    correction: Correction
    tables: tuple[Table, ...]
    left_out: tuple[str, ...]
    unproven: tuple[Unproven, ...]
    largest: Mapping[str, float]

    @property
    def held(self) -> Mapping[str, float]:
        """Temperatures, time and speed for which the tables are."""
        return self.request.conditions.used(self.required.calibration)

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        found = [text for one in self.tables for text in one.unmet]
        found += [f"no table available for {one} um" for one in self.left_out]
        if not self.request.unproven:
            # An error that was identified and is not significant needs no table.
            found += [f"not written: {one.text}" for one in self.unproven if one.not_identified]
        return tuple(found)


def make(
    machine: Machine, calibration: Calibration, request: Request, required: RequiredCorrections | None = None
) -> ControlTables:
    """Make the tables and read them back.

    Args:
        machine: the machine.
        calibration: its errors; corrections that its control applies are disregarded.
        request: format and settings.
        required: the required corrections, if known from another format with the same settings.

    Raises:
        InputError: an unknown format; a calibration whose estimate did not converge, or that was measured with tables on while
            ``request.add`` is False; old tables of another format; no error that the format can correct; no table that is shown to be
            an improvement.
    """
    if not request.tolerance_um > 0.0:
        raise InputError("tolerance must be positive", expected="µm", value=request.tolerance_um)
    calibration.check_settled()
    form = request.form
    doubts = (f"not checked against public documentation: {one}" for one in form.unchecked)
    held = values_in_words(request.conditions.used(calibration)).replace("°C", "degC")
    only = (f"only for {held}",) if held else ()
    request = replace(request, notes=(*request.notes, *only, *warning_texts(calibration.warnings), *doubts))
    old = _old_tables(machine, calibration, request)
    if required is None:
        required = RequiredCorrections(
            machine, calibration, request.at, request.tool_length_mm, request.classes, request.conditions
        )
    plan = design_of(form).plan(required, request, old)
    if plan.unproven and not any(content.largest > 0.0 for content in plan.correction.contents()):
        worst = max(plan.unproven, key=lambda one: one.u_rms / max(one.rms, 1e-12))
        raise InputError(
            f"none of the {len(plan.unproven)} tables is shown to be an improvement: U of the correction exceeds the correction",
            expected="a calibration with smaller uncertainties, or the tables without proof",
            file=calibration.path,
            value=worst.text,
            setting="force",
        )
    if plan.unproven and request.unproven:
        names = ", ".join(one.name for one in plan.unproven)
        note = f"NOT SHOWN TO BE AN IMPROVEMENT: U exceeds the correction in {names}"
        request = replace(request, notes=(*request.notes, note))
    if not plan.correction.contents():
        raise InputError(
            "no error that these tables could correct",
            expected="a calibration with errors that this format can correct",
            file=calibration.path,
            value=request.kind,
        )
    files = form.write(plan.correction, request.notes)
    back = form.read_back(files, machine)
    tables = plan.compared(back)
    if old is None:
        return ControlTables(required, request, files, {}, back, tables, plan.left_out, plan.unproven, _largest(back))
    whole = form.write(plan.correction.plus(old), request.notes)
    said = form.read_back(whole, machine)
    rows = (*tables, *_compare_sums(said, (old, back), form))
    return ControlTables(required, request, whole, files, said, rows, plan.left_out, plan.unproven, _largest(said))


def _old_tables(machine: Machine, calibration: Calibration, request: Request) -> Correction | None:
    """Return the old tables to which new ones are added; None if there are none."""
    control = calibration.control
    remaining = control is not None and control.errors_are == "remaining"
    if request.add and not remaining:
        raise InputError(
            "tables can be added to old ones only if the calibration was measured with those switched on",
            expected="a calibration with `control: errors_are: remaining`; without it the new tables replace the old ones",
            file=calibration.path,
            setting="add",
        )
    if not remaining or control is None:
        return None
    if not request.add:
        raise InputError(
            "the errors of this calibration were measured with tables switched on: new tables in their place would lose the "
            "corrections of the old ones",
            expected="old and new tables written together",
            file=calibration.path,
            setting="add",
            value=" ".join(entry.file.name for entry in control.tables),
        )
    if control.formats != (request.kind,):
        raise InputError(
            "the old tables are of another format",
            expected=f"the format {control.formats[0]}",
            file=calibration.path,
            setting="to",
            value=request.kind,
        )
    for entry in control.tables:
        entry.check()
    return request.form.read([entry.file for entry in control.tables], machine)


def _largest(correction: Correction) -> dict[str, float]:
    """Return the largest correction of every axis over the volume, from both directions."""
    machine, q = correction.machine, volume(correction.machine)
    found = dict.fromkeys(correction.axes, 0.0)
    for side in (1.0, -1.0):
        state: dict[str, Any] = {name: q[:, i] for i, name in enumerate(machine.names)}
        state |= {f"{APPROACH}{name}": np.full(len(q), side) for name in machine.names}
        for name in correction.axes:
            found[name] = max(found[name], float(np.abs(correction.shift(name, state)).max()))
    return found


def _compare_sums(whole: Correction, parts: tuple[Correction, Correction], form: TableFormat[Any]) -> list[Table]:
    """Check that the files to be loaded give the sum of the old and the new tables; return one row per axis."""
    rng, machine = np.random.default_rng(SEED), whole.machine
    state = {axis.name: rng.uniform(*axis.domain, CHECKS) for axis in machine.axes}
    state |= {f"{APPROACH}{name}": rng.choice([-1.0, 1.0], CHECKS) for name in machine.names}
    rows = []
    for name in whole.axes:
        axis = machine.by_name[name]
        meant = np.broadcast_to(sum(one.shift(name, state) for one in parts if name in one.axes), CHECKS)
        said = np.broadcast_to(whole.shift(name, state), CHECKS)
        # The sum is rounded once more than the new part: one digit for each table that corrects the axis.
        rounding = 2.0 * form.rounding[0 if axis.linear else 1] * whole.rounded(name)
        unit, largest = "um" if axis.linear else "urad", float(np.abs(said).max())
        content = TableSummary(f"old + new, all corrections of {name}", *axis.domain, 0, 0.0, largest, unit)
        rows.append(Table(content, 0.0, rounding, float("inf"), float(np.abs(said - meant).max())))
    return rows
