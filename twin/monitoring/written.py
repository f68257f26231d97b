"""Values written into a machine, read back from its files; their effect on readings, linearised; hypotheses on them, weighed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.units import UM, URAD
from twin.controls.correction import AxisErrors, TableSum, VolumetricCorrection
from twin.controls.kinematics.format import KinematicCorrection, linear_shift, table_geometry
from twin.identification.inputs import PreparedData, prepare
from twin.identification.network import Network, Unknowns
from twin.machine.machine import Machine
from twin.measurement.agreement import fit_of
from twin.measurement.observation import machine_state
from twin.measurement.set_up import StationsAndTargets
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects import split_name
from twin.model.effects.base import along
from twin.model.unknown_errors import prior_covariance, unknown_effects
from twin.numerics.covariance import symmetric_root
from twin.tool.forward import Kinematics
from twin.tool.inverse import Inverse
from twin.tool.uncertainty import volume

POSES: Final = 300
SEED: Final = 51
SINGULAR: Final = 1e-9
"""Relative singular value below which a combination of the set-up moves nothing."""
REST_UM: Final = 1.0
"""Effect of the kinematics, RMS, that no location error accounts for and that counts as a value of its own."""
LEAST_UM: Final = 0.05
"""Effect of a location, RMS, below which it counts as not written: rounding."""
LEAST_EFFECT_UM: Final = 1.0
LEAST_SHARE: Final = 0.05
"""Effect at the tool, RMS over the volume, from which a written value matters: in µm, and as a share of the whole effect."""
FACTORS: Final = (0.0, -1.0, 2.0, 10.0, 0.1, 1000.0)
"""Factors tested in place of 1: absent, reversed, twice, wrong units."""
GROSS: Final = 1000.0
"""Factor of a wrong unit with which readings hardly follow the commands."""
FALSE_ALARMS: Final = 0.04
"""Rate of false alarms of all hypotheses together."""
ODDS: Final = 20.0
"""Likelihood ratio above which one hypothesis excludes another."""
MOST_MOVES: Final = 6
Shift = Callable[[Mapping[str, np.ndarray]], np.ndarray]
"""Function from positions and directions by name, (n,) each, to the shift (n, axes) of the commands in metres and radians."""


@final
@dataclass(frozen=True)
class WrittenValue:
    """One value, or table, that was put into the machine.

    Attributes:
        name: ``table Y by X``, ``kinematics E_A0B``, ``program's words of X``, ``E_C0Y adjusted``.
        groups: names of the groups of values that are likely wrong together.
        shift: shift of the commands while it is in effect.
        constant: name and change (µm, µrad) of an adjusted error, in place of a shift.
    """

    name: str
    groups: tuple[str, ...]
    shift: Shift | None = None
    constant: tuple[str, float] | None = None


# --- What was written, read back ------------------------------------------------------------------


def written_values(
    machine: Machine,
    calibration: Calibration | None = None,
    *,
    folder: str | Path | None = None,
    adjusted: Mapping[str, float] = MappingProxyType({}),
    compensated: bool = False,
    tool_length_mm: float | None = None,
) -> tuple[Calibration | None, tuple[WrittenValue, ...]]:
    """Return the errors of the machine before, and what was put into it: arguments of `twin.confirm` and `twin.plan_confirmation`.

    Args:
        machine: the machine.
        calibration: its errors before; None: those in the folder.
        folder: folder that `twin control` wrote.
        adjusted: new value of each squareness or location that was adjusted, µrad or µm.
        compensated: whether a program compensated with the calibration was run.
        tool_length_mm: length of the active tool; None: that of the folder's tables, else that of the machine file.

    Raises:
        InputError: no calibration where one is needed; an invalid folder; an error that cannot be adjusted.

    Examples:
        >>> machine = twin.Machine.load("dmu50")
        >>> _, values = twin.written_values(machine, twin.Calibration.default(machine), compensated=True)
        >>> [value.name for value in values][:2]
        ["program's words of X", "program's words of Y"]
    """
    written = None if folder is None else Calibration.load(Path(folder) / "calibration.yaml", machine)
    length = active_tool_mm(machine, written, tool_length_mm)
    errors = written if calibration is None else calibration
    values = () if written is None else written_by(written, length)
    if written is not None and errors is not None:
        if errors.control is not None and errors.control.errors_are == "remaining":
            raise InputError(
                "the errors of this calibration were measured under other tables",
                expected="errors of the machine without tables",
                file=errors.path,
                value="errors_are: remaining",
            )
        errors = replace(errors.with_control(None), path=errors.path)
    if compensated:
        if errors is None:
            raise InputError("no calibration", expected="the calibration that the program was compensated with")
        values = (*values, *program_words(errors, length))
    return errors, (*values, *(adjustment(errors, machine, name, to) for name, to in adjusted.items()))


def active_tool_mm(machine: Machine, written: Calibration | None, given_mm: float | None) -> float:
    """Return the tool length: that given, else that for which the control's tables were made, else that of the machine file."""
    stated = None if written is None or written.control is None else written.control.tool_length_mm
    return next(length for length in (given_mm, stated, machine.tool_length_mm) if length is not None)


