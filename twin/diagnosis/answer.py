"""From the causes to the result: unexplained residuals, the extended calibration with its limits, and what is not identifiable.

Residuals that the causes do not explain are either unnamed patterns or excess noise. A cause that is not identifiable is confounded
with the set-up or with the uncertainty of the calibration; the result says with which. The entries of the given calibration stay; the
readings add what they could not determine, and their residuals replace the stated ones if every axis moved, or if they are worse.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from textwrap import wrap
from types import MappingProxyType
from typing import Any, Final, Literal, final

import numpy as np

from twin._common.arrays import largest_first, read_only
from twin._common.distributions import chi2_sf, f_sf
from twin._common.messages import Message, joined, say
from twin._common.provenance import warning_texts
from twin._common.units import UM
from twin.diagnosis import text as words
from twin.diagnosis.alternatives import points_to_measure
from twin.diagnosis.candidates.candidate import LARGEST_ERROR
from twin.diagnosis.causes import (
    NEGLIGIBLE_EXCESS,
    SMALL_EXCESS,
    SizedCauses,
    causes_with_alternatives,
    causes_with_payloads,
    misshapen,
    notices,
    readback_causes,
)
from twin.diagnosis.forms import LEAST_NONCENTRALITY, Candidates, Form
from twin.diagnosis.gain import EmpiricalExtension, error_at_tool, extend, gain, only_predicting, residuals_as_written
from twin.diagnosis.likelihood import PatternTest, scan_patterns
from twin.diagnosis.problem import Problem, in_um, rms, unwhiten
from twin.diagnosis.readings import ReadingNoise
from twin.diagnosis.result import Cause, DiagnosisResult, Trend, Unexplained, Verdict, readable_unit
from twin.diagnosis.structure import Findings
from twin.display import note, table
from twin.display.numbers import listed, lower, p_value_text, with_joined_units
from twin.display.results import Display, DisplayedResult
from twin.identification.network import Network
from twin.identification.result import FEWEST_DOF
from twin.identification.solve import setup_unknowns
from twin.measurement.columns import CARRIERS, assumptions, grouped_notes, overstated_noise
from twin.measurement.observation import has_times
from twin.model.calibration import Calibration
from twin.model.calibration_file import MeasuredWith, MisfitEntry, UnidentifiedEntry
from twin.model.effects import split_name
from twin.model.effects.entries import load_notices
from twin.model.effects.gravity_compliance import SIDE_NAMES
from twin.model.unknown_errors import at_rest
from twin.numerics.covariance import Covariance
from twin.numerics.observability import Unknown, determinability


@final
@dataclass(frozen=True, repr=False)
class Diagnosis(DisplayedResult, DiagnosisResult):
    """The errors that measured data show beyond the model, and their causes; see `DiagnosisResult` for the numbers."""

    def to_text(self) -> str:
        """Return the diagnosis in words, in lines of at most 100 characters."""
        return diagnosis_text(self)

    @property
    def brief(self) -> str:
        """Verdict, residuals and causes."""
        residuals = (
            f"RMS residual {self.rms_um:.3g} µm per coordinate, {self.expected_rms_um:.3g} µm expected from noise"
        )
        causes = listed([words.symbol(cause.effect, cause.where) for cause in self.causes])
        return f"{self.verdict}: {residuals}{f'; {causes}' if causes else ''}"

    def display(self) -> Display:
        """Return verdict, causes and advice."""
        return diagnosis_display(self)


VERDICTS: Final = ("consistent", "untested", "larger", "systematic")  # verdicts on the residuals, the best first


Keys = Sequence[tuple[str, str]]


def with_limits(diagnosis: Diagnosis, network: Network, indistinct: Mapping[tuple[str, str], Keys]) -> Diagnosis:
    """Return the diagnosis with the limits of its extended calibration stated in the calibration.

    ``indistinct``: causes that are not named because of their many alternatives, with these.
    """
    extended, data = diagnosis.extended, network.data
    given = {error.name for error in extended.not_identifiable}
    unknown = {name: why for name, why in _unknown(diagnosis, indistinct) if name not in given}
    tool, work = (len(set(data.target[data.carrier == side].tolist())) for side in CARRIERS)
    set_up = MeasuredWith(
        stations=len(set(data.station.tolist())), targets_on_tool=tool, targets_on_work=work, points=len(data)
    )
    limited = replace(
        extended,
        instruments=tuple(
            dict.fromkeys((*extended.instruments, *(instrument.name for instrument in network.instruments.every)))
        ),
        set_up=extended.set_up or set_up,
        misfit=_misfit(diagnosis, network),
        not_identifiable=(
            *extended.not_identifiable,
            *(UnidentifiedEntry(name=name, why=why) for name, why in unknown.items()),
        ),
    )
    return replace(diagnosis, extended=limited)


def _unknown(diagnosis: Diagnosis, indistinct: Mapping[tuple[str, str], Keys]) -> Iterator[tuple[str, str]]:
    """Yield the errors that the readings could not determine and the calibration does not know, with the reason."""
    calibration, extended = diagnosis.calibration, diagnosis.extended
    machine = extended.machine
    every = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    known = {name.partition("[")[0] for name in extended.covariance.names}
    unclear = {(cause.effect, cause.where): cause.equivalent for cause in diagnosis.causes}
    yield from (
        (where, f"cannot be separated from {' '.join(key)}")
        for key, alternatives in (unclear | dict(indistinct)).items()
        for _, where in alternatives
        if where in every and where not in known
    )
    for cause in diagnosis.causes:
        if not cause.promised and cause.where in every and cause.where not in known:
            yield cause.where, "found in the readings, but not determined between the measured positions"
    if calibration.set_up is not None or calibration.instruments:
        return
    # A calibration that does not say how it was measured: an absent error may be unknown instead of negligible.
    positions, values = diagnosis.data.positions, {effect.name for effect in extended.effects}
    for name in every:
        axis = split_name(name)[2]
        if name not in values and not np.ptp(positions[:, machine.names.index(axis)]) > 0.0:
            yield name, at_rest(axis)
    for (_, where), why in diagnosis.looks_like.items():
        if where in every and where not in values:
            yield where, why


def _misfit(diagnosis: Diagnosis, network: Network) -> MisfitEntry:
    """Return the residuals of the readings with the extended calibration, or the given ones if the readings cannot replace them."""
    verdict, says = _verdict_within_limits(diagnosis)
    after, dof = np.nan_to_num(diagnosis.after_um), diagnosis.dof
    chi2 = float(np.einsum("ni,nij,nj->", after, diagnosis.precision, after))
    held_out = None if diagnosis.gain is None else diagnosis.gain.held_out
    measured = MisfitEntry(
        verdict=verdict,
        says=says,
        rms_um=rms(diagnosis.after_um, network.read),
        reduced_chi2=chi2 / dof if dof > 0 else None,
        dof=max(dof, 0),
        held_out_rms_um=None if held_out is None else held_out.after_um,
    )
    given = diagnosis.calibration.misfit
    every_axis_moved = bool(np.all(np.ptp(diagnosis.data.positions, axis=0) > 0.0))
    if given is None or every_axis_moved or VERDICTS.index(verdict) >= VERDICTS.index(given.verdict):
        return measured
    return given


def _verdict_within_limits(
    diagnosis: Diagnosis,
) -> tuple[Literal["consistent", "systematic", "larger", "untested"], str]:
    """Return whether the extended calibration fits the readings, and what it leaves, in words."""
    unexplained, machine = diagnosis.unexplained, [cause for cause in diagnosis.causes if cause.origin == "machine"]
    absent = [f"{cause.effect} {cause.where}" for cause in machine if not cause.promised]
    unsure = [
        f"{cause.effect} {cause.where} cannot be separated from {listed(cause.alternatives(lambda *key: ' '.join(key)))}"
        for cause in diagnosis.causes
        if cause.equivalent
    ]
    says = [f"{listed(absent)} found, but not in this calibration"] if absent else []
    written = unexplained is not None and unexplained.extension is not None and unexplained.extension.written
    if unexplained is not None:
        says.append(f"{unexplained.evidence}{'; an empirical effect describes it' if written else ''}")
    text = "; ".join([*says, *unsure])
    if absent or (unexplained is not None and unexplained.depends_on and not written):
        return "systematic", text
    if unexplained is not None and not written:
        return "larger", text
    return ("untested" if diagnosis.dof < FEWEST_DOF else "consistent"), text


MOSTLY_EXPLAINED: Final = 0.1  # share of the excess that may remain unexplained for the verdict ``explained``
MOST_RANKED: Final = 12  # largest number of causes in the ranking


def conclude(sized: SizedCauses, calibration: Calibration, *, empirical: bool = False) -> Diagnosis:
    """Return the complete diagnosis: the causes with their alternatives, what they leave, and what modelling them gains."""
    sized, all_sized = only_predicting(sized), sized
    findings, forms = sized.findings, sized.forms
    task, candidates, problem = findings.task, findings.candidates, findings.problem
    by_noise, network = task.by_noise, problem.network
    predict = sized is all_sized
    named, comparison = causes_with_alternatives(sized, calibration)
    read_too_early, undecided = readback_causes(candidates, forms)
    named, loads = causes_with_payloads(candidates, forms, named)
    order = [k for k in largest_first(np.array([cause.share for cause in named])).tolist() if k not in sized.jumped]
    named = [named[k] for k in order]
    wanted = points_to_measure(findings.given_patterns, findings.beside_patterns([forms[k] for k in order]), named)
    said = (*notices(sized, comparison, undecided), *_indistinct(sized), *load_notices(sized.effects, network.machine))
    causes = (*named, *read_too_early, *loads)
    unexplained = _jump(sized) or _unexplained(sized)
    extension = extend(sized, calibration) if empirical and unexplained is not None else None
    if unexplained is not None and extension is not None:
        unexplained = replace(unexplained, extension=extension.extension)
    extended = _extended(sized, causes, calibration, extension)
    changed = bool(len(sized.jumped) < len(forms) or extended is not calibration)
    subtracted = [k for k, effects in enumerate(sized.estimate.effects) if not effects and k not in sized.jumped]
    by_instrument = sized.estimate.signature[:, subtracted].sum(axis=1)
    residual = in_um(network, problem.residual)
    after = residuals_as_written(problem, extended, by_instrument, sized.discrepancy.root) if changed else residual
    hidden = _unidentifiable(findings)
    weights = by_noise.network.whitening
    stated = not np.isfinite(task.noise.dof)
    overstated = overstated_noise(rms(residual, network.read), by_noise.chi2, by_noise.dof) if stated else ()
    by_patterns = [float(np.exp(test.log_p_corrected)) for test in findings.structure.pattern_tests]
    diagnosis = Diagnosis(
        verdict=_verdict(
            causes,
            unexplained,
            disagree=comparison.disagree or any(sized.temperatures),
            predict=predict and not misshapen(sized, unexplained),
        ),
        rms_um=rms(residual, network.read),
        absorbed_rms_um=rms(in_um(by_noise.network, by_noise.projected), network.read),
        expected_rms_um=_expected_um(by_noise),
        points=len(network.data),
        dof=problem.dof,
        p_value=min([_p_value(by_noise, task.noise), *by_patterns, *(cause.p_value for cause in causes)]),
        causes=causes,
        unexplained=unexplained,
        unidentifiable=tuple(hidden),
        looks_like=MappingProxyType(hidden),
        not_evaluated=task.catalogue.not_evaluated,
        next_measurement=wanted,
        trends=_trends(findings),
        ranking=_ranking(candidates),
        gain=gain(sized, (residual, after), unexplained, extension) if changed else None,
        tried=len(task.catalogue.candidates),
        noise_source=task.noise.source,
        calibration=calibration,
        extended=extended,
        data=replace(network.data, notices=(*network.data.notices, *overstated, *said)),
        residual_um=read_only(residual),
        after_um=read_only(after),
        directions=read_only(unwhiten(network, problem.view.by_base)),
        precision=read_only(np.einsum("nki,nkj->nij", weights, weights) * UM**2),
    )
    return with_limits(diagnosis, network, {one.keys[0]: one.keys for one in sized.indistinct})


def _extended(
    sized: SizedCauses, causes: Sequence[Cause], calibration: Calibration, extension: EmpiricalExtension | None
) -> Calibration:
    """Return the calibration extended by the promised causes and by the empirical effects, if any."""
    effects, covariance = sized.effects, sized.covariance
    if extension is not None:
        effects = [*effects, *extension.effects]
        # As independent blocks: the covariance of the causes already contains the influence of the patterns.
        covariance = Covariance.of_blocks([covariance, extension.covariance])
    if not effects:
        return calibration
    # An error that was unknown and cannot be separated from others stays unknown: it has a value, and its plausible range.
    unclear = {cause.where for cause in causes if cause.equivalent}
    unclear &= {error.name for error in calibration.not_identifiable}
    covariance = covariance.where(lambda name: name.partition("[")[0] not in unclear)
    data = sized.findings.problem.network.data
    source = "extended by twin diagnose from " + data.source
    return calibration.extended(effects, covariance, source, simulated=data.simulated)


def _verdict(causes: Sequence[Cause], unexplained: Unexplained | None, *, disagree: bool, predict: bool) -> Verdict:
    if not predict or (unexplained is not None and unexplained.share > MOSTLY_EXPLAINED):
        return "unexplained"
    if disagree or any(cause.equivalent for cause in causes):
        return "ambiguous"
    return "explained" if causes else "consistent"


def _indistinct(sized: SizedCauses) -> list[Message]:
    """Return a notice on each small cause that is not named: too many others fit as well, or it may not be there."""
    network, texts = sized.findings.problem.network, []
    for one in sized.indistinct:
        most_um = np.linalg.norm(np.nan_to_num(one.moved_um), axis=1).max(initial=0.0)
        tool_um, _ = error_at_tool(network.data, network.machine, one.effects, Covariance.none())
        at_tool = Message(", {size} RMS at the tool", size=words.micrometres(tool_um)) if one.effects else ""
        size = Message("up to {size} in the readings{tool}, at most", size=words.micrometres(most_um), tool=at_tool)
        names = [words.symbol(*key) for key in one.keys]
        if one.probability is None:
            texts.append(
                Message(
                    "something small is not named: {size} {share} of the excess; {count} causes fit it equally well ({names})",
                    size=size,
                    share=words.percent(NEGLIGIBLE_EXCESS),
                    count=len(names),
                    names=listed(names, most=4),
                )
            )
        else:
            instead = Message(" (or {names})", names=listed(names[1:], most=3)) if names[1:] else ""
            texts.append(
                Message(
                    "possible, but not named: {name}{instead}; {size} {share} of the excess; {likelihood}",
                    name=names[0],
                    instead=instead,
                    size=size,
                    share=words.percent(SMALL_EXCESS),
                    likelihood=words.likelihood_words(one.probability, not instead),
                )
            )
    return texts


def _unidentifiable(findings: Findings) -> dict[tuple[str, str], str]:
    """Return the candidates that the data cannot show, with what each is confounded with."""
    candidates, task = findings.by_noise, findings.task
    shown: dict[tuple[str, str], bool] = {}
    for form, dof in zip(candidates.forms, candidates.scan([])[1], strict=True):
        shown[form.key] = shown.get(form.key, False) or dof > 0
    hidden = [candidate.key for candidate in task.catalogue.candidates if not shown.get(candidate.key, True)]
    why = looks_like(task.by_noise, [form for form in candidates.forms if form.key in set(hidden)])
    return {key: why[key] for key in hidden}


def _ranking(candidates: Candidates) -> tuple[tuple[str, str, float, float], ...]:
    best: dict[tuple[str, str], tuple[float, float]] = {}
    scores = candidates.scores([], range(len(candidates.forms)))
    for form, (explained, _, log_p) in zip(candidates.forms, scores.tolist(), strict=True):
        if log_p < best.get(form.key, (0.0, 1.0))[1]:
            best[form.key] = explained, log_p
    ranked = sorted(best.items(), key=lambda entry: (entry[1][1], -entry[1][0]))[:MOST_RANKED]
    return tuple((*key, explained, candidates.p_value(log_p)) for key, (explained, log_p) in ranked)


SEEN_AT: Final = 0.05  # p-value below which a trend of the residuals with a column is reported
NOISE_P_VALUE: Final = 1e-4  # p-value of the residuals from which on they count as noise


def _jump(sized: SizedCauses) -> Unexplained | None:
    """Return the jump of a whole side as unexplained: the machine may have jumped, or what holds all its targets; None if none did."""
    findings, jumped = sized.findings, list(sized.jumped)
    if not jumped:
        return None
    problem, data = findings.problem, findings.problem.network.data
    share = float(sized.shares[jumped].sum())
    shift = sized.estimate.signature[:, jumped].sum(axis=1)
    size = rms(in_um(problem.network, problem.project(shift)), problem.network.read)
    side = str(data.carrier[np.argmax(np.any(shift.reshape(-1, 3) != 0.0, axis=1))])
    lines = [sized.forms[k].variant.fixed.get("line", 0.0) for k in jumped]
    moment = (
        Message("between lines {first:.0f} and {last:.0f}", first=min(lines), last=max(lines))
        if min(lines) < max(lines)
        else Message("at line {line:.0f}", line=lines[0])
    )
    if min(lines) == 0.0:
        rounds = listed(sorted({sized.forms[k].key[1].rpartition("round ")[2] for k in jumped}))
        moment = Message("in round {rounds}", rounds=rounds)
    text = Message(
        "all targets on the {side} side jumped {moment}, {size:.2g} µm RMS per coordinate, {share} of the excess; no "
        "known effect does "
        "so: the {side} side was displaced (a collision, a lost reference), or what holds all its targets",
        side=SIDE_NAMES[side],
        moment=moment,
        size=size,
        share=words.percent(share),
    )
    return Unexplained(share, ("time_s",) if has_times(data) else ("round",), side, text, size, jump=moment)


def _unexplained(sized: SizedCauses) -> Unexplained | None:
    """Return the unexplained residuals: unnamed patterns, or excess noise; None if they are compatible with noise."""
    findings, forms = sized.findings, sized.forms
    problem, structure, by_noise = findings.problem, findings.structure, findings.task.by_noise
    read, signature = problem.network.read, sized.estimate.signature.sum(axis=1)
    residual_um = rms(in_um(problem.network, problem.project(problem.residual - signature)), read)
    if structure.pattern_tests:
        patterns = [test.pattern for test in structure.pattern_tests]
        patterns_um = in_um(problem.network, structure.pattern(forms))
        # Beside the patterns, what counts as discrepancy is unexplained as well.
        share = max(sized.share_of_patterns, sized.share_left if findings.task.discrepancy.parts else 0.0)
        columns = tuple(dict.fromkeys(name for pattern in patterns for name in pattern.names))
        sides = {pattern.side for pattern in patterns}
        carrier = sides.pop() if len(sides) == 1 else "both"
        # No larger than what the causes leave: readings that do not determine a pattern leave its expected size to its prior.
        size = min(rms(np.nan_to_num(patterns_um), read), residual_um)
        text = Message(
            "a pattern that depends on {columns} ({side}), {size:.2g} µm RMS per coordinate, {share} of the excess, "
            "matches no known "
            "effect",
            columns=listed(columns, most=len(columns)),
            side=words.side(carrier),
            size=size,
            share=words.percent(share),
        )
        or_on = tuple(dict.fromkeys(names for test in structure.pattern_tests for names in test.rivals))
        return Unexplained(share, columns, carrier, text, size, or_on)
    p_value = _p_value(by_noise, findings.task.noise, sized.chi2_left, len(forms))
    if p_value >= NOISE_P_VALUE or (forms and sized.share_left <= NEGLIGIBLE_EXCESS):
        return None
    size = float(np.sqrt(max(residual_um**2 - _expected_um(by_noise) ** 2, 0.0)))
    text = (
        Message(
            "the residuals exceed the stated noise even with the causes in the model, without a pattern in any column"
        )
        if forms
        else Message("the residuals exceed the stated noise, without a pattern in any column of the table")
    )
    return Unexplained(sized.share_left, (), "both", text, size)


def _trends(findings: Findings) -> tuple[Trend, ...]:
    """Return the columns that the residuals depend on, one by one, before any cause is fitted."""
    single = [pattern for pattern in findings.patterns if len(pattern.channels) == 1 and pattern.field == "base"]
    best: dict[tuple[str, str], PatternTest] = {}
    for test in scan_patterns(findings.task.by_noise, single, (), findings.task.noise.dof):
        best.setdefault((test.pattern.side, test.pattern.names[0]), test)
    return tuple(
        Trend(column, side, test.explained, float(np.exp(test.log_p_corrected)))
        for (side, column), test in best.items()
        if test.log_p_corrected < np.log(SEEN_AT)
    )


def _p_value(problem: Problem, noise: ReadingNoise, chi2: float | None = None, fitted: int = 0) -> float:
    """Return the p-value of the residuals without any cause, or of a given χ² after fitting some parameters."""
    chi2, dof = problem.chi2 if chi2 is None else chi2, max(problem.dof - fitted, 1)
    if np.isfinite(noise.dof):
        return float(f_sf(chi2 / dof, dof, noise.dof))
    return float(chi2_sf(chi2, dof))


def _expected_um(problem: Problem) -> float:
    """Return the RMS residual per coordinate expected from measurement noise, µm."""
    variances = np.einsum("nii->ni", problem.network.covariance)[problem.network.read]
    return float(np.sqrt(np.mean(variances) * problem.dof / problem.readings)) * 1e6


ITSELF: Final = "itself"


def looks_like(problem: Problem, forms: Sequence[Form]) -> dict[tuple[str, str], str]:
    """Return for each candidate that is not identifiable what it is confounded with, in words."""
    every = list(dict.fromkeys((form.key, column) for form in forms for column in form.variant.columns))
    if not every:
        return {}
    products = problem.products([column for _, column in every])
    # Little of these columns remains after projecting out the set-up; the basis holds the part that was projected out.
    sizes_of = np.sqrt(np.maximum(np.diag(products.gram), 0.0) + np.sum(products.basis**2, axis=0))
    strongest: dict[tuple[str, str], tuple[float, int]] = {}
    for i, ((key, _), size) in enumerate(zip(every, sizes_of.tolist(), strict=True)):
        if size > strongest.get(key, (-1.0, 0))[0]:
            strongest[key] = size, i
    clearest = [i for _, i in strongest.values()]
    setup = setup_unknowns(problem.setup)
    count, doubt = len(setup), len(problem.nuisances.prior)
    # The whole in the directions of the basis, and the part of the causes orthogonal to it.
    values, vectors = np.linalg.eigh(products.gram[np.ix_(clearest, clearest)])
    beside = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    coordinates = problem.nuisances.coordinates
    whole = np.zeros((len(coordinates) + len(clearest), doubt + count + len(clearest)))
    whole[: len(coordinates)] = np.hstack([coordinates[:, count:], coordinates[:, :count], products.basis[:, clearest]])
    whole[len(coordinates) :, doubt + count :] = beside
    # Triangular, the calibration's uncertainty first: the rows below it hold what that uncertainty does not absorb, and any choice of
    # their columns is a factor of the corresponding part.
    triangle = np.asarray(np.linalg.qr(whole, mode="r"))[doubt:, doubt:]
    # Columns are in plausible sizes; a unit of the cause is at most one millimetre or milliradian.
    sizes = np.array([*(unknown.plausible * unknown.factor for unknown in setup), 1.0])
    unknowns = [*setup, Unknown(ITSELF, "", 1.0)]
    said = {}
    for k, (key, (size, _)) in enumerate(strongest.items()):
        if size**2 <= LEAST_NONCENTRALITY:
            said[key] = "no motion in the measurement shows it"
            continue
        if float(np.linalg.norm(triangle[:, count + k])) ** 2 <= LEAST_NONCENTRALITY:
            said[key] = "the uncertainty of the calibration hides it"
            continue
        columns = np.array([*range(count), count + k])
        observed = determinability(
            triangle[:, columns] / sizes, unknowns, tolerance=float(np.sqrt(LEAST_NONCENTRALITY))
        )
        direction = observed.null_direction_of(ITSELF)
        if direction is None:
            said[key] = "confounded with the stations, the targets and the uncertainty of the calibration together"
            continue
        first, *others = direction.moves
        # The compensating moves, with opposite sign, are what it looks like.
        same = ", ".join(f"{move.name} {-move.value / first.value:+.3g} {move.unit}" for move in others)
        said[key] = f"{LARGEST_ERROR * 1e-3:g} mm or mrad of it is equivalent to {same}"
    return said


# --- A diagnosis as text for the terminal, and as a table for a notebook -----------------------------

WIDTH: Final = 100
ABSORBED_RATIO: Final = 0.9  # of RMS residuals with and without the calibration's uncertainty: below, both are given
HARD_SPACE: Final = "\u00a0"


def diagnosis_text(diagnosis: DiagnosisResult) -> str:  # noqa: C901
    """Return the verdict, each cause, what to do, the gain and what to measure next, in lines of at most `WIDTH` characters."""
    lines = _wrapped(f"{say(words.VERDICTS[diagnosis.verdict])}. {say(words.headline(diagnosis)[0])}.")
    for text in (*warning_texts(diagnosis.warnings), *assumptions(diagnosis.data.notices)):
        lines += _wrapped(say(text), hang=2)
    for cause in diagnosis.causes:
        lines += ["", *_cause(cause)]
    lines.append("")
    for name, text in words.facts(diagnosis):
        lines += _wrapped(f"{say(name)}: {say(text)}", hang=2)
    lines += [
        "",
        *_wrapped(
            Message(
                "RMS residual {rms_um:.3g} µm per coordinate, {expected_rms_um:.3g} µm expected from {noise_source} "
                "({p_value_text}, {tried} causes tested).",
                rms_um=diagnosis.rms_um,
                expected_rms_um=diagnosis.expected_rms_um,
                noise_source=diagnosis.noise_source,
                p_value_text=p_value_text(diagnosis.p_value),
                tried=diagnosis.tried,
            ),
            hang=2,
        ),
    ]
    if diagnosis.absorbed_rms_um < ABSORBED_RATIO * diagnosis.rms_um:
        absorbed = Message(
            "{absorbed_rms_um:.3g} µm remain after allowing for the uncertainty stated in the calibration",
            absorbed_rms_um=diagnosis.absorbed_rms_um,
        )
        lines += _wrapped(absorbed + ".", start=2, hang=2)
    if diagnosis.unexplained is not None:
        lines += _wrapped(Message("Unexplained: {evidence}.", evidence=diagnosis.unexplained.evidence), hang=2)
    lines += _wrapped(words.rest(diagnosis), hang=2)
    lines += _gain(diagnosis)
    compared, beside = words.compared(diagnosis), [o for o in diagnosis.next_measurement if "separates" not in o]
    if compared or beside:
        lines += ["", say("What to measure next")]
    for separating_point in compared:
        lines += _wrapped(
            Message(
                "To separate {names} from {names2}: {verdict}",
                names=lower(separating_point.names[0]),
                names2=lower(separating_point.names[1]),
                verdict=separating_point.verdict,
            ),
            start=2,
            hang=4,
        )
        for pose, sides, target, station, difference in separating_point.rows:
            approached = Message(", approached from {sides}", sides=sides) if sides else ""
            lines += _wrapped(
                Message(
                    "{pose}, target {target}, station {station}{approached}: difference {difference}",
                    pose=pose,
                    target=target,
                    station=station,
                    approached=approached,
                    difference=difference,
                ),
                start=4,
                hang=8,
            )
    for entry in beside:
        lines += _wrapped(entry["text"], start=2, hang=4)
    lines += _listing(
        Message("Not identifiable from these readings, whatever their size:"), words.grouped(diagnosis.unidentifiable)
    )
    lines += _listing(
        Message("Not tested, because the table lacks these columns:"), words.missing(diagnosis.not_evaluated)
    )
    unused = diagnosis.data.set_aside
    if unused:
        lines += _listing(Message("Readings not used ({count}):", count=len(unused)), grouped_notes(unused))
    assumed = assumptions(diagnosis.data.notices)
    lines += _listing(Message("Notes:"), [notice for notice in diagnosis.data.notices if notice not in assumed])
    return "\n".join(lines) + "\n"


def diagnosis_display(diagnosis: DiagnosisResult) -> Display:
    """Return the verdict, a table of the causes and the advice, for a notebook."""
    title, mood = words.headline(diagnosis)
    rows = [
        (
            words.named(cause.effect, cause.where),
            _numbers(cause),
            words.percent(cause.share),
            listed(cause.alternatives(words.cause_title), most=3) or Message("none"),
        )
        for cause in diagnosis.causes
    ]
    warnings = [note(text, loud=True) for text in warning_texts(diagnosis.warnings)]
    causes = table((Message("cause"), Message("size"), Message("share of the excess"), Message("alternatives")), rows)
    return Display(
        title, words.facts(diagnosis), above=(*warnings, causes), small=diagnosis.verdict, wrong=mood != "well"
    )


def _cause(cause: Cause) -> list[str]:
    title = words.cause_title(cause.effect, cause.where)
    text = joined("", [title, f" ({words.symbol(cause.effect, cause.where)}, ", words.ORIGINS[cause.origin], ")"])
    lines = _wrapped(text, hang=2)
    lines += _wrapped(words.sentence(cause), start=4, hang=4)
    if cause.parameters:
        lines += _wrapped(_numbers(cause), start=4, hang=6)
    if cause.share > 0.0:
        lines += _wrapped(
            Message(
                "explains {share} of the excess over noise, {p_value_text}",
                share=words.percent(cause.share),
                p_value_text=p_value_text(cause.p_value),
            ),
            start=4,
            hang=6,
        )
    if cause.probability is not None:
        lines += _wrapped(words.likelihood_words(cause.probability, not cause.equivalent), start=4, hang=6)
    for rival in cause.rivals[:1]:
        lines += _wrapped(
            Message(
                "next best, ruled out: {name}, {odds}",
                name=words.named(rival.effect, rival.where),
                odds=words.odds(rival.log_odds),
            ),
            start=4,
            hang=6,
        )
    if cause.equivalent:
        names = cause.alternatives(words.named)
        lines += _wrapped(Message("fits these readings equally well: {names}", names=listed(names)), start=4, hang=6)
    if cause.assumes:
        lines += _wrapped(cause.assumes, start=4, hang=6)
    return lines


def _numbers(cause: Cause) -> str:
    values = [
        joined(" ", [words.parameter(q.name), words.measured(q.value, q.u, readable_unit(q.unit))])
        for q in cause.parameters
        if not q.coefficient
    ]
    curve = len(cause.parameters) - len(values)
    numbers = [joined("", [joined(", ", values), " (95 %)"])] if values else []
    return joined("; ", [*numbers, *([Message("a curve of {count} coefficients", count=curve)] if curve else [])])


def _gain(diagnosis: DiagnosisResult) -> list[str]:
    gain = diagnosis.gain
    if gain is None:
        return []
    text = Message(
        "RMS residual without → with the causes: {rms_before_um:.3g} → {rms_after_um:.3g} µm",
        rms_before_um=gain.rms_before_um,
        rms_after_um=gain.rms_after_um,
    )
    held = gain.held_out
    if held is not None:
        text += Message(
            "; on held-out {held_out_words} {before_um:.3g} → {after_um:.3g} µm",
            held_out_words=words.held_out_words(held.of),
            before_um=held.before_um,
            after_um=held.after_um,
        )
        if held.ci95_um is not None:
            low, high = held.ci95_um
            text += Message(
                " (reduced by {low} to {high}, 95 %)", low=words.micrometres(low), high=words.micrometres(high)
            )
    if gain.tool_before_um > 0.0:
        text += Message(
            "; compensated, at the tool over the working volume, {before} → {after} RMS",
            before=words.micrometres(gain.tool_before_um),
            after=words.micrometres(gain.tool_after_um),
        )
    return _wrapped(text + ".", hang=2)


def _listing(title: str, items: Sequence[str]) -> list[str]:
    if not items:
        return []
    return ["", say(title), *(line for item in items for line in _wrapped(item, start=2, hang=4))]


def _wrapped(text: str, *, start: int = 0, hang: int = 0) -> list[str]:
    indents: dict[str, Any] = {"initial_indent": " " * start, "subsequent_indent": " " * hang}
    lines = wrap(
        with_joined_units(say(text), HARD_SPACE), WIDTH, **indents, break_long_words=False, break_on_hyphens=False
    )
    return [line.replace(HARD_SPACE, " ") for line in lines]
