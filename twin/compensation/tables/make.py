"""Make the files of a control from a calibration, read them back and compare them with the model."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final, final

import numpy as np

from twin._common.errors import InputError
from twin._common.families import BASIC
from twin._common.provenance import warning_texts
from twin._common.records import APPROACH, json_form
from twin.compensation.tables.axis_tables import AxisTables, ComponentErrors, choose_nodes
from twin.compensation.tables.design import (
    POSITIONS_CHECKED,
    SEED,
    U_EVERY,
    Design,
    ProofOfTables,
    Request,
    RequiredCorrections,
    Share,
    Table,
    TablePlan,
    Unproven,
    share_depending_on,
)
from twin.compensation.tables.remains import PointUncertainty, VolumeError, or_unknown, volume_error
from twin.controls import ControlSection, Correction, TableFormat, TableSummary
from twin.controls.correction import EXACT_UM, MM_PER_UM, CorrectionGrid, MatrixCorrection
from twin.controls.formats.skew import SkewFormat
from twin.machine.machine import Axis, Machine
from twin.model.calibration import Calibration
from twin.model.conditions import values_in_words
from twin.model.effects import Effect
from twin.tool.forward import Poses
from twin.tool.uncertainty import DEFINITION, volume

BEFORE: Final = "before"
CONSTANTS: Final = "with_kinematics"
TABLES: Final = "with_kinematics_and_tables"
PROGRAM: Final = "with_program"
TITLES: Final = {
    BEFORE: "nominal kinematics in the control",
    CONSTANTS: "with the kinematics",
    TABLES: "with the kinematics and the tables",
    PROGRAM: "and a compensated program, in least increments",
}


@final
@dataclass(frozen=True)
class Stages:
    """Error that remains at the tool after every stage of the correction."""

    poses: int
    # error by stage; the stage of tables is absent without tables, that of the program for a machine that runs none
    errors: dict[str, VolumeError]
    uncertainty: PointUncertainty  # uncertainty of the point, the same in all stages

    def to_lines(self) -> list[str]:
        """Return the stages as text, one line each below a header."""
        u = self.uncertainty
        spread = f"{or_unknown(u.rms_um):>11}  {or_unknown(u.max_um):>11}"
        lines = [
            f"Error of the tool centre point in tool centre point mode over the volume ({self.poses} poses), µm",
            f"{'':<52}{'RMS':>9}  {'largest':>9}  {'± U (RMS)':>11}  {'± U (max)':>11}  {'expected RMS':>12}",
        ]
        lines += [
            f"  {TITLES[name]:<50}{one.rms_um:>9.2f}  {one.max_um:>9.2f}  {spread}  {or_unknown(one.expected_rms_um):>12}"
            for name, one in self.errors.items()
        ]
        if not np.isfinite(u.rms_um):
            return [
                *lines,
                "  U is unknown: the calibration gives no uncertainty. The error that really remains may have any size.",
            ]
        lines.append(f"  {DEFINITION}; it comes from the calibration, and no stage reduces it.")
        lines += [f"  {u.unknown_text}"] if u.unknown else []
        if u.without_uncertainty:
            lines.append(f"  U is a lower bound: no uncertainty is given for {' '.join(u.without_uncertainty)}.")
        return lines

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON object; unknown numbers are null."""
        return {"poses": self.poses, **json_form(self.errors), "uncertainty": self.uncertainty.to_dict()}


