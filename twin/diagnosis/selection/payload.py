"""What the machine carries beside what its URDF says, found by how the joints give way under it.

A joint's deflection is its compliance times its load, and the load is that of its own weight plus that of the payload: linear in the
compliance alone, and in mass and first moments of the payload times the compliance. The search takes these products of every joint as
free (`twin.diagnosis.candidates.catalogue`); where it finds any, this puts one payload in their place that is the same to all joints
and no heavier than it can be, and has the search made again. (Khalil and Dombre 2002, Modeling, Identification and Control of
Robots, ch. 12: base parameters are linear in the torques, and so here in the deflections.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from scipy.optimize import minimize

from twin.diagnosis.candidates.machine_effects import variant_at
from twin.diagnosis.problem.forms import Candidates, Form, columns_of, pseudo_inverse
from twin.diagnosis.selection.search import Selection, possible, select
from twin.machine.effects import Payload
from twin.machine.effects.gravity_compliance import FREE, GRAVITY_COMPLIANCE, payloads_of
from twin.machine.effects.payload import MASS, SIDES, SOUGHT_MM, Side, heaviest_kg, side_of
from twin.machine.machine import Axis
from twin.measurement.table import state_of

ROUNDS: Final = 4
FIRST: Final = (0.03, 0.2, 1.0)
"""Shares of the heaviest payload that a fit begins with."""
STILL: Final = 0.01
"""Share of the largest payload by which it may still move."""
STEPS: Final = 200
LOST: Final = 1e-9
"""Relative size below which a direction is not seen."""
AT_BOUND: Final = 0.99


@final
@dataclass(frozen=True, eq=False)
class Load:
    """The joints of one side that give way, beside the other causes.

    A payload is four numbers here: its mass as a share of the heaviest, its centre as a share of the farthest.

    Attributes:
        side: ``tool`` or ``work``.
        heaviest: kg.
        joints: the causes.
        free: of each joint the form whose payload is free, of five columns: own weight, mass, three first moments.
        gram: (5k, 5k) inner products of those columns of k joints, beside the other causes, in units of their parameters.
        slope: (5k,) with the residual.
    """

    side: Side
    heaviest: float
    joints: tuple[Form, ...]
    free: tuple[Form, ...]
    gram: np.ndarray
    slope: np.ndarray

    def under(self, four: np.ndarray) -> tuple[float, np.ndarray]:
        """What the joints explain under a payload, and (k,) their compliances."""
        shapes = self._shapes(four)
        inverse = np.linalg.pinv(shapes.T @ self.gram @ shapes, rcond=LOST, hermitian=True)
        slope = shapes.T @ self.slope
        return float(slope @ inverse @ slope), np.asarray(inverse @ slope)

    def _shapes(self, four: np.ndarray) -> np.ndarray:
        return np.kron(np.eye(len(self.joints)), weights(four)[:, None])

    def payload(self) -> Payload:
        """The one that explains most."""
        fits = [
            minimize(
                lambda four: -self.under(four)[0],
                np.array([share, 0.0, 0.0, 0.0]),
                method="L-BFGS-B",
                bounds=[(0.0, 1.0), *[(-1.0, 1.0)] * 3],
                options={"maxiter": STEPS},
            )
            for share in FIRST
        ]
        return Payload.of_shares(self.side, self.heaviest, min(fits, key=lambda fit: float(fit.fun)).x)

    def four(self, payload: Payload) -> np.ndarray:
        """(4,) of a payload."""
        return np.array([payload.mass_kg / self.heaviest, *(one / SOUGHT_MM for one in payload.centre_mm)])

    def covariances(self, four: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(k,) times more uncertain that the compliances are as the payload is no better known, and (4,) variances of that.

        Args:
            four: the payload.
            u: (k,) standard uncertainties of the compliances under exactly this payload.
        """
        _, values = self.under(four)
        step = np.eye(4) * 1e-6
        by_four = [(weights(four + one) - weights(four - one)) / 2e-6 for one in step]
        slopes = np.concatenate([self._shapes(four), *[np.kron(values, one)[:, None] for one in by_four]], axis=1)
        known = slopes.T @ self.gram @ slopes
        count = len(values)
        given = np.diag(np.linalg.pinv(known[:count, :count], rcond=LOST, hermitian=True))
        known /= max(float(np.median(u**2 / np.maximum(given, 1e-300))), 1e-300)
        # A mass or a centre of which the data say nothing is anywhere where it can be.
        known[count:, count:] += 3.0 * np.eye(4)
        found = np.diag(np.linalg.pinv(known, hermitian=True))
        return np.sqrt(np.maximum(found[:count] / np.maximum(u**2, 1e-300), 1.0)), found[count:]


