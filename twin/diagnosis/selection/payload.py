"""Estimation of a payload that is not in the URDF, from the deflection of the joints.

A joint's deflection is its compliance times its load: its own weight plus the payload. It is linear in the compliance, and in the
products of compliance with mass and first moments of the payload. The search treats these products as free for every joint
(`twin.diagnosis.candidates.catalogue`). If it finds any, they are replaced by one payload, the same for all joints and not heavier
than possible, and the search is repeated. (Khalil and Dombre 2002, Modeling, Identification and Control of Robots, ch. 12: the
torques, and so the deflections here, are linear in the base parameters.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from scipy.optimize import minimize

from twin.diagnosis.candidates.machine_effects import variant_at
from twin.diagnosis.problem.forms import Candidates, Form, columns_of, pseudo_inverse
from twin.diagnosis.selection.search import Selection, select, within_limits
from twin.machine.effects import Payload
from twin.machine.effects.gravity_compliance import GRAVITY_COMPLIANCE, PAYLOAD, UNKNOWN_PAYLOAD, AddedLoad, payloads_of
from twin.machine.effects.payload import CENTRE_RANGE_MM, MASS, SIDES, Side, max_payload_kg, side_of
from twin.machine.machine import Axis
from twin.measurement.state import machine_state

ROUNDS: Final = 4
"""Largest number of repeated searches."""
FIRST: Final = (0.03, 0.2, 1.0)
"""Initial masses of a fit, as shares of the heaviest payload."""
STILL: Final = 0.01
"""Change of the payload, as a share of the largest, below which it has converged."""
STEPS: Final = 200
"""Largest number of iterations of a fit."""
LOST: Final = 1e-9
"""Relative size below which a direction is not determined."""


@final
@dataclass(frozen=True, eq=False)
class Load:
    """The joints of one side that deflect, with the other causes projected out.

    A payload is four numbers here: its mass as a share of the heaviest, and its centre as a share of the farthest.

    Attributes:
        side: ``tool`` or ``work``.
        heaviest: largest mass considered, kg.
        joints: the forms of the deflecting joints.
        free: for each joint the form with a free payload, of five columns: own weight, mass, three first moments.
        gram: (5k, 5k) inner products of these columns of k joints, the other causes projected out, in units of the parameters.
        slope: (5k,) inner products with the residual.
    """

    side: Side
    heaviest: float
    joints: tuple[Form, ...]
    free: tuple[Form, ...]
    gram: np.ndarray
    slope: np.ndarray

    def explained_under(self, shares: np.ndarray) -> tuple[float, np.ndarray]:
        """Return the χ² that the joints explain under a payload, and (k,) their compliances."""
        shapes = self._shapes(shares)
        inverse = np.linalg.pinv(shapes.T @ self.gram @ shapes, rcond=LOST, hermitian=True)
        slope = shapes.T @ self.slope
        return float(slope @ inverse @ slope), np.asarray(inverse @ slope)

    def _shapes(self, shares: np.ndarray) -> np.ndarray:
        return np.kron(np.eye(len(self.joints)), weights(shares)[:, None])

    def payload(self) -> Payload:
        """Return the payload that explains most."""
        fits = [
            minimize(
                lambda shares: -self.explained_under(shares)[0],
                np.array([share, 0.0, 0.0, 0.0]),
                method="L-BFGS-B",
                bounds=[(0.0, 1.0), *[(-1.0, 1.0)] * 3],
                options={"maxiter": STEPS},
            )
            for share in FIRST
        ]
        return Payload.of_shares(self.side, self.heaviest, min(fits, key=lambda fit: float(fit.fun)).x)

    def shares_of(self, payload: Payload) -> np.ndarray:
        """Return a payload as (4,) shares of its bounds."""
        return np.array([payload.mass_kg / self.heaviest, *(one / CENTRE_RANGE_MM for one in payload.centre_mm)])

    def covariances(self, shares: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (k,) factors on the uncertainties of the compliances due to the payload, and (4,) variances of the payload.

        Args:
            shares: (4,) the payload, as shares of its bounds.
            u: (k,) standard uncertainties of the compliances under exactly this payload.
        """
        _, values = self.explained_under(shares)
        step = np.eye(4) * 1e-6
        by_four = [(weights(shares + one) - weights(shares - one)) / 2e-6 for one in step]
        slopes = np.concatenate([self._shapes(shares), *[np.kron(values, one)[:, None] for one in by_four]], axis=1)
        known = slopes.T @ self.gram @ slopes
        count = len(values)
        given = np.diag(np.linalg.pinv(known[:count, :count], rcond=LOST, hermitian=True))
        known /= max(float(np.median(u**2 / np.maximum(given, 1e-300))), 1e-300)
        # Prior: a mass or centre that the data do not determine is uniformly distributed within its bounds.
        known[count:, count:] += 3.0 * np.eye(4)
        found = np.diag(np.linalg.pinv(known, hermitian=True))
        return np.sqrt(np.maximum(found[:count] / np.maximum(u**2, 1e-300), 1.0)), found[count:]


def weights(shares: np.ndarray) -> np.ndarray:
    """Return (5,) weights of the columns of a joint: own weight, mass, first moments."""
    return np.concatenate([[1.0, shares[0]], shares[0] * shares[1:]])


