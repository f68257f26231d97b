"""Sizes of causes beside which the model is wrong: weighted by the noise and by the remaining discrepancy.

Which causes there are is decided against the noise alone. Their sizes go into a file, and weights of the noise alone (25 times better
along a tracker's beam than across) would make that file fit the unexplained residuals along the beam at the expense of the others.
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
from twin.diagnosis.problem.problem import Problem, unwhiten
from twin.identification.discrepancy import Discrepancy, isotropic, settled, updated

REWEIGHTINGS: Final = 4
"""Number of estimates with other weights, at most."""


def reweighted(
    problem: Problem,
    forms: Sequence[Form],
    by_noise: Estimate,
    noise_dof: float,
    random_effects: RandomEffects | None,
) -> tuple[Estimate, Discrepancy]:
    """Return the estimate with the discrepancy in its weights, and the discrepancy; the same estimate where the causes fit.

    The reduction of chi² and the Wald statistics stay those of the noise: they are tests.

    Args:
        problem: the data.
        forms: the causes.
        by_noise: their estimate with the weights of the noise.
        noise_dof: degrees of freedom of the noise variance.
        random_effects: patterns without a name (`estimate`).
    """
    network = problem.network
    discrepancy = isotropic(network, np.zeros(len(network.data)))
    width = sum(len(form.variant.columns) for form in forms)
    if not forms or not lacks_fit(problem, problem.residual - by_noise.signature.sum(axis=1), width, noise_dof):
        return by_noise, discrepancy
    share = min((problem.readings - problem.dof + width) / problem.readings, 1.0)
    found, weighted = by_noise, problem
    for attempt in range(REWEIGHTINGS):
        left = weighted.project(weighted.residual - found.signature.sum(axis=1))
        residual = unwhiten(weighted.network, left.reshape(-1, 3)[:, :, None])[:, :, 0]
        taken_up = share * weighted.network.covariance
        further = updated(network, discrepancy, residual, taken_up, np.ones(len(residual), dtype=bool))
        if settled(network, discrepancy, further) or attempt == REWEIGHTINGS - 1:
            break
        discrepancy = further
        weighted = Problem(network.with_discrepancy(discrepancy.root), problem.setup, problem.calibration)
        found = estimate(weighted, forms, np.inf, random_effects)
    signature = unwhiten(weighted.network, found.signature.reshape(len(network.data), 3, -1))
    signature = np.einsum("nij,njk->nik", network.whitening, signature).reshape(found.signature.shape)
    return (
        replace(found, signature=read_only(signature), explained=by_noise.explained, wald=by_noise.wald),
        discrepancy,
    )
