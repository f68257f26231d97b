"""Sizes of the selected causes, without those that are not significant against the variation between groups of readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from twin._common.arrays import read_only
from twin._common.distributions import f_log_sf
from twin.diagnosis.estimate.estimate import Estimate, estimate
from twin.diagnosis.estimate.misfit import MANY_ROUNDS
from twin.diagnosis.estimate.reweighted import reweighted
from twin.diagnosis.judgement.evidence import between_positions
from twin.diagnosis.problem.forms import Form, log_p_value
from twin.diagnosis.selection.structure import Findings
from twin.identification.discrepancy import Discrepancy
from twin.machine.effects import Effect
from twin.numerics.covariance import Covariance


@final
@dataclass(frozen=True, eq=False)
class SizedCauses:
    """The selected causes with their sizes.

    Attributes:
        found: the selected causes and patterns.
        forms: the causes that are significant.
        beside: the same forms with the patterns projected out.
        estimate: their sizes, fitted without the patterns.
        dropped: causes that are not significant against the variation between groups of readings.
        doubts: for each cause, why it is not valid between the measured positions; empty if it is.
        discrepancy: what the causes leave beyond the noise; it is in the weights of their sizes.
    """

    found: Findings
    forms: tuple[Form, ...]
    beside: tuple[Form, ...]
    estimate: Estimate
    dropped: tuple[Form, ...]
    doubts: tuple[str, ...]
    discrepancy: Discrepancy

    @property
    def excess(self) -> float:
        """Return the excess of χ² over its expectation from noise."""
        problem = self.found.problem
        return max(problem.chi2 - problem.dof, self.estimate.explained, 1e-30)

    @property
    def promised(self) -> list[bool]:
        """Return whether each cause is in the extended calibration."""
        return [not doubt for doubt in self.doubts]

    @property
    def effects(self) -> list[Effect]:
        """Return the effects of the promised causes."""
        return [
            one for own, promise in zip(self.estimate.effects, self.promised, strict=True) if promise for one in own
        ]

    @property
    def covariance(self) -> Covariance:
        """Return the covariance of the parameters of `effects`."""
        wanted = {parameter.name for effect in self.effects for parameter in effect.parameters}
        names, matrix = self.estimate.covariance.names, self.estimate.covariance.matrix
        at = [i for i, name in enumerate(names) if name in wanted]
        return Covariance(tuple(names[i] for i in at), read_only(np.array(matrix[np.ix_(at, at)])))

    def others(self, form: Form) -> list[Form]:
        """Return all causes but one."""
        return [one for one in self.forms if one is not form]

    def log_p(self, form: Form) -> float:
        """Return the log p-value of a cause, corrected for multiple testing, with all unexplained residuals counted as noise."""
        return log_p_beside(self.found, self.estimate, self.forms, form)


def estimate_sizes(found: Findings) -> SizedCauses:
    """Estimate the sizes of the causes, and drop one by one those that groups of readings do not confirm.

    Args:
        found: the selected causes and patterns.
    """
    forms = list(found.structure.forms)
    dropped: list[Form] = []
    while True:
        estimated = estimate(found.problem, forms, found.task.noise.dof, found.structure.beside)
        if found.structure.pattern_tests:
            judged = [(log_p_beside(found, estimated, forms, form), form) for form in forms]
        else:
            judged = [
                (_log_p(against) + form.log_tests, form)
                for form, against in zip(forms, estimated.wald, strict=True)
                if MANY_ROUNDS <= against[2] < np.inf
            ]
        worst = max(judged, key=lambda one: one[0], default=None)
        if worst is None or worst[0] <= np.log(found.candidates.level):
            break
        dropped.append(worst[1])
        forms = [form for form in forms if form is not worst[1]]
    beside = tuple(found.beside.forms[form.index] for form in forms)
    doubts = tuple(between_positions(found.candidates, forms, form) for form in forms)
    sizes, discrepancy = reweighted(found.task, forms, estimated, found.structure.beside)
    return SizedCauses(found, tuple(forms), beside, sizes, tuple(dropped), doubts, discrepancy)


def log_p_beside(found: Findings, estimated: Estimate, forms: Sequence[Form], form: Form) -> float:
    """Return `SizedCauses.log_p` for given causes."""
    explained, dof, _ = found.candidates.scores([one for one in forms if one is not form], [form.index])[0]
    left = max((found.problem.chi2 - estimated.explained) / max(found.problem.dof, 1), 1.0)
    chance = log_p_value(np.array(explained / left), max(float(dof), 1.0), found.candidates.dof)
    return min(float(chance) + form.log_tests, 0.0)


def _log_p(against: tuple[float, int, float]) -> float:
    """Return the log p-value of a cause by its Wald statistic (F with the groups' degrees of freedom; Hotelling's T² for one cause)."""
    statistic, width, count = against
    free = count - width
    return float(f_log_sf(statistic / width * free / (count - 1.0), width, free)) if free > 0 else 0.0
