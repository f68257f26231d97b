"""From the causes to the result: unexplained residuals, the extended calibration, its gain, and the causes that are not identifiable.

Residuals that the causes do not explain are either unnamed patterns or excess noise. A cause that is not identifiable is confounded
with the set-up or with the uncertainty of the calibration; the result says with which.

The limits of the extended calibration, as it states them: errors that remain unknown, residuals, instruments and set-up.

The entries of the given calibration stay. The readings of the diagnosis add what they could not determine, and their residuals replace
the stated ones if they test the whole calibration, that is if every axis moved, or if they are worse.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal, final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import chi2_sf, f_sf
from twin._common.units import UM
from twin.diagnosis.candidates.candidate import LARGEST_ERROR
from twin.diagnosis.causes import ReportedCauses, SizedCauses
from twin.diagnosis.forms import LEAST_NONCENTRALITY, Candidates, Form
from twin.diagnosis.gain import EmpiricalExtension, extend, gain, residuals_as_written
from twin.diagnosis.likelihood import PatternTest, scan_patterns
from twin.diagnosis.problem import Problem, in_um, rewhitened, rms, unwhiten
from twin.diagnosis.readings import ReadingNoise
from twin.diagnosis.result import DiagnosisResult, Trend, Unexplained, Verdict
from twin.diagnosis.structure import Findings
from twin.diagnosis.text import diagnosis_display, diagnosis_text, symbol
from twin.display.numbers import listed
from twin.display.results import Display, DisplayedResult
from twin.identification.network import Network
from twin.identification.result import FEWEST_DOF
from twin.identification.solve import setup_unknowns
from twin.measurement.checks import overstated_noise
from twin.measurement.columns import CARRIERS
from twin.model.calibration import Calibration
from twin.model.calibration_file import MeasuredWith, MisfitEntry, UnidentifiedEntry
from twin.model.effects import Effect, split_name
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
        causes = listed([symbol(cause.effect, cause.where) for cause in self.causes])
        return f"{self.verdict}: {residuals}{f'; {causes}' if causes else ''}"

    def display(self) -> Display:
        """Return verdict, causes and advice."""
        return diagnosis_display(self)


# --- The limits of the extended calibration, as it states them: errors that remain unknown, residuals, instruments and set-up

VERDICTS: Final = ("consistent", "untested", "larger", "systematic")
"""Verdicts on the residuals, the best first."""


def with_limits(found: Diagnosis, network: Network) -> Diagnosis:
    """Return the diagnosis with the limits of its extended calibration stated in the calibration.

    Args:
        network: the readings and their instruments.
    """
    extended = found.extended
    given = {error.name for error in extended.not_identifiable}
    unknown = {name: why for name, why in _unknown(found) if name not in given}
    return replace(
        found,
        extended=replace(
            extended,
            instruments=tuple(dict.fromkeys((*extended.instruments, *(one.name for one in network.instruments.every)))),
            set_up=extended.set_up or _set_up(network),
            misfit=_misfit(found, network),
            not_identifiable=(
                *extended.not_identifiable,
                *(UnidentifiedEntry(name=name, why=why) for name, why in unknown.items()),
            ),
        ),
    )


def _unknown(found: Diagnosis) -> Iterator[tuple[str, str]]:
    """Yield the errors that the readings could not determine and the calibration does not know, with the reason."""
    machine = found.extended.machine
    every = (*machine.motion_names, *machine.squareness_names, *machine.location_names)
    known = {name.partition("[")[0] for name in found.extended.covariance.names}
    for cause in found.causes:
        for _, where in cause.equivalent:
            if where in every and where not in known:
                yield where, f"cannot be separated from {cause.effect} {cause.where}"
        if not cause.promised and cause.where in every and cause.where not in known:
            yield cause.where, "found in the readings, but not determined between the measured positions"
    if not _is_silent(found.calibration):
        return
    data, values = found.data, {effect.name for effect in found.extended.effects}
    for name in every:
        axis = split_name(name)[2]
        if name not in values and not np.ptp(data.positions[:, machine.names.index(axis)]) > 0.0:
            yield name, at_rest(axis)
    for key, why in found.looks_like.items():
        if key[1] in every and key[1] not in values:
            yield key[1], why


def _is_silent(calibration: Calibration) -> bool:
    """Return whether a calibration does not say how it was measured, so that an absent error may be unknown instead of negligible."""
    return calibration.set_up is None and not calibration.instruments


def _set_up(network: Network) -> MeasuredWith:
    data = network.data
    tool, work = (len(dict.fromkeys(data.target[data.carrier == side].tolist())) for side in CARRIERS)
    stations = len(dict.fromkeys(data.station.tolist()))
    return MeasuredWith(stations=stations, targets_on_tool=tool, targets_on_work=work, points=len(data))


def _misfit(found: Diagnosis, network: Network) -> MisfitEntry:
    """Return the residuals of the readings with the extended calibration, or the given ones if the readings cannot replace them."""
    verdict, says = _verdict_within_limits(found)
    after = np.nan_to_num(found.after_um)
    chi2 = float(np.einsum("ni,nij,nj->", after, found.precision, after))
    held_out = None if found.gain is None else found.gain.held_out
    own = MisfitEntry(
        verdict=verdict,
        says=says,
        rms_um=rms(found.after_um, network.read),
        reduced_chi2=chi2 / found.dof if found.dof > 0 else None,
        dof=max(found.dof, 0),
        held_out_rms_um=None if held_out is None else held_out.after_um,
    )
    before = found.calibration.misfit
    whole = bool(np.all(np.ptp(found.data.positions, axis=0) > 0.0))
    if before is None or whole or VERDICTS.index(own.verdict) >= VERDICTS.index(before.verdict):
        return own
    return before


def _verdict_within_limits(found: Diagnosis) -> tuple[Literal["consistent", "systematic", "larger", "untested"], str]:
    """Return whether the extended calibration fits the readings, and what it leaves, in words."""
    left, machine = found.unexplained, [cause for cause in found.causes if cause.origin == "machine"]
    absent = [f"{cause.effect} {cause.where}" for cause in machine if not cause.promised]
    unsure = [
        f"{cause.effect} {cause.where} cannot be separated from {listed([' '.join(key) for key in cause.equivalent])}"
        for cause in found.causes
        if cause.equivalent
    ]
    says = [f"{listed(absent)} found, but not in this calibration"] if absent else []
    written = left is not None and left.extension is not None and left.extension.written
    if left is not None:
        says.append(f"{left.evidence}{'; an empirical effect describes it' if written else ''}")
    text = "; ".join([*says, *unsure])
    if absent or (left is not None and left.depends_on and not written):
        return "systematic", text
    if left is not None and not written:
        return "larger", text
    return ("untested" if found.dof < FEWEST_DOF else "consistent"), text


# --- From the causes to the result: unexplained residuals, the extended calibration, its gain, and the causes that are not id

MOSTLY_EXPLAINED: Final = 0.1
"""Share of the excess that may remain unexplained for the verdict ``explained``."""
MOST_RANKED: Final = 12
"""Largest number of causes in the ranking."""


def conclude(reported: ReportedCauses, calibration: Calibration, *, empirical: bool = False) -> Diagnosis:
    """Return the complete diagnosis.

    Args:
        reported: the causes as they are reported.
        calibration: the calibration tested.
        empirical: whether unexplained patterns extend the calibration as well.
    """
    sized, estimate = reported.sized, reported.sized.found
    problem, network, by_noise = estimate.problem, estimate.problem.network, estimate.task.by_noise
    misfit = residual_statistics(sized)
    left = misfit.left
    empirical_extension = extend(sized, calibration) if empirical and left is not None else None
    if left is not None and empirical_extension is not None:
        left = replace(left, extension=empirical_extension.extension)
    extended = _extended(reported, calibration, empirical_extension)
    changed = bool(sized.forms or extended is not calibration)
    instrument = sized.estimate.signature[:, [not own for own in sized.estimate.effects]].sum(axis=1)
    residual = in_um(problem.network, problem.residual)
    after = residuals_as_written(problem, extended, instrument, sized.discrepancy.root) if changed else residual
    hidden = _unidentifiable(estimate)
    weights = by_noise.network.whitening
    stated = not np.isfinite(estimate.task.noise.dof)
    overstated = overstated_noise(rms(residual, network.read), by_noise.chi2, by_noise.dof) if stated else ()
    answer = Diagnosis(
        verdict=_verdict(reported, left),
        rms_um=rms(residual, network.read),
        absorbed_rms_um=rms(in_um(by_noise.network, by_noise.projected), network.read),
        expected_rms_um=misfit.expected_um,
        points=len(network.data),
        dof=problem.dof,
        p_value=min([misfit.p_value, *(cause.p_value for cause in reported.causes)]),
        causes=reported.causes,
        unexplained=left,
        unidentifiable=tuple(hidden),
        looks_like=MappingProxyType(hidden),
        not_evaluated=estimate.task.catalogue.not_evaluated,
        next_measurement=reported.next_measurement,
        trends=misfit.trends,
        ranking=_ranking(estimate.candidates),
        # Evaluated last: it resets the pool.
        gain=gain(sized, (residual, after), left, empirical_extension) if changed else None,
        tried=len(estimate.task.catalogue.candidates),
        noise_source=estimate.task.noise.source,
        calibration=calibration,
        extended=extended,
        data=replace(network.data, notices=(*network.data.notices, *overstated, *reported.notices)),
        residual_um=read_only(residual),
        after_um=read_only(after),
        directions=read_only(unwhiten(problem.network, problem.view.by_base)),
        precision=read_only(np.einsum("nki,nkj->nij", weights, weights) * UM**2),
    )
    return with_limits(answer, network)


def _extended(
    reported: ReportedCauses, calibration: Calibration, empirical_extension: EmpiricalExtension | None
) -> Calibration:
    """Return the calibration extended by the promised causes and by the empirical effects, if any."""
    effects: list[Effect] = reported.sized.effects
    covariance = reported.sized.covariance
    if empirical_extension is not None:
        effects = [*effects, *empirical_extension.effects]
        # As independent blocks: the covariance of the causes already contains the influence of the patterns.
        covariance = Covariance.of_blocks([covariance, empirical_extension.covariance])
    if not effects:
        return calibration
    # An error that was unknown and cannot be separated from others stays unknown: it has a value, and its plausible range.
    unclear = {cause.where for cause in reported.causes if cause.equivalent}
    unclear &= {error.name for error in calibration.not_identifiable}
    covariance = covariance.where(lambda name: name.partition("[")[0] not in unclear)
    data = reported.sized.found.problem.network.data
    source = "extended by twin diagnose from " + data.source
    return calibration.extended(effects, covariance, source, simulated=data.simulated)


def _verdict(reported: ReportedCauses, left: Unexplained | None) -> Verdict:
    if left is not None and left.share > MOSTLY_EXPLAINED:
        return "unexplained"
    if not reported.causes:
        return "ambiguous" if reported.disagree else "consistent"
    return "ambiguous" if reported.disagree or any(cause.equivalent for cause in reported.causes) else "explained"


def _unidentifiable(found: Findings) -> dict[tuple[str, str], str]:
    """Return the candidates that the data cannot show, with what each is confounded with."""
    candidates = found.by_noise
    seen: dict[tuple[str, str], bool] = {}
    for form, score in zip(candidates.forms, candidates.scores([], range(len(candidates.forms))), strict=True):
        seen[form.key] = seen.get(form.key, False) or score[1] > 0
    hidden = [candidate.key for candidate in found.task.catalogue.candidates if not seen.get(candidate.key, True)]
    why = looks_like(found.task.by_noise, [form for form in candidates.forms if form.key in set(hidden)])
    return {key: why[key] for key in hidden}


def _ranking(candidates: Candidates) -> tuple[tuple[str, str, float, float], ...]:
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for form, (explained, _, log_p) in zip(
        candidates.forms, candidates.scores([], range(len(candidates.forms))), strict=True
    ):
        if log_p < best.get(form.key, (0.0, 1.0))[1]:
            best[form.key] = float(explained), float(log_p)
    ranked = sorted(best.items(), key=lambda one: (one[1][1], -one[1][0]))[:MOST_RANKED]
    return tuple(
        (effect, where, explained, candidates.p_value(log_p)) for (effect, where), (explained, log_p) in ranked
    )


SEEN_AT: Final = 0.05
"""p-value below which a trend of the residuals with a column is reported."""
NOISE_P_VALUE: Final = 1e-4
"""p-value of the residuals from which on they count as noise."""
NEGLIGIBLE_EXCESS: Final = 0.01
"""Share of the excess below which unexplained residuals are not a finding: real machines always have some."""


@final
@dataclass(frozen=True)
class ResidualStatistics:
    """The residuals of all readings.

    Attributes:
        p_value: of the residuals without any cause.
        expected_um: RMS per coordinate expected from measurement noise.
        trends: columns that the residuals depend on, one by one, before any cause is fitted.
        left: unexplained residuals; None if they are compatible with noise.
    """

    p_value: float
    expected_um: float
    trends: tuple[Trend, ...]
    left: Unexplained | None


def residual_statistics(sized: SizedCauses) -> ResidualStatistics:
    """Return the statistics of the residuals, and those the causes do not explain.

    Args:
        sized: the causes with their sizes.
    """
    estimate = sized.found
    problem = estimate.task.by_noise
    chances = [
        _p_value(problem, estimate.task.noise),
        *(float(np.exp(t.log_p_corrected)) for t in estimate.structure.pattern_tests),
    ]
    return ResidualStatistics(min(chances), _expected_um(problem), _trends(estimate), _unexplained(sized))


def _unexplained(sized: SizedCauses) -> Unexplained | None:
    """Return the unexplained residuals: unnamed patterns, or excess noise."""
    estimate, forms, excess = sized.found, sized.forms, sized.excess
    problem, structure, by_noise = estimate.problem, estimate.structure, estimate.task.by_noise
    left = by_noise.residual - rewhitened(sized.estimate.signature.sum(axis=1), problem.network, by_noise.network)
    after = float(left @ by_noise.project(left))
    left_share = float((after - problem.dof) / max(by_noise.chi2 - problem.dof, 1e-30)) if forms else 1.0
    weighted = problem.residual - sized.estimate.signature.sum(axis=1)
    left_um = rms(in_um(problem.network, problem.project(weighted)), problem.network.read)
    if structure.pattern_tests:
        patterns_um = in_um(problem.network, structure.pattern(forms))
        share = float(np.clip(structure.explained(forms) / excess, 0.0, 1.0))
        columns = tuple(
            dict.fromkeys(name for pattern_test in structure.pattern_tests for name in pattern_test.pattern.names)
        )
        sides = {pattern_test.pattern.side for pattern_test in structure.pattern_tests}
        carrier = sides.pop() if len(sides) == 1 else "both"
        # No larger than what the causes leave: readings that do not determine a pattern leave its expected size to its prior.
        size = min(rms(np.nan_to_num(patterns_um), problem.network.read), left_um)
        text = (
            f"a pattern that depends on {' and '.join(columns)} on the {carrier} side, {size:.2g} µm RMS per coordinate, "
            f"{100 * share:.2g} % of the excess, matches no known effect"
        )
        # Beside the patterns, what counts as discrepancy is unexplained as well.
        return Unexplained(
            max(share, left_share) if estimate.task.discrepancy.parts else share, columns, carrier, text, size
        )
    more = _p_value(by_noise, estimate.task.noise, after, len(forms))
    if more >= NOISE_P_VALUE or (forms and left_share <= NEGLIGIBLE_EXCESS):
        return None
    size = float(np.sqrt(max(left_um**2 - _expected_um(by_noise) ** 2, 0.0)))
    what = "the residuals exceed the stated noise" + (" even with the causes in the model" if forms else "")
    return Unexplained(left_share, (), "both", f"{what}, without a pattern in any column of the table", size)


def _trends(found: Findings) -> tuple[Trend, ...]:
    """Return the columns that the residuals depend on, one by one, before any cause is fitted."""
    single = [pattern for pattern in found.patterns if len(pattern.channels) == 1]
    best: dict[tuple[str, str], PatternTest] = {}
    for pattern_test in scan_patterns(
        found.task.by_noise, [one for one in single if one.field == "base"], (), found.task.noise.dof
    ):
        best.setdefault((pattern_test.pattern.side, pattern_test.pattern.names[0]), pattern_test)
    return tuple(
        Trend(column, side, pattern_test.explained, float(np.exp(pattern_test.log_p_corrected)))
        for (side, column), pattern_test in best.items()
        if pattern_test.log_p_corrected < np.log(SEEN_AT)
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
    """Return for each candidate that is not identifiable what it is confounded with, in words.

    Args:
        problem: the data.
        forms: all forms of these candidates.
    """
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
    own = [i for _, i in strongest.values()]
    setup = setup_unknowns(problem.setup)
    count, doubt = len(setup), len(problem.prior)
    # The whole in the directions of the basis, and the part of the causes orthogonal to it.
    values, vectors = np.linalg.eigh(products.gram[np.ix_(own, own)])
    beside = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    whole = np.zeros((len(problem.nuisance_coordinates) + len(own), doubt + count + len(own)))
    whole[: len(problem.nuisance_coordinates)] = np.concatenate(
        [problem.nuisance_coordinates[:, count:], problem.nuisance_coordinates[:, :count], products.basis[:, own]],
        axis=1,
    )
    whole[len(problem.nuisance_coordinates) :, doubt + count :] = beside
    # Triangular, the calibration's uncertainty first: the rows below it hold what that uncertainty does not absorb, and any choice of
    # their columns is a factor of the corresponding part.
    left = np.asarray(np.linalg.qr(whole, mode="r"))[doubt:, doubt:]
    # Columns are in plausible sizes; a unit of the cause is at most one millimetre or milliradian.
    sizes = np.array([*(one.plausible * one.factor for one in setup), 1.0])
    unknowns = [*setup, Unknown(ITSELF, "", 1.0)]
    said = {}
    for k, (key, (size, _)) in enumerate(strongest.items()):
        if size**2 <= LEAST_NONCENTRALITY:
            said[key] = "no motion in the measurement shows it"
            continue
        if float(np.linalg.norm(left[:, count + k])) ** 2 <= LEAST_NONCENTRALITY:
            said[key] = "the uncertainty of the calibration hides it"
            continue
        columns = np.array([*range(count), count + k])
        observed = determinability(left[:, columns] / sizes, unknowns, tolerance=float(np.sqrt(LEAST_NONCENTRALITY)))
        direction = observed.null_direction_of(ITSELF)
        if direction is None:
            said[key] = "confounded with the stations, the targets and the uncertainty of the calibration together"
            continue
        first, *others = direction.moves
        # The compensating moves, with opposite sign, are what it looks like.
        same = ", ".join(f"{move.name} {-move.value / first.value:+.3g} {move.unit}" for move in others)
        said[key] = f"{LARGEST_ERROR * 1e-3:g} mm or mrad of it is equivalent to {same}"
    return said