def stages_of(required: RequiredCorrections, known: Calibration, section: ControlSection) -> Stages:
    """Return the error after every stage, from the files in the control as read back; ``section``: of the calibration."""
    machine = required.machine
    alone = ControlSection("uncorrected", (), section.kinematics)
    kinds = {BEFORE: None, CONSTANTS: alone, TABLES: section} if section.tables else {BEFORE: None, CONSTANTS: alone}
    models = {
        name: required.kinematics_with(known.with_control(one).with_transformation()) for name, one in kinds.items()
    }
    at = required.volume
    uncertainty = PointUncertainty.of(models[BEFORE], at.q, at.sides)
    reached = {name: model.forward(at.q, at.sides) for name, model in models.items()}
    errors = {name: volume_error(poses, at.goal, uncertainty) for name, poses in reached.items()}
    if machine.runs_programs:
        last, linear = TABLES if section.tables else CONSTANTS, list(machine.linear)

        def reach(commands: np.ndarray) -> Poses:
            return models[last].forward(commands, at.sides)

        commands, _ = required.corrected_commands(reach, reached[last])
        increments = np.array([machine.axes[i].increment for i in linear])
        commands[:, linear] = np.round(commands[:, linear] / increments) * increments
        errors[PROGRAM] = volume_error(reach(commands), at.goal, uncertainty)
    return Stages(len(at.q), errors, uncertainty)


# --- Corrections of the three linear axes for their own errors, on a grid over their ranges -------

SHARES: Final = (0.6, 0.4, 0.3, 0.2)
"""Shares of the tolerance for one axis, tried in turn: interpolation errors of three axes add up, depending on the machine."""
MARGIN: Final = 1.05
"""Safety factor, as only a sample of the cells is checked."""
CELLS: Final = 4000
CELL_SEED: Final = 230
Truth = Callable[[np.ndarray], np.ndarray]
"""Function from (n, axes) positions to (n, 3) required corrections in µm."""


@final
class GridDesign(Design[CorrectionGrid]):
    """Compute the corrections of the three linear axes at the points of a grid."""

    correction = CorrectionGrid

    def plan(
        self, required: RequiredCorrections, request: Request, old: CorrectionGrid | None
    ) -> TablePlan[CorrectionGrid]:
        """See `Design.plan`."""
        machine = required.machine
        axes = [machine.axes[i] for i in machine.linear]
        names = tuple(axis.name for axis in axes)
        if len(names) != 3:
            raise InputError(
                f"{machine.name} does not have three linear axes",
                expected="three linear axes for a grid; linuxcnc, heidenhain and siemens have tables of single axes",
                file=machine.path,
                value=" ".join(names) or "none",
            )

        proof = ProofOfTables(required, keep_all=request.unproven)
        kept = np.array(_proven(required, axes, proof), dtype=float)

        def truth(positions: np.ndarray) -> np.ndarray:
            return required.linear_corrections(names, positions) * kept

        tolerance = request.tolerance_um
        if old is not None:
            grid = _on_nodes(required, tuple(np.array(nodes) for nodes in old.at), truth)
            off = _largest_deviation(required, grid, truth)
        else:
            for share in SHARES:
                where = tuple(_nodes(required, axis, truth, share * tolerance, request) for axis in axes)
                grid = _on_nodes(required, where, truth)
                off = _largest_deviation(required, grid, truth)
                if off <= tolerance or request.step is not None:
                    break
        return TablePlan(
            grid, lambda back: _tables(required, request, grid, truth, off, back), unproven=tuple(proof.unproven)
        )

    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """See `Design.share`."""
        if not required.machine.by_name[effect.frame.axis].linear:
            return "no", "error of a rotary axis: the grid depends on X, Y and Z only"
        return share_depending_on([axis for axis in others if not axis.linear])


