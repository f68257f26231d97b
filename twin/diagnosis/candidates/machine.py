"""Candidate causes in the machine: its effects at every place, curves, loads, spikes at reversals, following errors.

- Loads: with known compliances the deflection is linear in the mass and its first moments (Khalil and Dombre 2002, Modeling,
  Identification and Control of Robots, ch. 12); others are estimated together with the load (`twin.diagnosis.payload`).
- Spikes of a ball bar's circle: an axis sticks at its reversal while the others move on, and catches up, −A·sign(v)·exp(−t/τ) along it.
  A and τ depend on the feed and on the friction compensation of the drive, so it does not enter a calibration.
- Following errors: the share s of the difference between report and command that appears in the readings: 1 if the axis was at the
  reported position (``following_error``), 0 if it was reported before the axis had settled (``read_back``; `twin.diagnosis.causes`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from twin._common.messages import Message
from twin._common.units import UM
from twin.diagnosis.candidates.calibration import mistakes
from twin.diagnosis.candidates.candidate import (
    STRAIGHT_LINE,
    Candidate,
    CandidateInputs,
    Catalogue,
    Column,
    Drift,
    Missing,
    Variant,
    along_command,
    component_column,
    first_component,
    tabulated_column,
    unit_columns,
)
from twin.diagnosis.candidates.instrument import velocities
from twin.machine.error_names import DIRECTIONS
from twin.machine.machine import Axis, Machine
from twin.measurement.observation import has_times, order_in_time
from twin.measurement.table import Measurements
from twin.model.effects import MACHINE_EFFECTS, Effect, ErrorMotion, GravityCompliance, Payload, Specification, unit_of
from twin.model.effects.base import LOAD, LOAD_NUMBERS, NUMBERS, SIDES, Side, along, channel, is_carrying, side_of
from twin.model.effects.error_motion import (
    STRAIGHTNESS,
    specification_of,
)
from twin.model.effects.gravity_compliance import CARRIED_LOAD, PAYLOAD, AddedLoad, gravity_compliance, loads_of
from twin.model.effects.specification import NOTHING, REST, Advice, Drawing, Forms, single_parameter_form
from twin.model.effects.table_load import TableLoad
from twin.model.motion_curve import Curve
from twin.numerics.curves import POWER, CurveSpace, conversion
from twin.numerics.functions import Functions, Rows, tabulated

TESTED_EFFECTS: Final = tuple(
    effect for effect in MACHINE_EFFECTS if effect.forms is not None or (effect.make is not None and not effect.curve)
)


def machine_effects(inputs: CandidateInputs) -> Catalogue:
    """Return every machine effect, except curves, for which the data have the columns."""
    loaded = [effect for effect in inputs.calibration.extra if isinstance(effect, (GravityCompliance, TableLoad))]
    payloads: tuple[Payload, ...] | None = tuple(
        dict.fromkeys(payload for effect in loaded for payload in effect.payloads)
    )
    if not payloads and not any(isinstance(effect, GravityCompliance) for effect in loaded):
        payloads = None
    candidates: list[Candidate] = []
    missing: list[Missing] = []
    for specification in TESTED_EFFECTS:
        places, lacking = specification.candidate_places(inputs.machine, inputs.state)
        missing += [(specification.name, where, what) for where, what in lacking]
        candidates += [_effect_candidate(specification, where, inputs, payloads) for where in places]
    return Catalogue(tuple(candidates), tuple(missing))


def _effect_candidate(
    specification: Specification, where: str, inputs: CandidateInputs, payloads: Sequence[Payload] | None
) -> Candidate:
    if specification.forms is not None:
        forms = specification.forms(inputs.machine, where, inputs.state, payloads)
    elif specification.make is None:
        raise TypeError(f"{specification.name} has neither forms nor a constructor")
    else:
        make, (name,) = specification.make, specification.parameters
        unit = make(inputs.machine, where, {name: 1.0}, ()).parameters[0].unit
        forms = single_parameter_form((name, unit), lambda value: make(inputs.machine, where, {name: value}, ()))
    if forms.is_drift:
        drift = _drift(forms, specification.nonlinear[0], inputs)
        return Candidate(
            specification, where, forms.names, drift.variants, forms.tests or 1.0, forms.build, forms.units, drift=drift
        )
    variants = tuple(
        Variant(columns, fixed) for columns, fixed in zip(_columns(forms, inputs), forms.trials, strict=True)
    )
    tests = float(max(len(variants), 1)) if forms.tests is None else forms.tests
    return Candidate(specification, where, forms.names, variants, tests, forms.build, forms.units, forms.space)


def variant_at(candidate: Candidate, fixed: Mapping[str, float], machine: Machine, state: Mapping[str, Any]) -> Variant:
    """Return the variant of a candidate, which has ``units`` or ``drift``, at given values of its non-linear parameters."""
    if candidate.drift is not None:
        return candidate.drift.variant(fixed.get(candidate.drift.name, STRAIGHT_LINE))
    if candidate.units is None:
        raise TypeError(f"{candidate.effect}: columns exist only at the values tried")
    return Variant(tuple(unit_columns(candidate.units(fixed), machine, state)), fixed)


def _columns(forms: Forms, inputs: CandidateInputs) -> list[tuple[Column, ...]]:
    """Return the columns of every trial."""
    together, made = forms.together, forms.units
    if together is None and made is not None:
        return _of_units([made(fixed) for fixed in forms.trials], inputs)
    if together is None:
        raise TypeError("forms without columns")
    at = first_component(inputs.machine, together.frame.axis, together.frame.role)
    return [
        tuple(component_column([(at + i, together.functions, k, part) for i, part in together.parts]) for k in some)
        for some in together.columns
    ]


def _of_units(units: Sequence[Sequence[Effect]], inputs: CandidateInputs) -> list[tuple[Column, ...]]:
    """Return the columns of several trials, whose functions are evaluated together."""
    columns = iter(unit_columns([unit for some in units for unit in some], inputs.machine, inputs.state))
    return [tuple(next(columns) for _ in some) for some in units]


def _drift(forms: Forms, name: str, inputs: CandidateInputs) -> Drift:
    """Return the drift of some forms, with the name of its time constant."""
    made = forms.units
    if made is None:
        raise TypeError("a drift needs columns at any time constant")

    def columns_at(constants: Sequence[float]) -> list[tuple[Column, ...]]:
        fixed = [{} if constant == STRAIGHT_LINE else {name: constant} for constant in constants]
        return _of_units([made(values) for values in fixed], inputs)

    tried = tuple(fixed[name] for fixed in forms.trials if fixed)
    # The functions of all time constants tried are evaluated together.
    known = dict(zip(tried, columns_at(tried), strict=True))

    def columns(constant: float) -> tuple[Column, ...]:
        return known[constant] if constant in known else columns_at([constant])[0]

    return Drift(columns, tried, straight=False, name=name)


CORRECTION_DEGREE: Final = 3  # degree of the correction of a curve that is not a polynomial
MOST_DEGREES: Final = 8  # largest degree tried, unless the calibration's curve has a larger one


def curves(inputs: CandidateInputs) -> Catalogue:
    """Return corrections of the curves of linear axes, and of rotary axes with polynomial curves, in orthonormal polynomials."""
    return Catalogue(tuple(candidate for axis in inputs.machine.axes for candidate in _of_axis(inputs, axis)))


def _of_axis(inputs: CandidateInputs, axis: Axis) -> list[Candidate]:
    """Return the candidates of the error motions of an axis; those of one domain and degree share their functions."""
    alike: dict[tuple[tuple[float, float], int], dict[int, tuple[CurveSpace, dict[float, np.ndarray]]]] = {}
    for component in range(len(DIRECTIONS)):
        correction = _space_and_mistakes(inputs, axis, component)
        if correction is not None:
            alike.setdefault((correction[0].domain, correction[0].count), {})[component] = correction
    candidates: dict[int, Candidate] = {}
    for (domain, count), corrections in alike.items():
        shapes = [shape for _, patterns in corrections.values() for shape in patterns.values()]
        first_space, _ = next(iter(corrections.values()))
        functions = _functions_with_sums(first_space, _positions(inputs, axis, domain), shapes)
        start = count
        for component, (space, patterns) in corrections.items():
            index = [*range(count), *range(start, start + len(patterns))]
            at = first_component(inputs.machine, axis.name) + component
            columns = tuple(component_column([(at, functions, k, 1.0)]) for k in index)
            candidates[component] = _curve_candidate(axis, component, space, patterns, columns)
            start += len(patterns)
    return [candidates[component] for component in sorted(candidates)]


def _space_and_mistakes(
    inputs: CandidateInputs, axis: Axis, component: int
) -> tuple[CurveSpace, dict[float, np.ndarray]] | None:
    """Return functions of the correction of one error motion, and coefficients of mistakes in its curve; None if it has none."""
    name, curve = f"E_{DIRECTIONS[component]}{axis.name}", None
    if (known := inputs.calibration.curves.get(name)) is not None:
        curve = known.in_powers()
    limits = _domain_and_degree(axis, known, curve)
    if limits is None:
        return None
    domain, degrees = limits
    count = min(degrees, len(np.unique(np.round(_positions(inputs, axis, domain), 3))) - 1) + 1
    if count <= _fixed_by_datum(axis, component):
        return None
    space = CurveSpace(name, POWER, domain, 0, count)
    return space, mistakes(space, curve)


def _positions(inputs: CandidateInputs, axis: Axis, domain: tuple[float, float]) -> np.ndarray:
    """Return the (n,) positions of an axis inside a domain."""
    q = inputs.state[axis.name]
    return np.clip(q if axis.lower is not None else domain[0] + np.mod(q - domain[0], 360.0), *domain)


def _fixed_by_datum(axis: Axis, component: int) -> int:
    """Return how many coefficients the datum fixes (`twin.identification.network`): the constant, the slope of a straightness."""
    return 2 if specification_of(axis, component) is STRAIGHTNESS else 1


def _curve_candidate(
    axis: Axis, component: int, space: CurveSpace, patterns: Mapping[float, np.ndarray], columns: tuple[Column, ...]
) -> Candidate:
    """Return the candidate of one error motion, from the columns of its functions and of the mistakes in its curve."""
    first_free = _fixed_by_datum(axis, component)
    variants = [
        Variant(columns[first : degree + 1], {"first": float(first)})
        for degree in range(first_free, space.count)
        for first in (0, first_free)
    ]
    single_mistakes = [Variant((columns[space.count + k],), {"stops": stops}) for k, stops in enumerate(patterns)]
    tests = float(space.count - first_free + min(len(single_mistakes), 2))
    names = tuple((f"g{k}", unit_of(space.name)) for k in range(space.count))

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[Effect, ...]:
        if "stops" in fixed:
            values = values[0] * patterns[fixed["stops"]]
        first = round(fixed.get("first", 0.0))
        n = first + len(values)
        coefficients = tuple(float(v) for v in space.transform[:n, first:n] @ values)
        return (ErrorMotion(space.name, space.basis, space.domain, coefficients, wrapped=axis.lower is None),)

    specification = specification_of(axis, component)
    return Candidate(specification, space.name, names, (*variants, *single_mistakes), tests, build, space=space)


def _domain_and_degree(axis: Axis, known: Curve | None, curve: Curve | None) -> tuple[tuple[float, float], int] | None:
    """Return domain and largest degree of the correction of a known curve; None if it cannot be corrected.

    ``curve`` is the same in powers; None if it is not a polynomial.
    """
    if curve is not None:
        return curve.domain, max(MOST_DEGREES, len(curve.coefficients) - 1)
    if known is not None:
        # Another basis: only a correction that this basis can represent.
        fits = conversion(POWER, known.family, CORRECTION_DEGREE + 1, len(known.coefficients)) is not None
        return (known.domain, CORRECTION_DEGREE) if fits else None
    if axis.linear and axis.lower is not None and axis.upper is not None:
        return (axis.lower, axis.upper), MOST_DEGREES
    return None


def _functions_with_sums(space: CurveSpace, at: np.ndarray, patterns: Sequence[np.ndarray]) -> Functions:
    """Return a curve's orthonormal functions at (n,) positions, followed by linear combinations of them with coefficients (count,)."""
    sums = np.stack(patterns, axis=1) if patterns else np.zeros((space.count, 0))

    def values(rows: Rows) -> np.ndarray:
        of_space = space.functions(at[rows])
        return np.concatenate([of_space, of_space @ sums], axis=1)

    return Functions(len(at), space.count + sums.shape[1], values)


