"""Estimation of a payload that is not in the URDF, and of where a known load is carried, from the deflection of the joints.

A joint's deflection is its compliance times its load: its own weight plus the payload. It is linear in the compliance, and in the
products of compliance with mass and first moments of the payload. The search treats these products as free for every joint
(`twin.diagnosis.candidates`). If it finds any, they are replaced by one payload, the same for all joints and not heavier
than possible, and the search is repeated. A carried load has a known mass (channel `load_kg`); which side carries it, and where its
centre of gravity is, follows in the same way. (Khalil and Dombre 2002, Modeling, Identification and Control of Robots, ch. 12: the
torques, and so the deflections here, are linear in the base parameters.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
import scipy

from twin._common.arrays import first_largest
from twin._common.messages import Message
from twin.diagnosis.candidates.machine import variant_at, with_centre
from twin.diagnosis.forms import Candidates, Form, columns_of, pseudo_inverse
from twin.diagnosis.search import Selection, select, within_limits
from twin.machine.machine import Axis
from twin.measurement.observation import machine_state
from twin.model.effects import Payload
from twin.model.effects.base import CENTRE_RANGE_MM, LARGEST_RATIO, MASS, SIDES, Side, max_payload_kg, side_of, sum_of
from twin.model.effects.gravity_compliance import (
    CARRIED_LOAD,
    GRAVITY_COMPLIANCE,
    PAYLOAD,
    UNKNOWN_PAYLOAD,
    AddedLoad,
    refined_form,
)

ROUNDS: Final = 4  # largest number of repeated searches
FIRST_MASS_SHARES: Final = (0.03, 0.2, 1.0)  # initial masses of a fit, as shares of the heaviest payload
CONVERGED_SHARE: Final = 0.01  # change of the payload, as a share of the largest, below which it has converged
CENTRE_PRIOR: Final = 3.0  # inverse prior variance of a mass or centre as a share of its bound: uniform within ±1
CARRIED_INDEX: Final = 4
"""Index of a share: 1 if the side carries the load of the readings, else 0. Shares of a payload are before it, of the centre behind."""
STEPS: Final = 200  # largest number of iterations of a fit
NO_MASS: Final = Message("they fit only with a mass that is not positive, or a centre of mass beyond its range")
"""Reason for which a load is left out, in words."""
UNDETERMINED_SIZE: Final = 1e-9  # relative size below which a direction is not determined


@final
@dataclass(frozen=True, eq=False)
class Load:
    """The joints of one side that deflect, with the other causes projected out.

    The loads are four numbers here, or eight if the readings carry different loads: the payload's mass as a share of the heaviest, its
    centre as shares of the farthest; whether the load is carried (`CARRIED_INDEX`), and its centre as shares of the farthest.
    """

    side: Side
    heaviest: float  # largest mass considered, kg
    joints: tuple[Form, ...]  # those that deflect
    # of each joint with free loads: own weight, mass, three first moments; the same four of a carried load
    free: tuple[Form, ...]
    gram: np.ndarray  # (wk, wk) inner products of these w columns of k joints, in units of the parameters
    slope: np.ndarray  # (wk,) inner products with the residual

    @property
    def nothing(self) -> np.ndarray:
        """Shares without payload and without carried load."""
        return np.zeros(len(self.slope) // len(self.joints) - 1)

    def explained_under(self, shares: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the χ² that the joints explain under some loads, and (k,) their compliances."""
        shapes = self._shapes(shares)
        inverse = np.linalg.pinv(shapes.T @ self.gram @ shapes, rcond=UNDETERMINED_SIZE, hermitian=True)
        slope = shapes.T @ self.slope
        return float(slope @ inverse @ slope), np.asarray(inverse @ slope)

    def _shapes(self, shares: np.ndarray) -> np.ndarray:
        return np.kron(np.eye(len(self.joints)), weights(shares)[:, None])

    def best(self, *, payload: bool, carried: bool) -> np.ndarray:
        """Return the shares that explain most, with or without a payload and the carried load."""
        start = self.nothing
        bounds = [(0.0, 1.0 if payload else 0.0), *[(-1.0, 1.0) if payload else (0.0, 0.0)] * 3]
        if len(start) > CARRIED_INDEX:
            start[CARRIED_INDEX] = float(carried)
            bounds += [(start[CARRIED_INDEX], start[CARRIED_INDEX]), *[(-1.0, 1.0) if carried else (0.0, 0.0)] * 3]
        if not payload and not carried:
            return start
        fits = [
            scipy.optimize.minimize(
                lambda shares: (
                    CENTRE_PRIOR * np.sum(shares[CARRIED_INDEX + 1 :] ** 2) - self.explained_under(shares)[0]
                ),
                np.concatenate([[share if payload else 0.0], start[1:]]),
                method="L-BFGS-B",
                bounds=bounds,
                options={"maxiter": STEPS},
            )
            for share in (FIRST_MASS_SHARES if payload else FIRST_MASS_SHARES[:1])
        ]
        return np.asarray(fits[first_largest(np.array([-float(fit.fun) for fit in fits]))].x)

    def significant(self, critical: Callable[[float], float]) -> tuple[np.ndarray, float]:
        """Return the shares of the loads beyond the critical value, and the χ² that the carried load explains; 0 if not significant."""
        tried = {
            (payload, carried): self.best(payload=payload, carried=carried)
            for payload in (False, True)
            for carried in ((False, True) if len(self.nothing) > CARRIED_INDEX else (False,))
        }
        explained = {key: self.explained_under(shares)[0] for key, shares in tried.items()}
        gain = 0.0
        if (True, True) in tried:
            gain = explained[True, True] - explained[True, False]
            gain = gain if gain > critical(4.0) else 0.0
        carried = gain > 0.0
        payload = explained[True, carried] - explained[False, carried] > critical(4.0)
        return tried[payload, carried], gain

    def payloads_of(self, shares: np.ndarray) -> tuple[Payload | None, Payload | None]:
        """Return the payload and the carried load of some shares; None for one that is not there."""
        payload = Payload.of_shares(self.side, self.heaviest, shares[:CARRIED_INDEX]) if shares[0] else None
        carried = None
        if len(shares) > CARRIED_INDEX and shares[CARRIED_INDEX]:
            carried = replace(Payload.of_shares(self.side, 1.0, shares[CARRIED_INDEX:]), carried=True)
        return payload, carried

    def shares_of(self, payload: Payload | None, carried: Payload | None) -> np.ndarray:
        """Return a payload and a carried load as shares of their bounds."""
        shares = self.nothing
        if payload is not None:
            mass = payload.mass_kg / self.heaviest
            shares[:CARRIED_INDEX] = [mass, *(value / CENTRE_RANGE_MM for value in payload.centre_mm)]
        if carried is not None:
            shares[CARRIED_INDEX:] = [carried.mass_kg, *(value / CENTRE_RANGE_MM for value in carried.centre_mm)]
        return shares

    def covariances(self, shares: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (k,) factors on the uncertainties of the compliances due to the loads, and the variances of the shares.

        ``u`` are the (k,) standard uncertainties of the compliances under exactly these loads.
        """
        _, values = self.explained_under(shares)
        present = (
            np.concatenate([[shares[0]] * CARRIED_INDEX, [0.0], [shares[-CARRIED_INDEX]] * 3])[: len(shares)] != 0.0
        )
        step = np.eye(len(shares))[present] * 1e-6
        by_share = [(weights(shares + change) - weights(shares - change)) / 2e-6 for change in step]
        slopes = np.concatenate(
            [self._shapes(shares), *[np.kron(values, slope)[:, None] for slope in by_share]], axis=1
        )
        known = slopes.T @ self.gram @ slopes
        count = len(values)
        given = np.diag(np.linalg.pinv(known[:count, :count], rcond=UNDETERMINED_SIZE, hermitian=True))
        known /= max(float(np.median(u**2 / np.maximum(given, 1e-300))), 1e-300)
        # Prior: a mass or centre that the data do not determine is uniformly distributed within its bounds.
        known[count:, count:] += CENTRE_PRIOR * np.eye(len(step))
        posterior = np.diag(np.linalg.pinv(known, hermitian=True))
        variances = np.zeros(len(shares))
        variances[present] = posterior[count:]
        return np.sqrt(np.maximum(posterior[:count] / np.maximum(u**2, 1e-300), 1.0)), variances


def weights(shares: np.ndarray) -> np.ndarray:
    """Return (5,) or (9,) weights of the columns of a joint: own weight; mass and first moments of payload and carried load."""
    some = [
        part
        for k in range(0, len(shares), CARRIED_INDEX)
        for part in (shares[k : k + 1], shares[k] * shares[k + 1 : k + CARRIED_INDEX])
    ]
    return np.concatenate([[1.0], *some])


def select_with_payload(candidates: Candidates, before: Sequence[Form] = ()) -> Selection:
    """Return the best set of possible causes, with one payload per side in the load of all deflecting joints.

    The search starts from the set ``before`` forms were refined if that has a payload, which a new search may miss.
    """
    anew = not any(MASS in form.variant.fixed for form in before)
    best = select(candidates, () if anew else [candidates.forms[form.index] for form in before])
    for _ in range(ROUNDS):
        loads = _loads_found(candidates, best.forms)
        moved = [_refine_side(candidates, side, *payloads) for side, payloads in loads.items()]
        if not any(moved):
            break
        candidates.exclude_forms([form for form in candidates.forms if UNKNOWN_PAYLOAD in form.variant.fixed])
        known = {form.key: form for form in candidates.forms if MASS in form.variant.fixed}
        best, anew = select(candidates, [known.get(form.key, form) for form in best.forms]), False
    for _ in range(ROUNDS):
        forms = [_bounded_load(candidates, form, best.forms) for form in best.forms]
        if forms == list(best.forms):
            break
        best, anew = select(candidates, [form for form in forms if form is not None]), False
    return within_limits(candidates, best, anew)


def _bounded_load(candidates: Candidates, form: Form, forms: Sequence[Form]) -> Form | None:
    """Return the form, or for an added load that is impossible the best possible one; None if no such load explains anything.

    Mass and first moments are free in the search. A mass that is not positive, or a centre beyond the search range, is the noise of
    directions that the readings hardly show: with the centre's prior (`CENTRE_PRIOR`) the estimate stays within its bounds.
    """
    added = next(iter(_added_loads(candidates, forms, (form,))), None)
    if added is None or added.plausible:
        return form
    by_width = {len(other.variant.columns): other for other in candidates.forms if other.key == form.key}
    free, single = by_width[CARRIED_INDEX], by_width[1]
    heaviest = LARGEST_RATIO if added.carried else max_payload_kg(candidates.problem.network.machine)
    centre, mass = _bounded_centre(
        *_projected(candidates, [free], [other for other in forms if other is not form]), heaviest
    )
    if mass <= 0.0:
        candidates.exclude({form.key}, NO_MASS)
        return None
    candidates.exclude_forms([free])
    candidates.refine(single, with_centre(form.candidate, centre))
    return candidates.forms[single.index]


def _projected(candidates: Candidates, forms: Sequence[Form], others: Sequence[Form]) -> tuple[np.ndarray, np.ndarray]:
    """Return inner products of some forms' columns and with the residual, other causes projected out, in units of the parameters."""
    every = [*others, *forms]
    columns, gram, slope = columns_of(every), candidates.gram(every), candidates.slope
    at = np.concatenate([np.searchsorted(columns, form.columns) for form in forms])
    given = np.setdiff1d(np.arange(len(columns)), at)
    along = gram[np.ix_(at, given)] @ pseudo_inverse(gram[np.ix_(given, given)])
    size = np.array([column.scale for form in forms for column in form.variant.columns])
    projected = gram[np.ix_(at, at)] - along @ gram[np.ix_(given, at)]
    return projected / np.outer(size, size), (slope[columns[at]] - along @ slope[columns[given]]) / size


def _bounded_centre(gram: np.ndarray, slope: np.ndarray, heaviest: float) -> tuple[np.ndarray, float]:
    """Return the centre (3,), mm, and the mass within their bounds that explain most.

    ``gram`` (4, 4) and ``slope`` (4,) are inner products of mass and first moments, per kg and kg·m.
    """

    def mass_of(shares: np.ndarray) -> tuple[float, float]:
        one_kg = np.array([1.0, *(1e-3 * CENTRE_RANGE_MM * shares)])
        size, along = float(one_kg @ gram @ one_kg), float(one_kg @ slope)
        mass = float(np.clip(along / size, 0.0, heaviest)) if size > 0.0 else 0.0
        return mass, 2.0 * mass * along - mass**2 * size

    fits = [
        scipy.optimize.minimize(
            lambda shares: CENTRE_PRIOR * np.sum(shares**2) - mass_of(shares)[1],
            start,
            method="L-BFGS-B",
            bounds=[(-1.0, 1.0)] * 3,
            options={"maxiter": STEPS},
        )
        for start in (np.zeros(3), *np.concatenate([np.eye(3), -np.eye(3)]))
    ]
    shares = np.asarray(fits[first_largest(np.array([-float(fit.fun) for fit in fits]))].x)
    return CENTRE_RANGE_MM * shares, mass_of(shares)[0]


def _loads_found(candidates: Candidates, forms: Sequence[Form]) -> dict[Side, tuple[Payload | None, Payload | None]]:
    """Return by side the payload and the carried load that some causes imply; the load is carried on one side only."""
    loads_found: dict[Side, tuple[Payload | None, Payload | None]] = {}
    carried: dict[Side, float] = {}
    for side in SIDES:
        load = loaded_joints(candidates, forms, side)
        if load is not None:
            first = load.free[0]
            shares, carried[side] = load.significant(lambda dof, first=first: candidates.critical_value(first, dof))  # type: ignore[misc]
            loads_found[side] = load.payloads_of(shares)
    for side in loads_found:
        if carried[side] < max(carried.values()):
            loads_found[side] = loads_found[side][0], None
    if any(carried.values()):
        # The other side's joints must not carry it either, even if none of them is among the causes yet.
        loads_found = {side: loads_found.get(side, (None, None)) for side in SIDES}
    # Further compliances of that side carry an added load as well.
    for added in _added_loads(candidates, forms):
        if added.plausible:
            kinds = list(loads_found.get(added.side, (None, None)))
            alike = kinds[added.carried]
            kinds[added.carried] = added if alike is None else sum_of((alike, added))
            loads_found[added.side] = kinds[0], kinds[1]
    return loads_found


def _added_loads(candidates: Candidates, forms: Sequence[Form], of: Sequence[Form] | None = None) -> list[Payload]:
    """Return the loads found with the known compliances, fitted with all forms; of those forms only, if given."""
    loads = [form for form in of or forms if form.candidate.specification in (PAYLOAD, CARRIED_LOAD)]
    if not loads:
        return []
    columns, values, _ = candidates.fitted(forms)
    added_loads = []
    for form in loads:
        at = np.searchsorted(columns, form.columns)
        scale = np.array([column.scale for column in form.variant.columns])
        built = () if form.candidate.build is None else form.candidate.build(values[at] * scale, form.variant.fixed)
        added_loads += [effect.payload for effect in built[:1] if isinstance(effect, AddedLoad) and effect.weights[0]]
    return added_loads


def loaded_joints(candidates: Candidates, forms: Sequence[Form], side: Side) -> Load | None:
    """Return the deflecting joints of a side if any of them has a payload or carries a load, free or fixed; else None."""
    free = {form.key: form for form in candidates.forms if UNKNOWN_PAYLOAD in form.variant.fixed}
    joints = [form for form in forms if form.key in free and side_of(axis_of_form(candidates, form)) == side]
    if not any({UNKNOWN_PAYLOAD, MASS} & form.variant.fixed.keys() for form in joints):
        return None
    with_free_loads = [free[form.key] for form in joints]
    gram, slope = _projected(candidates, with_free_loads, [form for form in forms if form not in joints])
    heaviest = max_payload_kg(candidates.problem.network.machine)
    return Load(side, heaviest, tuple(joints), tuple(with_free_loads), gram, slope)


def _refine_side(candidates: Candidates, side: Side, payload: Payload | None, carried: Payload | None) -> bool:
    """Put a payload and a carried load into the load of every joint of a side; return whether that changed anything."""
    machine = candidates.problem.network.machine
    state = machine_state(candidates.problem.network.data, machine)
    numbers = refined_form(payload, carried)
    farthest = np.ones(4)
    size = refined_form(
        Payload.of_shares(side, max_payload_kg(machine), farthest),
        replace(Payload.of_shares(side, 1.0, farthest), carried=True),
    )
    moved = False
    for form in list(candidates.forms):
        joint = form.candidate.specification is GRAVITY_COMPLIANCE and UNKNOWN_PAYLOAD not in form.variant.fixed
        if not joint or side_of(axis_of_form(candidates, form)) != side:
            continue
        before = form.variant.fixed
        if before and all(abs(before[name] - value) <= CONVERGED_SHARE * size[name] for name, value in numbers.items()):
            continue
        candidates.refine(form, variant_at(form.candidate, numbers, machine, state))
        moved = True
    return moved


def axis_of_form(candidates: Candidates, form: Form) -> Axis:
    """Return the axis of a deflecting joint."""
    return candidates.problem.network.machine.by_name[form.candidate.where]
