"""From a calibration to the files of a control, read back from their text and compared with the model before anybody loads them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.provenance import texts
from twin.control.axis_tables import AxisTables
from twin.control.component_errors import ComponentErrors
from twin.control.design import CHECKS, SEED, Design, Table
from twin.control.request import Request
from twin.control.spatial_grid import GridDesign
from twin.control.wanted import Wanted
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH
from twin.machine.control import Content, Correction, TableFormat
from twin.machine.machine import Machine
from twin.uncertainty.budget import volume

DESIGNS: Final[tuple[Design[Any], ...]] = (AxisTables(), ComponentErrors(), GridDesign())


def design_of(form: TableFormat[Any]) -> Design[Any]:
    """Return how the tables of a format are worked out."""
    return next(one for one in DESIGNS if one.correction is form.correction)


@final
@dataclass(frozen=True)
class Made:
    """Files of a control.

    Attributes:
        wanted: what they were made from.
        request: what was asked for.
        files: text by name; those the control reads.
        increment: text by name of the new part alone, where tables were added to old ones; else nothing.
        correction: what the control that is given the files does, as read back.
        tables: each as it was read back.
        left_out: tables there was no room for.
        largest: correction of every axis that is moved, over the volume and both directions, as read back: µm, µrad.
    """

    wanted: Wanted
    request: Request
    files: Mapping[str, str]
    increment: Mapping[str, str]
    correction: Correction
    tables: tuple[Table, ...]
    left_out: tuple[str, ...]
    largest: Mapping[str, float]

    @property
    def unmet(self) -> tuple[str, ...]:
        """What could not be met, in words."""
        found = [text for one in self.tables for text in one.unmet]
        return (*found, *(f"no table left for {one} um" for one in self.left_out))


def make(machine: Machine, calibration: Calibration, request: Request) -> Made:
    """Make the tables and read them back.

    Args:
        machine: the machine.
        calibration: its errors; what its control takes out by itself is not counted in.
        request: what is asked for.

    Raises:
        InputError: a format there is not; a calibration that did not settle; one whose errors are left under tables, without ``add``;
            old tables that cannot be added to; a calibration without errors that the format can carry.
    """
    if not request.tolerance_um > 0.0:
        raise InputError("--tolerance is not positive", expected="µm", value=request.tolerance_um)
    calibration.check_settled()
    form = request.form
    doubts = (f"not checked against a public description: {one}" for one in form.unchecked)
    request = replace(request, notes=(*request.notes, *texts(calibration.warnings), *doubts))
    old = _old(machine, calibration, request)
    wanted = Wanted(machine, calibration, request.at, request.tool_length_mm, request.classes, request.conditions)
    plan = design_of(form).plan(wanted, request, old)
    if not plan.correction.contents():
        raise InputError(
            "nothing to put into tables",
            expected="a calibration with errors this format can carry",
            file=calibration.path,
            value=request.kind,
        )
    files = form.write(plan.correction, request.notes)
    back = form.read_back(files, machine)
    tables = plan.compared(back)
    if old is None:
        return Made(wanted, request, files, {}, back, tables, plan.left_out, _largest(back))
    whole = form.write(plan.correction.plus(old), request.notes)
    said = form.read_back(whole, machine)
    rows = (*tables, *_sums(said, (old, back), form))
    return Made(wanted, request, whole, files, said, rows, plan.left_out, _largest(said))


def _old(machine: Machine, calibration: Calibration, request: Request) -> Correction | None:
    """The tables that new ones are added to."""
    control = calibration.control
    remaining = control is not None and control.errors_are == "remaining"
    if request.add and not remaining:
        raise InputError(
            "--add, and the errors of the calibration are not those left under tables",
            expected="a calibration that says `control: errors_are: remaining`; otherwise the new tables replace the old ones",
            file=calibration.path,
        )
    if not remaining or control is None:
        return None
    if not request.add:
        raise InputError(
            "the errors of this calibration were measured with tables switched on: new tables in their place would lose what those "
            "take out",
            expected="--add, which writes the old and the new ones together",
            file=calibration.path,
            value=" ".join(entry.file.name for entry in control.tables),
        )
    if control.formats != (request.kind,):
        raise InputError(
            "the tables to be added to are of another format",
            expected=f"--to {control.formats[0]}",
            file=calibration.path,
            value=request.kind,
        )
    for entry in control.tables:
        entry.check()
    return request.form.read([entry.file for entry in control.tables], machine)


def _largest(correction: Correction) -> dict[str, float]:
    machine, q = correction.machine, volume(correction.machine)
    found = dict.fromkeys(correction.axes, 0.0)
    for side in (1.0, -1.0):
        state: dict[str, Any] = {name: q[:, i] for i, name in enumerate(machine.names)}
        state |= {f"{APPROACH}{name}": np.full(len(q), side) for name in machine.names}
        for name in correction.axes:
            found[name] = max(found[name], float(np.abs(correction.shift(name, state)).max()))
    return found


def _sums(whole: Correction, parts: tuple[Correction, Correction], form: TableFormat[Any]) -> list[Table]:
    """That the files to be loaded say what the old and the new tables say together."""
    rng, machine = np.random.default_rng(SEED), whole.machine
    state = {axis.name: rng.uniform(*axis.domain, CHECKS) for axis in machine.axes}
    state |= {f"{APPROACH}{name}": rng.choice([-1.0, 1.0], CHECKS) for name in machine.names}
    rows = []
    for name in whole.axes:
        axis = machine.by_name[name]
        meant = np.broadcast_to(sum(one.shift(name, state) for one in parts if name in one.axes), CHECKS)
        said = np.broadcast_to(whole.shift(name, state), CHECKS)
        # A table of the sum is rounded once more than its new part: a digit for each that moves the axis.
        rounding = 2.0 * form.rounding[0 if axis.linear else 1] * whole.rounded(name)
        unit, largest = "um" if axis.linear else "urad", float(np.abs(said).max())
        content = Content(f"old + new, all that moves {name}", *axis.domain, 0, 0.0, largest, unit)
        rows.append(Table(content, 0.0, rounding, float("inf"), float(np.abs(said - meant).max())))
    return rows
