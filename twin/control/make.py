"""From a calibration to the files of a control, read back from their text and compared with the model before anybody loads them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.files import scratch_folder
from twin._common.provenance import texts
from twin.control.design import Format, Planned, by_key, key_of, named, summed, tables, tolerance_of
from twin.control.volumetric import (
    PlannedErrors,
    PlannedGrid,
    added_errors,
    component_errors,
    spatial_grid,
)
from twin.control.wanted import Wanted
from twin.machine.calibration import Calibration
from twin.machine.conditions import APPROACH, Conditions
from twin.machine.control import Correction, Term, Terms, grid, heidenhain, isg, linuxcnc, read_tables, siemens
from twin.machine.control.geometry import Geometry
from twin.machine.iso16907 import BASIC
from twin.machine.machine import DIRECTIONS, Machine
from twin.uncertainty.budget import volume

FORMAT: Final[Mapping[str, Format]] = {
    "linuxcnc": Format(linuxcnc.POINTS, False, False, False, False, (0.0005, 0.0088)),
    "heidenhain": Format(heidenhain.POINTS, True, False, True, False, (0.05, 0.0875)),
    "siemens": Format(siemens.POINTS, True, True, True, True, (0.0005, 0.0088)),
}
"""Half of the last digit: 0.5 nm; 0.5e-6 degrees (linuxcnc, siemens), 0.05 µm and 0.5e-5 degrees (heidenhain)."""
CHECKS: Final = 997
"""Positions of every table, drawn, at which it is compared with the model."""
SEED: Final = 16907
TABLES: Final = siemens.TABLES
UNCHECKED: Final[Mapping[str, tuple[str, ...]]] = {
    "heidenhain": heidenhain.UNCHECKED,
    "siemens": siemens.UNCHECKED,
    "isg": isg.UNCHECKED,
}
"""By format: what could not be checked against a public description of it; said in every file and in the account."""


@final
@dataclass(frozen=True)
class Request:
    """What is asked for.

    Attributes:
        kind: one of `twin.machine.control.FORMATS`.
        at: mm, degrees by axis: where the other axes stand while one moves; the middle of their ranges where none is given.
        tool_length_mm: at which length the point is corrected; None: the machine file's.
        classes: basic classes to correct.
        tolerance_um: of the interpolation.
        step: mm or degrees between nodes; None: as wide as the tolerance allows.
        most: tables the control has (siemens).
        products: whether two tables may be multiplied (siemens).
        conditions: temperatures and time.
        add: whether the calibration's errors are those left under tables that are to be kept, the new ones added to them.
        notes: lines for the comments of every file.
    """

    kind: str
    at: Mapping[str, float] = field(default_factory=dict)
    tool_length_mm: float | None = None
    classes: frozenset[str] = frozenset(BASIC)
    tolerance_um: float = 1.0
    step: float | None = None
    most: int = TABLES
    products: bool = True
    conditions: Conditions = field(default_factory=Conditions)
    add: bool = False
    notes: tuple[str, ...] = ()


@final
@dataclass(frozen=True)
class Table:
    """One table as it was read back.

    Attributes:
        name: ``Y by X``.
        unit: ``um`` or ``urad``.
        low, high: range of its nodes, mm or degrees.
        nodes: how many; of the axis with the most for a grid.
        step: between them.
        peak: largest value, in ``unit``.
        off: the truth is no farther from the straight lines between the nodes, in ``unit``.
        rounding: of the written digits, in ``unit``.
        back: largest distance between the table as read back and the model at positions drawn, in ``unit``.
        tolerance: of the interpolation, in ``unit``.
    """

    name: str
    unit: str
    low: float
    high: float
    nodes: int
    step: float
    peak: float
    off: float
    rounding: float
    back: float
    tolerance: float

    @property
    def holds(self) -> bool:
        """Whether the text says what was meant."""
        return self.back <= self.off + self.rounding

    @property
    def fine(self) -> bool:
        """Whether its nodes are dense enough for the tolerance."""
        return self.off <= self.tolerance * (1.0 + 1e-9)


@final
@dataclass(frozen=True)
class Made:
    """Files of a control.

    Attributes:
        wanted: what they were made from.
        request: what was asked for.
        files: text by name; those the control reads.
        increment: text by name of the new part alone, where tables were added to old ones; else nothing.
        tables: each as it was read back.
        left_out: tables there was no room for.
        unchecked: what of the format could not be checked against a public description.
        largest: correction of every axis that is moved, over the volume and both directions, as read back: µm, µrad.
    """

    wanted: Wanted
    request: Request
    files: Mapping[str, str]
    increment: Mapping[str, str]
    tables: tuple[Table, ...]
    left_out: tuple[str, ...]
    unchecked: tuple[str, ...]
    largest: Mapping[str, float]

    @property
    def unmet(self) -> tuple[str, ...]:
        """What could not be met, in words."""
        found = [
            f"{one.name}: as read back {one.back:.4f} {one.unit} from the model, more than {one.off:.4f} + {one.rounding:.4f}"
            for one in self.tables
            if not one.holds
        ]
        found += [
            f"{one.name}: {one.off:.3f} {one.unit} between the nodes, more than the tolerance {one.tolerance:g}"
            for one in self.tables
            if not one.fine
        ]
        found += [f"no table left for {one} um" for one in self.left_out]
        return tuple(found)


def middle_of(machine: Machine, at: Mapping[str, float]) -> dict[str, float]:
    """Where axes stand: as given; else linear axes in the middle of their ranges, rotary ones as near to zero as they come.

    Raises:
        InputError: no such axis, or a position out of its range.
    """
    found = {}
    for axis in machine.axes:
        low, high = axis.domain
        found[axis.name] = 0.5 * (low + high) if axis.linear else float(np.clip(0.0, low, high))
    for name, value in at.items():
        if name not in found:
            raise InputError("--at of no axis", expected=f"one of {' '.join(machine.names)}", value=name)
        low, high = machine.by_name[name].domain
        if not low <= value <= high:
            raise InputError(f"--at out of the range of {name}", expected=f"{low:g} … {high:g}", value=value)
        found[name] = float(value)
    return found


def make(machine: Machine, calibration: Calibration, request: Request) -> Made:
    """Make the tables and read them back.

    Args:
        machine: the machine.
        calibration: its errors; what its control takes out by itself is not counted in.
        request: what is asked for.

    Raises:
        InputError: a format there is not; a calibration that did not settle; one whose errors are left under tables, without ``add``;
            old tables that cannot be added to.
    """
    if not request.tolerance_um > 0.0:
        raise InputError("--tolerance is not positive", expected="µm", value=request.tolerance_um)
    calibration.check_settled()
    doubts = (f"not checked against a public description: {one}" for one in UNCHECKED.get(request.kind, ()))
    request = replace(request, notes=(*request.notes, *texts(calibration.warnings), *doubts))
    old = _old(machine, calibration, request)
    length = machine.tool_length_mm if request.tool_length_mm is None else request.tool_length_mm
    wanted = Wanted(
        machine,
        calibration.with_control(None),
        middle_of(machine, request.at),
        length,
        request.classes,
        request.conditions,
    )
    match request.kind:
        case "isg":
            return _isg(wanted, request, old)
        case "grid":
            return _grid(wanted, request, old)
        case _:
            return _axis_wise(wanted, request, old)


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
    return read_tables(request.kind, [entry.file for entry in control.tables], machine)


def read_back(files: Mapping[str, str], kind: str, machine: Machine) -> Correction:
    """What a control that is given these texts does, as `twin.machine.control.read_tables` reads them."""
    with scratch_folder() as folder:
        paths = []
        for name, text in files.items():
            path = folder / name
            path.write_text(text, encoding="utf-8")
            paths.append(path)
        return read_tables(kind, paths, machine)


def _largest(correction: Correction, machine: Machine) -> dict[str, float]:
    q = volume(machine)
    found = dict.fromkeys(correction.axes, 0.0)
    for side in (1.0, -1.0):
        state: dict[str, Any] = {name: q[:, i] for i, name in enumerate(machine.names)}
        state |= {f"{APPROACH}{name}": np.full(len(q), side) for name in machine.names}
        for name in correction.axes:
            found[name] = max(found[name], float(np.abs(correction.shift(name, state)).max()))
    return found


def _axis_wise(wanted: Wanted, request: Request, old: Correction | None) -> Made:
    machine, form = wanted.machine, FORMAT[request.kind]
    if old is not None and not isinstance(old, Terms):
        raise InputError("old tables of another kind", expected="tables of single axes", value=request.kind)
    planned, left = tables(
        wanted,
        form,
        tolerance_um=request.tolerance_um,
        step=request.step,
        products=request.products,
        most=request.most if request.kind == "siemens" else TABLES,
        old=old,
    )
    if not planned:
        raise InputError(
            "nothing to put into tables",
            expected="a calibration with errors this format can carry",
            file=wanted.calibration.path,
            value=request.kind,
        )
    write = {"linuxcnc": linuxcnc.write, "heidenhain": heidenhain.write, "siemens": siemens.write}[request.kind]
    own = write([one.term for one in planned], machine, request.notes)
    whole = own if old is None else write(summed(planned, old), machine, request.notes)
    back = read_back(own, request.kind, machine)
    if not isinstance(back, Terms):
        raise InputError("tables of another kind were read back", expected="tables of single axes", value=request.kind)
    said: Correction = back if old is None else read_back(whole, request.kind, machine)
    found = by_key(back.terms)
    rows = [_row(one, found[key_of(one.term)], wanted, form, request) for one in planned]
    if old is not None:
        rows += _sum_rows(said, old, back, machine, form)
    unchecked = UNCHECKED.get(request.kind, ())
    return Made(
        wanted, request, whole, own if old is not None else {}, tuple(rows), left, unchecked, _largest(said, machine)
    )


def _row(one: Planned, back: Term, wanted: Wanted, form: Format, request: Request) -> Table:
    machine, curve = wanted.machine, one.term.factors[0]
    low, high = curve.at[0], curve.at[-1]
    q = np.random.default_rng(SEED).uniform(low, high, CHECKS)
    moved = machine.by_name[one.term.axis]
    rounding = form.digits[0 if moved.linear else 1]
    truth, said = one.truth(q), back.factors[0].along(q)
    scale = 1.0
    if len(one.term.factors) > 1:
        # The product is largest where the other axis is farthest from its reference.
        reach = int(np.argmax(np.abs(one.term.factors[1].values)))
        end = np.array(one.term.factors[1].at[reach])
        scale = abs(one.term.factors[1].values[reach])
        truth, said = truth * one.term.factors[1].along(end), said * back.factors[1].along(end)
        rounding = rounding * scale + one.peak * 1e-9
    return Table(
        name=named(one.term),
        unit="um" if moved.linear else "urad",
        low=low,
        high=high,
        nodes=len(curve.at),
        step=curve.step,
        peak=one.peak,
        off=one.off,
        rounding=rounding,
        back=float(np.abs(truth - said).max()),
        tolerance=tolerance_of(moved, request.tolerance_um) * scale,
    )


def _sum_rows(
    whole: Correction, old: Correction, new: Correction, machine: Machine, form: Format | None
) -> list[Table]:
    """That the files to be loaded say what the old and the new tables say together."""
    rng = np.random.default_rng(SEED)
    state = {axis.name: rng.uniform(*axis.domain, CHECKS) for axis in machine.axes}
    state |= {f"approach_{name}": rng.choice([-1.0, 1.0], CHECKS) for name in machine.names}
    rows = []
    for name in whole.axes:
        axis = machine.by_name[name]
        parts = [one.shift(name, state) for one in (old, new) if name in one.axes]
        said, meant = np.broadcast_to(whole.shift(name, state), CHECKS), np.broadcast_to(sum(parts), CHECKS)
        # A table of the sum is rounded once more than its new part: a digit for each that moves the axis.
        count = sum(term.axis == name for term in whole.terms) if isinstance(whole, Terms) else 6 * len(machine.axes)
        half = 0.0005 if form is None else form.digits[0 if axis.linear else 1]
        low, high = axis.domain
        back = float(np.abs(said - meant).max())
        rows.append(
            Table(
                f"old + new, all that moves {name}",
                "um" if axis.linear else "urad",
                low,
                high,
                0,
                0.0,
                float(np.abs(said).max()),
                0.0,
                2.0 * half * count,
                back,
                float("inf"),
            )
        )
    return rows


def _isg(wanted: Wanted, request: Request, old: Correction | None) -> Made:
    machine = wanted.machine
    if old is not None and not isinstance(old, isg.Volumetric):
        raise InputError("old tables of another kind", expected="isg", value=request.kind)
    geometry = Geometry(machine, wanted.tool_length_mm)
    planned = component_errors(wanted, geometry, tolerance_um=request.tolerance_um, step=request.step, old=old)
    if not planned:
        raise InputError(
            "nothing to put into tables", expected="a calibration with errors", file=wanted.calibration.path
        )
    own = isg.write([one.errors for one in planned], geometry, request.notes)
    whole = own if old is None else isg.write(added_errors(planned, old), geometry, request.notes)
    back = read_back(own, "isg", machine)
    if not isinstance(back, isg.Volumetric):
        raise InputError("tables of another kind were read back", expected="isg", value=request.kind)
    found = {one.axis: one for one in back.errors}
    rows = [row for one in planned for row in _error_rows(one, found[one.errors.axis], request)]
    said: Correction = back if old is None else read_back(whole, "isg", machine)
    if old is not None:
        rows += _sum_rows(said, old, back, machine, None)
    increment = own if old is not None else {}
    return Made(wanted, request, whole, increment, tuple(rows), (), isg.UNCHECKED, _largest(said, machine))


def _error_rows(one: PlannedErrors, back: isg.AxisErrors, request: Request) -> list[Table]:
    rows = []
    for i, curve in one.errors.curves.items():
        q = np.random.default_rng(SEED).uniform(curve.at[0], curve.at[-1], CHECKS)
        off = float(np.abs(one.truth(q)[:, i] - back.curves[i].along(q)).max())
        linear = i < 3
        rows.append(
            Table(
                name=f"E_{DIRECTIONS[i]}{curve.of}",
                unit="um" if linear else "urad",
                low=curve.at[0],
                high=curve.at[-1],
                nodes=len(curve.at),
                step=curve.step,
                peak=max(abs(value) for value in curve.values),
                off=float(one.off[i]),
                rounding=0.0005,
                back=off,
                tolerance=request.tolerance_um * (1.0 if linear else 2.0),
            )
        )
    return rows


def _grid(wanted: Wanted, request: Request, old: Correction | None) -> Made:
    if old is not None and not isinstance(old, grid.Grid):
        raise InputError("old tables of another kind", expected="grid", value=request.kind)
    planned = spatial_grid(wanted, tolerance_um=request.tolerance_um, step=request.step, old=old)
    own = grid.write(planned.grid, request.notes)
    whole = own
    if old is not None:
        whole = grid.write(grid.Grid(old.names, old.at, old.values + planned.grid.values), request.notes)
    back = read_back(own, "grid", wanted.machine)
    rows = _grid_rows(planned, back, wanted, request)
    said = back if old is None else read_back(whole, "grid", wanted.machine)
    if old is not None:
        rows += _sum_rows(said, old, back, wanted.machine, None)
    increment = own if old is not None else {}
    return Made(wanted, request, whole, increment, tuple(rows), (), (), _largest(said, wanted.machine))


def _grid_rows(planned: PlannedGrid, back: Correction, wanted: Wanted, request: Request) -> list[Table]:
    rng = np.random.default_rng(SEED)
    machine, made = wanted.machine, planned.grid
    positions = np.tile([wanted.at[name] for name in machine.names], (CHECKS, 1))
    for name, nodes in zip(made.names, made.at, strict=True):
        positions[:, machine.names.index(name)] = rng.uniform(nodes[0], nodes[-1], CHECKS)
    state = {name: positions[:, i] for i, name in enumerate(machine.names)}
    truth = planned.truth(positions)
    rows = []
    for k, name in enumerate(made.names):
        nodes = made.at[k]
        # Where a place drawn here is farther off than all that were looked at before, that is what is said of the grid.
        off = max(planned.off, float(np.abs(made.shift(name, state) - truth[:, k]).max()))
        rows.append(
            Table(
                name=f"d{name} over the box",
                unit="um",
                low=nodes[0],
                high=nodes[-1],
                nodes=len(nodes),
                step=nodes[1] - nodes[0],
                peak=float(np.abs(made.values[..., k]).max()),
                off=off,
                rounding=0.5 * 10.0**-grid.DIGITS,
                back=float(np.abs(back.shift(name, state) - truth[:, k]).max()),
                tolerance=request.tolerance_um,
            )
        )
    return rows


def bundle(files: Mapping[str, str], kind: str) -> tuple[str, ...]:
    """Names of the files `twin.machine.control.read_tables` wants of what was written."""
    return tuple(name for name in files if not (kind == "isg" and name == isg.LIST))


def classes_of(kind: str, asked: Sequence[str]) -> tuple[str, ...]:
    """Classes a format takes out, as far as it can, of those asked for."""
    can = {
        "linuxcnc": ("L-POS", "L-ANG", "R-POS"),
        "heidenhain": ("L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS"),
        "siemens": ("L-POS", "L-STR", "L-SQU", "L-ANG", "R-POS"),
        "isg": BASIC,
        "grid": ("L-POS", "L-STR", "L-SQU", "L-ANG"),
    }[kind]
    return tuple(name for name in BASIC if name in can and name in asked)
