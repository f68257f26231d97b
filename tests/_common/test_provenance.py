"""Warnings of several sources in one list."""

from __future__ import annotations

import pytest

from twin._common.provenance import ILLUSTRATIVE, UNKNOWN_UNCERTAINTY, SourceWarning, merge_warnings

ALL = UNKNOWN_UNCERTAINTY
ONE, TWO = ALL.about(["E_XX"]), ALL.about(["E_YY", "E_XX"])


@pytest.mark.parametrize(
    ("lists", "errors"),
    [
        (([ONE], [TWO]), ("E_XX", "E_YY")),
        (([TWO], [ONE]), ("E_YY", "E_XX")),
        (([ONE], [ALL]), ()),
        (([ALL], [ONE]), ()),
        (([ONE], [ALL], [TWO]), ()),
        (([ONE, TWO, ONE],), ("E_XX", "E_YY")),
    ],
)
def test_one_warning_names_the_errors_of_all(lists: tuple[list[SourceWarning], ...], errors: tuple[str, ...]) -> None:
    """A warning about all errors includes those about some, in any order; the most serious stands first."""
    found = merge_warnings(*lists, [ILLUSTRATIVE])
    assert [one.name for one in found] == ["illustrative", "unknown_uncertainty"]
    assert found[1].errors == errors and found[1].title == ALL.title


def test_more_than_eight_errors_are_counted() -> None:
    names = [f"E_{i}" for i in range(10)]
    assert ALL.about(names).sentence == f"{', '.join(names[:8])} and 2 more {ALL.explanation}"
    assert ALL.about(names[:8]).sentence == f"{', '.join(names[:8])} {ALL.explanation}"
    assert ALL.text == f"{ALL.title}: {ALL.explanation}"
