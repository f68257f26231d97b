"""Tables of one axis over another: which tables a format needs, and their values.

For the kinematics of the control's transformation, the location errors (``E_X0C`` …) give the lines of the rotary axes and the place of
the workpiece exactly. A format that holds only some of them gets the values for which the remaining displacement of the functional
point, over the volume and with this tool, is least in the sum of squares. Squareness errors are not part of it: they also act without a
transformation, and are left to tables.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.families import BASIC
from twin._common.units import TURN
from twin.compensation.tables.design import (
    NEGLIGIBLE_SHARE,
    U_EVERY,
    URAD_PER_UM,
    Design,
    ProofOfTables,
    Request,
    RequiredCorrections,
    Share,
    Table,
    TablePlan,
    check_positions,
    share_depending_on,
    tolerance_of,
)
from twin.controls import ControlCurve, ControlTerm, TableFormat, TableSum, TableSummary
from twin.controls.correction import (
    BOTH,
    DOWN,
    UP,
    AxisErrors,
    Direction,
    VolumetricCorrection,
    period_of,
    rest_geometry,
)
from twin.controls.kinematics import kinematics_named
from twin.controls.kinematics.format import KinematicsFormat, TableGeometry, Values, linear_shift, table_geometry
from twin.machine.error_names import component_names
from twin.machine.machine import Axis, Machine
from twin.model.calibration import Calibration
from twin.model.effects import Effect, split_name
from twin.tool.uncertainty import volume

Truth = Callable[[np.ndarray], np.ndarray]
"""Function from (n,) positions in mm or degrees to (n, k) values."""
RESOLUTION: Final = 1e-4
"""Nodes are multiples of this, in mm or degrees, so that no format rounds them."""
POSITIONS_BETWEEN_NODES: Final = 20
"""Positions checked between two nodes: the peak of a parabola is missed by 0.1 %."""
MARGIN: Final = 1.02


@final
@dataclass(frozen=True)
class Nodes:
    """Nodes of the tables over one axis."""

    at: np.ndarray  # positions in mm or degrees
    values: np.ndarray  # (nodes, k) values there
    deviation: np.ndarray  # (k,) largest deviation from linear interpolation, in the unit of the values


def choose_nodes(
    truth: Truth, low: float, high: float, tolerance: np.ndarray, *, step: float | None, most: int
) -> Nodes:
    """Return the nodes for a range, mm or degrees; `InputError` if the step is not positive or needs too many nodes.

    ``tolerance``: (k,) of the interpolation; ``step``: distance, reduced to one that divides the range; None: as wide as it allows.
    """
    whole = round((high - low) / RESOLUTION)
    counts = [n for n in range(1, most) if whole % n == 0]
    if step is not None:
        if step <= 0.0:
            raise InputError("step must be positive", expected="mm (degrees for a rotary axis)", value=step)
        fine = [n for n in counts if (high - low) / n <= step * (1.0 + 1e-9)]
        if not fine:
            raise InputError(
                "the step needs more points than the format has",
                expected=f"at least {(high - low) / counts[-1]:g} over {low:g} … {high:g}",
                value=step,
                setting="step",
            )
        return nodes_at(truth, np.linspace(low, high, fine[0] + 1))
    for n in counts:
        nodes = nodes_at(truth, np.linspace(low, high, n + 1))
        if np.all(nodes.deviation <= tolerance):
            break
    return nodes


def nodes_at(truth: Truth, nodes: np.ndarray) -> Nodes:
    """Return the values at given nodes and the largest deviation from linear interpolation between them."""
    nodes = np.round(nodes / RESOLUTION) * RESOLUTION
    dense = np.interp(
        np.arange(POSITIONS_BETWEEN_NODES * (len(nodes) - 1) + 1) / POSITIONS_BETWEEN_NODES,
        np.arange(len(nodes)),
        nodes,
    )
    seen = truth(dense)
    values = seen[::POSITIONS_BETWEEN_NODES]
    lines = np.stack([np.interp(dense, nodes, column) for column in values.T], axis=1)
    return Nodes(read_only(nodes), read_only(values), read_only(MARGIN * np.abs(seen - lines).max(axis=0)))


# --- Kinematics of the control's transformation from the constant errors of a calibration: the lines of its rotary axes

ITERATIONS: Final = 3
STEP: Final = 1e-4
"""Step of the derivatives, mm, degrees or of a direction."""
OTHER_POINTS_UM: Final = 1000.0
"""Displacement of the tool centre point from which kinematics are not those of the machine file."""
NEGLIGIBLE_SINGULAR_VALUE: Final = 1e-6
"""Relative singular value of combinations of parameters that do not move the point, such as a shift along an axis."""
ROUND_TRIP_UM: Final = 0.1


@final
@dataclass(frozen=True)
class ConstantKinematics:
    """Kinematics of a control, as a file and as read back from it."""

    form: KinematicsFormat
    machine: Machine
    text: str  # text of the file
    geometry: TableGeometry  # the geometry read back
    # displaced_rms_um, displaced_max_um: displacement of the functional point by the location errors over the volume
    displaced_rms_um: float
    displaced_max_um: float
    # left_rms_um, left_max_um: displacement that remains with the file, because the format cannot hold it
    left_rms_um: float
    left_max_um: float
    round_trip_um: float  # largest displacement of the functional point by rounding in the file
    present: Values  # the control's parameters before, by the names of the format
    values: Values  # the parameters as written
    u: Values  # their standard uncertainties from that of the location errors; NaN if unknown

    @property
    def unmet(self) -> tuple[str, ...]:
        """Requirements that are not met, one sentence each."""
        if self.round_trip_um <= ROUND_TRIP_UM:
            return ()
        return (
            f"{self.form.file}: read back, the point deviates by {self.round_trip_um:.3f} um, more than {ROUND_TRIP_UM} um",
        )


def real_geometry(calibration: Calibration) -> TableGeometry:
    """Return the geometry of the table with the location errors of a calibration; `InputError` unless it has two rotary axes."""
    machine = calibration.machine
    errors = np.zeros(6 * len(machine.frames))
    for name, value in calibration.location.items():
        component, _, axis = split_name(name)
        frame = next(i for i, one in enumerate(machine.frames) if (one.axis, one.role) == (axis, "location"))
        errors[6 * frame + component] += 1e-6 * value
    return table_geometry(machine, errors)


def make_kinematics(
    calibration: Calibration,
    kind: str,
    tool_length_mm: float | None = None,
    notes: Sequence[str] = (),
    present: Path | None = None,
) -> ConstantKinematics:
    """Return the kinematics of a control for the location errors of a calibration, as a file and as read back.

    ``present``: file of the control with the parameters that it holds now; None for those of the machine file's geometry. `InputError`
    for an unknown format, a machine that the transformation cannot represent, no location errors, or present parameters whose geometry
    differs from the machine file's by more than `OTHER_POINTS_UM`.
    """
    machine, form = calibration.machine, kinematics_named(kind)
    nominal = form.nominal(machine) if present is None else form.values(present, machine)
    if not any(calibration.location.values()):
        raise InputError(
            "no location errors of rotary axes: the kinematics of the control need no correction",
            expected="a calibration with `location:`",
            file=calibration.path,
        )
    length = machine.tool_length_mm if tool_length_mm is None else tool_length_mm
    q, names = volume(machine), list(nominal)
    goal = linear_shift(machine, real_geometry(calibration), q, length)

    def shift(vector: np.ndarray) -> np.ndarray:
        geometry = form.geometry(dict(zip(names, vector.tolist(), strict=True)), machine)
        return linear_shift(machine, geometry, q, length)

    vector = np.array(list(nominal.values()))
    if present is not None and (apart := float(np.abs(shift(vector)).max())) > OTHER_POINTS_UM:
        raise InputError(
            "the present kinematics are those of another machine, or counted from other points than in the machine file",
            expected=f"the tool centre point within {OTHER_POINTS_UM / 1e3:g} mm of that of the machine file",
            file=present,
            value=f"{apart / 1e3:.3f} mm",
        )
    # The errors are small: the derivatives at the nominal machine serve all iterations.
    steps = STEP * np.eye(len(names))
    by = np.stack([(shift(vector + h) - shift(vector - h)).ravel() / (2.0 * STEP) for h in steps], axis=1)
    back_to = np.linalg.pinv(by, rcond=NEGLIGIBLE_SINGULAR_VALUE)
    for _ in range(ITERATIONS):
        vector = vector + back_to @ (goal - shift(vector)).ravel()
    values = dict(zip(names, vector.tolist(), strict=True))
    text = form.write(values, machine, notes)
    back = form.read_back(text, machine)
    read = linear_shift(machine, back, q, length)
    left, rounded = np.linalg.norm(goal - read, axis=1), np.linalg.norm(read - shift(vector), axis=1)
    displaced = np.linalg.norm(goal, axis=1)
    rms = [float(np.sqrt(np.mean(one**2))) for one in (displaced, left)]
    return ConstantKinematics(
        form,
        machine,
        text,
        back,
        rms[0],
        float(displaced.max()),
        rms[1],
        float(left.max()),
        float(rounded.max()),
        nominal,
        values,
        dict(zip(names, _uncertainties(calibration, q, length, back_to).tolist(), strict=True)),
    )


def _uncertainties(calibration: Calibration, q: np.ndarray, length_mm: float, back_to: np.ndarray) -> np.ndarray:
    """Return the standard uncertainties of a control's parameters from those of the location errors; NaN if these are unknown."""
    names = [name for name in calibration.location if name in calibration.covariance.names]
    if len(names) < len(calibration.location):
        return np.full(len(back_to), np.nan)

    def shift(name: str, by: float) -> np.ndarray:
        moved = {**calibration.location, name: calibration.location[name] + by}
        return linear_shift(calibration.machine, real_geometry(replace(calibration, location=moved)), q, length_mm)

    rates = np.stack([back_to @ (shift(name, 0.5) - shift(name, -0.5)).ravel() for name in names], axis=1)
    return np.sqrt(np.einsum("pi,ij,pj->p", rates, calibration.covariance.of(names).matrix, rates))


