"""From the causes to the answer: what is left, the extended calibration, what it gains, and what these data could not show.

What the causes leave is either patterns without a name or more scatter than stated. A cause that data could not show, however large,
looks like something of the set-up or of the calibration's own uncertainty: which, is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np

from twin._common.arrays import locked
from twin._common.distributions import chi2_sf, f_sf
from twin._common.units import UM
from twin.diagnosis.candidates.signatures import LARGEST
from twin.diagnosis.diagnosis import Diagnosis
from twin.diagnosis.judgement.causes import Judged
from twin.diagnosis.judgement.extend import Extended, extend
from twin.diagnosis.judgement.gain import gain, of_file
from twin.diagnosis.judgement.sizes import Sized
from twin.diagnosis.problem.forms import LEAST_NONCENTRALITY, Candidates, Form
from twin.diagnosis.problem.noise import ReadingNoise
from twin.diagnosis.problem.problem import Problem, rms, unwhiten, unwhitened_um
from twin.diagnosis.result import Trend, Unexplained, Verdict
from twin.diagnosis.selection.structure import Findings
from twin.diagnosis.selection.unnamed import Trace, scan
from twin.identification.solve import named_setup
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.numerics.covariance import Covariance
from twin.numerics.observability import Unknown, determinability

MOSTLY_EXPLAINED: Final = 0.1
"""Share of the excess that causes may leave and still count as the explanation."""
RANKED: Final = 12


def answer(judged: Judged, calibration: Calibration, *, empirical: bool = False) -> Diagnosis:
    """The whole answer.

    Args:
        judged: the causes as they are reported.
        calibration: the model that was judged.
        empirical: whether what is left unexplained extends the calibration as well.
    """
    sized, found = judged.sized, judged.sized.found
    problem, network = found.problem, found.problem.network
    misfit = misfit_of(sized)
    left = misfit.left
    unnamed = extend(sized, calibration) if empirical and left is not None else None
    if left is not None and unnamed is not None:
        left = replace(left, extension=unnamed.extension)
    extended = _extended(judged, calibration, unnamed)
    changed = bool(sized.forms or extended is not calibration)
    instrument = sized.estimate.signature[:, [not own for own in sized.estimate.effects]].sum(axis=1)
    residual = unwhitened_um(problem, problem.residual)
    after = of_file(problem, extended, instrument) if changed else residual
    hidden = _unidentifiable(found)
    weights = network.whitening
    return Diagnosis(
        verdict=_verdict(judged, left),
        rms_um=rms(residual, network.read),
        absorbed_rms_um=rms(unwhitened_um(problem, problem.projected), network.read),
        expected_rms_um=misfit.expected_um,
        points=len(network.data),
        dof=problem.dof,
        p_value=min([misfit.p_value, *(cause.p_value for cause in judged.causes)]),
        causes=judged.causes,
        unexplained=left,
        unidentifiable=tuple(hidden),
        looks_like=MappingProxyType(hidden),
        not_evaluated=found.task.catalogue.not_evaluated,
        next_measurement=judged.next_measurement,
        trends=misfit.trends,
        ranking=_ranking(found.candidates),
        # Last: it puts the candidates back to what was tried.
        gain=gain(sized, (residual, after), left, unnamed) if changed else None,
        tried=len(found.task.catalogue.candidates),
        scatter=found.task.noise.source,
        calibration=calibration,
        extended=extended,
        data=replace(network.data, notices=(*network.data.notices, *judged.notices)),
        residual_um=locked(residual),
        after_um=locked(after),
        directions=locked(unwhiten(problem, problem.view.by_base)),
        precision=locked(np.einsum("nki,nkj->nij", weights, weights) * UM**2),
    )


def _extended(judged: Judged, calibration: Calibration, unnamed: Extended | None) -> Calibration:
    """The calibration with the causes that are promised, and with what was made of the rest."""
    effects: list[Effect] = judged.sized.effects
    covariance = judged.sized.covariance
    if unnamed is not None:
        effects = [*effects, *unnamed.effects]
        # Independent: the causes' covariance already holds what the patterns can do to them.
        covariance = Covariance.of_blocks([covariance, unnamed.covariance])
    if not effects:
        return calibration
    data = judged.sized.found.problem.network.data
    source = "extended by twin diagnose from " + data.source
    return calibration.extended(effects, covariance, source, simulated=data.simulated)


def _verdict(judged: Judged, left: Unexplained | None) -> Verdict:
    if left is not None and left.share > MOSTLY_EXPLAINED:
        return "unexplained"
    if not judged.causes:
        return "ambiguous" if judged.disagree else "consistent"
    return "ambiguous" if judged.disagree or any(cause.equivalent for cause in judged.causes) else "explained"


def _unidentifiable(found: Findings) -> dict[tuple[str, str], str]:
    """Candidates that the data could not show, and what looks the same as each."""
    candidates = found.candidates
    seen: dict[tuple[str, str], bool] = {}
    for form, score in zip(candidates.forms, candidates.scores([], range(len(candidates.forms))), strict=True):
        seen[form.key] = seen.get(form.key, False) or score[1] > 0
    hidden = [candidate.key for candidate in found.task.catalogue.candidates if not seen.get(candidate.key, True)]
    why = looks_like(found.problem, [form for form in candidates.forms if form.key in set(hidden)])
    return {key: why[key] for key in hidden}


def _ranking(candidates: Candidates) -> tuple[tuple[str, str, float, float], ...]:
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for form, (explained, _, log_p) in zip(
        candidates.forms, candidates.scores([], range(len(candidates.forms))), strict=True
    ):
        if log_p < best.get(form.key, (0.0, 1.0))[1]:
            best[form.key] = float(explained), float(log_p)
    ranked = sorted(best.items(), key=lambda one: (one[1][1], -one[1][0]))[:RANKED]
    return tuple(
        (effect, where, explained, candidates.p_value(log_p)) for (effect, where), (explained, log_p) in ranked
    )


SEEN_AT: Final = 0.05
"""Chance below which a column is said to go with the misfit."""
LARGE: Final = 1e-4
SMALL: Final = 0.01
"""Share of the excess below which what is left beside causes is noted, and no finding: real machines have some everywhere."""


@final
@dataclass(frozen=True)
class WholeMisfit:
    """The misfit of the readings.

    Attributes:
        p_value: chance of as large a one without any cause.
        expected_um: RMS a coordinate that the scatter lets expect.
        trends: columns it goes with, one by one, before any cause is taken out.
        left: what the causes leave of it; None where that is no more than scatter.
    """

    p_value: float
    expected_um: float
    trends: tuple[Trend, ...]
    left: Unexplained | None


def misfit_of(sized: Sized) -> WholeMisfit:
    """The misfit, and what the causes leave of it.

    Args:
        sized: the causes, with their sizes.
    """
    problem, found = sized.found.problem, sized.found
    chances = [_p_value(problem, found.task.noise), *(float(np.exp(t.log_paid)) for t in found.structure.traces)]
    return WholeMisfit(min(chances), _expected_um(problem), _trends(found), _unexplained(sized))


def _unexplained(sized: Sized) -> Unexplained | None:
    """What the causes leave: the patterns, or more scatter than stated."""
    found, forms, excess = sized.found, sized.forms, sized.excess
    problem, structure = found.problem, found.structure
    if structure.traces:
        patterns_um = unwhitened_um(problem, structure.pattern(forms))
        share = float(np.clip(structure.explained(forms) / excess, 0.0, 1.0))
        columns = tuple(dict.fromkeys(name for trace in structure.traces for name in trace.pattern.names))
        sides = {trace.pattern.side for trace in structure.traces}
        carrier = sides.pop() if len(sides) == 1 else "both"
        size = float(np.sqrt(np.nansum(patterns_um**2) / max(np.count_nonzero(problem.network.read), 1)))
        text = (
            f"a pattern that goes with {' and '.join(columns)} on the {carrier} side, {size:.2g} µm RMS a coordinate, "
            f"{100 * share:.2g} % of the excess, fits no effect that is known here"
        )
        return Unexplained(share, columns, carrier, text, size)
    after = problem.chi2 - sized.estimate.explained
    share = float((after - problem.dof) / excess) if forms else 1.0
    more = _p_value(problem, found.task.noise, after, len(forms))
    if more >= LARGE or (forms and share <= SMALL):
        return None
    size = float(np.sqrt(max(after / problem.dof - 1.0, 0.0))) * _expected_um(problem)
    what = "more scatter than stated" + (" is left" if forms else "")
    return Unexplained(share, (), "both", f"{what}, without any pattern in the columns given", size)


def _trends(found: Findings) -> tuple[Trend, ...]:
    """Columns the misfit goes with, one by one, before any cause is taken out."""
    single = [pattern for pattern in found.patterns if len(pattern.channels) == 1]
    best: dict[tuple[str, str], Trace] = {}
    for trace in scan(found.problem, [one for one in single if one.field == "base"], (), found.task.noise.dof):
        best.setdefault((trace.pattern.side, trace.pattern.names[0]), trace)
    return tuple(
        Trend(column, side, trace.explained, float(np.exp(trace.log_paid)))
        for (side, column), trace in best.items()
        if trace.log_paid < np.log(SEEN_AT)
    )


def _p_value(problem: Problem, scatter: ReadingNoise, chi2: float | None = None, fitted: int = 0) -> float:
    """Chance of as large a misfit without any cause, or of a misfit once some numbers were fitted."""
    chi2, dof = problem.chi2 if chi2 is None else chi2, max(problem.dof - fitted, 1)
    if np.isfinite(scatter.dof):
        return float(f_sf(chi2 / dof, dof, scatter.dof))
    return float(chi2_sf(chi2, dof))


def _expected_um(problem: Problem) -> float:
    """RMS a coordinate that the scatter lets expect, µm."""
    variances = np.einsum("nii->ni", problem.network.covariance)[problem.network.read]
    return float(np.sqrt(np.mean(variances) * problem.dof / problem.readings)) * 1e6


ITSELF: Final = "itself"


def looks_like(problem: Problem, forms: Sequence[Form]) -> dict[tuple[str, str], str]:
    """A sentence for every candidate that none of its forms shows.

    Args:
        problem: the data.
        forms: of those candidates, all of them.
    """
    every = list(dict.fromkeys((form.key, column) for form in forms for column in form.variant.columns))
    if not every:
        return {}
    found = problem.products([column for _, column in every])
    # Beside the set-up there is next to nothing of them; what there was before is what the basis has of it, too.
    sizes_of = np.sqrt(np.maximum(np.diag(found.gram), 0.0) + np.sum(found.basis**2, axis=0))
    strongest: dict[tuple[str, str], tuple[float, int]] = {}
    for i, ((key, _), size) in enumerate(zip(every, sizes_of.tolist(), strict=True)):
        if size > strongest.get(key, (-1.0, 0))[0]:
            strongest[key] = size, i
    own = [i for _, i in strongest.values()]
    setup = named_setup(problem.setup)
    count, doubt = len(setup), len(problem.prior)
    # All of it in the directions of the basis, and what of the causes is beside them.
    values, vectors = np.linalg.eigh(found.gram[np.ix_(own, own)])
    beside = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    whole = np.zeros((len(problem.nuisance_coordinates) + len(own), doubt + count + len(own)))
    whole[: len(problem.nuisance_coordinates)] = np.concatenate(
        [problem.nuisance_coordinates[:, count:], problem.nuisance_coordinates[:, :count], found.basis[:, own]], axis=1
    )
    whole[len(problem.nuisance_coordinates) :, doubt + count :] = beside
    # Triangular, the calibration's doubt first: below it stands what that doubt does not take up, and every choice among its columns
    # is a factor of theirs.
    left = np.asarray(np.linalg.qr(whole, mode="r"))[doubt:, doubt:]
    # Columns are in plausible sizes; of the cause one is a millimetre or milliradian at its largest.
    sizes = np.array([*(one.plausible * one.factor for one in setup), 1.0])
    unknowns = [*setup, Unknown(ITSELF, "", 1.0)]
    said = {}
    for k, (key, (size, _)) in enumerate(strongest.items()):
        if size**2 <= LEAST_NONCENTRALITY:
            said[key] = "nothing that was moved shows it"
            continue
        if float(np.linalg.norm(left[:, count + k])) ** 2 <= LEAST_NONCENTRALITY:
            said[key] = "the calibration itself is not known well enough"
            continue
        columns = np.array([*range(count), count + k])
        told = determinability(left[:, columns] / sizes, unknowns, tolerance=float(np.sqrt(LEAST_NONCENTRALITY)))
        direction = told.null_direction_of(ITSELF)
        if direction is None:
            said[key] = "stations, targets and the calibration's own doubt together take it up"
            continue
        first, *others = direction.moves
        # What makes up for it is the opposite of what it looks like.
        same = ", ".join(f"{move.name} {-move.value / first.value:+.3g} {move.unit}" for move in others)
        said[key] = f"{LARGEST * 1e-3:g} mm or mrad of it looks like {same}"
    return said
