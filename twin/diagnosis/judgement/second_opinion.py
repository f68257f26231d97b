"""A second, Bayesian method: probabilities of the causes, and 95 % credible sets.

The search selects one set of causes. The sum of single effects (`twin.diagnosis.judgement.single_effects`) on the same whitened,
projected readings gives a probability to every cause independently. If the two methods disagree, neither result is certain.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import first_largest
from twin.diagnosis.judgement.single_effects import ODDS, Alternatives, Fit, SingleEffects
from twin.diagnosis.problem.forms import Candidates, Form
from twin.diagnosis.selection.search import ROUGHLY

CREDIBLE: Final = 0.95
"""Smallest posterior probability of a credible set."""
MOST: Final = 12
"""Largest number of effects."""
Key = tuple[str, str]
"""Effect and place."""


@final
@dataclass(frozen=True)
class SingleEffect:
    """One effect with the posterior distribution over its possible causes.

    Attributes:
        log_odds: natural log of the odds of an effect against none.
        posterior: probability of each cause given that there is an effect, all forms of the cause together; the likeliest first.
        credible: the smallest set of causes that has `CREDIBLE` of the probability, the likeliest first.
    """

    log_odds: float
    posterior: Mapping[Key, float]
    credible: tuple[Key, ...]

    @property
    def found(self) -> bool:
        """Return whether the odds reach `ODDS`, which limits the rate of false alarms to one in 20."""
        return self.log_odds >= float(np.log(ODDS))

    def probability(self, keys: Collection[Key]) -> float:
        """Return the posterior probability that the effect exists and is one of the given causes."""
        share = sum(self.posterior.get(key, 0.0) for key in set(keys))
        return float(min(share, 1.0) / (1.0 + np.exp(-self.log_odds)))


@final
@dataclass(frozen=True)
class SecondOpinion:
    """Independent single effects.

    Attributes:
        effects: those found, the strongest first, followed by one that was not.
    """

    effects: tuple[SingleEffect, ...]

    @property
    def found(self) -> tuple[SingleEffect, ...]:
        """Return the effects whose odds reach `ODDS`."""
        return tuple(effect for effect in self.effects if effect.found)

    def probability(self, keys: Collection[Key]) -> float:
        """Return the posterior probability that at least one effect is one of the given causes."""
        return float(1.0 - np.prod([1.0 - effect.probability(keys) for effect in self.effects]))


@final
@dataclass(frozen=True)
class ComparedCause:
    """The result of the second method for one cause of the search.

    Attributes:
        probability: that the cause, or one that it is equivalent to, exists.
        credible: credible set of the effect that corresponds to it; empty if no effect does.
        instead: credible set of the effect found in its place; empty if there is none.
    """

    probability: float
    credible: tuple[Key, ...]
    instead: tuple[Key, ...]


@final
@dataclass(frozen=True)
class Comparison:
    """Comparison of the search with the second method.

    Attributes:
        causes: in the order of the search's groups.
        further: effects found that correspond to no cause of the search and replace none.
    """

    causes: tuple[ComparedCause, ...]
    further: tuple[SingleEffect, ...]

    @property
    def disagree(self) -> bool:
        """Return whether an effect was found that the search explains differently or not at all.

        A cause that only the search finds is no disagreement: the second method finds fewer effects at the same rate of false alarms.
        """
        return bool(self.further) or any(cause.instead for cause in self.causes)


def second_opinion(candidates: Candidates, start: Sequence[Form] = (), most: int = MOST) -> SecondOpinion:
    """Return the posterior of the causes of a pool.

    The prior of a form follows the search's correction for multiple testing: effects share it as they share the rate of false alarms,
    the places of an effect in proportion to their number of independent forms. A known or bounded size is part of the prior.

    Args:
        candidates: the data and the forms; forms forbidden to the search are included with their own prior.
        start: forms selected by the search; the iteration starts from them as well as from no effect.
        most: largest number of effects.
    """
    effects = SingleEffects(_alternatives(candidates), candidates.slope, candidates.cross, candidates.dof)
    found = effects.fitted(most, [form.index for form in start])
    keys = [form.key for form in candidates.forms]
    ordered = sorted(found, key=lambda effect: (not effect.found, -effect.log_odds))
    return SecondOpinion(tuple(_by_key(effect, keys, candidates.key_of) for effect in ordered))


def compare_with_search(opinion: SecondOpinion, groups: Sequence[Collection[Key]]) -> Comparison:
    """Compare the causes of the search with the second method.

    Each effect is assigned to at most one group, maximising the joint posterior probability. An unassigned effect disagrees with the
    search if a group has no effect, which it then replaces, or if its credible set has no cause in common with any group. Two effects
    with the same likeliest cause count as one cause in two forms.

    Args:
        opinion: result of the second method on the same data.
        groups: for each cause of the search, the cause and those equivalent to it.
    """
    common = np.array([[effect.probability(group) for effect in opinion.effects] for group in groups])
    rows, columns = _assigned(common) if len(groups) else (np.zeros(0, int), np.zeros(0, int))
    partner = {
        int(g): int(e)
        for g, e in zip(rows, columns, strict=True)
        if set(groups[g]).intersection(opinion.effects[e].credible)
    }
    likeliest = {opinion.effects[e].credible[0] for e in partner.values()}
    left = [e for e, effect in enumerate(opinion.effects) if effect.found and e not in partner.values()]
    left = [e for e in left if opinion.effects[e].credible[0] not in likeliest]
    alone = [g for g in range(len(groups)) if g not in partner]
    named = {key for group in groups for key in group}
    instead: dict[int, int] = {}
    further = []
    for e in left:
        free = [g for g in alone if g not in instead]
        if free:
            instead[free[first_largest(common[free, e])]] = e
        elif named.isdisjoint(opinion.effects[e].credible):
            further.append(opinion.effects[e])

    def credible(index: int | None) -> tuple[Key, ...]:
        return () if index is None else opinion.effects[index].credible

    causes = tuple(
        ComparedCause(opinion.probability(group), credible(partner.get(g)), credible(instead.get(g)))
        for g, group in enumerate(groups)
    )
    return Comparison(causes, tuple(further))


def _assigned(common: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the pairs, each row and column in at most one, with the largest sum of probabilities."""
    best = common.argmax(axis=1)
    if len(np.unique(best)) == len(best):
        return np.arange(len(best)), best
    rows, columns = scipy.optimize.linear_sum_assignment(-common)
    return rows, columns