def written_by(calibration: Calibration, tool_length_mm: float) -> tuple[WrittenValue, ...]:
    """Return what `twin control` wrote beside a calibration: tables and kinematics, or the correction of a kinematics module.

    Args:
        calibration: the calibration of the folder, with its `control:` section; its files are read.
        tool_length_mm: length of the active tool.

    Raises:
        InputError: no `control:` section, errors measured with the tables active, or a file that is not the one recorded.
    """
    control, machine = calibration.control, calibration.machine
    if control is None or control.errors_are != "uncorrected":
        raise InputError(
            "the calibration does not say what was written into the control",
            expected="calibration.yaml of the folder that `twin control` wrote, with `errors_are: uncorrected`",
            file=calibration.path,
            value="no control section" if control is None else "errors_are: remaining",
        )
    if control.live:
        return program_words(calibration.with_control(None), tool_length_mm, "module's correction of")
    values: list[WrittenValue] = []
    acting = calibration.with_transformation().with_tool(tool_length_mm).corrections
    for correction in {one.kind: one.correction for one in acting}.values():
        if isinstance(correction, KinematicCorrection):
            values += _locations(machine, correction)
        elif isinstance(correction, TableSum):
            for term in correction.terms:
                groups = (f"all tables that move {term.axis}", f"all tables over {term.factors[0].argument}")
                values.append(WrittenValue(f"table {term.name}", groups, _moved_by(machine, {term.axis: term})))
        elif isinstance(correction, VolumetricCorrection):
            for own in correction.errors:
                for i, curve in own.curves.items():
                    part = replace(correction, errors=(AxisErrors(own.axis, {i: curve}),))
                    name = f"component E_{'XYZABC'[i]}{own.axis}"
                    values.append(WrittenValue(name, (f"all components of {own.axis}",), _shift_of(machine, part)))
        else:
            values += [
                WrittenValue(f"correction of {axis}", (), _shift_of(machine, correction, (axis,)))
                for axis in correction.axes
            ]
    return _unique(values)


def _unique(values: Sequence[WrittenValue]) -> tuple[WrittenValue, ...]:
    """Return the values with the second and further ones of a name numbered."""
    names = [value.name for value in values]
    return tuple(
        value
        if names.index(value.name) == i
        else replace(value, name=f"{value.name} ({names[:i].count(value.name) + 1})")
        for i, value in enumerate(values)
    )


def _moved_by(machine: Machine, values: Mapping[str, Callable[[Mapping[str, Any]], Any]]) -> Shift:
    """Return the shift by functions of µm or µrad, by axis."""

    def shift(state: Mapping[str, np.ndarray]) -> np.ndarray:
        found = np.zeros((len(state[machine.names[0]]), len(machine.axes)))
        for i, axis in enumerate(machine.axes):
            if axis.name in values:
                found[:, i] = np.asarray(values[axis.name](state)) * (UM if axis.linear else URAD)
        return found

    return shift


