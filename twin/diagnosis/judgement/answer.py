"""From the causes to the answer: what is left, the extended calibration, what it gains."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Final

import numpy as np

from twin._common.arrays import locked
from twin._common.units import UM
from twin.diagnosis.diagnosis import Diagnosis
from twin.diagnosis.judgement.absorbed import looks_like
from twin.diagnosis.judgement.causes import Judged
from twin.diagnosis.judgement.extend import Extended, extend
from twin.diagnosis.judgement.gain import gain, of_file
from twin.diagnosis.judgement.left import misfit_of
from twin.diagnosis.problem.pool import Pool
from twin.diagnosis.problem.problem import plain, rms, unwhitened
from twin.diagnosis.result import Unexplained, Verdict
from twin.diagnosis.selection.structure import Findings
from twin.machine.calibration import Calibration
from twin.machine.effects import Effect
from twin.numerics.covariance import Covariance

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
    residual = unwhitened(problem, problem.residual)
    after = of_file(problem, extended, instrument) if changed else residual
    hidden = _unidentifiable(found)
    weights = network.whitening
    return Diagnosis(
        verdict=_verdict(judged, left),
        rms_um=rms(residual, network.read),
        absorbed_rms_um=rms(unwhitened(problem, problem.projected), network.read),
        expected_rms_um=misfit.expected_um,
        points=len(network.data),
        dof=problem.dof,
        p_value=min([misfit.p_value, *(cause.p_value for cause in judged.causes)]),
        causes=judged.causes,
        unexplained=left,
        unidentifiable=tuple(hidden),
        looks_like=MappingProxyType(hidden),
        not_evaluated=found.posed.known.not_evaluated,
        next_measurement=judged.next_measurement,
        trends=misfit.trends,
        ranking=_ranking(found.pool),
        # Last: it puts the pool back to what was tried.
        gain=gain(sized, (residual, after), left, unnamed) if changed else None,
        tried=len(found.posed.known.candidates),
        scatter=found.posed.scatter.source,
        calibration=calibration,
        extended=extended,
        data=replace(network.data, notices=(*network.data.notices, *judged.notices)),
        residual_um=locked(residual),
        after_um=locked(after),
        directions=locked(plain(problem, problem.view.by_base)),
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
    pool = found.pool
    seen: dict[tuple[str, str], bool] = {}
    for form, score in zip(pool.forms, pool.scores([], range(len(pool.forms))), strict=True):
        seen[form.key] = seen.get(form.key, False) or score[1] > 0
    hidden = [candidate.key for candidate in found.posed.known.candidates if not seen.get(candidate.key, True)]
    why = looks_like(found.problem, [form for form in pool.forms if form.key in set(hidden)])
    return {key: why[key] for key in hidden}


def _ranking(pool: Pool) -> tuple[tuple[str, str, float, float], ...]:
    best: dict[tuple[str, str], tuple[float, float]] = {}
    for form, (explained, _, log_p) in zip(pool.forms, pool.scores([], range(len(pool.forms))), strict=True):
        if log_p < best.get(form.key, (0.0, 1.0))[1]:
            best[form.key] = float(explained), float(log_p)
    ranked = sorted(best.items(), key=lambda one: (one[1][1], -one[1][0]))[:RANKED]
    return tuple((effect, where, explained, pool.chance(log_p)) for (effect, where), (explained, log_p) in ranked)