def select_with_payload(candidates: Candidates, before: Sequence[Form] = ()) -> Selection:
    """Return the best set of possible causes, with one payload per side in the load of all deflecting joints.

    Args:
        candidates: the forms; a payload that is found is added to the load of its joints.
        before: the best set before forms were refined; the search starts from it if it has a payload, which a new search may miss.
    """
    anew = not any(MASS in form.variant.fixed for form in before)
    best = select(candidates, () if anew else [candidates.forms[form.index] for form in before])
    for _ in range(ROUNDS):
        loads = [load for side in SIDES if (load := loaded_joints(candidates, best.forms, side)) is not None]
        payloads = [_significant_payload(candidates, load) for load in loads]
        payloads += _added_loads(candidates, best.forms)
        if not any([_add_payload(candidates, payload) for payload in payloads]):
            break
        _exclude_free_payloads(candidates)
        known = {form.key: form for form in candidates.forms if MASS in form.variant.fixed}
        best, anew = select(candidates, [known.get(form.key, form) for form in best.forms]), False
    return within_limits(candidates, best, anew)


def _added_loads(candidates: Candidates, forms: Sequence[Form]) -> list[Payload]:
    """Return the loads found with the known compliances, which further compliances of that side carry as well."""
    own = [form for form in forms if form.candidate.specification is PAYLOAD]
    if not own:
        return []
    columns, values, _ = candidates.fitted(forms)
    found = []
    for form in own:
        at = np.searchsorted(columns, form.columns)
        scale = np.array([column.scale for column in form.variant.columns])
        built = () if form.candidate.build is None else form.candidate.build(values[at] * scale, form.variant.fixed)
        found += [effect.payload for effect in built[:1] if isinstance(effect, AddedLoad) and effect.weights[0] > 0.0]
    return found


def _significant_payload(candidates: Candidates, load: Load) -> Payload:
    """Return the payload that explains most, with zero mass if it is not significant."""
    found = load.payload()
    more = load.explained_under(load.shares_of(found))[0] - load.explained_under(np.zeros(4))[0]
    return found if more > candidates.critical_value(load.free[0], 4.0) else replace(found, mass_kg=0.0)


def restore_payloads(candidates: Candidates, forms: Sequence[Form]) -> None:
    """Put the payloads of the given causes back into the load of all joints, after the pool was evaluated on other data."""
    yielding = [form for form in forms if form.candidate.specification is GRAVITY_COMPLIANCE]
    for payload in {
        one for form in yielding for one in payloads_of(axis_of_form(candidates, form), form.variant.fixed)
    }:
        _add_payload(candidates, payload)


def select_on_part(part: Candidates, forms: Sequence[Form]) -> Selection:
    """Return the best set of causes on a part of the data, starting from that on all data, with the payloads of the latter.

    Args:
        part: the candidates on a part of the data.
        forms: the causes found on all data; each stays if it is significant.
    """
    _exclude_free_payloads(part)
    return within_limits(part, select(part, [part.forms[form.index] for form in forms]), False)


def _exclude_free_payloads(candidates: Candidates) -> None:
    """Exclude the forms with a free payload for each joint."""
    candidates.exclude_forms([form for form in candidates.forms if UNKNOWN_PAYLOAD in form.variant.fixed])


def loaded_joints(candidates: Candidates, forms: Sequence[Form], side: Side) -> Load | None:
    """Return the deflecting joints of a side if any of them has a payload, free or fixed; else None."""
    free = {form.key: form for form in candidates.forms if UNKNOWN_PAYLOAD in form.variant.fixed}
    joints = [form for form in forms if form.key in free and side_of(axis_of_form(candidates, form)) == side]
    if not any(UNKNOWN_PAYLOAD in form.variant.fixed or MASS in form.variant.fixed for form in joints):
        return None
    own = [free[form.key] for form in joints]
    every = [*(form for form in forms if form not in joints), *own]
    columns, gram = columns_of(every), candidates.gram(every)
    at = np.concatenate([np.searchsorted(columns, form.columns) for form in own])
    rest = np.setdiff1d(np.arange(len(columns)), at)
    slope = candidates.slope[columns]
    inverse, _ = pseudo_inverse(gram[np.ix_(rest, rest)])
    along = gram[np.ix_(at, rest)] @ inverse
    size = np.concatenate([[column.scale for column in form.variant.columns] for form in own])
    left = (gram[np.ix_(at, at)] - along @ gram[np.ix_(rest, at)]) / np.outer(size, size)
    heaviest = max_payload_kg(candidates.problem.network.machine)
    return Load(side, heaviest, tuple(joints), tuple(own), left, (slope[at] - along @ slope[rest]) / size)


def _add_payload(candidates: Candidates, payload: Payload) -> bool:
    """Put a payload into the load of every joint of its side; return whether that changed anything."""
    machine = candidates.problem.network.machine
    state = machine_state(candidates.problem.network.data, machine)
    numbers = payload.numbers
    size = Payload.of_shares(payload.side, max_payload_kg(machine), np.ones(4)).numbers
    moved = False
    for form in list(candidates.forms):
        joint = form.candidate.specification is GRAVITY_COMPLIANCE and UNKNOWN_PAYLOAD not in form.variant.fixed
        if not joint or side_of(axis_of_form(candidates, form)) != payload.side:
            continue
        before = form.variant.fixed
        if before and all(abs(before[name] - value) <= STILL * size[name] for name, value in numbers.items()):
            continue
        candidates.refine(form, variant_at(form.candidate, numbers, machine, state))
        moved = True
    return moved


def axis_of_form(candidates: Candidates, form: Form) -> Axis:
    """Return the axis of a deflecting joint."""
    return candidates.problem.network.machine.by_name[form.candidate.where]