LOADS: Final = 4  # mass and three first moments


def added_payloads(inputs: CandidateInputs) -> Catalogue:
    """Return the candidates for each side on which the calibration has compliances: a payload, and the load that the readings carry.

    A load that all readings carry is confounded with a payload: it is tested where compliances are known without it, else the payload.
    """
    compliant = [effect for effect in inputs.calibration.extra if isinstance(effect, GravityCompliance)]
    every = {side: [effect for effect in compliant if side_of(effect.axis) == side] for side in SIDES}
    sides = [side for side in SIDES if every[side]]
    known = {payload.side for effect in compliant for payload in effect.payloads if payload.carried}
    candidates: list[Candidate] = []
    missing: list[Missing] = []
    carrying = is_carrying(inputs.state)
    varied = carrying and bool(np.ptp(inputs.state[LOAD]) > 0.0)
    if carrying and not varied and not sides:
        moved = dict.fromkeys(side_of(axis) for axis in inputs.machine.axes)
        missing += [(CARRIED_LOAD.name, side, f"readings at different {LOAD}") for side in moved]
    for side in sides:
        if not carrying or varied:
            candidates.append(_payload_candidate(inputs, side, every[side], carried=False))
        else:
            missing.append((PAYLOAD.name, side, f"readings at different {LOAD}"))
        if carrying and side in (known or sides):
            candidates.append(_payload_candidate(inputs, side, every[side], carried=True))
        elif not carrying:
            missing.append((CARRIED_LOAD.name, side, LOAD))
    return Catalogue(tuple(candidates), tuple(missing))


