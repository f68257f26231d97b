"""A second, Bayesian method: probabilities of the causes, and 95 % credible sets.

It is independent of the search; if the two disagree, neither result is certain. The whitened, projected residual is the sum of a few
effects, each of which is exactly one form (a block of columns) or none. Each effect in turn is fitted to the residual less the expected
contribution of the others, until convergence (iterative Bayesian stepwise selection). G. Wang, A. Sarkar, P. Carbonetto, M. Stephens
(2020), A simple new approach to variable selection in regression, with application to genetic fine mapping, J. R. Statist. Soc. B 82,
1273. From inner products: Y. Zou, P. Carbonetto, G. Wang, M. Stephens (2022), Fine-mapping from summary data with the sum of single
effects model, PLoS Genetics 18, e1010299.

Three things differ from the paper. An effect is a block of columns. The prior variance is averaged over a grid, not maximised: the
mean Bayes factor without any effect is one, so that by Markov's inequality odds of 20 or more arise in at most one of 20 such data
sets. With noise known from repeats only, the Bayes factor is that of Student's t. The iteration ends in a local optimum: it may
also start from forms selected by other means, and the result with the larger evidence lower bound is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import first_largest, largest_first
from twin._common.distributions import chi2_isf
from twin.diagnosis.forms import DEVIANCE_RULED_OUT, LEAST_NONCENTRALITY, Candidates, Form
from twin.diagnosis.search import ALL_OR_NOTHING_TOLERANCE

FOUND_ODDS: Final = 20.0  # odds of an effect against none at which it counts as found
PRIOR_NONCENTRALITIES: Final = 30.0 * 10.0 ** np.arange(9)
"""Expected noncentrality of an effect under its prior: the variance grid."""
SIZE_PRIOR: Final = 1.0 / (
    (np.arange(len(PRIOR_NONCENTRALITIES)) + 1.0) * (np.arange(len(PRIOR_NONCENTRALITIES)) + 2.0)
)
"""Prior weight of each, before normalisation: half of it on effects that are just large enough to be found."""
NEGLECTED_CHANGE: Final = 1e-2  # of the residual, in standard deviations, by forms left out of a contribution
CONVERGED_CONTRIBUTION: Final = 0.1
"""Standard deviations of an expected contribution, from one sweep to the next, below which the iteration ends."""
NEGLECTED_PROBABILITY: Final = 1e-6  # posterior probability below which forms are always neglected
CONVERGED_PROBABILITY: Final = 1e-3  # change of any posterior probability in a sweep below which the iteration ends
SWEEPS: Final = 100


@final
@dataclass(frozen=True, eq=False)
class Alternatives:
    """Forms with the same number of columns."""

    forms: np.ndarray  # (n,) number of each form
    columns: np.ndarray  # (n, w) column numbers of each form
    inner: np.ndarray  # (n, w, w) inner products of these columns
    prior: np.ndarray  # (n,) probability, not normalised
    largest: np.ndarray  # (n, w) coefficients of the largest size that is possible
    centre: np.ndarray  # (n, w) prior mean of the coefficients; zero unless the size is known beforehand
    width: np.ndarray  # (n,) relative prior standard deviation of a size that is known beforehand


@final
@dataclass(frozen=True, eq=False)
class Fit:
    """Posterior of one effect."""

    log_odds: float  # natural log of the odds of an effect of any form against none
    posterior: np.ndarray  # (forms,) probability of each, given that there is an effect
    coefficients: np.ndarray  # (columns,) posterior mean
    slope: np.ndarray  # (columns,) contribution to the inner products with the residual
    along: float = 0.0  # product of the coefficients with the residual to which the effect was fitted

    @property
    def found(self) -> bool:
        """Return whether the odds reach `FOUND_ODDS`."""
        return self.log_odds >= float(np.log(FOUND_ODDS))

    @property
    def probability(self) -> float:
        """Return the posterior probability that the effect exists, at prior odds of one."""
        return float(1.0 / (1.0 + np.exp(-self.log_odds)))


@final
class SingleEffects:
    """Forms and data of one selection problem.

    ``slope`` are inner products (columns,) with the residual; ``cross`` returns those of some columns with all, a row each.
    """

    def __init__(
        self,
        alternatives: Sequence[Alternatives],
        slope: np.ndarray,
        cross: Callable[[np.ndarray], np.ndarray],
        dof: float = float("inf"),
    ) -> None:
        self._slope = slope
        self._cross = cross
        self._forms = 1 + max((int(alternative.forms.max(initial=-1)) for alternative in alternatives), default=-1)
        kinds = [_Kind(alternative, dof) for alternative in alternatives]
        total = sum(float(kind.prior.sum()) for kind in kinds)
        self._kinds = [kind for kind in kinds if len(kind.forms)]
        self._log_prior = [np.log(kind.prior / total) for kind in self._kinds]

    def fitted(self, most: int, start: Sequence[int] = ()) -> tuple[Fit, ...]:
        """Return at most ``most`` effects in the order of entry, else with one more that was not found.

        The iteration starts without effects and, in addition, from the forms of ``start``.
        """
        if not self._kinds:
            return ()
        grown = self._grown([], most)
        other = self._grown(self._started(start), most) if len(start) else grown
        return other if self._evidence(other) > self._evidence(grown) else grown

    def _started(self, forms: Sequence[int]) -> list[Fit]:
        """Return one effect per form, with joint least-squares coefficients."""
        columns = {int(f): own for kind in self._kinds for f, own in zip(kind.forms, kind.columns, strict=True)}
        some = [form for form in dict.fromkeys(forms) if form in columns]
        every = np.unique(np.concatenate([np.zeros(0, dtype=int), *(columns[form] for form in some)]))
        cross = self._cross(every)
        values = np.linalg.lstsq(cross[:, every], self._slope[every], rcond=1e-9)[0]
        started = []
        for form in some:
            at = np.searchsorted(every, columns[form])
            posterior, coefficients = np.zeros(self._forms), np.zeros(len(self._slope))
            posterior[form], coefficients[columns[form]] = 1.0, values[at]
            started.append(Fit(float("inf"), posterior, coefficients, values[at] @ cross[at]))
        return started

    def _grown(self, effects: list[Fit], most: int) -> tuple[Fit, ...]:
        """Add effects while the newest is found."""
        effects = self._settled(effects)
        for _ in range(2 * most):
            newest = self._single(self._slope - _sum(effects))
            if not newest.found or len(effects) >= most:
                return (*effects, newest)
            effects = self._settled([*effects, self._with_slope(newest)])
        return tuple(effects)

    def _settled(self, effects: list[Fit]) -> list[Fit]:
        """Iterate by coordinate ascent; an effect that is no longer found given the others is removed at once."""
        for _ in range(SWEEPS):
            changed = False
            for old in tuple(effects):
                k = effects.index(old)
                new = self._single(self._slope - _sum(effects[:k] + effects[k + 1 :]))
                if new.found:
                    moved = np.abs(new.probability * new.posterior - old.probability * old.posterior)
                    new = self._with_slope(new)
                    effects = [*effects[:k], new, *effects[k + 1 :]]
                    shift = float((new.coefficients - old.coefficients) @ (new.slope - old.slope))
                    if float(moved.max()) > CONVERGED_PROBABILITY or shift > CONVERGED_CONTRIBUTION**2:
                        changed = True
                else:
                    changed = True
                    effects = effects[:k] + effects[k + 1 :]
            if not changed:
                break
        return effects

    def _single(self, slope: np.ndarray) -> Fit:
        """Fit one effect to a residual."""
        log_bayes = [kind.log_bayes(slope) + prior for kind, prior in zip(self._kinds, self._log_prior, strict=True)]
        log_odds = float(np.logaddexp.reduce(np.concatenate(log_bayes)))
        posterior = np.zeros(self._forms)
        for kind, own in zip(self._kinds, log_bayes, strict=True):
            posterior[kind.forms] = np.exp(own - log_odds)
        return Fit(log_odds, posterior, np.zeros(len(slope)), slope)

    def _with_slope(self, effect: Fit) -> Fit:
        """Return the effect with its expected contribution as ``slope``, in place of the slope of the residual."""
        # A form's likelihood ratio is at least its posterior odds: neglected forms change the residual by their share of its root.
        rare = max(NEGLECTED_PROBABILITY, NEGLECTED_CHANGE / float(np.sqrt(1.0 + 2.0 * max(effect.log_odds, 0.0))))
        order = largest_first(effect.posterior)[::-1]
        chosen = np.zeros(self._forms, dtype=bool)
        chosen[order] = np.cumsum(effect.posterior[order]) > rare
        coefficients = np.zeros(len(self._slope))
        for kind in self._kinds:
            own = np.flatnonzero(chosen[kind.forms])
            if len(own):
                weight = effect.probability * effect.posterior[kind.forms[own]]
                found = weight[:, None] * kind.expected(effect.slope, own)
                np.add.at(coefficients, kind.columns[own], found)
        columns = np.flatnonzero(coefficients)
        slope = coefficients[columns] @ self._cross(columns)
        return Fit(effect.log_odds, effect.posterior, coefficients, slope, float(coefficients @ effect.slope))

    def _evidence(self, effects: Sequence[Fit]) -> float:
        """Return the evidence lower bound relative to no effect; prior odds of each effect are one.

        The Kullback-Leibler divergence of an effect follows from its marginal likelihood and the residual to which it was fitted.
        """
        own = sum(float(np.logaddexp(0.0, effect.log_odds) - np.log(2.0)) - effect.along for effect in effects)
        coefficients, slopes = (
            np.stack(values) for values in zip(*((e.coefficients, e.slope) for e in effects), strict=True)
        )
        between = coefficients @ slopes.T
        return own + float(self._slope @ coefficients.sum(axis=0)) - 0.5 * float(between.sum() - np.trace(between))


@final
class _Kind:
    """Forms with the same number of columns, in coordinates in which the noise has unit variance and the prior is diagonal.

    The prior of a form's coefficients is isotropic (columns have plausible sizes), scaled so that the expected noncentrality is one
    of `PRIOR_NONCENTRALITIES`, up to that of the largest possible size. Forms and directions that the data do not show are omitted.
    """

    def __init__(self, own: Alternatives, dof: float) -> None:
        values, vectors = np.linalg.eigh(own.inner)
        seen = (values > LEAST_NONCENTRALITY) & (values > 1e-8 * np.einsum("nii->ni", own.inner).max(axis=1)[:, None])
        some = seen.any(axis=1) & (own.prior > 0.0)
        values, vectors, seen = np.where(seen, values, 0.0)[some], vectors[some], seen[some]
        self.forms, self.columns, self.prior = own.forms[some], own.columns[some], own.prior[some]
        self._dof = dof
        self._directions = seen.sum(axis=1)
        self._turn = vectors * np.where(seen, 1.0 / np.sqrt(np.where(seen, values, 1.0)), 0.0)[:, None, :]
        total = values.sum(axis=1)
        self._variance = PRIOR_NONCENTRALITIES[None, :, None] * (values / total[:, None])[:, None, :]
        most = np.einsum("nii,ni->n", own.inner[some], own.largest[some] ** 2)
        weight = SIZE_PRIOR * (PRIOR_NONCENTRALITIES <= np.maximum(most, PRIOR_NONCENTRALITIES[0])[:, None])
        with np.errstate(divide="ignore"):
            self._log_weight = np.log(weight / weight.sum(axis=1)[:, None])
        self._mean = np.sqrt(values) * np.einsum("nij,ni->nj", vectors, own.centre[some])
        known = np.any(own.centre[some] != 0.0, axis=1)
        self._variance[known] = ((own.width[some, None] * self._mean) ** 2)[known, None, :]
        self._occam = 0.5 * np.log1p(self._variance).sum(axis=2)

    def log_bayes(self, slope: np.ndarray) -> np.ndarray:
        """Return the (n,) log Bayes factor of each form against no effect, averaged over the sizes."""
        return np.asarray(np.logaddexp.reduce(self._by_size(self._along(slope, None), None), axis=1))

    def expected(self, slope: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Return the (chosen, w) posterior mean of the coefficients of some forms."""
        along = self._along(slope, chosen)
        by_size = self._by_size(along, chosen)
        share = np.exp(by_size - np.logaddexp.reduce(by_size, axis=1)[:, None])
        variance = self._variance[chosen]
        mean = (variance * along[:, None, :] + self._mean[chosen, None, :]) / (1.0 + variance)
        return np.einsum("nij,ns,nsj->ni", self._turn[chosen], share, mean)

    def _along(self, slope: np.ndarray, chosen: np.ndarray | None) -> np.ndarray:
        """Return (n, w) least-squares coefficients in units of their standard deviation, in independent directions."""
        turn, columns = (self._turn, self.columns) if chosen is None else (self._turn[chosen], self.columns[chosen])
        return np.einsum("nij,ni->nj", turn, slope[columns])

    def _by_size(self, along: np.ndarray, chosen: np.ndarray | None) -> np.ndarray:
        """Return (n, sizes) log of Bayes factor times prior weight of the size."""
        every = slice(None) if chosen is None else chosen
        null = np.sum(along**2, axis=1)[:, None]
        off = (along - self._mean[every])[:, None, :]
        beside = np.sum(off**2 / (1.0 + self._variance[every]), axis=2)
        if np.isfinite(self._dof):
            # The variance of the noise integrated out: the ratio of two multivariate t densities.
            half = 0.5 * (self._dof + self._directions[every])[:, None]
            ratio = half * (np.log1p(null / self._dof) - np.log1p(beside / self._dof))
        else:
            ratio = 0.5 * (null - beside)
        return np.asarray(ratio - self._occam[every] + self._log_weight[every])


