"""Each fold of the cross-validation chooses its causes anew, from those that the search may name."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.diagnosis.battery import Searcher
from tests.diagnosis.test_held_up import arm_with_random_errors
from twin.diagnosis import cross_validation
from twin.diagnosis.cross_validation import without_overfitting
from twin.diagnosis.forms import Candidates, Form
from twin.diagnosis.readings import readings
from twin.diagnosis.search import largest_causes
from twin.model.calibration import Calibration

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