def _payload_candidate(
    inputs: CandidateInputs, side: Side, compliant: Sequence[GravityCompliance], *, carried: bool
) -> Candidate:
    first = 1 + LOADS * SIDES.index(side)
    loads_at = loads_of(inputs.machine)
    measured = loads_at(inputs.state)
    mass = np.asarray(inputs.state[LOAD], dtype=float)[:, None] if carried else 1.0

    def column(k: int) -> Column:
        parts = []
        for joint in compliant:
            at = first_component(inputs.machine, joint.axis.name, "motion")
            functions = tabulated(mass * np.asarray(measured[joint.axis.name][first + k], dtype=float)[:, None])
            parts += [(at + i, functions, 0, joint.compliance * part) for i, part in along(joint.axis, 1.0).items()]
        return component_column(parts)

    def loads_along(axis: str) -> Callable[[Mapping[str, Any]], Sequence[Any]]:
        def along_axis(positions: Mapping[str, Any]) -> Sequence[Any]:
            units = loads_at(positions)[axis][first : first + LOADS]
            if not carried:
                return units
            held = channel(positions, LOAD, f"{CARRIED_LOAD.name}:{side}")
            return [held * unit for unit in units]

        return along_axis

    rigid = _rigid(inputs.machine, side, compliant)
    known = inputs.calibration.covariance
    deviations = dict(zip(known.names, np.sqrt(np.diag(known.matrix)), strict=True))
    # 0 where the calibration gives no uncertainty of a compliance.
    doubt = [float(deviations.get(joint.parameters[0].name, 0.0)) for joint in compliant]

    def build(values: np.ndarray, fixed: Mapping[str, float]) -> tuple[AddedLoad, ...]:
        weights = values if len(values) == LOADS else values[0] * first_moments(fixed)

        def load(joint: GravityCompliance, u: float, beside: Sequence[AddedLoad] = ()) -> AddedLoad:
            return AddedLoad(joint, loads_along(joint.axis.name), side, weights, carried=carried, u=u, beside=beside)

        others = [load(joint, abs(joint.compliance)) for joint in rigid]
        return tuple(
            load(joint, u, others if k == 0 else ()) for k, (joint, u) in enumerate(zip(compliant, doubt, strict=True))
        )

    columns = tuple(column(k) for k in range(LOADS))
    units = ("1" if carried else "kg", "mm", "mm", "mm")
    return Candidate(
        CARRIED_LOAD if carried else PAYLOAD,
        side,
        tuple(zip(LOAD_NUMBERS if carried else NUMBERS, units, strict=True)),
        # The mass at the origin of the frame that carries it, or with its centre.
        (Variant(columns[:1]), Variant(columns)),
        2.0,
        build,
        reported=_mass_and_centre,
    )