def _sum(effects: Sequence[Fit]) -> np.ndarray | float:
    return np.sum([effect.slope for effect in effects], axis=0) if effects else 0.0


CREDIBLE_PROBABILITY: Final = 0.95  # smallest posterior probability of a credible set
SUM_REMAINDER: Final = 0.05  # largest share of an effect's χ² that causes leave which together are the same
NOISE_LEVEL: Final = 0.01  # p-value from which on what they leave is the noise that a curve of many functions follows
MAX_EFFECTS: Final = 12  # largest number of effects
Key = tuple[str, str]  # effect and place


@final
@dataclass(frozen=True)
class SingleEffect:
    """One effect with the posterior distribution over its possible causes."""

    log_odds: float  # natural log of the odds of an effect against none
    # of each cause given that there is an effect, all its forms together; the likeliest first
    posterior: Mapping[Key, float]
    credible: tuple[Key, ...]  # the fewest causes that have `CREDIBLE_PROBABILITY` together, the likeliest first
    sum_of: tuple[Key, ...] = ()  # causes of the search that together, and not without one of them, are this effect

    @property
    def found(self) -> bool:
        """Return whether the odds reach `FOUND_ODDS`, which limits the rate of false alarms to one in 20."""
        return self.log_odds >= float(np.log(FOUND_ODDS))

    def probability(self, keys: Collection[Key]) -> float:
        """Return the posterior probability that the effect exists and is one of the given causes, or a sum with one of them."""
        share = sum(self.posterior.get(key, 0.0) for key in set(keys))
        if not set(keys).isdisjoint(self.sum_of):
            share = 1.0
        return float(min(share, 1.0) / (1.0 + np.exp(-self.log_odds)))