def weights(four: np.ndarray) -> np.ndarray:
    """(5,) of the loads: own weight, mass, first moments."""
    return np.concatenate([[1.0, four[0]], four[0] * four[1:]])


def chosen(candidates: Candidates, before: Sequence[Form] = ()) -> Selection:
    """The best set of causes that are possible, with one payload a side in the load of all joints that give way.

    Args:
        candidates: the forms; where joints ask for a payload they have it in their load from then on.
        before: the best set before forms were refined; begun with where it has a payload, which not every way through a search finds.
    """
    anew = not any(MASS in form.variant.fixed for form in before)
    best = select(candidates, () if anew else [candidates.forms[form.index] for form in before])
    for _ in range(ROUNDS):
        loads = [load for side in SIDES if (load := asked(candidates, best.forms, side)) is not None]
        if not any([_put(candidates, _believed(candidates, load)) for load in loads]):
            break
        _bar(candidates)
        known = {form.key: form for form in candidates.forms if MASS in form.variant.fixed}
        best, anew = select(candidates, [known.get(form.key, form) for form in best.forms]), False
    return possible(candidates, best, anew)


def _believed(candidates: Candidates, load: Load) -> Payload:
    """The payload that explains most, if that is worth its price; none, of no mass, if it is not."""
    found = load.payload()
    more = load.under(load.four(found))[0] - load.under(np.zeros(4))[0]
    return found if more > candidates.critical_value(load.free[0], 4.0) else replace(found, mass_kg=0.0)


def again(candidates: Candidates, forms: Sequence[Form]) -> None:
    """Have the payloads that some causes were found with in the load of all joints, after other data were judged."""
    yielding = [form for form in forms if form.candidate.specification is GRAVITY_COMPLIANCE]
    for payload in {
        one for form in yielding for one in payloads_of(axis_of_form(candidates, form), form.variant.fixed)
    }:
        _put(candidates, payload)


def chosen_on(part: Candidates, forms: Sequence[Form]) -> Selection:
    """The best set of causes on a part of the data, from one that was found on all of them; payloads as they are there.

    Args:
        part: of the candidates.
        forms: of the candidates; each stays where it is worth it.
    """
    _bar(part)
    return possible(part, select(part, [part.forms[form.index] for form in forms]), False)


def _bar(candidates: Candidates) -> None:
    """No joint has a payload of its own."""
    candidates.exclude_forms([form for form in candidates.forms if FREE in form.variant.fixed])


def asked(candidates: Candidates, forms: Sequence[Form], side: Side) -> Load | None:
    """The joints of a side that give way, if any of them asks for a payload or was given one."""
    free = {form.key: form for form in candidates.forms if FREE in form.variant.fixed}
    joints = [form for form in forms if form.key in free and side_of(axis_of_form(candidates, form)) == side]
    if not any(FREE in form.variant.fixed or MASS in form.variant.fixed for form in joints):
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
    heaviest = heaviest_kg(candidates.problem.network.machine)
    return Load(side, heaviest, tuple(joints), tuple(own), left, (slope[at] - along @ slope[rest]) / size)


def _put(candidates: Candidates, payload: Payload) -> bool:
    """Have a payload in the load of every joint of its side; whether that changes anything."""
    machine = candidates.problem.network.machine
    state = state_of(candidates.problem.network.data, machine)
    numbers = payload.numbers
    size = Payload.of_shares(payload.side, heaviest_kg(machine), np.ones(4)).numbers
    moved = False
    for form in list(candidates.forms):
        joint = form.candidate.specification is GRAVITY_COMPLIANCE and FREE not in form.variant.fixed
        if not joint or side_of(axis_of_form(candidates, form)) != payload.side:
            continue
        before = form.variant.fixed
        if before and all(abs(before[name] - value) <= STILL * size[name] for name, value in numbers.items()):
            continue
        candidates.refine(form, variant_at(form.candidate, numbers, machine, state))
        moved = True
    return moved


def axis_of_form(candidates: Candidates, form: Form) -> Axis:
    """The axis of a joint that gives way."""
    return candidates.problem.network.machine.by_name[form.candidate.where]