def first_moments(fixed: Mapping[str, float]) -> np.ndarray:
    """Return (4,) mass and first moments, kg·m, of a load of 1 kg with the centre that a variant fixes; at the origin without one."""
    return np.array([1.0, *(1e-3 * fixed.get(name, 0.0) for name in NUMBERS[1:])])


def with_centre(candidate: Candidate, centre_mm: Sequence[float] | np.ndarray) -> Variant:
    """Return the variant of an added load with a given centre in the frame that carries it: its only coefficient is the mass."""
    fixed = dict(zip(NUMBERS[1:], map(float, centre_mm), strict=True))
    parts = list(zip(candidate.variants[-1].columns, first_moments(fixed), strict=True))
    terms = [replace(term, weight=term.weight * weight) for column, weight in parts for term in column.terms]
    # The effect of 1 kg is at most the sum of those of its mass and moments, so that this mass has the largest plausible effect.
    scale = 1.0 / sum(abs(weight) / column.scale for column, weight in parts)
    return Variant((Column(tuple(terms), float(scale)),), fixed)


def _rigid(machine: Machine, side: Side, compliant: Sequence[GravityCompliance]) -> list[GravityCompliance]:
    """Return the axes of a side without a known compliance, as if they gave way as much as the known ones do (RMS, same kind of axis).

    The calibration says nothing of them: readings without the load may not have loaded them.
    """
    known = {joint.axis.name for joint in compliant}
    rigid = []
    for axis in machine.axes:
        like = [joint.compliance for joint in compliant if joint.axis.linear == axis.linear]
        if like and axis.name not in known and side_of(axis) == side:
            rigid.append(gravity_compliance(machine, axis.name, float(np.sqrt(np.mean(np.square(like))))))
    return rigid