def probability_of_any(effects: Sequence[SingleEffect], keys: Collection[Key]) -> float:
    """Return the posterior probability that at least one of independent effects is one of the given causes."""
    return float(1.0 - np.prod([1.0 - effect.probability(keys) for effect in effects]))


@final
@dataclass(frozen=True)
class Comparison:
    """Comparison of the search with the second method."""

    probability: tuple[float, ...] = ()  # of each cause of the search, that it or an equivalent exists
    credible: tuple[tuple[Key, ...], ...] = ()  # of each the credible set of the effect that corresponds to it
    instead: tuple[tuple[Key, ...], ...] = ()  # of each the credible set of the effect found in its place
    further: tuple[SingleEffect, ...] = ()  # effects found that correspond to no cause of the search

    @property
    def disagree(self) -> bool:
        """Return whether an effect was found that the search explains differently or not at all.

        A cause that only the search finds is no disagreement: the second method finds fewer effects at the same rate of false alarms.
        """
        return bool(self.further) or any(self.instead)


def second_opinion(candidates: Candidates, start: Sequence[Form] = ()) -> tuple[SingleEffect, ...]:
    """Return independent single effects: those found, the strongest first, followed by one that was not.

    The prior of a form follows the search's correction for multiple testing: effects share it as they share the rate of false alarms,
    the places of an effect in proportion to their number of independent forms. A known or bounded size is part of the prior. Forms
    forbidden to the search are included with their own prior. The iteration starts from no effect, and from the forms that the search
    selected: an effect can be the sum of several (a lean of X is the same as one of Y and one of the rotary axis that Y carries).
    """
    effects = SingleEffects(_alternatives(candidates), candidates.slope, candidates.cross, candidates.dof)
    fitted = effects.fitted(MAX_EFFECTS, [form.index for form in start])
    ordered = sorted(fitted, key=lambda effect: (not effect.found, -effect.log_odds))
    return tuple(replace(_by_key(effect, candidates), sum_of=_sum_of(effect, candidates, start)) for effect in ordered)