# --- Tables of one axis over another: which tables a format needs, and their values ---------------

TURNS: Final = (-TURN, 2.0 * TURN)
"""Range of a table over an unlimited rotary axis, degrees, in a format that does not wrap positions."""
LINEAR: Final = ("L-POS", "L-STR", "L-SQU", "L-ANG")
ROTARY: Final = ("R-POS",)
"""Classes that a table over an axis corrects."""
SOME_BEYOND: Final = 0.01
ALL_BEYOND: Final = 0.99
"""Limits of the share of an error that no linear axis can correct; products of two errors contribute about 0.001."""


@final
@dataclass(frozen=True)
class TableColumn:
    """Column of the tables over one axis."""

    moved: str  # the axis that is corrected
    side: Direction  # the direction of approach the column is for
    by: str | None = None  # axis of the lever the column is multiplied by; None without a product


@final
@dataclass(frozen=True)
class Planned:
    """One table or product to be written."""

    term: ControlTerm  # the table
    deviation: float  # largest deviation of the required correction from it, µm or µrad
    q: np.ndarray  # (n,) random positions at which the file read back is checked
    truth: np.ndarray  # (n,) required correction there


@final
class AxisTables(Design[TableSum]):
    """Tables of one axis over another, and products of two of them."""

    correction = TableSum

    def plan(self, required: RequiredCorrections, request: Request, old: TableSum | None) -> TablePlan[TableSum]:
        """See `Design.plan`. If there are more tables than the control has, those that correct least are left out."""
        form, machine, found = request.form, required.machine, list[Planned]()
        proof = ProofOfTables(required, keep_all=request.unproven)
        for axis in machine.axes:
            columns = _columns(required, form, axis, request)
            if not columns:
                continue
            truth = _required_values(required, axis, columns)
            kept = None if old is None else _nodes_of_old_tables(old, axis)
            if kept is None:
                low, high = TURNS if axis.lower is None and not form.wraps else required.range_of(axis)
                limits = [tolerance_of(machine.by_name[column.moved], request.tolerance_um) for column in columns]
                nodes = choose_nodes(truth, low, high, np.array(limits), step=request.step, most=form.points)
            else:
                nodes = nodes_at(truth, np.array(kept))
            planned = _planned(required, axis, columns, nodes, truth, period_of(axis) if form.wraps else None)
            factors = _factors(required, axis, columns, planned[0].q[::U_EVERY])
            for k, one in enumerate(planned):
                (content,) = TableSum((one.term,), machine).contents()
                if proof.keeps(content, [axis.name], LINEAR if axis.linear else ROTARY, one.truth, factors[:, k]):
                    found.append(one)
        most = None if form.tables is None else request.most or form.tables
        within, left_out = _strongest(found, most)

        def compared(back: TableSum) -> tuple[Table, ...]:
            return tuple(
                _table(one, content, back, required, request) for one, content in zip(within, contents, strict=True)
            )

        correction = TableSum(tuple(one.term for one in within), machine)
        contents = correction.contents()
        return TablePlan(correction, compared, left_out, tuple(proof.unproven))

    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """See `Design.share`."""
        form, iso_class = request.form, required.class_of(effect)
        if not required.machine.by_name[effect.frame.axis].linear:
            if iso_class != "R-POS":
                return "no", "the direction of its effect turns with the rotary axes"
            return share_depending_on(others)
        if not form.across and iso_class in ("L-STR", "L-SQU"):
            return "no", "needs a table that corrects another axis: the format has none"
        beyond = required.uncorrectable_share(effect)
        if beyond > ALL_BEYOND:
            return "no", "no linear axis moves the point in its direction"
        if beyond > SOME_BEYOND:
            return "line", f"no linear axis moves the point in the direction of {100.0 * beyond:.0f} % of it"
        if iso_class != "L-ANG" or others or (form.products and request.products):
            return share_depending_on(others)
        if not form.across:
            return "line", "only along its own axis, and exact only with the other axes at their reference positions"
        return "line", "exact only with the other axes at their reference positions"


