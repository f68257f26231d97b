"""The gain of the extended calibration as written: on all readings, on held-out readings, and at the tool.

Empirical effects, without a known cause, fitted to the patterns that no named cause explains.

Their coefficients are the most likely ones at the variances of the patterns, with the causes fixed at their written sizes. They enter
a calibration only if held-out readings confirm them, and are valid only within the measured ranges.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.errors import InputError
from twin._common.records import APPROACH
from twin.diagnosis.causes import JUMPED, SizedCauses
from twin.diagnosis.cross_validation import (
    GROUPS_FOR_AN_INTERVAL,
    OVERFITTED_RATIO,
    HeldOutFolds,
    choose_folds,
    fitted_rms_um,
    folds_at_positions,
    folds_in_time,
    held_out_squares,
    jackknife_interval,
    predicted_pattern_shift,
    predicted_shift,
)
from twin.diagnosis.forms import Candidates, Form
from twin.diagnosis.likelihood import Likelihood, PatternTest
from twin.diagnosis.nuisance import setup_basis
from twin.diagnosis.problem import Problem, in_um, rms, unwhiten
from twin.diagnosis.result import Extension, Gain, HeldOut, Term, Unexplained
from twin.diagnosis.structure import Findings
from twin.identification.network import Network
from twin.identification.solve import solve
from twin.machine.machine import Machine
from twin.measurement.observation import machine_state
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.calibration_file import acting_frame, available_in_programs, unused_place
from twin.model.effects import Effect, Empirical
from twin.model.effects.empirical import channel_name
from twin.numerics.covariance import Covariance
from twin.tool.forward import Kinematics
from twin.tool.uncertainty import volume


def held_out(sized: SizedCauses, written: Collection[int] = ()) -> HeldOut | None:
    """Return the residuals of held-out readings, without and with the written causes and patterns, fitted to the other readings.

    Periods and other numbers that are not linear stay as fitted to all readings. None if nothing can be held out.
    """
    findings, problem = sized.findings, sized.findings.problem
    named = [form for form, doubt in zip(sized.forms, sized.doubts, strict=True) if not doubt]

    def predict(part: Candidates) -> tuple[np.ndarray, np.ndarray]:
        after = predicted_shift(problem, part, named)
        if written:
            likelihood = Likelihood(part, findings.structure.pattern_tests)
            after = after + predicted_pattern_shift(likelihood, named, written)
        return np.zeros_like(after), after

    split = _folds_of(sized)
    return None if split is None else _held_out(findings.candidates, split, predict)


def only_predicting(sized: SizedCauses) -> SizedCauses:
    """Return the causes, those of the machine in doubt if together they do not lower the residuals of held-out readings.

    They are compared with the causes of the instrument alone; with too few groups to judge, nothing is doubted. Nor do they predict if
    they leave much more in held-out readings than in those that they are fitted to, unless the gain is larger than its uncertainty.
    """
    problem, pairs = sized.findings.problem, list(zip(sized.forms, sized.doubts, strict=True))
    named = [form for form, doubt in pairs if not doubt]
    of_instrument = [form for form in named if form.candidate.origin == "instrument"]
    split = _folds_of(sized)
    if len(of_instrument) == len(named) or split is None:
        return sized

    def predict(part: Candidates) -> tuple[np.ndarray, np.ndarray]:
        return predicted_shift(problem, part, of_instrument), predicted_shift(problem, part, named)

    held = _held_out(sized.findings.candidates, split, predict)
    if held is None or held.ci95_um is None:
        return sized
    overfitted = held.after_um > OVERFITTED_RATIO * fitted_rms_um(sized.findings.candidates, named)
    if held.after_um < held.before_um and not (overfitted and held.ci95_um[0] <= 0.0):
        return sized
    why = f"; held-out {held.of} are not predicted better with it ({held.before_um:.3g} µm without, {held.after_um:.3g} µm with)"
    return replace(
        sized,
        doubts=tuple(doubt or ("" if form.candidate.origin == "instrument" else why) for form, doubt in pairs),
    )


def _folds_of(sized: SizedCauses) -> HeldOutFolds | None:
    network = sized.findings.problem.network
    return choose_folds(network.data, network.machine, [form.candidate for form in sized.forms])


def held_out_patterns(findings: Findings, forms: Sequence[Form], written: Collection[int]) -> HeldOut | None:
    """Return the residuals of held-out readings, with the causes alone and with the written patterns, fitted to the other readings."""
    problem, structure, network = findings.problem, findings.structure, findings.problem.network
    names = {name for k in written for name in structure.pattern_tests[k].pattern.names}
    # The approach direction of an axis is held out by the positions of that axis.
    axes = {channel_name(name).removeprefix(APPROACH) for name in names}
    moving = [i for i, name in enumerate(network.machine.names) if name in axes]
    split = folds_at_positions(network.data, moving) if moving else folds_in_time(network.data)
    if split is None:
        return None

    def predict(small: Candidates) -> tuple[np.ndarray, np.ndarray]:
        named = predicted_shift(problem, small, forms)
        return named, named + predicted_pattern_shift(Likelihood(small, structure.pattern_tests), forms, written)

    return _held_out(findings.candidates, split, predict)


def _held_out(
    candidates: Candidates, split: HeldOutFolds, predict: Callable[[Candidates], tuple[np.ndarray, np.ndarray]]
) -> HeldOut | None:
    table = held_out_squares(candidates, split, predict)
    if table is None:
        return None
    total = table.sum(axis=0)
    before, after = np.sqrt(total[:2] / total[2])
    return HeldOut(split.of, len(table), float(before), float(after), jackknife_interval(table))


DIRECTIONS: Final = 3


@final
@dataclass(frozen=True, eq=False)
class EmpiricalExtension:
    """Empirical effects fitted to the unexplained patterns."""

    extension: Extension  # their description in the result
    effects: tuple[Empirical, ...] = ()  # written; empty if held-out readings do not confirm them
    covariance: Covariance = field(default_factory=Covariance.none)  # of their parameters
    written: tuple[int, ...] = ()  # numbers of their patterns
    left_um: float = 0.0  # RMS per coordinate of the patterns that are not written


def extend(sized: SizedCauses, calibration: Calibration) -> EmpiricalExtension:
    """Fit an empirical effect to each pattern, and test on held-out readings whether the effects reduce the residuals."""
    findings, forms, problem = sized.findings, sized.forms, sized.findings.problem
    likelihood, machine = findings.structure.likelihood, problem.network.machine
    if sized.jumped:
        return EmpiricalExtension(
            Extension((), 0.0, None, False, "it is a jump, of which a later program knows nothing")
        )
    if likelihood is None or not likelihood.pattern_tests:
        return EmpiricalExtension(Extension((), 0.0, None, False, "it depends on no column of the table"))
    model = likelihood.fit(forms, findings.structure.model)
    slope = likelihood.slope_with(problem.residual - sized.estimate.signature.sum(axis=1))
    which, values, covariance = likelihood.most_likely(model, slope)
    terms: list[Term] = []
    effects: list[Empirical] = []
    written: list[int] = []
    in_file = np.zeros(len(which), dtype=bool)
    written_shift, other_shift = np.zeros((2, len(problem.residual)))
    taken = [effect.name for effect in calibration.extra]
    for k, pattern_test in enumerate(likelihood.pattern_tests):
        of_pattern = likelihood.group[which] // DIRECTIONS == k
        shift = likelihood.effect_on_readings(which[of_pattern], values[of_pattern])
        term = _term(pattern_test, machine, _rms(problem, shift), taken)
        terms.append(term)
        if term.reason is None:
            effects.append(_effect(term, machine, likelihood, k, which[of_pattern], values[of_pattern]))
            taken.append(effects[-1].name)
            written.append(k)
            in_file |= of_pattern
            written_shift += shift
        else:
            other_shift += shift
    held = held_out_patterns(findings, forms, written) if effects else None
    reason = _unproven(held) if effects else "; ".join(dict.fromkeys(str(term.reason) for term in terms))
    extension = Extension(tuple(terms), _rms(problem, written_shift), held, reason is None, reason)
    if reason is not None:
        return EmpiricalExtension(extension)
    names = tuple(parameter.name for effect in effects for parameter in effect.parameters)
    matrix = read_only(covariance[np.ix_(in_file, in_file)])
    return EmpiricalExtension(
        extension, tuple(effects), Covariance(names, matrix), tuple(written), _rms(problem, other_shift)
    )


def _rms(problem: Problem, made: np.ndarray) -> float:
    """Return the RMS per coordinate, µm, of (3n,) whitened shifts after projecting out the set-up."""
    return rms(in_um(problem.network, problem.project(made)), problem.network.read)


def _term(pattern_test: PatternTest, machine: Machine, size: float, taken: Sequence[str]) -> Term:
    """Return the term of a pattern, with the reason if it cannot become an effect."""
    pattern = pattern_test.pattern
    columns = pattern.waves(pattern_test.level)
    along = _along(pattern_test)
    reason = None
    unknown = [column.column for column in columns if not available_in_programs(column.column, machine)]
    if unknown:
        reason = f"it depends on {' and '.join(unknown)}, which a later program does not know"
    elif size == 0.0:
        reason = "with the causes in the model its size is zero"
    else:
        try:
            acting_frame(pattern.side, along, machine)
        except InputError as error:
            reason = error.what
    ranges = {column.column: column.range for column in columns if column.range is not None}
    return Term(unused_place(pattern.side, columns, taken), along, pattern.names, ranges, size, reason)


def _along(pattern_test: PatternTest) -> Literal["base", "tool", "work"]:
    if pattern_test.pattern.field == "base":
        return "base"
    return "tool" if pattern_test.pattern.side == "tool" else "work"


def _effect(
    term: Term, machine: Machine, likelihood: Likelihood, k: int, which: np.ndarray, values: np.ndarray
) -> Empirical:
    """Return the empirical effect of the k-th pattern: ``values`` in µm of its columns with a coefficient (``which``)."""
    pattern_test = likelihood.pattern_tests[k]
    columns, along = pattern_test.pattern.waves(pattern_test.level), _along(pattern_test)
    # Columns are sorted by direction, then by function.
    names = np.array(Empirical.names(columns)).ravel()
    of_pattern = np.flatnonzero(likelihood.group // DIRECTIONS == k)
    chosen = names[np.searchsorted(of_pattern, which)].tolist()
    frame, turning = acting_frame(pattern_test.pattern.side, along, machine)
    return Empirical(term.where, along, columns, dict(zip(chosen, values.tolist(), strict=True)), frame, turning)


def _unproven(held: HeldOut | None) -> str | None:
    """Return why held-out readings do not confirm the effects; None if they do."""
    if held is None:
        return "no readings could be held out to confirm it"
    if held.ci95_um is None:
        return f"fewer than {GROUPS_FOR_AN_INTERVAL} {held.of} could be held out, too few to confirm it"
    if held.ci95_um[0] <= 0.0:
        return (
            f"held-out {held.of} do not confirm it ({held.before_um:.3g} µm without it, {held.after_um:.3g} µm with it)"
        )
    return None


LARGEST_UM: Final = 1e5
"""Error at the tool above which none is stated: small rotations and compliances do not describe a machine that is 100 mm off."""
# With zero length a rotation about the spindle nose would have no effect.
DEFAULT_TOOL_MM: Final = 100.0  # tool length assumed if the machine file has none


def gain(
    sized: SizedCauses,
    residuals: tuple[np.ndarray, np.ndarray],
    unexplained: Unexplained | None,
    extension: EmpiricalExtension | None,
) -> Gain:
    """Return the gain of the extended calibration: ``residuals`` (n, 3), µm, are those with the given and with the extended one."""
    network = sized.findings.problem.network
    data, machine = network.data, network.machine
    held = held_out(sized, () if extension is None else extension.written)
    effects, covariance = sized.effects, sized.covariance
    # Errors that are not in the file remain: causes that are not promised, and unexplained residuals.
    not_promised = sum(
        float(np.nansum(in_um(network, sized.estimate.signature[:, k]) ** 2) / len(data))
        for k, doubt in enumerate(sized.doubts)
        if doubt and doubt != JUMPED
    ) + sum(float(np.nansum(one.moved_um**2) / len(data)) for one in sized.indistinct)
    pattern_um = 0.0 if unexplained is None or not unexplained.depends_on else unexplained.size_um
    unseen = 0.0
    if extension is not None and extension.effects:
        effects = [*effects, *extension.effects]
        covariance = Covariance.of_blocks([covariance, extension.covariance])
        pattern_um = extension.left_um
        # The true pattern is larger than the most likely one by its uncertainty, so that is part of the machine's error too.
        unseen = error_at_tool(data, machine, extension.effects, extension.covariance)[1]
    moved, doubt_um = error_at_tool(data, machine, effects, covariance)
    remaining = not_promised + 3.0 * pattern_um**2
    at_tool = float(np.sqrt(moved**2 + unseen**2 + remaining)), float(np.sqrt(doubt_um**2 + remaining))
    before, after = (rms(residual_um, network.read) for residual_um in residuals)
    if not max(at_tool) <= LARGEST_UM:
        at_tool = float("nan"), float("nan")
    return Gain(before, after, held, *at_tool, machine.tool_length_mm or DEFAULT_TOOL_MM)


def residuals_as_written(
    problem: Problem, extended: Calibration, instrument: np.ndarray, root: np.ndarray
) -> np.ndarray:
    """Return the (n, 3) residuals in µm with a calibration as written, the set-up refitted; NaN where no coordinate was measured.

    The whitened effect (3n,) of instrument errors is subtracted first; the discrepancy (its root) is in the weights of the set-up.
    """
    network = problem.network.with_discrepancy(root)
    as_written = Network(
        network.machine, network.data, network.instruments, network.unknowns, extended, network.covariance, check=False
    )
    setup = solve(as_written, np.zeros(0), problem.setup, np.ones(len(network.data))).setup
    columns = np.empty((len(setup) + 1, len(network.data), 3))
    for chunk in as_written.chunks(np.zeros(0), setup):
        columns[:, chunk.rows] = chunk.columns
    columns[:-1] *= setup.plausible[:, None, None]
    *_, residual = flat = columns.reshape(len(columns), -1)
    moved = unwhiten(problem.network, instrument.reshape(-1, 3)[:, :, None])
    residual -= (network.whitening @ moved).reshape(-1)
    basis, _ = setup_basis(flat[:-1].T)
    return in_um(as_written, residual - basis @ (basis.T @ residual))


def error_at_tool(
    data: Measurements, machine: Machine, effects: Sequence[Effect], covariance: Covariance
) -> tuple[float, float]:
    """Return the RMS error at the tool over the volume with the given and with the extended calibration, on the extended machine.

    With the given calibration the effects themselves remain, to first order; with the extended one their uncertainty. The volume is
    limited to the ranges of empirical effects; temperatures and times are those of the measurements.
    """
    if not effects:
        return 0.0, 0.0
    positions = _inside(volume(machine, 400), machine, effects)
    rng = np.random.default_rng(16907)
    sides = rng.choice([-1.0, 1.0], (len(machine.axes), len(positions)))
    rows = rng.integers(0, len(data), len(positions))
    measured = machine_state(data, machine)
    state: dict[str, Any] = {name: values[rows] for name, values in measured.items()}
    state |= {f"approach_{name}": side for name, side in zip(machine.names, sides, strict=True)}
    state |= {axis.name: positions[:, i] for i, axis in enumerate(machine.axes)}
    at_tip = Kinematics(machine, Calibration.zero(machine), tool_length_mm=machine.tool_length_mm or DEFAULT_TOOL_MM)
    by_error = at_tip.sensitivities(positions).error[:, :3]
    index = {(frame.axis, frame.role): 6 * i for i, frame in enumerate(machine.frames)}

    def moved(effect: Effect, components: Mapping[int, Any]) -> np.ndarray:
        at, shift = index[effect.frame.axis, effect.frame.role], np.zeros((len(positions), 3))
        for i, value in components.items():
            # Effects that depend on earlier readings were evaluated on all readings in their order.
            values = np.asarray(value, dtype=float)[rows] if effect.history else np.asarray(value, dtype=float)
            shift += by_error[:, :, at + i] * np.broadcast_to(values, len(positions))[:, None]
        return shift

    whole = np.zeros((len(positions), 3))
    by_parameter: dict[str, np.ndarray] = {}
    for effect in effects:
        at_effect = measured if effect.history else state
        whole += moved(effect, effect.components(at_effect))
        for parameter, derivative in zip(effect.parameters, effect.derivatives(at_effect), strict=True):
            # Effects in several frames share the parameters of an added load.
            by_parameter[parameter.name] = by_parameter.get(parameter.name, 0.0) + moved(effect, derivative)
    known = [name for name in covariance.names if name in by_parameter]
    columns = np.stack([np.zeros_like(whole), *(by_parameter[name] for name in known)], axis=2)[:, :, 1:]
    variance = np.sum((columns @ covariance.of(known).matrix) * columns, axis=(1, 2))
    return float(np.sqrt(np.mean(np.sum(whole**2, axis=1)))), float(np.sqrt(np.mean(np.maximum(variance, 0.0))))


def _inside(positions: np.ndarray, machine: Machine, effects: Sequence[Effect]) -> np.ndarray:
    """Return (n, axes) positions of the volume, scaled into the ranges of the empirical effects."""
    clipped = np.array(positions)
    for i, axis in enumerate(machine.axes):
        ranges = [
            limits
            for effect in effects
            if isinstance(effect, Empirical)
            for column, limits in effect.ranges.items()
            if channel_name(column) == axis.name
        ]
        span = np.ptp(positions[:, i])
        if ranges and span > 0.0:
            low, high = max(limits[0] for limits in ranges), min(limits[1] for limits in ranges)
            clipped[:, i] = low + (positions[:, i] - positions[:, i].min()) / span * (high - low)
    return clipped