def _sum_of(effect: Fit, candidates: Candidates, named: Sequence[Form]) -> tuple[Key, ...]:
    """Return the named causes that together make the same readings as an effect and not without one of them; empty if none do.

    A single one does only in place of an effect that the search excludes as impossible: another cause of like readings is a rival.
    """
    size, likeliest = float(effect.coefficients @ effect.slope), int(np.argmax(effect.posterior))
    # Of its functions, the causes need few: the others follow the noise.
    by_noise = chi2_isf(NOISE_LEVEL, len(candidates.forms[likeliest].columns))
    most_left = min(SUM_REMAINDER * size, max(DEVIANCE_RULED_OUT, float(by_noise)))

    def spanned(forms: Sequence[Form]) -> bool:
        columns, _, inverse = candidates.fitted(forms)
        slope = effect.slope[columns]
        return size - float(slope @ inverse @ slope) <= most_left

    if not effect.found or not named or not spanned(named):
        return ()
    needed = list(named)
    for form in named:
        others = [other for other in needed if other is not form]
        if others and spanned(others):
            needed = others
    excluded = np.isinf(candidates.critical_table[likeliest]).all()
    return tuple(form.key for form in needed) if len(needed) > 1 or excluded else ()


def compare_with_search(effects: Sequence[SingleEffect], groups: Sequence[Collection[Key]]) -> Comparison:
    """Compare the causes of the search, each in a group with those equivalent to it, with the second method.

    Each effect is assigned to at most one group, maximising the joint posterior probability. An unassigned effect disagrees with the
    search if a group has no effect, which it then replaces, or if its credible set has no cause in common with any group. Two effects
    with the same likeliest cause count as one cause in two forms.
    """
    common = np.array([[effect.probability(group) for effect in effects] for group in groups])
    pairs = zip(*_assigned(common), strict=True) if len(groups) else ()
    partner = {
        int(g): int(e) for g, e in pairs if set(groups[g]).intersection((*effects[e].credible, *effects[e].sum_of))
    }
    likeliest = {effects[e].credible[0] for e in partner.values()}
    named = {key for group in groups for key in group}
    instead: dict[int, int] = {}
    further = []
    for e, effect in enumerate(effects):
        if not effect.found or e in partner.values() or effect.credible[0] in likeliest:
            continue
        free = [g for g in range(len(groups)) if g not in partner and g not in instead]
        if free:
            instead[free[first_largest(common[free, e])]] = e
        elif named.isdisjoint((*effect.credible, *effect.sum_of)):
            further.append(effect)
    credible, replacing = (
        tuple(effects[of[g]].credible if g in of else () for g in range(len(groups))) for of in (partner, instead)
    )
    return Comparison(
        tuple(probability_of_any(effects, group) for group in groups), credible, replacing, tuple(further)
    )