def _proven(required: RequiredCorrections, axes: Sequence[Axis], proof: ProofOfTables) -> list[bool]:
    """Return for each of the linear axes whether its correction over the box is written; otherwise it is zero."""
    names = tuple(axis.name for axis in axes)
    rng = np.random.default_rng(SEED)
    q = _full(
        required,
        np.stack([rng.uniform(*required.range_of(axis), POSITIONS_CHECKED // U_EVERY) for axis in axes], axis=1),
    )
    values, factors = required.linear_corrections(names, q), required.linear_factors(names, q)
    return [
        # Without any correction there is nothing to prove.
        not values[:, k].any()
        or proof.keeps(
            TableSummary.over(f"d{name} over the box", (0.0,), 0.0, "um"), names, BASIC, values[:, k], factors[:, k]
        )
        for k, name in enumerate(names)
    ]


def _tables(
    required: RequiredCorrections,
    request: Request,
    grid: CorrectionGrid,
    truth: Truth,
    off: float,
    back: CorrectionGrid,
) -> tuple[Table, ...]:
    """Compare the corrections of every axis, as written and as read back, with the required ones at random positions."""
    rng = np.random.default_rng(SEED)
    q = np.stack([rng.uniform(nodes[0], nodes[-1], POSITIONS_CHECKED) for nodes in grid.at], axis=1)
    state, meant = _state(required, q), truth(_full(required, q))
    tables = []
    for k, (name, content) in enumerate(zip(grid.axes, grid.contents(), strict=True)):
        written, read = (float(np.abs(one.shift(name, state) - meant[:, k]).max()) for one in (grid, back))
        # A random position may show a larger deviation than the cells checked before: report the larger one.
        tables.append(Table(content, max(off, written), request.form.rounding[0], request.tolerance_um, read))
    return tuple(tables)


def _nodes(required: RequiredCorrections, axis: Axis, truth: Truth, limit_um: float, request: Request) -> np.ndarray:
    """Return the nodes of one axis, chosen along the edges of the box, where the levers of angular errors are longest."""
    others = [required.machine.axes[i] for i in required.machine.linear if required.machine.axes[i] is not axis]
    corners = [
        {one.name: end for one, end in zip(others, ends, strict=True)}
        for ends in product(*(required.range_of(other) for other in others))
    ]

    def along(q: np.ndarray) -> np.ndarray:
        return np.concatenate([truth(required.positions_along(axis, q, corner)) for corner in corners], axis=1)

    limits = np.full(3 * len(corners), limit_um)
    return choose_nodes(along, *required.range_of(axis), limits, step=request.step, most=request.form.points).at


def _on_nodes(required: RequiredCorrections, where: tuple[np.ndarray, ...], truth: Truth) -> CorrectionGrid:
    """Return the grid with the required corrections at its points."""
    mesh = np.stack(np.meshgrid(*where, indexing="ij"), axis=-1).reshape(-1, 3)
    values = truth(_full(required, mesh)).reshape(*(len(nodes) for nodes in where), 3)
    return CorrectionGrid(required.machine, tuple(tuple(nodes.tolist()) for nodes in where), values)


def _largest_deviation(required: RequiredCorrections, grid: CorrectionGrid, truth: Truth) -> float:
    """Return the largest deviation in µm of the required correction from the grid's interpolation.

    The centres of some cells and the midpoints of cell sides along the edges of the box are checked, where it is largest.
    """
    rng, where = np.random.default_rng(CELL_SEED), [np.array(nodes) for nodes in grid.at]
    inside = np.stack([rng.choice(0.5 * (nodes[1:] + nodes[:-1]), CELLS) for nodes in where], axis=1)
    ends = np.stack([rng.choice(nodes[[0, -1]], CELLS) for nodes in where], axis=1)
    on_edges = np.where(rng.integers(0, 3, (CELLS, 1)) == np.arange(3), inside, ends)
    q = np.concatenate([inside, on_edges])
    state = _state(required, q)
    seen = np.stack([grid.shift(name, state) for name in grid.axes], axis=1)
    return float(MARGIN * np.abs(seen - truth(_full(required, q))).max())


def _full(required: RequiredCorrections, linear: np.ndarray) -> np.ndarray:
    """Return (n, axes) positions: the linear axes as given, the other axes at their reference positions."""
    rows = np.tile([required.at[name] for name in required.machine.names], (len(linear), 1))
    rows[:, list(required.machine.linear)] = linear
    return np.asarray(rows)


def _state(required: RequiredCorrections, linear: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(required.machine.names, _full(required, linear).T, strict=True))


# --- Skew and scale settings: the part of the required corrections that is linear in the positions of the linear axes

PER_AXIS: Final = 5
"""Positions of each linear axis at which the linear part is fitted."""


@final
class MatrixDesign(Design[MatrixCorrection]):
    """Compute the linear part of the corrections by least squares over the volume; the format says which entries it holds."""

    correction = MatrixCorrection

    def plan(
        self, required: RequiredCorrections, request: Request, old: MatrixCorrection | None
    ) -> TablePlan[MatrixCorrection]:
        """See `Design.plan`."""
        machine, form = required.machine, request.form
        if not isinstance(form, SkewFormat):
            raise LookupError(f"{form.name} has corrections of another kind")
        axes = [machine.axes[i] for i in machine.linear]
        names = tuple(axis.name for axis in axes)
        form.check(names)
        mesh = np.meshgrid(*(np.linspace(*required.range_of(axis), PER_AXIS) for axis in axes), indexing="ij")
        linear = np.stack(mesh, axis=-1).reshape(-1, len(names))
        positions = _full(required, linear)
        # The constant is the zero of the machine: settings leave it alone.
        fit = np.linalg.pinv(np.column_stack([linear, np.ones(len(linear))]))[:-1] * MM_PER_UM
        values = (fit @ required.linear_corrections(names, positions)).T
        # Where the scale stays, a column of the whole matrix keeps its direction: what is square then has edges of other lengths.
        kept = [1.0 if form.holds(name, name) else 1.0 + values[j, j] for j, name in enumerate(names)]
        values = np.where(np.eye(len(names), dtype=bool), values, values / np.array(kept))
        spread = np.einsum("jn,nir->ijr", fit, required.linear_factors(names, positions))
        matrix, scale, proof = np.zeros(values.shape), {}, ProofOfTables(required, keep_all=request.unproven)
        for i, moved in enumerate(names):
            for j, by in enumerate(names):
                along, holds = linear[:, j] / MM_PER_UM, form.holds(moved, by)
                if not (holds or i == j) or abs(values[i, j]) * np.abs(along).max() < EXACT_UM:
                    continue
                content = TableSummary.over(f"{moved} by {by}", axes[j].domain, 0.0, "um")
                # An entry that the format does not hold is no table that could be refused.
                judge = proof if holds else ProofOfTables(required, keep_all=False)
                if judge.keeps(content, (by,), BASIC, values[i, j] * along, along[:, None] * spread[i, j]):
                    if holds:
                        matrix[i, j] = values[i, j]
                    else:
                        scale[moved] = float(values[i, j])

        correction = MatrixCorrection(machine, matrix, scale)

        def compared(back: MatrixCorrection) -> tuple[Table, ...]:
            rows = []
            for content, (moved, by, value) in zip(correction.contents(), correction.entries, strict=True):
                read = back.matrix[names.index(moved), names.index(by)]
                reach = max(abs(content.low), abs(content.high)) / MM_PER_UM
                rounding = reach * form.digit
                rows.append(Table(content, 0.0, rounding, request.tolerance_um, abs(read - value) * reach))
            return tuple(rows)

        return TablePlan(correction, compared, unproven=tuple(proof.unproven))

    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """See `Design.share`."""
        if required.class_of(effect) == "L-SQU":
            return "whole", ""
        return "line", "only the part that is linear in the positions, in the entries that the format has"


# --- Make the files of a control from a calibration, read them back and compare them with the model

DESIGNS: Final[tuple[Design[Any], ...]] = (AxisTables(), ComponentErrors(), GridDesign(), MatrixDesign())


def design_of(form: TableFormat[Any]) -> Design[Any]:
    """Return the class that computes the tables of a format."""
    return next(design for design in DESIGNS if design.correction is form.correction)


@final
@dataclass(frozen=True)
class ControlTables:
    """Tables for a control, as files and as read back from them."""

    required: RequiredCorrections  # the required corrections they were made from
    request: Request  # format and settings
    files: Mapping[str, str]  # text by file name, as the control reads it
    increment: Mapping[str, str]  # text by file name of the new part alone if tables were added to old ones; else empty
    correction: Correction  # corrections of the control with these files, as read back
    tables: tuple[Table, ...]  # every table compared with the model
    left_out: tuple[str, ...]  # tables left out because the control has too few
    unproven: tuple[Unproven, ...]  # tables that are not shown to be an improvement: not written, or written on request
    # largest correction by axis, over the volume and both directions, as read back: µm, µrad
    largest: Mapping[str, float]

    @property
    def held(self) -> Mapping[str, float]:
        """Temperatures, time and speed for which the tables are."""
        return self.request.conditions.used(self.required.calibration)

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        unmet = [text for table in self.tables for text in table.unmet]
        unmet += [f"no table available for {one} um" for one in self.left_out]
        if not self.request.unproven:
            # An error that was identified and is not significant needs no table.
            unmet += [f"not written: {one.text}" for one in self.unproven if one.not_identified]
        return tuple(unmet)


def make(
    machine: Machine, calibration: Calibration, request: Request, required: RequiredCorrections | None = None
) -> ControlTables:
    """Make the tables and read them back; ``required``: if known from another format with the same settings.

    `InputError` for a calibration that did not converge or was measured with tables on (unless ``request.add``), old tables of another
    format, no error that the format can correct, or no table that is shown to be an improvement.
    """
    if not request.tolerance_um > 0.0:
        raise InputError("tolerance must be positive", expected="µm", value=request.tolerance_um)
    calibration.check_settled()
    check_no_module(calibration)
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


def check_no_module(calibration: Calibration) -> None:
    """Raise `InputError` if a kinematics module is active in the control, beside which tables and kinematics are not made."""
    calibration.check_not_live()
    if calibration.control is not None and calibration.control.live:
        raise InputError(
            "these errors were measured with a kinematics module active: tables or kinematics beside it are not made",
            expected="a new module that holds both (twin doc control)",
            file=calibration.path,
        )


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
    largest = dict.fromkeys(correction.axes, 0.0)
    for side in (1.0, -1.0):
        state: dict[str, Any] = {name: q[:, i] for i, name in enumerate(machine.names)}
        state |= {f"{APPROACH}{name}": np.full(len(q), side) for name in machine.names}
        for name in correction.axes:
            largest[name] = max(largest[name], float(np.abs(correction.shift(name, state)).max()))
    return largest


def _compare_sums(whole: Correction, parts: tuple[Correction, Correction], form: TableFormat[Any]) -> list[Table]:
    """Check that the files to be loaded give the sum of the old and the new tables; return one row per axis."""
    rng, machine = np.random.default_rng(SEED), whole.machine
    state = {axis.name: rng.uniform(*axis.domain, POSITIONS_CHECKED) for axis in machine.axes}
    state |= {f"{APPROACH}{name}": rng.choice([-1.0, 1.0], POSITIONS_CHECKED) for name in machine.names}
    rows = []
    for name in whole.axes:
        axis = machine.by_name[name]
        meant = np.broadcast_to(sum(part.shift(name, state) for part in parts if name in part.axes), POSITIONS_CHECKED)
        said = np.broadcast_to(whole.shift(name, state), POSITIONS_CHECKED)
        # The sum is rounded once more than the new part: one digit for each table that corrects the axis.
        rounding = 2.0 * form.rounding[0 if axis.linear else 1] * whole.rounded(name)
        unit, largest = "um" if axis.linear else "urad", float(np.abs(said).max())
        content = TableSummary(f"old + new, all corrections of {name}", *axis.domain, 0, 0.0, largest, unit)
        rows.append(Table(content, 0.0, rounding, float("inf"), float(np.abs(said - meant).max())))
    return rows