def _mass_and_centre(values: np.ndarray) -> np.ndarray:
    """Return mass, kg, and centre, mm, from mass and first moments, kg·m; of the mass alone the mass."""
    return np.concatenate([values[:1], 1e3 * values[1:] / values[0]])


TIME_CONSTANTS_IN_ROWS: Final = (1.0, 2.0, 4.0, 8.0)
"""Time constants tried, in intervals between rows: shorter ones fall between the readings, longer ones are backlash."""

REVERSAL_SPIKE: Final = Specification(
    name="reversal_spike",
    kind="machine",
    title=lambda where: Message("{where} sticks for a moment when it reverses", where=where),
    family="spikes at reversals",
    advice=Advice(
        "Service: friction compensation of the drive of {axis} (its amplitude and time), and the friction of its "
        "guideway.",
        f"{REST} It does not enter the calibration.",
        NOTHING,
    ),
    evidence=lambda of: Message(
        "{where} lags by {measure} right after each reversal and catches up within some readings",
        where=of.where,
        measure=of.measure,
    ),
    limits={"um": 200.0, "urad": 2000.0},
    drawing=Drawing(by_state=True),
)


def reversal_spikes(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every axis that reversed while it was measured in motion."""
    candidates = []
    for name, velocity in velocities(inputs.data, inputs.machine).items():
        since, interval = time_since_reversal(inputs.data, velocity)
        if not np.any(np.isfinite(since)):
            continue
        axis = inputs.machine.by_name[name]
        variants = []
        for rows in TIME_CONSTANTS_IN_ROWS:
            late = -np.sign(velocity) * np.exp(-since / (rows * interval))
            column = tabulated_column({i: late * part for i, part in along_command(inputs.machine, axis)})
            variants.append(Variant((column,), {"time_constant": rows * interval}))
        names = (("amplitude", "um" if axis.linear else "urad"),)
        candidates.append(Candidate(REVERSAL_SPIKE, name, names, tuple(variants), 2.0))
    return Catalogue(tuple(candidates))


def time_since_reversal(data: Measurements, velocity: np.ndarray) -> tuple[np.ndarray, float]:
    """Return (n,) the time in s since an axis reversed, infinite before the first reversal of a round, and the interval between rows.

    Rows follow each other at a known feed or at known times; a reversal is in the middle between two rows of opposite velocity.
    """
    timed, order = has_times(data), order_in_time(data)
    q, rounds = data.positions[order], data.round[order]
    step = np.linalg.norm(np.diff(q, axis=0, prepend=q[:1]), axis=1)
    feed = np.nan_to_num(data.feed_mm_min[order]) / 60.0
    by_feed = np.where(feed > 0.0, step / np.where(feed > 0.0, feed, 1.0), 0.0)
    passed = np.diff(data.time_s[order], prepend=data.time_s[order][:1]) if timed else by_feed
    direction, by_row, elapsed = np.sign(velocity[order]), np.full(len(q), np.inf), np.inf
    for i in range(1, len(q)):
        if rounds[i] != rounds[i - 1]:
            elapsed = np.inf
        elif direction[i] * direction[i - 1] < 0.0:
            elapsed = 0.5 * passed[i]
        else:
            elapsed += passed[i]
        by_row[i] = elapsed
    since = np.empty_like(by_row)
    since[order] = by_row
    return since, float(np.median(passed[passed > 0.0])) if np.any(passed > 0.0) else 1.0


LEAST_UM: Final = 1e-3  # µm or µrad: smaller differences between report and command are ignored

FOLLOWING_ERROR: Final = Specification(
    name="following_error",
    kind="machine",
    title=lambda where: Message("{where} did not reach its commanded position", where=where),
    advice=Advice(
        "Service: the drive of {axis}, which does not reach the commanded position. Set-up: the dwell before each "
        "reading.",
        "Let {axis} settle and measure again. It does not go into the calibration.",
        "Do not compensate it: how far the axis lags depends on speed and load.",
    ),
    evidence=lambda of: Message(
        "{where} was at the position that the control reported, not at the commanded one", where=of.where
    ),
    rare=True,
    all_or_nothing=True,
    drawing=Drawing(size_of="report", by_state=True),
)
READ_BACK: Final = Specification(
    name="read_back",
    kind="instrument",
    title=lambda where: Message("reported positions of {where} were read too early", where=where),
    family="reported positions",
    advice=Advice(
        "Metrology: the moment at which the control's positions were read.",
        "Use the commanded positions, or wait until {axis} stands still before reading.",
        NOTHING,
    ),
    evidence=lambda of: Message("the positions reported for {where} were read before it had settled", where=of.where),
    drawing=Drawing(size_of="report", by_state=True),
)


def following_errors(inputs: CandidateInputs) -> Catalogue:
    """Return a candidate for every axis with reported positions that differ from the command."""
    candidates, missing = [], []
    for i, axis in enumerate(inputs.machine.axes):
        reported = inputs.data.readback[:, i]
        if np.all(np.isnan(reported)):
            missing.append((READ_BACK.name, axis.name, f"readback_{axis.name}_{axis.unit}"))
            continue
        difference = np.where(np.isfinite(reported), (reported - inputs.data.positions[:, i]) * axis.scale / UM, 0.0)
        if np.abs(difference).max() >= LEAST_UM:
            column = tabulated_column({i: difference * part for i, part in along_command(inputs.machine, axis)})
            candidates.append(Candidate(FOLLOWING_ERROR, axis.name, (("share", "1"),), (Variant((column,)),), 1.0))
    return Catalogue(tuple(candidates), tuple(missing))