def _assigned(common: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the pairs, each row and column in at most one, with the largest sum of probabilities."""
    best = common.argmax(axis=1)
    if len(np.unique(best)) == len(best):
        return np.arange(len(best)), best
    rows, columns = scipy.optimize.linear_sum_assignment(-common)
    return rows, columns


def _alternatives(candidates: Candidates) -> list[Alternatives]:
    alternatives = []
    for rows, columns, inner in candidates.blocks():
        forms = [candidates.forms[i] for i in rows]
        largest, centre, width = np.ones(columns.shape), np.zeros(columns.shape), np.zeros(len(rows))
        for i, form in enumerate(forms):
            if np.isfinite(form.candidate.largest):
                largest[i] = form.candidate.largest / np.array([column.scale for column in form.variant.columns])
            if form.candidate.specification.all_or_nothing:
                centre[i], width[i] = 1.0 / form.variant.columns[0].scale, ALL_OR_NOTHING_TOLERANCE
        # The form's share of the correction for multiple testing, which counts independent forms.
        prior = np.array(
            [np.exp(-form.log_tests) * form.candidate.tests / len(form.candidate.variants) for form in forms]
        )
        alternatives.append(Alternatives(rows, columns, inner, prior, largest, centre, width))
    return alternatives


def _by_key(effect: Fit, candidates: Candidates) -> SingleEffect:
    """Return the effect with the posterior summed over the forms of each cause."""
    total = np.bincount(candidates.key_of[: len(effect.posterior)], effect.posterior)
    names = {int(number): form.key for number, form in zip(candidates.key_of, candidates.forms, strict=True)}
    order = np.argsort(-total, kind="stable")
    ordered = {names[int(i)]: float(total[i]) for i in order if total[i] > 0.0}
    held = int(np.searchsorted(np.cumsum(total[order]), CREDIBLE_PROBABILITY)) + 1
    credible = tuple(names[int(i)] for i in order[:held])
    return SingleEffect(effect.log_odds, MappingProxyType(ordered), credible)