def _columns(required: RequiredCorrections, form: TableFormat[Any], axis: Axis, request: Request) -> list[TableColumn]:
    """Return the columns over one axis whose largest value matters: per corrected axis and direction, then the products."""
    machine = required.machine
    tolerance = tolerance_of(axis, request.tolerance_um)
    dense = np.round(np.linspace(*required.range_of(axis), 501) / RESOLUTION) * RESOLUTION
    if not axis.linear:
        turns = {side: required.rotary_correction(axis, dense, side) for side in (UP, DOWN, BOTH)}
        split = form.directions and np.abs(turns[UP] - turns[DOWN]).max() > NEGLIGIBLE_SHARE * tolerance
        used = (UP, DOWN) if split else (BOTH,)
        worth = max(np.abs(turns[side]).max() for side in used) > NEGLIGIBLE_SHARE * tolerance
        return [TableColumn(axis.name, side) for side in used] if worth else []
    linear = [machine.axes[i].name for i in machine.linear]
    sides = (UP, DOWN) if form.directions else (BOTH, BOTH)
    up, down = (
        required.linear_corrections((axis.name,), required.positions_along(axis, dense), side) for side in sides
    )
    columns: list[TableColumn] = []
    for k, moved in enumerate(linear):
        if not form.across and moved != axis.name:
            continue
        if max(np.abs(up[:, k]).max(), np.abs(down[:, k]).max()) <= NEGLIGIBLE_SHARE * tolerance:
            continue
        can = form.crossed_directions or moved == axis.name
        directed = can and np.abs(up[:, k] - down[:, k]).max() > NEGLIGIBLE_SHARE * tolerance
        columns += [TableColumn(moved, side) for side in ((UP, DOWN) if directed else (BOTH,))]
    for by in linear if form.products and request.products else ():
        if by != axis.name:
            peaks = np.abs(_slope(required, axis, by, dense)).max(axis=0)
            columns += [
                TableColumn(moved, BOTH, by)
                for moved, peak in zip(linear, peaks, strict=True)
                if peak > 0.5 * tolerance
            ]
    return columns


