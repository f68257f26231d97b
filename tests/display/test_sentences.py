"""Parts of sentences."""

from __future__ import annotations

from twin.display.numbers import capital, listed, lower


def test_names_are_listed_and_many_are_counted() -> None:
    assert listed(["a"]) == "a" and listed(["a", "b"]) == "a and b" and listed(["a", "b", "c"]) == "a, b and c"
    assert listed([str(i) for i in range(20)]) == "0, 1, 2, 3, 4, 5, 6 and 13 more"
    assert listed([]) == ""


def test_a_name_in_the_middle_of_a_sentence_keeps_the_letter_of_its_axis() -> None:
    assert capital("reversal of Y") == "Reversal of Y" and capital("") == ""
    assert lower("Reversal of Y") == "reversal of Y" and lower("Y reversal") == "Y reversal"
