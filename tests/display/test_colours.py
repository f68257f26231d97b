"""Colours of pictures: visible on white, and distinct for readers who do not see red or green.

Contrast as in WCAG 2.2, 1.4.11 (3 : 1 for graphics). Colour blindness by the matrices of Machado, Oliveira and Fernandes (IEEE TVCG
15(6), 2009), table 1, full severity; distances in CIE 1976 L*a*b*.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from twin.display.figures import BACKWARD, BOTH, FORWARD, RUN, THIRD

LINES = {"FORWARD": FORWARD, "BACKWARD": BACKWARD, "THIRD": THIRD, "BOTH": BOTH}
SIGHT = {
    "all": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
WHITE = TO_XYZ @ np.ones(3)
LEAST = 15.0
"""ΔE*ab; 2.3 is just noticeable for adjacent areas. The closest pair has 17: blue and green without blue-sensitive cones."""


def linear(colour: str) -> np.ndarray:
    part = np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def lab(rgb: np.ndarray) -> np.ndarray:
    ratio = TO_XYZ @ np.clip(rgb, 0.0, 1.0) / WHITE
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("colour", [*LINES.values(), RUN])
def test_a_line_is_visible_on_white(colour: str) -> None:
    assert 1.05 / (float(TO_XYZ[1] @ linear(colour)) + 0.05) >= 3.0


@pytest.mark.parametrize("sight", SIGHT)
def test_lines_are_distinct_for_every_sight(sight: str) -> None:
    seen = {name: lab(SIGHT[sight] @ linear(colour)) for name, colour in LINES.items()}
    for one, other in combinations(seen, 2):
        assert np.linalg.norm(seen[one] - seen[other]) >= LEAST, (one, other)


def test_red_and_green_would_not_pass() -> None:
    red, green = (lab(SIGHT["deuteranopia"] @ linear(colour)) for colour in ("#b04030", "#667722"))
    assert np.linalg.norm(red - green) < LEAST