def _shift_of(machine: Machine, correction: Any, axes: Sequence[str] | None = None) -> Shift:
    names = correction.axes if axes is None else axes
    return _moved_by(
        machine,
        {name: lambda state, name=name: correction.shift(name, state) for name in names},  # type: ignore[misc]
    )


def _locations(machine: Machine, correction: KinematicCorrection) -> list[WrittenValue]:
    """Return the location errors that the control's kinematics hold, as read back, one value each; and the rest, if there is any."""
    length, q = correction.tool_length_mm, volume(machine, POSES, SEED)
    frames = {(frame.axis, frame.role): i for i, frame in enumerate(machine.frames)}

    def geometry_of(name: str, size: float) -> Any:
        component, _, axis = split_name(name)
        errors = np.zeros(6 * len(machine.frames))
        errors[6 * frames[axis, "location"] + component] = size * UM
        return table_geometry(machine, errors)

    names = machine.location_names
    rates = np.stack([linear_shift(machine, geometry_of(name, 1.0), q, length).ravel() for name in names], axis=1)
    held = linear_shift(machine, correction.geometry, q, length).ravel()
    # Locations that move the point alike share their value by least squares, with equal plausible sizes.
    sizes = np.linalg.pinv(rates, rcond=1e-6) @ held
    values = []
    for name, size in zip(names, sizes.tolist(), strict=True):
        linear = [machine.names[i] for i in machine.linear]
        geometry = geometry_of(name, size)
        if np.sqrt(np.mean(linear_shift(machine, geometry, q, length) ** 2)) < LEAST_UM:
            continue
        part = KinematicCorrection(machine, geometry, length)
        values.append(
            WrittenValue(
                f"kinematics {name}", (f"the location of {split_name(name)[2]}",), _shift_of(machine, part, linear)
            )
        )
    left = float(np.sqrt(np.mean((held - rates @ sizes) ** 2)))
    if left > REST_UM:
        whole = _shift_of(machine, correction)
        parts = [value.shift for value in values if value.shift is not None]
        values.append(
            WrittenValue("rest of the kinematics", (), lambda state: whole(state) - sum(part(state) for part in parts))
        )
    return values


def program_words(
    calibration: Calibration, tool_length_mm: float, what: str = "program's words of"
) -> tuple[WrittenValue, ...]:
    """Return the corrections that a compensated program makes, one value for the words of each axis.

    Args:
        calibration: the calibration that the program was compensated with.
        tool_length_mm: length of the active tool.
        what: begins the name of each value.
    """
    machine = calibration.machine
    real = Kinematics(machine, calibration, tool_length_mm=tool_length_mm)
    nominal = Kinematics(machine, Calibration.zero(machine), tool_length_mm=tool_length_mm)
    inverse = Inverse(real)

    def shift(state: Mapping[str, np.ndarray]) -> np.ndarray:
        q = np.stack([state[name] for name in machine.names], axis=1)
        sides = [state.get(f"approach_{name}") for name in machine.names]
        approach = (
            np.stack([np.zeros(len(q)) if side is None else side for side in sides], axis=1) if real.directed else None
        )
        return (inverse.solve(nominal.forward(q), q, approach=approach).positions - q) * machine.scale

    def of(i: int) -> Shift:
        return lambda state: shift(state) * (np.arange(len(machine.axes)) == i)

    kinds = ["the linear axes' words" if axis.linear else "the rotary axes' words" for axis in machine.axes]
    return tuple(
        WrittenValue(f"{what} {axis.name}", (kind,), of(i))
        for i, (axis, kind) in enumerate(zip(machine.axes, kinds, strict=True))
    )


def adjustment(calibration: Calibration | None, machine: Machine, name: str, to: float) -> WrittenValue:
    """Return the adjustment of a squareness or location to a value, µm or µrad.

    Raises:
        InputError: no calibration, or no such error of the machine.
    """
    names = (*machine.squareness_names, *machine.location_names)
    if name not in names or calibration is None:
        raise InputError(
            "no such squareness or location" if calibration is not None else "an adjustment needs a calibration",
            expected=f"one of {', '.join(names)}"
            if calibration is not None
            else "the calibration before the adjustment",
            value=name,
        )
    now = {**calibration.squareness, **calibration.location}.get(name, 0.0)
    return WrittenValue(f"{name} adjusted", (), constant=(name, to - now))


