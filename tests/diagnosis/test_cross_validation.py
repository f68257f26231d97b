"""Each fold of the cross-validation chooses its causes anew, from those that the search may name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import twin
from tests.diagnosis.battery import Searcher
from tests.diagnosis.test_held_up import arm_with_random_errors
from twin.diagnosis import cross_validation
from twin.diagnosis.cross_validation import without_overfitting
from twin.diagnosis.forms import Candidates, Form
from twin.diagnosis.problem import LOOSELY_PLACED
from twin.diagnosis.readings import readings
from twin.diagnosis.search import largest_causes
from twin.machine.machine import Machine
from twin.measurement.instruments import LaserTracker
from twin.measurement.simulate import simulate
from twin.measurement.table import Measurements
from twin.model.calibration import Calibration
from twin.model.effects.entries import effect_named
from twin.samples import thesis_plan

OFFSET = ("zero_offset", "J3")
Chosen = list[list[Form]]


@pytest.fixture
def candidates(tmp_path: Path) -> Candidates:
    """Return the candidates for few poses of an arm with a zero offset of J3."""
    machine, data = arm_with_random_errors(tmp_path, 4e-3, seed=1)
    placed = readings(data, machine, Calibration.default(machine))
    return Searcher(placed.without(placed.bad)).candidates


@pytest.fixture
def of_folds(monkeypatch: pytest.MonkeyPatch) -> Chosen:
    """Return a list that receives the causes chosen in every fold."""
    chosen: Chosen = []
    original = cross_validation._chosen_again

    def noted(part: Candidates, count: int) -> list[Form]:
        chosen.append(original(part, count))
        return chosen[-1]

    monkeypatch.setattr(cross_validation, "_chosen_again", noted)
    return chosen


def test_a_fold_does_not_choose_what_the_search_may_not_name(candidates: Candidates, of_folds: Chosen) -> None:
    """An offset larger than possible explains the poses left out; it must not count in favour of other causes."""
    forms = largest_causes(candidates, 9)
    assert forms[0].key == OFFSET
    without_overfitting(candidates, forms)
    assert len(of_folds) > 2 and all(chosen[0].key == OFFSET for chosen in of_folds)
    of_folds.clear()
    candidates.exclude({OFFSET})
    without_overfitting(candidates, forms[1:])
    assert len(of_folds) > 2 and all(OFFSET not in {form.key for form in chosen} for chosen in of_folds)


def test_a_fold_ends_where_no_cause_is_left(candidates: Candidates) -> None:
    """No cause is named twice, and no excluded one fills the number asked for."""
    named = largest_causes(candidates, 9)
    slots = {form.slot for form in named}
    candidates.exclude_forms([form for form in candidates.forms if form.slot not in slots])
    chosen = [form.slot for form in cross_validation._chosen_again(candidates, 99)]
    assert sorted(chosen) == sorted(slots)


def test_the_fewest_causes_within_one_standard_error_are_kept() -> None:
    """The third cause is best by far less than its standard deviation over the groups; the first improves each group by as much."""
    groups = np.arange(8.0)
    first = np.full(8, 10.0)
    second = first - np.where(groups < 4, 3.0, -2.9)
    assert cross_validation._fewest(np.column_stack([first + 5.0, first, second])) == 1
    assert cross_validation._fewest(np.column_stack([first + 5.0, first, first - 1.0])) == 2


def with_a_small_station(machine: Machine, *, seed: int) -> tuple[Measurements, Calibration]:
    """Return the thesis's readings of a machine with a hidden tilt, four poses from a second station, and its calibration."""
    model, rng, tracker = Calibration.default(machine), np.random.default_rng(seed), LaserTracker()
    hidden = effect_named("cross_axis", "E_AY by Z", {"coefficient": 60.0}, machine)
    real = replace(model, extra=(hidden,))
    plan = thesis_plan.plan(machine)
    data, _ = simulate(plan, machine, real, tracker, rng)
    at = np.array(
        [[50.0, 400, -350, 40, 30], [450, 60, -300, 40, 100], [250, 420, -60, 40, 200], [100, 225, -200, 40, 300]]
    )
    some = plan.select(np.array([np.flatnonzero(plan.target == name)[0] for name in ("K", "P", "Q")] * len(at)))
    second = replace(
        some,
        positions=np.repeat(at, 3, axis=0),
        approach=np.zeros((12, 5)),
        station=np.full(12, "second", dtype=object),
        round=np.full(12, "5", dtype=object),
        time_s=plan.time_s[-1] + 15.0 * np.arange(1, 13),
    )
    return Measurements.join([data, simulate(second, machine, real, tracker, rng)[0]]), model


def test_a_station_that_the_other_readings_do_not_place_says_nothing_of_a_cause(dmu50: Machine) -> None:
    """Without the held-out poses a station of four turns about the others: the error of its prediction is not the machine's."""
    data, model = with_a_small_station(dmu50, seed=7)
    found = twin.diagnose(data, dmu50, model, instrument=LaserTracker())
    held = found.gain.held_out
    assert found.verdict in ("explained", "ambiguous") and all(cause.promised for cause in found.causes)
    assert held.after_um == pytest.approx(found.expected_rms_um, rel=0.05) and held.before_um < 1.3 * held.after_um


def test_what_the_other_readings_place_is_their_covariance(dmu50: Machine) -> None:
    """Against the covariance of a plain least-squares fit of the set-up without the held-out readings."""
    data, model = with_a_small_station(dmu50, seed=8)
    placed = readings(data, dmu50, model, LaserTracker())
    problem = placed.without(placed.bad).problem
    columns = problem.nuisances.rows(slice(None))[:, :, : problem.nuisances.setup_count]
    own = problem.network.data
    of_second = np.flatnonzero(own.station == "second")
    for out in (of_second[:3], of_second[:9], np.flatnonzero(own.station != "second")[::5]):
        gone = np.isin(np.arange(len(own)), out)
        left = columns[~gone].reshape(-1, columns.shape[2])
        covariance = np.linalg.pinv(left.T @ left, rcond=1e-13, hermitian=True)
        variance = np.einsum("nik,kl,nil->ni", columns[out], covariance, columns[out])
        expected = (variance <= LOOSELY_PLACED**2).all(axis=1)
        assert np.mean(problem.without(gone).placed_held_out == expected) > 0.99
    assert not problem.without(np.isin(np.arange(len(own)), of_second[:9])).placed_held_out.all()
    assert problem.without(np.isin(np.arange(len(own)), np.arange(0, 600, 7))).placed_held_out.all()