def _alternatives(candidates: Candidates) -> list[Alternatives]:
    found = []
    for rows, columns, inner in candidates.blocks():
        forms = [candidates.forms[i] for i in rows]
        largest, centre, width = np.ones(columns.shape), np.zeros(columns.shape), np.zeros(len(rows))
        for i, form in enumerate(forms):
            if np.isfinite(form.candidate.largest):
                largest[i] = form.candidate.largest / np.array([column.scale for column in form.variant.columns])
            if form.candidate.specification.all_or_nothing:
                centre[i], width[i] = 1.0 / form.variant.columns[0].scale, ROUGHLY
        # The form's share of the correction for multiple testing, which counts independent forms.
        prior = np.array(
            [np.exp(-form.log_tests) * form.candidate.tests / len(form.candidate.variants) for form in forms]
        )
        found.append(Alternatives(rows, columns, inner, prior, largest, centre, width))
    return found


def _by_key(effect: Fit, keys: Sequence[Key], number: np.ndarray) -> SingleEffect:
    """Return the effect with the posterior summed over the forms of each cause."""
    total = np.bincount(number[: len(effect.posterior)], effect.posterior)
    names = dict(zip(number.tolist(), keys, strict=True))
    order = np.argsort(-total, kind="stable")
    ordered = {names[int(i)]: float(total[i]) for i in order if total[i] > 0.0}
    held = int(np.searchsorted(np.cumsum(total[order]), CREDIBLE)) + 1
    credible = tuple(names[int(i)] for i in order[:held])
    return SingleEffect(effect.log_odds, MappingProxyType(ordered), credible)
