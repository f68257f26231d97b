"""Weights of noise and discrepancy where the causes leave more than the noise.

Weights of the noise alone (25 times better along a tracker's beam than across) would select and size the causes by the unexplained
residuals along the beam, at the expense of the others. Tests of consistency compare the residuals with the noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from twin._common.arrays import read_only
from twin.diagnosis.estimate.estimate import Estimate, RandomEffects, estimate
from twin.diagnosis.estimate.misfit import lacks_fit
from twin.diagnosis.problem.forms import Form
from twin.diagnosis.problem.problem import Problem, rewhitened, unwhiten
from twin.diagnosis.problem.readings import DiagnosisTask
from twin.identification.discrepancy import Discrepancy, no_discrepancy, settled, updated

REWEIGHTINGS: Final = 4
"""Number of estimates with other weights, at most."""


def remaining_discrepancy(
    task: DiagnosisTask, forms: Sequence[Form], found: Estimate, patterned: Problem | None = None
) -> Discrepancy:
    """Return the discrepancy of the residuals that causes, and patterns if any, leave.

    Args:
        task: the data, with the weights of the estimate.
        forms: the causes.
        found: their estimate.
        patterned: the same problem with the patterns projected out (`Problem.with_random_effects`); None to count them as discrepancy.
    """
    network, problem = task.by_noise.network, task.problem if patterned is None else patterned
    residual = problem.residual - rewhitened(found.signature.sum(axis=1), task.problem.network, problem.network)
    left = unwhiten(problem.network, problem.project(residual).reshape(-1, 3)[:, :, None])[:, :, 0]
    # A direction with a prior takes up the share of a reading that its posterior variance has lost.
    absorbed = len(problem.nuisance_coordinates) - float(np.sum(problem.nuisances.prior**2))
    share = min((absorbed + _width(forms)) / problem.readings, 1.0)
    taken_up = share * task.problem.network.covariance
    return updated(network, task.discrepancy, left, taken_up, np.ones(len(left), dtype=bool))


def reweighted(
    task: DiagnosisTask, forms: Sequence[Form], found: Estimate, random_effects: RandomEffects | None
) -> tuple[Estimate, Discrepancy]:
    """Return the estimate with all that the causes leave in its weights, patterns too, and this discrepancy.

    The same estimate where the causes fit. The reduction of chi² and the Wald statistics stay as they are: they are tests.

    Args:
        task: the data, with the weights of the estimate.
        forms: the causes.
        found: their estimate.
        random_effects: patterns without a name (`estimate`).
    """
    by_noise = task.by_noise
    left = by_noise.residual - rewhitened(found.signature.sum(axis=1), task.problem.network, by_noise.network)
    if not forms or not lacks_fit(by_noise, left, _width(forms), task.noise.dof):
        return found, no_discrepancy(by_noise.network)
    weighted, again = task, found
    for attempt in range(REWEIGHTINGS):
        further = remaining_discrepancy(weighted, forms, again)
        if settled(by_noise.network, weighted.discrepancy, further) or attempt == REWEIGHTINGS - 1:
            break
        weighted = weighted.with_discrepancy(further)
        again = estimate(weighted.problem, forms, np.inf, random_effects)
    signature = rewhitened(again.signature, weighted.problem.network, task.problem.network)
    return (
        replace(again, signature=read_only(signature), explained=found.explained, wald=found.wald),
        weighted.discrepancy,
    )


def _width(forms: Sequence[Form]) -> int:
    return sum(len(form.variant.columns) for form in forms)