# --- The linear model -----------------------------------------------------------------------------


@final
@dataclass(frozen=True, eq=False)
class LinearReadings:
    """One table of readings, linearised at the calibration; whitened, with the set-up projected out.

    Attributes:
        residual: (3n,) measured less predicted by the errors of the calibration, nothing written in effect.
        written: (3n, k) by the factor of each written value.
        elsewhere: (3n, k·axes) by the values of each on another axis of its kind; zero for its own.
        constants: (3n, c) by each constant error, in plausible sizes.
        errors: (3n, e) by the errors of the machine, in standard deviations of the prior.
        rank: degrees of freedom of the readings, those of the set-up taken off.
    """

    residual: np.ndarray
    written: np.ndarray
    elsewhere: np.ndarray
    constants: np.ndarray
    errors: np.ndarray
    rank: int


def linear_readings(
    network: Network,
    setup: StationsAndTargets,
    calibration: Calibration,
    written: Sequence[WrittenValue],
    prior: Unknowns | None,
) -> LinearReadings:
    """Return the linear model of a table.

    Args:
        network: readings, with the constant errors as unknowns and the calibration as base.
        setup: stations and targets, fitted or as planned.
        calibration: errors of the machine and their covariance, without corrections.
        written: what was put into the machine.
        prior: unknown errors that take the place of the calibration's covariance; None with one.
    """
    machine, data = network.machine, network.data
    view = network.view(np.zeros(len(network.unknowns)), setup, np.arange(len(data)))
    effects = effects_on(
        view.by_error, machine, calibration, written, network.unknowns, prior, machine_state(data, machine)
    )
    by_setup = np.zeros((len(data), 3, len(setup)))
    network.fill_setup_columns(view, setup, by_setup)
    left, size, _ = np.linalg.svd(by_setup.reshape(3 * len(data), len(setup)) * setup.plausible, full_matrices=False)
    basis = left[:, size > SINGULAR * size.max(initial=1e-300)]

    def projected(columns: np.ndarray) -> np.ndarray:
        return np.asarray(columns - basis @ (basis.T @ columns))

    rank = int(np.count_nonzero(network.read)) - basis.shape[1]
    own, elsewhere, constants, errors = map(projected, effects)
    return LinearReadings(projected(view.residual.reshape(-1)), own, elsewhere, constants, errors, rank)


