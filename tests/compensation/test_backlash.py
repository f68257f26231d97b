"""Approach directions of many points at once compared with a machine that is followed step by step."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.compensation.programs.backlash import AT_END, STANDING_STILL, _from_reversal, _play


def play(way: np.ndarray, width: float) -> tuple[list[float], list[float]]:
    """Follow an axis in its play: its place there, from −1 to +1, and the end last reached."""
    place = end = 0.0
    last = np.nan
    places, ends = [], []
    for here in way:
        if np.isnan(here):
            place = end = 0.0
        elif not np.isnan(last):
            place = min(1.0, max(-1.0, place + 2.0 / width * (here - last)))
            place = np.sign(place) if abs(place) > 1.0 - AT_END else place
            end = place if abs(place) == 1.0 else end
        last = here
        places.append(place)
        ends.append(end)
    return places, ends


def from_reversal(way: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Move each change of side back to behind the last extreme point before it, since the one before or the last gap."""
    found = sides.copy()
    first = 0
    for at in range(len(way)):
        if np.isnan(way[at]):
            first = at + 1
        elif at and sides[at] != sides[at - 1]:
            height = way[first:at] * sides[at]
            first += max(i for i, one in enumerate(height) if one <= min(height) + STANDING_STILL)
            found[first + 1 : at] = sides[at]
    return found


@settings(max_examples=400)
@given(
    steps=st.lists(
        st.one_of(st.integers(-3, 3), st.integers(-3, 3), st.floats(-3, 3), st.sampled_from([5e-4, -5e-4]), st.none()),
        max_size=80,
    ),
    width=st.sampled_from([0.0015, 0.0041, 0.01]),
)
def test_the_way_of_an_axis_in_its_play(steps: list[float | None], width: float) -> None:
    way = np.cumsum([0.0 if step is None else 1e-3 * step for step in steps])
    way = np.where([step is None for step in steps], np.nan, way) if steps else way
    places, ends = _play(way, width)
    expected = play(way, width)
    assert np.allclose(places, expected[0], rtol=0.0, atol=2.0 * AT_END)
    assert ends.tolist() == expected[1]
    assert np.array_equal(_from_reversal(way, ends), from_reversal(way, ends))