def _required_values(
    required: RequiredCorrections, axis: Axis, columns: Sequence[TableColumn]
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of the required values of the columns over one axis: (n,) positions → (n, columns) µm or µrad."""
    linear = [required.machine.axes[i].name for i in required.machine.linear]

    def truth(q: np.ndarray) -> np.ndarray:
        if not axis.linear:
            return np.stack([required.rotary_correction(axis, q, column.side) for column in columns], axis=1)
        line, found = required.positions_along(axis, q), {}
        for side, by in {(column.side, column.by) for column in columns}:
            found[side, by] = (
                required.linear_corrections((axis.name,), line, side) if by is None else _slope(required, axis, by, q)
            )
        return np.stack([found[column.side, column.by][:, linear.index(column.moved)] for column in columns], axis=1)

    return truth


def _factors(required: RequiredCorrections, axis: Axis, columns: Sequence[TableColumn], q: np.ndarray) -> np.ndarray:
    """Return the factors (n, columns, r) of the covariance of the required values of the columns, as `_required_values`."""
    if not axis.linear:
        return np.stack([required.rotary_factors(axis, q, column.side) for column in columns], axis=1)
    linear, line = [required.machine.axes[i].name for i in required.machine.linear], required.positions_along(axis, q)
    factors: dict[tuple[Direction, str | None], np.ndarray] = {}
    for side, by in {(column.side, column.by) for column in columns}:
        if by is None:
            factors[side, by] = required.linear_factors((axis.name,), line, side)
        else:
            ends = [
                required.linear_factors((axis.name,), required.positions_along(axis, q, {by: end}))
                for end in required.range_of(required.machine.by_name[by])
            ]
            factors[side, by] = 0.5 * (ends[1] - ends[0])
    return np.stack([factors[column.side, column.by][:, linear.index(column.moved)] for column in columns], axis=1)


def _slope(required: RequiredCorrections, axis: Axis, by: str, q: np.ndarray) -> np.ndarray:
    """Return the change (n, linear axes) in µm of the correction when axis ``by`` moves by half its range."""
    low, high = required.range_of(required.machine.by_name[by])
    ends = [
        required.linear_corrections((axis.name,), required.positions_along(axis, q, {by: end})) for end in (low, high)
    ]
    return np.asarray(0.5 * (ends[1] - ends[0]))


def _planned(
    required: RequiredCorrections,
    axis: Axis,
    columns: Sequence[TableColumn],
    nodes: Nodes,
    truth: Callable[[np.ndarray], np.ndarray],
    period: float | None,
) -> list[Planned]:
    """Return the tables over one axis on the nodes, with the required values at the random positions."""
    where = tuple(nodes.at.tolist())
    q = check_positions(where[0], where[-1])
    meant = truth(q)
    planned = []
    for k, one in enumerate(columns):
        factors = [ControlCurve(axis.name, where, tuple(nodes.values[:, k].tolist()), period, one.side)]
        if one.by is not None:
            low, high = required.range_of(required.machine.by_name[one.by])
            half, middle = 0.5 * (high - low), required.at[one.by]
            factors.append(ControlCurve(one.by, (low, high), ((low - middle) / half, (high - middle) / half)))
        reach = factors[1].peak if one.by is not None else 1.0
        planned.append(
            Planned(ControlTerm(one.moved, tuple(factors)), float(nodes.deviation[k]) * reach, q, meant[:, k])
        )
    return planned


def _strongest(found: Sequence[Planned], most: int | None) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """Return at most ``most`` tables, those with the largest correction per table, and the names of those left out."""
    order = sorted(range(len(found)), key=lambda i: -found[i].term.peak / len(found[i].term.factors))
    kept: set[int] = set()
    used = 0
    for i in order:
        need = len(found[i].term.factors)
        if most is None or used + need <= most:
            kept.add(i)
            used += need
    left_out = tuple(f"{one.term.name}: {one.term.peak:.1f}" for i, one in enumerate(found) if i not in kept)
    return tuple(one for i, one in enumerate(found) if i in kept), left_out


def _table(
    one: Planned, content: TableSummary, back: TableSum, required: RequiredCorrections, request: Request
) -> Table:
    """Return one table compared with the file read back; a product at the position where its lever is longest."""
    moved, factors = required.machine.by_name[one.term.axis], one.term.factors
    same = next(term for term in back.terms if term.key == one.term.key)
    rounding, scale = request.form.rounding[0 if moved.linear else 1], 1.0
    truth, said = one.truth, same.factors[0].along(one.q)
    for factor, read in zip(factors[1:], same.factors[1:], strict=True):
        end, scale = factor.at[int(np.argmax(np.abs(factor.values)))], factor.peak
        truth, said = truth * factor.along(end), said * read.along(end)
        rounding = rounding * scale + one.term.peak * 1e-9
    tolerance = tolerance_of(moved, request.tolerance_um) * scale
    return Table(content, one.deviation, rounding, tolerance, float(np.abs(truth - said).max()))


def _nodes_of_old_tables(old: TableSum, axis: Axis) -> tuple[float, ...] | None:
    """Return the nodes of the old tables over an axis; None if there are none."""
    curves = [term.factors[0] for term in old.terms if term.factors[0].argument == axis.name]
    if not curves:
        return None
    if any(curve.at != curves[0].at for curve in curves):
        raise InputError(
            f"the old tables over {axis.name}, to which new ones are added, have different nodes",
            expected="the same nodes in all tables over one axis",
            value=[f"{len(curve.at)} points" for curve in curves],
        )
    return curves[0].at


# --- Component errors of every axis, for a control that has a kinematic model of the machine ------


@final
class ComponentErrors(Design[VolumetricCorrection]):
    """Compute the component errors in the error frame of every axis, location errors and squareness included."""

    correction = VolumetricCorrection

    def plan(
        self, required: RequiredCorrections, request: Request, old: VolumetricCorrection | None
    ) -> TablePlan[VolumetricCorrection]:
        """See `Design.plan`."""
        form, planned = request.form, list[tuple[AxisErrors, Nodes, np.ndarray, np.ndarray]]()
        limit = request.tolerance_um * np.array([1.0] * 3 + [URAD_PER_UM] * 3)
        proof = ProofOfTables(required, keep_all=request.unproven)
        before = {} if old is None else {error.axis: next(iter(error.curves.values())).at for error in old.errors}
        for axis in required.machine.axes:
            truth = _component_required_values(required, axis)
            low, high = required.range_of(axis)
            peaks = np.abs(truth(np.linspace(low, high, 501))).max(axis=0)
            used = [i for i in range(6) if peaks[i] > NEGLIGIBLE_SHARE * limit[i]]
            if not used:
                continue
            if axis.name in before:
                nodes = nodes_at(truth, np.array(before[axis.name]))
            else:
                nodes = choose_nodes(truth, low, high, limit, step=request.step, most=form.points)
            where, period = tuple(nodes.at.tolist()), period_of(axis)
            q = check_positions(where[0], where[-1])
            values, factors = truth(q), _component_factors(required, axis, q[::U_EVERY])
            contents = [
                TableSummary.over(name, where, 0.0, "um" if i < 3 else "urad")
                for i, name in enumerate(component_names(axis.name))
            ]
            used = [i for i in used if proof.keeps(contents[i], [axis.name], BASIC, values[:, i], factors[:, i])]
            if not used:
                continue
            curves = {i: ControlCurve(axis.name, where, tuple(nodes.values[:, i].tolist()), period) for i in used}
            planned.append((AxisErrors(axis.name, curves), nodes, q, values))
        correction = VolumetricCorrection(tuple(one[0] for one in planned), required.machine, required.tool_length_mm)

        def compared(back: VolumetricCorrection) -> tuple[Table, ...]:
            contents, read = iter(correction.contents()), {error.axis: error.curves for error in back.errors}
            found = []
            for own, nodes, q, meant in planned:
                for i in own.curves:
                    off, back_off = (
                        float(nodes.deviation[i]),
                        float(np.abs(meant[:, i] - read[own.axis][i].along(q)).max()),
                    )
                    found.append(Table(next(contents), off, form.rounding[i // 3], float(limit[i]), back_off))
            return tuple(found)

        return TablePlan(correction, compared, unproven=tuple(proof.unproven))

    def share(
        self, required: RequiredCorrections, effect: Effect, others: Sequence[Axis], request: Request
    ) -> tuple[Share, str]:
        """See `Design.share`."""
        return share_depending_on(others)


def _component_required_values(required: RequiredCorrections, axis: Axis) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function of an axis's component errors at the control's reference point: (n,) positions → (n, 6) µm and µrad."""
    rest = rest_geometry(required.machine)
    turn, lever = rest.turns[axis.name], rest.centre(axis) - rest.places[axis.name]

    def truth(q: np.ndarray) -> np.ndarray:
        own = required.frame_errors(axis, q)
        shift, spin = own[:, :3] @ turn.T, own[:, 3:] @ turn.T
        # µrad times mm is nm.
        return np.concatenate([shift + 1e-3 * np.cross(spin, lever), spin], axis=1)

    return truth


def _component_factors(required: RequiredCorrections, axis: Axis, q: np.ndarray) -> np.ndarray:
    """Return the factor (n, 6, r) of the covariance of the component errors of `_required_values`."""
    rest = rest_geometry(required.machine)
    turn, lever = rest.turns[axis.name], rest.centre(axis) - rest.places[axis.name]
    own = required.frame_error_factors(axis, q)
    shift, spin = (np.einsum("ij,njr->nir", turn, part) for part in (own[:, :3], own[:, 3:]))
    # µrad times mm is nm.
    across = 1e-3 * np.cross(spin.transpose(0, 2, 1), lever).transpose(0, 2, 1)
    return np.concatenate([shift + across, spin], axis=1)