def effects_on(
    by_error: np.ndarray,
    machine: Machine,
    calibration: Calibration,
    written: Sequence[WrittenValue],
    unknowns: Unknowns,
    prior: Unknowns | None,
    state: Mapping[str, np.ndarray],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return what the written values, they on other axes, constants and the machine's errors do to points: (3n, columns) each.

    Args:
        by_error: (n, 3, 6·frames) derivative of the points by every component of every error frame, per metre and radian.
        state: positions and channels by name, (n,) each.
    """
    by_axis = np.stack([_by_axis(by_error, machine, i) for i in range(len(machine.axes))], axis=2)
    by_constant = _by_unknowns(by_error, unknowns, machine, state) * unknowns.plausible
    names = [column.entity for column in unknowns.columns]
    own, elsewhere = [np.zeros((3 * len(by_error), 0))], [np.zeros((3 * len(by_error), 0))]
    for value in written:
        if value.shift is not None:
            shift = value.shift(state)
            own.append(np.einsum("nia,na->ni", by_axis, shift).reshape(-1, 1))
            elsewhere.append(_on_other_axes(machine, by_axis, shift))
            continue
        name, size = value.constant or ("", 0.0)
        k = names.index(name) if name in names else 0
        own.append(by_constant[:, k, None] * (size / unknowns.plausible[k] if name in names else 0.0))
        elsewhere.append(np.zeros((3 * len(by_error), len(machine.axes))))
    by_errors = (
        _by_calibration(by_error, calibration, state)
        if prior is None
        else _by_unknowns(by_error, prior, machine, state) * _sizes(prior)
    )
    return np.concatenate(own, axis=1), np.concatenate(elsewhere, axis=1), by_constant, by_errors


def _by_axis(by_error: np.ndarray, machine: Machine, i: int) -> np.ndarray:
    """Return (n, 3) the derivative by a motion of one axis along its command, per metre or radian."""
    at = next(6 * k for k, one in enumerate(machine.frames) if (one.axis, one.role) == (machine.axes[i].name, "motion"))
    return np.asarray(sum(part * by_error[:, :, at + c] for c, part in along(machine.axes[i], 1.0).items()))


def _on_other_axes(machine: Machine, by_axis: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Return (3n, axes) the effect of the values of the axis that a shift moves, on each other axis of its kind."""
    found = np.zeros((len(shift), 3, len(machine.axes)))
    moved = np.flatnonzero(np.any(shift != 0.0, axis=0))
    if len(moved) == 1:
        for j, axis in enumerate(machine.axes):
            if j != moved[0] and axis.linear is machine.axes[moved[0]].linear:
                found[:, :, j] = by_axis[:, :, j] * shift[:, moved[0], None]
    return found.reshape(-1, len(machine.axes))


def _by_unknowns(
    by_error: np.ndarray, unknowns: Unknowns, machine: Machine, state: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Return (3n, columns) the derivatives by the machine's unknowns, per µm and µrad."""
    found = np.zeros((len(unknowns), len(by_error), 3))
    for column, shapes in zip(
        found, unknowns.shapes(np.stack([state[name] for name in machine.names], axis=1)), strict=True
    ):
        for at, values in shapes:
            column += by_error[:, :, at] * values[:, None]
    return found.reshape(len(unknowns), 3 * len(by_error)).T


def _by_calibration(by_error: np.ndarray, calibration: Calibration, state: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return (3n, parameters) the derivatives by the calibration's errors, times the root of their covariance."""
    index = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(calibration.machine.frames)}
    found = []
    for covariance, effects in (
        (calibration.covariance, calibration.effects),
        (prior_covariance(calibration), unknown_effects(calibration)),
    ):
        columns = np.zeros((len(covariance.names), len(by_error), 3))
        number = {name: k for k, name in enumerate(covariance.names)}
        for effect in effects:
            at = index[effect.frame.axis, effect.frame.role]
            if not number.keys() & {parameter.name for parameter in effect.parameters}:
                continue
            for parameter, rates in zip(effect.parameters, effect.derivatives(state), strict=True):
                for c, rate in rates.items() if parameter.name in number else ():
                    unit = UM if c < 3 else URAD
                    columns[number[parameter.name]] += by_error[:, :, at + c] * (unit * np.reshape(rate, (-1, 1)))
        found.append(columns.reshape(len(columns), 3 * len(by_error)).T @ symmetric_root(covariance.matrix))
    return np.concatenate(found, axis=1)


def _sizes(unknowns: Unknowns) -> np.ndarray:
    """Return the prior standard deviations of unknown errors: the functions of a curve share its plausible size."""
    entities = [column.entity for column in unknowns.columns]
    return np.asarray(unknowns.plausible / np.sqrt([entities.count(name) for name in entities]))


def mattering(effects: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the RMS (k,) of the effects of written values on points (n, 3, k), µm, and whether each matters."""
    rms, whole = rms_length(effects), float(rms_length(effects.sum(axis=2, keepdims=True))[0])
    return rms, rms >= max(LEAST_EFFECT_UM, LEAST_SHARE * whole)


def rms_length(points: np.ndarray) -> np.ndarray:
    """Return (m,) the RMS length of points (n, 3, m)."""
    return np.asarray(np.sqrt(np.mean(np.sum(points**2, axis=1), axis=0)))


def prepared(machine: Machine, table: Measurements, written: Sequence[WrittenValue]) -> PreparedData:
    """Return rows, instruments and initial set-up of a table; see `twin.identification.inputs.prepare`.

    Raises:
        InputError: the readings do not follow the commands; with the written values that explain it if they act in a wrong unit.
    """
    try:
        return prepare(machine, table, None)
    except InputError as error:
        agreeing: list[tuple[float, str, float]] = []
        for name, some in groups_of(written).items():
            shifts = [value.shift for value in (written[k] for k in some) if value.shift is not None]
            moved = sum((shift(machine_state(table, machine)) for shift in shifts), np.zeros(table.positions.shape))
            for factor in (GROSS, -GROSS):
                there = replace(table, positions=read_only(table.positions + factor * moved / machine.scale))
                try:
                    placed = prepare(machine, there, None)
                except InputError:
                    continue
                miss = fit_of(machine, placed.data, placed.instruments).miss
                agreeing.append((float(np.sqrt(np.mean(miss**2))), name, factor))
        if not agreeing:
            raise
        _, name, factor = min(agreeing)
        raise InputError(
            f"commands and readings disagree, but agree if {name} is in effect with {factor:g} times the values: wrong unit",
            expected="the values in the unit of the control; switch them off",
            file=error.file,
            line=error.line,
            value=error.value,
        ) from None


# --- Hypotheses, weighed by their likelihood ------------------------------------------------------


@final
@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis: factor of each written value that is not 1, axis of each on a wrong axis, and what is free: constants and factors.

    ``free`` has the index of a constant error (≥ 0), or of a group of written values (−1 − index).
    """

    factors: tuple[tuple[int, float], ...] = ()
    axes: tuple[tuple[int, int], ...] = ()
    free: tuple[int, ...] = ()

    def kinds(self, count: int) -> int:
        """Return the number of different factors among ``count`` written values."""
        axes = dict(self.axes)
        return len({(factor, axes.get(k)) for k, factor in self.factors}) + (len(self.factors) < count)

    def with_factor(self, some: Sequence[int], factor: float, axis: int | None = None) -> Hypothesis:
        """Return the state with a factor of some values, or with them on another axis."""
        factors = {k: v for k, v in self.factors if k not in some} | (
            dict.fromkeys(some, factor) if factor != 1.0 else {}
        )
        axes = {k: v for k, v in self.axes if k not in some} | ({} if axis is None else dict.fromkeys(some, axis))
        return replace(self, factors=tuple(sorted(factors.items())), axes=tuple(sorted(axes.items())))


@final
class Weigher:
    """Likelihoods of hypotheses, with the machine's errors and the set-up integrated out.

    Args:
        after: readings with the written values in effect.
        before: readings without them; None without.
        dependent: whether the prior may come from the readings before.
        variance: factor on the stated variance of the readings.
    """

    def __init__(
        self, after: LinearReadings, before: LinearReadings | None, *, dependent: bool, variance: float = 1.0
    ) -> None:
        self.count, self.constants = after.written.shape[1], after.constants.shape[1]
        self.axes = after.elsewhere.shape[1] // max(self.count, 1)
        scale, wider = 1.0 / np.sqrt(variance), np.sqrt(2.0) if dependent else 1.0
        deviation = (after.residual - after.written.sum(axis=1))[:, None]
        columns = scale * np.concatenate([after.written, after.elsewhere, after.constants, deviation], axis=1)
        by_errors = [scale * wider * after.errors]
        along_errors = by_errors[0].T @ columns
        gram = columns.T @ columns
        self.rank = after.rank
        if before is not None:
            by_errors.append(scale * before.errors)
            residual = scale / wider * before.residual
            along_errors[:, -1] += by_errors[1].T @ residual
            gram[-1, -1] += residual @ residual
            self.rank += before.rank
        self.precision = np.eye(after.errors.shape[1]) + sum(own.T @ own for own in by_errors)
        self.along, self.wider = along_errors, wider
        gram = gram - along_errors.T @ np.linalg.solve(self.precision, along_errors)
        self.normal, self.slope, self.chi2 = gram[:-1, :-1], gram[:-1, -1], float(gram[-1, -1])

    def column(self, free: int, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """Return the coefficients of a free constant, or of a free common factor of a group."""
        found = np.zeros(len(self.slope))
        if free >= 0:
            found[-self.constants + free] = 1.0
        else:
            found[list(groups[-1 - free])] = 1.0
        return found

    def free(self, state: Hypothesis, groups: Sequence[Sequence[int]]) -> np.ndarray:
        """Return the coefficients (columns, f) of the free columns of a state."""
        columns = [self.column(one, groups) for one in state.free]
        return np.stack(columns, axis=1) if columns else np.zeros((len(self.slope), 0))

    def fit(self, state: Hypothesis, groups: Sequence[Sequence[int]]) -> tuple[float, float, np.ndarray, np.ndarray]:
        """Return the log likelihood ratio against everything in effect, χ², and estimate and covariance of the free ones (prior 1)."""
        x = self.fixed(state)
        y = self.slope - self.normal @ x
        ratio = float(x @ self.slope - 0.5 * x @ self.normal @ x)
        free = self.free(state, groups)
        precision = free.T @ self.normal @ free + np.eye(free.shape[1])
        covariance = np.linalg.inv(precision)
        estimate = covariance @ (free.T @ y)
        gain = 0.5 * float(y @ free @ estimate)
        chi2 = self.chi2 - 2.0 * (ratio + gain)
        return ratio + gain - 0.5 * float(np.linalg.slogdet(precision)[1]), chi2, estimate, covariance

    def coefficients(self, state: Hypothesis, groups: Sequence[Sequence[int]]) -> tuple[np.ndarray, np.ndarray]:
        """Return the coefficients of written values (from 0), other axes and constants, and of the machine's errors (means)."""
        _, _, estimate, _ = self.fit(state, groups)
        x = self.fixed(state) + sum(v * self.column(one, groups) for one, v in zip(state.free, estimate, strict=True))
        errors = self.wider * np.linalg.solve(self.precision, self.along[:, -1] - self.along[:, :-1] @ x)
        return x + (np.arange(len(x)) < self.count), errors

    def fixed(self, state: Hypothesis) -> np.ndarray:
        """Return the coefficients that a state fixes, as differences from everything in effect."""
        x = np.zeros(len(self.slope))
        for k, factor in state.factors:
            x[k] = factor - 1.0
        for k, axis in state.axes:
            x[k], x[self.count + k * self.axes + axis] = -1.0, 1.0
        return x

    def factors(self, state: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
        """Return estimate and standard uncertainty (k,) of the factor of each value, the others free with standard deviation 1."""
        x = self.fixed(state)
        own = slice(0, self.count)
        inverse = np.linalg.inv(self.normal[own, own] + np.eye(self.count))
        step = inverse @ (self.slope - self.normal @ x)[own]
        # The prior of the factor itself taken off again.
        variance = np.diag(inverse)
        without = variance / np.maximum(1.0 - variance, 1e-12)
        return 1.0 + x[own] + step * without / variance, np.sqrt(without)

    def noise(self) -> tuple[float, float]:
        """Return χ² with everything free that is known, and its degrees of freedom."""
        some = np.r_[: self.count, len(self.slope) - self.constants : len(self.slope)]
        wide = self.normal[np.ix_(some, some)] + np.eye(len(some)) * 1e-6
        chi2 = self.chi2 - float(self.slope[some] @ np.linalg.solve(wide, self.slope[some]))
        absorbed = float(np.trace(np.eye(len(self.precision)) - np.linalg.inv(self.precision)))
        # Free columns take degrees of freedom only where the readings determine them.
        taken = float(np.trace(np.linalg.solve(wide, self.normal[np.ix_(some, some)])))
        return chi2, self.rank - absorbed - taken


def mistakes(groups: Sequence[Sequence[int]], count: int) -> np.ndarray:
    """Return (h, count) changes of the factors by one or two mistakes: groups of values absent (−1) or reversed (−2)."""
    single = [(list(some), change) for some in groups for change in (-1.0, -2.0)]
    found = np.zeros((len(single) * (len(single) + 1) // 2, count))
    for row, (first, second) in zip(found, combinations_with_replacement(single, 2), strict=True):
        for some, change in (first, second):
            row[some] = change
    return np.unique(found, axis=0)


def shown(weigher: Weigher, state: Hypothesis, groups: Sequence[Sequence[int]]) -> np.ndarray:
    """Return (k,) whether all that one or two mistakes more could do to a value, absent or reversed, is excluded by `ODDS`."""
    free = weigher.free(state, groups)
    projector = free @ np.linalg.solve(free.T @ weigher.normal @ free + np.eye(free.shape[1]), free.T)
    normal = weigher.normal - weigher.normal @ projector @ weigher.normal
    left = weigher.slope - weigher.normal @ weigher.fixed(state)
    slope = left - weigher.normal @ projector @ left
    own = slice(0, weigher.count)
    changes = mistakes(groups, weigher.count)
    ratio = changes @ slope[own] - 0.5 * np.einsum("hk,kl,hl->h", changes, normal[own, own], changes)
    return np.asarray(~np.any((changes != 0.0) & (ratio > -np.log(ODDS))[:, None], axis=0))


def groups_of(written: Sequence[WrittenValue]) -> dict[str, list[int]]:
    """Return the groups of written values that are likely wrong together, by name: everything, the groups, and each value."""
    groups: dict[str, list[int]] = {"everything that was written": list(range(len(written)))}
    for k, value in enumerate(written):
        for name in value.groups:
            groups.setdefault(name, []).append(k)
    groups |= {value.name: [k] for k, value in enumerate(written)}
    unique: dict[tuple[int, ...], str] = {}
    for name, some in reversed(groups.items()):
        unique.setdefault(tuple(some), name)
    return {name: list(some) for some, name in reversed(unique.items()) if some}


def _moves(state: Hypothesis, weigher: Weigher, groups: Sequence[Sequence[int]]) -> set[Hypothesis]:
    """Return the states that one more mistake, or one more change, makes of a state."""
    everything = range(weigher.count)
    found: set[Hypothesis] = set()
    diagonal = np.diag(weigher.normal)[weigher.count : weigher.count * (1 + weigher.axes)]
    on_axis = diagonal.reshape(weigher.count, weigher.axes) > 0.0
    for number, some in enumerate(groups):
        found |= {state.with_factor(some, factor) for factor in (1.0, *FACTORS)}
        found |= {
            state.with_factor(some, 0.0, axis) for axis in np.flatnonzero(on_axis[list(some)].all(axis=0)).tolist()
        }
        if not state.factors and len(some) < weigher.count:
            found.add(state.with_factor([k for k in everything if k not in some], 0.0))
        if -1 - number not in state.free:
            found.add(replace(state, free=(*state.free, -1 - number)))
    found |= {replace(state, free=(*state.free, c)) for c in range(weigher.constants) if c not in state.free}
    return found - {state}


def best_hypothesis(weigher: Weigher, groups: Sequence[Sequence[int]]) -> tuple[Hypothesis, list[Hypothesis]]:
    """Return the most likely state, and those that it does not exclude: as many mistakes, odds below `ODDS`."""
    state, value, others = Hypothesis(), 0.0, list[Hypothesis]()
    for _ in range(MOST_MOVES):
        moves = sorted(_moves(state, weigher, groups), key=repr)
        ratios = [weigher.fit(one, groups)[0] for one in moves]
        # One mistake of all values is as likely as one of any single group: of equals, the one with fewer kinds of factors. Another
        # share is a kind, too, and is stated only if it is clearly more likely than the factors that mistakes have.
        ranked = [
            ratio
            - np.log(len(groups) + 1) * one.kinds(weigher.count)
            - np.log(ODDS * (len(groups) + 1)) * sum(free < 0 for free in one.free)
            for ratio, one in zip(ratios, moves, strict=True)
        ]
        best = int(np.argmax(ranked)) if moves else 0
        if not moves or ratios[best] - value < np.log(len(moves) / FALSE_ALARMS):
            break
        state, value = moves[best], ratios[best]
        order = sorted(range(len(moves)), key=lambda k: -ratios[k])
        others = [moves[k] for k in order if k != best and ratios[k] > value - np.log(ODDS)]
    return state, others
